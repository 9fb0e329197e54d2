//! Force control in the machine: what it senses, and the reference p_r = p_d + p_c that is placed instead of the wanted pose (spec h4-milling (3.31)-(3.33)).
//!
//! The components of a force, and of p_c, are the first three pose coordinates: x, y and z of the work.
//!
//! p_c bends to three bounds. Its own limit is in its law. Where p_r would leave a soft limit it stands there, and p_c gives way (never beyond 0: p_d is inside). Where
//! the machine cannot place p_r, p_c is taken back to what it was a period before; if p_r cannot be placed even then, it is a fault.
//!
//! Misuse: [`Machinery::absorb`] while the machine moves (other than by p_c). What is wanted would jump.

use super::{FORCE_PART, Machinery};
use crate::config::Config;
use crate::force::conditioning::COMPONENTS;
use crate::force::{Design, ForceControl, ForceProblem};
use crate::io::Inputs;
use crate::kinematics::{Accelerations, PoseError};
use crate::safety::integrity::{Constants, Digest};
use crate::units::force::Displacement;
use crate::units::{Acceleration, Coordinate, Length, Rate};
use haptimill_protocol::message::{ConfigField, ConfigProblem};

/// How long a component must have been able to yield before another end of it is told, microseconds.
const TOLD_FOR_US: u32 = 500_000;

impl Machinery {
    /// What is worked out for force control, before a configuration is taken.
    #[cold]
    #[inline(never)]
    pub(super) fn force_of(config: &Config) -> Result<Option<Design>, ConfigProblem> {
        let Some(force) = &config.force else {
            return Ok(None);
        };
        let design = Design::new(force, config.period_us);
        design.map(Some).map_err(|(axis, _)| ConfigProblem {
            field: ConfigField::Force,
            axis: axis.map(|axis| axis as u8),
        })
    }

    #[cold]
    #[inline(never)]
    pub(super) fn set_up_force(&mut self, design: Option<Design>) {
        self.force = match (&self.config.force, design) {
            (Some(force), Some(design)) => {
                Some(ForceControl::of(force, design, self.config.period_us))
            }
            _ => None,
        };
    }

    /// The force part of stage *sense*: codes to forces; `active` while something moves or may move.
    #[inline]
    pub fn sense_force(&mut self, inputs: &Inputs, spindle_rpm: i16, active: bool) {
        let Some(force) = &mut self.force else {
            return;
        };
        let pose = self.measured_pose.as_ref().unwrap_or(&self.reference.pose);
        let [x, y, z, ..] = pose.0;
        let unloaded = force.unloaded(active);
        let table = self.machine.table(pose);
        force.sense(&inputs.force, spindle_rpm, &[x, y, z], table, unloaded);
        force.mind(active);
    }

    /// Whether the reference may be another pose than the wanted one.
    #[inline]
    pub(super) fn yields(&self) -> bool {
        self.force.as_ref().is_some_and(|force| !force.rests())
    }

    /// Stage *yield*: the reference of this period. `stopped` by a fault of the force, `homing` while the references are looked for.
    #[inline]
    pub fn give_way(&mut self, stopped: bool, homing: bool) {
        let Some(force) = &mut self.force else {
            return;
        };
        force.suspend(homing);
        if force.rests() && self.limited == [0; COMPONENTS] {
            // No axis is under force control, and nothing is left of what was.
            force.hold(stopped);
            self.reference.pose = self.motion.wanted().pose;
            return;
        }
        self.yield_to_force(stopped);
    }

    #[inline(never)]
    fn yield_to_force(&mut self, stopped: bool) {
        let Some(force) = &mut self.force else {
            return;
        };
        // A force beyond its limit is believed: the tool goes on yielding to it while the machine brakes.
        let unbelieved = force
            .condition()
            .is_some_and(|problem| !matches!(problem, ForceProblem::Limit { .. }));
        force.hold(stopped || (unbelieved && force.mask() != 0));
        let wanted = self.motion.wanted();
        let [x, y, z, ..] = wanted.rates;
        let yielding = *force.advance(&[x, y, z]);
        self.reference = *wanted;
        let mut limited = 0;
        for (component, yielding) in yielding.iter().enumerate() {
            if yielding.limited {
                limited |= 1 << component;
            }
            if yielding.displacement == Displacement::default() && yielding.rate == Rate::ZERO {
                continue;
            }
            let desired = self.reference.pose.0[component];
            let reference = self.displace(component, yielding.displacement);
            let rate = &mut self.reference.rates[component];
            *rate = rate.saturating_add(yielding.rate);
            let acceleration = &mut self.reference.accelerations[component];
            *acceleration = acceleration.saturating_add(yielding.acceleration);
            if let Some(end) = self.soft_limit_passed(component, desired, reference) {
                self.stand(component, desired, end);
                limited |= 1 << component;
            }
        }
        self.note_limited(limited);
        if self.force.as_ref().is_some_and(ForceControl::adopted) {
            for part in FORCE_PART..super::PARTS {
                self.digests[part] = self.digest(part);
            }
        }
    }

