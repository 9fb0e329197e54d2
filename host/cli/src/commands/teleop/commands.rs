//! Operator commands from standard input.

use haptimill_teleop::CommandInput;
use std::io::{BufRead, Read};
use std::sync::mpsc::{self, Receiver, SyncSender};

/// Longest line, bytes.
const LONGEST_LINE: u64 = 256;

/// Commands that wait for the session at most; more wait in the input.
const WAITING: usize = 16;

/// Reads operator commands from standard input, one per line, until its end.
pub(super) fn listen() -> Receiver<CommandInput> {
    let (sender, receiver) = mpsc::sync_channel(WAITING);
    std::thread::spawn(move || read_commands(std::io::stdin().lock(), &sender));
    receiver
}

/// Reads commands from lines. A line that is not UTF-8 text is reported as no command; reading
/// continues with the next line. A line that is too long ends the reading: the input is no list of
/// commands.
fn read_commands(mut input: impl BufRead, sender: &SyncSender<CommandInput>) {
    let mut line = Vec::new();
    loop {
        line.clear();
        let mut bounded = Read::take(&mut input, LONGEST_LINE + 1);
        let result = match bounded.read_until(b'\n', &mut line) {
            Ok(0) => return,
            Ok(_) if line.len() as u64 > LONGEST_LINE => {
                CommandInput::Lost(format!("a line of more than {LONGEST_LINE} bytes"))
            }
            Ok(_) => match String::from_utf8_lossy(&line) {
                line if line.trim().is_empty() => continue,
                line => line
                    .parse()
                    .map_or_else(CommandInput::Invalid, CommandInput::Command),
            },
            Err(error) => CommandInput::Lost(error.to_string()),
        };
        let is_last = matches!(result, CommandInput::Lost(_));
        if sender.send(result).is_err() || is_last {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptimill_teleop::OperatorCommand;
    use std::io::{self, BufReader};

    /// An input that fails after its lines.
    struct Breaks(&'static [u8]);

    impl Read for Breaks {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            if self.0.is_empty() {
                return Err(io::Error::other("broken"));
            }
            self.0.read(buffer)
        }
    }

    fn read(input: impl Read) -> Vec<CommandInput> {
        let (sender, receiver) = mpsc::sync_channel(WAITING);
        read_commands(BufReader::new(input), &sender);
        drop(sender);
        receiver.iter().collect()
    }

    #[test]
    fn a_line_that_is_not_text_is_reported_and_the_next_line_is_read() {
        let all = read(&b"hold\r\n\n r\xe9sume\n\xff\nstop\nend"[..]);
        assert_eq!(all.len(), 5, "{all:?}");
        assert_eq!(all[0], CommandInput::Command(OperatorCommand::Hold));
        assert!(
            matches!(&all[1], CommandInput::Invalid(why) if why.contains("is no command; write hold"))
        );
        assert!(matches!(&all[2], CommandInput::Invalid(_)));
        assert_eq!(
            all[3..],
            [
                CommandInput::Command(OperatorCommand::Stop),
                CommandInput::Command(OperatorCommand::End)
            ]
        );
    }

    #[test]
    fn a_failing_input_is_reported_and_the_end_of_input_is_not() {
        assert_eq!(
            read(Breaks(b"hold\n")),
            [
                CommandInput::Command(OperatorCommand::Hold),
                CommandInput::Lost("broken".to_string())
            ]
        );
        assert_eq!(
            read(&b"hold\n"[..]),
            [CommandInput::Command(OperatorCommand::Hold)]
        );
    }

    /// `/dev/zero`, and a file without line ends.
    #[test]
    fn a_line_without_an_end_is_given_up() {
        let lost = CommandInput::Lost("a line of more than 256 bytes".to_string());
        assert_eq!(read(io::repeat(0)), std::slice::from_ref(&lost));
        let all = read([&b"hold\n"[..], &[b'x'; 5000]].concat().as_slice());
        assert_eq!(all, [CommandInput::Command(OperatorCommand::Hold), lost]);
        let longest = [&[b' '; 251][..], b"hold\n"].concat();
        assert_eq!(
            read(&longest[..]),
            [CommandInput::Command(OperatorCommand::Hold)]
        );
    }
}
