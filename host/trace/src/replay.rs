//! Replay of a recording: a new controller gets the recorded inputs, and its outputs are compared
//! with the recorded outputs, bit by bit.
//!
//! A recording is complete in itself: configuration and commands came over the serial line, whose
//! bytes are in the periods. Each period compares the drive commands, the spindle and the bytes
//! sent to the host; during the job also the snapshot of the controller (state, commanded and
//! measured values, following errors, forces). A controller on another target that gives the same
//! bits computes the same.
//!
//! A match shows that both controllers behave alike on these inputs. It does not show that they are
//! correct.

use crate::{Header, Period, Record, Recording, RecordingError, Records, first_unequal_field};
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::Outputs;
use serde::Serialize;
use std::fmt::{self, Write as _};
use std::iter::Peekable;

/// Result of a replay without a difference.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Match {
    /// Number of replayed periods.
    pub periods: u64,
    /// Number of records that were compared with snapshots of the controller.
    pub records: u64,
}

/// First difference of a replay.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Mismatch {
    /// Control period of the controller.
    pub period: u64,
    /// Seconds since the first period.
    pub time_s: f64,
    /// Name of the value that differs.
    pub field: String,
    /// Recorded value.
    pub recorded: String,
    /// Replayed value.
    pub replayed: String,
}

impl fmt::Display for Mismatch {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            out,
            "control period {} ({:.4} s): {} was {}, in the replay {}",
            self.period, self.time_s, self.field, self.recorded, self.replayed
        )
    }
}

/// Reason why a recording cannot be replayed.
#[derive(Debug)]
pub enum ReplayError {
    /// The recording cannot be read.
    Recording(RecordingError),
    /// The recording has no periods.
    NoPeriods(String),
    /// The recording does not begin at the power-on of its controller.
    NoBeginning(String, u64),
}

impl fmt::Display for ReplayError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Recording(error) => write!(out, "{error}"),
            Self::NoPeriods(why) => write!(out, "{why}"),
            Self::NoBeginning(file, period) => write!(
                out,
                "{file}: begins at control period {period} of its controller; it cannot be replayed without the periods before it"
            ),
        }
    }
}

impl std::error::Error for ReplayError {}

impl From<RecordingError> for ReplayError {
    fn from(error: RecordingError) -> Self {
        Self::Recording(error)
    }
}

/// Returns why a recording cannot be replayed; `None` if it has periods.
#[must_use]
pub fn why_not_replayable(recording: &Recording) -> Option<String> {
    if recording.periods() > 0 {
        return None;
    }
    let file = recording.path().display();
    Some(if recording.records() == 0 {
        format!("{file}: has no records")
    } else {
        format!(
            "{file}: has the telemetry of its controller, but not its inputs: it was recorded \
             through a port, of a controller that had run for long, or with --record every or \
             last; it cannot be replayed. Recordings of `haptimill run` without --port or with pil: \
             can"
        )
    })
}

/// Replays a recording up to its end.
///
/// # Errors
///
/// Returns an error if the recording cannot be read or does not have all periods.
pub fn replay(recording: &Recording) -> Result<Result<Match, Mismatch>, ReplayError> {
    if let Some(why) = why_not_replayable(recording) {
        return Err(ReplayError::NoPeriods(why));
    }
    let mut controller = Controller::new(recording.config().period_us);
    let mut outputs = Outputs::default();
    let mut records = recording.iter()?.peekable();
    let mut equal = Match {
        periods: 0,
        records: 0,
    };
    let mut first = None;
    for period in recording.read_periods()? {
        let period = period?;
        let number = period.inputs.period;
        // The first period has number 0, or the number of periods missed before it.
        if first.is_none() && number != u64::from(period.inputs.missed) {
            let file = recording.path().display().to_string();
            return Err(ReplayError::NoBeginning(file, number));
        }
        let first_period = *first.get_or_insert(number);
        // As on every board: sent bytes are removed, other outputs stay until they change.
        outputs.transmit.clear();
        controller.tick(&period.inputs, &mut outputs, &mut ());
        let at = |(field, recorded, replayed)| Mismatch {
            period: number,
            time_s: number.wrapping_sub(first_period) as f64 * recording.period_s(),
            field,
            recorded,
            replayed,
        };
        if let Some(difference) = compare_outputs(&period.outputs, &outputs, recording.header()) {
            return Ok(Err(at(difference)));
        }
        equal.periods += 1;
        if let Some(record) = record_of(&mut records, number)? {
            if let Some(difference) = compare_snapshots(&controller, &period, &record, recording) {
                return Ok(Err(at(difference)));
            }
            equal.records += 1;
        }
    }
    Ok(Ok(equal))
}

