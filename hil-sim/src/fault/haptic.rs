//! Faults of the haptic arm: its nine encoders and its amplifiers. They have no effect on a machine
//! without such an arm.

use super::text::{Keys, Word};
use super::{Channel, Level};
use core::fmt;
use serde::{Deserialize, Serialize};

/// A fault of the haptic arm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum HapticFault {
    /// A channel of an encoder is stuck.
    EncoderStuck {
        /// Encoder with the fault.
        #[serde(flatten)]
        place: HapticEncoder,
        /// Stuck channel.
        channel: Channel,
        /// Level at which it is stuck.
        level: Level,
    },
    /// The channels of an encoder are swapped: it counts backwards.
    EncoderSwapped(HapticEncoder),
    /// The counter of an encoder slips once.
    EncoderSlip {
        /// Encoder with the fault.
        #[serde(flatten)]
        place: HapticEncoder,
        /// Counts added to the counter.
        counts: i32,
    },
    /// An encoder is unplugged: both channels are low.
    EncoderDropped(HapticEncoder),
    /// Noise pulses on A, B or both.
    EncoderNoise {
        /// Encoder with the fault.
        #[serde(flatten)]
        place: HapticEncoder,
        /// Mean rate, 1/s.
        #[serde(rename = "per-second")]
        per_second: f64,
    },
    /// The amplifiers give no current and report a trip.
    AmplifiersTripped,
}

/// One of the nine encoders.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct HapticEncoder {
    /// Leg, 1 to 3.
    pub leg: u8,
    /// Encoder of the leg.
    pub sensor: HapticSensor,
}

/// Encoder of a leg.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HapticSensor {
    /// Encoder of the slide d.
    Slide,
    /// Encoder of the turn theta3.
    Turn,
    /// Encoder of the hinge theta4.
    Hinge,
}

impl Word for HapticSensor {
    const WORDS: &'static [(&'static str, Self)] = &[
        ("slide", Self::Slide),
        ("turn", Self::Turn),
        ("hinge", Self::Hinge),
    ];
}

impl HapticEncoder {
    fn read(keys: &mut Keys<'_>) -> Result<Self, String> {
        Ok(Self {
            leg: keys.number("leg")?,
            sensor: keys.word("sensor")?,
        })
    }
}

impl fmt::Display for HapticEncoder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "leg={} sensor={}", self.leg, self.sensor.word())
    }
}

impl HapticFault {
    /// Encoder of the fault, if it has one.
    pub const fn encoder(&self) -> Option<HapticEncoder> {
        match self {
            Self::EncoderStuck { place, .. }
            | Self::EncoderSwapped(place)
            | Self::EncoderSlip { place, .. }
            | Self::EncoderDropped(place)
            | Self::EncoderNoise { place, .. } => Some(*place),
            Self::AmplifiersTripped => None,
        }
    }

    /// Reads the keys of the fault `haptic-` + `name`.
    pub(super) fn read(name: &str, keys: &mut Keys<'_>) -> Result<Self, String> {
        Ok(match name {
            "encoder-stuck" => Self::EncoderStuck {
                place: HapticEncoder::read(keys)?,
                channel: keys.word("channel")?,
                level: keys.word("level")?,
            },
            "encoder-swapped" => Self::EncoderSwapped(HapticEncoder::read(keys)?),
            "encoder-slip" => Self::EncoderSlip {
                place: HapticEncoder::read(keys)?,
                counts: keys.number("counts")?,
            },
            "encoder-dropped" => Self::EncoderDropped(HapticEncoder::read(keys)?),
            "encoder-noise" => Self::EncoderNoise {
                place: HapticEncoder::read(keys)?,
                per_second: keys.number("per-second")?,
            },
            "amplifiers-tripped" => Self::AmplifiersTripped,
            _ => return Err(format!("haptic-{name} is in the catalogue only")),
        })
    }
}

impl fmt::Display for HapticFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::EncoderStuck {
                place,
                channel,
                level,
            } => {
                let (channel, level) = (channel.word(), level.word());
                write!(
                    f,
                    "haptic-encoder-stuck {place} channel={channel} level={level}"
                )
            }
            Self::EncoderSwapped(place) => write!(f, "haptic-encoder-swapped {place}"),
            Self::EncoderSlip { place, counts } => {
                write!(f, "haptic-encoder-slip {place} counts={counts}")
            }
            Self::EncoderDropped(place) => write!(f, "haptic-encoder-dropped {place}"),
            Self::EncoderNoise { place, per_second } => {
                write!(f, "haptic-encoder-noise {place} per-second={per_second}")
            }
            Self::AmplifiersTripped => f.write_str("haptic-amplifiers-tripped"),
        }
    }
}
