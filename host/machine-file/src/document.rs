//! A machine file as a tree of sections. A section records the requested keys, to find unknown
//! ones.
//!
//! Reading does not stop at the first problem. A number that is missing or wrong is reported once
//! and read as NaN; later comparisons with NaN are false and report nothing. Callers must not use
//! any value unless [`Document::finish`] returns `Ok`.

mod section;

pub use section::{Allowed, Section, real, whole};

use super::problem::{LISTED_PROBLEMS, Problem, Problems};
use haptimill_machine_keys::Section as KeySection;
use std::cell::{Cell, RefCell};
use std::collections::HashMap;
use toml::Spanned;
use toml::de::DeTable;

/// The text of a machine file, its lines, and the problems found so far.
pub struct Document<'i> {
    file: &'i str,
    text: &'i str,
    /// All sections of the kind of file, with their keys.
    sections: Vec<KeySection>,
    problems: RefCell<Vec<(usize, Problem)>>,
    /// Number of problems beyond [`KEPT_PROBLEMS`].
    more: Cell<usize>,
}

/// What is wrong with a key that is missing.
pub const MISSING: &str = "is missing";
/// The problem of a key that its section does not have.
const UNKNOWN: &str = "is not a known key";

/// Largest number of problems that are kept. Each one costs a search for its line.
const KEPT_PROBLEMS: usize = 1000;

impl<'i> Document<'i> {
    /// Creates a document without problems. `sections` are those of the kind of file: they tell a
    /// key of another model or variant from an unknown one.
    pub fn new(file: &'i str, text: &'i str, sections: Vec<KeySection>) -> Self {
        Self {
            file,
            text,
            sections,
            problems: RefCell::default(),
            more: Cell::default(),
        }
    }

    /// Parses the text; `None` after a report.
    pub fn parse(&self) -> Option<Spanned<DeTable<'i>>> {
        let (root, errors) = DeTable::parse_recoverable(self.text);
        // One mistake, such as a misspelt [[joint]], can cause many equal errors.
        let mut counts: HashMap<&str, usize> = HashMap::new();
        for error in &errors {
            *counts.entry(error.message()).or_default() += 1;
        }
        for error in &errors {
            let message = error.message();
            // Only the first of equal errors is reported.
            let Some(count) = counts.remove(message) else {
                continue;
            };
            let span = error.span().unwrap_or_default();
            let more = match count - 1 {
                0 => String::new(),
                more => format!(" ({more} more like this below)"),
            };
            let line = self.text[..span.start].rfind('\n').map_or(0, |at| at + 1);
            let is_header = self.text[line..].starts_with('[');
            let (what, remedy) = match self.text.get(span.clone()) {
                Some(key) if message == "duplicate key" && is_header => (
                    format!("a section {key} is there already"),
                    "remove one; of a list each one has two brackets, as [[joint]]",
                ),
                Some(key) if message == "duplicate key" => (
                    format!("{key} is a duplicate key"),
                    "remove or rename one, or write the missing header of its section above it",
                ),
                _ => (message.trim().replace('\n', ", "), "correct the TOML"),
            };
            self.report(span.start, "", what, format!("{remedy}{more}"));
        }
        errors.is_empty().then_some(root)
    }

    /// Whether a problem of such a key was reported.
    pub fn has_problem(&self, is_it: impl Fn(&str) -> bool) -> bool {
        let problems = self.problems.borrow();
        problems.iter().any(|(_, problem)| is_it(&problem.key))
    }

    /// Drops the problem that a key is missing: another problem is its cause.
    pub fn forget_missing(&self, key: &str) {
        let mut problems = self.problems.borrow_mut();
        problems.retain(|(_, problem)| problem.key != key || problem.what != MISSING);
    }

    /// Reports a problem at a byte offset of the text.
    pub fn report(
        &self,
        offset: usize,
        key: impl Into<String>,
        what: impl Into<String>,
        remedy: impl Into<String>,
    ) {
        if self.problems.borrow().len() >= KEPT_PROBLEMS {
            self.more.set(self.more.get() + 1);
            return;
        }
        let (line, column) = position(self.text, offset);
        self.problems.borrow_mut().push((
            offset,
            Problem {
                file: self.file.to_string(),
                line,
                column,
                key: key.into(),
                what: what.into(),
                remedy: remedy.into(),
            },
        ));
    }

    /// Adds a problem that has its place.
    pub fn add(&self, problem: Problem) {
        let lines = self
            .text
            .split_inclusive('\n')
            .take(problem.line.saturating_sub(1));
        let offset = lines.map(str::len).sum::<usize>() + problem.column.saturating_sub(1);
        self.problems.borrow_mut().push((offset, problem));
    }

    /// Whether no problem was reported yet.
    pub fn is_valid(&self) -> bool {
        self.problems.borrow().is_empty()
    }

    /// Ends the document.
    ///
    /// # Errors
    ///
    /// Returns all reported problems.
    pub fn finish(self) -> Result<(), Problems> {
        if self.problems.borrow().is_empty() {
            return Ok(());
        }
        Err(self.into_problems())
    }

    /// Returns all reported problems in the order of the text.
    pub fn into_problems(self) -> Problems {
        let mut problems = self.problems.into_inner();
        let missing: Vec<(String, String)> = problems
            .iter()
            .filter(|(_, problem)| problem.what == MISSING)
            .map(|(_, problem)| {
                let parent = problem.key.rsplit_once('.');
                let parent = parent.map_or(String::new(), |(parent, _)| format!("{parent}."));
                (parent, section::table_path(&problem.key))
            })
            .collect();
        // Without its header, the keys of a section are in the section before it.
        problems.retain(|(_, problem)| {
            let name = problem.key.rsplit('.').next();
            let has = |path: &str| {
                let mut of_path = self.sections.iter().filter(|section| section.path == path);
                of_path.any(|section| {
                    section.keys.iter().any(|key| {
                        let rotary = key.rotary.map(|(rotary, _)| rotary);
                        name == Some(key.name) || (rotary.is_some() && name == rotary)
                    })
                })
            };
            problem.what != UNKNOWN
                || !missing
                    .iter()
                    .any(|(parent, path)| problem.key.starts_with(parent) && has(path))
        });
        problems.sort_by_key(|(offset, _)| *offset);
        let more = problems.len().saturating_sub(LISTED_PROBLEMS) + self.more.get();
        problems.truncate(LISTED_PROBLEMS);
        Problems(problems.into_iter().map(|(_, p)| p).collect(), more)
    }
}

/// Returns line and column (in characters) of a byte offset, both from 1.
pub fn position(text: &str, offset: usize) -> (usize, usize) {
    let bytes = &text.as_bytes()[..offset.min(text.len())];
    let line_start = bytes.iter().rposition(|b| *b == b'\n').map_or(0, |p| p + 1);
    let line = bytes.iter().filter(|b| **b == b'\n').count() + 1;
    // Counts the bytes that begin a character; an offset inside a character is valid, too.
    let begins = |b: &&u8| **b & 0xC0 != 0x80;
    (line, bytes[line_start..].iter().filter(begins).count() + 1)
}
