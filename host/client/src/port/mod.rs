//! Byte transports: a serial port, a TCP connection, and the two ends that a served simulator listens on.
//!
//! A transport carries bytes and knows nothing of frames. Both directions wait at most as long as they are told, zero included, so
//! one thread can serve a transport and everything else. Misuse: bytes that were taken by [`Transport::write`] are on their way, not
//! delivered; only the link above knows what arrived.

mod serial;
mod serve;
mod tcp;
mod token;

pub use serial::{SerialTransport, list};
#[cfg(unix)]
pub use serve::PtyServer;
pub use serve::TcpServer;
pub use tcp::TcpTransport;
pub use token::{TOKEN_VARIABLE, Token, use_token};

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

/// What a served TCP port says to a second host before it closes the connection.
pub const BUSY: &[u8] = b"haptimill: busy: another host is connected; try again when it has gone\n";

/// What it says to a host without the token.
pub const DENIED: &[u8] =
    b"haptimill: denied: this port asks for a token; give it with --token or HAPTIMILL_TOKEN\n";

/// What it says to a connection that opens no session.
pub const SLOW: &[u8] = b"haptimill: closed: no session was opened within 2 s\n";

/// What it says to a host that fell silent.
pub const CLOSED: &[u8] = b"haptimill: closed: nothing was heard of this host for too long\n";

/// The baud rate of a serial port when none is given.
pub const DEFAULT_BAUD: u32 = 115_200;

/// Carries bytes both ways.
pub trait Transport: Send {
    /// Reads what has arrived, waiting at most `wait` for the first byte. 0 means that nothing came.
    ///
    /// # Errors
    /// The transport is gone for good; open it again.
    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> Result<usize, PortError>;

    /// Writes as much as is taken within `wait`, and says how much that was.
    ///
    /// # Errors
    /// The transport is gone for good; open it again.
    fn write(&mut self, bytes: &[u8], wait: Duration) -> Result<usize, PortError>;

    /// What people call it: a path or an address.
    fn name(&self) -> &str;
}

/// Where a controller is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PortSpec {
    /// The built-in simulator, in this process.
    Simulator,
    /// The built-in simulator around a controller on an emulated board.
    Emulated(Board),
    /// A TCP port, `HOST:PORT`.
    Tcp(String),
    /// A serial port or pseudo-terminal, by its path (on Windows its name).
    Serial(String),
}

/// A board that can be emulated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Board {
    /// The MPS2 with a Cortex-M4F.
    Mps2,
    /// The MPS2 with a Cortex-M7; it runs the same image.
    Mps2M7,
}

impl Board {
    /// What the chores call its image.
    #[must_use]
    pub const fn name(self) -> &'static str {
        "mps2"
    }

    /// The sources of its image.
    #[must_use]
    pub const fn folder(self) -> &'static str {
        "firmware/boards/mps2"
    }

    /// What the emulator calls it.
    #[must_use]
    pub const fn machine(self) -> &'static str {
        match self {
            Self::Mps2 => "mps2-an386",
            Self::Mps2M7 => "mps2-an500",
        }
    }
}

impl fmt::Display for Board {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Mps2 => "pil:mps2",
            Self::Mps2M7 => "pil:mps2-m7",
        })
    }
}

impl FromStr for PortSpec {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "sim" {
            return Ok(Self::Simulator);
        }
        if let Some(board) = text.strip_prefix("pil:") {
            return match board {
                "mps2" => Ok(Self::Emulated(Board::Mps2)),
                "mps2-m7" => Ok(Self::Emulated(Board::Mps2M7)),
                _ => Err(
                    "emulated boards are pil:mps2 (Cortex-M4F) and pil:mps2-m7 (Cortex-M7)"
                        .to_string(),
                ),
            };
        }
        if let Some(address) = text.strip_prefix("tcp:") {
            let port = address.rsplit_once(':').and_then(|(host, port)| {
                (!host.is_empty()).then_some(())?;
                port.parse::<u16>().ok()
            });
            return match port {
                Some(_) => Ok(Self::Tcp(address.to_string())),
                None => Err("write tcp:HOST:PORT, for instance tcp:localhost:7000".to_string()),
            };
        }
        if text.is_empty() {
            return Err("write sim, tcp:HOST:PORT, or the path of a serial port".to_string());
        }
        Ok(Self::Serial(text.to_string()))
    }
}

