//! Whole programs: all steps, or all problems.

use super::problem::{Notice, Place, Problems, Refused};
use super::{Coordinates, Interpreter, Options, Step};
use std::io::Cursor;

/// A comment, as written between its marks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Comment {
    /// Place of the opening mark.
    pub place: Place,
    /// The text, without marks and surrounding blanks; bytes that are not UTF-8 are replaced.
    pub text: String,
}

/// A program without problems.
#[derive(Debug, Clone, PartialEq)]
pub struct Program {
    /// Name of the file, for messages.
    pub file: String,
    /// Names of the called files, see [`Place::file`].
    pub called: Vec<String>,
    /// Start.
    pub start: Coordinates,
    /// Steps, in order.
    pub steps: Vec<Step>,
    /// Line of the program itself that made each step, see [`Interpreter::main_line`].
    pub main_lines: Vec<u32>,
    /// Comments, in the order in which they were read.
    pub comments: Vec<Comment>,
    /// Words that change nothing on this machine.
    pub notices: Vec<Notice>,
    /// Number of lines of the file.
    pub lines: u32,
}

/// Reads a part program from any bytes. `file` is its name in messages.
///
/// # Errors
///
/// Returns every problem of the file, with line, column and remedy. A program with a problem is
/// refused as a whole.
pub fn read(file: &str, text: &[u8], options: &Options) -> Result<Program, Refused> {
    let mut interpreter = Interpreter::new(Cursor::new(text), options);
    interpreter.keep_comments();
    let (mut steps, mut main_lines) = (Vec::new(), Vec::new());
    let mut problems = Problems::default();
    while let Some(next) = interpreter.next() {
        match next {
            Ok(step) if problems.is_empty() => {
                main_lines.push(interpreter.main_line(&step));
                steps.push(step);
            }
            Ok(_) => {}
            Err(problem) => problems.note(Err(problem)),
        }
    }
    let called = interpreter.called().to_vec();
    problems.take(file, &called)?;
    Ok(Program {
        file: file.to_owned(),
        called,
        start: options.start,
        steps,
        main_lines,
        comments: interpreter.take_comments(),
        notices: interpreter.notices().to_vec(),
        lines: interpreter.lines(),
    })
}
