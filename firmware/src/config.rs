//! Configuration of a controller: all machine data.
//!
//! The host builds it from a machine file and sends it in chunks. The controller checks it
//! (`Config::check`) before it becomes active at the start of a control period. All values are
//! integers in the scales given here. A configuration therefore has one encoding (postcard) and one
//! CRC-32.

mod check;
mod drive_chip;
pub mod volumetric;

use crate::force::ForceConfig;
use crate::haptics::config::{FollowConfig, HapticConfig};
use crate::io::JointInputs;
use crate::named_io::config::IoConfig;
pub use drive_chip::{ChipKind, DriveChip};
pub use haptimill_kinematics::descriptor::AxisKind;
use haptimill_kinematics::{BoundedKinematics, JointLimits, Model};
use haptimill_math::{Acceleration, Coordinate, Effort, Gain, Rate};
use haptimill_protocol::message::MAX_AXES;
use heapless::{String, Vec};
use serde::{Deserialize, Serialize};
use volumetric::VolumetricConfig;

/// Whether this controller was built with the haptic arm (feature `haptics`).
///
/// Without it the controller refuses a configuration with a haptic arm, and the compiler omits the
/// code of the arm.
pub const HAPTICS: bool = cfg!(feature = "haptics");

/// All machine data of a controller.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Config {
    /// Name of the machine.
    pub name: String<24>,
    /// Control period in microseconds, 50 to 1000.
    pub period_us: u16,
    /// The geometry.
    pub model: Model,
    /// Pose coordinates, in the order of the model.
    pub pose: Vec<PoseAxis, MAX_AXES>,
    /// Joints, in the order of the model; then the second motors of gantries.
    pub joints: Vec<JointSettings, MAX_AXES>,
    /// Deceleration of stops along the path.
    pub stopping: Stopping,
    /// Limits of supervision.
    pub supervision: Supervision,
    /// Rates of homing.
    pub homing: Homing,
    /// Force sensor and force control, if the machine has them.
    pub force: Option<ForceConfig>,
    /// Mapping from a master to the tool, if a master can move it.
    #[cfg_attr(not(feature = "haptics"), serde(deserialize_with = "absent"))]
    pub follow: Option<FollowConfig>,
    /// The haptic arm, if there is one.
    #[cfg_attr(not(feature = "haptics"), serde(deserialize_with = "absent"))]
    pub haptic: Option<HapticConfig>,
    /// Named inputs and outputs.
    pub io: IoConfig,
    /// Volumetric compensation, if the errors of the machine are known.
    pub volumetric: Option<VolumetricConfig>,
}

impl Config {
    /// Pose coordinates that wrap around, one bit each.
    #[must_use]
    pub fn wrapping(&self) -> u8 {
        let pose = self.pose.iter().enumerate();
        pose.fold(0, |mask, (index, coordinate)| {
            mask | u8::from(coordinate.wraps()) << index
        })
    }

    /// Joints that wrap around, one bit each.
    #[must_use]
    pub fn wrapping_joints(&self) -> u8 {
        let joints = self.joints.iter().enumerate();
        joints.fold(0, |mask, (index, joint)| {
            mask | u8::from(joint.wraps()) << index
        })
    }

    /// Kinematics of this machine, with the limits of its joints.
    #[must_use]
    pub fn kinematics(&self) -> BoundedKinematics {
        let joints = self.joints.iter().filter(|joint| joint.gantry.is_none());
        let limits = joints.map(|joint| JointLimits {
            low: joint.low,
            high: joint.high,
            rate: joint.rate,
        });
        BoundedKinematics::new(&self.model, limits)
    }
}

/// Pose coordinate: its soft limits, and the limits of its jogs.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct PoseAxis {
    /// Linear or rotary.
    pub kind: AxisKind,
    /// Lower soft limit.
    pub low: Coordinate,
    /// Upper soft limit.
    pub high: Coordinate,
    /// Maximum rate of a program or a jog.
    pub rate: Rate,
    /// Maximum acceleration of a jog.
    pub acceleration: Acceleration,
    /// Maximum jerk of a jog, in the scale of [`JERK_SHIFT`].
    pub jerk: u32,
}

