//! The device side for a simulator that is served in real time: a pseudo-terminal or a TCP
//! listener.
//!
//! A second host is rejected, but a stop that it sends is executed: every user of the port can stop
//! the machine.
//!
//! Both outlive their hosts. Without a host nothing is read, and written bytes are dropped, as with
//! an unplugged cable.

use super::token::{LONGEST_LINE, TOKEN_PREFIX, Token};
use super::{BUSY, CLOSED, DENIED, PortError, SLOW, TcpTransport, Transport, is_quiet};
use haptimill_protocol::frame::FrameDecoder;
use haptimill_protocol::out_of_band::{STOP, StopDetector};
use sha2::{Digest, Sha256};
use std::collections::VecDeque;
use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

#[cfg(unix)]
pub use pty::PtyServer;

/// Serves one host at a time on a TCP port; a second one gets the message `busy` and is closed.
///
/// A connection becomes the host when it has sent a valid Hello, after its token where the port
/// requires one. [`TcpServer::read`] handles a bounded number of connections and bytes per call, so
/// other connections do not delay the host.
pub struct TcpServer {
    name: String,
    listener: TcpListener,
    /// SHA-256 of the token that a host must send.
    token: Option<[u8; 32]>,
    host: Option<TcpTransport>,
    /// Time of the newest bytes of the host.
    received_at: Instant,
    /// Bytes of the host from before it was accepted.
    early: VecDeque<u8>,
    /// Connections that are not the host, the oldest first.
    candidates: VecDeque<Candidate>,
    accepted_at: Instant,
    /// A rejected connection sent an out-of-band stop.
    stop: bool,
}

/// A connection that is not the host: it has not sent a Hello yet, or is rejected.
struct Candidate {
    stream: TcpStream,
    peer: SocketAddr,
    since: Instant,
    received: Vec<u8>,
    /// It is rejected; its bytes are searched for a stop only.
    is_rejected: bool,
}

/// Time between two checks for new connections.
const ACCEPT_EVERY: Duration = Duration::from_millis(10);

/// Connections that are accepted per check.
const ACCEPTED: usize = 8;

/// Connections that wait to become the host or to be closed at most; of more, the oldest is closed.
const CANDIDATES: usize = 16;

/// Bytes that are read from a connection per check, and in total while it is not the host.
const CANDIDATE_BYTES: usize = 512;
const MAX_CANDIDATE_BYTES: usize = 4096;

/// Time in which a new connection must send its token and a Hello.
const HELLO_TIMEOUT: Duration = Duration::from_secs(2);

/// Time in which a rejected connection is still searched for a stop.
const CLOSE_DELAY: Duration = Duration::from_millis(500);

/// A host that is silent for this time is replaced by another one. Hosts send every 100 ms.
const SILENT: Duration = Duration::from_secs(2);

/// After a longer time between two checks the silence of a host is not counted: this process did
/// not run.
const PROCESS_STALL: Duration = Duration::from_millis(500);

