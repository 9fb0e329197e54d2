//! Sentences of the haptic arm.

use super::{Amount, AxesText, AxisKind, Describe};
use crate::haptic::MasterProblem;
use core::fmt::{Formatter, Result};

/// Quantity that an encoder of a leg measures.
const fn sensor(index: u8) -> &'static str {
    match index {
        0 => "slide",
        1 => "rotation theta3",
        _ => "link angle theta4",
    }
}

impl Describe for MasterProblem {
    fn describe(&self, _: &AxesText<'_>, f: &mut Formatter<'_>) -> Result {
        match *self {
            Self::Encoder { leg, by } => {
                let by = Amount {
                    value: by,
                    kind: AxisKind::Linear,
                };
                let leg = leg + 1;
                write!(
                    f,
                    "an encoder of leg {leg} of the haptic arm is wrong: a side of the platform appears \
                     {by} too long; check it for a jump, a stuck channel and its counting direction, \
                     and configure the controller with the arm at its home"
                )
            }
            Self::Illegal { leg, sensor: index } => write!(
                f,
                "the encoder of the {} of leg {} of the haptic arm made illegal transitions; check its cable and shield",
                sensor(index),
                leg + 1
            ),
            Self::Range { leg, sensor: index } => write!(
                f,
                "the {} of leg {} of the haptic arm is out of its range; \
                 move the handle to its home and configure again",
                sensor(index),
                leg + 1
            ),
            Self::Singular => f.write_str(
                "the handle is near a singularity of the haptic arm; move it towards the middle",
            ),
            Self::Drive => {
                f.write_str("an amplifier of the haptic arm reports a fault; check the amplifiers")
            }
        }
    }
}
