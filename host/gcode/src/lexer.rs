//! Lexer: from bytes to words (a letter and a number) with their places.
//!
//! The lexer accepts any bytes. Everything but words, comments, blanks and `%` is a problem with
//! its place; nothing is skipped. The reason for an own lexer is in
//! docs/decisions/0003-part-program-lexer.md.

use super::problem::{Place, Problems};

/// Largest magnitude of a number. It keeps all later computations finite.
pub(crate) const LARGEST_NUMBER: f64 = 1e7;

/// A word: a letter and its number.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Word {
    /// Place of the letter.
    pub place: Place,
    /// The letter, in upper case.
    pub letter: char,
    /// The number.
    pub value: f64,
    /// Text of the word, for messages.
    pub text: String,
}

/// A comment, as written between its marks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Comment {
    /// Place of the opening mark.
    pub place: Place,
    /// The text, without marks and surrounding blanks; bytes that are not UTF-8 are replaced.
    pub text: String,
}

/// A line of the program.
#[derive(Debug, Default)]
pub(crate) struct Line {
    /// Its words, in order.
    pub words: Vec<Word>,
    /// Place of the last `%`.
    pub percent: Option<Place>,
    /// Whether a part of the line has a problem; the rest must not be used as a motion.
    pub has_problem: bool,
}

/// Returns the lines of a file with their numbers from 1. A line ends with LF, CR LF or CR. A byte
/// order mark at the start is skipped.
pub(crate) fn lines(bytes: &[u8]) -> impl Iterator<Item = (u32, &[u8])> {
    let mut rest = Some(bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes));
    let mut number = 0u32;
    std::iter::from_fn(move || {
        let here = rest?;
        number = number.saturating_add(1);
        let Some(end) = here.iter().position(|&byte| byte == b'\n' || byte == b'\r') else {
            rest = None;
            return Some((number, here));
        };
        let newline = if here[end..].starts_with(b"\r\n") {
            2
        } else {
            1
        };
        rest = Some(&here[end + newline..]);
        Some((number, &here[..end]))
    })
}

/// Reads one line.
pub(crate) fn read_line(
    number: u32,
    bytes: &[u8],
    comments: &mut Vec<Comment>,
    problems: &mut Problems,
) -> Line {
    let mut scan = Scan {
        bytes,
        at: 0,
        column: 1,
        number,
    };
    let mut line = Line::default();
    while let Some(byte) = scan.peek() {
        let place = scan.place();
        match byte {
            b' ' | b'\t' => scan.step(),
            b'%' => {
                scan.step();
                line.percent = Some(place);
            }
            b';' => {
                comments.push(Comment {
                    place,
                    text: text_of(&bytes[scan.at + 1..]),
                });
                break;
            }
            b'(' => {
                let start = scan.at + 1;
                match bytes[start..]
                    .iter()
                    .position(|&byte| byte == b')' || byte == b'(')
                {
                    Some(end) if bytes[start + end] == b')' => {
                        comments.push(Comment {
                            place,
                            text: text_of(&bytes[start..start + end]),
                        });
                        scan.step_to(start + end + 1);
                    }
                    Some(_) => {
                        problems.add(
                            place,
                            "a comment is opened inside a comment",
                            "use ( ) without another ( inside, or ; to the end of the line",
                        );
                        line.has_problem = true;
                        break;
                    }
                    None => {
                        problems.add(
                            place,
                            "the comment is not closed",
                            "close it with ) on the same line, or open it with ;",
                        );
                        line.has_problem = true;
                        break;
                    }
                }
            }
            _ if byte.is_ascii_alphabetic() => match scan.word(problems) {
                Some(word) => line.words.push(word),
                None => line.has_problem = true,
            },
            _ => {
                scan.refuse_symbol(problems);
                line.has_problem = true;
            }
        }
    }
    line
}

fn text_of(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).trim().to_owned()
}

/// A position in a line.
struct Scan<'a> {
    bytes: &'a [u8],
    at: usize,
    column: u32,
    number: u32,
}

