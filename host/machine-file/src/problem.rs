//! Problems of a machine file, with their places.

use std::fmt;

/// A problem of a machine file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// Name of the file, as given.
    pub file: String,
    /// Line, from 1; 0 if the file cannot be read.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
    /// Path of the key, such as `joint[2].law.kp`; empty if the text is not TOML.
    pub key: String,
    /// The problem, with the value and the allowed range.
    pub what: String,
    /// The remedy.
    pub remedy: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            0 => write!(out, "{}: ", self.file)?,
            line => write!(out, "{}:{line}:{}: ", self.file, self.column)?,
        }
        if !self.key.is_empty() {
            write!(out, "{}: ", self.key)?;
        }
        write!(out, "{}", self.what)?;
        if !self.remedy.is_empty() {
            write!(out, "; {}", self.remedy)?;
        }
        Ok(())
    }
}

pub use haptimill_gcode::LISTED_PROBLEMS;

/// Problems of a machine file: the first `LISTED_PROBLEMS` in the order of the lines, at least
/// one, and the number of the others.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problems(pub Vec<Problem>, pub usize);

impl Problems {
    /// Returns the only problem of a file that cannot be read.
    pub(crate) fn unreadable(file: &str, what: String, remedy: &str) -> Self {
        let problem = Problem {
            file: file.to_string(),
            line: 0,
            column: 0,
            key: String::new(),
            what,
            remedy: remedy.to_string(),
        };
        Self(vec![problem], 0)
    }

    /// Returns the number of problems.
    #[must_use]
    pub fn count(&self) -> usize {
        self.0.len() + self.1
    }
}

impl fmt::Display for Problems {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, problem) in self.0.iter().enumerate() {
            if index > 0 {
                writeln!(out)?;
            }
            write!(out, "{problem}")?;
        }
        if let (more @ 1.., Some(problem)) = (self.1, self.0.first()) {
            let plural = if more == 1 { "" } else { "s" };
            write!(out, "\n{}: {more} more problem{plural}", problem.file)?;
        }
        Ok(())
    }
}

impl std::error::Error for Problems {}
