//! How the command ends: one number for scripts, one sentence for people.

use haptimill_client::port::PortError;
use haptimill_client::{Error, ErrorKind, Located};
use haptimill_machine_file::Problems;
use std::fmt;

/// Exit codes of `haptimill`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// It is done.
    Done = 0,
    /// A defect of this program, reported rather than hidden.
    Internal = 1,
    /// The command line cannot be understood (this number is given by its reader).
    Usage = 2,
    /// An input file cannot be read or has a mistake; nothing moved.
    BadInput = 3,
    /// The program asks for what the machine cannot do; nothing moved.
    Refused = 4,
    /// The port cannot be opened, is taken, or the link to the controller broke.
    Port = 5,
    /// The machine latched a fault.
    Fault = 6,
    /// Stopped by the user (Ctrl-C, or `haptimill stop`); the machine slowed down along its path.
    Stopped = 7,
    /// The controller refused a command in its present state, or its board has another configuration than the command needs.
    Command = 8,
    /// The result cannot be written.
    Output = 9,
}

/// The table of exit codes, as `--help` prints it.
pub const EXIT_CODES: &str = "\
Exit codes:
  0  done
  1  a defect of this program
  2  the command line cannot be understood
  3  an input file cannot be read or has a mistake; nothing moved
  4  the program asks for what the machine cannot do; nothing moved
  5  the port cannot be opened, is taken, or the link broke
  6  the machine latched a fault
  7  stopped by the user; the machine slowed down along its path
  8  refused in the controller's present state or configuration; `trace diff`, `replay`: there is a difference
  9  the result cannot be written
With --json an error is an object on standard output too, unless the command line
cannot be understood: {\"error\", \"exit_code\", \"problems\": [...]}.";

/// Why the command did not do what it was asked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CliError {
    /// The exit code.
    pub exit: Exit,
    /// What to tell, on standard error; may have several lines, ends without one.
    pub message: String,
    /// The single mistakes of an input file, where that is the reason.
    pub problems: Vec<Located>,
    /// With --json: what there is to say on standard output has been said.
    pub told: bool,
}

impl CliError {
    /// An error with its exit code.
    pub fn new(exit: Exit, message: impl fmt::Display) -> Self {
        Self {
            exit,
            message: message.to_string(),
            problems: Vec::new(),
            told: false,
        }
    }

    /// The same, where standard output has its JSON already.
    #[must_use]
    pub fn told(mut self) -> Self {
        self.told = true;
        self
    }

    /// For a program that reads standard output.
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
            told: false,
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
    fn the_table_lists_every_code() {
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
            .filter(|line| line.starts_with("  "))
            .map(|line| line.split_whitespace().next().unwrap().parse().unwrap())
            .collect();
        assert_eq!(listed, all.map(|exit| exit as u8));
    }
}
