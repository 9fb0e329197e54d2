//! The bytes of a serial line, received on a thread of its own.
//!
//! A machine takes the blocks of a program when it executes them, a long move may take a minute, and
//! the buffers of the system hold some kilobytes. The thread reads all the time and tells the sender
//! when to pause: XOFF above [`PAUSE_ABOVE`] bytes that wait for the machine, XON below
//! [`RESUME_BELOW`]. With RTS/CTS it stops reading above, and the driver of the port drops RTS.

use haptimill_client::port::{Flow, PortError, SerialTransport, Transport as _};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError, SyncSender};
use std::time::{Duration, Instant};

/// The character that starts the sender, DC1.
const XON: u8 = 0x11;

/// The character that stops the sender, DC3.
const XOFF: u8 = 0x13;

/// Bytes that wait for the machine when the sender is told to pause.
const PAUSE_ABOVE: usize = 4096;

/// Bytes that wait for the machine when the sender is told to go on.
const RESUME_BELOW: usize = 1024;

/// Most bytes that wait: a sender that does not pause fills the buffers of the system next.
const MOST: usize = 1 << 16;

/// Longest wait for bytes.
const POLL: Duration = Duration::from_millis(20);

/// Parts of the line that may wait.
const PARTS: usize = MOST;

/// A line that is received.
pub(super) struct Receiver {
    parts: mpsc::Receiver<Result<Vec<u8>, PortError>>,
    waiting: Arc<AtomicUsize>,
}

impl Receiver {
    /// Opens a line and starts to receive. The sender is told to begin.
    ///
    /// # Errors
    /// As [`SerialTransport::open_with_flow`].
    pub(super) fn open(path: &str, baud: u32, flow: Flow) -> Result<Self, PortError> {
        let line = SerialTransport::open_with_flow(path, baud, flow)?;
        let waiting = Arc::new(AtomicUsize::new(0));
        let (sender, parts) = mpsc::sync_channel(PARTS);
        let thread = Thread {
            line,
            has_characters: flow == Flow::XonXoff,
            is_paused: false,
            waiting: Arc::clone(&waiting),
            parts: sender,
        };
        std::thread::spawn(move || thread.run());
        Ok(Self { parts, waiting })
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

/// The receiving side.
struct Thread {
    line: SerialTransport,
    /// The sender is paused by characters.
    has_characters: bool,
    is_paused: bool,
    waiting: Arc<AtomicUsize>,
    parts: SyncSender<Result<Vec<u8>, PortError>>,
}

impl Thread {
    /// Receives until the line fails or nobody reads it.
    fn run(mut self) {
        let mut result = self.tell(XON);
        while result.is_ok() {
            match self.receive() {
                Ok(part) if part.is_empty() => {}
                Ok(part) => {
                    self.waiting.fetch_add(part.len(), Ordering::Relaxed);
                    if self.parts.send(Ok(part)).is_err() {
                        return;
                    }
                }
                Err(error) => result = Err(error),
            }
        }
        if let Err(error) = result {
            let _ = self.parts.send(Err(error));
        }
    }

    fn receive(&mut self) -> Result<Vec<u8>, PortError> {
        let waiting = self.waiting.load(Ordering::Relaxed);
        if !self.is_paused && waiting > PAUSE_ABOVE {
            self.is_paused = true;
            self.tell(XOFF)?;
        } else if self.is_paused && waiting < RESUME_BELOW {
            self.is_paused = false;
            self.tell(XON)?;
        }
        let is_full = waiting >= MOST || (self.is_paused && !self.has_characters);
        if is_full {
            std::thread::sleep(POLL);
            return Ok(Vec::new());
        }
        let mut buffer = [0; 1024];
        let count = self.line.read(&mut buffer, POLL)?;
        Ok(buffer[..count].to_vec())
    }

    /// Sends a character of flow control; a line that takes no bytes for a second has no sender
    /// that could read it.
    fn tell(&mut self, character: u8) -> Result<(), PortError> {
        let start = Instant::now();
        while self.has_characters
            && self.line.write(&[character], POLL)? == 0
            && start.elapsed() < Duration::from_secs(1)
        {}
        Ok(())
    }
}
