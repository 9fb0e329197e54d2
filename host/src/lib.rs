//! The library behind the `haptimill` command.

pub mod machine;
pub mod port;
