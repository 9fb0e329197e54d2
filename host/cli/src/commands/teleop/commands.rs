//! Operator commands from standard input.

use haptimill_teleop::CommandInput;
use std::io::BufRead;
use std::sync::mpsc::{self, Receiver, Sender};

/// Reads operator commands from standard input, one per line, until its end.
pub(super) fn listen() -> Receiver<CommandInput> {
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || read_commands(std::io::stdin().lock(), &sender));
    receiver
}

/// Reads commands from lines. A line that is not UTF-8 text is reported as no command; reading
/// continues with the next line.
fn read_commands(input: impl BufRead, sender: &Sender<CommandInput>) {
    for line in input.split(b'\n') {
        let result = match &line {
            Ok(line) => match String::from_utf8_lossy(line) {
                line if line.trim().is_empty() => continue,
                line => line
                    .parse()
                    .map_or_else(CommandInput::Invalid, CommandInput::Command),
            },
            Err(error) => CommandInput::Lost(error.to_string()),
        };
        if sender.send(result).is_err() || line.is_err() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptimill_teleop::OperatorCommand;
    use std::io::{self, BufReader, Read};

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
        let (sender, receiver) = mpsc::channel();
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
}
