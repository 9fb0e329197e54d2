//! What is wrong with a part program, where, and what to do about it.

use std::fmt;

/// The most problems that are listed; the rest is counted.
pub const LISTED_PROBLEMS: usize = 50;

/// A place in a part program.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Place {
    /// Line, from 1.
    pub line: u32,
    /// Column in characters, from 1.
    pub column: u32,
}

/// One thing that is wrong.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// Where.
    pub place: Place,
    /// What.
    pub what: String,
    /// What to do about it.
    pub remedy: String,
}

/// A part program that was refused, with every reason that was found. Nothing of it may be run.
///
/// Shown as `file:line:column: what; remedy`, one line a problem, in the order of the file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refused {
    /// Name of the file, as it was given.
    pub file: String,
    /// The problems, at least one, at most [`LISTED_PROBLEMS`].
    pub problems: Vec<Problem>,
    /// How many more there are.
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
    /// Notes a problem.
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

    /// How many there are.
    pub(crate) fn count(&self) -> usize {
        self.found.len() + self.more
    }

    /// The value, if nothing was wrong.
    pub(crate) fn or<T>(mut self, file: &str, value: T) -> Result<T, Refused> {
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
