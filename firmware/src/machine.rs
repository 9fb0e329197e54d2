//! The configured machine: geometry, joints, motion, force control and haptic arm, with the stages
//! of the control cycle that work on them.
//!
//! Positions are in axis units: 2^-20 mm, 2^-32 turn, multi-turn 2^-22 turn.

mod compliance;
mod configure;
mod correction;
mod enable;
mod gantry;
mod joint_rates;
pub mod masters;
mod move_off;
mod named_io;
mod switches;

use crate::config::Config;
use crate::digest::Digest;
use crate::force::ForceControl;
use crate::force::sensor::COMPONENTS;
use crate::io::{DriveCommand, Inputs};
use crate::joint::JointDrive;
use crate::motion::interpolator::Progress;
use crate::motion::{Mode, Motion, PoseCommand};
use crate::named_io::{NamedIo, ProbeLatch};
use crate::safety::homing::Homing;
use crate::volumetric::Compensation;
use configure::PARTS;
pub use configure::{EncoderScaling, PositionSnapshot};
use gantry::Gantries;
use haptimill_kinematics::BoundedKinematics;
use haptimill_kinematics::{JointMotion, Joints, Kinematics, Pose, PoseError};
use haptimill_math::Coordinate;
use haptimill_protocol::message::{
    ActiveLines, AxisValues, Fault, MAX_AXES, MoreTelemetry, Refusal, Telemetry,
};
use haptimill_protocol::setpoint::Setpoint;
use heapless::Vec;
use joint_rates::JointRates;
use masters::Masters;
use switches::Switches;

/// State of one joint in one period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct JointSnapshot {
    /// Measured position.
    pub measured: Coordinate,
    /// Commanded position.
    pub commanded: Coordinate,
    /// Following error, the input of the servo loop.
    pub following_error: Coordinate,
    /// Command to the drive.
    pub command: DriveCommand,
}

/// A configured machine.
#[derive(Debug)]
pub struct Machine {
    /// The configuration.
    pub config: Config,
    /// CRC-32 of the configuration as it was sent.
    pub crc: u32,
    /// Geometry and strokes.
    pub kinematics: BoundedKinematics,
    /// Program, jogs and sources: the commanded motion.
    pub motion: Motion,
    /// Search for the index pulses.
    pub homing: Homing,
    /// Search for the home switches.
    switches: Switches,
    /// No switch needs [`Machine::hardware_fault`] now.
    plain_switches: bool,
    /// Second motors of gantries.
    gantries: Gantries,
    /// Force sensor and force control, on a machine that has them.
    pub force: Option<ForceControl>,
    /// The haptic arm or the remote master, and the mapping to the tool.
    pub masters: Masters,
    /// Named inputs and outputs.
    pub io: NamedIo,
    /// Volumetric compensation, on a machine with error tables.
    pub compensation: Option<Compensation>,
    /// Reference p_r on a machine with force control; unused without it.
    reference: PoseCommand,
    /// Hold-off before a compliance-limit event is reported again, in periods.
    limited: [u16; COMPONENTS],
    /// Components that reached the compliance limit in this period.
    newly_limited: u8,
    joints: Vec<JointDrive, MAX_AXES>,
    measured: Joints,
    /// Joints that wrap around, one bit each, and their turns since they were configured.
    wrapping: u8,
    turns: [i32; MAX_AXES],
    /// Computed every period on a machine with a force sensor, otherwise on demand.
    measured_pose: Option<Pose>,
    target: JointMotion,
    /// Joint-rate check of the setpoints of a job.
    joint_rates: JointRates,
    digests: [Digest; PARTS],
    next_part: usize,
    /// Periods left in which the rotors of step motors may lock after enable.
    locking: Option<u32>,
    /// Fault of a counter that was not reported yet.
    counter_fault: Option<Fault>,
}

impl Machine {
    /// Number of pose coordinates, and of the joints of the model.
    #[must_use]
    #[inline]
    pub fn axes(&self) -> usize {
        self.config.pose.len()
    }

    /// Number of joints, with the second motors of gantries.
    #[must_use]
    #[inline]
    pub fn joint_count(&self) -> usize {
        self.joints.len()
    }

