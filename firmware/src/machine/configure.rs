//! Configuration of a machine: from its presets, from the machine before, and the check of its
//! parts against their digests.

use super::Machine;
use super::correction::VOLUMETRIC_PARTS;
use super::gantry::Gantries;
use super::joint_rates::JointRates;
use super::masters::Masters;
use super::switches::Switches;
use crate::config::{AxisKind, Config, Drive, JointSettings, SwitchInput};
use crate::digest::{Constants, Digest};
use crate::force::Design;
use crate::force::sensor::COMPONENTS;
use crate::io::Inputs;
use crate::joint::power_on_counts::SincePowerOn;
use crate::joint::{EncoderState, JointDrive};
use crate::motion::{Motion, PoseCommand};
use crate::named_io::NamedIo;
use crate::safety::homing::Homing;
use crate::volumetric::Compensation;
use haptimill_kinematics::{JointMotion, Joints};
use haptimill_math::Coordinate;
use haptimill_protocol::message::{ConfigField, ConfigProblem, MAX_AXES};
use heapless::Vec;

/// Number of parts in which the configuration and the values derived from it are checked against
/// their digests. The parts are: geometry and bounds, motion, each pose axis and each joint, the
/// haptic arm, the named inputs and outputs, the error tables, the force sensor, each axis of
/// force control.
pub(super) const PARTS: usize = FORCE_PART + 1 + COMPONENTS;

/// Digest part of the haptic arm.
pub(super) const HAPTICS_PART: usize = 2 + 2 * MAX_AXES;

/// Digest part of the force sensor.
pub(super) const FORCE_PART: usize = VOLUMETRIC_PART + VOLUMETRIC_PARTS;

/// Digest part of the error tables.
pub(super) const VOLUMETRIC_PART: usize = IO_PART + 1;

/// Digest part of the named inputs and outputs.
pub(super) const IO_PART: usize = HAPTICS_PART + 1;

/// Encoder scaling and encoder state of each joint.
pub type PositionSnapshot = Vec<(EncoderScaling, EncoderState), MAX_AXES>;

/// Scaling of the counter of a joint: kind, axis units per count of the encoder (or per step),
/// preset, index and index pitch, and the coordinate and side of the home switch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EncoderScaling(
    AxisKind,
    i64,
    [Coordinate; 3],
    Option<(SwitchInput, bool, Coordinate)>,
);

impl EncoderScaling {
    fn of(joint: &JointSettings) -> Self {
        let (per_count, index, pitch) = match (&joint.encoder, &joint.drive) {
            (Some(encoder), _) => (encoder.per_count, encoder.index, encoder.index_pitch),
            (None, Drive::Steps { per_step, .. }) => (*per_step, Coordinate(0), Coordinate(0)),
            (None, Drive::Torque { .. }) => (0, Coordinate(0), Coordinate(0)),
        };
        let home = joint.home.switch();
        let switch = home.map(|home| (home.input, home.downwards, home.coordinate));
        Self(joint.kind, per_count, [joint.preset, index, pitch], switch)
    }
}

impl Machine {
    /// Creates the machine of a configuration, at its presets.
    ///
    /// # Errors
    /// The first problem of the configuration.
    pub fn new(config: Config, crc: u32, inputs: &Inputs) -> Result<Self, ConfigProblem> {
        Self::check_joints(&config)?;
        let design = Self::force_of(&config)?;
        let mut machine = Self::bare(&config, crc);
        machine.configure(design, inputs);
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
        config: &Config,
        crc: u32,
        inputs: &Inputs,
    ) -> Result<(), ConfigProblem> {
        Self::check_joints(config)?;
        let design = Self::force_of(config)?;
        Self::install_bare(slot, config, crc);
        if let Some(machine) = slot {
            machine.configure(design, inputs);
        }
        Ok(())
    }

    /// Checks the configuration, and that its joints can be created.
    #[cold]
    #[inline(never)]
    fn check_joints(config: &Config) -> Result<(), ConfigProblem> {
        config.check()?;
        for (index, joint) in config.joints.iter().enumerate() {
            JointDrive::new(joint, config.period_us).map_err(|_| ConfigProblem {
                field: ConfigField::Drive,
                index: Some(index as u8),
            })?;
        }
        Ok(())
    }

    /// Creates the joints, at their presets. [`Machine::check_joints`] has found no problem.
    #[cold]
    #[inline(never)]
    fn create_joints(&mut self, inputs: &Inputs) {
        for (settings, joint_inputs) in self.config.joints.iter().zip(&inputs.joints) {
            let Ok(mut joint) = JointDrive::new(settings, self.config.period_us) else {
                return;
            };
            joint.measure(joint_inputs, inputs.time_ns);
            joint.set_reference(joint.counter(joint_inputs), settings.preset);
            let _ = self.joints.push(joint);
        }
    }

