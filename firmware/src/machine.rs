//! The configured machine: geometry, joints, motion, force control and haptic arm, with the stages
//! of the control cycle that work on them.
//!
//! Positions are in axis units (2^-20 mm or 2^-32 turn).

mod compliance;
mod joint_rates;
pub mod masters;

use crate::config::digest::{Constants, Digest};
use crate::config::{AxisKind, Config, JointAxis};
use crate::force::sensor::COMPONENTS;
use crate::force::{Design, ForceControl};
use crate::io::{DriveCommand, Inputs};
use crate::joint::power_on_counts::SincePowerOn;
use crate::joint::{EncoderState, JointDrive};
use crate::motion::interpolator::Progress;
use crate::motion::{Mode, Motion, PoseCommand};
use crate::safety::homing::Homing;
use haptimill_kinematics::BoundedKinematics;
use haptimill_kinematics::{JointMotion, Joints, Kinematics, Pose, PoseError};
use haptimill_math::Coordinate;
use haptimill_protocol::message::{
    AxisValues, ConfigField, ConfigProblem, Fault, MAX_AXES, Refusal, Telemetry,
};
use haptimill_protocol::setpoint::Setpoint;
use heapless::Vec;
use joint_rates::JointRates;
use masters::Masters;

/// Number of parts in which the configuration and the values derived from it are checked against
/// their digests. The parts are: geometry and bounds, motion, each pose axis and each joint, the
/// haptic arm, the force sensor, each axis of force control.
const PARTS: usize = FORCE_PART + 1 + COMPONENTS;

/// Digest part of the haptic arm.
const HAND_PART: usize = 2 + 2 * MAX_AXES;

/// Digest part of the force sensor.
const FORCE_PART: usize = HAND_PART + 1;

/// Encoder scaling and encoder state of each joint.
pub type PositionSnapshot = Vec<(EncoderScaling, EncoderState), MAX_AXES>;

/// Encoder scaling of a joint: kind, axis units per count, preset, index and index pitch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EncoderScaling(AxisKind, i64, Coordinate, Coordinate, Coordinate);

impl EncoderScaling {
    fn of(axis: &JointAxis) -> Self {
        Self(
            axis.kind,
            axis.per_count,
            axis.preset,
            axis.index,
            axis.index_pitch,
        )
    }
}

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
    /// Force sensor and force control, on a machine that has them.
    pub force: Option<ForceControl>,
    /// The haptic arm or the remote master, and the mapping to the tool.
    pub masters: Masters,
    /// Reference p_r on a machine with force control; unused without it.
    reference: PoseCommand,
    /// Hold-off before a compliance-limit event is reported again, in periods.
    limited: [u16; COMPONENTS],
    /// Components that reached the compliance limit in this period.
    newly_limited: u8,
    joints: Vec<JointDrive, MAX_AXES>,
    measured: Joints,
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

/// A rotor has locked when it has not moved for this time, microseconds: six cycles of a rotor that
/// oscillates at 120 Hz.
const LOCKED_US: u32 = 50_000;

/// All rotors must have locked after this time, microseconds.
const LOCKING_US: u32 = 1_000_000;

impl Machine {
    /// Creates the machine of a configuration, at its presets.
    ///
    /// # Errors
    /// The first problem of the configuration.
    pub fn new(config: Config, crc: u32, inputs: &Inputs) -> Result<Self, ConfigProblem> {
        let joints = Self::joints_of(&config, inputs)?;
        let design = Self::force_of(&config)?;
        let mut machine = Self::bare(config, crc);
        machine.set_up(joints, design, inputs);
        Ok(machine)
    }

    /// Creates the machine of a configuration in `slot`. With its queue a machine is too large to
    /// be passed by value on the stack of a microcontroller. A refused configuration leaves the
    /// slot unchanged.
    ///
    /// # Errors
    /// The first problem of the configuration.
    #[cold]
    #[inline(never)]
    pub fn install(
        slot: &mut Option<Self>,
        config: Config,
        crc: u32,
        inputs: &Inputs,
    ) -> Result<(), ConfigProblem> {
        let joints = Self::joints_of(&config, inputs)?;
        let design = Self::force_of(&config)?;
        Self::install_bare(slot, config, crc);
        if let Some(machine) = slot {
            machine.set_up(joints, design, inputs);
        }
        Ok(())
    }