impl PoseAxis {
    /// Whether the coordinate wraps around: it is rotary, and its limits are the whole circle.
    #[must_use]
    pub const fn wraps(&self) -> bool {
        is_circle(self.kind, self.low, self.high)
    }
}

impl JointSettings {
    /// Whether the joint wraps around: it is rotary, and its stroke is the whole circle.
    #[must_use]
    pub const fn wraps(&self) -> bool {
        is_circle(self.kind, self.low, self.high)
    }
}

const fn is_circle(kind: AxisKind, low: Coordinate, high: Coordinate) -> bool {
    kind.is_circular() && low.0 == i32::MIN && high.0 == i32::MAX
}

/// Binary scale of a jerk: axis units per second cubed divided by 2^16. The unit is 2^-4 mm/s^3 or
/// 2^-16 turn/s^3.
pub const JERK_SHIFT: u32 = 16;

/// Largest number of nodes of a backlash table.
pub const BACKLASH_NODES: usize = 16;

/// Steepest change of the backlash along the stroke is 2 to the power of minus this: with that
/// slope the rates of motor and joint differ by 0.2 %.
pub const BACKLASH_SLOPE_SHIFT: u32 = 8;

/// Joint: its screw, drive, servo loop, limits, and its encoder if it has one.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct JointSettings {
    /// Linear or rotary.
    pub kind: AxisKind,
    /// Lower end of the stroke.
    pub low: Coordinate,
    /// Upper end of the stroke.
    pub high: Coordinate,
    /// Maximum rate.
    pub rate: Rate,
    /// Full width of the backlash of the screw. The encoder sits on the motor side. 0 switches the
    /// compensation off.
    pub backlash: Coordinate,
    /// Backlash at evenly spaced places from the lower to the upper end of the stroke, linear
    /// between them, none above `backlash`. Empty where it is the same everywhere.
    pub backlash_table: Vec<Coordinate, BACKLASH_NODES>,
    /// The drive.
    pub drive: Drive,
    /// The servo loop; a step drive has its own and ignores this one.
    pub law: ServoConfig,
    /// Coordinate at the home pose. The operator sets a joint that homes by its index pulse or by
    /// its preset to it before power-on.
    pub preset: Coordinate,
    /// How the joint finds its reference.
    pub home: Home,
    /// The encoder. Without one the joint is open loop: it has a step drive, and its position is
    /// the count of the emitted steps.
    pub encoder: Option<EncoderSettings>,
    /// Switches whose line is low when they are active, by their [bits](SwitchInput::bit).
    pub active_low: u8,
    /// Open loop only: the joint cannot move while its drive is off, and the drive keeps its
    /// electrical angle. Otherwise the position is lost with the drives off.
    pub keeps_position: bool,
    /// The joint is no joint of the model but the second motor of a gantry.
    pub gantry: Option<GantryAxis>,
}

/// Second motor of a gantry: it gets the joint motion of the first one.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct GantryAxis {
    /// Joint of the first motor, a joint of the model.
    pub of: u8,
    /// Largest racking: distance of the second motor from the first one, and during homing the
    /// difference of their motions.
    pub racking: Coordinate,
}

/// How a joint finds its reference.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Home {
    /// By the index pulse nearest to the preset.
    Index,
    /// Not at all: the joint is at its preset when the host commands homing.
    Preset,
    /// By a switch.
    Switch(SwitchHome),
    /// By a switch, and then by the next index pulse off the switch, which must come near its
    /// place.
    SwitchAndIndex(SwitchHome),
}

impl Home {
    /// The search for a switch, if the joint homes by one.
    #[must_use]
    pub const fn switch(&self) -> Option<&SwitchHome> {
        match self {
            Self::Switch(switch) | Self::SwitchAndIndex(switch) => Some(switch),
            Self::Index | Self::Preset => None,
        }
    }
}

