//! The configuration of a controller: everything that makes it this machine and not another.
//!
//! The host makes it from a machine file, sends it in pieces, and the controller checks it (`Config::check`) before it becomes active at a
//! period boundary. All values are integers in the scales stated here, so a configuration has one encoding (postcard) and one CRC-32.

mod check;
pub mod digest;

use crate::force::ForceConfig;
use crate::haptics::config::{FollowConfig, HapticConfig};
use haptimill_kinematics::{BoundedKinematics, JointLimits, Model};
use haptimill_math::{Acceleration, Coordinate, Effort, Gain, Rate};
use haptimill_protocol::message::MAX_AXES;
use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

/// Whether this controller was built with the haptic arm (feature `hand`).
///
/// Without it a configuration with a haptic arm is refused, and the compiler omits its code.
pub const HAND: bool = cfg!(feature = "hand");

/// Everything that makes a controller this machine.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Config {
    /// Name of the machine.
    pub name: String<24>,
    /// Control period in microseconds, 50 to 1000.
    pub period_us: u16,
    /// The geometry.
    pub model: Model,
    /// The pose coordinates, in the model's order.
    pub pose: Vec<PoseAxis, MAX_AXES>,
    /// The joints, in the model's order.
    pub joints: Vec<JointAxis, MAX_AXES>,
    /// Stops and their bounds.
    pub stopping: Stopping,
    /// Limits of supervision.
    pub supervision: Supervision,
    /// How the reference is found.
    pub homing: Homing,
    /// Force sensor and force control, if the machine has them.
    pub force: Option<ForceConfig>,
    /// How the tool follows a hand, if one can lead it.
    #[cfg_attr(not(feature = "hand"), serde(deserialize_with = "absent"))]
    pub follow: Option<FollowConfig>,
    /// The haptic arm, if there is one.
    #[cfg_attr(not(feature = "hand"), serde(deserialize_with = "absent"))]
    pub haptic: Option<HapticConfig>,
}

/// Linear or rotary.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum AxisKind {
    /// Axis units are 2^-20 mm.
    Linear,
    /// Axis units are 2^-32 turn.
    Rotary,
}

impl Config {
    /// The geometry of this machine with the limits of its joints.
    #[must_use]
    pub fn kinematics(&self) -> BoundedKinematics {
        let limits = self.joints.iter().map(|joint| JointLimits {
            low: joint.low,
            high: joint.high,
            rate: joint.rate,
        });
        BoundedKinematics::new(&self.model, limits)
    }
}

/// A pose coordinate: its soft limits and what a jog may ask of it.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct PoseAxis {
    /// Linear or rotary.
    pub kind: AxisKind,
    /// Lower soft limit.
    pub low: Coordinate,
    /// Upper soft limit.
    pub high: Coordinate,
    /// Largest rate, of a program or a jog.
    pub rate: Rate,
    /// Largest acceleration of a jog.
    pub acceleration: Acceleration,
    /// Largest jerk of a jog, in the scale of [`JERK_SHIFT`].
    pub jerk: u32,
}

/// A jerk is in axis units per second cubed divided by 2^16: 2^-4 mm/s^3, or 2^-16 turn/s^3.
pub const JERK_SHIFT: u32 = 16;

/// A joint: its screw, encoder, drive, loop and limits.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct JointAxis {
    /// Linear or rotary.
    pub kind: AxisKind,
    /// Lower end of the stroke.
    pub low: Coordinate,
    /// Upper end of the stroke.
    pub high: Coordinate,
    /// Largest rate.
    pub rate: Rate,
    /// Axis units per encoder count, times 2^24; negative when the encoder counts backwards.
    pub per_count: i64,
    /// Whole width of the backlash of the screw; the encoder sits on the motor side. 0 switches compensation off.
    pub backlash: Coordinate,
    /// What drives it.
    pub drive: Drive,
    /// Its position loop.
    pub law: ServoConfig,
    /// Largest following error at standstill.
    pub following: Coordinate,
    /// The limit grows with the wanted rate: this many 2^-16 seconds of travel are added.
    pub following_lag: u32,
    /// Motion of this much wanted with the encoder still is an encoder fault.
    pub still: Coordinate,
    /// Coordinate at the home preset (the distance that the operator sets up before power on).
    pub preset: Coordinate,
    /// Coordinate of the index pulse nearest the preset.
    pub index: Coordinate,
    /// Distance from one index pulse to the next (one turn of the motor).
    pub index_pitch: Coordinate,
    /// Counts by which an index pulse may be off its place, its own width included; less than a quarter of a turn. 0: pulses are only looked for, and never compared with the counts.
    pub index_slack: u16,
    /// How far a found index may be from where the preset says; less than half the pitch.
    pub search: Coordinate,
}

