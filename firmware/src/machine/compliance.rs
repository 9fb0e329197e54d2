//! Stage *comply*: force control in the machine. The reference p_r = p_d + p_c replaces the
//! commanded pose p_d as the input of the inverse kinematics (docs/control.md (3.31)-(3.33)).
//!
//! The components of a force, and of p_c, are the first three pose coordinates: x, y and z in
//! workpiece coordinates.
//!
//! Three bounds limit the compliant displacement p_c:
//! - The compliance limit, in the admittance law.
//! - The soft limits: p_r stops at a soft limit, or at p_d where that is beyond it by the
//!   tolerance, and p_c becomes the rest. It does not change its sign.
//! - The kinematics: where p_r has no joint motion, p_c returns to its value of the period before.
//!   If that reference fails as well, the machine faults.
//!
//! Callers must use [`Machine::rebase_on_compliance`] only while nothing but p_c moves the machine;
//! otherwise the commanded pose jumps.

use super::Machine;
use super::configure::FORCE_PART;
use crate::config::Config;
use crate::digest::{Constants, Digest};
use crate::force::sensor::COMPONENTS;
use crate::force::{Design, ForceControl, ForceProblem};
use crate::io::Inputs;
use haptimill_kinematics::{Accelerations, Kinematics, PoseError};
use haptimill_math::force::Displacement;
use haptimill_math::{Acceleration, Coordinate, Length, Rate};
use haptimill_protocol::message::{ConfigField, ConfigProblem};

/// Hold-off before a compliance-limit event of a component is reported again, microseconds.
const LIMITED_HOLD_OFF_US: u32 = 500_000;

impl Machine {
    /// Designs force control for a configuration before the configuration is taken.
    #[cold]
    #[inline(never)]
    pub(super) fn force_of(config: &Config) -> Result<Option<Design>, ConfigProblem> {
        let Some(force) = &config.force else {
            return Ok(None);
        };
        let design = Design::new(force, config.period_us);
        design.map(Some).map_err(|(axis, _)| ConfigProblem {
            field: ConfigField::Force,
            index: axis.map(|axis| axis as u8),
        })
    }

    #[cold]
    #[inline(never)]
    pub(super) fn configure_force(&mut self, design: Option<Design>) {
        self.force = match (&self.config.force, design) {
            (Some(force), Some(design)) => {
                Some(ForceControl::of(force, design, self.config.period_us))
            }
            _ => None,
        };
    }

    /// Stage *measure*, force part: converter codes to forces. `active`: something moves or may
    /// move.
    #[inline]
    pub fn measure_force(&mut self, inputs: &Inputs, spindle_rpm: i16, active: bool) {
        let Some(force) = &mut self.force else {
            return;
        };
        let pose = self.measured_pose.as_ref().unwrap_or(&self.reference.pose);
        let [x, y, z, ..] = pose.0;
        let unloaded = force.unloaded(active);
        let rotation = self.kinematics.sensor_rotation(pose);
        force.measure(&inputs.force, spindle_rpm, &[x, y, z], rotation, unloaded);
        force.update_overload(active);
    }

    /// Whether the reference may differ from the commanded pose.
    #[inline]
    pub(super) fn is_compliant(&self) -> bool {
        self.force
            .as_ref()
            .is_some_and(|force| !force.is_inactive())
    }

    /// Stage *comply*: computes the reference of this period. `stopped`: a force fault stops the
    /// machine. `homing`: the index pulses are searched for.
    #[inline]
    pub fn comply(&mut self, stopped: bool, homing: bool) {
        let Some(force) = &mut self.force else {
            return;
        };
        force.suspend(homing);
        if force.is_inactive() && self.limited == [0; COMPONENTS] {
            // No axis is under force control, and no displacement is left.
            force.hold(stopped);
            self.reference.pose = self.motion.commanded().pose;
            return;
        }
        self.apply_admittance(stopped);
    }

