//! The library behind the `haptimill` command.

pub mod cli;
pub mod client;
#[cfg(feature = "console")]
pub mod console;
pub mod kin;
pub mod machine;
pub mod model;
pub mod plan;
pub mod port;
pub mod program;
pub mod record;
pub mod replay;
pub mod report;
pub mod scenario;
pub mod session;
pub mod teleop;
