//! Exit codes and error messages of the command.

use haptimill_client::port::PortError;
use haptimill_client::{Error, ErrorKind, Located};
use haptimill_machine_file::Problems;
use std::fmt;

/// Exit codes of `haptimill`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// Success.
    Done = 0,
    /// A defect of this program.
    Internal = 1,
    /// The command line is not valid (clap uses this number, too).
    Usage = 2,
    /// An input file cannot be read or has a mistake; nothing moved.
    BadInput = 3,
    /// The part program exceeds a limit of the machine; nothing moved.
    Refused = 4,
    /// The port cannot be opened, is in use, or the connection to the controller is lost.
    Port = 5,
    /// The machine latched a fault, or a simulated one lost steps or made another part.
    Fault = 6,
    /// Stopped by the user (Ctrl-C, or `haptimill stop`); the machine decelerated along its path.
    Stopped = 7,
    /// The controller refused a command in its state, or has another configuration than the command
    /// needs; or a comparison found a difference.
    Command = 8,
    /// A result cannot be written.
    Output = 9,
}

/// The table of exit codes for `--help`.
pub const EXIT_CODES: &str = "\
Exit codes:
  0  success
  1  a defect of this program
  2  the command line is not valid
  3  an input file cannot be read or has a mistake; nothing moved
  4  the part program exceeds a limit of the machine; nothing moved
  5  the port cannot be opened, is in use, or the connection is lost
  6  the machine latched a fault; in the simulator also: steps were lost, or the
     part differs from the drawing or design
  7  stopped by the user; the machine decelerated along its path
  8  the controller refused a command in its state or configuration;
     `trace diff` and `replay`: there is a difference; `pulses`: there are faults
  9  a result cannot be written
With --json an error is an object on standard output, too, unless the command line
is not valid: {\"error\", \"exit_code\", \"problems\": [...]}.";

/// Why the command failed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CliError {
    /// The exit code.
    pub exit: Exit,
    /// The message on standard error: one or more lines, without a newline at the end.
    pub message: String,
    /// The mistakes of an input file, where that is the reason.
    pub problems: Vec<Located>,
    /// With --json: the result on standard output is complete without this error.
    pub reported: bool,
}

impl CliError {
    /// Creates an error with its exit code.
    pub fn new(exit: Exit, message: impl fmt::Display) -> Self {
        Self {
            exit,
            message: message.to_string(),
            problems: Vec::new(),
            reported: false,
        }
    }

    /// Marks an error whose result is already on standard output.
    #[must_use]
    pub fn reported(mut self) -> Self {
        self.reported = true;
        self
    }

    /// The error as JSON.
    #[must_use]
    pub fn to_json(&self) -> serde_json::Value {
        serde_json::json!({
            "error": self.message,
            "exit_code": self.exit as u8,
            "problems": self.problems,
        })
    }
}

impl fmt::Display for CliError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}", self.message)
    }
}

impl std::error::Error for CliError {}

impl From<ErrorKind> for Exit {
    fn from(kind: ErrorKind) -> Self {
        match kind {
            ErrorKind::Internal => Self::Internal,
            ErrorKind::Usage => Self::Usage,
            ErrorKind::BadInput => Self::BadInput,
            ErrorKind::Refused => Self::Refused,
            ErrorKind::Port => Self::Port,
            ErrorKind::Fault => Self::Fault,
            ErrorKind::Stopped => Self::Stopped,
            ErrorKind::Command => Self::Command,
            ErrorKind::Output => Self::Output,
        }
    }
}

impl From<Error> for CliError {
    fn from(error: Error) -> Self {
        Self {
            exit: error.kind.into(),
            message: error.message,
            problems: error.problems,
            reported: false,
        }
    }
}

impl From<Problems> for CliError {
    fn from(problems: Problems) -> Self {
        Error::from(problems).into()
    }
}

impl From<PortError> for CliError {
    fn from(error: PortError) -> Self {
        Error::from(error).into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_lists_every_exit_code() {
        let all = [
            Exit::Done,
            Exit::Internal,
            Exit::Usage,
            Exit::BadInput,
            Exit::Refused,
            Exit::Port,
            Exit::Fault,
            Exit::Stopped,
            Exit::Command,
            Exit::Output,
        ];
        let listed: Vec<u8> = EXIT_CODES
            .lines()
            .filter(|line| line.starts_with("  ") && !line.starts_with("   "))
            .map(|line| line.split_whitespace().next().unwrap().parse().unwrap())
            .collect();
        assert_eq!(listed, all.map(|exit| exit as u8));
    }
}
