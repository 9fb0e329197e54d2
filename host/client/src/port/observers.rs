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
const MAX: usize = 32;

/// Connections that have not sent their token at most; of more, the oldest is closed.
const CANDIDATES: usize = 16;

/// Time after which an observer that reads nothing is closed.
const STALLED: Duration = Duration::from_secs(5);

/// Connections that are accepted per call.
const ACCEPTED: usize = 4;

/// Time between two looks at the connections.
const EVERY: Duration = Duration::from_millis(10);

/// Time in which a connection must send its token.
const TOKEN_TIMEOUT: Duration = Duration::from_secs(2);

/// Bytes kept for an observer that does not read; of more, whole lines are left out.
pub const MAX_UNREAD: usize = 1 << 16;

/// Bytes that are read of an observer at most.
const MAX_RECEIVED: usize = 4096;

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
    /// When it took bytes for the last time, or had none to take.
    took_at: Instant,
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
            if self.token.is_none() && self.admitted() >= MAX {
                let _ = stream.write(BUSY);
                continue;
            }
            self.all.push(Observer {
                stream,
                since: Instant::now(),
                received: Vec::new(),
                is_admitted: self.token.is_none(),
                unread: Vec::new(),
                took_at: Instant::now(),
            });
            // Connections without the token must not keep out those with it.
            if self.all.len() - self.admitted() > CANDIDATES
                && let Some(oldest) = self.all.iter().position(|it| !it.is_admitted)
            {
                self.all.remove(oldest);
            }
        }
        let token = self.token.as_ref();
        let mut admitted = self.admitted();
        self.all.retain_mut(|observer| {
            let was_admitted = observer.is_admitted;
            let stays = observer.serve(token, admitted < MAX);
            admitted += usize::from(stays && !was_admitted && observer.is_admitted);
            stays
        });
    }

    fn admitted(&self) -> usize {
        self.all.iter().filter(|it| it.is_admitted).count()
    }

    /// Sends a line to every observer; never waits.
    pub fn send(&mut self, line: &str) {
        for observer in self.all.iter_mut().filter(|it| it.is_admitted) {
            if observer.unread.len() + line.len() < MAX_UNREAD {
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
    fn serve(&mut self, token: Option<&[u8; 32]>, has_room: bool) -> bool {
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
                Ok(Some(_)) if has_room => self.is_admitted = true,
                Ok(Some(_)) => {
                    let _ = self.stream.write(BUSY);
                    return false;
                }
                Ok(None)
                    if self.since.elapsed() < TOKEN_TIMEOUT
                        && self.received.len() < MAX_RECEIVED => {}
                _ => {
                    let _ = self.stream.write(DENIED);
                    return false;
                }
            }
        }
        if self.unread.is_empty() {
            self.took_at = Instant::now();
            return true;
        }
        match self.stream.write(&self.unread) {
            Ok(count) => {
                self.unread.drain(..count);
                self.took_at = Instant::now();
                true
            }
            Err(error) => super::is_quiet(&error) && self.took_at.elapsed() < STALLED,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{BufRead as _, BufReader};

    /// Longest wait. It is no speed limit.
    const LIMIT: Duration = Duration::from_secs(60);

    fn connect(observers: &Observers) -> TcpStream {
        TcpStream::connect(observers.address().unwrap()).unwrap()
    }

    /// Serves until a condition holds.
    #[track_caller]
    fn serve_until(observers: &mut Observers, is_done: impl Fn(&Observers) -> bool) {
        let until = Instant::now() + LIMIT;
        while !is_done(observers) {
            assert!(Instant::now() < until);
            observers.advance();
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn connections_without_the_token_keep_nobody_out() {
        let token: Token = "0123456789abcdef".parse().unwrap();
        let observers = Observers::listen("127.0.0.1:0").unwrap();
        let mut observers = observers.with_token(&token);
        // More than the observers at most, all silent, and none times out before the end.
        let mut silent = Vec::new();
        for _ in 0..2 * MAX {
            silent.push(connect(&observers));
            observers.advance();
        }
        let mut watching = connect(&observers);
        watching.write_all(&token.line()).unwrap();
        serve_until(&mut observers, Observers::has_any);
        assert!(observers.all.len() <= MAX + CANDIDATES);
        observers.send("a line");
        serve_until(&mut observers, |it| {
            it.all.iter().all(|it| it.unread.is_empty())
        });
        let mut line = String::new();
        BufReader::new(watching).read_line(&mut line).unwrap();
        assert_eq!(line, "a line\n");
    }

    #[test]
    fn observers_beyond_the_limit_are_refused_although_they_have_the_token() {
        let token: Token = "0123456789abcdef".parse().unwrap();
        let observers = Observers::listen("127.0.0.1:0").unwrap();
        let mut observers = observers.with_token(&token);
        let mut open = Vec::new();
        for count in 1..=MAX {
            let mut stream = connect(&observers);
            stream.write_all(&token.line()).unwrap();
            open.push(stream);
            serve_until(&mut observers, |it| it.admitted() == count);
        }
        let mut late = connect(&observers);
        late.write_all(&token.line()).unwrap();
        late.set_nonblocking(true).unwrap();
        let mut answer = vec![0; BUSY.len()];
        let until = Instant::now() + LIMIT;
        while late.read(&mut answer).is_err() {
            assert!(Instant::now() < until);
            observers.advance();
            std::thread::sleep(Duration::from_millis(1));
        }
        assert_eq!(answer, BUSY);
        assert_eq!(observers.admitted(), MAX);
    }

    #[test]
    fn an_observer_that_never_reads_loses_its_place() {
        let mut observers = Observers::listen("127.0.0.1:0").unwrap();
        let idle = connect(&observers);
        serve_until(&mut observers, Observers::has_any);
        let line = "x".repeat(MAX_UNREAD / 2);
        let until = Instant::now() + LIMIT;
        while observers.has_any() {
            assert!(Instant::now() < until, "it keeps its place");
            observers.send(&line);
            observers.advance();
            std::thread::sleep(Duration::from_millis(1));
        }
        drop(idle);
    }
}
