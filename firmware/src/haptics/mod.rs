//! Haptics: pose of a haptic arm, and force feedback to the operator (docs/control.md 2.2, 2.4,
//! 3.4, 3.5).
//!
//! This module implements two stages of the control cycle. *Measure* ([`Haptic::measure`]) turns
//! nine counters into the pose of the handle, and decides whether they are valid. *Render*
//! ([`Haptic::render`]) computes six motor currents from the force on the tool:
//! - the force feedback law ([`feedback_law`]);
//! - the low-pass filter during an energy deficit ([`feedback_filter`]);
//! - the virtual fixtures ([`fixture`]);
//! - the damping of the passivity controllers ([`passivity`], [`oscillation`]);
//! - the limit of each axis, and the largest force step per control period;
//! - the statics of the arm, with a common clamp of all currents that keeps the direction of the
//!   force.
//!
//! A force measured in one control period reaches the operator in the next, because outputs take
//! effect at its beginning.
//!
//! The fed-back force is the peak force of force control: the operator must perceive high forces
//! (docs/control.md 3.3), the peak rises in the control period of its sample, and a hand cannot
//! follow the ripple of the teeth.
//!
//! | part | units |
//! | --- | --- |
//! | positions, rates | 2^-20 mm, 2^-20 mm/s |
//! | forces | 2^-16 N; force on the tool, and force of the arm on the operator |
//! | motor torques | N mm, in f32 like the statics |
//!
//! A problem of the arm switches its motors off in the control period in which it is detected. They
//! stay off until [`Haptic::reset`]. A problem that occurs while they are off is reported but
//! not latched.
//!
//! Callers must call [`Haptic::measure`] before [`Haptic::render`] in every control period.

pub mod config;
pub mod feedback_filter;
pub mod feedback_law;
pub mod fixture;
pub mod mapping;
pub mod oscillation;
pub mod passivity;

use crate::digest::{Constants, Digest, impl_digest};
use crate::io::{HapticInputs, HapticOutputs, LEGS};
use config::HapticConfig;
use feedback_filter::FeedbackFilter;
use feedback_law::FeedbackLaw;
use fixture::{TooSmall, VirtualFixtures};
use haptimill_kinematics::haptic_arm::statics::Wrench;
use haptimill_kinematics::haptic_arm::{ArmError, ArmPose, HapticArm, LegReading};
use haptimill_math::force::Force;
use haptimill_math::scale::{difference, multiply_high, product, saturate, total};
use haptimill_math::{Angle, Length, Rate};
pub use haptimill_protocol::haptic::{
    COMPONENTS, ForceFeedback, MasterPose, MasterProblem, MasterTelemetry,
};
use mapping::HandleFrame;
use motors::Motors;
use oscillation::{FORGET_US, OperatorPower, OscillationDampers};
use passivity::{Passivity, WHOLE, works};

mod motors;

/// Blend time of the force feedback when the master starts or stops moving the tool, microseconds.
const BLEND_US: u32 = 100_000;

/// Largest age of the last remote force, microseconds.
const FEEL_US: u32 = 100_000;

/// Encoder of a leg.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
struct LegSensor {
    per_count: i64,
    /// Counts beyond this are out of range.
    max: u32,
    preset: i32,
    low: i32,
    high: i32,
}

/// Force on a remote tool.
#[derive(Debug, Clone, Copy, Default)]
struct RemoteMaster {
    force: [Force; COMPONENTS],
    /// Control periods for which it is still valid.
    left: u32,
}

/// Counters at the home of the handle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Zero {
    counts: [[i32; 3]; LEGS],
    illegal: [[u16; 3]; LEGS],
}

/// State of the haptic arm; zeros on a machine without one.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct HapticSnapshot {
    /// The tip, 2^-20 mm.
    pub tip: [i32; COMPONENTS],
    /// Force of the arm on the operator, 2^-16 N.
    pub force: [i32; COMPONENTS],
    /// Output of the force feedback law alone, 2^-16 N.
    pub feedback: [i32; COMPONENTS],
    /// Force of the virtual fixtures, 2^-16 N.
    pub fixture: [i32; COMPONENTS],
    /// Directions of the x and z axes of the handle, 32767 for 1; zeros where its pose is invalid.
    pub axes: [[i16; COMPONENTS]; 2],
}

