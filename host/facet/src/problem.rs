//! Problems of a design, by line and facet.

use core::fmt;

pub use haptimill_gcode::LISTED_PROBLEMS;

/// A name in one line, for messages and comments of part programs.
pub fn one_line(name: &str) -> String {
    name.replace(char::is_control, " ")
}

/// A problem of a design.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// Line of the file, from 1; 0 for the design as a whole.
    pub line: usize,
    /// Name of the facet.
    pub facet: Option<String>,
    /// The problem.
    pub what: String,
    /// The remedy.
    pub remedy: String,
}

impl Problem {
    /// `file:line: facet NAME: what; remedy`.
    #[must_use]
    pub fn text(&self, file: &str) -> String {
        let mut text = format!("{file}:");
        if self.line > 0 {
            text.push_str(&format!("{}:", self.line));
        }
        if let Some(facet) = &self.facet {
            text.push_str(&format!(" facet {facet}:"));
        }
        text.push_str(&format!(" {}; {}", self.what, self.remedy));
        text
    }
}

/// A refused design with its problems. No part of it may be cut.
///
/// `Display` writes `file:line: facet NAME: what; remedy`, one line for each problem, in the order
/// of the file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refused {
    /// Name of the file, as given.
    pub file: String,
    /// The problems, at least one, at most `LISTED_PROBLEMS`.
    pub problems: Vec<Problem>,
    /// Number of the others.
    pub more: usize,
}

impl fmt::Display for Refused {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, problem) in self.problems.iter().enumerate() {
            if index > 0 {
                writeln!(out)?;
            }
            write!(out, "{}", problem.text(&self.file))?;
        }
        if self.more > 0 {
            write!(out, "\n{}: {} more problems", self.file, self.more)?;
        }
        Ok(())
    }
}

impl std::error::Error for Refused {}

/// Problems as they are found.
#[derive(Debug)]
pub struct Problems {
    file: String,
    problems: Vec<Problem>,
}

impl Problems {
    pub fn new(file: &str) -> Self {
        Self {
            file: file.to_string(),
            problems: Vec::new(),
        }
    }

    pub fn report(
        &mut self,
        line: usize,
        facet: Option<&str>,
        what: impl Into<String>,
        remedy: impl Into<String>,
    ) {
        self.problems.push(Problem {
            line,
            facet: facet.map(str::to_string),
            what: what.into(),
            remedy: remedy.into(),
        });
    }

    /// Whether none was found.
    pub fn is_empty(&self) -> bool {
        self.problems.is_empty()
    }

    /// The value, or the refusal.
    pub fn finish<T>(mut self, value: Option<T>) -> Result<T, Refused> {
        if let (Some(value), true) = (value, self.problems.is_empty()) {
            return Ok(value);
        }
        if self.problems.is_empty() {
            self.report(0, None, "has no design", "write its facets");
        }
        self.problems.sort_by_key(|problem| problem.line);
        let more = self.problems.len().saturating_sub(LISTED_PROBLEMS);
        self.problems.truncate(LISTED_PROBLEMS);
        Err(Refused {
            file: self.file,
            problems: self.problems,
            more,
        })
    }
}
