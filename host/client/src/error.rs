//! The error of ports, sessions and everything above them.
//!
//! An [`Error`] has a kind for programs and a message for the user. The command line assigns exit
//! codes.

use haptimill_gcode::Refused;
use haptimill_machine_file::Problems;
use serde::Serialize;
use std::fmt;

/// Kind of an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ErrorKind {
    /// A defect of this program, reported rather than hidden.
    Internal,
    /// The arguments contradict each other.
    Usage,
    /// An input file cannot be read or has a mistake; nothing moved.
    BadInput,
    /// The part program demands what the machine cannot do; nothing moved.
    Refused,
    /// The port cannot be opened, is in use, or the link to the controller failed.
    Port,
    /// The machine latched a fault.
    Fault,
    /// Stopped by the user; the machine decelerated along its path.
    Stopped,
    /// The controller refused a command in its present state, or its board has another
    /// configuration than the command needs.
    Command,
    /// The result cannot be written.
    Output,
}

/// An error.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Error {
    /// The kind.
    pub kind: ErrorKind,
    /// The message; it may have several lines, and ends without a line break.
    pub message: String,
    /// The single mistakes of an input file, where they are the reason.
    pub problems: Vec<Located>,
}

/// A mistake in a file, for programs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Located {
    /// The file, as it was given.
    pub file: String,
    /// Line, from 1; 0 when the file cannot be read at all.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
    /// The mistake.
    pub message: String,
    /// The remedy.
    pub remedy: String,
}

impl Error {
    /// An error of a kind.
    pub fn new(kind: ErrorKind, message: impl fmt::Display) -> Self {
        Self {
            kind,
            message: message.to_string(),
            problems: Vec::new(),
        }
    }

    /// A mistake of an input file.
    pub fn in_file(file: impl fmt::Display, problem: impl fmt::Display) -> Self {
        Self::new(ErrorKind::BadInput, format_args!("{file}: {problem}"))
    }

    /// A part program was refused.
    pub fn refused(kind: ErrorKind, refused: &Refused) -> Self {
        let located = |problem: &haptimill_gcode::Problem| Located {
            file: haptimill_gcode::file_name(&refused.file, &refused.called, problem.place.file)
                .to_owned(),
            line: problem.place.line as usize,
            column: problem.place.column as usize,
            message: problem.what.clone(),
            remedy: problem.remedy.clone(),
        };
        Self {
            problems: refused.problems.iter().map(located).collect(),
            ..Self::new(kind, refused)
        }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}", self.message)
    }
}

impl std::error::Error for Error {}

impl From<Problems> for Error {
    fn from(problems: Problems) -> Self {
        let located = |problem: &haptimill_machine_file::Problem| Located {
            file: problem.file.clone(),
            line: problem.line,
            column: problem.column,
            message: match problem.key.as_str() {
                "" => problem.what.clone(),
                key => format!("{key}: {}", problem.what),
            },
            remedy: problem.remedy.clone(),
        };
        Self {
            problems: problems.0.iter().map(located).collect(),
            ..Self::new(ErrorKind::BadInput, problems)
        }
    }
}
