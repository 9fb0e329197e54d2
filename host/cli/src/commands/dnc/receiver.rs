//! The bytes of a serial line, received on a thread of its own.
//!
//! A machine takes the blocks of a program when it executes them, a long move may take a minute,
//! and the buffers of the system hold some kilobytes. The thread reads all the time and pauses
//! the sender: XOFF above [`PAUSE_ABOVE`] bytes that wait for the machine, XON below
//! [`RESUME_BELOW`]. With RTS/CTS it stops reading above, and the driver of the port drops RTS.

use haptimill_client::port::{Flow, PortError, SerialTransport, Transport as _};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::time::Duration;

/// The character that starts the sender, DC1.
const XON: u8 = 0x11;

/// The character that stops the sender, DC3.
const XOFF: u8 = 0x13;

/// Bytes that wait for the machine above which XOFF is sent.
const PAUSE_ABOVE: usize = 4096;

/// Bytes that wait for the machine below which XON is sent.
const RESUME_BELOW: usize = 1024;

/// Most bytes that wait: a sender that does not pause fills the buffers of the system next.
const MAX: usize = 1 << 16;

/// Longest wait for bytes.
const POLL: Duration = Duration::from_millis(20);

/// A line that is received.
pub(super) struct Receiver {
    parts: mpsc::Receiver<Result<Vec<u8>, PortError>>,
    waiting: Arc<AtomicUsize>,
    is_closed: Arc<AtomicBool>,
}

impl Receiver {
    /// Opens a line and starts to receive. XON starts the sender.
    ///
    /// # Errors
    /// As [`SerialTransport::open_with_flow`].
    pub(super) fn open(path: &str, baud: u32, flow: Flow) -> Result<Self, PortError> {
        let line = SerialTransport::open_with_flow(path, baud, flow)?;
        let waiting = Arc::new(AtomicUsize::new(0));
        let is_closed = Arc::new(AtomicBool::new(false));
        let (sender, parts) = mpsc::channel();
        let thread = Thread {
            line,
            flow,
            is_paused: true,
            waiting: Arc::clone(&waiting),
            is_closed: Arc::clone(&is_closed),
            parts: sender,
        };
        std::thread::spawn(move || thread.run());
        Ok(Self {
            parts,
            waiting,
            is_closed,
        })
    }

    /// The next bytes; none after `wait`.
    ///
    /// # Errors
    /// The line fails.
    pub(super) fn read(&self, wait: Duration) -> Result<Vec<u8>, PortError> {
        match self.parts.recv_timeout(wait) {
            Ok(Ok(part)) => {
                self.waiting.fetch_sub(part.len(), Ordering::Relaxed);
                Ok(part)
            }
            Ok(Err(error)) => Err(error),
            // After its error the thread has ended, and the program with it.
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => Ok(Vec::new()),
        }
    }
}

impl Drop for Receiver {
    /// Ends the thread. A sender that is paused stays so: nobody takes its bytes.
    fn drop(&mut self) {
        self.is_closed.store(true, Ordering::Relaxed);
    }
}

/// The receiving side.
struct Thread {
    line: SerialTransport,
    flow: Flow,
    /// The last character of flow control is not XON; before the first one the sender waits.
    is_paused: bool,
    waiting: Arc<AtomicUsize>,
    is_closed: Arc<AtomicBool>,
    parts: Sender<Result<Vec<u8>, PortError>>,
}

impl Thread {
    /// Receives until the line fails or the receiver is dropped.
    fn run(mut self) {
        while !self.is_closed.load(Ordering::Relaxed) {
            let part = self.receive();
            if part.as_ref().is_ok_and(Vec::is_empty) {
                continue;
            }
            let is_end = part.is_err();
            self.waiting
                .fetch_add(part.as_ref().map_or(0, Vec::len), Ordering::Relaxed);
            if self.parts.send(part).is_err() || is_end {
                return;
            }
        }
    }

    fn receive(&mut self) -> Result<Vec<u8>, PortError> {
        let waiting = self.waiting.load(Ordering::Relaxed);
        if self.flow == Flow::XonXoff {
            // A character that the line does not take is sent again in the next round.
            if !self.is_paused && waiting > PAUSE_ABOVE {
                self.is_paused = self.line.write(&[XOFF], POLL)? > 0;
            } else if self.is_paused && waiting < RESUME_BELOW {
                self.is_paused = self.line.write(&[XON], POLL)? == 0;
            }
        }
        let max = match self.flow {
            Flow::RtsCts => PAUSE_ABOVE,
            Flow::XonXoff | Flow::None => MAX,
        };
        if waiting >= max {
            std::thread::sleep(POLL);
            return Ok(Vec::new());
        }
        let mut buffer = [0; 1024];
        let count = self.line.read(&mut buffer, POLL)?;
        Ok(buffer[..count].to_vec())
    }
}