impl Scan<'_> {
    fn peek(&self) -> Option<u8> {
        self.bytes.get(self.at).copied()
    }

    fn place(&self) -> Place {
        Place {
            line: self.number,
            column: self.column,
        }
    }

    /// Advances one byte. A column is a character: continuation bytes do not count.
    fn step(&mut self) {
        self.at += 1;
        if self.peek().is_none_or(|byte| byte & 0xC0 != 0x80) {
            self.column = self.column.saturating_add(1);
        }
    }

    fn step_to(&mut self, at: usize) {
        while self.at < at {
            self.step();
        }
    }

    fn step_while(&mut self, mut what: impl FnMut(u8) -> bool) {
        while self.peek().is_some_and(&mut what) {
            self.step();
        }
    }

    /// Reads a letter and its number; blanks between them are allowed.
    fn word(&mut self, problems: &mut Problems) -> Option<Word> {
        let place = self.place();
        let start = self.at;
        let letter = char::from(self.bytes[self.at]).to_ascii_uppercase();
        self.step();
        self.step_while(|byte| byte == b' ' || byte == b'\t');
        let number = self.at;
        if self.peek().is_some_and(|byte| byte == b'+' || byte == b'-') {
            self.step();
        }
        self.step_while(|byte| byte.is_ascii_digit());
        if self.peek() == Some(b'.') {
            self.step();
            self.step_while(|byte| byte.is_ascii_digit());
        }
        // The slices have only letters, blanks, signs, digits and points: they are ASCII.
        let text = text_of(&self.bytes[start..self.at]);
        let digits = &self.bytes[number..self.at];
        if !digits.iter().any(u8::is_ascii_digit) {
            if self.peek().is_some_and(|byte| byte == b'[' || byte == b'#') {
                self.refuse_symbol(problems);
            } else {
                let what = format!("the letter {letter} has no number");
                problems.add(
                    place,
                    what,
                    "write a number after the letter, or put a remark in ( )",
                );
            }
            return None;
        }
        let value: f64 = std::str::from_utf8(digits).ok()?.parse().ok()?;
        if value.abs() > LARGEST_NUMBER {
            problems.add(
                place,
                format!("the number of {text} is too large"),
                "write at most 10,000,000",
            );
            return None;
        }
        Some(Word {
            place,
            letter,
            value,
            text,
        })
    }

    /// Reports the symbol at the position; a run of similar bytes is one problem.
    fn refuse_symbol(&mut self, problems: &mut Problems) {
        let place = self.place();
        let Some(byte) = self.peek() else { return };
        let (what, remedy) = match byte {
            b'/' => (
                "block delete (/) is not supported".into(),
                "remove the slash, or the line",
            ),
            b'#' | b'[' | b']' | b'=' => (
                "variables and expressions are not supported".into(),
                "let the CAM program write the numbers",
            ),
            b'*' => (
                "checksums are not supported".into(),
                "remove the * and the number after it",
            ),
            b')' => (
                "a comment is closed that was not opened".into(),
                "open it with ( on the same line",
            ),
            b'0'..=b'9' | b'.' | b'+' | b'-' => (
                "a number without a letter".into(),
                "write the letter of the word in front of the number",
            ),
            b',' => (
                "a comma is not supported".into(),
                "write decimals with a point: X10.5",
            ),
            0x20..=0x7E => (
                format!("'{}' is not supported", char::from(byte)),
                "remove it, or put it in a comment ( )",
            ),
            _ => (
                format!("byte 0x{byte:02X} is not part of a word"),
                "part programs are plain ASCII text outside comments",
            ),
        };
        problems.add(place, what, remedy);
        match byte {
            b'0'..=b'9' | b'.' | b'+' | b'-' => {
                self.step_while(|byte| byte.is_ascii_digit() || matches!(byte, b'.' | b'+' | b'-'));
            }
            0x20..=0x7E => self.step_to(self.at + 1),
            _ => self.step_while(|byte| !(0x20..=0x7E).contains(&byte) && byte != b'\t'),
        }
        // The rest of an expression is the same problem.
        if matches!(byte, b'#' | b'[' | b'=' | b'*') {
            self.step_while(|byte| byte != b'(' && byte != b';');
        }
    }
}
