//! Replaying a recording: a new controller is given what the recorded one sensed, and must say what that one said, bit by bit.
//!
//! The recording needs nothing beside it. What the recorded controller had as configuration came over its serial line, and the line is in the periods; so is
//! every command. What is compared in each period: the command to each drive, the spindle, the bytes said to the host, and, once the job is recorded, what the
//! controller knew of itself (state, wanted and measured, following errors, forces). A controller on another target that leaves the same bits
//! is thereby shown to be this one.
//!
//! Misuse: equal says that this program and the one that recorded behave alike on these inputs, not that either of them is right.

use crate::{Header, Period, Record, Recording, RecordingError, Records, unequal};
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::Outputs;
use serde::Serialize;
use std::fmt::{self, Write as _};
use std::iter::Peekable;

/// A controller that said the same.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Equal {
    /// Periods that were replayed.
    pub periods: u64,
    /// Records that were compared with what the controller knew of itself.
    pub records: u64,
}

/// Where a controller said something else first.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Unequal {
    /// Control period of the controller.
    pub period: u64,
    /// Seconds since the first period.
    pub time_s: f64,
    /// What differs.
    pub field: String,
    /// As it was recorded.
    pub recorded: String,
    /// As it is now.
    pub replayed: String,
}

impl fmt::Display for Unequal {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            out,
            "control period {} ({:.4} s): {} was {}, the replay says {}",
            self.period, self.time_s, self.field, self.recorded, self.replayed
        )
    }
}

/// Why a recording cannot be replayed.
#[derive(Debug)]
pub enum ReplayError {
    /// It cannot be read.
    Recording(RecordingError),
    /// It has no periods.
    NoPeriods(String),
    /// It does not begin at the power-on of its controller.
    NoBeginning(String, u64),
}

impl fmt::Display for ReplayError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Recording(error) => write!(out, "{error}"),
            Self::NoPeriods(why) => write!(out, "{why}"),
            Self::NoBeginning(file, period) => write!(
                out,
                "{file}: begins at control period {period} of its controller; what came before is not in it, so it cannot be replayed"
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

/// Why a recording has no periods, in words; `None` when it has some.
#[must_use]
pub fn not_replayable(recording: &Recording) -> Option<String> {
    if recording.periods() > 0 {
        return None;
    }
    let file = recording.path().display();
    Some(if recording.records() == 0 {
        format!("{file}: nothing was recorded in it")
    } else {
        format!(
            "{file}: has only what its controller reported, not what it sensed: it was recorded through a port, or of a controller that had run for long; \
             it cannot be replayed. Recordings of `haptimill run` without --port or with pil: can"
        )
    })
}

/// Replays a recording as far as it goes.
///
/// # Errors
/// It cannot be read, or has not what a replay needs.
pub fn replay(recording: &Recording) -> Result<Result<Equal, Unequal>, ReplayError> {
    if let Some(why) = not_replayable(recording) {
        return Err(ReplayError::NoPeriods(why));
    }
    let mut controller = Controller::new(recording.config().period_us);
    let mut outputs = Outputs::default();
    let mut records = recording.iter()?.peekable();
    let mut equal = Equal {
        periods: 0,
        records: 0,
    };
    let mut first = None;
    for period in recording.read_periods()? {
        let period = period?;
        let number = period.inputs.period;
        // The first one is numbered 0, or by those that were missed before it.
        if first.is_none() && number != u64::from(period.inputs.missed) {
            let file = recording.path().display().to_string();
            return Err(ReplayError::NoBeginning(file, number));
        }
        let begun = *first.get_or_insert(number);
        // As on every board: bytes of before are gone, the rest stays until it is said anew.
        outputs.transmit.clear();
        controller.tick(&period.inputs, &mut outputs, &mut ());
        let at = |(field, recorded, replayed)| Unequal {
            period: number,
            time_s: number.wrapping_sub(begun) as f64 * recording.period_s(),
            field,
            recorded,
            replayed,
        };
        if let Some(difference) = said(&period.outputs, &outputs, recording.header()) {
            return Ok(Err(at(difference)));
        }
        equal.periods += 1;
        if let Some(record) = record_of(&mut records, number)? {
            if let Some(difference) = known(&controller, &period, &record, recording) {
                return Ok(Err(at(difference)));
            }
            equal.records += 1;
        }
    }
    Ok(Ok(equal))
}

/// The record of a period, if there is one.
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

/// The first thing that was said otherwise.
fn said(
    recorded: &Outputs,
    replayed: &Outputs,
    header: &Header,
) -> Option<(String, String, String)> {
    if recorded == replayed {
        return None;
    }
    let axes = recorded.axes.iter().zip(&replayed.axes).enumerate();
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
    let (one, other) = (&recorded.haptic, &replayed.haptic);
    if one.enabled != other.enabled {
        return Some((
            "the motors of the haptic arm".to_string(),
            on(one.enabled).to_string(),
            on(other.enabled).to_string(),
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
            "what was said to the host".to_string(),
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

const fn on(enabled: bool) -> &'static str {
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

/// The first thing that the controller knew otherwise of itself.
fn known(
    controller: &Controller,
    period: &Period,
    record: &Record,
    recording: &Recording,
) -> Option<(String, String, String)> {
    let Some(reading) = controller.snapshot(&period.inputs) else {
        let field = "the configuration".to_string();
        return Some((field, "active".to_string(), "none".to_string()));
    };
    let mut now = *record;
    now.set_reading(period.inputs.period, &reading);
    if !recording.header().hand {
        // Recorded before there were hands in records; what the arm's motors were told is compared all the same.
        (now.hand, now.hand_flags) = (record.hand, record.hand_flags);
    }
    unequal(record, &now, recording)
}

#[cfg(test)]
mod tests;
