//! Inputs and outputs of a control period: the interface between a board and the controller.
//!
//! A board latches the inputs at the start of a period. The outputs take effect at the start of the
//! next one, on every board and in the simulator. All values are counts, codes and ticks; the
//! configuration scales them to axis units and forces.

use haptimill_protocol::message::MAX_AXES;
use heapless::Vec;

/// Largest number of bytes that a period receives. More bytes wait in the board's ring and are
/// counted.
pub const RECEIVE_BYTES: usize = 64;

/// Largest number of bytes that a period transmits.
pub const TRANSMIT_BYTES: usize = 64;

pub use haptimill_protocol::message::{Alarms, DriveAlarm};

/// Inputs of one joint, latched at the start of the period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct JointInputs {
    /// Quadrature x4 counter, free running, wraps around.
    pub counts: i32,
    /// Time of the last counted edge, in ns of a free running clock that wraps around (see
    /// [`Inputs::time_ns`]). A time that lies up to 1 ms ahead of the latch counts as the latch.
    ///
    /// Rate measurement and supervision need these times. A board that cannot time edges gives the
    /// latch of the period in which the count changed.
    pub edge_time_ns: u32,
    /// Illegal transitions (both channels at once), free running, wraps around.
    pub illegal: u16,
    /// Counter at the last index pulse.
    pub index_counts: i32,
    /// Index pulses seen, free running, wraps around. A change marks a new `index_counts`.
    pub index_pulses: u8,
    /// Steps emitted so far, signed, free running, wraps around.
    pub steps: i32,
    /// Level of the home switch's line; the configuration says which level is active.
    pub home: bool,
    /// Level of the line of the limit switch at the lower end.
    pub limit_low: bool,
    /// Level of the line of the limit switch at the upper end.
    pub limit_high: bool,
    /// The drive reports no alarm. The controller reads it before it switches the drive on, so the
    /// signal must not depend on the drive being on.
    pub drive_ready: bool,
    /// Why the drive is not ready. It counts only where `drive_ready` is false.
    pub alarm: DriveAlarm,
}

pub use haptimill_protocol::force::COMPONENTS;

/// Sample of the force sensor's converter in a period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ForceSample {
    /// Codes of x, y, z: -8192 to 8191.
    pub codes: [i16; COMPONENTS],
    /// Conversions so far, free running, wraps around. A change marks a new sample.
    pub conversions: u8,
    /// The charge amplifier reports an overload.
    pub overload: bool,
}

pub use haptimill_kinematics::haptic_arm::LEGS;

/// Inputs of one leg of the haptic arm, latched at the start of the period (docs/control.md 2.2).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LegInputs {
    /// Quadrature x4 counters, free running, wrapping around: slide position d, rotation theta3
    /// about the slide axis, link angle theta4.
    pub counts: [i32; 3],
    /// Illegal transitions of the three encoders, free running, wrapping around.
    pub illegal: [u16; 3],
}

/// Inputs of the haptic arm, latched at the start of the period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct HapticInputs {
    /// The legs.
    pub legs: [LegInputs; LEGS],
    /// The enabling switch on the handle is pressed. While it is released, the handle moves without
    /// the tool.
    pub enabling_switch: bool,
    /// The amplifiers report that they are healthy.
    pub drives_ready: bool,
}

/// Current commands of the haptic arm's amplifiers, effective at the start of the next period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct HapticOutputs {
    /// Amplifiers enabled.
    pub enabled: bool,
    /// Codes of 14-bit converters, -8192 to 8191. Each leg has the force along its slide (f_j),
    /// then the torque about it (tau_j).
    pub currents: [[i16; 2]; LEGS],
}

pub use haptimill_protocol::message::ANALOG;

/// What a board says of its memory for a configuration.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Storage {
    /// It has none.
    #[default]
    None,
    /// It is ready.
    Ready,
    /// It is keeping a configuration.
    Busy,
    /// The configuration that was ordered last is kept.
    Stored,
    /// The configuration that was ordered last is not kept.
    Failed,
}

impl Storage {
    /// The state with this code, 0 to 4; `None` for any other one.
    #[must_use]
    pub const fn of_code(code: u8) -> Self {
        match code {
            1 => Self::Ready,
            2 => Self::Busy,
            3 => Self::Stored,
            4 => Self::Failed,
            _ => Self::None,
        }
    }
}

