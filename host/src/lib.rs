//! The library behind the `haptimill` command.

pub mod client;
