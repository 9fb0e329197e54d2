//! Starts the storm: random robustness episodes of the whole controller (docs/storm.md).

use crate::cargo;
use crate::planted::planted;

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
    if status.success() {
        Ok(())
    } else {
        Err(
            "the storm found something; each failure above names the command that reproduces it"
                .into(),
        )
    }
}
