//! Problems of a part program, with place and remedy.

use std::collections::BTreeSet;
use std::fmt;

/// Largest number of listed problems; the others are counted.
pub const LISTED_PROBLEMS: usize = 50;

/// A place in a part program.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Place {
    /// 0 for the program itself, else the number of a called file from 1, see [`Refused::called`].
    pub file: u16,
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
    /// Names of the called files, in the order of their numbers.
    pub called: Vec<String>,
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
            let Place { file, line, column } = problem.place;
            let name = file_name(&self.file, &self.called, file);
            write!(
                f,
                "{name}:{line}:{column}: {}; {}",
                problem.what, problem.remedy
            )?;
        }
        if self.more > 0 {
            write!(f, "\n{}: {} more problems", self.file, self.more)?;
        }
        Ok(())
    }
}

impl std::error::Error for Refused {}

/// Problems of a program, of which the first are listed.
#[derive(Debug, Default)]
pub struct Problems {
    listed: Vec<Listed>,
    more: usize,
    /// File and line of each problem, of the first [`MAX_LINES`].
    lines: BTreeSet<(u16, u32)>,
}

/// Lines whose problems are counted once, although loops repeat them.
const MAX_LINES: usize = 10_000;

/// Other lines with the same problem that are named.
const NAMED_LINES: usize = 3;

/// A problem, and the other lines that have the same.
#[derive(Debug)]
struct Listed {
    problem: Problem,
    /// The first of them.
    lines: Vec<u32>,
    count: usize,
}

impl Listed {
    fn into_problem(self) -> Problem {
        let Listed {
            mut problem,
            mut lines,
            count,
        } = self;
        lines.sort_unstable();
        let named: Vec<String> = lines.iter().map(u32::to_string).collect();
        let more = match count - named.len() {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        let line = if count == 1 { "line" } else { "lines" };
        if count > 0 {
            let others = format!(" (also in {line} {}{more})", named.join(", "));
            problem.what.push_str(&others);
        }
        problem
    }
}

impl Problems {
    /// Notes the problem of a result, if there is one. A line has at most one: a loop that repeats
    /// it finds it again, or one that follows from it. The same problem in other lines is counted
    /// with the first one.
    pub fn note(&mut self, result: Result<(), Problem>) {
        let Err(problem) = result else { return };
        let Place { file, line, .. } = problem.place;
        if self.lines.contains(&(file, line)) {
            return;
        }
        if self.lines.len() < MAX_LINES {
            self.lines.insert((file, line));
        }
        let is_same =
            |it: &&mut Listed| it.problem.place.file == file && it.problem.what == problem.what;
        if let Some(same) = self.listed.iter_mut().find(is_same) {
            same.count += 1;
            if same.lines.len() < NAMED_LINES {
                same.lines.push(line);
            }
        } else if self.listed.len() < LISTED_PROBLEMS {
            self.listed.push(Listed {
                problem,
                lines: Vec::new(),
                count: 0,
            });
        } else {
            self.more += 1;
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.listed.is_empty()
    }

    /// Ends the collection.
    ///
    /// # Errors
    ///
    /// The problems in the order of the file, if there is one.
    pub fn take(self, file: &str, called: &[String]) -> Result<(), Refused> {
        if self.listed.is_empty() {
            return Ok(());
        }
        let listed = self.listed.into_iter();
        let mut problems: Vec<Problem> = listed.map(Listed::into_problem).collect();
        problems.sort_by_key(|problem| problem.place);
        Err(Refused {
            file: file.to_owned(),
            called: called.to_vec(),
            problems,
            more: self.more,
        })
    }
}

/// Returns the name of a place's file.
pub fn file_name<'a>(main: &'a str, called: &'a [String], file: u16) -> &'a str {
    usize::from(file)
        .checked_sub(1)
        .and_then(|index| called.get(index))
        .map_or(main, String::as_str)
}

/// A word that was accepted although it changes nothing, or less than it says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Notice {
    /// Place of the first such word.
    pub place: Place,
    /// What it does here.
    pub what: String,
}

/// A mistake in the line that is being read: problem, remedy and byte offset in the line.
#[derive(Debug, Clone)]
pub(crate) struct Mistake {
    pub at: usize,
    pub what: String,
    pub remedy: String,
    /// What an earlier mistake may have left wrong, so that this one follows from it.
    pub cause: Option<Cause>,
}

/// State that a block with a mistake may have left wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Cause {
    Feed,
    Motion,
    Position,
    Spindle,
    Parameter,
    /// Loops, conditions and subroutines that are open.
    Order,
    /// Words of a cycle, which stay in force for its next holes.
    Series,
    /// The plane in force.
    Plane,
    /// A comment that is not closed: its next lines are no blocks.
    Comment,
    /// Something that an earlier mistake named, as a tool that does not exist.
    Named,
}