    /// Stage *measure*: encoder counts to joint positions; with a force sensor also the pose.
    #[inline]
    pub fn measure(&mut self, inputs: &Inputs) {
        let time_ns = inputs.time_ns;
        let before = self.turning();
        let measured = self.measured.0.iter_mut();
        let mut large_step = false;
        for ((joint, inputs), measured) in self.joints.iter_mut().zip(&inputs.joints).zip(measured)
        {
            let measurement = joint.measure(inputs, time_ns);
            *measured = measurement.coordinate;
            large_step |= measurement.large_step;
        }
        if let Some(before) = before {
            self.count_turns(&before);
        }
        if large_step {
            self.detect_jumps(u32::from(inputs.missed) + 1);
        }
        if inputs.missed != 0 {
            self.skip_periods(inputs);
        }
        self.measure_pose();
        self.measure_haptics(&inputs.haptic);
        self.measure_io(inputs);
    }

    /// Accounts for missed periods in the rates of the joints.
    #[cold]
    #[inline(never)]
    fn skip_periods(&mut self, inputs: &Inputs) {
        for (joint, counted) in self.joints.iter_mut().zip(&inputs.joints) {
            joint.skip(inputs.missed, counted.counts);
        }
    }

    /// Levels of the named inputs; the position of this period for a probe that takes its level.
    #[inline]
    fn measure_io(&mut self, inputs: &Inputs) {
        let (measured, motion) = (&self.measured, &self.motion);
        self.io.measure(&self.config.io, inputs, || ProbeLatch {
            period: inputs.period,
            joints: *measured,
            commanded: motion.commanded().pose,
        });
    }

    /// The position of this period, for a probe.
    #[must_use]
    pub fn probe_latch(&self, period: u64) -> ProbeLatch {
        ProbeLatch {
            period,
            joints: self.measured,
            commanded: self.motion.commanded().pose,
        }
    }

    /// Finds counters that jumped farther than a joint can move in `periods`, which is more than
    /// one after missed periods. Keeps the first jump for a report.
    #[cold]
    #[inline(never)]
    fn detect_jumps(&mut self, periods: u32) {
        for (index, joint) in self.joints.iter_mut().enumerate() {
            if joint.jumped(periods) {
                self.counter_fault.get_or_insert(Fault::CounterJump {
                    joint: index as u8,
                    counts: joint.measurement().moved.unsigned_abs(),
                });
            }
        }
    }

    /// Finds encoders with a stuck channel while the drives are off. Keeps the first one for a
    /// report. The encoder of `suspect` is not checked.
    #[inline(never)]
    pub fn supervise_unpowered(&mut self, suspect: Option<u8>) {
        let joints = self.joints.iter_mut().zip(&self.config.joints);
        for (index, (joint, settings)) in joints.enumerate() {
            if suspect == Some(index as u8) {
                continue;
            }
            let fault = joint.supervise_unpowered(index as u8, settings, self.config.period_us);
            self.counter_fault = self.counter_fault.or(fault);
        }
    }

    /// A counter that jumped, with drives on or off, or that has a stuck channel, with drives off,
    /// until it is [acknowledged](Self::acknowledge_counter_fault).
    #[must_use]
    #[inline]
    pub const fn counter_fault(&self) -> Option<Fault> {
        self.counter_fault
    }

    /// Whether the levels of the limit switches need no interpretation.
    #[must_use]
    #[inline]
    pub const fn has_only_plain_switches(&self) -> bool {
        self.plain_switches
    }

    /// Clears the fault of a counter after it was reported.
    pub const fn acknowledge_counter_fault(&mut self) {
        self.counter_fault = None;
    }

    fn update_measured(&mut self) {
        let before = self.turning();
        for (measured, joint) in self.measured.0.iter_mut().zip(&self.joints) {
            *measured = joint.measurement().coordinate;
        }
        if let Some(before) = before {
            self.count_turns(&before);
        }
        self.measure_pose();
    }

    /// The measured joints of a machine with joints that wrap around.
    #[inline]
    fn turning(&self) -> Option<Joints> {
        (self.wrapping != 0).then_some(self.measured)
    }

    /// Counts the turns that the measured joints completed since they were at `before`. A joint
    /// moves less than half a turn in a period.
    #[inline(never)]
    fn count_turns(&mut self, before: &Joints) {
        let measured = self.measured.0.iter().zip(&before.0);
        for (joint, (turns, (now, before))) in self.turns.iter_mut().zip(measured).enumerate() {
            let by = i64::from(now.wrapping_sub(*before).0);
            if self.wrapping >> joint & 1 != 0 {
                let over = i64::from(before.0) + by - i64::from(now.0);
                *turns = turns.wrapping_add((over >> 32) as i32);
            }
        }
    }

