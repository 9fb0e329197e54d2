//! Comparison of two recordings. The same job on two targets must give the same bits.

use super::{Axes, Record, Recording, RecordingError};
use std::fmt;

/// The first difference of two recordings.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// Number of the record, from 0.
    pub record: u64,
    /// Control period of the record in the first recording.
    pub period: u64,
    /// Name of the field, with its axis.
    pub field: String,
    /// Its value in the first recording.
    pub first: String,
    /// Its value in the second recording.
    pub second: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            out,
            "record {}, control period {}: {} is {} in the first, {} in the second",
            self.record, self.period, self.field, self.first, self.second
        )
    }
}

/// Returns the first difference of the records of two recordings. Headers are not compared.
///
/// # Errors
///
/// Returns an error if a recording cannot be read.
pub fn difference(
    first: &Recording,
    second: &Recording,
) -> Result<Option<Difference>, RecordingError> {
    for (number, (one, other)) in first.iter()?.zip(second.iter()?).enumerate() {
        let (one, other) = (one?, other?);
        if one != other {
            let Some((field, first, second)) = first_unequal_field(&one, &other, first) else {
                continue;
            };
            return Ok(Some(Difference {
                record: number as u64,
                period: one.period,
                field,
                first,
                second,
            }));
        }
    }
    let (records, others) = (first.records(), second.records());
    Ok((records != others).then(|| Difference {
        record: records.min(others),
        period: 0,
        field: "number of records".to_string(),
        first: records.to_string(),
        second: others.to_string(),
    }))
}

/// Returns the first field in which two records differ, with both values.
#[must_use]
pub fn first_unequal_field(
    one: &Record,
    other: &Record,
    recording: &Recording,
) -> Option<(String, String, String)> {
    let plain = [
        ("period", one.period.to_string(), other.period.to_string()),
        (
            "state",
            format!("{:?}", one.state),
            format!("{:?}", other.state),
        ),
        (
            "flags",
            format!("{:#010b}", one.flags),
            format!("{:#010b}", other.flags),
        ),
        (
            "flags of the haptic arm",
            one.haptic_flags.to_string(),
            other.haptic_flags.to_string(),
        ),
        (
            "setpoint",
            one.setpoint.to_string(),
            other.setpoint.to_string(),
        ),
        ("line", one.line.to_string(), other.line.to_string()),
        (
            "speed factor",
            one.speed_factor.to_string(),
            other.speed_factor.to_string(),
        ),
        (
            "spindle",
            one.spindle_rpm.to_string(),
            other.spindle_rpm.to_string(),
        ),
    ];
    if let Some((name, first, second)) = plain.into_iter().find(|(_, a, b)| a != b) {
        return Some((name.to_string(), first, second));
    }
    let header = recording.header();
    let rows: [(&str, &[String], &Axes, &Axes); 7] = [
        ("measured joint", &header.joints, &one.joints, &other.joints),
        (
            "commanded pose",
            &header.pose,
            &one.commanded,
            &other.commanded,
        ),
        (
            "commanded joint",
            &header.joints,
            &one.joints_commanded,
            &other.joints_commanded,
        ),
        (
            "following error",
            &header.joints,
            &one.following_error,
            &other.following_error,
        ),
        ("drive command", &header.joints, &one.drive, &other.drive),
        ("tool", &header.pose, &one.tool, &other.tool),
        (
            "programmed pose",
            &header.pose,
            &one.programmed,
            &other.programmed,
        ),
    ];
    for (name, axes, first, second) in rows {
        for (axis, (first, second)) in first.iter().zip(second).enumerate() {
            if first != second {
                let axis = axes.get(axis).cloned().unwrap_or_else(|| axis.to_string());
                return Some((
                    format!("{name} {axis}"),
                    first.to_string(),
                    second.to_string(),
                ));
            }
        }
    }
    let forces = [
        ("peak force", &one.force.high, &other.force.high),
        ("low force", &one.force.low, &other.force.low),
        (
            "compliant displacement",
            &one.force.displacement,
            &other.force.displacement,
        ),
        ("true force", &one.true_force, &other.true_force),
        ("tip of the handle", &one.haptic.tip, &other.haptic.tip),
        (
            "force on the operator",
            &one.haptic.force,
            &other.haptic.force,
        ),
        (
            "force feedback",
            &one.haptic.feedback,
            &other.haptic.feedback,
        ),
        (
            "virtual fixture force",
            &one.haptic.fixture,
            &other.haptic.fixture,
        ),
    ];
    for (name, first, second) in forces {
        for (axis, (first, second)) in ["x", "y", "z"].iter().zip(first.iter().zip(second)) {
            if first != second {
                return Some((
                    format!("{name} {axis}"),
                    first.to_string(),
                    second.to_string(),
                ));
            }
        }
    }
    None
}
