//! How a job ended.

use super::{ClientError, RequestError};
use haptimill_protocol::setpoint::SetpointError;
use std::fmt;

/// How a job ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum JobEnding {
    /// The last setpoint was reached, at standstill.
    Done {
        /// Number of the job, as in `JobStart`.
        job: u32,
        /// Number of setpoints that were reached.
        setpoints: u32,
    },
    /// The controller dropped the job, after a stop or a fault that it reports as an event.
    Dropped {
        /// Number of the job, as in `JobStart`.
        job: u32,
        /// Number of setpoints that were reached.
        setpoints: u32,
    },
    /// The controller refused its start, a setpoint, or its end; the machine was stopped.
    Refused {
        /// Number of the job, as in `JobStart`.
        job: u32,
        /// The refused request, and the reason.
        error: RequestError,
    },
    /// A setpoint cannot be encoded; the machine was stopped.
    Setpoint {
        /// Number of the job, as in `JobStart`.
        job: u32,
        /// Number of the setpoint.
        setpoint: u32,
        /// The reason: no duration, or a wrong number of coordinates.
        error: SetpointError,
    },
    /// The session ended.
    Lost {
        /// Number of the job, as in `JobStart`.
        job: u32,
        /// The end of the session.
        error: ClientError,
    },
}

impl fmt::Display for JobEnding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Done { setpoints, .. } => write!(f, "done, {setpoints} setpoints"),
            Self::Dropped { setpoints, .. } => write!(f, "dropped after {setpoints} setpoints"),
            Self::Refused { error, .. } => write!(f, "refused: {error}"),
            Self::Setpoint {
                setpoint, error, ..
            } => write!(f, "setpoint {setpoint} cannot be sent: {error}"),
            Self::Lost { error, .. } => error.fmt(f),
        }
    }
}
