//! What goes wrong at the haptic arm: its nine encoders and its amplifiers. A machine without such an arm does not notice.

use super::text::{Keys, Word};
use super::{Channel, Level};
use core::fmt;
use serde::{Deserialize, Serialize};

/// What goes wrong at the haptic arm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum HapticFault {
    /// A channel of an encoder stands still.
    EncoderStuck {
        /// The encoder.
        #[serde(flatten)]
        place: HapticEncoder,
        /// The channel.
        channel: Channel,
        /// The level at which it stands.
        level: Level,
    },
    /// The channels of an encoder are swapped: it counts backwards.
    EncoderSwapped(HapticEncoder),
    /// A counter jumps, once.
    EncoderSlip {
        /// The encoder.
        #[serde(flatten)]
        place: HapticEncoder,
        /// By how much.
        counts: i32,
    },
    /// The plug of an encoder is out: both channels low.
    EncoderDropped(HapticEncoder),
    /// Noise pulses on A, B or both.
    EncoderNoise {
        /// The encoder.
        #[serde(flatten)]
        place: HapticEncoder,
        /// How many, on average.
        #[serde(rename = "per-second")]
        per_second: f64,
    },
    /// The amplifiers give nothing, and say so.
    AmplifiersTripped,
}

/// One of the nine encoders.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct HapticEncoder {
    /// The leg, 1 to 3.
    pub leg: u8,
    /// Which of the leg's.
    pub sensor: HapticSensor,
}

/// Encoder of a leg.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HapticSensor {
    /// The slide d.
    Slide,
    /// The turn theta3.
    Turn,
    /// The hinge theta4.
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
    /// The encoder that it is about, if it is about one.
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

    /// Reads the keys of a fault whose name is `hand-` and this.
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
            _ => return Err(format!("hand-{name} is in the catalogue only")),
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
                    "hand-encoder-stuck {place} channel={channel} level={level}"
                )
            }
            Self::EncoderSwapped(place) => write!(f, "hand-encoder-swapped {place}"),
            Self::EncoderSlip { place, counts } => {
                write!(f, "hand-encoder-slip {place} counts={counts}")
            }
            Self::EncoderDropped(place) => write!(f, "hand-encoder-dropped {place}"),
            Self::EncoderNoise { place, per_second } => {
                write!(f, "hand-encoder-noise {place} per-second={per_second}")
            }
            Self::AmplifiersTripped => f.write_str("hand-amplifiers-tripped"),
        }
    }
}
