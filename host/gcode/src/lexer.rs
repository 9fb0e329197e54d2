//! From bytes to words: a letter and a number, with the place of each.
//!
//! Takes any bytes. What is neither word, comment, blank nor `%` is a problem at its place; nothing is skipped in silence. Why this is not a
//! library: docs/decisions/0003-part-program-lexer.md.

use super::problem::{Place, Problems};

/// The largest magnitude of a number; also keeps every later computation finite.
pub(crate) const LARGEST_NUMBER: f64 = 1e7;

/// A word: a letter and its number.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Word {
    /// Where its letter stands.
    pub place: Place,
    /// The letter, in upper case.
    pub letter: char,
    /// The number.
    pub value: f64,
    /// As it is written, for messages.
    pub text: String,
}

/// A comment, as written between its marks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Comment {
    /// Where its opening mark stands.
    pub place: Place,
    /// The text, without marks and surrounding blanks; bytes that are not UTF-8 are replaced.
    pub text: String,
}

/// A line of the program.
#[derive(Debug, Default)]
pub(crate) struct Line {
    /// Its words, in order.
    pub words: Vec<Word>,
    /// Its `%` signs.
    pub percent: Option<Place>,
    /// A part of it could not be read: what is left of it must not be understood as a motion.
    pub broken: bool,
}

/// The lines of a file, with their numbers from 1. A line ends with LF, CR LF or CR. A byte order mark at the start is passed over.
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
                        line.broken = true;
                        break;
                    }
                    None => {
                        problems.add(
                            place,
                            "the comment is not closed",
                            "close it with ) on the same line, or open it with ;",
                        );
                        line.broken = true;
                        break;
                    }
                }
            }
            _ if byte.is_ascii_alphabetic() => match scan.word(problems) {
                Some(word) => line.words.push(word),
                None => line.broken = true,
            },
            _ => {
                scan.refuse_symbol(problems);
                line.broken = true;
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

    /// One byte on. A column is a character: bytes that continue one do not count.
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

    /// A letter and its number; blanks may stand between them.
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
        // Only letters, blanks, signs, digits and points were passed: the slices are ASCII.
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
                    "write the number behind the letter, or put a remark in ( )",
                );
            }
            return None;
        }
        let value: f64 = std::str::from_utf8(digits).ok()?.parse().ok()?;
        if value.abs() > LARGEST_NUMBER {
            problems.add(
                place,
                format!("the number of {text} is too large"),
                "no word may be beyond 10,000,000",
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

    /// Refuses what stands here; a run of alike bytes is one problem.
    fn refuse_symbol(&mut self, problems: &mut Problems) {
        let place = self.place();
        let Some(byte) = self.peek() else { return };
        let (what, remedy) = match byte {
            b'/' => (
                "block delete (/) is not honoured".into(),
                "take out the slash, or the whole line",
            ),
            b'#' | b'[' | b']' | b'=' => (
                "variables and expressions are not known".into(),
                "let the program that wrote this file put in the numbers",
            ),
            b'*' => (
                "checksums are not known".into(),
                "take out the * and the number behind it",
            ),
            b')' => (
                "a comment is closed that was not opened".into(),
                "open it with ( on the same line",
            ),
            b'0'..=b'9' | b'.' | b'+' | b'-' => (
                "a number stands without a letter".into(),
                "write the letter of the word in front of the number",
            ),
            b',' => (
                "a comma is not known".into(),
                "write decimals with a point: X10.5",
            ),
            0x20..=0x7E => (
                format!("'{}' is not known", char::from(byte)),
                "take it out, or put it in a comment ( )",
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
        // The rest of an expression is not worth a problem for each of its parts.
        if matches!(byte, b'#' | b'[' | b'=' | b'*') {
            self.step_while(|byte| byte != b'(' && byte != b';');
        }
    }
}