/// States that are in doubt after a mistake: what follows from them is not reported.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Doubt {
    causes: [bool; Cause::Named as usize + 1],
    comment: OpenComment,
}

/// A comment that was not closed on its line.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum OpenComment {
    #[default]
    None,
    /// The next lines may be its text.
    Text,
    /// A block followed.
    Blocks,
}

impl Doubt {
    pub(crate) fn add(&mut self, cause: Cause) {
        self.causes[cause as usize] = true;
    }

    pub(crate) fn remove(&mut self, cause: Cause) {
        self.causes[cause as usize] = false;
    }

    /// Whether a line with a mistake continues a comment that is not closed: text, or its end.
    pub(crate) fn continues_comment(&mut self, line: &[u8]) -> bool {
        if self.comment == OpenComment::None {
            return false;
        }
        match line.iter().find(|byte| matches!(byte, b'(' | b')')) {
            None => self.comment == OpenComment::Text,
            Some(mark) => {
                self.comment = OpenComment::None;
                *mark == b')'
            }
        }
    }

    /// Notes a line without a mistake.
    pub(crate) fn pass(&mut self, has_comment: bool, is_block: bool) {
        if self.comment == OpenComment::None {
            return;
        }
        if has_comment {
            self.comment = OpenComment::None;
        } else if is_block {
            self.comment = OpenComment::Blocks;
        }
    }

    /// Whether a mistake may follow from an earlier one.
    pub(crate) fn explains(&self, mistake: &Mistake) -> bool {
        mistake
            .cause
            .is_some_and(|cause| cause == Cause::Named || self.causes[cause as usize])
    }

    /// Notes what a line with a mistake may have left wrong.
    pub(crate) fn note(&mut self, line: &[u8], mistake: &Mistake) {
        match mistake.cause {
            // The end of a wrong arc is known.
            Some(Cause::Position) => return,
            // The other words of the block are lost.
            Some(Cause::Comment) => self.comment = OpenComment::Text,
            Some(Cause::Named) => {}
            Some(cause) => return self.add(cause),
            None => {}
        }
        for byte in line {
            match byte.to_ascii_uppercase() {
                b'(' | b';' => break,
                b'F' => self.add(Cause::Feed),
                b'S' | b'M' => self.add(Cause::Spindle),
                b'G' => {
                    self.add(Cause::Motion);
                    self.add(Cause::Position);
                }
                b'A'..=b'C' | b'U'..=b'Z' => self.add(Cause::Position),
                b'#' => self.add(Cause::Parameter),
                _ => {}
            }
        }
    }
}

impl Mistake {
    pub(crate) fn new(at: usize, what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self {
            at,
            what: what.into(),
            remedy: remedy.into(),
            cause: None,
        }
    }

    /// Marks a mistake that may follow from an earlier one.
    pub(crate) fn because(self, cause: Cause) -> Self {
        Self {
            cause: Some(cause),
            ..self
        }
    }
}

/// Returns the place of a byte of a line; a column is a character, continuation bytes do not count.
pub(crate) fn place_of(file: u16, line: u32, bytes: &[u8], at: usize) -> Place {
    let before = &bytes[..at.min(bytes.len())];
    let column = before.iter().filter(|&&byte| byte & 0xC0 != 0x80).count();
    Place {
        file,
        line,
        column: u32::try_from(column).unwrap_or(u32::MAX - 1) + 1,
    }
}
