//! `haptimill dnc`: a part program that comes over a serial line.

use super::run::{self, RunArgs};
use super::{CliError, Exit, output};
use crate::commands::interrupt;
use clap::{Args, ValueEnum};
use haptimill_client::port::{Flow, SerialTransport, Transport as _};
use haptimill_machine_file::input;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

const LONG: &str = "\
Receive a part program over a serial line (RS-232) and run it.

A CAM computer sends the program on the line of --line, 8 data bits, no parity, 1 stop bit. FILE \
keeps what was received. The program ends with the second %, with M2 or M30, or with Ctrl-D (EOT). \
It is received whole and checked before anything moves, then it runs as `haptimill run FILE` does, \
with the same options. These, the port and the folder of the results are checked before the line \
is read. A line that falls silent for --silence seconds in the middle of the program \
is an error that names the last block; nothing moves.";

/// Arguments of `haptimill dnc`.
#[derive(Debug, Clone, Args)]
#[command(about = "Receive a part program over a serial line and run it", long_about = LONG)]
pub struct DncArgs {
    /// Serial line of the CAM computer, by its path
    #[arg(long, value_name = "LINE")]
    pub line: String,
    /// Baud rate of the line
    #[arg(long, value_name = "N", default_value_t = 9600,
          value_parser = clap::value_parser!(u32).range(110..=4_000_000))]
    pub line_baud: u32,
    /// Flow control: xon (XON/XOFF), rts (RTS/CTS), none
    #[arg(long, value_name = "FLOW", default_value = "xon")]
    pub flow: FlowArg,
    /// Longest silence in the middle of the program
    #[arg(long, value_name = "SECONDS", default_value_t = 30.0, value_parser = super::args::seconds)]
    pub silence: f64,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub run: RunArgs,
}

/// Flow control on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum FlowArg {
    /// XON/XOFF.
    Xon,
    /// RTS/CTS.
    Rts,
    /// None.
    None,
}

impl From<FlowArg> for Flow {
    fn from(flow: FlowArg) -> Self {
        match flow {
            FlowArg::Xon => Self::XonXoff,
            FlowArg::Rts => Self::RtsCts,
            FlowArg::None => Self::None,
        }
    }
}

/// Longest wait for bytes between two looks at Ctrl-C.
const POLL: Duration = Duration::from_millis(50);

/// Receives a program and runs it.
///
/// # Errors
/// See [`Exit`]: the line fails or falls silent, or as `haptimill run`.
pub fn run(args: DncArgs) -> Result<(), CliError> {
    // A mistake of the command line must not end the command behind a long reception, when FILE
    // is replaced.
    run::check_before_program(&args.run)?;
    output::check_writable(&args.run.program)?;
    let mut line = SerialTransport::open_with_flow(&args.line, args.line_baud, args.flow.into())?;
    let interrupted = interrupt::flag();
    let mut program = Received::default();
    let mut buffer = [0; 4096];
    let mut last_byte = Instant::now();
    if !args.run.json && !args.run.quiet {
        print_line!("receiving on {}; Ctrl-C stops", args.line);
    }
    while !program.is_complete() {
        if interrupted.load(Ordering::Relaxed) {
            let what = "stopped by the user before the program was complete; nothing moved";
            return Err(CliError::new(Exit::Stopped, what));
        }
        let count = match line.read(&mut buffer, POLL) {
            Ok(count) => count,
            Err(error) => return Err(program.cut(&args.line, &error.to_string())),
        };
        if count > 0 {
            last_byte = Instant::now();
            program.add(&buffer[..count]);
            if program.text.len() as u64 > input::PROGRAM_BYTES {
                let what = format!("more than {} bytes", input::PROGRAM_BYTES);
                return Err(program.cut(&args.line, &what));
            }
        } else if program.has_begun() && last_byte.elapsed().as_secs_f64() > args.silence {
            let what = format!("nothing was received for {} s", args.silence);
            return Err(program.cut(&args.line, &what));
        }
    }
    let file = &args.run.program;
    output::save(file, &program.text)?;
    if !args.run.json && !args.run.quiet {
        let lines = haptimill_report::count(program.lines as usize, "line");
        print_line!("{}: {lines} received", file.display());
    }
    run::run(args.run)
}

/// A program that is being received.
#[derive(Debug, Default)]
struct Received {
    text: Vec<u8>,
    /// Complete lines.
    lines: u32,
    /// Start of the line that is not complete yet.
    start: usize,
    /// The last complete line that is a block.
    last_block: String,
    /// A tape mark was received before the first block.
    is_open: bool,
    has_block: bool,
    ended: bool,
}

