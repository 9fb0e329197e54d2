//! Errors between host and controller, with their messages.

use haptimill_protocol::message::{HelloRefusal, PROTOCOL_VERSION, Refusal};
use std::fmt;

/// Quality of the line.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LineHealth {
    /// Corrupt frames that were received.
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
    /// No answer to the Hello.
    NoAnswer {
        /// Time waited, microseconds.
        waited_us: u64,
    },
    /// The controller refuses the session.
    Refused {
        /// Why.
        why: HelloRefusal,
        /// Protocol version of the controller.
        version: u16,
    },
    /// The controller sends nothing any more.
    Silent {
        /// Duration of the silence, microseconds.
        silent_us: u64,
        /// Quality of the line before.
        line: LineHealth,
    },
    /// The controller answers, but messages are not delivered.
    Stalled {
        /// Quality of the line.
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
                "no controller answered within {:.1} s; \
                 check the port, its speed and the controller's power",
                *waited_us as f64 * 1e-6
            ),
            Self::Refused {
                why: HelloRefusal::Version,
                version,
            } => write!(
                f,
                "the controller uses version {version} of the protocol, this host version {PROTOCOL_VERSION}; \
                 use host and firmware of one release"
            ),
            Self::Refused { why, .. } => write!(f, "the controller refuses the session: {why}"),
            Self::Silent { silent_us, line } => {
                let seconds = *silent_us as f64 * 1e-6;
                if line.bad_frames == 0 {
                    write!(
                        f,
                        "nothing was received from the controller for {seconds:.1} s; \
                         check the cable and the controller's power"
                    )
                } else {
                    write!(
                        f,
                        "no intact frame was received from the controller for {seconds:.1} s, and the line was \
                         bad before ({line}); check cable, shield and speed, and the controller's power"
                    )
                }
            }
            Self::Stalled { line } => write!(
                f,
                "the line has too many errors: the controller answers, but messages are not delivered ({line}); \
                 check cable, shield and speed"
            ),
        }
    }
}

impl std::error::Error for ClientError {}

/// Why a request failed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RequestError {
    /// The controller refused it.
    Refused(Refusal),
    /// The controller did not acknowledge it.
    NoAnswer {
        /// Name of its command.
        command: &'static str,
        /// Time waited, microseconds.
        waited_us: u64,
        /// Quality of the line.
        line: LineHealth,
    },
    /// An out-of-band stop preceded its transmission.
    Withdrawn,
    /// The session ended.
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
            Self::Withdrawn => f.write_str("withdrawn because of an out-of-band stop"),
            Self::Lost(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for RequestError {}
