//! Starts the fuzz test: random sequences of events against the controller (docs/fuzzing.md).

use crate::cargo;
use crate::mutations::mutations;
use std::process::{Command, ExitStatus};

/// Runs the fuzz test with these arguments.
pub fn fuzz(arguments: &[&str]) -> Result<(), String> {
    if let Some(at) = arguments
        .iter()
        .position(|argument| *argument == "--mutations")
    {
        return mutations(&arguments[at + 1..]);
    }
    let status = cargo()
        .args([
            "run",
            "--quiet",
            "--release",
            "--package",
            "haptimill-tests",
            "--bin",
            "fuzz",
            "--",
        ])
        .args(arguments)
        .status()
        .map_err(|error| format!("cargo cannot be started: {error}"))?;
    result(status)
}

/// Runs the fuzz test for two minutes with the program that the tests have built.
pub fn short_fuzz() -> Result<(), String> {
    let own = std::env::current_exe().map_err(|error| format!("xtask: {error}"))?;
    let program = own.with_file_name(format!("fuzz{}", std::env::consts::EXE_SUFFIX));
    let words = ["--minutes", "2", "--seed", "1"];
    println!("== fuzz: {} {}", program.display(), words.join(" "));
    let status = Command::new(&program)
        .args(words)
        .status()
        .map_err(|error| format!("{}: {error}", program.display()))?;
    result(status)
}

fn result(status: ExitStatus) -> Result<(), String> {
    if status.success() {
        Ok(())
    } else {
        Err(
            "the fuzz test found something; each failure above names the command that reproduces it"
                .into(),
        )
    }
}
