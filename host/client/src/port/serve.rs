//! The device's end, for a simulator that is served in real time: a pseudo-terminal, or a TCP listener.
//!
//! A second host is sent away, but a stop that it sends is heard: whoever may use the port can stop the machine.
//!
//! Both outlive their hosts: while none is there, reading gives nothing and what is written is thrown away, as on a cable that is not plugged in.

use super::token::{LONGEST_LINE, TOKEN_WORD, Token};
use super::{BUSY, CLOSED, DENIED, PortError, SLOW, TcpTransport, Transport, is_quiet};
use haptimill_protocol::frame::FrameDecoder;
use haptimill_protocol::urgent::{STOP, UrgentDetector};
use sha2::{Digest, Sha256};
use std::collections::VecDeque;
use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

#[cfg(unix)]
pub use pty::PtyServer;

/// Serves one host at a time on a TCP port; a second one is told that it is busy and closed.
///
/// A connection becomes the host only once it has sent a valid Hello, after its token where the port
/// demands one: garbage takes no place. [`TcpServer::read`] does a bounded part of the work at a
/// time, so neither many connections nor many bytes delay the host that is served.
pub struct TcpServer {
    name: String,
    listener: TcpListener,
    /// SHA-256 of the token that a host has to give.
    token: Option<[u8; 32]>,
    host: Option<TcpTransport>,
    /// When the host was heard last.
    heard: Instant,
    /// What the host said before it had the place.
    early: VecDeque<u8>,
    /// Connections that are not the host, the oldest first.
    guests: VecDeque<Guest>,
    asked: Instant,
    /// A host that was sent away asked for an urgent stop.
    stop: bool,
}

/// A connection that is not the host: it has said nothing yet, or is sent away.
struct Guest {
    stream: TcpStream,
    peer: SocketAddr,
    since: Instant,
    said: Vec<u8>,
    /// It was told to go; what it says is looked through for a stop only.
    away: bool,
}

/// How often a listener looks for a new host while it has one.
const ACCEPT_EVERY: Duration = Duration::from_millis(10);

/// Connections that are accepted in one look.
const ACCEPTED: usize = 8;

/// Connections that may wait to become the host or to be closed; of more, the oldest is closed.
const GUESTS: usize = 16;

/// Bytes that are taken of a connection in one look, and in all while it is not the host.
const GUEST_BYTES: usize = 512;
const MOST_GUEST_BYTES: usize = 4096;

/// Longest time in which a new connection must give its token and say something.
const FIRST_WORD: Duration = Duration::from_secs(2);

/// How long a connection that was sent away is still looked through for a stop.
const LAST_WORD: Duration = Duration::from_millis(500);

/// A host that was silent for so long has to make room for another one. Hosts speak every 100 ms.
const SILENT: Duration = Duration::from_secs(2);

/// A pause between two looks after which the silence of a host proves nothing.
const HELD_UP: Duration = Duration::from_millis(500);

/// A host that was silent for so long is closed in any case.
const GONE: Duration = Duration::from_secs(30);