/// Search of a joint for its switch.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct SwitchHome {
    /// The switch.
    pub input: SwitchInput,
    /// Joints with the lowest number are searched first, joints with one number together.
    pub order: u8,
    /// The joint moves down to its switch.
    pub downwards: bool,
    /// Coordinate where the switch becomes active on the way to it.
    pub coordinate: Coordinate,
    /// Rate to the switch, and off it.
    pub rate: Rate,
    /// Rate of the second touch, whose position is used.
    pub touch_rate: Rate,
    /// Acceleration of the search.
    pub acceleration: Acceleration,
    /// Distance off the released switch, between the touches and at the end.
    pub back_off: Coordinate,
    /// Largest distance within which the switch is released.
    pub release: Coordinate,
    /// Largest distance to the switch.
    pub travel: Coordinate,
}

/// Switch of a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum SwitchInput {
    /// [`crate::io::JointInputs::home`].
    Home,
    /// [`crate::io::JointInputs::limit_low`]; while the machine is not homed it is no fault.
    LimitLow,
    /// [`crate::io::JointInputs::limit_high`]; while the machine is not homed it is no fault.
    LimitHigh,
}

impl SwitchInput {
    /// Bit of the switch in [`JointSettings::active_low`].
    #[must_use]
    pub const fn bit(self) -> u8 {
        1 << self as u8
    }
}

impl JointSettings {
    /// The chip of the drive that the board sets, if there is one. A board without the bus of these
    /// chips must refuse the joint.
    #[must_use]
    pub const fn chip(&self) -> Option<&DriveChip> {
        match &self.drive {
            Drive::Steps { chip, .. } => chip.as_ref(),
            Drive::Torque { .. } => None,
        }
    }

    /// Whether the joint has no encoder: its position is the count of the emitted steps.
    #[must_use]
    pub const fn is_open_loop(&self) -> bool {
        self.encoder.is_none()
    }

    /// Whether the joint depends on limit switches: it searches one, or the line of one is low
    /// while it is active. A board that does not read them must refuse it.
    #[must_use]
    pub const fn needs_limit_switches(&self) -> bool {
        let limits = SwitchInput::LimitLow.bit() | SwitchInput::LimitHigh.bit();
        let searched = match self.home.switch() {
            Some(switch) => switch.input.bit(),
            None => 0,
        };
        (self.active_low | searched) & limits != 0
    }

    /// The active switches, by their [bits](SwitchInput::bit).
    #[must_use]
    #[inline]
    pub const fn active_switches(&self, inputs: &JointInputs) -> u8 {
        let levels =
            inputs.home as u8 | (inputs.limit_low as u8) << 1 | (inputs.limit_high as u8) << 2;
        levels ^ self.active_low
    }
}

/// Encoder of a joint, its index pulse, and the supervision that needs an encoder.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct EncoderSettings {
    /// Axis units per encoder count, times 2^24; negative when the encoder counts backwards.
    pub per_count: i64,
    /// Largest following error at standstill.
    pub following: Coordinate,
    /// Increase of the following-error limit with the commanded rate, in 2^-16 s of travel.
    pub following_lag: u32,
    /// Encoder-stuck distance: commanded motion without a count that is a fault.
    pub stuck_distance: Coordinate,
    /// Coordinate of the index pulse nearest to the preset.
    pub index: Coordinate,
    /// Distance from one index pulse to the next: one turn of the motor.
    pub index_pitch: Coordinate,
    /// Tolerance of the position of an index pulse, in counts, including the width of the pulse;
    /// less than a quarter of a turn. At 0 only homing uses the pulses: they are not compared with
    /// the counts.
    pub index_slack: u16,
    /// Largest distance of a found index pulse from its place by the preset; less than half the
    /// pitch.
    pub search: Coordinate,
}

