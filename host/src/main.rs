//! The `haptimill` command.
fn main() {}