    #[inline(never)]
    fn apply_admittance(&mut self, stopped: bool) {
        let Some(force) = &mut self.force else {
            return;
        };
        // A force above its limit is still valid: the tool complies with it while the machine
        // decelerates.
        let invalid = force
            .condition()
            .is_some_and(|problem| !matches!(problem, ForceProblem::Limit { .. }));
        force.hold(stopped || (invalid && force.mask() != 0));
        let commanded = self.motion.commanded();
        let [x, y, z, ..] = commanded.rates;
        let compliance = *force.advance(&[x, y, z]);
        self.reference = *commanded;
        let mut limited = 0;
        for (component, compliance) in compliance.iter().enumerate() {
            if compliance.limited {
                limited |= 1 << component;
            }
            if compliance.displacement == Displacement::default() && compliance.rate == Rate::ZERO {
                continue;
            }
            let commanded = self.reference.pose.0[component];
            let reference = self.displace(component, compliance.displacement);
            let rate = &mut self.reference.rates[component];
            *rate = rate.saturating_add(compliance.rate);
            let acceleration = &mut self.reference.accelerations[component];
            *acceleration = acceleration.saturating_add(compliance.acceleration);
            if let Some(end) = self.soft_limit_passed(component, commanded, reference) {
                self.stop_at_soft_limit(component, commanded, end);
                limited |= 1 << component;
            }
        }
        self.report_limited(limited);
        if self.force.as_ref().is_some_and(ForceControl::adopted) {
            for part in FORCE_PART..super::PARTS {
                self.digests[part] = self.digest(part);
            }
        }
    }

    /// One period with the drives off: resets the compliant displacement.
    pub fn release_force(&mut self) {
        if let Some(force) = &mut self.force {
            force.release();
            if force.adopted() {
                for part in FORCE_PART..super::PARTS {
                    self.digests[part] = self.digest(part);
                }
            }
        }
    }

    /// Writes p_d + p_c of one component into the reference, and returns it.
    fn displace(&mut self, component: usize, by: Displacement) -> Coordinate {
        let commanded = self.motion.commanded().pose.0[component];
        let reference = Coordinate(commanded.0.saturating_add(by.length().0));
        self.reference.pose.0[component] = reference;
        reference
    }

    /// The end that the reference passes: the soft limit, or the commanded position where that is
    /// beyond it by the tolerance.
    fn soft_limit_passed(
        &self,
        component: usize,
        commanded: Coordinate,
        reference: Coordinate,
    ) -> Option<Coordinate> {
        let axis = self.config.pose.get(component)?;
        let (low, high) = (axis.low.min(commanded), axis.high.max(commanded));
        if reference > high {
            Some(high)
        } else if reference < low {
            Some(low)
        } else {
            None
        }
    }

    /// Stops the reference of one component at a soft limit.
    fn stop_at_soft_limit(&mut self, component: usize, commanded: Coordinate, end: Coordinate) {
        // The result is a p_c of smaller magnitude, so it fits.
        let left = Length(end.0.saturating_sub(commanded.0));
        if let Some(force) = &mut self.force {
            force.clamp_displacement(component, Displacement::from_length(left));
        }
        self.reference.pose.0[component] = end;
        self.reference.rates[component] = Rate::ZERO;
        self.reference.accelerations[component] = Acceleration::ZERO;
    }

    /// Passes p_c and its rate to the jog source: the joint rates include them.
    #[inline]
    pub(super) fn pass_displacement_to_jog(&mut self) {
        if let Some(force) = &self.force {
            let displacement = force
                .compliance()
                .map(|of| (of.displacement.length().0, of.rate));
            self.motion.jog.displace(&displacement);
        }
    }

    /// Whether a commanded joint rate exceeds its maximum.
    fn exceeds_joint_rate(&self) -> bool {
        let rates = self.target.rates.iter().zip(self.kinematics.rates());
        let mut joints = rates.take(self.axes());
        joints.any(|(rate, limit)| rate.0.unsigned_abs() > limit.0.unsigned_abs())
    }