/// Returns the record of a period, if there is one.
fn record_of(
    records: &mut Peekable<Records>,
    period: u64,
) -> Result<Option<Record>, RecordingError> {
    while let Some(next) = records.next_if(|next| match next {
        Ok(record) => record.period <= period,
        Err(_) => true,
    }) {
        let record = next?;
        if record.period == period {
            return Ok(Some(record));
        }
    }
    Ok(None)
}

/// Returns the first output that differs.
fn compare_outputs(
    recorded: &Outputs,
    replayed: &Outputs,
    header: &Header,
) -> Option<(String, String, String)> {
    if recorded == replayed {
        return None;
    }
    let axes = recorded.joints.iter().zip(&replayed.joints).enumerate();
    for (axis, (one, other)) in axes {
        if one != other {
            let name = header.joints.get(axis);
            let name = name.cloned().unwrap_or_else(|| axis.to_string());
            return Some((
                format!("the command to drive {name}"),
                format!("{one:?}"),
                format!("{other:?}"),
            ));
        }
    }
    if recorded.spindle_rpm != replayed.spindle_rpm {
        return Some((
            "the spindle".to_string(),
            recorded.spindle_rpm.to_string(),
            replayed.spindle_rpm.to_string(),
        ));
    }
    if recorded.digital != replayed.digital {
        return Some((
            "the digital outputs".to_string(),
            format!("{:#010x}", recorded.digital),
            format!("{:#010x}", replayed.digital),
        ));
    }
    if recorded.analog != replayed.analog {
        return Some((
            "the analog outputs".to_string(),
            format!("{:?}", recorded.analog),
            format!("{:?}", replayed.analog),
        ));
    }
    let (one, other) = (&recorded.haptic, &replayed.haptic);
    if one.enabled != other.enabled {
        return Some((
            "the motors of the haptic arm".to_string(),
            on_off(one.enabled).to_string(),
            on_off(other.enabled).to_string(),
        ));
    }
    for (leg, (one, other)) in one.currents.iter().zip(&other.currents).enumerate() {
        for (kind, (one, other)) in ["force", "torque"].iter().zip(one.iter().zip(other)) {
            if one != other {
                return Some((
                    format!("the {kind} current of leg {} of the haptic arm", leg + 1),
                    one.to_string(),
                    other.to_string(),
                ));
            }
        }
    }
    if recorded.transmit != replayed.transmit {
        return Some((
            "the bytes sent to the host".to_string(),
            hexadecimal(&recorded.transmit),
            hexadecimal(&replayed.transmit),
        ));
    }
    Some((
        "the outputs".to_string(),
        format!("{recorded:?}"),
        format!("{replayed:?}"),
    ))
}

const fn on_off(enabled: bool) -> &'static str {
    if enabled { "on" } else { "off" }
}

fn hexadecimal(bytes: &[u8]) -> String {
    if bytes.is_empty() {
        return "nothing".to_string();
    }
    let mut text = String::new();
    for byte in bytes {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
    }
    text
}

/// Returns the first value of the controller's snapshot that differs.
fn compare_snapshots(
    controller: &Controller,
    period: &Period,
    record: &Record,
    recording: &Recording,
) -> Option<(String, String, String)> {
    let Some(snapshot) = controller.snapshot(&period.inputs) else {
        let field = "the configuration".to_string();
        return Some((field, "active".to_string(), "none".to_string()));
    };
    let mut now = *record;
    now.set_snapshot(period.inputs.period, &snapshot);
    if !recording.header().has_haptic_arm {
        // Records of version 5 have no haptic arm; its motor commands are compared in the outputs.
        (now.haptic, now.haptic_flags) = (record.haptic, record.haptic_flags);
    }
    first_unequal_field(record, &now, recording)
}

#[cfg(test)]
mod tests;
