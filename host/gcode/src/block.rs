//! Blocks: the words, codes, assignments and comments of a line.

use super::codes::{Code, Codes, Group, g_group, g_remedy, m_group, m_remedy, tenths};
use super::expression::{LARGEST_NUMBER, Parameter, Read, Scan, Values, text_of};
use super::problem::{Cause, Mistake};
use super::symbols::{refuse_odd_character, refuse_statement, refuse_symbol};

/// How the number of a word is written.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) enum Written {
    /// Digits without a decimal point.
    #[default]
    Whole,
    /// Digits with a decimal point.
    Point,
    /// A parameter or an expression.
    Value,
}

impl Written {
    fn of(number: &[u8]) -> Self {
        if number.iter().any(|byte| matches!(byte, b'#' | b'[')) {
            Self::Value
        } else if number.contains(&b'.') {
            Self::Point
        } else {
            Self::Whole
        }
    }
}

/// A word that is no code: its number and its place in the line.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Word {
    pub value: f64,
    pub at: usize,
    pub end: usize,
    pub written: Written,
}

/// A comment: the place of its mark, and its text between the marks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct CommentSpan {
    pub at: usize,
    pub from: usize,
    pub to: usize,
}

/// Words of a block.
#[derive(Debug, Default)]
pub(crate) struct Block {
    words: [Word; 26],
    /// Bit k is set if letter k (A is 0) has a word.
    present: u32,
    /// Distance from the origin (`@`) and angle (`^`) of polar coordinates; X and Y then have words
    /// without a value.
    polar: [Option<Word>; 2],
    pub codes: Codes,
    pub assignments: Vec<(Parameter, f64)>,
    pub comments: Vec<CommentSpan>,
    /// Place of the first word, code or assignment.
    pub first: Option<usize>,
    /// Place of the last `%`.
    pub percent: Option<usize>,
    /// Place of the O of a block that begins with one, and of the byte after it.
    pub o_word: Option<usize>,
    /// Whether it has a number (N).
    numbered: bool,
    /// Whether the block begins with a slash.
    pub optional: bool,
}

const fn bit(letter: u8) -> u32 {
    1 << (letter - b'A')
}

/// Returns the bits of letters.
pub(crate) const fn letters(text: &[u8]) -> u32 {
    let (mut bits, mut index) = (0, 0);
    while index < text.len() {
        bits |= bit(text[index]);
        index += 1;
    }
    bits
}

/// Letters of axes, in the order of the offsets.
pub(crate) const AXES: [u8; 9] = *b"XYZABCUVW";

/// Bits of the axis letters.
pub(crate) const AXIS_LETTERS: u32 = letters(&AXES);

impl Block {
    fn clear(&mut self) {
        self.present = 0;
        self.polar = [None; 2];
        self.codes = Codes::default();
        self.assignments.clear();
        self.comments.clear();
        self.first = None;
        self.percent = None;
        self.o_word = None;
        self.numbered = false;
        self.optional = false;
    }

    /// Returns the word of a letter in upper case.
    pub(crate) fn word(&self, letter: u8) -> Option<Word> {
        (self.present & bit(letter) != 0).then(|| self.words[usize::from(letter - b'A')])
    }

    /// Returns the value of a letter.
    pub(crate) fn value(&self, letter: u8) -> Option<f64> {
        self.word(letter).map(|word| word.value)
    }

    /// Returns the values of the polar words, distance and angle; `None` without any.
    pub(crate) fn polar(&self) -> Option<[Option<f64>; 2]> {
        let polar = self.polar.map(|word| word.map(|word| word.value));
        (polar != [None; 2]).then_some(polar)
    }

    /// Returns the code to which the axis words belong, unless they are an end point.
    pub(crate) fn axis_code(&self) -> Option<Code> {
        let once = self.codes.get(Group::Once);
        let once = once.filter(|code| matches!(code.tenths, 100 | 280 | 300 | 520 | 920));
        once.or_else(|| {
            let length = self.codes.get(Group::ToolLength)?;
            let takes = match length.tenths {
                431 => true,
                432 => self.has_any(AXIS_LETTERS),
                _ => false,
            };
            takes.then_some(length)
        })
    }

    /// Multiplies the number of a word.
    pub(crate) fn scale(&mut self, letter: u8, factor: f64) {
        self.words[usize::from(letter - b'A')].value *= factor;
    }

