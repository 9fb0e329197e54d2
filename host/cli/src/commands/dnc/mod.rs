//! `haptimill dnc`: a part program that comes over a serial line.

mod receiver;

use super::run::{self, RunArgs};
use super::{CliError, Exit, output};
use crate::commands::interrupt;
use clap::{Args, ValueEnum};
use haptimill_client::port::Flow;
use haptimill_machine_file::input;
use receiver::Receiver;
use std::fs::File;
use std::io::{self, Read, Write as _};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

const LONG: &str = "\
Receive a part program over a serial line (RS-232) and run it.

A CAM computer sends the program on the line of --line, 8 data bits, no parity, 1 stop bit. FILE \
keeps what was received. The program ends with the second %, with M2 or M30, or with Ctrl-D (EOT). \
It is received whole and checked before anything moves, then it runs as `haptimill run FILE` does, \
with the same options. Options, port and results folder are checked before the line is read. A \
pause of --silence seconds within the program is an error that names the last block; nothing \
moves.

With --stream the program runs as it comes, for programs of any length. The machine homes when the \
first byte has arrived, and waits at standstill where the line is slower than the machine. Where \
the line is cut, or a block cannot be executed, the machine stops along its path, and the error \
names the last block received and the last one executed.";

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

/// Most bytes of a line of the program.
const LONGEST_LINE: usize = 1 << 16;

/// Receives a program and runs it.
///
/// # Errors
/// See [`Exit`]: the line fails or pauses too long, or as `haptimill run`.
pub fn run(args: DncArgs) -> Result<(), CliError> {
    // A mistake of the command line must not end the command behind a long reception, when FILE
    // is replaced.
    run::check_before_program(&args.run)?;
    output::check_writable(&args.run.program)?;
    let mut reception = Reception::open(&args)?;
    if !args.run.json && !args.run.quiet {
        print_line!("receiving on {}; Ctrl-C stops", args.line);
    }
    if args.run.stream {
        return run_as_it_comes(args.run, reception);
    }
    let program = loop {
        if reception.program.is_complete() {
            break reception.program;
        }
        reception.receive().map_err(Cut::before_motion)?;
        if reception.program.text.len() as u64 > input::PROGRAM_BYTES {
            let why = format!("more than {} bytes", input::PROGRAM_BYTES);
            return Err(reception.cut(&why).before_motion());
        }
    };
    drop(reception.line);
    let file = &args.run.program;
    output::save(file, &program.text)?;
    if !args.run.json && !args.run.quiet {
        let lines = haptimill_report::count(program.lines as usize, "line");
        print_line!("{}: {lines} received", file.display());
    }
    run::run(args.run)
}

/// Runs a program while it comes.
fn run_as_it_comes(args: RunArgs, mut reception: Reception) -> Result<(), CliError> {
    // The machine is homed when a program comes, not before.
    while !reception.program.has_begun() {
        reception.receive().map_err(Cut::before_motion)?;
    }
    let file = &args.program;
    let kept = File::create(file).map_err(|error| output::write_error(file, error))?;
    let is_cut = Arc::new(AtomicBool::new(false));
    let lines = Lines {
        reception,
        ready: io::Cursor::default(),
        kept,
        is_cut: Arc::clone(&is_cut),
    };
    run::run_live(args, Box::new(lines)).map_err(|error| CliError {
        exit: if is_cut.load(Ordering::Relaxed) {
            Exit::Port
        } else {
            error.exit
        },
        ..error
    })
}

/// A serial line and the program that comes over it.
struct Reception {
    line: Receiver,
    name: String,
    /// Longest silence in the middle of the program, s.
    silence: f64,
    /// Time for which no byte came while one was waited for.
    silent: Duration,
    interrupted: Arc<AtomicBool>,
    program: Received,
}

impl Reception {
    fn open(args: &DncArgs) -> Result<Self, CliError> {
        Ok(Self {
            line: Receiver::open(&args.line, args.line_baud, args.flow.into())?,
            name: args.line.clone(),
            silence: args.silence,
            silent: Duration::ZERO,
            interrupted: interrupt::flag(),
            program: Received::default(),
        })
    }