impl Received {
    /// Adds bytes. Those after the end of the program are dropped.
    fn add(&mut self, bytes: &[u8]) {
        for byte in bytes {
            match byte {
                _ if self.ended => return,
                // Leader, trailer and flow characters of tapes and old senders.
                0 | 0x11..=0x14 | 0x7f => continue,
                // EOT.
                4 => {
                    self.end_line();
                    self.ended = self.has_block;
                    continue;
                }
                _ => self.text.push(*byte),
            }
            if matches!(byte, b'\n' | b'\r') {
                self.end_line();
            }
        }
    }

    fn end_line(&mut self) {
        let line = String::from_utf8_lossy(&self.text[self.start..]).into_owned();
        let is_line_feed_of_return =
            line == "\n" && self.start > 0 && self.text.get(self.start - 1) == Some(&b'\r');
        self.start = self.text.len();
        if is_line_feed_of_return {
            return;
        }
        self.lines += 1;
        let block = without_comments(&line);
        if block.contains('%') {
            if self.has_block || self.is_open {
                self.ended = true;
            }
            self.is_open = true;
        } else if !block.is_empty() {
            self.has_block = true;
            self.last_block = line.trim().to_string();
            self.ended = ends_program(&block) && !self.is_open;
        }
    }

    const fn is_complete(&self) -> bool {
        self.ended
    }

    const fn has_begun(&self) -> bool {
        !self.text.is_empty()
    }

    /// The error of a program that ended before its end.
    fn cut(&self, line: &str, why: &str) -> CliError {
        let last = if self.last_block.is_empty() {
            "no block was received".to_string()
        } else {
            format!(
                "the last block was line {}, {}",
                self.lines, self.last_block
            )
        };
        let what = format!(
            "{line}: the program ended before its end: {why}; {last}; nothing moved. Check the \
             cable, and that both ends have the same baud rate and flow control"
        );
        CliError::new(Exit::Port, what)
    }
}

/// The words of a line in upper case, without comments and blanks.
fn without_comments(line: &str) -> String {
    let mut words = String::new();
    let mut is_comment = false;
    for letter in line.chars() {
        match letter {
            ';' if !is_comment => break,
            '(' => is_comment = true,
            ')' => is_comment = false,
            _ if is_comment || letter.is_whitespace() => {}
            _ => words.extend(letter.to_uppercase()),
        }
    }
    words
}

/// Whether a block has M2 or M30.
fn ends_program(block: &str) -> bool {
    block.match_indices('M').any(|(at, _)| {
        let digits: String = block[at + 1..]
            .chars()
            .take_while(|letter| letter.is_ascii_digit() || *letter == '.')
            .collect();
        matches!(digits.parse::<f64>(), Ok(number) if number == 2.0 || number == 30.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn received(text: &str) -> Received {
        let mut program = Received::default();
        // One byte at a time: the parts of a line arrive at any time.
        for byte in text.as_bytes() {
            program.add(std::slice::from_ref(byte));
        }
        program
    }

    #[test]
    fn the_end_of_a_program_is_recognised() {
        for (text, complete) in [
            ("G0 X1\nM30\n", true),
            ("G0 X1\r\nM2\r\n", true),
            ("G0 X1\rM02\r", true),
            ("G0 X1\nM30", false),
            ("%\nG0 X1\nM30\n", false),
            ("%\nG0 X1\nM30\n%\n", true),
            ("\0\0%\r\nG0 X1\r\n%\r\n\0", true),
            ("G0 X1 (M30)\n; M30\n", false),
            ("M3 S200\nM300\n", false),
            ("G0 X1\n\u{4}", true),
            ("", false),
            ("%\n", false),
        ] {
            assert_eq!(received(text).is_complete(), complete, "{text:?}");
        }
        let program = received("\0%\r\nG0 X1\r\nM30\r\n%\r\nG0 X9\r\n");
        assert_eq!(program.text, b"%\r\nG0 X1\r\nM30\r\n%\r");
        assert_eq!(program.lines, 4);
    }

    #[test]
    fn a_cut_names_the_last_block() {
        let error = received("G0 X1\nG1 X2 F100\nG1 X").cut("line", "silence");
        assert!(error.message.contains("line 2, G1 X2 F100;"), "{error}");
        let error = received("").cut("line", "silence");
        assert!(error.message.contains("no block"), "{error}");
    }
}
