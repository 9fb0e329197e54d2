//! Refusals, faults and events as sentences, with the remedy where there is one.
//!
//! `Display` of these types names joints and coordinates by number, from 1, and omits amounts,
//! because it does not know the axis units. [`AxesText::describe`] knows the machine: it adds their
//! names, and amounts in millimetres or degrees.
//!
//! ```
//! use haptimill_protocol::message::Fault;
//! use haptimill_protocol::text::{AxesText, AxisText, AxisKind};
//! let joint = [AxisText { name: "joint 1", kind: AxisKind::Linear }];
//! let axes = AxesText { joints: &joint, ..AxesText::default() };
//! let fault = Fault::SoftLimit { coordinate: 4 };
//! assert_eq!(
//!     fault.to_string(),
//!     "coordinate 5 left its soft limits; reset, then jog it back"
//! );
//! let fault = Fault::FollowingError { joint: 0, error: -(3 << 20), limit: 1 << 20 };
//! assert_eq!(
//!     axes.describe(&fault).to_string(),
//!     "the following error of joint 1 is -3.000 mm (at most 1.000 mm); \
//!      remove what blocks the joint, then reset and home"
//! );
//! ```

mod drive_alarm;
mod force;
mod haptic;
mod plain;
mod refusal;
mod report;

use crate::force::{ForceProblem, ForceRefusal, TareRefusal};
use crate::haptic::MasterProblem;
use crate::message::{ConfigProblem, Event, Fault, HelloRefusal, PoseError, Refusal};
use core::fmt::{Display, Formatter, Result};
use serde::{Deserialize, Serialize};

/// Linear or rotary.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum AxisKind {
    /// Axis units are 2^-20 mm; the range is +-2048 mm.
    #[default]
    Linear,
    /// Axis units are 2^-32 turn. The range is one turn, and differences take the shorter way
    /// round.
    Rotary,
    /// Rotary, multi-turn: axis units are 2^-22 turn, and the range is +-512 turns. The
    /// arithmetic is that of a linear axis.
    MultiTurn,
}

impl AxisKind {
    /// Whether the axis turns: its quantities are in degrees in files and messages.
    #[must_use]
    pub const fn is_rotary(self) -> bool {
        matches!(self, Self::Rotary | Self::MultiTurn)
    }

    /// Whether a full turn leads to the same coordinate, so that sums wrap around.
    #[must_use]
    pub const fn is_circular(self) -> bool {
        matches!(self, Self::Rotary)
    }

    /// Axis units by which a commanded pose may be beyond a soft limit: 2^-9 mm, or 2^-21 turn
    /// (0.0002 degrees), or 2^-20 turn of a multi-turn coordinate. A path that touches the
    /// limit passes it by less between its setpoints, and in the rounding of a change of curvature.
    #[must_use]
    pub const fn soft_limit_tolerance(self) -> i32 {
        match self {
            Self::Linear | Self::Rotary => 1 << 11,
            Self::MultiTurn => 1 << 2,
        }
    }

    /// Binary logarithm of the axis units per millimetre or per turn.
    #[must_use]
    pub const fn unit_bits(self) -> u32 {
        match self {
            Self::Linear => 20,
            Self::Rotary => 32,
            Self::MultiTurn => 22,
        }
    }
}

/// Name and kind of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AxisText<'a> {
    /// Name.
    pub name: &'a str,
    /// Linear or rotary.
    pub kind: AxisKind,
}

/// Driver chip of a joint that the board sets, by its place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ChipText {
    /// Address at a one-wire UART.
    Address(u8),
    /// Position in a chain at an SPI.
    Position(u8),
}

/// Axes, inputs and outputs of a machine. The lists may be short or empty; a missing entry is
/// named by its number.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct AxesText<'a> {
    /// Pose coordinates.
    pub pose: &'a [AxisText<'a>],
    /// Joints.
    pub joints: &'a [AxisText<'a>],
    /// Sentences of the pose errors of the geometry, by their codes.
    pub pose_errors: &'a [&'a str],
    /// Driver chips of the joints; `None` for a joint without one.
    pub chips: &'a [Option<ChipText>],
    /// Names of the digital inputs.
    pub inputs: &'a [&'a str],
    /// Names of the digital outputs.
    pub outputs: &'a [&'a str],
    /// Names of the analog outputs.
    pub analog_outputs: &'a [&'a str],
}

impl<'a> AxesText<'a> {
    /// Returns the sentence of `Display` with names and amounts.
    pub fn describe<T: Describe>(&'a self, what: &'a T) -> Described<'a, T> {
        Described { axes: self, what }
    }
}

