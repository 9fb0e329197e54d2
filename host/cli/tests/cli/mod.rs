//! The command line: help, exit codes, machine files, kinematics tables, ports.

mod command_line;
mod kin;
mod machine;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Exit code and output of a command.
struct RunResult {
    code: i32,
    out: String,
    err: String,
}

/// Runs the command in the root of the workspace.
fn haptimill(arguments: &[&str], input: &str) -> RunResult {
    let mut child = Command::new(env!("CARGO_BIN_EXE_haptimill"))
        .args(arguments)
        .current_dir(root())
        .env("COLUMNS", "120")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // A command that does not read standard input closes it.
    let _ = child.stdin.take().unwrap().write_all(input.as_bytes());
    let output = child.wait_with_output().unwrap();
    RunResult {
        code: output.status.code().unwrap(),
        out: String::from_utf8(output.stdout).unwrap(),
        err: String::from_utf8(output.stderr).unwrap(),
    }
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../..")
        .canonicalize()
        .unwrap()
}

/// The command, its output and its exit code as one text.
fn transcript(arguments: &[&str], input: &str) -> String {
    let ran = haptimill(arguments, input);
    let mut text = format!("$ haptimill {}\n{}", arguments.join(" "), ran.out);
    if !ran.err.is_empty() {
        text.push_str("--- standard error\n");
        text.push_str(&ran.err);
    }
    text.push_str(&format!("--- exit code {}\n", ran.code));
    text
}