/// Haptic arm.
#[derive(Debug, Clone)]
pub struct Haptic {
    arm: HapticArm,
    sensors: [[LegSensor; 3]; LEGS],
    motors: Motors,
    illegal_max: u16,
    /// Filter coefficient of the rates per control period, 2^-32.
    smoothing: u32,
    step: i32,
    periods_per_second: i64,
    blend_step: i32,
    feel_periods: u32,
    law: FeedbackLaw,
    fixtures: VirtualFixtures,
    passivity: Passivity,
    dampers: OscillationDampers,
    shares: FeedbackFilter,
    operator_power: OperatorPower,
    /// Counts at the presets.
    zero: [[i32; 3]; LEGS],
    illegal: [[u16; 3]; LEGS],
    pose: Option<ArmPose>,
    tip: [i32; COMPONENTS],
    moved: [i32; COMPONENTS],
    /// 2^-28 mm/s.
    rates: [i64; COMPONENTS],
    enabling_switch: bool,
    ready: bool,
    /// Blend factor of the force feedback, 2^-16.
    blend: i32,
    remote: RemoteMaster,
    force: [Force; COMPONENTS],
    feedback: [Force; COMPONENTS],
    fixture: [Force; COMPONENTS],
    enabled: bool,
    problem: Option<MasterProblem>,
    /// The problem is latched until a reset.
    latched: bool,
    /// The problem has not been reported.
    fresh: bool,
}

impl_digest!(Haptic { fields { arm, sensors, motors, illegal_max, smoothing, step, periods_per_second, blend_step, feel_periods }, nested {}, skip {
    law, fixtures, passivity, dampers, shares, operator_power, zero, illegal, pose, tip, moved, rates, enabling_switch, ready, blend, remote, force, feedback, fixture, enabled, problem, latched, fresh
} });

impl Haptic {
    /// Creates the arm of a sound configuration. The handle must be at its home.
    #[must_use]
    #[cold]
    #[inline(never)]
    pub fn new(config: &HapticConfig, period_us: u16, inputs: &HapticInputs) -> Self {
        let period = u32::from(period_us.max(1));
        let sensors = config.sensors.map(|leg| {
            core::array::from_fn(|index| {
                let (low, high) = config.ranges[index];
                LegSensor {
                    per_count: leg[index].per_count,
                    max: ((1 << 57) / leg[index].per_count.unsigned_abs().max(1)).min(1 << 30)
                        as u32,
                    preset: leg[index].preset.0,
                    low: low.0,
                    high: high.0,
                }
            })
        });
        let filter = u64::from(config.rate_filter_us) + u64::from(period);
        let mut haptic = Self {
            arm: HapticArm::new(&config.geometry),
            sensors,
            motors: Motors::new(&config.drives, config.condition),
            illegal_max: config.illegal_transitions,
            // Below 1: the time constant is at least one control period.
            smoothing: ((u64::from(period) << 32) / (filter + 1)).min(1 << 31) as u32,
            step: config.step.0,
            periods_per_second: i64::from(1_000_000 / period),
            blend_step: ((period << 16) / BLEND_US).max(1) as i32,
            feel_periods: FEEL_US / period,
            law: FeedbackLaw::new(&config.feedback, period_us),
            fixtures: VirtualFixtures::new(&config.fixture, config.ball, period_us),
            passivity: Passivity::new(&config.passivity, period_us, FORGET_US),
            dampers: OscillationDampers::new(&config.passivity, period_us),
            shares: FeedbackFilter::new(period_us),
            operator_power: OperatorPower::new(period_us),
            zero: inputs.legs.map(|leg| leg.counts),
            illegal: inputs.legs.map(|leg| leg.illegal),
            pose: None,
            tip: [0; COMPONENTS],
            moved: [0; COMPONENTS],
            rates: [0; COMPONENTS],
            enabling_switch: false,
            ready: false,
            blend: 0,
            remote: RemoteMaster::default(),
            force: [Force::ZERO; COMPONENTS],
            feedback: [Force::ZERO; COMPONENTS],
            fixture: [Force::ZERO; COMPONENTS],
            enabled: false,
            problem: None,
            latched: false,
            fresh: false,
        };
        haptic.measure(inputs);
        haptic
    }

