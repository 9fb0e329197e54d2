//! The `haptimill` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    haptimill::commands::main()
}