    /// Whether one of some letters has a word.
    pub(crate) fn has_any(&self, letters: u32) -> bool {
        self.present & letters != 0
    }

    /// Returns the first word of some letters.
    pub(crate) fn first_of(&self, letters: u32) -> Option<(u8, Word)> {
        let mut found: Option<(u8, Word)> = None;
        let mut bits = self.present & letters;
        while bits != 0 {
            let letter = b'A' + bits.trailing_zeros() as u8;
            bits &= bits - 1;
            let word = self.words[usize::from(letter - b'A')];
            if found.is_none_or(|(_, first)| word.at < first.at) {
                found = Some((letter, word));
            }
        }
        found
    }

    /// Reads a line.
    ///
    /// # Errors
    ///
    /// Returns its first mistake. The comments before it are in the block.
    pub(crate) fn read(&mut self, line: &[u8], values: &dyn Values) -> Read<()> {
        self.clear();
        let mut scan = Scan::new(line, 0, values);
        loop {
            let start = scan.at;
            let Some(byte) = scan.peek() else {
                return Ok(());
            };
            match byte {
                b' ' | b'\t' => scan.at += 1,
                b'%' => {
                    scan.at += 1;
                    self.percent = Some(start);
                }
                b';' => {
                    self.comments.push(CommentSpan {
                        at: start,
                        from: start + 1,
                        to: line.len(),
                    });
                    return Ok(());
                }
                b'(' => self.comment(&mut scan)?,
                b'/' if self.first.is_none() && !self.optional => {
                    scan.at += 1;
                    self.optional = true;
                }
                b'#' => {
                    self.first.get_or_insert(start);
                    self.assignment(&mut scan)?;
                }
                b'O' | b'o' if self.first.is_none() => {
                    self.first = Some(start);
                    self.o_word = Some(start);
                    return Ok(());
                }
                _ if byte.is_ascii_alphabetic() => {
                    let letter = byte.to_ascii_uppercase();
                    if letter != b'N' {
                        self.first.get_or_insert(start);
                    }
                    self.letter(&mut scan, letter)?;
                    self.numbered |= letter == b'N';
                }
                b'@' | b'^' => {
                    self.first.get_or_insert(start);
                    self.polar_word(&mut scan)?;
                }
                _ => return Err(Box::new(refuse_symbol(line, start))),
            }
        }
    }

    fn comment(&mut self, scan: &mut Scan) -> Read<()> {
        let at = scan.at;
        let from = at + 1;
        let end = scan.bytes[from..]
            .iter()
            .position(|&byte| byte == b')' || byte == b'(');
        match end {
            Some(end) if scan.bytes[from + end] == b')' => {
                self.comments.push(CommentSpan {
                    at,
                    from,
                    to: from + end,
                });
                scan.at = from + end + 1;
                Ok(())
            }
            Some(_) => Err(Box::new(Mistake::new(
                at,
                "a comment is opened inside a comment",
                "use ( ) without another ( inside, or ; to the end of the line",
            ))),
            None => {
                let found = Mistake::new(
                    at,
                    "the comment is not closed",
                    "close it with ) on the same line, or open it with ;",
                );
                Err(Box::new(found.because(Cause::Comment)))
            }
        }
    }

    fn assignment(&mut self, scan: &mut Scan) -> Read<()> {
        let start = scan.at;
        let parameter = scan.parameter()?;
        scan.skip_blanks();
        if scan.peek() != Some(b'=') {
            return Err(Box::new(Mistake::new(
                start,
                format!("the parameter {} is not used", scan.text(start)),
                "assign a value (#1=2), or write the letter that uses it (X#1)",
            )));
        }
        scan.at += 1;
        let value = scan.value()?;
        self.assignments.push((parameter, value));
        Ok(())
    }

