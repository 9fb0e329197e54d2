//! A TCP connection to a controller or to a served simulator.

use super::{BUSY, CLOSED, DENIED, PortError, SLOW, Token, Transport, is_quiet, token};
use std::io::{Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

/// A TCP connection without delay of small packets.
pub struct TcpTransport {
    name: String,
    stream: TcpStream,
    /// Nothing was received yet: the first bytes may be the message that the other end is busy.
    fresh: bool,
}

impl TcpTransport {
    /// Connects to `HOST:PORT` within 5 seconds, with the token of this process.
    ///
    /// # Errors
    /// See [`TcpTransport::connect_with`].
    pub fn connect(address: &str) -> Result<Self, PortError> {
        Self::connect_with(address, token::token())
    }

    /// Connects to `HOST:PORT` within 5 seconds, and sends a token first.
    ///
    /// # Errors
    /// [`PortError::Open`] with the remedy. The first [`Transport::read`] fails when another host
    /// is being served.
    pub fn connect_with(address: &str, token: Option<&Token>) -> Result<Self, PortError> {
        let refused = |reason: String| PortError::Open {
            name: format!("tcp:{address}"),
            reason,
            remedy: "check the address, and that the controller or `haptimill sim serve` runs there",
        };
        let addresses = address.to_socket_addrs();
        let mut reason = "the name has no address".to_string();
        for candidate in addresses.map_err(|error| refused(error.to_string()))? {
            match TcpStream::connect_timeout(&candidate, Duration::from_secs(5)) {
                Ok(mut stream) => {
                    if let Some(token) = token {
                        stream
                            .write_all(&token.line())
                            .map_err(|error| refused(error.to_string()))?;
                    }
                    return Self::new(stream, format!("tcp:{address}"))
                        .map_err(|error| refused(error.to_string()));
                }
                Err(error) => reason = error.to_string(),
            }
        }
        Err(refused(reason))
    }

    /// Uses a connection that is open already.
    pub(super) fn new(stream: TcpStream, name: String) -> std::io::Result<Self> {
        stream.set_nodelay(true)?;
        Ok(Self {
            name,
            stream,
            fresh: true,
        })
    }

    /// Sets the timeout of the next call; zero is the non-blocking mode of the socket.
    fn wait(&self, wait: Duration) -> std::io::Result<()> {
        self.stream.set_nonblocking(wait.is_zero())?;
        if !wait.is_zero() {
            self.stream.set_read_timeout(Some(wait))?;
            self.stream.set_write_timeout(Some(wait))?;
        }
        Ok(())
    }

    fn lost(&self, reason: &str) -> PortError {
        PortError::Gone {
            name: self.name.clone(),
            reason: reason.to_string(),
        }
    }
}

impl Transport for TcpTransport {
    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> Result<usize, PortError> {
        if buffer.is_empty() {
            return Ok(0);
        }
        match self.wait(wait).and_then(|()| self.stream.read(buffer)) {
            Ok(0) => Err(self.lost("connection closed")),
            Ok(count) => {
                let first = std::mem::take(&mut self.fresh);
                // The messages have no zero byte, which begins and ends every frame.
                let bytes = &buffer[..count];
                let is = |message: &[u8]| {
                    bytes.len() >= 15 && message.starts_with(&bytes[..count.min(message.len())])
                };
                let name = || self.name.clone();
                if first && is(BUSY) {
                    return Err(PortError::Busy { name: name() });
                }
                if first && is(DENIED) {
                    return Err(PortError::Denied { name: name() });
                }
                if is(CLOSED) || first && is(SLOW) {
                    return Err(self.lost("it closed the connection after a silence"));
                }
                Ok(count)
            }
            Err(error) if is_quiet(&error) => Ok(0),
            Err(error) => Err(self.lost(&error.to_string())),
        }
    }

    fn write(&mut self, bytes: &[u8], wait: Duration) -> Result<usize, PortError> {
        match self.wait(wait).and_then(|()| self.stream.write(bytes)) {
            Ok(count) => Ok(count),
            Err(error) if is_quiet(&error) => Ok(0),
            Err(error) => {
                // A message that waits to be read explains more than a broken pipe.
                if self.fresh {
                    self.read(&mut [0; 128], Duration::from_millis(50))?;
                }
                Err(self.lost(&error.to_string()))
            }
        }
    }

    fn name(&self) -> &str {
        &self.name
    }
}