    /// Counters at the home of the handle.
    #[must_use]
    pub const fn zero(&self) -> Zero {
        Zero {
            counts: self.zero,
            illegal: self.illegal,
        }
    }

    /// Takes over the zero of another configuration with the same encoder scaling.
    pub const fn take_over(&mut self, zero: &Zero) {
        self.zero = zero.counts;
        self.illegal = zero.illegal;
        self.pose = None;
    }

    /// Runs the *measure* stage.
    pub fn measure(&mut self, inputs: &HapticInputs) {
        self.enabling_switch = inputs.enabling_switch;
        self.ready = inputs.drives_ready;
        self.moved = [0; COMPONENTS];
        let known = self.pose.is_some();
        let found = self.read(inputs).and_then(|readings| {
            // Computed in place, because it is too large to be passed on.
            let pose = self.pose.get_or_insert_default();
            let found = self.arm.find(&readings, pose);
            found.map(|()| pose.tip).map_err(|error| match error {
                ArmError::Slide { leg } => MasterProblem::Range { leg, sensor: 0 },
                ArmError::Side { leg, by } => MasterProblem::Encoder { leg, by: by.0 },
            })
        });
        match found {
            Ok(tip) => self.update_tip(tip, known),
            Err(problem) => {
                self.pose = None;
                self.rates = [0; COMPONENTS];
                self.raise(problem, self.enabled);
            }
        }
    }

    /// Converts counters to leg readings.
    fn read(&mut self, inputs: &HapticInputs) -> Result<[LegReading; LEGS], MasterProblem> {
        let mut readings = [LegReading::default(); LEGS];
        for (index, leg) in inputs.legs.iter().enumerate() {
            let mut values = [0; 3];
            for (sensor, value) in values.iter_mut().enumerate() {
                let (at, here) = (index as u8, sensor as u8);
                let illegal = leg.illegal[sensor].wrapping_sub(self.illegal[index][sensor]);
                if illegal > self.illegal_max {
                    return Err(MasterProblem::Illegal {
                        leg: at,
                        sensor: here,
                    });
                }
                let encoder = &self.sensors[index][sensor];
                let counts = leg.counts[sensor].wrapping_sub(self.zero[index][sensor]);
                let range = MasterProblem::Range {
                    leg: at,
                    sensor: here,
                };
                // The largest counts are two turns, or 4 m: below 2^58 with the scale.
                if counts.unsigned_abs() > encoder.max {
                    return Err(range);
                }
                let by = product(i64::from(counts), encoder.per_count) >> 24;
                *value = saturate(i64::from(encoder.preset) + by);
                if *value < encoder.low || *value > encoder.high {
                    return Err(range);
                }
            }
            readings[index] = LegReading {
                slide: Length(values[0]),
                turn: Angle(values[1]),
                hinge: Angle(values[2]),
            };
        }
        Ok(readings)
    }

    /// Updates tip, motion and rates from a new pose. `known` is whether the previous pose was
    /// valid.
    fn update_tip(&mut self, tip: [i32; COMPONENTS], known: bool) {
        if known {
            for (axis, rate) in self.rates.iter_mut().enumerate() {
                // More than 16 mm in a control period is not motion; the side lengths of the
                // platform detect it.
                let moved = tip[axis]
                    .wrapping_sub(self.tip[axis])
                    .clamp(-(1 << 24), 1 << 24);
                self.moved[axis] = moved;
                // Below 2^24 * 2^20 * 2^8, and so is the rate.
                let raw = product(i64::from(moved), self.periods_per_second) << 8;
                *rate = total(*rate, multiply_high(difference(raw, *rate), self.smoothing));
            }
        }
        self.tip = tip;
        if !self.latched {
            self.problem = None;
        }
    }

    fn raise(&mut self, problem: MasterProblem, latched: bool) {
        if self.problem.is_none() {
            self.problem = Some(problem);
            self.fresh = true;
        }
        self.latched |= latched;
    }

