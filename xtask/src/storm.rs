//! Starts the storm: random robustness episodes of the whole controller (docs/storm.md).

use crate::cargo;
use crate::planted::planted;
use std::process::{Command, ExitStatus};

/// Runs the storm with these arguments.
pub fn storm(arguments: &[&str]) -> Result<(), String> {
    if let Some(at) = arguments
        .iter()
        .position(|argument| *argument == "--planted")
    {
        return planted(&arguments[at + 1..]);
    }
    let status = cargo()
        .args([
            "run",
            "--quiet",
            "--release",
            "--package",
            "haptimill-tests",
            "--bin",
            "storm",
            "--",
        ])
        .args(arguments)
        .status()
        .map_err(|error| format!("cargo cannot be started: {error}"))?;
    result(status)
}

/// Runs the storm for two minutes with the program that the tests have built.
pub fn short_storm() -> Result<(), String> {
    let own = std::env::current_exe().map_err(|error| format!("xtask: {error}"))?;
    let program = own.with_file_name(format!("storm{}", std::env::consts::EXE_SUFFIX));
    let words = ["--minutes", "2", "--seed", "1"];
    println!("== storm: {} {}", program.display(), words.join(" "));
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
            "the storm found something; each failure above names the command that reproduces it"
                .into(),
        )
    }
}
