//! Observers: read-only connections to the process that commands a machine.
//!
//! A serial port has one opener, and a controller one session. The process that has the session
//! therefore passes on what it receives: one JSON object per line. Nothing that an observer sends
//! reaches the machine; its bytes are read for the token only.

use super::serve::check_token;
use super::token::Token;
use super::{BUSY, DENIED, PortError};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

/// Observers at most.
const MOST: usize = 32;

/// Connections that are accepted per call.
const ACCEPTED: usize = 4;

/// Time between two looks at the connections.
const EVERY: Duration = Duration::from_millis(10);

/// Time in which a connection must send its token.
const TOKEN_TIMEOUT: Duration = Duration::from_secs(2);

/// Bytes kept for an observer that does not read; of more, whole lines are left out.
const MOST_UNREAD: usize = 1 << 16;

/// Bytes that are read of an observer at most.
const MOST_RECEIVED: usize = 4096;

/// Serves observers on a TCP port.
pub struct Observers {
    name: String,
    listener: TcpListener,
    token: Option<[u8; 32]>,
    all: Vec<Observer>,
    looked_at: Instant,
}

struct Observer {
    stream: TcpStream,
    since: Instant,
    received: Vec<u8>,
    is_admitted: bool,
    unread: Vec<u8>,
}

impl Observers {
    /// Listens on `HOST:PORT`; port 0 takes a free one.
    ///
    /// # Errors
    /// [`PortError::Open`].
    pub fn listen(address: &str) -> Result<Self, PortError> {
        let listen = || {
            let listener = TcpListener::bind(address)?;
            listener.set_nonblocking(true)?;
            Ok((format!("tcp:{}", listener.local_addr()?), listener))
        };
        let (name, listener) = listen().map_err(|error: std::io::Error| PortError::Open {
            name: format!("tcp:{address}"),
            reason: error.to_string(),
            remedy: "choose another port, or 0 for a free one",
        })?;
        Ok(Self {
            name,
            listener,
            token: None,
            all: Vec::new(),
            looked_at: Instant::now(),
        })
    }

    /// Serves only observers that send this token first.
    #[must_use]
    pub fn with_token(self, token: &Token) -> Self {
        Self {
            token: Some(token.digest()),
            ..self
        }
    }

    /// The address, as `tcp:HOST:PORT`.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The address on which it listens.
    ///
    /// # Errors
    /// The system does not return it.
    pub fn address(&self) -> std::io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Accepts and serves connections; never waits.
    pub fn advance(&mut self) {
        if self.looked_at.elapsed() < EVERY {
            return;
        }
        self.looked_at = Instant::now();
        for _ in 0..ACCEPTED {
            let Ok((mut stream, _)) = self.listener.accept() else {
                break;
            };
            if stream.set_nonblocking(true).is_err() {
                continue;
            }
            if self.all.len() >= MOST {
                let _ = stream.write(BUSY);
                continue;
            }
            self.all.push(Observer {
                stream,
                since: Instant::now(),
                received: Vec::new(),
                is_admitted: self.token.is_none(),
                unread: Vec::new(),
            });
        }
        let token = self.token.as_ref();
        self.all.retain_mut(|observer| observer.serve(token));
    }

    /// Sends a line to every observer; never waits.
    pub fn send(&mut self, line: &str) {
        for observer in self.all.iter_mut().filter(|it| it.is_admitted) {
            if observer.unread.len() + line.len() < MOST_UNREAD {
                observer.unread.extend_from_slice(line.as_bytes());
                observer.unread.push(b'\n');
            }
        }
    }

    /// Whether anybody observes.
    #[must_use]
    pub fn has_any(&self) -> bool {
        self.all.iter().any(|observer| observer.is_admitted)
    }
}

impl Observer {
    /// Reads and writes once; false when the connection ends.
    fn serve(&mut self, token: Option<&[u8; 32]>) -> bool {
        let mut buffer = [0; 512];
        match self.stream.read(&mut buffer) {
            Ok(0) => return false,
            Ok(count) if !self.is_admitted => self.received.extend_from_slice(&buffer[..count]),
            // An admitted observer has nothing to say.
            Ok(_) => {}
            Err(error) if super::is_quiet(&error) => {}
            Err(_) => return false,
        }
        if !self.is_admitted {
            match check_token(token, &self.received) {
                Ok(Some(_)) => self.is_admitted = true,
                Ok(None)
                    if self.since.elapsed() < TOKEN_TIMEOUT
                        && self.received.len() < MOST_RECEIVED => {}
                _ => {
                    let _ = self.stream.write(DENIED);
                    return false;
                }
            }
        }
        if self.unread.is_empty() {
            return true;
        }
        match self.stream.write(&self.unread) {
            Ok(count) => {
                self.unread.drain(..count);
                true
            }
            Err(error) => super::is_quiet(&error),
        }
    }
}
