//! Group codes and values of a DXF file.

use crate::drawing::Problem;
use std::borrow::Cow;

/// The remedy of a file that is none.
pub const DAMAGED: &str = "the file is damaged; save the drawing again as ASCII DXF";

/// A group code with its value.
#[derive(Debug, Clone, Copy)]
pub struct Pair<'a> {
    pub code: i32,
    pub value: &'a [u8],
    pub line: usize,
}

impl<'a> Pair<'a> {
    /// The value as text.
    pub fn text(&self) -> Cow<'a, str> {
        String::from_utf8_lossy(self.value)
    }

    pub fn word(&self) -> &'a str {
        std::str::from_utf8(self.value).unwrap_or("?").trim()
    }
}

/// Reads pairs; the latest one can be put back.
pub struct Pairs<'a> {
    bytes: &'a [u8],
    /// Line of the latest value, from 1.
    pub line: usize,
    /// A pair that is read again.
    pub back: Option<Pair<'a>>,
    /// The group 0 of the present record, and its handle.
    record: Option<Pair<'a>>,
    handle: Option<Pair<'a>>,
}

impl<'a> Pairs<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self {
            bytes,
            line: 0,
            back: None,
            record: None,
            handle: None,
        }
    }

    fn next_line(&mut self) -> Option<&'a [u8]> {
        if self.bytes.is_empty() {
            return None;
        }
        let end = self
            .bytes
            .iter()
            .position(|&byte| byte == b'\n' || byte == b'\r');
        let (line, rest) = match end {
            None => (self.bytes, &[][..]),
            Some(end) if self.bytes[end..].starts_with(b"\r\n") => {
                (&self.bytes[..end], &self.bytes[end + 2..])
            }
            Some(end) => (&self.bytes[..end], &self.bytes[end + 1..]),
        };
        self.bytes = rest;
        self.line += 1;
        Some(line)
    }

    /// The next pair that is no comment.
    pub fn next(&mut self) -> Result<Option<Pair<'a>>, Problem> {
        if let Some(pair) = self.back.take() {
            return Ok(Some(pair));
        }
        loop {
            match self.pair()? {
                Some(pair) if pair.code == 999 => {}
                other => return Ok(other),
            }
        }
    }

    fn pair(&mut self) -> Result<Option<Pair<'a>>, Problem> {
        let Some(code) = self.next_line() else {
            return Ok(None);
        };
        let line = self.line;
        let word = code.trim_ascii();
        if word.is_empty() && self.bytes.trim_ascii().is_empty() {
            return Ok(None);
        }
        let code = std::str::from_utf8(word)
            .ok()
            .and_then(|word| word.parse::<i32>().ok());
        let Some(code) = code.filter(|code| (-5..=1071).contains(code)) else {
            let shown: String = String::from_utf8_lossy(word).chars().take(40).collect();
            let place = self.place();
            let what = format!("'{shown}' is not a group code of a DXF file{place}");
            return Err(Problem::at_line(line, what, DAMAGED));
        };
        let Some(value) = self.next_line() else {
            let place = self.place();
            let what = format!("the file ends after group code {code}{place}");
            return Err(Problem::at_line(line, what, DAMAGED));
        };
        let pair = Pair { code, value, line };
        match code {
            0 => (self.record, self.handle) = (Some(pair), None),
            5 if self.handle.is_none() => self.handle = Some(pair),
            _ => {}
        }
        Ok(Some(pair))
    }

    /// The present record, for a message.
    fn place(&self) -> String {
        let Some(record) = self.record else {
            return String::new();
        };
        let handle = self.handle.map(|pair| format!(" handle {}", pair.word()));
        let handle = handle.unwrap_or_default();
        // The group code is the line before its value.
        format!(", in {}{handle} of line {}", record.word(), record.line)
    }

    /// The pairs up to the next group code 0, without those of embedded objects: these repeat
    /// group codes of the entity with other meanings.
    pub fn rest_of_record(&mut self, pairs: &mut Vec<Pair<'a>>) -> Result<(), Problem> {
        pairs.clear();
        let mut embedded = false;
        while let Some(pair) = self.next()? {
            if pair.code == 0 {
                self.back = Some(pair);
                break;
            }
            embedded |= pair.code == 101;
            if !embedded {
                pairs.push(pair);
            }
        }
        Ok(())
    }
}
