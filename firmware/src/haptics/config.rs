//! The configuration of a haptic arm, and of a tool that a hand leads.

use super::Reflection;
use super::passivity::PassivityConfig;
use super::walls::WallConfig;
use crate::io::LEGS;
use haptimill_kinematics::haptic_arm::{HapticGeometry, SLIDE_MAX};
use haptimill_math::force::Force;
use haptimill_math::{Coordinate, Effort, Length};
use serde::{Deserialize, Serialize};

/// An encoder of a leg.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Encoder {
    /// Axis units (2^-20 mm for the slide, 2^-32 turn for an angle) per count, times 2^24; negative when it counts backwards. Below 2^46.
    pub per_count: i64,
    /// Coordinate at the handle's home, where the operator holds it when the configuration is activated.
    pub preset: Coordinate,
}

/// A current amplifier with its motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Amplifier {
    /// Effort at code 8192: 2^-16 N along the slide, 2^-16 N m about it; negative when it is wired the other way round.
    pub full_scale: Effort,
    /// Largest effort that may be commanded.
    pub limit: Effort,
}

/// A haptic arm.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct HapticConfig {
    /// Lengths.
    pub geometry: HapticGeometry,
    /// Of each leg the encoders of the slide d, of theta3 and of theta4.
    pub sensors: [[Encoder; 3]; LEGS],
    /// Where d, theta3 and theta4 may be, of all legs: lower and upper end.
    pub ranges: [(Coordinate, Coordinate); 3],
    /// Of each leg the motors along the slide and about it.
    pub drives: [[Amplifier; 2]; LEGS],
    /// Illegal transitions of an encoder that are still borne.
    pub illegal_transitions: u16,
    /// Largest condition number of the arm's statics, 2 to 1000 (20).
    pub condition: u16,
    /// Time constant of the filter of the hand's rates, microseconds, 500 to 20,000 (5000).
    pub rate_filter_us: u16,
    /// Diameter of the ball at the tip: virtual walls leave it room.
    pub ball: Length,
    /// The most that the force at the hand changes in a period: to 0.05 N.
    pub step: Force,
    /// What part of the force on the tool is felt, at the start.
    pub reflection: Reflection,
    /// Virtual walls.
    pub wall: WallConfig,
    /// The energy at the hand.
    pub passivity: PassivityConfig,
}

/// How a tool follows a hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct FollowConfig {
    /// G_P of docs/control.md (3.1), 2^-12: 0.1 to 2 (1).
    pub scale: u16,
    /// k of the two stages of the following, 1/s: 10 to 500 (100).
    pub gain: u16,
    /// How old the newest word of a hand afar may be, milliseconds, 5 to 1000 (50).
    pub stale_ms: u16,
}

/// Whether a position scale is within 0.1 to 2.
#[must_use]
pub const fn scale_is_sound(scale: u16) -> bool {
    scale >= 410 && scale <= 2 << 12
}

impl FollowConfig {
    /// Whether all is within the ranges that it names.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        scale_is_sound(self.scale)
            && (10..=500).contains(&self.gain)
            && (5..=1000).contains(&self.stale_ms)
    }
}

impl HapticConfig {
    /// Whether all is within the ranges that it names.
    #[must_use]
    #[cold]
    pub fn is_sound(&self) -> bool {
        let slide = SLIDE_MAX.0;
        let ranges = self.ranges.iter().all(|(low, high)| low < high)
            && self.ranges[0].0.0 >= -slide
            && self.ranges[0].1.0 <= slide;
        let sensor = |(encoder, (low, high)): (&Encoder, &(Coordinate, Coordinate))| {
            (1 << 12..1 << 46).contains(&encoder.per_count.unsigned_abs())
                && (low..=high).contains(&&encoder.preset)
        };
        let sensors = self
            .sensors
            .iter()
            .all(|leg| leg.iter().zip(&self.ranges).all(sensor));
        let drive = |drive: &Amplifier| {
            drive.full_scale.0 != i32::MIN
                && drive.limit.0 > 0
                && drive.limit.0 <= drive.full_scale.0.abs()
        };
        self.geometry.is_sound()
            && ranges
            && sensors
            && self.drives.iter().flatten().all(drive)
            && self.illegal_transitions <= 1000
            && (2..=1000).contains(&self.condition)
            && (500..=20_000).contains(&self.rate_filter_us)
            && (0..=50 << 20).contains(&self.ball.0)
            && (1..=3277).contains(&self.step.0)
            && super::feedback_law::is_sound(&self.reflection)
            && self.wall.is_sound()
            && self.passivity.is_sound()
    }
}