    /// Stage *solve* with force control.
    #[inline(never)]
    pub(super) fn solve_reference(&mut self) -> Result<(), PoseError> {
        let placed = self.solve_once();
        if placed.is_ok() && !self.exceeds_joint_rate() {
            return Ok(());
        }
        // The tool complies no further where a joint rate would exceed its maximum.
        let Some(force) = self.force.as_mut().filter(|force| force.displaced()) else {
            return placed;
        };
        let compliance = *force.roll_back();
        let mut limited = 0;
        for (component, compliance) in compliance.iter().enumerate() {
            let commanded = self.motion.commanded();
            self.reference.rates[component] = commanded.rates[component];
            self.reference.accelerations[component] = commanded.accelerations[component];
            self.displace(component, compliance.displacement);
            if compliance.displacement != Displacement::default() {
                limited |= 1 << component;
            }
        }
        self.report_limited(limited);
        self.solve_once()
    }

    fn solve_once(&mut self) -> Result<(), PoseError> {
        let mut reference = &self.reference;
        if let (Some(compensation), Some(tables)) =
            (&mut self.compensation, &self.config.volumetric)
            && compensation.is_active()
        {
            reference = compensation.correct(tables, reference);
        }
        let accelerations: &Accelerations = &reference.accelerations;
        self.kinematics.solve(
            &reference.pose,
            &reference.rates,
            accelerations,
            &mut self.target,
        )
    }

    fn report_limited(&mut self, limited: u8) {
        let periods = LIMITED_HOLD_OFF_US / u32::from(self.config.period_us.max(1));
        for (component, left) in self.limited.iter_mut().enumerate() {
            if limited & (1 << component) == 0 {
                *left = left.saturating_sub(1);
                continue;
            }
            if *left == 0 {
                self.newly_limited |= 1 << component;
            }
            *left = periods.min(u32::from(u16::MAX)) as u16;
        }
    }

    /// The next component that reached the compliance limit; each is reported once.
    pub const fn take_limited(&mut self) -> Option<u8> {
        if self.newly_limited == 0 {
            return None;
        }
        let component = self.newly_limited.trailing_zeros();
        self.newly_limited &= self.newly_limited - 1;
        Some(component as u8)
    }

    /// Makes the reference the commanded pose, at rest: the tool stays at its compliant
    /// displacement.
    ///
    /// A compliant displacement that still moves follows its admittance law instead: a rebase would
    /// stop it within a period.
    pub fn rebase_on_compliance(&mut self) {
        let Some(force) = &mut self.force else {
            return;
        };
        if force.moves() {
            force.reset_contact();
            return;
        }
        if force.displaced() {
            let pose = self.reference.pose;
            self.motion.set_position(&pose);
        }
        force.reset();
    }

    /// Resets the compliant displacement after the commanded pose became the measured one.
    pub(super) fn reset_force(&mut self) {
        if let Some(force) = &mut self.force {
            force.reset();
        }
    }

    /// Adds a digest part of force control: 0 is the sensor and its configuration, the others are
    /// the active settings of each axis.
    pub(super) fn digest_force(&self, part: usize, digest: &mut Digest) {
        if part == 0 {
            digest.add(&self.config.force);
        }
        let Some(force) = &self.force else {
            return;
        };
        match part {
            0 => Constants::digest(force, digest),
            1..=COMPONENTS => force.digest_axis(part - 1, digest),
            _ => {}
        }
    }

    /// The input of the inverse kinematics: p_r, or the commanded pose without a compliant
    /// displacement.
    #[must_use]
    pub fn reference(&self) -> &crate::motion::PoseCommand {
        if self.is_compliant() {
            &self.reference
        } else {
            self.motion.commanded()
        }
    }
}
