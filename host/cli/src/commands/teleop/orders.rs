//! Orders from standard input.

use haptimill_teleop::OrderInput;
use std::io::BufRead;
use std::sync::mpsc::{self, Receiver, Sender};

/// Orders from lines of standard input; nothing comes any more at its end.
pub(super) fn listen() -> Receiver<OrderInput> {
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || hear(std::io::stdin().lock(), &sender));
    receiver
}

/// Orders from lines. Bytes that are no text make a line that is no order, and the next line is heard all the same.
fn hear(input: impl BufRead, sender: &Sender<OrderInput>) {
    for line in input.split(b'\n') {
        let heard = match &line {
            Ok(line) => match String::from_utf8_lossy(line) {
                line if line.trim().is_empty() => continue,
                line => line
                    .parse()
                    .map_or_else(OrderInput::Invalid, OrderInput::Order),
            },
            Err(error) => OrderInput::Lost(error.to_string()),
        };
        if sender.send(heard).is_err() || line.is_err() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptimill_teleop::Order;
    use std::io::{self, BufReader, Read};

    /// Gives lines, then fails.
    struct Breaks(&'static [u8]);

    impl Read for Breaks {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            if self.0.is_empty() {
                return Err(io::Error::other("broken"));
            }
            self.0.read(buffer)
        }
    }

    fn heard(input: impl Read) -> Vec<OrderInput> {
        let (sender, receiver) = mpsc::channel();
        hear(BufReader::new(input), &sender);
        drop(sender);
        receiver.iter().collect()
    }

    #[test]
    fn a_line_that_is_no_text_is_no_order_and_the_next_is_heard() {
        let all = heard(&b"hold\r\n\n r\xe9sume\n\xff\nstop\nend"[..]);
        assert_eq!(all.len(), 5, "{all:?}");
        assert_eq!(all[0], OrderInput::Order(Order::Hold));
        assert!(
            matches!(&all[1], OrderInput::Invalid(why) if why.contains("is no order; write hold"))
        );
        assert!(matches!(&all[2], OrderInput::Invalid(_)));
        assert_eq!(
            all[3..],
            [
                OrderInput::Order(Order::Stop),
                OrderInput::Order(Order::End)
            ]
        );
    }

    #[test]
    fn an_input_that_breaks_is_told_and_one_that_ends_is_not() {
        assert_eq!(
            heard(Breaks(b"hold\n")),
            [
                OrderInput::Order(Order::Hold),
                OrderInput::Lost("broken".to_string())
            ]
        );
        assert_eq!(heard(&b"hold\n"[..]), [OrderInput::Order(Order::Hold)]);
    }
}