    /// One period with the drives off.
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

    /// Puts p_d + p_c of one component into the reference.
    fn displace(&mut self, component: usize, by: Displacement) -> Coordinate {
        let desired = self.motion.wanted().pose.0[component];
        let reference = Coordinate(desired.0.saturating_add(by.length().0));
        self.reference.pose.0[component] = reference;
        reference
    }

    /// The soft limit beyond which the tool would yield, of a desired position inside.
    fn soft_limit_passed(
        &self,
        component: usize,
        desired: Coordinate,
        reference: Coordinate,
    ) -> Option<Coordinate> {
        let axis = self.config.pose.get(component)?;
        if reference > axis.high && desired <= axis.high {
            Some(axis.high)
        } else if reference < axis.low && desired >= axis.low {
            Some(axis.low)
        } else {
            None
        }
    }

    /// The reference of one component stands at an end.
    fn stand(&mut self, component: usize, desired: Coordinate, end: Coordinate) {
        // Towards 0 from p_c, which is a length: fits.
        let left = Length(end.0.saturating_sub(desired.0));
        if let Some(force) = &mut self.force {
            force.confine(component, Displacement::from_length(left));
        }
        self.reference.pose.0[component] = end;
        self.reference.rates[component] = Rate::ZERO;
        self.reference.accelerations[component] = Acceleration::ZERO;
    }

    /// What the tool has yielded by, and how fast it does: joints have their rates for that as well.
    #[inline]
    pub(super) fn tell_excursion(&mut self) {
        if let Some(force) = &self.force {
            let excursion = force
                .yielding()
                .map(|of| (of.displacement.length().0, of.rate));
            self.motion.jog.displace(&excursion);
        }
    }

    /// Whether a joint is commanded more than its maximum rate.
    fn exceeds_joint_rate(&self) -> bool {
        let rates = self.target.rates.iter().zip(self.machine.rates());
        let mut joints = rates.take(self.joints.len());
        joints.any(|(rate, limit)| rate.0.unsigned_abs() > limit.0.unsigned_abs())
    }

    /// Stage *place* with force control.
    #[inline(never)]
    pub(super) fn place_reference(&mut self) -> Result<(), PoseError> {
        let placed = self.place_once();
        if placed.is_ok() && !self.exceeds_joint_rate() {
            return Ok(());
        }
        // The tool yields no further where a joint would have to be too fast for it.
        let Some(force) = self.force.as_mut().filter(|force| force.displaced()) else {
            return placed;
        };
        let yielding = *force.withhold();
        let mut limited = 0;
        for (component, yielding) in yielding.iter().enumerate() {
            let wanted = self.motion.wanted();
            self.reference.rates[component] = wanted.rates[component];
            self.reference.accelerations[component] = wanted.accelerations[component];
            self.displace(component, yielding.displacement);
            if yielding.displacement != Displacement::default() {
                limited |= 1 << component;
            }
        }
        self.note_limited(limited);
        self.place_once()
    }

    fn place_once(&mut self) -> Result<(), PoseError> {
        let reference = &self.reference;
        let accelerations: &Accelerations = &reference.accelerations;
        self.machine.place(
            &reference.pose,
            &reference.rates,
            accelerations,
            &mut self.target,
        )
    }

    fn note_limited(&mut self, limited: u8) {
        let periods = TOLD_FOR_US / u32::from(self.config.period_us.max(1));
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

    /// A component that cannot yield any further, and could before; each is told once.
    pub const fn take_limited(&mut self) -> Option<u8> {
        if self.newly_limited == 0 {
            return None;
        }
        let component = self.newly_limited.trailing_zeros();
        self.newly_limited &= self.newly_limited - 1;
        Some(component as u8)
    }

    /// Wanted becomes the reference, at rest: the tool stays where it yielded to. One that is on its way goes on by its law: where it is, it would be stopped within a period.
    pub fn absorb(&mut self) {
        let Some(force) = &mut self.force else {
            return;
        };
        if force.moves() {
            force.forget_contact();
            return;
        }
        if force.displaced() {
            let pose = self.reference.pose;
            self.motion.place(&pose);
        }
        force.reset();
    }

    /// Wanted became measured: the tool has not yielded.
    pub(super) fn forget_force(&mut self) {
        if let Some(force) = &mut self.force {
            force.reset();
        }
    }

    /// A part of force control: the sensor with what was configured, then each axis with the settings that are in force.
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

    /// What is placed: p_r, or where nothing yields what is wanted.
    #[must_use]
    pub fn reference(&self) -> &crate::motion::Wanted {
        if self.yields() {
            &self.reference
        } else {
            self.motion.wanted()
        }
    }
}
