//! The library behind the `haptimill` command.