    /// Takes a problem that has not been reported.
    pub fn take_problem(&mut self) -> Option<MasterProblem> {
        let fresh = core::mem::take(&mut self.fresh);
        self.problem.filter(|_| fresh)
    }

    /// The present problem of the arm.
    #[must_use]
    pub const fn problem(&self) -> Option<MasterProblem> {
        self.problem
    }

    /// Clears a latched problem. A persistent one is detected again.
    pub const fn reset(&mut self) {
        self.problem = None;
        self.latched = false;
        self.fresh = false;
    }

    /// Frame of the handle; `None` if it is invalid.
    #[must_use]
    pub fn frame(&self) -> Option<HandleFrame> {
        let pose = self.pose.as_ref().filter(|_| self.problem.is_none())?;
        Some(HandleFrame {
            tip: pose.tip,
            axes: pose.axes,
            enabling_switch: self.enabling_switch,
        })
    }

    /// Rates of the tip, 2^-20 mm/s.
    #[must_use]
    pub fn rates(&self) -> [Rate; COMPONENTS] {
        self.rates.map(|rate| Rate(saturate(rate >> 8)))
    }

    /// Sets the force on a remote tool, 2^-6 N.
    pub fn set_remote_force(&mut self, force: [i16; COMPONENTS]) {
        self.remote = RemoteMaster {
            force: force.map(|part| Force(i32::from(part) << 10)),
            left: self.feel_periods,
        };
    }

    /// Last force on a remote tool, 2^-6 N, valid or not.
    #[must_use]
    pub fn remote_force(&self) -> [i16; COMPONENTS] {
        self.remote.force.map(|part| (part.0 >> 10) as i16)
    }

    /// Runs the *render* stage. `tool` is the force on a local tool, `moves_tool` whether the
    /// master moves a tool now, `powered` whether the arm may have power.
    pub fn render(
        &mut self,
        tool: Option<[Force; COMPONENTS]>,
        moves_tool: bool,
        powered: bool,
        outputs: &mut HapticOutputs,
    ) {
        if powered && !self.ready {
            self.raise(MasterProblem::Drive, true);
        }
        let Some(pose) = self
            .pose
            .as_ref()
            .filter(|_| powered && self.problem.is_none())
        else {
            return self.switch_off(outputs);
        };
        self.remote.left = self.remote.left.saturating_sub(1);
        let there = if self.remote.left > 0 {
            self.remote.force
        } else {
            [Force::ZERO; COMPONENTS]
        };
        let tool = tool.unwrap_or(there);
        let towards = if moves_tool { 1 << 16 } else { 0 };
        self.blend += (towards - self.blend).clamp(-self.blend_step, self.blend_step);
        let rates = self.rates.map(|rate| Rate(saturate(rate >> 8)));
        self.fixture = self.fixtures.push(&pose.tip);
        let stored = self.fixtures.stored();
        let works = works(&self.force, &self.moved);
        self.passivity.observe_work(&works, stored);
        self.dampers.update(&self.force, &self.moved, stored);
        let (all, oscillating) = (self.passivity.deficit_of(), self.dampers.deficit_of());
        let idle = self.operator_power.observe_work(&works);
        let deficit_of =
            idle.map(|idle| all.max(((i64::from(oscillating) * i64::from(idle)) >> 16) as i32));
        // Axes that the operator does not drive get half the damping, applied to the full velocity.
        let damped = deficit_of.map(|deficit_of| deficit_of.min(WHOLE) / 2);
        let dampers = self.dampers.damp(&rates, &idle, &damped);
        let shares = self.law.shares(&tool);
        // The blend is applied after the filter: a released master has no force.
        let shares = self
            .shares
            .smooth(&shares, &deficit_of)
            .map(|share| Force(saturate((i64::from(share.0) * i64::from(self.blend)) >> 16)));
        self.feedback = self.law.damped(&shares, &rates);
        let mut force = self.force;
        for (axis, force) in force.iter_mut().enumerate() {
            let damping = self.passivity.damp_by(damped[axis], rates[axis]);
            let damping = Force(damping.0.saturating_add(dampers[axis].0));
            let commanded =
                self.law
                    .combine(axis, self.feedback[axis], damping, self.fixture[axis]);
            let change = commanded.0.saturating_sub(force.0);
            force.0 += change.clamp(-self.step, self.step);
        }
        let wrench = Wrench::at_tip(&force, pose);
        match self.motors.currents(&self.arm, pose, &wrench) {
            Ok((currents, share)) => {
                outputs.enabled = true;
                outputs.currents = currents;
                self.enabled = true;
                // The observers must see only the force that the motors produced.
                self.force = force
                    .map(|force| Force(saturate((i64::from(force.0) * i64::from(share)) >> 16)));
            }
            Err(_) => {
                self.raise(MasterProblem::Singular, true);
                self.switch_off(outputs);
            }
        }
    }

