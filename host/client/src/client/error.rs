//! What can go wrong between host and controller, in words.

use haptimill_protocol::message::{HelloRefusal, PROTOCOL_VERSION, Refusal};
use std::fmt;

/// How the line did until something went wrong on it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LineHealth {
    /// Broken frames that were received.
    pub bad_frames: u32,
    /// Frames that were sent again.
    pub resent: u32,
}

impl fmt::Display for LineHealth {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { bad_frames, resent } = self;
        write!(f, "{bad_frames} broken frames, {resent} sent again")
    }
}

/// Why there is no session, or no job.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ClientError {
    /// No session is open, or it was closed from this side.
    Closed,
    /// A job runs already.
    JobRuns,
    /// Nothing answered the greeting.
    NoAnswer {
        /// How long was waited, microseconds.
        waited_us: u64,
    },
    /// The controller refuses the session.
    Refused {
        /// Why.
        why: HelloRefusal,
        /// The protocol version it speaks.
        version: u16,
    },
    /// The controller fell silent.
    Silent {
        /// For how long, microseconds.
        silent_us: u64,
        /// How the line did before.
        line: LineHealth,
    },
    /// The controller lives, and a message cannot be brought over.
    Stalled {
        /// How the line did.
        line: LineHealth,
    },
}

impl fmt::Display for ClientError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Closed => f.write_str("not connected to a controller"),
            Self::JobRuns => f.write_str("a job runs already; stop it first"),
            Self::NoAnswer { waited_us } => write!(
                f,
                "no controller answered within {:.1} s; check the port, its speed and that the controller has power",
                *waited_us as f64 * 1e-6
            ),
            Self::Refused {
                why: HelloRefusal::Version,
                version,
            } => write!(
                f,
                "the controller speaks version {version} of the protocol, this host version {PROTOCOL_VERSION}; use the host and the firmware of one release"
            ),
            Self::Refused { why, .. } => write!(f, "the controller refuses the session: {why}"),
            Self::Silent { silent_us, line } => {
                let seconds = *silent_us as f64 * 1e-6;
                if line.bad_frames == 0 {
                    write!(
                        f,
                        "nothing was heard from the controller for {seconds:.1} s; check the cable and the controller's power"
                    )
                } else {
                    write!(
                        f,
                        "no whole frame was heard from the controller for {seconds:.1} s, and the line was bad before ({line}); check cable, shield and speed, and the controller's power"
                    )
                }
            }
            Self::Stalled { line } => write!(
                f,
                "the line is too bad: the controller is there, but messages do not get through ({line}); check cable, shield and speed"
            ),
        }
    }
}

impl std::error::Error for ClientError {}

/// Why a request came to nothing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RequestError {
    /// The controller refused it.
    Refused(Refusal),
    /// The controller took it and did not answer.
    NoAnswer {
        /// What it was called.
        command: &'static str,
        /// How long was waited, microseconds.
        waited_us: u64,
        /// How the line did.
        line: LineHealth,
    },
    /// An urgent stop came before it was sent.
    Withdrawn,
    /// The session ended first.
    Lost(ClientError),
}

impl fmt::Display for RequestError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Refused(refusal) => refusal.fmt(f),
            Self::NoAnswer {
                command,
                waited_us,
                line,
            } => {
                let seconds = *waited_us as f64 * 1e-6;
                write!(
                    f,
                    "the controller did not answer the command '{command}' within {seconds:.1} s"
                )?;
                if line.bad_frames > 0 {
                    write!(
                        f,
                        ": the line is bad ({line}); check cable, shield and speed"
                    )?;
                }
                Ok(())
            }
            Self::Withdrawn => f.write_str("withdrawn: an urgent stop came first"),
            Self::Lost(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for RequestError {}
