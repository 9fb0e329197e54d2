//! What is wrong in a machine file, and where.

use std::fmt;

/// One thing that is wrong in a machine file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// Name of the file, as it was given.
    pub file: String,
    /// Line, from 1; 0 when the file cannot be read at all.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
    /// Path of the key, such as `joint[2].law.kp`; empty where the text itself cannot be read.
    pub key: String,
    /// What is wrong, with the value and the allowed range.
    pub what: String,
    /// What to do about it.
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

/// The most problems of a file that are listed; the rest is counted.
pub const LISTED_PROBLEMS: usize = 50;

/// What is wrong in a machine file, in the order of the lines, at most `LISTED_PROBLEMS` and never empty; and how many problems more there are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problems(pub Vec<Problem>, pub usize);

impl Problems {
    /// The only problem of a file: it cannot be read.
    pub(crate) fn unread(file: &str, what: String, remedy: &str) -> Self {
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

    /// How many there are.
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
