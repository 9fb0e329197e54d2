//! Sentences of the haptic arm.

use super::{Amount, Axes, AxisKind, Describe};
use crate::haptic::MasterProblem;
use core::fmt::{Formatter, Result};

/// Quantity that an encoder of a leg measures.
const fn sensor(index: u8) -> &'static str {
    match index {
        0 => "slide",
        1 => "turn of the slide",
        _ => "lean of the link",
    }
}

impl Describe for MasterProblem {
    fn describe(&self, _: &Axes<'_>, f: &mut Formatter<'_>) -> Result {
        match *self {
            Self::Encoder { leg, by } => {
                let by = Amount {
                    value: by,
                    kind: AxisKind::Linear,
                };
                let leg = leg + 1;
                write!(
                    f,
                    "an encoder of leg {leg} of the haptic arm cannot be right: a side of the handle seems {by} too long; it jumped, sticks or counts the wrong way, or the arm did not stand at its home when it was configured"
                )
            }
            Self::Illegal { leg, sensor: index } => write!(
                f,
                "the encoder of the {} of leg {} of the haptic arm made impossible steps; check its cable and shield",
                sensor(index),
                leg + 1
            ),
            Self::Range { leg, sensor: index } => write!(
                f,
                "the {} of leg {} of the haptic arm is where it cannot be; bring the handle to its home and configure again",
                sensor(index),
                leg + 1
            ),
            Self::Singular => f.write_str(
                "the handle is near a position in which the arm cannot hold it; bring it back towards the middle",
            ),
            Self::Drive => f.write_str("an amplifier of the haptic arm reports a fault; look at the amplifiers"),
        }
    }
}