impl TcpServer {
    /// Listens on `HOST:PORT`; port 0 takes a free one, see [`TcpServer::address`].
    ///
    /// # Errors
    /// [`PortError::Open`].
    pub fn listen(address: &str) -> Result<Self, PortError> {
        let listen = || {
            let listener = TcpListener::bind(address)?;
            listener.set_nonblocking(true)?;
            let name = format!("tcp:{}", listener.local_addr()?);
            Ok((name, listener))
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
            host: None,
            heard: Instant::now(),
            early: VecDeque::new(),
            guests: VecDeque::new(),
            asked: Instant::now(),
            stop: false,
        })
    }

    /// Serves only hosts that give this token first.
    #[must_use]
    pub fn with_token(self, token: &Token) -> Self {
        Self {
            token: Some(token.digest()),
            ..self
        }
    }

    /// Where it listens.
    ///
    /// # Errors
    /// The system does not tell.
    pub fn address(&self) -> std::io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Looks at new connections and at those that wait.
    fn accept(&mut self) {
        if self.asked.elapsed() < ACCEPT_EVERY {
            return;
        }
        if self.asked.elapsed() > HELD_UP {
            // This process stood still, and may not have read what the host said.
            self.heard = Instant::now();
        }
        self.asked = Instant::now();
        if self.host.is_some() && self.heard.elapsed() > GONE {
            self.drop_host();
        }
        for _ in 0..ACCEPTED {
            let Ok((stream, peer)) = self.listener.accept() else {
                break;
            };
            if stream.set_nonblocking(true).is_err() {
                continue;
            }
            if self.guests.len() == GUESTS {
                self.guests.pop_front();
            }
            self.guests.push_back(Guest {
                stream,
                peer,
                since: Instant::now(),
                said: Vec::new(),
                away: false,
            });
        }
        for _ in 0..self.guests.len() {
            if let Some(guest) = self.guests.pop_front()
                && let Some(guest) = self.look_at(guest)
            {
                self.guests.push_back(guest);
            }
        }
    }

    /// Goes on with a connection that is not the host; none when it became the host or is closed.
    fn look_at(&mut self, mut guest: Guest) -> Option<Guest> {
        let mut buffer = [0; GUEST_BYTES];
        let ended = match guest.stream.read(&mut buffer) {
            Ok(0) => true,
            Ok(count) => {
                guest.said.extend_from_slice(&buffer[..count]);
                false
            }
            Err(error) => !is_quiet(&error),
        };
        let known = self.admit(&guest.said);
        if let Ok(Some(from)) = known
            && UrgentDetector::new().push_all(&guest.said[from..])
        {
            self.stop = true;
            guest.said.truncate(from);
        }
        if ended || guest.said.len() > MOST_GUEST_BYTES {
            return None;
        }
        if guest.away {
            return (guest.since.elapsed() < LAST_WORD).then_some(guest);
        }
        match known {
            Err(()) => guest.send_away(DENIED),
            _ if self.host.is_some() && self.heard.elapsed() < SILENT => guest.send_away(BUSY),
            Ok(Some(from)) if opens_session(&guest.said[from..]) => {
                self.drop_host();
                let said = guest.said.split_off(from);
                if guest.stream.set_nonblocking(false).is_ok()
                    && let Ok(host) = TcpTransport::new(guest.stream, format!("tcp:{}", guest.peer))
                {
                    self.early = said.into();
                    self.host = Some(host);
                    self.heard = Instant::now();
                }
                None
            }
            _ if guest.since.elapsed() > FIRST_WORD => {
                guest.send_away(if self.token.is_some() { DENIED } else { SLOW })
            }
            _ => Some(guest),
        }
    }

    /// Where the protocol begins in what a connection said first; none while its token is not complete.
    ///
    /// # Errors
    /// It gave no token, or another one.
    fn admit(&self, said: &[u8]) -> Result<Option<usize>, ()> {
        let Some(token) = &self.token else {
            return Ok(Some(0));
        };
        match said
            .iter()
            .take(LONGEST_LINE)
            .position(|byte| *byte == b'\n')
        {
            Some(end) => {
                let given = said[..end].strip_prefix(TOKEN_WORD).ok_or(())?;
                let given: [u8; 32] = Sha256::digest(given).into();
                // The digests are compared to their ends, whatever differs.
                let differ = given.iter().zip(token).fold(0, |all, (a, b)| all | (a ^ b));
                (std::hint::black_box(differ) == 0)
                    .then_some(Some(end + 1))
                    .ok_or(())
            }
            None if said.len() >= LONGEST_LINE => Err(()),
            None => Ok(None),
        }
    }

    fn drop_host(&mut self) {
        self.early.clear();
        if let Some(mut host) = self.host.take() {
            // It does not read either, or it would have spoken.
            let _ = host.write(CLOSED, Duration::ZERO);
        }
    }
}

/// Whether these bytes contain a valid Hello.
fn opens_session(mut said: &[u8]) -> bool {
    FrameDecoder::new().take(&mut said).is_some()
}

impl Guest {
    /// Says why. What it says meanwhile is still read: closing at once would reset the connection and lose the reason, so only the sending half is closed.
    fn send_away(mut self, why: &[u8]) -> Option<Self> {
        let _ = self.stream.write(why);
        let _ = self.stream.shutdown(Shutdown::Write);
        self.away = true;
        self.since = Instant::now();
        Some(self)
    }
}

impl Transport for TcpServer {
    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> Result<usize, PortError> {
        self.accept();
        if buffer.len() >= STOP.len() && std::mem::take(&mut self.stop) {
            buffer[..STOP.len()].copy_from_slice(&STOP);
            return Ok(STOP.len());
        }
        let Some(host) = &mut self.host else {
            std::thread::sleep(wait.min(ACCEPT_EVERY));
            return Ok(0);
        };
        if !self.early.is_empty() {
            return Ok(self.early.read(buffer).unwrap_or(0));
        }
        match host.read(buffer, wait) {
            Ok(count) => {
                if count > 0 {
                    self.heard = Instant::now();
                }
                Ok(count)
            }
            Err(_) => {
                self.host = None;
                Ok(0)
            }
        }
    }