/// A host that is silent for this time is closed in any case.
const MAX_SILENCE: Duration = Duration::from_secs(30);

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
            received_at: Instant::now(),
            early: VecDeque::new(),
            candidates: VecDeque::new(),
            accepted_at: Instant::now(),
            stop: false,
        })
    }

    /// Serves only hosts that send this token first.
    #[must_use]
    pub fn with_token(self, token: &Token) -> Self {
        Self {
            token: Some(token.digest()),
            ..self
        }
    }

    /// The address on which it listens.
    ///
    /// # Errors
    /// The system does not return it.
    pub fn address(&self) -> std::io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Handles new connections and those that wait.
    fn accept(&mut self) {
        if self.accepted_at.elapsed() < ACCEPT_EVERY {
            return;
        }
        if self.accepted_at.elapsed() > PROCESS_STALL {
            // This process did not run, and may not have read the bytes of the host yet.
            self.received_at = Instant::now();
        }
        self.accepted_at = Instant::now();
        if self.host.is_some() && self.received_at.elapsed() > MAX_SILENCE {
            self.drop_host();
        }
        for _ in 0..ACCEPTED {
            let Ok((stream, peer)) = self.listener.accept() else {
                break;
            };
            if stream.set_nonblocking(true).is_err() {
                continue;
            }
            if self.candidates.len() == CANDIDATES {
                self.candidates.pop_front();
            }
            self.candidates.push_back(Candidate {
                stream,
                peer,
                since: Instant::now(),
                received: Vec::new(),
                is_rejected: false,
            });
        }
        for _ in 0..self.candidates.len() {
            if let Some(candidate) = self.candidates.pop_front()
                && let Some(candidate) = self.handle(candidate)
            {
                self.candidates.push_back(candidate);
            }
        }
    }

    /// Handles a connection that is not the host; `None` when it became the host or is closed.
    fn handle(&mut self, mut candidate: Candidate) -> Option<Candidate> {
        let mut buffer = [0; CANDIDATE_BYTES];
        let ended = match candidate.stream.read(&mut buffer) {
            Ok(0) => true,
            Ok(count) => {
                candidate.received.extend_from_slice(&buffer[..count]);
                false
            }
            Err(error) => !is_quiet(&error),
        };
        let known = check_token(self.token.as_ref(), &candidate.received);
        if let Ok(Some(from)) = known
            && StopDetector::new().push_all(&candidate.received[from..])
        {
            self.stop = true;
            candidate.received.truncate(from);
        }
        if ended || candidate.received.len() > MAX_CANDIDATE_BYTES {
            return None;
        }
        if candidate.is_rejected {
            return (candidate.since.elapsed() < CLOSE_DELAY).then_some(candidate);
        }
        match known {
            Err(()) => candidate.reject(DENIED),
            _ if self.host.is_some() && self.received_at.elapsed() < SILENT => {
                candidate.reject(BUSY)
            }
            Ok(Some(from)) if has_hello(&candidate.received[from..]) => {
                self.drop_host();
                let received = candidate.received.split_off(from);
                if candidate.stream.set_nonblocking(false).is_ok()
                    && let Ok(host) =
                        TcpTransport::new(candidate.stream, format!("tcp:{}", candidate.peer))
                {
                    self.early = received.into();
                    self.host = Some(host);
                    self.received_at = Instant::now();
                }
                None
            }
            _ if candidate.since.elapsed() > HELLO_TIMEOUT => {
                candidate.reject(if self.token.is_some() { DENIED } else { SLOW })
            }
            _ => Some(candidate),
        }
    }

    fn drop_host(&mut self) {
        self.early.clear();
        if let Some(mut host) = self.host.take() {
            // A host that sends nothing does not read either.
            let _ = host.write(CLOSED, Duration::ZERO);
        }
    }
}

/// The offset of the data in the first bytes of a connection; `None` while its token is not
/// complete. A port without a token has data only.
///
/// # Errors
/// The token is missing or wrong.
pub(super) fn check_token(token: Option<&[u8; 32]>, received: &[u8]) -> Result<Option<usize>, ()> {
    let Some(token) = token else {
        return Ok(Some(0));
    };
    match received
        .iter()
        .take(LONGEST_LINE)
        .position(|byte| *byte == b'\n')
    {
        Some(end) => {
            let given = received[..end].strip_prefix(TOKEN_PREFIX).ok_or(())?;
            let given: [u8; 32] = Sha256::digest(given).into();
            // In constant time.
            let differ = given.iter().zip(token).fold(0, |all, (a, b)| all | (a ^ b));
            (std::hint::black_box(differ) == 0)
                .then_some(Some(end + 1))
                .ok_or(())
        }
        None if received.len() >= LONGEST_LINE => Err(()),
        None => Ok(None),
    }
}

/// Whether these bytes contain a valid Hello.
fn has_hello(mut received: &[u8]) -> bool {
    FrameDecoder::new().take(&mut received).is_some()
}

impl Candidate {
    /// Sends the reason and closes the sending half. Closing both at once would reset the
    /// connection and lose the reason.
    fn reject(mut self, why: &[u8]) -> Option<Self> {
        let _ = self.stream.write(why);
        let _ = self.stream.shutdown(Shutdown::Write);
        self.is_rejected = true;
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
                    self.received_at = Instant::now();
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

    /// A pseudo-terminal that any serial program can open.
    pub struct PtyServer {
        path: String,
        device: OwnedFd,
        /// Keeps the settings of the terminal, and prevents read errors, while no host has it open.
        host_side: OwnedFd,
        received_at: Instant,
    }

    /// A host that was killed leaves its exclusive lock; after this silence the lock is removed.
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
                received_at: Instant::now(),
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

        fn lost(&self, error: Errno) -> PortError {
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
                    self.received_at = Instant::now();
                    Ok(count)
                }
                Err(Errno::AGAIN | Errno::INTR) => {
                    if self.received_at.elapsed() > SILENCE {
                        self.received_at = Instant::now();
                        let _ = ioctl_tiocnxcl(&self.host_side);
                    }
                    Ok(0)
                }
                Err(error) => Err(self.lost(error)),
            }
        }

        fn write(&mut self, bytes: &[u8], wait: Duration) -> Result<usize, PortError> {
            if !wait.is_zero() {
                self.ready(PollFlags::OUT, wait);
            }
            match rustix::io::write(&self.device, bytes) {
                Ok(count) => Ok(count),
                Err(Errno::AGAIN | Errno::INTR) => Ok(0),
                Err(error) => Err(self.lost(error)),
            }
        }

        fn name(&self) -> &str {
            &self.path
        }
    }
}
