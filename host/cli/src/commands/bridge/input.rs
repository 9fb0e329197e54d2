//! Bytes of a sender: lines, and the real-time commands between them.

use std::collections::VecDeque;

/// Length of a line at most, bytes.
const LONGEST_LINE: usize = 256;

/// Lines that wait at most. A sender that counts characters has far fewer under way.
const MAX_LINES: usize = 4096;

/// A real-time command: it is executed at once, also in the middle of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RealTime {
    /// `?`: report the status.
    Report,
    /// `!`, and the door (0x84): hold.
    Hold,
    /// `~`: resume.
    Resume,
    /// 0x18: stop, and drop everything.
    Reset,
    /// 0x85: end a jog.
    JogCancel,
    /// 0x90 to 0x94: feed override, as a change in percent; `None` sets 100 %.
    Feed(Option<i16>),
    /// 0x95 to 0x97: rapid override, percent.
    Rapid(u8),
    /// 0x99 to 0x9D: spindle override, as [`RealTime::Feed`].
    Spindle(Option<i16>),
    /// 0x9E, 0xA0, 0xA1: switches of spindle and coolant during a hold.
    Switch,
}

fn real_time(byte: u8) -> Option<RealTime> {
    Some(match byte {
        b'?' => RealTime::Report,
        b'!' | 0x84 => RealTime::Hold,
        b'~' => RealTime::Resume,
        0x18 => RealTime::Reset,
        0x85 => RealTime::JogCancel,
        0x90 => RealTime::Feed(None),
        0x91 => RealTime::Feed(Some(10)),
        0x92 => RealTime::Feed(Some(-10)),
        0x93 => RealTime::Feed(Some(1)),
        0x94 => RealTime::Feed(Some(-1)),
        0x95 => RealTime::Rapid(100),
        0x96 => RealTime::Rapid(50),
        0x97 => RealTime::Rapid(25),
        0x99 => RealTime::Spindle(None),
        0x9a => RealTime::Spindle(Some(10)),
        0x9b => RealTime::Spindle(Some(-10)),
        0x9c => RealTime::Spindle(Some(1)),
        0x9d => RealTime::Spindle(Some(-1)),
        0x9e | 0xa0 | 0xa1 => RealTime::Switch,
        _ => return None,
    })
}

/// A line, or why there is none.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Line {
    /// Its text, without comments of `;` and blanks at its ends.
    Text(String),
    /// It has more than 256 bytes, or bytes that are no ASCII.
    Bad(&'static str),
}

/// Divides the bytes of a sender.
#[derive(Debug, Default)]
pub(super) struct Input {
    line: Vec<u8>,
    is_too_long: bool,
    /// The last byte was a carriage return: a line feed after it ends no other line.
    after_return: bool,
    lines: VecDeque<Line>,
}

impl Input {
    /// Takes a byte; returns the real-time command that it is.
    pub(super) fn add(&mut self, byte: u8) -> Option<RealTime> {
        if let Some(command) = real_time(byte) {
            return Some(command);
        }
        let after_return = std::mem::replace(&mut self.after_return, byte == b'\r');
        match byte {
            b'\n' if after_return => {}
            b'\n' | b'\r' => self.end_line(),
            _ if self.line.len() == LONGEST_LINE => self.is_too_long = true,
            _ => self.line.push(byte),
        }
        None
    }

    fn end_line(&mut self) {
        let bytes = std::mem::take(&mut self.line);
        let is_too_long = std::mem::take(&mut self.is_too_long);
        // Beyond this the sender waits for no answer; its bytes are dropped as by a full buffer.
        if self.lines.len() == MAX_LINES {
            return;
        }
        self.lines.push_back(match String::from_utf8(bytes) {
            _ if is_too_long => Line::Bad("the line has more than 256 bytes; divide it"),
            Ok(text) if text.is_ascii() => Line::Text(text.trim().to_string()),
            _ => Line::Bad("the line has bytes that are no ASCII; leave them out"),
        });
    }

    /// The next line, which stays until [`Input::take`].
    pub(super) fn next(&self) -> Option<&Line> {
        self.lines.front()
    }

    /// Removes the next line.
    pub(super) fn take(&mut self) {
        self.lines.pop_front();
    }

    /// Drops everything.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> (Vec<RealTime>, Vec<Line>) {
        let mut input = Input::default();
        let commands = bytes.iter().filter_map(|byte| input.add(*byte)).collect();
        (commands, input.lines.into())
    }

    #[test]
    fn real_time_commands_come_out_of_the_middle_of_a_line() {
        let (commands, lines) = read(b"G1 X?1!0~\nG0\x18");
        let expected = [
            RealTime::Report,
            RealTime::Hold,
            RealTime::Resume,
            RealTime::Reset,
        ];
        assert_eq!(commands, expected);
        assert_eq!(lines, [Line::Text("G1 X10".into())]);
        let (commands, _) = read(&[0x85, 0x90, 0x92, 0x97, 0x9c, 0x84, 0xa0, 0xff]);
        let expected = [
            RealTime::JogCancel,
            RealTime::Feed(None),
            RealTime::Feed(Some(-10)),
            RealTime::Rapid(25),
            RealTime::Spindle(Some(1)),
            RealTime::Hold,
            RealTime::Switch,
        ];
        assert_eq!(commands, expected);
    }

    #[test]
    fn each_line_end_is_one_line() {
        let text = |text: &str| Line::Text(text.into());
        assert_eq!(
            read(b"a\nb\rc\r\n\n").1,
            [text("a"), text("b"), text("c"), text("")]
        );
        let long = [b'G'; LONGEST_LINE + 1];
        assert!(matches!(
            read(&[&long[..], b"\n"].concat()).1[..],
            [Line::Bad(_)]
        ));
        assert!(matches!(read(b"G1 X\xc3\xa4\n").1[..], [Line::Bad(_)]));
    }

    #[test]
    fn lines_are_bounded() {
        let (_, lines) = read(&vec![b'\n'; 2 * MAX_LINES]);
        assert_eq!(lines.len(), MAX_LINES);
    }
}
