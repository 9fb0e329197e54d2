//! The device's end, for a simulator that is served in real time: a pseudo-terminal, or a TCP listener.
//!
//! A second host is sent away, but a stop that it sends is heard: whoever can reach the port can stop the machine.
//!
//! Both outlive their hosts: while none is there, reading gives nothing and what is written is thrown away, as on a cable that is not plugged in.

use super::{BUSY, PortError, TcpTransport, Transport};
use haptimill_protocol::urgent::{STOP, UrgentDetector};
use std::io::Write;
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

#[cfg(unix)]
pub use pty::PtyServer;

/// Serves one host at a time on a TCP port; a second one is told that it is busy and closed.
pub struct TcpServer {
    name: String,
    listener: TcpListener,
    host: Option<TcpTransport>,
    asked: Instant,
    /// A host that was sent away asked for an urgent stop.
    stop: Arc<AtomicBool>,
}

/// How often a listener looks for a new host while it has one.
const ACCEPT_EVERY: Duration = Duration::from_millis(10);

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
            host: None,
            asked: Instant::now(),
            stop: Arc::new(AtomicBool::new(false)),
        })
    }

    /// Where it listens.
    ///
    /// # Errors
    /// The system does not tell.
    pub fn address(&self) -> std::io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Takes a host that waits, or sends it away.
    fn accept(&mut self) {
        if self.host.is_some() && self.asked.elapsed() < ACCEPT_EVERY {
            return;
        }
        self.asked = Instant::now();
        while let Ok((stream, peer)) = self.listener.accept() {
            if self.host.is_some() {
                send_away(stream, Arc::clone(&self.stop));
            } else if stream.set_nonblocking(false).is_ok() {
                self.host = TcpTransport::new(stream, format!("tcp:{peer}")).ok();
            }
        }
    }
}

/// Says why, and closes. What the other end sent meanwhile is not read: closing would then reset the connection and lose the reason, so
/// only the sending half is closed and the rest is left to the other end.
fn send_away(mut stream: TcpStream, stop: Arc<AtomicBool>) {
    let _ = stream.set_write_timeout(Some(Duration::from_millis(20)));
    let _ = stream.set_nonblocking(false);
    let _ = stream.write_all(BUSY);
    let _ = stream.shutdown(Shutdown::Write);
    // A short-lived thread drains what was sent, so that the reason is not overtaken by a reset; a stop among it counts.
    std::thread::spawn(move || {
        use std::io::Read;
        let _ = stream.set_read_timeout(Some(Duration::from_millis(500)));
        let mut waste = [0; 256];
        let mut urgent = UrgentDetector::new();
        for _ in 0..64 {
            let Ok(count @ 1..) = stream.read(&mut waste) else {
                break;
            };
            if urgent.push_all(&waste[..count]) {
                stop.store(true, Ordering::Relaxed);
            }
        }
    });
}

impl Transport for TcpServer {
    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> Result<usize, PortError> {
        self.accept();
        if buffer.len() >= STOP.len() && self.stop.swap(false, Ordering::Relaxed) {
            buffer[..STOP.len()].copy_from_slice(&STOP);
            return Ok(STOP.len());
        }
        let Some(host) = &mut self.host else {
            std::thread::sleep(wait.min(ACCEPT_EVERY));
            return Ok(0);
        };
        match host.read(buffer, wait) {
            Ok(count) => Ok(count),
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