    /// Force control needs the measured pose in every period.
    #[inline]
    fn measure_pose(&mut self) {
        if self.force.is_some() {
            let measured = self.kinematics.forward(&self.measured).ok();
            self.measured_pose = measured.map(|pose| self.uncorrected(pose));
        }
    }

    /// The measured pose, if the forward kinematics verifies one.
    #[must_use]
    #[inline]
    pub fn measured_pose(&self) -> Option<Pose> {
        match self.force {
            Some(_) => self.measured_pose,
            None => {
                let measured = self.kinematics.forward(&self.measured).ok();
                measured.map(|pose| self.uncorrected(pose))
            }
        }
    }

    /// Whether the illegal transitions of every encoder since the last enable are within the
    /// configured limit.
    #[must_use]
    #[inline]
    pub fn encoders_counted(&self) -> bool {
        let limit = u32::from(self.config.supervision.illegal_transitions);
        self.joints
            .iter()
            .all(|joint| joint.measurement().illegal <= limit)
    }

    /// Supervises all joints against their commands of the period before. `missed`: periods were
    /// missed since.
    #[inline]
    pub fn supervise(&mut self, missed: bool) -> Option<Fault> {
        let Config {
            supervision,
            period_us,
            joints,
            ..
        } = &self.config;
        for (index, joint) in self.joints.iter_mut().enumerate() {
            if let Some(settings) = joints.get(index)
                && let Some(fault) =
                    joint.supervise(index as u8, settings, supervision, *period_us, missed)
            {
                return Some(fault);
            }
        }
        None
    }

    /// Stage *solve*: inverse kinematics of the commanded pose, or of the reference under force
    /// control.
    #[inline]
    pub fn solve(&mut self) -> Result<(), PoseError> {
        if self.searches_switches() {
            return Ok(());
        }
        if self.is_compliant() {
            return self.solve_reference();
        }
        let mut commanded = self.motion.commanded();
        if let (Some(compensation), Some(tables)) =
            (&mut self.compensation, &self.config.volumetric)
            && compensation.is_active()
        {
            commanded = compensation.correct(tables, commanded);
        }
        self.kinematics.solve(
            &commanded.pose,
            &commanded.rates,
            &commanded.accelerations,
            &mut self.target,
        )
    }

    /// The first joint whose commanded rate exceeds its maximum by more than 1/32, which the
    /// look-ahead should have prevented.
    #[must_use]
    #[inline]
    pub fn joint_beyond_rate(&self) -> Option<usize> {
        let rates = self.target.rates.iter().zip(self.kinematics.rates());
        let mut joints = rates.take(self.axes());
        // The sum is unsigned: near half a turn per second it exceeds the range of a rate.
        joints.position(|(rate, limit)| {
            rate.0.unsigned_abs() > limit.0.unsigned_abs() + (limit.0.unsigned_abs() >> 5)
        })
    }

    /// Stage *servo*: position loops. Returns a joint whose drive command is saturated.
    #[inline]
    pub fn servo(&mut self, commands: &mut [DriveCommand; MAX_AXES]) -> Option<u8> {
        let mut saturated = None;
        let JointMotion {
            joints,
            rates,
            accelerations,
        } = &self.target;
        for (index, joint) in self.joints.iter_mut().enumerate() {
            let Some(command) = commands.get_mut(index) else {
                break;
            };
            let (coordinate, rate) = (joints.0[index], rates[index]);
            if joint.servo(coordinate, rate, accelerations[index], command) {
                saturated = Some(index as u8);
            }
        }
        saturated
    }

    /// Stage *interpolate*: commanded motion of this period. Also returns the coordinate of a jog
    /// that a limit stops, if there is one.
    #[inline]
    pub fn advance(&mut self, mode: Mode) -> (Progress, Option<u8>) {
        self.pass_displacement_to_jog();
        match self.motion.advance_program(mode) {
            Some(progress) => (progress, None),
            None => self.advance_with_sources(mode),
        }
    }

    #[inline(never)]
    fn advance_with_sources(&mut self, mode: Mode) -> (Progress, Option<u8>) {
        self.motion.advance(mode, &self.kinematics)
    }

    /// The first coordinate of the pose that is beyond its soft limits by more than their
    /// tolerance.
    #[must_use]
    #[inline]
    pub fn beyond_soft_limit(&self, pose: &Pose) -> Option<u8> {
        self.config
            .pose
            .iter()
            .zip(&pose.0)
            .position(|(limits, at)| {
                let tolerance = limits.kind.soft_limit_tolerance();
                at.0 < limits.low.0.saturating_sub(tolerance)
                    || at.0 > limits.high.0.saturating_add(tolerance)
            })
            .map(|index| index as u8)
    }

