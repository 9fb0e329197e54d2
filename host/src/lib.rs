//! The library behind the `haptimill` command.

pub mod cli;
pub mod kin;
pub mod machine;
pub mod port;
pub mod record;
pub mod report;