    fn write(&mut self, bytes: &[u8], wait: Duration) -> Result<usize, PortError> {
        let Some(host) = &mut self.host else {
            return Ok(bytes.len());
        };
        match host.write(bytes, wait) {
            Ok(count) => Ok(count),
            Err(_) => {
                self.host = None;
                Ok(bytes.len())
            }
        }
    }

    fn name(&self) -> &str {
        &self.name
    }
}

#[cfg(unix)]
mod pty {
    use super::{Duration, Instant, PortError, Transport};
    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    use rustix::fd::OwnedFd;
    use rustix::fs::{Mode, OFlags, fcntl_setfl};
    use rustix::io::Errno;
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    use rustix::termios::{OptionalActions, ioctl_tiocnxcl, tcgetattr, tcsetattr};

    /// A pseudo-terminal whose other end any serial program can open.
    pub struct PtyServer {
        path: String,
        device: OwnedFd,
        /// Keeps the terminal's settings, and keeps reading from failing, while no host has it open.
        host_side: OwnedFd,
        heard: Instant,
    }

    /// A host that was killed leaves its exclusive lock behind; after this silence it is taken off.
    const SILENCE: Duration = Duration::from_secs(2);

    impl PtyServer {
        /// Makes a pseudo-terminal in raw mode. Its path is [`Transport::name`].
        ///
        /// # Errors
        /// [`PortError::Open`].
        pub fn open() -> Result<Self, PortError> {
            Self::make().map_err(|error| PortError::Open {
                name: "pseudo-terminal".to_string(),
                reason: error.to_string(),
                remedy: "serve on a TCP port instead",
            })
        }

        fn make() -> Result<Self, Errno> {
            let device = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
            grantpt(&device)?;
            unlockpt(&device)?;
            let path = ptsname(&device, Vec::new())?;
            let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
            let host_side = rustix::fs::open(path.as_c_str(), flags, Mode::empty())?;
            let mut settings = tcgetattr(&host_side)?;
            settings.make_raw();
            tcsetattr(&host_side, OptionalActions::Now, &settings)?;
            fcntl_setfl(&device, OFlags::NONBLOCK)?;
            Ok(Self {
                path: path.to_string_lossy().into_owned(),
                device,
                host_side,
                heard: Instant::now(),
            })
        }

        /// Waits until the device is ready for `what`, at most `wait`.
        fn ready(&self, what: PollFlags, wait: Duration) -> bool {
            let wait = Timespec {
                tv_sec: wait.as_secs() as i64,
                tv_nsec: i64::from(wait.subsec_nanos()),
            };
            let mut fds = [PollFd::new(&self.device, what)];
            matches!(poll(&mut fds, Some(&wait)), Ok(1..))
        }

        fn gone(&self, error: Errno) -> PortError {
            PortError::Gone {
                name: self.path.clone(),
                reason: error.to_string(),
            }
        }
    }

    impl Transport for PtyServer {
        fn read(&mut self, buffer: &mut [u8], wait: Duration) -> Result<usize, PortError> {
            if !wait.is_zero() {
                self.ready(PollFlags::IN, wait);
            }
            match rustix::io::read(&self.device, buffer) {
                Ok(count) => {
                    self.heard = Instant::now();
                    Ok(count)
                }
                Err(Errno::AGAIN | Errno::INTR) => {
                    if self.heard.elapsed() > SILENCE {
                        self.heard = Instant::now();
                        let _ = ioctl_tiocnxcl(&self.host_side);
                    }
                    Ok(0)
                }
                Err(error) => Err(self.gone(error)),
            }
        }

        fn write(&mut self, bytes: &[u8], wait: Duration) -> Result<usize, PortError> {
            if !wait.is_zero() {
                self.ready(PollFlags::OUT, wait);
            }
            match rustix::io::write(&self.device, bytes) {
                Ok(count) => Ok(count),
                Err(Errno::AGAIN | Errno::INTR) => Ok(0),
                Err(error) => Err(self.gone(error)),
            }
        }

        fn name(&self) -> &str {
            &self.path
        }
    }
}
