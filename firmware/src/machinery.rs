//! The parts that a configuration makes: geometry, joints, motion, force control, haptic arm; and the stages that are theirs.

pub mod hand;
mod joint_rates;
mod yielding;

use crate::config::{AxisKind, Config, JointAxis};
use crate::drive::counted::SincePowerOn;
use crate::drive::{JointDrive, Kept};
use crate::force::conditioning::COMPONENTS;
use crate::force::{Design, ForceControl};
use crate::io::{DriveCommand, Inputs};
use crate::kinematics::machine::Machine;
use crate::kinematics::{JointMotion, Joints, Kinematics, Pose, PoseError};
use crate::motion::program::Progress;
use crate::motion::{Mode, Motion, Wanted};
use crate::safety::homing::Homing;
use crate::safety::integrity::{Constants, Digest};
use crate::units::Coordinate;
use hand::Hands;
use haptimill_protocol::message::{
    AxisValues, ConfigField, ConfigProblem, Fault, MAX_AXES, Refusal, Telemetry,
};
use haptimill_protocol::setpoint::Setpoint;
use heapless::Vec;
use joint_rates::JointRates;

/// Parts in which the configuration, and what was worked out from it, is checked against its digest: geometry and bounds, motion, then each axis of
/// the pose and each joint, then the haptic arm, then the force sensor and each axis of force control.
const PARTS: usize = FORCE_PART + 1 + COMPONENTS;

/// The part of the haptic arm.
const HAND_PART: usize = 2 + 2 * MAX_AXES;

/// The part of the force sensor.
const FORCE_PART: usize = HAND_PART + 1;

/// What the counts of each joint mean, where it stands, and what is known of its encoder.
pub type Standing = Vec<(Meaning, Kept), MAX_AXES>;

/// What the counts of a joint's encoder mean: kind, axis units per count, preset, index and its pitch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Meaning(AxisKind, i64, Coordinate, Coordinate, Coordinate);

impl Meaning {
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

/// One joint in one period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct JointReading {
    /// Where it is.
    pub measured: Coordinate,
    /// Where it shall be.
    pub wanted: Coordinate,
    /// What its loop works on.
    pub following_error: Coordinate,
    /// What its drive was told.
    pub command: DriveCommand,
}

/// A configured machine.
#[derive(Debug)]
pub struct Machinery {
    /// The configuration.
    pub config: Config,
    /// CRC-32 of the configuration as it was sent.
    pub crc: u32,
    /// Geometry and strokes.
    pub machine: Machine,
    /// What is wanted.
    pub motion: Motion,
    /// The search for the references.
    pub homing: Homing,
    /// Force sensor and force control, on a machine that has them.
    pub force: Option<ForceControl>,
    /// The haptic arm, and the hands that lead.
    pub hands: Hands,
    /// p_r on a machine with force control: what is placed. Without it that is what is wanted.
    reference: Wanted,
    /// Periods for which a component that could not yield any further is still taken for one.
    limited: [u16; COMPONENTS],
    /// Components that could not yield any further in this period, and could before.
    newly_limited: u8,
    joints: Vec<JointDrive, MAX_AXES>,
    measured: Joints,
    /// On a machine with a force sensor; without one the pose is worked out for whoever asks.
    measured_pose: Option<Pose>,
    target: JointMotion,
    /// Of the setpoints of a job.
    joint_rates: JointRates,
    digests: [Digest; PARTS],
    next_part: usize,
    /// Periods in which the rotors of step motors may still lock, after their drives were switched on.
    locking: Option<u32>,
    /// A counter that jumped and was not named yet: joint, and counts.
    jumped: Option<(u8, u16)>,
}

/// A rotor has locked when it has stayed in its place for so long, microseconds: six cycles of one that swings at 120 Hz.
const LOCKED_US: u32 = 50_000;

/// All rotors must have locked after so long, microseconds.
const LOCKING_US: u32 = 1_000_000;

impl Machinery {
    /// The machine of a configuration, standing at its presets.
    ///
    /// # Errors
    /// What is wrong with the configuration.
    pub fn new(config: Config, crc: u32, inputs: &Inputs) -> Result<Self, ConfigProblem> {
        let joints = Self::joints_of(&config, inputs)?;
        let design = Self::force_of(&config)?;
        let mut machinery = Self::bare(config, crc);
        machinery.set_up(joints, design, inputs);
        Ok(machinery)
    }