    /// Checks that the pose of a setpoint is within soft limits and strokes, and stores the end of
    /// its segment for the check of the joint rates.
    ///
    /// # Errors
    /// The soft limit or pose error that refuses the setpoint.
    pub fn check_setpoint_pose(&mut self, number: u32, setpoint: &Setpoint) -> Result<(), Refusal> {
        let mut pose = Pose::default();
        for (slot, value) in pose.0.iter_mut().zip(&setpoint.pose) {
            *slot = Coordinate(*value);
        }
        let pose = self.motion.destination(&pose);
        if let Some(coordinate) = self.beyond_soft_limit(&pose) {
            return Err(Refusal::SoftLimit {
                setpoint: number,
                coordinate,
            });
        }
        self.append_end(setpoint).map_err(|error| Refusal::Pose {
            setpoint: number,
            error,
        })
    }

    /// The commanded pose as values of a message.
    #[must_use]
    pub fn commanded_values(&self) -> AxisValues {
        self.values(self.axes(), |index| self.motion.commanded().pose.0[index].0)
    }

    /// Fills in pose and joints of a telemetry sample. The measured pose is empty when the forward
    /// kinematics does not verify one.
    pub fn fill_telemetry(&self, inputs: &Inputs, sample: &mut Telemetry) {
        sample.commanded = self.commanded_values();
        if let Some(pose) = self.measured_pose() {
            sample.measured = self.values(self.axes(), |index| pose.0[index].0);
        }
        let joints = self.joint_count();
        sample.joints = self.values(joints, |index| self.measured.0[index].0);
        if self.wrapping != 0 {
            sample.turns = self.values(joints, |index| self.turns[index]);
        }
        sample.following_error = self.values(joints, |index| {
            self.joints[index].servo_output().following_error.0
        });
        sample.drive = self.drive_values(inputs);
        sample.open_loop = self.open_loop();
        let compensation = self.compensation.as_ref().map(Compensation::percent);
        sample.more = MoreTelemetry::new(compensation, self.active_lines(inputs));
    }

    /// What the switches, the drives and the emergency stop circuit signal.
    fn active_lines(&self, inputs: &Inputs) -> ActiveLines {
        let mut lines = ActiveLines {
            emergency_stop: inputs.emergency_stop,
            ..ActiveLines::default()
        };
        for (joint, (settings, seen)) in self.config.joints.iter().zip(&inputs.joints).enumerate() {
            let active = settings.active_switches(seen);
            for (input, joints) in lines.switches.iter_mut().enumerate() {
                *joints |= (active >> input & 1) << joint;
            }
            let alarm = (!seen.drive_ready).then_some(seen.alarm);
            lines.alarms = lines.alarms.with(joint, alarm);
        }
        lines
    }

    /// Joints without an encoder, one bit each.
    #[must_use]
    pub fn open_loop(&self) -> u8 {
        let joints = self.joints.iter().rev();
        joints.fold(0, |bits, joint| bits << 1 | u8::from(joint.is_open_loop()))
    }

    /// Drive commands: DAC codes, or steps emitted.
    #[must_use]
    pub fn drive_values(&self, inputs: &Inputs) -> AxisValues {
        self.values(self.joint_count(), |index| self.command(inputs, index))
    }

    fn command(&self, inputs: &Inputs, index: usize) -> i32 {
        match self.joints[index].servo_output().command {
            DriveCommand::Torque(code) => i32::from(code),
            DriveCommand::Steps(_) => inputs.joints[index].steps,
            DriveCommand::Off => 0,
        }
    }

    /// State of each joint in this period, for recorders.
    pub fn joints(&self) -> impl Iterator<Item = JointSnapshot> + '_ {
        (0..self.joint_count()).map(|index| JointSnapshot {
            measured: self.measured.0[index],
            commanded: self.target.joints.0[index],
            following_error: self.joints[index].servo_output().following_error,
            command: self.joints[index].servo_output().command,
        })
    }

    /// The joint motion commanded last: positions, rates and accelerations.
    #[must_use]
    pub const fn target(&self) -> &JointMotion {
        &self.target
    }

    fn values(&self, count: usize, value: impl Fn(usize) -> i32) -> AxisValues {
        (0..count.min(MAX_AXES)).map(value).collect()
    }
}
