//! What a session talks over.

use crate::port::{PortError, Transport};
use std::time::{Duration, Instant};

/// Carries bytes to a controller and back, and has a clock.
pub trait Line {
    /// Sends bytes, lets a little time pass, adds what has arrived to `received`, and gives the time in microseconds.
    ///
    /// # Errors
    /// The port is gone.
    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError>;

    /// What people call it.
    fn name(&self) -> String;
}

/// Longest wait for bytes in one exchange: a thousand steps a second.
const WAIT: Duration = Duration::from_millis(1);

/// Longest wait for a port to take bytes. A port that takes none for so long is not reading; the link notices the silence.
const WRITE_WAIT: Duration = Duration::from_millis(20);

/// A controller behind a port, in real time.
pub struct PortLine {
    port: Box<dyn Transport>,
    begun: Instant,
    /// Bytes that the port has not taken yet.
    waiting: Vec<u8>,
}

impl PortLine {
    /// A line over an open port.
    #[must_use]
    pub fn new(port: Box<dyn Transport>) -> Self {
        Self { port, begun: Instant::now(), waiting: Vec::new() }
    }
}

impl Line for PortLine {
    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError> {
        self.waiting.extend_from_slice(transmit);
        if !self.waiting.is_empty() {
            let taken = self.port.write(&self.waiting, WRITE_WAIT)?;
            self.waiting.drain(..taken);
        }
        let mut buffer = [0; 4096];
        let count = self.port.read(&mut buffer, WAIT)?;
        received.extend_from_slice(&buffer[..count]);
        Ok(self.begun.elapsed().as_micros() as u64)
    }

    fn name(&self) -> String {
        self.port.name().to_string()
    }
}
