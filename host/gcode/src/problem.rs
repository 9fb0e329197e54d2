//! Problems of a part program, with place and remedy.

use std::fmt;

/// Largest number of listed problems; the others are counted.
pub const LISTED_PROBLEMS: usize = 50;

/// A place in a part program.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Place {
    /// Line, from 1.
    pub line: u32,
    /// Column in characters, from 1.
    pub column: u32,
}

/// A problem.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// Its place.
    pub place: Place,
    /// The problem.
    pub what: String,
    /// The remedy.
    pub remedy: String,
}

/// A refused part program with its problems. No part of it may be run.
///
/// `Display` writes `file:line:column: what; remedy`, one line per problem, in the order of the
/// file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refused {
    /// Name of the file, as given.
    pub file: String,
    /// The problems, at least one, at most [`LISTED_PROBLEMS`].
    pub problems: Vec<Problem>,
    /// Number of the others.
    pub more: usize,
}

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, problem) in self.problems.iter().enumerate() {
            if index > 0 {
                writeln!(f)?;
            }
            let Place { line, column } = problem.place;
            write!(
                f,
                "{}:{line}:{column}: {}; {}",
                self.file, problem.what, problem.remedy
            )?;
        }
        if self.more > 0 {
            write!(f, "\n{}: {} more problems", self.file, self.more)?;
        }
        Ok(())
    }
}

impl std::error::Error for Refused {}

/// Collects problems.
#[derive(Debug, Default)]
pub(crate) struct Problems {
    found: Vec<Problem>,
    more: usize,
}

impl Problems {
    /// Adds a problem.
    pub(crate) fn add(&mut self, place: Place, what: impl Into<String>, remedy: impl Into<String>) {
        if self.found.len() < LISTED_PROBLEMS {
            self.found.push(Problem {
                place,
                what: what.into(),
                remedy: remedy.into(),
            });
        } else {
            self.more += 1;
        }
    }

    /// Returns the number of problems.
    pub(crate) fn count(&self) -> usize {
        self.found.len() + self.more
    }

    /// Returns the value if there is no problem.
    pub(crate) fn into_result<T>(mut self, file: &str, value: T) -> Result<T, Refused> {
        if self.found.is_empty() {
            return Ok(value);
        }
        self.found.sort_by_key(|problem| problem.place);
        Err(Refused {
            file: file.to_owned(),
            problems: self.found,
            more: self.more,
        })
    }
}