    /// Waits for bytes, for a short time.
    fn receive(&mut self) -> Result<(), Cut> {
        if self.interrupted.load(Ordering::Relaxed) {
            return Err(Cut::Stopped);
        }
        let start = Instant::now();
        let part = self
            .line
            .read(POLL)
            .map_err(|error| self.cut(&error.to_string()))?;
        if !part.is_empty() {
            self.silent = Duration::ZERO;
            self.program.add(&part);
            return Ok(());
        }
        if self.program.has_begun() {
            // A machine that does not take the program is not a silent line.
            self.silent += start.elapsed();
        }
        if self.silent.as_secs_f64() > self.silence {
            let why = format!("nothing was received for {} s", self.silence);
            return Err(self.cut(&why));
        }
        Ok(())
    }

    fn cut(&self, why: &str) -> Cut {
        let last = self.program.last();
        Cut::Line(format!(
            "{}: the program ended before its end: {why}; {last}",
            self.name
        ))
    }
}

/// Why a program ended before its end.
#[derive(Debug)]
enum Cut {
    /// The user stopped the command.
    Stopped,
    /// The line failed or fell silent: what happened, and the last block.
    Line(String),
}

impl Cut {
    /// The error of a command that has not moved the machine.
    fn before_motion(self) -> CliError {
        match self {
            Self::Stopped => {
                let what = "stopped by the user before the program was complete; nothing moved";
                CliError::new(Exit::Stopped, what)
            }
            Self::Line(what) => {
                let what = format!(
                    "{what}; nothing moved. Check the cable, and that both ends have the same \
                     baud rate and flow control"
                );
                CliError::new(Exit::Port, what)
            }
        }
    }
}

/// The lines of a program as they come.
struct Lines {
    reception: Reception,
    /// Complete lines that were not read yet.
    ready: io::Cursor<Vec<u8>>,
    /// The file that keeps the program.
    kept: File,
    is_cut: Arc<AtomicBool>,
}

impl Read for Lines {
    /// Waits for a line; no byte is the end of the program.
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            let count = self.ready.read(buffer)?;
            if count > 0 {
                return Ok(count);
            }
            let lines = self.reception.program.take_lines();
            if !lines.is_empty() {
                self.kept.write_all(&lines)?;
                self.ready = io::Cursor::new(lines);
                continue;
            }
            if self.reception.program.is_complete() {
                return Ok(0);
            }
            let received = self.reception.receive().and_then(|()| {
                if self.reception.program.text.len() > LONGEST_LINE {
                    let why = format!("a line of more than {LONGEST_LINE} bytes");
                    return Err(self.reception.cut(&why));
                }
                Ok(())
            });
            match received {
                Ok(()) => {}
                // The session stops the machine.
                Err(Cut::Stopped) => return Ok(0),
                Err(Cut::Line(what)) => {
                    self.is_cut.store(true, Ordering::Relaxed);
                    return Err(io::Error::other(what));
                }
            }
        }
    }
}

/// A program that is being received.
#[derive(Debug, Default)]
struct Received {
    text: Vec<u8>,
    /// Complete lines.
    lines: u32,
    /// Start of the line that is not complete yet.
    start: usize,
    /// The last line ended with a carriage return.
    has_return: bool,
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
        let is_line_feed_of_return = line == "\n" && self.has_return;
        self.start = self.text.len();
        self.has_return = line.ends_with('\r');
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

    /// Takes the complete lines.
    fn take_lines(&mut self) -> Vec<u8> {
        let rest = self.text.split_off(self.start);
        self.start = 0;
        std::mem::replace(&mut self.text, rest)
    }

    const fn is_complete(&self) -> bool {
        self.ended
    }

    const fn has_begun(&self) -> bool {
        !self.text.is_empty() || self.lines > 0
    }

    /// The last block, as a part of a sentence.
    fn last(&self) -> String {
        if self.last_block.is_empty() {
            return "no block was received".to_string();
        }
        format!(
            "the last block was line {}, {}",
            self.lines, self.last_block
        )
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
        let last = received("G0 X1\nG1 X2 F100\nG1 X").last();
        assert_eq!(last, "the last block was line 2, G1 X2 F100");
        assert_eq!(received("").last(), "no block was received");
    }

    #[test]
    fn lines_are_taken_as_they_come() {
        let text = "%\r\nG0 X1\r\nM30\r\n%\r\n";
        let (mut program, mut taken) = (Received::default(), Vec::new());
        for byte in text.as_bytes() {
            program.add(std::slice::from_ref(byte));
            taken.extend(program.take_lines());
            assert!(program.text.len() < 6);
        }
        assert!(program.is_complete());
        assert_eq!((taken, program.lines), (received(text).text, 4));
    }
}
