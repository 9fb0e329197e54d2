//! Byte transports: serial ports, TCP connections, and the two kinds of port of a served simulator.
//!
//! A transport carries bytes without framing. Both directions have a timeout, which may be zero, so
//! one thread can serve a transport and everything else. Bytes that [`Transport::write`] accepted
//! are not delivered yet: the link above acknowledges what arrived.

#[cfg(unix)]
mod control;
mod observers;
mod serial;
mod serve;
mod tcp;
mod token;

#[cfg(unix)]
pub use control::{Control, ask};
pub use observers::{MAX_UNREAD, Observers};
pub use serial::{Flow, SerialTransport, board_of, list, list_of};
#[cfg(unix)]
pub use serve::PtyServer;
pub use serve::TcpServer;
pub use tcp::TcpTransport;
pub use token::{TOKEN_VARIABLE, Token, use_token};

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

/// Message of a served TCP port to a second host, before it closes the connection.
pub const BUSY: &[u8] =
    b"haptimill: busy: another host is connected; try again when it has disconnected\n";

/// Message to a host without the token.
pub const DENIED: &[u8] =
    b"haptimill: denied: this port requires a token; give it with --token or HAPTIMILL_TOKEN\n";

/// Message to a connection that opens no session.
pub const SLOW: &[u8] = b"haptimill: closed: no session was opened within 2 s\n";

/// Message to a host that sends nothing.
pub const CLOSED: &[u8] = b"haptimill: closed: nothing was received from this host for too long\n";

/// The baud rate of a serial port when none is given.
pub const DEFAULT_BAUD: u32 = 115_200;

/// A bidirectional byte channel.
pub trait Transport: Send {
    /// Reads received bytes, waiting at most `wait` for the first one. Returns their number.
    ///
    /// # Errors
    /// The transport failed for good; open it again.
    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> Result<usize, PortError>;

    /// Writes as many bytes as are accepted within `wait`, and returns their number.
    ///
    /// # Errors
    /// The transport failed for good; open it again.
    fn write(&mut self, bytes: &[u8], wait: Duration) -> Result<usize, PortError>;

    /// Its name: a path or an address.
    fn name(&self) -> &str;
}

/// The port of a controller.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PortSpec {
    /// The built-in simulator, in this process.
    Simulator,
    /// The built-in simulator with a controller on an emulated board.
    Emulated(Board),
    /// A simulated machine behind the pins of an emulated board.
    EmulatedPins,
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
    /// The MPS2 with a Cortex-M7, with the same image.
    Mps2M7,
}

impl Board {
    /// Name of its image in `cargo xtask`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        "mps2"
    }

    /// Folder of the sources of its image.
    #[must_use]
    pub const fn folder(self) -> &'static str {
        "firmware/boards/mps2"
    }

    /// Its name in the emulator.
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
        if let Some(board) = text.strip_prefix("emu:") {
            return match board {
                "pico2" => Ok(Self::EmulatedPins),
                _ => Err("the board that is emulated with its pins is emu:pico2".to_string()),
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
            Self::EmulatedPins => write!(out, "emu:pico2"),
            Self::Tcp(address) => write!(out, "tcp:{address}"),
            Self::Serial(path) => write!(out, "{path}"),
        }
    }
}

/// Opens a port. The built-in simulator is no port: it runs in this process.
///
/// # Errors
/// See [`PortError`]; [`PortError::NoPort`] for [`PortSpec::Simulator`].
pub fn open(spec: &PortSpec, baud: u32) -> Result<Box<dyn Transport>, PortError> {
    match spec {
        PortSpec::Simulator | PortSpec::Emulated(_) | PortSpec::EmulatedPins => {
            Err(PortError::NoPort)
        }
        PortSpec::Tcp(address) => Ok(Box::new(TcpTransport::connect(address)?)),
        PortSpec::Serial(path) => Ok(Box::new(SerialTransport::open(path, baud)?)),
    }
}

/// Sends the out-of-band stop several times to a port that another host has locked: the lock does
/// not exclude a stop.
///
/// # Errors
/// The port cannot be written.
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
            out.write_all(&haptimill_protocol::out_of_band::STOP)?;
            out.flush()?;
            std::thread::sleep(PAUSE);
        }
        Ok(())
    };
    match spec {
        PortSpec::Simulator | PortSpec::Emulated(_) | PortSpec::EmulatedPins => {
            Err(PortError::NoPort)
        }
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

impl From<PortError> for crate::Error {
    fn from(error: PortError) -> Self {
        Self::new(crate::ErrorKind::Port, error)
    }
}

/// Why a port cannot be used.
#[derive(Debug)]
pub enum PortError {
    /// The built-in simulator was given where a running controller is needed.
    NoPort,
    /// It cannot be opened.
    Open {
        /// The port.
        name: String,
        /// Why.
        reason: String,
        /// The remedy.
        remedy: &'static str,
    },
    /// Another program uses it.
    Busy {
        /// The port.
        name: String,
    },
    /// It requires a token.
    Denied {
        /// The port.
        name: String,
    },
    /// No process takes requests for it.
    Uncommanded {
        /// The port.
        name: String,
        /// Why.
        reason: String,
    },
    /// The controller of a simulated machine has failed.
    Failed {
        /// The controller.
        name: String,
        /// Its message.
        reason: String,
    },
    /// The other end is gone.
    Gone {
        /// The port.
        name: String,
        /// How that was detected.
        reason: String,
    },
}

impl fmt::Display for PortError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoPort => write!(
                out,
                "the built-in simulator, emulated boards included, runs only inside `haptimill run`; start one with `haptimill sim serve` and give its port"
            ),
            Self::Open {
                name,
                reason,
                remedy,
            } => write!(out, "{name}: cannot be opened: {reason}; {remedy}"),
            Self::Busy { name } if name.starts_with("tcp:") => write!(
                out,
                "{name}: another host is connected to it; end that one, then try again \
                 (`haptimill stop` works meanwhile, and `haptimill watch` observes a `run --serve`)"
            ),
            Self::Busy { name } => write!(
                out,
                "{name}: another program uses it; close that program (`fuser {name}` names it), then try again \
                 (`haptimill stop` works meanwhile, and `haptimill watch` observes a `run --serve`)"
            ),
            Self::Denied { name } => write!(
                out,
                "{name}: requires a token; give that of `haptimill sim serve` with --token, or in {TOKEN_VARIABLE}"
            ),
            Self::Uncommanded { name, reason } => write!(
                out,
                "{name}: nothing was changed: {reason}; give the name of the port as \
                 `haptimill run` has it, while its job runs"
            ),
            Self::Failed { name, reason } => write!(
                out,
                "{name}: the controller has failed, its drives are off: {reason}"
            ),
            Self::Gone { name, reason } => write!(
                out,
                "{name}: the connection is lost ({reason}); check the cable and the power, then try again"
            ),
        }
    }
}

impl std::error::Error for PortError {}

/// Whether an error only means that nothing was transferred in time.
fn is_quiet(error: &std::io::Error) -> bool {
    use std::io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(error.kind(), Interrupted | TimedOut | WouldBlock)
}

#[cfg(test)]
mod tests;