    /// Checks the configuration and creates its joints, at their presets.
    #[cold]
    #[inline(never)]
    fn joints_of(
        config: &Config,
        inputs: &Inputs,
    ) -> Result<Vec<JointDrive, MAX_AXES>, ConfigProblem> {
        config.check()?;
        let mut joints = Vec::new();
        for (index, axis) in config.joints.iter().enumerate() {
            let problem = ConfigProblem {
                field: ConfigField::Drive,
                axis: Some(index as u8),
            };
            let mut joint = JointDrive::new(axis, config.period_us).map_err(|_| problem)?;
            joint.measure(&inputs.axes[index], inputs.time_ns);
            joint.set_reference(inputs.axes[index].counts, axis.preset);
            joints.push(joint).map_err(|_| problem)?;
        }
        Ok(joints)
    }

    /// Moves a new machine into the slot. The machine is built on the stack first; a function of
    /// its own keeps that frame free of anything else.
    #[cold]
    #[inline(never)]
    fn install_bare(slot: &mut Option<Self>, config: Config, crc: u32) {
        *slot = Some(Self::bare(config, crc));
    }

    /// A machine without joints and motion.
    #[inline(always)]
    fn bare(config: Config, crc: u32) -> Self {
        Self {
            kinematics: config.kinematics(),
            motion: Motion::default(),
            homing: Homing::default(),
            force: None,
            masters: Masters::default(),
            reference: PoseCommand::default(),
            limited: [0; COMPONENTS],
            newly_limited: 0,
            joints: Vec::new(),
            measured: Joints::default(),
            measured_pose: None,
            target: JointMotion::default(),
            joint_rates: JointRates::default(),
            digests: [Digest::default(); PARTS],
            next_part: 0,
            locking: None,
            counter_fault: None,
            config,
            crc,
        }
    }

    #[cold]
    #[inline(never)]
    fn set_up(
        &mut self,
        joints: Vec<JointDrive, MAX_AXES>,
        design: Option<Design>,
        inputs: &Inputs,
    ) {
        self.joints = joints;
        self.set_up_force(design);
        self.set_up_hand(&inputs.haptic);
        self.motion.set_up(&self.config);
        for part in 0..PARTS {
            self.digests[part] = self.digest(part);
        }
        self.update_measured();
    }

    /// Encoder scaling and state of all joints, which a new configuration may take over.
    #[must_use]
    pub fn standing(&self) -> PositionSnapshot {
        let joints = self.config.joints.iter().zip(&self.joints);
        joints
            .map(|(axis, joint)| (EncoderScaling::of(axis), joint.standing()))
            .collect()
    }

    /// Whether the next index pulse of a joint will confirm or refute its encoder.
    #[must_use]
    pub fn index_will_tell(&self, axis: u8) -> bool {
        let joint = self.joints.get(usize::from(axis));
        joint.is_some_and(|joint| joint.indexes().will_tell())
    }

    /// Takes over the joint positions of another configuration if the encoder scalings are equal;
    /// returns whether they are.
    pub fn take_over(&mut self, standing: &PositionSnapshot, inputs: &Inputs) -> bool {
        let meanings = self.config.joints.iter().map(EncoderScaling::of);
        if !meanings.eq(standing.iter().map(|(meaning, _)| *meaning)) {
            return false;
        }
        for (index, (joint, (_, kept))) in self.joints.iter_mut().zip(standing).enumerate() {
            joint.take_over(inputs.axes[index].counts, kept);
        }
        self.update_measured();
        true
    }

    /// Derives the joint positions from the presets at power-on and the counts since. Returns false
    /// if an encoder is invalid.
    #[cold]
    #[inline(never)]
    pub fn count_from(&mut self, counted: &SincePowerOn) -> bool {
        let limit = u32::from(self.config.supervision.illegal_transitions);
        let mut is_valid = true;
        for (joint, counted) in self.joints.iter_mut().zip(&counted.axes) {
            is_valid &= joint.count_from(counted) && counted.illegal <= limit;
        }
        self.update_measured();
        is_valid
    }

    /// Number of axes.
    #[must_use]
    #[inline]
    pub fn axes(&self) -> usize {
        self.joints.len()
    }

