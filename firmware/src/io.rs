//! What a board fills in before a control period, and what it carries out after it.
//!
//! Inputs are latched at the start of a period; outputs take effect at the start of the next, on every board and in the
//! simulator alike. Nothing here is in engineering units: counts, codes and ticks only. The configuration gives them meaning.

use haptimill_protocol::message::MAX_AXES;
use heapless::Vec;

/// The most bytes that are heard in a period; the rest waits in the board's ring and is counted.
pub const RECEIVE_BYTES: usize = 64;

/// The most bytes that are said in a period.
pub const TRANSMIT_BYTES: usize = 64;

/// What one joint's hardware says, latched at the start of the period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct AxisInputs {
    /// Quadrature x4 counter, free running, wraps around.
    pub counts: i32,
    /// Time of the last counted edge, nanoseconds of a free running clock that wraps around (see [`Inputs::time_ns`]); up to a millisecond after it is taken for now.
    /// Without such times no rate is known, and supervision is blind: a board that has none gives the latch of the period in which the count changed.
    pub edge_time_ns: u32,
    /// Illegal transitions (both channels at once), free running, wraps around.
    pub illegal: u16,
    /// Counter at the last index pulse.
    pub index_counts: i32,
    /// Index pulses seen, free running, wraps around; a change says that `index_counts` is new.
    pub index_pulses: u8,
    /// Steps really emitted, signed, free running, wraps around.
    pub steps: i32,
    /// Home switch is active.
    pub home: bool,
    /// Limit switch at the lower end is active.
    pub limit_low: bool,
    /// Limit switch at the upper end is active.
    pub limit_high: bool,
    /// The drive reports no alarm. It is asked for before the drive is switched on, so it must not wait for that.
    pub drive_ready: bool,
}

/// Components of a force: x, y, z of the work.
pub const COMPONENTS: usize = 3;

/// What the board's converter of a force sensor says in a period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ForceSample {
    /// Codes of x, y, z: -8192 to 8191.
    pub codes: [i16; COMPONENTS],
    /// Conversions so far, free running, wraps around; without a change there is no new sample.
    pub conversions: u8,
    /// The charge amplifier reports an overload.
    pub overload: bool,
}

/// Legs of the haptic arm.
pub const LEGS: usize = 3;

/// What the hardware of one leg of the haptic arm says, latched at the start of the period (docs/control.md 2.2).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LegInputs {
    /// Quadrature x4 counters, free running, wrapping around: the slide d, the turn theta3 about its axis, the angle theta4 of the link.
    pub counts: [i32; 3],
    /// Illegal transitions of the three encoders, free running, wrapping around.
    pub illegal: [u16; 3],
}

/// What the haptic arm's hardware says, latched at the start of the period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct HapticInputs {
    /// The legs.
    pub legs: [LegInputs; LEGS],
    /// The button on the handle is held: the hand leads the tool. Let go, the handle moves alone (the clutch).
    pub engaged: bool,
    /// The amplifiers report that they are well.
    pub drives_ready: bool,
}

/// Current commands of the haptic arm's amplifiers, effective at the start of the next period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct HapticOutputs {
    /// Amplifiers enabled.
    pub enabled: bool,
    /// Codes of 14-bit converters, -8192 to 8191: for each leg the force along its slide (f_j), then the torque about it (tau_j).
    pub currents: [[i16; 2]; LEGS],
}

/// All that is sensed, latched at the start of the period.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Inputs {
    /// Number of this period; grows by 1 and by the missed ones.
    pub period: u64,
    /// Periods that were missed just before this one.
    pub missed: u16,
    /// The board's free running clock at the latch, nanoseconds, wraps around.
    pub time_ns: u32,
    /// The joints.
    pub axes: [AxisInputs; MAX_AXES],
    /// The force sensor; nothing changes on a machine without.
    pub force: ForceSample,
    /// The haptic arm; nothing changes on a machine without.
    pub haptic: HapticInputs,
    /// Emergency stop circuit is open.
    pub emergency_stop: bool,
    /// Bytes from the host, oldest first.
    pub received: Vec<u8, RECEIVE_BYTES>,
    /// Bytes that wait in the board's ring for a later period.
    pub waiting: u16,
    /// Bytes that the board's transmitter can take in this period; a slow line takes none for many periods.
    pub transmit_room: u16,
    /// Bytes that the board lost for want of room, free running, wraps around.
    pub lost_bytes: u16,
    /// The receive interrupt saw the urgent stop since the last period.
    pub urgent: bool,
}

/// Pulses of one period on a step/dir drive, in ticks of the step clock.
///
/// Step `k` (from 0) leaves at `delay + k * interval + ramp * k * (k - 1) / 2` ticks after the start of the period. All steps of a
/// segment have one direction. The direction line takes its level at the start of a period that has steps; in one without, and while the drive is [off](DriveCommand::Off), it
/// stays as it is. The planner counts on that: time to set the direction up is left only where it changes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StepSegment {
    /// Steps; the sign is the direction. 0 has none: the line stays.
    pub count: i16,
    /// Ticks from the start of the period to the first step.
    pub delay: u32,
    /// Ticks from the first to the second step.
    pub interval: u32,
    /// Ticks that each further interval is longer.
    pub ramp: i32,
}

/// What one joint's drive shall do.
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

/// All that is to be done, effective at the start of the next period.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Outputs {
    /// The joints; [`DriveCommand::Off`] disables the drive.
    pub axes: [DriveCommand; MAX_AXES],
    /// The haptic arm's amplifiers.
    pub haptic: HapticOutputs,
    /// Spindle speed in rev/min: clockwise above 0, counter-clockwise below, 0 is off.
    pub spindle_rpm: i16,
    /// Bytes to the host.
    pub transmit: Vec<u8, TRANSMIT_BYTES>,
}

impl Outputs {
    /// The safe state: drives, haptic arm and spindle off. Bytes to the host still go out.
    pub fn make_safe(&mut self) {
        self.axes = [DriveCommand::Off; MAX_AXES];
        self.haptic = HapticOutputs::default();
        self.spindle_rpm = 0;
    }
}