    /// Switches the motors off and resets all force states.
    fn switch_off(&mut self, outputs: &mut HapticOutputs) {
        *outputs = HapticOutputs::default();
        self.enabled = false;
        self.blend = 0;
        self.force = [Force::ZERO; COMPONENTS];
        self.feedback = self.force;
        self.fixture = self.force;
        self.passivity.reset();
        self.dampers.reset();
        self.shares.reset();
        self.operator_power.reset();
    }

    /// Sets the force feedback law.
    pub const fn set_feedback(&mut self, settings: &ForceFeedback) {
        self.law.set(settings);
    }

    /// Sets or removes a face of the virtual fixture. Without a position it is placed at the tip.
    ///
    /// # Errors
    ///
    /// Returns [`TooSmall`] if the ball does not fit; nothing changes.
    pub fn set_fixture(
        &mut self,
        axis: usize,
        upper: bool,
        fixture: Option<(Option<Length>, Rate)>,
    ) -> Result<(), TooSmall> {
        let here = Length(self.tip.get(axis).copied().unwrap_or(0));
        let fixture = fixture.map(|(at, rate)| (at.unwrap_or(here), rate));
        self.fixtures.set(axis, upper, fixture)
    }

    /// Force of the arm on the operator.
    #[must_use]
    pub const fn force(&self) -> &[Force; COMPONENTS] {
        &self.force
    }

    /// Pose of the handle; `None` if it is invalid.
    #[must_use]
    pub const fn pose(&self) -> Option<&ArmPose> {
        self.pose.as_ref()
    }

    /// State for recorders.
    #[must_use]
    pub fn snapshot(&self) -> HapticSnapshot {
        let raw = |forces: &[Force; COMPONENTS]| forces.map(|force| force.0);
        HapticSnapshot {
            tip: self.tip,
            force: raw(&self.force),
            feedback: raw(&self.feedback),
            fixture: raw(&self.fixture),
            axes: self.axes(),
        }
    }

    /// Directions of the x and z axes of the handle, 32767 for 1; zeros where its pose is invalid.
    fn axes(&self) -> [[i16; COMPONENTS]; 2] {
        let axes = self.pose.map_or([[0; 3]; 3], |pose| pose.axes);
        let direction = |axis: [i32; 3]| axis.map(|part| (part >> 15).clamp(-32767, 32767) as i16);
        [direction(axes[0]), direction(axes[2])]
    }

    /// Telemetry of the master.
    #[must_use]
    pub fn telemetry(&self, period: u64) -> MasterTelemetry {
        let short = |forces: &[Force; COMPONENTS]| {
            forces.map(|force| (force.0 >> 8).clamp(-32768, 32767) as i16)
        };
        MasterTelemetry {
            period,
            pose: MasterPose {
                tip: self.tip,
                rate: self.rates().map(|rate| rate.0 >> 8),
                axes: self.axes(),
                enabling_switch: self.enabling_switch
                    && self.problem.is_none()
                    && self.pose.is_some(),
            },
            force: short(&self.force),
            feedback: short(&self.feedback),
            fixture: short(&self.fixture),
            energy: (self.passivity.energy().min(self.dampers.energy()) >> 28).clamp(-32768, 32767)
                as i16,
            enabled: self.enabled,
            problem: self.problem,
        }
    }

    /// Adds the constants computed from the configuration to a digest.
    pub fn digest(&self, digest: &mut Digest) {
        Constants::digest(self, digest);
    }
}