    /// Stage *measure*: encoder counts to joint positions; with a force sensor also the pose.
    #[inline]
    pub fn measure(&mut self, inputs: &Inputs) {
        let time_ns = inputs.time_ns;
        let measured = self.measured.0.iter_mut();
        let mut leapt = false;
        for ((joint, inputs), measured) in self.joints.iter_mut().zip(&inputs.axes).zip(measured) {
            let measurement = joint.measure(inputs, time_ns);
            *measured = measurement.coordinate;
            leapt |= measurement.leapt;
        }
        if leapt {
            self.detect_jumps(u32::from(inputs.missed) + 1);
        }
        self.measure_pose();
        self.measure_haptics(&inputs.haptic);
    }

    /// Finds counters that jumped farther than a joint can move in `periods`, which is more than
    /// one after missed periods. Keeps the first jump for a report.
    #[cold]
    #[inline(never)]
    fn detect_jumps(&mut self, periods: u32) {
        for (index, joint) in self.joints.iter_mut().enumerate() {
            if joint.jumped(periods) {
                let counts = joint.measurement().moved.unsigned_abs();
                let counts = counts.min(u32::from(u16::MAX)) as u16;
                self.counter_fault.get_or_insert(Fault::EncoderIllegal {
                    axis: index as u8,
                    count: counts,
                });
            }
        }
    }