    /// The machine of a configuration takes its place in `slot`, where it stays: with its queue it is too large to be handed from one function to the
    /// next on the stack of a microcontroller. A refused configuration leaves the slot as it was.
    ///
    /// # Errors
    /// What is wrong with the configuration.
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
        Self::place_bare(slot, config, crc);
        if let Some(machinery) = slot {
            machinery.set_up(joints, design, inputs);
        }
        Ok(())
    }

    /// The joints of a configuration that has been checked, at their presets.
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
            joint.sense(&inputs.axes[index], inputs.time_ns);
            joint.set_reference(inputs.axes[index].counts, axis.preset);
            joints.push(joint).map_err(|_| problem)?;
        }
        Ok(joints)
    }

    /// A machine is put together on the stack before it takes its place: nothing else shall be there meanwhile.
    #[cold]
    #[inline(never)]
    fn place_bare(slot: &mut Option<Self>, config: Config, crc: u32) {
        *slot = Some(Self::bare(config, crc));
    }

    /// Without joints and motion.
    #[inline(always)]
    fn bare(config: Config, crc: u32) -> Self {
        Self {
            machine: Machine::new(&config),
            motion: Motion::default(),
            homing: Homing::default(),
            force: None,
            hands: Hands::default(),
            reference: Wanted::default(),
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
            jumped: None,
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
        self.remember_measured();
    }

    /// Where the joints stand, and what their counts mean: what a new configuration may take over.
    #[must_use]
    pub fn standing(&self) -> Standing {
        let joints = self.config.joints.iter().zip(&self.joints);
        joints
            .map(|(axis, joint)| (Meaning::of(axis), joint.standing()))
            .collect()
    }

    /// Whether the next index pulse of a joint will tell if its encoder has lost counts.
    #[must_use]
    pub fn index_will_tell(&self, axis: u8) -> bool {
        let joint = self.joints.get(usize::from(axis));
        joint.is_some_and(|joint| joint.indexes().will_tell())
    }

    /// Takes over where the joints stood under another configuration, if counts mean the same; says whether they do.
    pub fn take_over(&mut self, standing: &Standing, inputs: &Inputs) -> bool {
        let meanings = self.config.joints.iter().map(Meaning::of);
        if !meanings.eq(standing.iter().map(|(meaning, _)| *meaning)) {
            return false;
        }
        for (index, (joint, (_, kept))) in self.joints.iter_mut().zip(standing).enumerate() {
            joint.take_over(inputs.axes[index].counts, kept);
        }
        self.remember_measured();
        true
    }

    /// The joints stood at their presets at power-on, and have moved from there as was counted since. False if an encoder cannot be believed.
    #[cold]
    #[inline(never)]
    pub fn count_from(&mut self, counted: &SincePowerOn) -> bool {
        let limit = u32::from(self.config.supervision.illegal_transitions);
        let mut believed = true;
        for (joint, counted) in self.joints.iter_mut().zip(&counted.axes) {
            believed &= joint.count_from(counted) && counted.illegal <= limit;
        }
        self.remember_measured();
        believed
    }

    /// Number of axes.
    #[must_use]
    #[inline]
    pub fn axes(&self) -> usize {
        self.joints.len()
    }

    /// Stage *sense*: encoders to joints, and where a force is felt joints to pose.
    #[inline]
    pub fn sense(&mut self, inputs: &Inputs) {
        let time_ns = inputs.time_ns;
        let measured = self.measured.0.iter_mut();
        let mut leapt = false;
        for ((joint, inputs), measured) in self.joints.iter_mut().zip(&inputs.axes).zip(measured) {
            let sensed = joint.sense(inputs, time_ns);
            *measured = sensed.coordinate;
            leapt |= sensed.leapt;
        }
        if leapt {
            self.note_jumps(u32::from(inputs.missed) + 1);
        }
        self.measure_pose();
        self.sense_hand(&inputs.haptic);
    }

    /// In so many periods a joint can go farther than in one.
    #[cold]
    #[inline(never)]
    fn note_jumps(&mut self, periods: u32) {
        for (index, joint) in self.joints.iter_mut().enumerate() {
            if joint.jumped(periods) {
                let counts = joint.sensed().moved.unsigned_abs();
                let counts = counts.min(u32::from(u16::MAX)) as u16;
                self.jumped.get_or_insert((index as u8, counts));
            }
        }
    }

    /// A counter that jumped, whether drives are on or off, until it [was named](Self::named_jump): joint, and counts.
    #[must_use]
    #[inline]
    pub const fn jump(&self) -> Option<(u8, u16)> {
        self.jumped
    }

    /// The fault of that joint was named.
    pub const fn named_jump(&mut self) {
        self.jumped = None;
    }

    fn remember_measured(&mut self) {
        for (measured, joint) in self.measured.0.iter_mut().zip(&self.joints) {
            *measured = joint.sensed().coordinate;
        }
        self.measure_pose();
    }

    /// What a force acts on is needed in every period.
    #[inline]
    fn measure_pose(&mut self) {
        if self.force.is_some() {
            self.measured_pose = self.machine.forward(&self.measured).ok();
        }
    }

    /// The measured pose, if the forward kinematics certifies one.
    #[must_use]
    #[inline]
    pub fn measured_pose(&self) -> Option<Pose> {
        match self.force {
            Some(_) => self.measured_pose,
            None => self.machine.forward(&self.measured).ok(),
        }
    }

    /// Whether the encoders have made no more illegal transitions since they were enabled last than supervision allows.
    #[must_use]
    #[inline]
    pub fn encoders_counted(&self) -> bool {
        let limit = u32::from(self.config.supervision.illegal_transitions);
        self.joints
            .iter()
            .all(|joint| joint.sensed().illegal <= limit)
    }

    /// Whether no joint moves faster than twice its following error in a second (0.6 mm/s for 0.3 mm).
    #[must_use]
    pub fn is_still(&self) -> bool {
        self.joints
            .iter()
            .zip(&self.config.joints)
            .all(|(joint, axis)| {
                i64::from(joint.rate().0).abs() <= 2 * i64::from(axis.following.0).abs()
            })
    }

    /// Wanted becomes measured, drives on.
    pub fn enable(&mut self) -> Result<(), PoseError> {
        let measured = self.measured;
        self.stand_at(&measured)?;
        let mut locks = false;
        for joint in &mut self.joints {
            joint.enable();
            locks |= joint.begin_lock();
        }
        self.locking = locks.then(|| LOCKING_US / u32::from(self.config.period_us.max(1)));
        Ok(())
    }

    /// These joints are commanded, at rest; an error changes nothing.
    #[inline(never)]
    fn stand_at(&mut self, joints: &Joints) -> Result<(), PoseError> {
        let pose = self.machine.forward(joints)?;
        self.machine.inverse(&pose)?;
        self.motion.place(&pose);
        self.forget_force();
        self.settle();
        Ok(())
    }

    /// Whether the drives were just switched on and the rotors of step motors have not locked yet: nothing may be moved.
    #[must_use]
    #[inline]
    pub const fn is_locking(&self) -> bool {
        self.locking.is_some()
    }

    /// One period in which the rotors of step motors lock: each moves to the nearest detent, by two full steps at most, and swings there. Its encoder counts that. When all have
    /// locked, the commanded position becomes the measured one, and steps count from there.
    ///
    /// # Errors
    /// A rotor that is farther from where it was switched on than a joint may be off at rest, or that does not come to rest.
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

    /// Step motors are commanded where they are measured; torque drives stay where they are commanded, or a load would push them on.
    fn rebase(&mut self) -> Result<(), PoseError> {
        let mut joints = self.target.joints;
        for (coordinate, joint) in joints.0.iter_mut().zip(&mut self.joints) {
            if let Some(slide) = joint.end_lock() {
                *coordinate = slide;
            }
        }
        self.stand_at(&joints)
    }

    /// Drives off.
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

    /// Begins the search for the references.
    pub fn begin_homing(&mut self) {
        self.absorb();
        self.joints.iter_mut().for_each(|joint| joint.search(true));
        self.motion.begin_jog(false);
        self.homing = Homing::default();
    }

    /// Index pulses of this period, for the search.
    #[inline]
    pub fn note_indexes(&mut self) -> Result<(), Fault> {
        for (index, axis) in self.config.joints.iter().enumerate() {
            if let Some((_, coordinate)) = self.joints[index].sensed().index
                && let Some(fault) = self.homing.index(index, axis, coordinate)
            {
                return Err(fault);
            }
        }
        Ok(())
    }

    /// Corrects the coordinates of all joints; wanted becomes measured, so nothing moves.
    pub fn correct(
        &mut self,
        corrections: &[Coordinate; MAX_AXES],
        inputs: &Inputs,
    ) -> Result<(), PoseError> {
        for (index, joint) in self.joints.iter_mut().enumerate() {
            let coordinate = joint.sensed().motor.0.wrapping_add(corrections[index].0);
            joint.set_reference(inputs.axes[index].counts, Coordinate(coordinate));
            joint.search(false);
        }
        self.remember_measured();
        let pose = self.machine.forward(&self.measured)?;
        self.motion.place(&pose);
        self.forget_force();
        self.settle();
        Ok(())
    }

    /// Supervision of all joints against what was wanted of them in the period before; periods were `missed` since.
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

    /// Stage *place*: the wanted pose, or its reference where the tool yields, to the joints.
    #[inline]
    pub fn place(&mut self) -> Result<(), PoseError> {
        if self.yields() {
            return self.place_reference();
        }
        let wanted = self.motion.wanted();
        self.machine.place(
            &wanted.pose,
            &wanted.rates,
            &wanted.accelerations,
            &mut self.target,
        )
    }

    /// The first joint that is commanded more than its maximum rate and 1/32 of it: something that no look ahead has prevented.
    #[must_use]
    #[inline]
    pub fn joint_too_fast(&self) -> Option<usize> {
        let rates = self.target.rates.iter().zip(self.machine.rates());
        let mut joints = rates.take(self.joints.len());
        joints.position(|(rate, limit)| rate.0.unsigned_abs() > (limit.0 + (limit.0 >> 5)) as u32)
    }

    /// Stage *drive*: position loops. Gives a joint whose drive was asked for too much.
    #[inline]
    pub fn drive(&mut self, commands: &mut [DriveCommand; MAX_AXES]) -> Option<u8> {
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
            if joint.drive(coordinate, rate, accelerations[index], command) {
                saturated = Some(index as u8);
            }
        }
        saturated
    }

    /// What is wanted in this period. The number is a coordinate whose jog was kept from going on.
    #[inline]
    pub fn advance(&mut self, mode: Mode) -> (Progress, Option<u8>) {
        self.tell_excursion();
        match self.motion.advance_alone(mode) {
            Some(progress) => (progress, None),
            None => self.advance_by_hand(mode),
        }
    }

    #[inline(never)]
    fn advance_by_hand(&mut self, mode: Mode) -> (Progress, Option<u8>) {
        self.motion.advance(mode, &self.machine)
    }

    /// The first coordinate of the wanted pose that is beyond its soft limits.
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

    /// Whether the machine can be where a setpoint says, within its soft limits.
    ///
    /// # Errors
    /// What is wrong with that pose.
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
        self.note_end(setpoint).map_err(|error| Refusal::Pose {
            setpoint: number,
            error,
        })
    }

    /// Compares one part of the configuration with its digest, another one each time.
    #[inline(never)]
    pub fn configuration_intact(&mut self) -> bool {
        let part = self.next_part;
        self.next_part = (part + 1) % PARTS;
        self.digest(part) == self.digests[part]
    }

    fn digest(&self, part: usize) -> Digest {
        let mut digest = Digest::default();
        let config = &self.config;
        match part {
            0 => {
                digest.add(&(&config.name, &config.model, &self.machine));
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

    /// The wanted pose as values of a message.
    #[must_use]
    pub fn wanted_values(&self) -> AxisValues {
        self.values(|index| self.motion.wanted().pose.0[index].0)
    }

    /// Notes down what telemetry tells of pose and joints; the measured pose is empty when it is not certified.
    pub fn note(&self, inputs: &Inputs, note: &mut Telemetry) {
        let axes = self.axes();
        let wanted = &self.motion.wanted().pose.0;
        put(&mut note.wanted, axes, |index| wanted[index].0);
        match self.measured_pose() {
            Some(pose) => put(&mut note.measured, axes, |index| pose.0[index].0),
            None => note.measured.clear(),
        }
        put(&mut note.joints, axes, |index| self.measured.0[index].0);
        put(&mut note.following_error, axes, |index| {
            self.joints[index].driven().following_error.0
        });
        put(&mut note.drive, axes, |index| self.command(inputs, index));
    }

    /// Drive commands: DAC codes, or steps emitted.
    #[must_use]
    pub fn drive_values(&self, inputs: &Inputs) -> AxisValues {
        self.values(|index| self.command(inputs, index))
    }

    fn command(&self, inputs: &Inputs, index: usize) -> i32 {
        match self.joints[index].driven().command {
            DriveCommand::Torque(code) => i32::from(code),
            DriveCommand::Steps(_) => inputs.axes[index].steps,
            DriveCommand::Off => 0,
        }
    }

    /// What each joint measured and was told in this period, for recorders.
    pub fn joints(&self) -> impl Iterator<Item = JointReading> + '_ {
        (0..self.axes()).map(|index| JointReading {
            measured: self.measured.0[index],
            wanted: self.target.joints.0[index],
            following_error: self.joints[index].driven().following_error,
            command: self.joints[index].driven().command,
        })
    }

    /// What the joints were told last: positions, rates and accelerations.
    #[must_use]
    pub const fn target(&self) -> &JointMotion {
        &self.target
    }

    fn values(&self, value: impl Fn(usize) -> i32) -> AxisValues {
        (0..self.axes()).map(value).collect()
    }
}

/// Writes values where there are as many already, but for the first time.
fn put(values: &mut AxisValues, axes: usize, value: impl Fn(usize) -> i32) {
    let _ = values.resize(axes, 0);
    for (index, place) in values.iter_mut().enumerate() {
        *place = value(index);
    }
}