/// All inputs, latched at the start of the period.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Inputs {
    /// Number of this period. It grows by 1 plus the number of missed periods.
    pub period: u64,
    /// Periods missed directly before this one.
    pub missed: u16,
    /// The board's free running clock at the latch, in ns; wraps around.
    pub time_ns: u32,
    /// The joints.
    pub joints: [JointInputs; MAX_AXES],
    /// The force sensor; constant on a machine without one.
    pub force: ForceSample,
    /// The haptic arm; constant on a machine without one.
    pub haptic: HapticInputs,
    /// Levels of the general digital inputs, channel `k` in bit `k`, not debounced. A board gives 0
    /// for channels that it lacks. The switches of the joints are in [`JointInputs`].
    pub digital: u32,
    /// Codes of the analog inputs, -32768 to 32767. A board gives 0 for channels that it lacks.
    pub analog: [i16; ANALOG],
    /// Emergency stop circuit is open.
    pub emergency_stop: bool,
    /// The memory for a configuration.
    pub storage: Storage,
    /// Bytes from the host, oldest first.
    pub received: Vec<u8, RECEIVE_BYTES>,
    /// Bytes that wait in the board's ring for a later period.
    pub waiting: u16,
    /// Bytes that the board's transmitter can take in this period. On a slow line it is 0 for many
    /// periods.
    pub transmit_room: u16,
    /// Bytes that the board lost because its ring was full, free running, wraps around.
    pub lost_bytes: u16,
    /// The receive interrupt recognised the out-of-band stop since the last period.
    pub out_of_band_stop: bool,
}

impl Inputs {
    /// Drives that are not ready, and why.
    #[must_use]
    pub fn alarms(&self) -> Alarms {
        if self.joints.iter().all(|seen| seen.drive_ready) {
            return Alarms::default();
        }
        let joints = self.joints.iter().enumerate();
        joints.fold(Alarms::default(), |alarms, (joint, seen)| {
            alarms.with(joint, (!seen.drive_ready).then_some(seen.alarm))
        })
    }
}

/// The first drive that is not ready, and why; one whose chip is cut off by another chip only if
/// there is no other.
#[cold]
#[inline(never)]
#[must_use]
pub fn first_alarm(joints: &[JointInputs]) -> Option<(u8, DriveAlarm)> {
    let alarms = || {
        let joints = joints.iter().enumerate();
        joints.filter(|(_, seen)| !seen.drive_ready)
    };
    let cause = alarms().find(|(_, seen)| seen.alarm != DriveAlarm::Unreachable);
    let (joint, seen) = cause.or_else(|| alarms().next())?;
    Some((joint as u8, seen.alarm))
}

/// Pulses of one period on a step/direction drive, in ticks of the step clock.
///
/// Step `k` (from 0) leaves at `delay + k * interval + ramp * k * (k - 1) / 2` ticks after the
/// start of the period. All steps of a segment have one direction. Each pulse begins in the period;
/// the last one may end in the next period.
///
/// The direction line changes only at the start of a period that has steps. It keeps its level in
/// a period without steps and while the drive is [off](DriveCommand::Off). The step generator
/// relies on this: it leaves setup time only where the direction changes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StepSegment {
    /// Number of steps; the sign is the direction. At 0 the direction line keeps its level.
    pub count: i16,
    /// Ticks from the start of the period to the first step.
    pub delay: u32,
    /// Ticks from the first to the second step.
    pub interval: u32,
    /// Ticks by which each further interval is longer.
    pub ramp: i32,
}

/// Command to one joint's drive.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum DriveCommand {
    /// Drive disabled.
    #[default]
    Off,
    /// Torque command: code of a 14-bit DAC, -8192 to 8191.
    Torque(i16),
    /// Step pulses.
    Steps(StepSegment),
}

/// All outputs, effective at the start of the next period.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Outputs {
    /// The joints; [`DriveCommand::Off`] disables the drive.
    pub joints: [DriveCommand; MAX_AXES],
    /// The haptic arm's amplifiers.
    pub haptic: HapticOutputs,
    /// Spindle speed in rev/min: clockwise above 0, counter-clockwise below 0, off at 0.
    pub spindle_rpm: i16,
    /// Levels of the general digital outputs, channel `k` in bit `k`. A board ignores the bits of
    /// channels that it lacks.
    pub digital: u32,
    /// Codes of the analog outputs, -32768 to 32767. A board ignores channels that it lacks.
    pub analog: [i16; ANALOG],
    /// Bytes to the host.
    pub transmit: Vec<u8, TRANSMIT_BYTES>,
}

impl Outputs {
    /// Switches drives, haptic arm and spindle off, and sets the general outputs to the level and
    /// code 0, as after a reset of the board. Bytes to the host are still transmitted.
    pub fn make_safe(&mut self) {
        self.joints = [DriveCommand::Off; MAX_AXES];
        self.haptic = HapticOutputs::default();
        self.spindle_rpm = 0;
        self.digital = 0;
        self.analog = [0; ANALOG];
    }
}