/// Drive of a joint.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Drive {
    /// A current-mode amplifier behind a 14-bit DAC.
    Torque {
        /// Effort at code 8192; negative when the amplifier is wired in reverse.
        full_scale: Effort,
        /// Largest effort that may be commanded.
        limit: Effort,
    },
    /// A step/direction drive.
    Steps {
        /// Axis units per step, times 2^24; negative when a positive step moves down.
        per_step: i64,
        /// Ticks of the step clock per microsecond, 1 to 1000.
        ticks_per_us: u16,
        /// Least width of a pulse, and least time between two pulses, in ticks.
        pulse: u16,
        /// Setup time of the direction level before the first pulse, in ticks.
        setup: u16,
        /// Hold time of the direction level after the last pulse, in ticks.
        hold: u16,
        /// Difference between steps and encoder that is the fault of lost steps; 0 without an
        /// encoder.
        lost: Coordinate,
        /// Settings that the board writes into the chip of the drive. Without them the drive is set
        /// by its switches.
        chip: Option<DriveChip>,
    },
}

/// Servo loop of a joint (docs/control.md 3.1, 3.2).
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ServoConfig {
    /// Form of the loop.
    pub form: ServoForm,
    /// K_P in 1/s^2.
    pub kp: Gain,
    /// K_D in 1/s.
    pub kd: Gain,
    /// Time constant of the first-order filter on the error rate, in microseconds; 0 is no filter.
    pub rate_filter_us: u16,
    /// Inertia: effort units per acceleration unit, times 2^20 (1 kg on a linear axis: 0.016 *
    /// 2^20).
    pub inertia: u32,
    /// Viscous friction: effort units per rate unit, times 2^24.
    pub viscous: u32,
    /// Coulomb friction to compensate.
    pub coulomb: Effort,
    /// Rate at which the compensation reaches tanh(1) of its full value.
    pub coulomb_rate: Rate,
    /// K_I in 1/s^3, of an integrator with conditional anti-windup; 0 is no integrator. The thesis
    /// has none.
    pub ki: Gain,
    /// Time constant in which the integrator of a moving joint drains into the estimate of its
    /// friction, in milliseconds; 0 is no adaptation. It needs an integrator.
    pub friction_adaptation_ms: u16,
}

/// Forms of the servo loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ServoForm {
    /// (3.29) with the corrected sign: inertia * (K_P e + K_D e') + friction compensation.
    Pd,
    /// (3.35)-(3.37): inertia * (l_e'' + K_D e' + K_P e) + viscous l_e' + friction compensation.
    ModelBased,
}

/// Deceleration along the path.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Stopping {
    /// Time from the programmed speed to rest, in ms, 5 to 2000. It sets the largest change of the
    /// speed factor.
    pub time_ms: u16,
    /// Part of that time in which the deceleration builds up, and decays, in ms. It sets the jerk.
    pub ramp_ms: u16,
}

/// Limits of supervision.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Supervision {
    /// Silence of the host that ends a job or a jog, in ms, 10 to 5000.
    pub heartbeat_ms: u16,
    /// Missed control periods in a row that are a fault, 1 to 50.
    pub missed_periods: u16,
    /// Illegal encoder transitions since enable that are a fault, 0 to 1000.
    pub illegal_transitions: u16,
}

/// Rates of the pose during the search for the index pulses.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Homing {
    /// Rate of linear coordinates.
    pub rate: Rate,
    /// Rate of rotary coordinates, in 2^-32 turn/s for all of them.
    pub rotary_rate: Rate,
}

impl Homing {
    /// Rate of multi-turn rotary coordinates, in their axis units per second.
    #[must_use]
    pub const fn multi_turn_rate(&self) -> i32 {
        self.rotary_rate.0 >> (AxisKind::Rotary.unit_bits() - AxisKind::MultiTurn.unit_bits())
    }
}

/// Deserializes a part that this controller was built without: `None`, or an error if the
/// configuration has the part. The part is not decoded, which saves the code for it.
#[cfg(not(feature = "haptics"))]
fn absent<'de, D: serde::Deserializer<'de>, T>(deserializer: D) -> Result<Option<T>, D::Error> {
    enum Never {}
    impl<'de> Deserialize<'de> for Never {
        fn deserialize<D: serde::Deserializer<'de>>(_: D) -> Result<Self, D::Error> {
            Err(serde::de::Error::custom("built without it"))
        }
    }
    Ok(Option::<Never>::deserialize(deserializer)?.map(|never| match never {}))
}
