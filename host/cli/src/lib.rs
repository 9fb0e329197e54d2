//! The library behind the `haptimill` command.

pub mod commands;
#[cfg(feature = "console")]
pub mod console;
pub mod kin;
