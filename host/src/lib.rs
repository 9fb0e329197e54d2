//! The library behind the `haptimill` command.

pub mod cli;
pub mod kin;
pub mod machine;
pub mod port;
pub mod program;
pub mod record;
pub mod client;
pub mod report;