impl fmt::Display for PortSpec {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Simulator => write!(out, "sim"),
            Self::Emulated(board) => write!(out, "{board}"),
            Self::Tcp(address) => write!(out, "tcp:{address}"),
            Self::Serial(path) => write!(out, "{path}"),
        }
    }
}

/// Opens the port of a spec. The built-in simulator is no port: it runs in this process.
///
/// # Errors
/// See [`PortError`]; [`PortError::NoPort`] for [`PortSpec::Simulator`].
pub fn open(spec: &PortSpec, baud: u32) -> Result<Box<dyn Transport>, PortError> {
    match spec {
        PortSpec::Simulator | PortSpec::Emulated(_) => Err(PortError::NoPort),
        PortSpec::Tcp(address) => Ok(Box::new(TcpTransport::connect(address)?)),
        PortSpec::Serial(path) => Ok(Box::new(SerialTransport::open(path, baud)?)),
    }
}

/// Sends the urgent stop to a port that another host has, some times over: its lock keeps commands out, not a stop.
///
/// # Errors
/// The port cannot be written to at all.
pub fn stop_past_lock(spec: &PortSpec) -> Result<(), PortError> {
    const TIMES: u32 = 5;
    const PAUSE: Duration = Duration::from_millis(20);
    let failed = |error: std::io::Error| PortError::Open {
        name: spec.to_string(),
        reason: error.to_string(),
        remedy: "use the emergency stop of the machine",
    };
    let repeat = |out: &mut dyn std::io::Write| -> std::io::Result<()> {
        for _ in 0..TIMES {
            out.write_all(&haptimill_protocol::urgent::STOP)?;
            out.flush()?;
            std::thread::sleep(PAUSE);
        }
        Ok(())
    };
    match spec {
        PortSpec::Simulator | PortSpec::Emulated(_) => Err(PortError::NoPort),
        PortSpec::Tcp(address) => std::net::TcpStream::connect(address)
            .and_then(|mut stream| {
                use std::io::Write as _;
                if let Some(token) = token::token() {
                    stream.write_all(&token.line())?;
                }
                repeat(&mut stream)
            })
            .map_err(failed),
        PortSpec::Serial(path) => std::fs::OpenOptions::new()
            .write(true)
            .open(path)
            .and_then(|mut file| repeat(&mut file))
            .map_err(failed),
    }
}

/// Why a port cannot be used (any more).
#[derive(Debug)]
pub enum PortError {
    /// The built-in simulator was asked for where a running controller is needed.
    NoPort,
    /// It cannot be opened.
    Open {
        /// The port.
        name: String,
        /// Why.
        reason: String,
        /// What to do.
        remedy: &'static str,
    },
    /// Another program has it.
    Busy {
        /// The port.
        name: String,
    },
    /// It asks for a token.
    Denied {
        /// The port.
        name: String,
    },
    /// The controller of a simulated machine has failed.
    Failed {
        /// The controller.
        name: String,
        /// What it said of that.
        reason: String,
    },
    /// The other end has gone.
    Gone {
        /// The port.
        name: String,
        /// How that was seen.
        reason: String,
    },
}

impl fmt::Display for PortError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoPort => write!(
                out,
                "the built-in simulator, emulated boards included, lives only inside `haptimill run`; start one with `haptimill sim serve` and give its port"
            ),
            Self::Open {
                name,
                reason,
                remedy,
            } => write!(out, "{name}: cannot be opened: {reason}; {remedy}"),
            Self::Busy { name } if name.starts_with("tcp:") => write!(
                out,
                "{name}: another host is connected to it; end that one, then try again (`haptimill stop` is heard all the same)"
            ),
            Self::Busy { name } => write!(
                out,
                "{name}: another program has it; close that program (`fuser {name}` names it), then try again (`haptimill stop` is heard all the same)"
            ),
            Self::Denied { name } => write!(
                out,
                "{name}: asks for a token; give that of `haptimill sim serve` with --token, or in {TOKEN_VARIABLE}"
            ),
            Self::Failed { name, reason } => write!(
                out,
                "{name}: the controller has failed, its drives are off: {reason}"
            ),
            Self::Gone { name, reason } => write!(
                out,
                "{name}: the other end has gone ({reason}); check the cable and the power, then try again"
            ),
        }
    }
}

impl std::error::Error for PortError {}

/// Times out or would block: nothing happened, and nothing is wrong.
fn is_quiet(error: &std::io::Error) -> bool {
    use std::io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(error.kind(), Interrupted | TimedOut | WouldBlock)
}

#[cfg(test)]
mod tests;