/// What drives a joint.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Drive {
    /// A current-mode amplifier behind a 14-bit DAC.
    Torque {
        /// Effort at code 8192; negative when the amplifier is wired the other way round.
        full_scale: Effort,
        /// Largest effort that may be commanded.
        limit: Effort,
    },
    /// A step/direction drive.
    Steps {
        /// Axis units per step, times 2^24; negative when a positive step goes down.
        per_step: i64,
        /// Ticks of the step clock per microsecond, 1 to 1000.
        ticks_per_us: u16,
        /// Least width of a pulse, and least time between two, in ticks.
        pulse: u16,
        /// Direction level before the first pulse, in ticks.
        setup: u16,
        /// Direction level after the last pulse, in ticks.
        hold: u16,
        /// Disagreement of steps and encoder that means lost steps.
        lost: Coordinate,
    },
}

/// The position loop of a joint (docs/control.md 3.1, 3.2).
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ServoConfig {
    /// Which form.
    pub form: ServoForm,
    /// K_P in 1/s^2.
    pub kp: Gain,
    /// K_D in 1/s.
    pub kd: Gain,
    /// Time constant of the first-order filter on the rate of the error, in microseconds; 0 is none.
    pub rate_filter_us: u16,
    /// Inertia: effort units per acceleration unit, times 2^20 (1 kg on a linear axis: 0.016 * 2^20).
    pub inertia: u32,
    /// Viscous friction: effort units per rate unit, times 2^24.
    pub viscous: u32,
    /// Coulomb friction that is compensated.
    pub coulomb: Effort,
    /// Rate at which the compensation has reached tanh(1) of its full value.
    pub coulomb_rate: Rate,
    /// K_I in 1/s^3: an integrator with conditional anti-windup; 0 is none (the thesis has none).
    pub ki: Gain,
}

/// The two forms of the position loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ServoForm {
    /// (3.29) with the corrected sign: inertia * (K_P e + K_D e') + friction compensation.
    Pd,
    /// (3.35)-(3.37): inertia * (l_e'' + K_D e' + K_P e) + viscous l_e' + friction compensation.
    ModelBased,
}

/// How the machine slows down along its path.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Stopping {
    /// Time from the programmed speed to rest, in milliseconds, 5 to 2000; sets the greatest change of the path rate.
    pub time_ms: u16,
    /// Part of that time in which the braking builds up (and dies away), in milliseconds; sets the jerk.
    pub ramp_ms: u16,
}

/// Limits of supervision.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Supervision {
    /// Silence of the host that ends a job or a jog, in milliseconds.
    pub heartbeat_ms: u16,
    /// Control periods missed in a row that are a fault.
    pub missed_periods: u16,
    /// Illegal encoder transitions since enable that are a fault.
    pub illegal_transitions: u16,
}

/// How fast the pose moves while the index pulses are looked for.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Homing {
    /// Rate of linear coordinates.
    pub rate: Rate,
    /// Rate of rotary coordinates.
    pub table_rate: Rate,
}

/// A part that this controller was built without: it is not there, or the configuration cannot be read. Nothing of the part is decoded, which saves the code for it.
#[cfg(not(feature = "hand"))]
fn absent<'de, D: serde::Deserializer<'de>, T>(deserializer: D) -> Result<Option<T>, D::Error> {
    enum Never {}
    impl<'de> Deserialize<'de> for Never {
        fn deserialize<D: serde::Deserializer<'de>>(_: D) -> Result<Self, D::Error> {
            Err(serde::de::Error::custom("built without it"))
        }
    }
    Ok(Option::<Never>::deserialize(deserializer)?.map(|never| match never {}))
}