    /// Moves a new machine into the slot. The machine is built on the stack first; a function of
    /// its own keeps that frame free of anything else.
    #[cold]
    #[inline(never)]
    fn install_bare(slot: &mut Option<Self>, config: &Config, crc: u32) {
        *slot = Some(Self::bare(config, crc));
    }

    /// A machine without joints and motion.
    #[inline(always)]
    fn bare(config: &Config, crc: u32) -> Self {
        Self {
            kinematics: config.kinematics(),
            motion: Motion::default(),
            homing: Homing::default(),
            switches: Switches::default(),
            plain_switches: true,
            gantries: Gantries::default(),
            force: None,
            masters: Masters::default(),
            io: NamedIo::new(&config.io),
            compensation: None,
            reference: PoseCommand::default(),
            limited: [0; COMPONENTS],
            newly_limited: 0,
            joints: Vec::new(),
            measured: Joints::default(),
            wrapping: 0,
            turns: [0; MAX_AXES],
            measured_pose: None,
            target: JointMotion::default(),
            joint_rates: JointRates::default(),
            digests: [Digest::default(); PARTS],
            next_part: 0,
            locking: None,
            counter_fault: None,
            config: config.clone(),
            crc,
        }
    }

    #[cold]
    #[inline(never)]
    fn configure(&mut self, design: Option<Design>, inputs: &Inputs) {
        self.create_joints(inputs);
        self.gantries = Gantries::new(&self.config);
        self.wrapping = self.config.wrapping_joints();
        self.configure_force(design);
        self.configure_haptics(&inputs.haptic);
        let period_us = self.config.period_us;
        let tables = self.config.volumetric.as_ref();
        self.compensation = tables.map(|tables| Compensation::new(tables, period_us));
        self.motion.configure(&self.config);
        self.plain_switches = self.has_plain_switches();
        for part in 0..PARTS {
            self.digests[part] = self.digest(part);
        }
        self.update_measured();
    }

    /// Encoder scaling and state of all joints, which a new configuration may take over.
    #[must_use]
    pub fn positions(&self) -> PositionSnapshot {
        let joints = self.config.joints.iter().zip(&self.joints);
        joints
            .map(|(settings, joint)| (EncoderScaling::of(settings), joint.encoder_state()))
            .collect()
    }

    /// Whether a joint can move unseen while its drive is off: it has no encoder, and nothing holds
    /// it.
    #[must_use]
    pub fn loses_position_without_drives(&self) -> bool {
        let mut joints = self.config.joints.iter();
        joints.any(|joint| joint.encoder.is_none() && !joint.keeps_position)
    }

    /// Whether a joint homes by its preset, or by the index pulse nearest to it.
    #[must_use]
    pub fn needs_presets(&self) -> bool {
        let mut joints = self.config.joints.iter();
        joints.any(|joint| joint.home.switch().is_none())
    }

    /// Whether the next index pulse of a joint will confirm or refute its encoder.
    #[must_use]
    pub fn index_decides(&self, joint: u8) -> bool {
        let joint = self.joints.get(usize::from(joint));
        joint.is_some_and(|joint| joint.indexes().is_armed())
    }

    /// Takes over the joint positions of another configuration if the encoder scalings are equal;
    /// returns whether they are.
    pub fn take_over(&mut self, positions: &PositionSnapshot, inputs: &Inputs) -> bool {
        let scalings = self.config.joints.iter().map(EncoderScaling::of);
        if !scalings.eq(positions.iter().map(|(scaling, _)| *scaling)) {
            return false;
        }
        for (index, (joint, (_, state))) in self.joints.iter_mut().zip(positions).enumerate() {
            joint.take_over(joint.counter(&inputs.joints[index]), state);
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
        for (joint, counted) in self.joints.iter_mut().zip(&counted.encoders) {
            is_valid &= joint.count_from(counted) && counted.illegal <= limit;
        }
        self.update_measured();
        is_valid
    }

    /// Compares the next part of the configuration with its digest; true if they agree.
    #[inline(never)]
    pub fn check_next_digest(&mut self) -> bool {
        let part = self.next_part;
        self.next_part = (part + 1) % PARTS;
        self.digest(part) == self.digests[part]
    }

    pub(super) fn digest(&self, part: usize) -> Digest {
        let mut digest = Digest::default();
        let config = &self.config;
        match part {
            0 => {
                digest.add(&(&config.name, &config.model, &self.kinematics));
                digest.add(&(&config.stopping, &config.supervision, &config.homing));
                digest.add(&(config.period_us, self.crc, self.gantries.seconds()));
            }
            1 => self.motion.digest(&mut digest),
            HAPTICS_PART => self.digest_haptics(&mut digest),
            IO_PART => digest.add(&config.io),
            VOLUMETRIC_PART..FORCE_PART => {
                self.digest_volumetric(part - VOLUMETRIC_PART, &mut digest);
            }
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
}
