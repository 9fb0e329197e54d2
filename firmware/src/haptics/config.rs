//! Configuration of a haptic arm, and of a tool that a master moves.

use super::ForceFeedback;
use super::fixture::FixtureConfig;
use super::passivity::PassivityConfig;
use crate::io::LEGS;
use haptimill_kinematics::haptic_arm::{HapticGeometry, SLIDE_MAX};
use haptimill_math::force::Force;
use haptimill_math::{Coordinate, Effort, Length};
use serde::{Deserialize, Serialize};

/// Encoder of a leg.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Encoder {
    /// Axis units (2^-20 mm for the slide, 2^-32 turn for an angle) per count, times 2^24; negative
    /// if it counts backwards. Below 2^46 in magnitude.
    pub per_count: i64,
    /// Coordinate at the home of the handle, where the operator holds it when the configuration is
    /// activated.
    pub preset: Coordinate,
}

/// Current amplifier with its motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Amplifier {
    /// Effort at code 8192: 2^-16 N along the slide, 2^-16 N m about it; negative for reversed
    /// wiring.
    pub full_scale: Effort,
    /// Largest commanded effort.
    pub limit: Effort,
}

/// Configuration of a haptic arm.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct HapticConfig {
    /// Dimensions of the arm.
    pub geometry: HapticGeometry,
    /// Encoders of each leg: slide d, theta3, theta4.
    pub sensors: [[Encoder; 3]; LEGS],
    /// Ranges of d, theta3 and theta4 in all legs: lower and upper end.
    pub ranges: [(Coordinate, Coordinate); 3],
    /// Motors of each leg: along the slide, and about it.
    pub drives: [[Amplifier; 2]; LEGS],
    /// Largest accepted number of illegal transitions of an encoder.
    pub illegal_transitions: u16,
    /// Largest condition number of the arm's statics, 2 to 1000 (20).
    pub condition: u16,
    /// Time constant of the filter of the master's rates, microseconds, 500 to 20,000 (5000).
    pub rate_filter_us: u16,
    /// Diameter of the ball at the tip: opposite faces of virtual fixtures keep this distance.
    pub ball: Length,
    /// Largest change of the force on the operator in a control period: to 0.05 N.
    pub step: Force,
    /// Force feedback law after a start.
    pub feedback: ForceFeedback,
    /// Virtual fixtures.
    pub fixture: FixtureConfig,
    /// Passivity observer and controller.
    pub passivity: PassivityConfig,
}

/// Master-to-tool mapping and tracking.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct FollowConfig {
    /// Position scale G_P of docs/control.md (3.1), 2^-12: 0.1 to 2 (1).
    pub scale: u16,
    /// Gain k of the two tracking stages, 1/s: 10 to 500 (100).
    pub gain: u16,
    /// Largest age of the newest sample of a remote master, milliseconds, 5 to 1000 (50).
    pub stale_ms: u16,
}

/// Whether a position scale is within 0.1 to 2.
#[must_use]
pub const fn scale_is_sound(scale: u16) -> bool {
    scale >= 410 && scale <= 2 << 12
}

impl FollowConfig {
    /// Whether all values are within their documented ranges.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        scale_is_sound(self.scale)
            && (10..=500).contains(&self.gain)
            && (5..=1000).contains(&self.stale_ms)
    }
}

impl HapticConfig {
    /// Whether all values are within their documented ranges.
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
            && super::feedback_law::is_sound(&self.feedback)
            && self.fixture.is_sound()
            && self.passivity.is_sound()
    }
}
