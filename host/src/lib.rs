//! The library behind the `haptimill` command.

pub mod plan;
pub mod program;