    /// Finds encoders with a stuck channel while the drives are off. Keeps the first one for a
    /// report.
    #[inline(never)]
    pub fn supervise_unpowered(&mut self) {
        let joints = self.joints.iter_mut().zip(&self.config.joints);
        for (index, (joint, axis)) in joints.enumerate() {
            let fault = joint.supervise_unpowered(index as u8, axis, self.config.period_us);
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

    /// Clears the fault of a counter after it was reported.
    pub const fn acknowledge_counter_fault(&mut self) {
        self.counter_fault = None;
    }

    fn update_measured(&mut self) {
        for (measured, joint) in self.measured.0.iter_mut().zip(&self.joints) {
            *measured = joint.measurement().coordinate;
        }
        self.measure_pose();
    }

    /// Force control needs the measured pose in every period.
    #[inline]
    fn measure_pose(&mut self) {
        if self.force.is_some() {
            self.measured_pose = self.kinematics.forward(&self.measured).ok();
        }
    }

    /// The measured pose, if the forward kinematics certifies one.
    #[must_use]
    #[inline]
    pub fn measured_pose(&self) -> Option<Pose> {
        match self.force {
            Some(_) => self.measured_pose,
            None => self.kinematics.forward(&self.measured).ok(),
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

    /// Whether every joint moves at most twice its following-error limit per second (0.6 mm/s for
    /// 0.3 mm).
    #[must_use]
    pub fn is_at_standstill(&self) -> bool {
        self.joints
            .iter()
            .zip(&self.config.joints)
            .all(|(joint, axis)| {
                i64::from(joint.rate().0).abs() <= 2 * i64::from(axis.following.0).abs()
            })
    }

    /// Switches the drives on; the commanded position becomes the measured one.
    pub fn enable(&mut self) -> Result<(), PoseError> {
        let measured = self.measured;
        self.place_at(&measured)?;
        let mut locks = false;
        for joint in &mut self.joints {
            joint.enable();
            locks |= joint.begin_lock();
        }
        self.locking = locks.then(|| LOCKING_US / u32::from(self.config.period_us.max(1)));
        Ok(())
    }

    /// Commands these joint positions, at rest. An error changes nothing.
    #[inline(never)]
    fn place_at(&mut self, joints: &Joints) -> Result<(), PoseError> {
        let pose = self.kinematics.forward(joints)?;
        self.kinematics.load(&pose, &pose, &[])?;
        self.motion.set_position(&pose);
        self.reset_force();
        self.settle();
        Ok(())
    }

    /// Whether the rotors of step motors are still locking after enable; nothing may be moved.
    #[must_use]
    #[inline]
    pub const fn is_locking(&self) -> bool {
        self.locking.is_some()
    }

    /// One period in which the rotors of step motors lock. Each rotor moves to the nearest detent,
    /// by two full steps at most, and oscillates there; its encoder counts that. When all have
    /// locked, the commanded position becomes the measured one, and steps count from there.
    ///
    /// # Errors
    /// A rotor that moved farther than the following-error limit at standstill, or that does not
    /// come to rest in time.
    #[cold]
    #[inline(never)]
    pub fn lock(&mut self) -> Result<(), Fault> {
        let Some(left) = &mut self.locking else {
            return Ok(());
        };
        *left = left.saturating_sub(1);
        let over = *left == 0;
        let enough = LOCKED_US / u32::from(self.config.period_us.max(1));
        let mut locked = true;
        for (index, (joint, axis)) in self.joints.iter_mut().zip(&self.config.joints).enumerate() {
            let Some((by, quiet)) = joint.locking(axis) else {
                continue;
            };
            let moves = quiet < enough;
            if by.magnitude() > axis.following.magnitude() || (over && moves) {
                return Err(Fault::NotLocked {
                    axis: index as u8,
                    by: by.0,
                });
            }
            locked &= !moves;
        }
        if locked {
            self.locking = None;
            self.rebase().map_err(Fault::Pose)?;
        }
        Ok(())
    }

    /// Commands step motors to their measured positions. Torque drives keep their commanded
    /// positions, because a load would push them further otherwise.
    fn rebase(&mut self) -> Result<(), PoseError> {
        let mut joints = self.target.joints;
        for (coordinate, joint) in joints.0.iter_mut().zip(&mut self.joints) {
            if let Some(slide) = joint.end_lock() {
                *coordinate = slide;
            }
        }
        self.place_at(&joints)
    }

    /// Switches the drives off.
    #[inline]
    pub fn disable(&mut self) {
        self.locking = None;
        for joint in &mut self.joints {
            joint.disable();
        }
    }

    fn settle(&mut self) {
        self.joints.iter_mut().for_each(JointDrive::settle);
    }

    /// Begins homing: the search for the index pulses.
    pub fn begin_homing(&mut self) {
        self.rebase_on_compliance();
        self.joints.iter_mut().for_each(|joint| joint.search(true));
        self.motion.begin_jog(false);
        self.homing = Homing::default();
    }

    /// Passes the index pulses of this period to homing.
    #[inline]
    pub fn check_index_pulses(&mut self) -> Result<(), Fault> {
        for (index, axis) in self.config.joints.iter().enumerate() {
            if let Some((_, coordinate)) = self.joints[index].measurement().index
                && let Some(fault) = self.homing.index(index, axis, coordinate)
            {
                return Err(fault);
            }
        }
        Ok(())
    }

    /// Corrects the positions of all joints. The commanded position becomes the measured one, so
    /// nothing moves.
    pub fn apply_homing(
        &mut self,
        corrections: &[Coordinate; MAX_AXES],
        inputs: &Inputs,
    ) -> Result<(), PoseError> {
        for (index, joint) in self.joints.iter_mut().enumerate() {
            let coordinate = joint
                .measurement()
                .motor
                .0
                .wrapping_add(corrections[index].0);
            joint.set_reference(inputs.axes[index].counts, Coordinate(coordinate));
            joint.search(false);
        }
        self.update_measured();
        let pose = self.kinematics.forward(&self.measured)?;
        self.motion.set_position(&pose);
        self.reset_force();
        self.settle();
        Ok(())
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
            if let Some(axis) = joints.get(index)
                && let Some(fault) =
                    joint.supervise(index as u8, axis, supervision, *period_us, missed)
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
        if self.is_compliant() {
            return self.solve_reference();
        }
        let commanded = self.motion.commanded();
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
        let mut joints = rates.take(self.joints.len());
        joints.position(|(rate, limit)| rate.0.unsigned_abs() > (limit.0 + (limit.0 >> 5)) as u32)
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
        self.update_excursion();
        match self.motion.advance_program(mode) {
            Some(progress) => (progress, None),
            None => self.advance_with_sources(mode),
        }
    }

    #[inline(never)]
    fn advance_with_sources(&mut self, mode: Mode) -> (Progress, Option<u8>) {
        self.motion.advance(mode, &self.kinematics)
    }

    /// The first coordinate of the pose that is beyond its soft limits.
    #[must_use]
    #[inline]
    pub fn beyond_soft_limit(&self, pose: &Pose) -> Option<u8> {
        self.config
            .pose
            .iter()
            .zip(&pose.0)
            .position(|(axis, coordinate)| *coordinate < axis.low || *coordinate > axis.high)
            .map(|index| index as u8)
    }

    /// Checks that the pose of a setpoint is within soft limits and strokes.
    ///
    /// # Errors
    /// The soft limit or pose error that refuses the setpoint.
    pub fn can_reach(&mut self, number: u32, setpoint: &Setpoint) -> Result<(), Refusal> {
        let mut pose = Pose::default();
        for (slot, value) in pose.0.iter_mut().zip(&setpoint.pose) {
            *slot = Coordinate(*value);
        }
        let pose = self.motion.destination(&pose);
        if let Some(axis) = self.beyond_soft_limit(&pose) {
            return Err(Refusal::SoftLimit {
                setpoint: number,
                axis,
            });
        }
        self.append_end(setpoint).map_err(|error| Refusal::Pose {
            setpoint: number,
            error,
        })
    }

    /// Compares the next part of the configuration with its digest; true if they agree.
    #[inline(never)]
    pub fn check_next_digest(&mut self) -> bool {
        let part = self.next_part;
        self.next_part = (part + 1) % PARTS;
        self.digest(part) == self.digests[part]
    }

    fn digest(&self, part: usize) -> Digest {
        let mut digest = Digest::default();
        let config = &self.config;
        match part {
            0 => {
                digest.add(&(&config.name, &config.model, &self.kinematics));
                digest.add(&(&config.stopping, &config.supervision, &config.homing));
                digest.add(&(config.period_us, self.crc));
            }
            1 => self.motion.digest(&mut digest),
            HAND_PART => self.digest_hand(&mut digest),
            FORCE_PART.. => self.digest_force(part - FORCE_PART, &mut digest),
            _ if part.is_multiple_of(2) => digest.add(&config.pose.get(part / 2 - 1)),
            _ => {
                let index = part / 2 - 1;
                digest.add(&config.joints.get(index));
                if let Some(joint) = self.joints.get(index) {
                    joint.digest(&mut digest);
                }
            }
        }
        digest
    }

    /// The commanded pose as values of a message.
    #[must_use]
    pub fn commanded_values(&self) -> AxisValues {
        self.values(|index| self.motion.commanded().pose.0[index].0)
    }

    /// Fills in pose and joints of a telemetry sample. The measured pose is empty when the forward
    /// kinematics does not certify one.
    pub fn fill_telemetry(&self, inputs: &Inputs, sample: &mut Telemetry) {
        let axes = self.axes();
        let commanded = &self.motion.commanded().pose.0;
        put(&mut sample.commanded, axes, |index| commanded[index].0);
        match self.measured_pose() {
            Some(pose) => put(&mut sample.measured, axes, |index| pose.0[index].0),
            None => sample.measured.clear(),
        }
        put(&mut sample.joints, axes, |index| self.measured.0[index].0);
        put(&mut sample.following_error, axes, |index| {
            self.joints[index].servo_output().following_error.0
        });
        put(&mut sample.drive, axes, |index| self.command(inputs, index));
    }

    /// Drive commands: DAC codes, or steps emitted.
    #[must_use]
    pub fn drive_values(&self, inputs: &Inputs) -> AxisValues {
        self.values(|index| self.command(inputs, index))
    }

    fn command(&self, inputs: &Inputs, index: usize) -> i32 {
        match self.joints[index].servo_output().command {
            DriveCommand::Torque(code) => i32::from(code),
            DriveCommand::Steps(_) => inputs.axes[index].steps,
            DriveCommand::Off => 0,
        }
    }

    /// State of each joint in this period, for recorders.
    pub fn joints(&self) -> impl Iterator<Item = JointSnapshot> + '_ {
        (0..self.axes()).map(|index| JointSnapshot {
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

    fn values(&self, value: impl Fn(usize) -> i32) -> AxisValues {
        (0..self.axes()).map(value).collect()
    }
}

/// Overwrites `values` in place; resizes it on first use.
fn put(values: &mut AxisValues, axes: usize, value: impl Fn(usize) -> i32) {
    let _ = values.resize(axes, 0);
    for (index, solve) in values.iter_mut().enumerate() {
        *solve = value(index);
    }
}