impl AxesText<'_> {
    const fn joint(&self, index: u8) -> Named<'_> {
        Named(self.joints, "joint", index)
    }

    const fn coordinate(&self, index: u8) -> Named<'_> {
        Named(self.pose, "coordinate", index)
    }

    /// An axis of force control: x, y or z, the first three coordinates.
    const fn axis(&self, index: u8) -> Named<'_> {
        Named(self.pose, "axis", index)
    }

    const fn input(&self, index: u8) -> NamedChannel<'_> {
        NamedChannel(self.inputs, "input", index)
    }

    const fn output(&self, index: u8) -> NamedChannel<'_> {
        NamedChannel(self.outputs, "output", index)
    }

    const fn analog_output(&self, index: u8) -> NamedChannel<'_> {
        NamedChannel(self.analog_outputs, "analog output", index)
    }
}

/// Displays an input or output by its name, or by its kind and its number from 1.
struct NamedChannel<'a>(&'a [&'a str], &'static str, u8);

impl Display for NamedChannel<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        match self.0.get(usize::from(self.2)) {
            Some(name) => f.write_str(name),
            None => write!(f, "{} {}", self.1, u32::from(self.2) + 1),
        }
    }
}

/// A sentence with the names of a machine's axes, from [`AxesText::describe`].
#[derive(Debug, Clone, Copy)]
pub struct Described<'a, T> {
    axes: &'a AxesText<'a>,
    what: &'a T,
}

impl<T: Describe> Display for Described<'_, T> {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        self.what.describe(self.axes, f)
    }
}

/// Types that have a sentence.
pub trait Describe {
    /// Writes the sentence, without a capital at its start or a full stop at its end.
    ///
    /// # Errors
    ///
    /// Those of the formatter.
    fn describe(&self, axes: &AxesText<'_>, f: &mut Formatter<'_>) -> Result;
}

/// A value in engineering units: millimetres or degrees, three decimals, exactly rounded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Amount {
    /// Axis units.
    pub value: i32,
    /// Kind of the axis.
    pub kind: AxisKind,
}

impl Display for Amount {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        // Thousandths, rounded half up: below 2^31 * 360,000 < 2^50.
        let (per_unit, unit) = if self.kind.is_rotary() {
            (360_000, "deg")
        } else {
            (1000, "mm")
        };
        let bits = self.kind.unit_bits();
        let thousandths = (i64::from(self.value) * per_unit + (1 << (bits - 1))) >> bits;
        let sign = if thousandths < 0 { "-" } else { "" };
        let size = thousandths.unsigned_abs();
        write!(f, "{sign}{}.{:03} {unit}", size / 1000, size % 1000)
    }
}

/// Displays a joint, a coordinate or an axis by its name, or by what it is and its number from 1.
struct Named<'a>(&'a [AxisText<'a>], &'static str, u8);

impl Display for Named<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        match self.0.get(usize::from(self.2)) {
            Some(axis) => f.write_str(axis.name),
            None => write!(f, "{} {}", self.1, u32::from(self.2) + 1),
        }
    }
}

/// Returns the amount if the kind of the axis is known.
fn amount(axes: &[AxisText<'_>], axis: u8, value: i32) -> Option<Amount> {
    let kind = axes.get(usize::from(axis))?.kind;
    Some(Amount { value, kind })
}

/// Implements `Display` without a machine, and the error trait where it applies.
macro_rules! display {
    ($($name:ident),*) => {$(
        impl Display for $name {
            fn fmt(&self, f: &mut Formatter<'_>) -> Result {
                self.describe(&AxesText::default(), f)
            }
        }
    )*};
}
display!(
    PoseError,
    Refusal,
    ConfigProblem,
    Fault,
    Event,
    ForceProblem,
    ForceRefusal,
    TareRefusal,
    MasterProblem
);

impl core::error::Error for PoseError {}
impl core::error::Error for Refusal {}
impl core::error::Error for HelloRefusal {}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::string::ToString;

    proptest! {
        #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

        /// An amount equals the value within half a thousandth when parsed as a decimal number.
        #[test]
        fn amounts_are_right(value: i32) {
            for (kind, scale, unit) in [(AxisKind::Linear, 1048576.0, " mm"), (AxisKind::Rotary, 4294967296.0 / 360.0, " deg"), (AxisKind::MultiTurn, 4194304.0 / 360.0, " deg")] {
                let text = Amount { value, kind }.to_string();
                let read: f64 = text.strip_suffix(unit).unwrap().parse().unwrap();
                prop_assert!((read - f64::from(value) / scale).abs() <= 0.0005 + 1e-9, "{} for {}", text, value);
            }
        }
    }

    #[test]
    fn names_are_used_where_they_are_known() {
        let slide = [AxisText {
            name: "l1",
            kind: AxisKind::Linear,
        }];
        let axes = AxesText {
            joints: &slide,
            ..AxesText::default()
        };
        let error = PoseError::OutOfStroke {
            joint: 0,
            by: 1 << 19,
        };
        let refusal = Refusal::Pose {
            setpoint: 12,
            error,
        };
        assert_eq!(
            axes.describe(&refusal).to_string(),
            "setpoint 12: l1 would leave its stroke by 0.500 mm; \
             move the workpiece towards the middle of the workspace"
        );
        assert!(
            refusal
                .to_string()
                .starts_with("setpoint 12: joint 1 would leave its stroke;")
        );
    }
}
