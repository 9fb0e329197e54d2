//! Source: the lines of a program, read through a window of bounded size.
//!
//! Loops and subroutines go back to earlier lines, so that a source can seek. Its memory does not
//! depend on the length of the file.

use std::io::{self, Read, Seek, SeekFrom};

/// Longest line, bytes.
pub const LONGEST_LINE: usize = 65_536;

/// Bytes read at once.
const CHUNK: usize = 65_536;

/// A stream of bytes that can go back.
pub trait ProgramBytes: Read + Seek + Send {}

impl<T: Read + Seek + Send> ProgramBytes for T {}

/// Position between two lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Mark {
    /// Byte offset of the next line.
    pub offset: u64,
    /// Number of the lines before it.
    pub line: u32,
}

/// Result of reading a line.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Fetched {
    /// The line is in the buffer.
    Line,
    /// The line is longer than [`LONGEST_LINE`]; its beginning is in the buffer.
    TooLong,
    /// The stream begins with text of two bytes per character.
    Utf16,
    /// No further line.
    End,
}

/// Lines of a program.
pub(crate) struct Source<'a> {
    bytes: Box<dyn ProgramBytes + 'a>,
    window: Vec<u8>,
    /// Next byte of the window.
    at: usize,
    /// Bytes of the stream before the window.
    before: u64,
    /// Lines before the next one.
    pub line: u32,
    /// Whether the last line ended without a line end: nothing follows.
    ended: bool,
}

impl<'a> Source<'a> {
    pub(crate) fn new(bytes: Box<dyn ProgramBytes + 'a>) -> Self {
        Self {
            bytes,
            window: Vec::new(),
            at: 0,
            before: 0,
            line: 0,
            ended: false,
        }
    }

    /// Returns the position of the next line.
    pub(crate) fn mark(&self) -> Mark {
        Mark {
            offset: self.before + self.at as u64,
            line: self.line,
        }
    }

    /// Goes to a position that [`Source::mark`] returned.
    pub(crate) fn seek(&mut self, mark: Mark) -> io::Result<()> {
        let end = self.before + self.window.len() as u64;
        if (self.before..=end).contains(&mark.offset) {
            self.at = (mark.offset - self.before) as usize;
        } else {
            self.bytes.seek(SeekFrom::Start(mark.offset))?;
            self.window.clear();
            self.at = 0;
            self.before = mark.offset;
        }
        self.line = mark.line;
        self.ended = false;
        Ok(())
    }

    /// Reads more bytes; false at the end of the stream.
    fn fill(&mut self) -> io::Result<bool> {
        if self.at > 0 {
            self.window.drain(..self.at);
            self.before += self.at as u64;
            self.at = 0;
        }
        let old = self.window.len();
        self.window.resize(old + CHUNK, 0);
        loop {
            match self.bytes.read(&mut self.window[old..]) {
                Ok(count) => {
                    self.window.truncate(old + count);
                    return Ok(count > 0);
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => {
                    self.window.truncate(old);
                    return Err(error);
                }
            }
        }
    }

    /// Reads the next line into `line`, without its end: LF, CR LF or CR. A UTF-8 byte order mark
    /// at the start of the stream is skipped.
    pub(crate) fn next(&mut self, line: &mut Vec<u8>) -> io::Result<Fetched> {
        line.clear();
        if self.ended {
            return Ok(Fetched::End);
        }
        if self.before == 0 && self.at == 0 {
            while self.window.len() < 3 && self.fill()? {}
            match self.window[..] {
                [0xEF, 0xBB, 0xBF, ..] => self.at = 3,
                // With the mark of the byte order, or from characters of ASCII.
                [0xFF, 0xFE, ..]
                | [0xFE, 0xFF, ..]
                | [1..=255, 0, 1..=255, ..]
                | [0, 1..=255, 0, ..] => {
                    self.line = self.line.saturating_add(1);
                    return Ok(Fetched::Utf16);
                }
                _ => {}
            }
        }
        let mut too_long = false;
        let mut searched = 0;
        loop {
            let rest = &self.window[self.at..];
            let end = rest[searched..]
                .iter()
                .position(|&byte| byte == b'\n' || byte == b'\r');
            let Some(end) = end else {
                if rest.len() >= LONGEST_LINE {
                    if !too_long {
                        line.extend_from_slice(&rest[..200]);
                    }
                    too_long = true;
                    self.at = self.window.len();
                    searched = 0;
                } else {
                    searched = rest.len();
                }
                if self.fill()? {
                    continue;
                }
                if !too_long {
                    line.extend_from_slice(&self.window[self.at..]);
                }
                self.at = self.window.len();
                self.ended = true;
                break;
            };
            let end = searched + end;
            let is_return = rest[end] == b'\r';
            if !too_long {
                line.extend_from_slice(&rest[..end]);
            }
            // The LF of a CR LF may be in the next chunk.
            if is_return && self.at + end + 1 == self.window.len() {
                self.at += end;
                self.fill()?;
                self.at += 1;
            } else {
                self.at += end + 1;
            }
            if is_return && self.window.get(self.at) == Some(&b'\n') {
                self.at += 1;
            }
            break;
        }
        self.line = self.line.saturating_add(1);
        Ok(if too_long || line.len() > LONGEST_LINE {
            line.truncate(200);
            Fetched::TooLong
        } else {
            Fetched::Line
        })
    }
}