    fn polar_word(&mut self, scan: &mut Scan) -> Read<()> {
        let start = scan.at;
        let sign = scan.bytes[start];
        scan.at += 1;
        scan.skip_blanks();
        let mistake = |what: String, remedy| Err(Box::new(Mistake::new(start, what, remedy)));
        if !scan.has_value() {
            let what = format!("'{}' has no number", char::from(sign));
            return mistake(what, "write the distance after @ and the angle after ^");
        }
        let value = scan.value()?;
        let text = || text_of(&scan.bytes[start..scan.at]);
        if value.abs() > LARGEST_NUMBER {
            let what = format!("the number of {} is too large", text());
            return mistake(what, "write at most 10,000,000");
        }
        let axes = bit(b'X') | bit(b'Y');
        if self.polar == [None; 2] && self.present & axes != 0 {
            let what = format!("{} together with X or Y", text());
            return mistake(what, "write the end point with @ and ^, or with X and Y");
        }
        let place = &mut self.polar[usize::from(sign == b'^')];
        if place.is_some() {
            let what = format!("'{}' occurs twice in one block", char::from(sign));
            return mistake(what, "keep one");
        }
        let word = Word {
            value,
            at: start,
            end: scan.at,
            written: Written::Whole,
        };
        *place = Some(word);
        if self.present & axes == 0 {
            self.present |= axes;
            for letter in *b"XY" {
                self.words[usize::from(letter - b'A')] = Word { value: 0.0, ..word };
            }
        }
        Ok(())
    }

    fn letter(&mut self, scan: &mut Scan, letter: u8) -> Read<()> {
        let start = scan.at;
        scan.at += 1;
        scan.skip_blanks();
        if !scan.has_value() {
            if let Some(refused) = refuse_odd_character(scan.bytes, scan.at) {
                return Err(Box::new(refused));
            }
            if let Some(refused) = refuse_statement(scan.bytes, start) {
                return Err(Box::new(refused));
            }
            let what = format!("the letter {} has no number", char::from(letter));
            let remedy = "write a number after the letter, or put a remark in ( )";
            return Err(Box::new(Mistake::new(start, what, remedy)));
        }
        let number = scan.at;
        let value = scan.value()?;
        let end = scan.at;
        let text = || text_of(&scan.bytes[start..end]);
        // A feed that no machine has means: as fast as the limits allow. Long programs number their
        // blocks by tens.
        let largest = match letter {
            b'F' | b'N' => 1e12,
            _ => LARGEST_NUMBER,
        };
        if value.abs() > largest {
            return Err(Box::new(Mistake::new(
                start,
                format!("the number of {} is too large", text()),
                "write at most 10,000,000",
            )));
        }
        let code = |tenths| Code {
            tenths,
            at: start,
            end,
        };
        match letter {
            b'G' => {
                let found = tenths(value).and_then(|number| Some((number, g_group(number)?)));
                let Some((number, group)) = found else {
                    return Err(Box::new(Mistake::new(
                        start,
                        format!("{} is not supported", text()),
                        tenths(value).map_or("remove it if the part does not need it", g_remedy),
                    )));
                };
                self.codes.enter(group, code(number), scan.bytes)
            }
            b'M' => {
                let whole = (value.fract() == 0.0 && value >= 0.0).then_some(value as u16);
                let Some((number, group)) =
                    whole.and_then(|number| Some((number, m_group(number)?)))
                else {
                    return Err(Box::new(Mistake::new(
                        start,
                        format!("{} is not supported", text()),
                        whole.map_or("remove it if the part does not need it", m_remedy),
                    )));
                };
                self.codes.enter(group, code(number * 10), scan.bytes)
            }
            b'N' => {
                if self.first.is_some() {
                    return Err(Box::new(Mistake::new(
                        start,
                        "a block number inside a block",
                        "write N at the start of the line",
                    )));
                }
                if self.numbered {
                    return Err(Box::new(Mistake::new(
                        start,
                        "two block numbers in a block",
                        "remove one",
                    )));
                }
                if value < 0.0 {
                    return Err(Box::new(Mistake::new(
                        start,
                        format!("{} is not a block number", text()),
                        "write a number from 0, or remove it",
                    )));
                }
                Ok(())
            }
            b'O' => Err(Box::new(Mistake::new(
                start,
                format!("program number {} is not alone in its block", text()),
                "write O at the start of a line",
            ))),
            b'X' | b'Y' if self.polar != [None; 2] => Err(Box::new(Mistake::new(
                start,
                format!("{} together with polar coordinates", text()),
                "write the end point with @ and ^, or with X and Y",
            ))),
            _ => {
                if self.present & bit(letter) != 0 {
                    let what = format!(
                        "the letter {} occurs twice in one block",
                        char::from(letter)
                    );
                    return Err(Box::new(Mistake::new(start, what, "keep one")));
                }
                self.present |= bit(letter);
                self.words[usize::from(letter - b'A')] = Word {
                    value,
                    at: start,
                    end,
                    written: Written::of(&scan.bytes[number..end]),
                };
                Ok(())
            }
        }
    }
}
