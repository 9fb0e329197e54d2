//! The hand on a haptic arm: where it is, and what it shall feel (docs/control.md 2.2, 2.4, 3.4, 3.5).
//!
//! Two stages of the corridor are here. *Sense* ([`Haptic::measure`]): nine counters to the pose of the handle, and whether they can be believed. *Feel* ([`Haptic::render`]): the force on the tool through the [`law`],
//! smoothed while the hand owes energy ([`smooth`]), the [`wall`]s, the damping that [`passivity`] and [`swing`] ask for, all within the limit of the axis and not faster than the configured step in a period, through the statics of the arm to six currents, all clamped together so that
//! the direction stays. What is sensed of a force in a period is felt in the next: outputs take effect at its beginning.
//!
//! The force that is reflected is the peak that force control works on: high forces are what the hand shall know of (docs/control.md 3.3), it rises in the period in which it was sampled, and a hand cannot follow the ripple of the teeth.
//!
//! | part | units |
//! | --- | --- |
//! | places, rates | 2^-20 mm, 2^-20 mm/s |
//! | forces | 2^-16 N; the force on the tool, and what the arm does to the hand |
//! | torques of the motors | N mm, in f32, where the statics are |
//!
//! A problem with the arm takes its motors off in the period in which it is seen, and they stay off until [`Haptic::reset`]; one that comes and goes while they are off anyway is only told. Misuse: [`Haptic::render`] without [`Haptic::measure`] before it in the same period.

pub mod config;
pub mod feedback_filter;
pub mod feedback_law;
pub mod mapping;
pub mod oscillation;
pub mod passivity;
pub mod walls;

use crate::config::digest::{Constants, Digest, constants};
use crate::io::{HapticInputs, HapticOutputs, LEGS};
use crate::snapshot::HapticSnapshot;
use config::HapticConfig;
use feedback_filter::FeedbackFilter;
use feedback_law::FeedbackLaw;
use haptimill_kinematics::haptic_arm::statics::Wrench;
use haptimill_kinematics::haptic_arm::{ArmError, HandPose, HapticArm, LegReading};
use haptimill_math::force::Force;
use haptimill_math::scale::{difference, multiply_high, product, saturate, total};
use haptimill_math::{Angle, Length, Rate};
pub use haptimill_protocol::haptic::{COMPONENTS, Hand, HandProblem, HandTelemetry, Reflection};
use mapping::Frame;
use motors::Motors;
use oscillation::{OperatorPower, OscillationDampers};
use passivity::{Passivity, WHOLE, works};
use walls::{TooSmall, Walls};

mod motors;

/// How long the reflection takes to come in, or to go, when the hand begins to lead or lets go, microseconds.
const BLEND_US: u32 = 100_000;

/// How long it takes until most (63 %) of a debt of the hand is forgiven, microseconds: as long as it takes to feel that a contact is one that swings.
const FORGET_US: u32 = 10_000_000;

/// How old the last word of a tool afar may be, microseconds.
const FEEL_US: u32 = 100_000;

/// An encoder of a leg.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
struct Sensor {
    per_count: i64,
    /// Counts beyond which nothing is looked at.
    most: u32,
    preset: i32,
    low: i32,
    high: i32,
}

/// What was felt by a tool afar.
#[derive(Debug, Clone, Copy, Default)]
struct RemoteMaster {
    force: [Force; COMPONENTS],
    /// Periods for which it is still believed.
    left: u32,
}

/// Counters at the handle's home.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Zero {
    counts: [[i32; 3]; LEGS],
    illegal: [[u16; 3]; LEGS],
}

/// A haptic arm.
#[derive(Debug, Clone)]
pub struct Haptic {
    arm: HapticArm,
    sensors: [[Sensor; 3]; LEGS],
    motors: Motors,
    illegal_most: u16,
    /// Part of a difference that the filter of the rates takes in a period, 2^-32.
    smoothing: u32,
    step: i32,
    periods_per_second: i64,
    blend_step: i32,
    feel_periods: u32,
    law: FeedbackLaw,
    walls: Walls,
    passivity: Passivity,
    swings: OscillationDampers,
    shares: FeedbackFilter,
    supply: OperatorPower,
    /// Counts at the presets.
    zero: [[i32; 3]; LEGS],
    illegal: [[u16; 3]; LEGS],
    pose: Option<HandPose>,
    tip: [i32; COMPONENTS],
    moved: [i32; COMPONENTS],
    /// 2^-28 mm/s.
    rates: [i64; COMPONENTS],
    engaged: bool,
    ready: bool,
    /// How much of the reflection is let through, 2^-16.
    blend: i32,
    remote: RemoteMaster,
    force: [Force; COMPONENTS],
    reflected: [Force; COMPONENTS],
    wall: [Force; COMPONENTS],
    enabled: bool,
    problem: Option<HandProblem>,
    /// It stays until it is reset.
    latched: bool,
    /// The problem has not been told.
    fresh: bool,
}

constants!(Haptic { arm, sensors, motors, illegal_most, smoothing, step, periods_per_second, blend_step, feel_periods } of {} but {
    law, walls, passivity, swings, shares, supply, zero, illegal, pose, tip, moved, rates, engaged, ready, blend, remote, force, reflected, wall, enabled, problem, latched, fresh
});

impl Haptic {
    /// The arm of a sound configuration; the handle stands at its home.
    #[must_use]
    #[cold]
    #[inline(never)]
    pub fn new(config: &HapticConfig, period_us: u16, inputs: &HapticInputs) -> Self {
        let period = u32::from(period_us.max(1));
        let sensors = config.sensors.map(|leg| {
            core::array::from_fn(|index| {
                let (low, high) = config.ranges[index];
                Sensor {
                    per_count: leg[index].per_count,
                    most: ((1 << 57) / leg[index].per_count.unsigned_abs().max(1)).min(1 << 30)
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
            illegal_most: config.illegal_transitions,
            // Below 1: the filter takes at least a period.
            smoothing: ((u64::from(period) << 32) / (filter + 1)).min(1 << 31) as u32,
            step: config.step.0,
            periods_per_second: i64::from(1_000_000 / period),
            blend_step: ((period << 16) / BLEND_US).max(1) as i32,
            feel_periods: FEEL_US / period,
            law: FeedbackLaw::new(&config.reflection, period_us),
            walls: Walls::new(&config.wall, config.ball, period_us),
            passivity: Passivity::new(&config.passivity, period_us, FORGET_US),
            swings: OscillationDampers::new(&config.passivity, period_us),
            shares: FeedbackFilter::new(period_us),
            supply: OperatorPower::new(period_us),
            zero: inputs.legs.map(|leg| leg.counts),
            illegal: inputs.legs.map(|leg| leg.illegal),
            pose: None,
            tip: [0; COMPONENTS],
            moved: [0; COMPONENTS],
            rates: [0; COMPONENTS],
            engaged: false,
            ready: false,
            blend: 0,
            remote: RemoteMaster::default(),
            force: [Force::ZERO; COMPONENTS],
            reflected: [Force::ZERO; COMPONENTS],
            wall: [Force::ZERO; COMPONENTS],
            enabled: false,
            problem: None,
            latched: false,
            fresh: false,
        };
        haptic.measure(inputs);
        haptic
    }

    /// What its counters were at the handle's home.
    #[must_use]
    pub const fn zero(&self) -> Zero {
        Zero {
            counts: self.zero,
            illegal: self.illegal,
        }
    }

    /// Counts as under another configuration whose counts mean the same.
    pub const fn take_over(&mut self, zero: &Zero) {
        self.zero = zero.counts;
        self.illegal = zero.illegal;
        self.pose = None;
    }

    /// Stage *sense*.
    pub fn measure(&mut self, inputs: &HapticInputs) {
        self.engaged = inputs.engaged;
        self.ready = inputs.drives_ready;
        self.moved = [0; COMPONENTS];
        let known = self.pose.is_some();
        let found = self.read(inputs).and_then(|readings| {
            // Found in its place: it is too large to be handed on.
            let pose = self.pose.get_or_insert_default();
            let found = self.arm.find(&readings, pose);
            found.map(|()| pose.tip).map_err(|error| match error {
                ArmError::Slide { leg } => HandProblem::Range { leg, sensor: 0 },
                ArmError::Side { leg, by } => HandProblem::Encoder { leg, by: by.0 },
            })
        });
        match found {
            Ok(tip) => self.go_on(tip, known),
            Err(problem) => {
                self.pose = None;
                self.rates = [0; COMPONENTS];
                self.raise(problem, self.enabled);
            }
        }
    }

    /// Counters to readings.
    fn read(&mut self, inputs: &HapticInputs) -> Result<[LegReading; LEGS], HandProblem> {
        let mut readings = [LegReading::default(); LEGS];
        for (index, leg) in inputs.legs.iter().enumerate() {
            let mut values = [0; 3];
            for (sensor, value) in values.iter_mut().enumerate() {
                let (at, here) = (index as u8, sensor as u8);
                let illegal = leg.illegal[sensor].wrapping_sub(self.illegal[index][sensor]);
                if illegal > self.illegal_most {
                    return Err(HandProblem::Illegal {
                        leg: at,
                        sensor: here,
                    });
                }
                let encoder = &self.sensors[index][sensor];
                let counts = leg.counts[sensor].wrapping_sub(self.zero[index][sensor]);
                let range = HandProblem::Range {
                    leg: at,
                    sensor: here,
                };
                // As many counts make two turns, or 4 m: below 2^58 with the scale.
                if counts.unsigned_abs() > encoder.most {
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
                lean: Angle(values[2]),
            };
        }
        Ok(readings)
    }

    /// A new pose: where the tip is, and where it was known before, what it moved and its rates.
    fn go_on(&mut self, tip: [i32; COMPONENTS], known: bool) {
        if known {
            for (axis, rate) in self.rates.iter_mut().enumerate() {
                // More than 16 mm in a period is no motion; the sides of the platform see to that.
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

    fn raise(&mut self, problem: HandProblem, latched: bool) {
        if self.problem.is_none() {
            self.problem = Some(problem);
            self.fresh = true;
        }
        self.latched |= latched;
    }

    /// A problem that was not told yet.
    pub fn take_problem(&mut self) -> Option<HandProblem> {
        let fresh = core::mem::take(&mut self.fresh);
        self.problem.filter(|_| fresh)
    }

    /// What is wrong with the arm.
    #[must_use]
    pub const fn problem(&self) -> Option<HandProblem> {
        self.problem
    }

    /// The problem was looked after. What is still wrong is found again.
    pub const fn reset(&mut self) {
        self.problem = None;
        self.latched = false;
        self.fresh = false;
    }

    /// The frame of the handle, if there is one that can be believed.
    #[must_use]
    pub fn frame(&self) -> Option<Frame> {
        let pose = self.pose.as_ref().filter(|_| self.problem.is_none())?;
        Some(Frame {
            tip: pose.tip,
            axes: pose.axes,
            engaged: self.engaged,
        })
    }

    /// Rates of the tip.
    #[must_use]
    pub fn rates(&self) -> [Rate; COMPONENTS] {
        self.rates.map(|rate| Rate(saturate(rate >> 8)))
    }

    /// What a tool afar feels, 2^-6 N.
    pub fn set_remote_force(&mut self, force: [i16; COMPONENTS]) {
        self.remote = RemoteMaster {
            force: force.map(|part| Force(i32::from(part) << 10)),
            left: self.feel_periods,
        };
    }

    /// What was said last of a tool afar, 2^-6 N, believed or not.
    #[must_use]
    pub fn remote_force(&self) -> [i16; COMPONENTS] {
        self.remote.force.map(|part| (part.0 >> 10) as i16)
    }

    /// Stage *feel*: `tool` is what a tool here feels, `leads` whether the hand leads one now, `powered` whether the arm may have power.
    pub fn render(
        &mut self,
        tool: Option<[Force; COMPONENTS]>,
        leads: bool,
        powered: bool,
        outputs: &mut HapticOutputs,
    ) {
        if powered && !self.ready {
            self.raise(HandProblem::Drive, true);
        }
        let Some(pose) = self
            .pose
            .as_ref()
            .filter(|_| powered && self.problem.is_none())
        else {
            return self.let_go(outputs);
        };
        self.remote.left = self.remote.left.saturating_sub(1);
        let there = if self.remote.left > 0 {
            self.remote.force
        } else {
            [Force::ZERO; COMPONENTS]
        };
        let tool = tool.unwrap_or(there);
        let towards = if leads { 1 << 16 } else { 0 };
        self.blend += (towards - self.blend).clamp(-self.blend_step, self.blend_step);
        let rates = self.rates.map(|rate| Rate(saturate(rate >> 8)));
        self.wall = self.walls.push(&pose.tip);
        let stored = self.walls.stored();
        let works = works(&self.force, &self.moved);
        self.passivity.observe_works(&works, stored);
        self.swings.watch(&self.force, &self.moved, stored);
        let (all, swinging) = (self.passivity.deficit_of(), self.swings.deficit_of());
        let idle = self.supply.watch_works(&works);
        let deficit_of =
            idle.map(|idle| all.max(((i64::from(swinging) * i64::from(idle)) >> 16) as i32));
        // Of what is not led the whole motion is damped, half as much.
        let damped = deficit_of.map(|deficit_of| deficit_of.min(WHOLE) / 2);
        let swings = self.swings.damp(&rates, &idle, &damped);
        let shares = self.law.shares(&tool);
        // What is let through is not smoothed: who lets go feels nothing more.
        let shares = self
            .shares
            .smooth(&shares, &deficit_of)
            .map(|share| Force(saturate((i64::from(share.0) * i64::from(self.blend)) >> 16)));
        self.reflected = self.law.boosted(&shares, &rates);
        let mut force = self.force;
        for (axis, force) in force.iter_mut().enumerate() {
            let damping = self.passivity.damp_by(damped[axis], rates[axis]);
            let damping = Force(damping.0.saturating_add(swings[axis].0));
            let commanded = self
                .law
                .together(axis, self.reflected[axis], damping, self.wall[axis]);
            let change = commanded.0.saturating_sub(force.0);
            force.0 += change.clamp(-self.step, self.step);
        }
        let wrench = Wrench::at_tip(&force, pose);
        match self.motors.currents(&self.arm, pose, &wrench) {
            Ok((currents, share)) => {
                outputs.enabled = true;
                outputs.currents = currents;
                self.enabled = true;
                // What the motors cannot do did not act.
                self.force = force
                    .map(|force| Force(saturate((i64::from(force.0) * i64::from(share)) >> 16)));
            }
            Err(_) => {
                self.raise(HandProblem::Singular, true);
                self.let_go(outputs);
            }
        }
    }

    /// The motors are off, and nothing is remembered of what they did.
    fn let_go(&mut self, outputs: &mut HapticOutputs) {
        *outputs = HapticOutputs::default();
        self.enabled = false;
        self.blend = 0;
        self.force = [Force::ZERO; COMPONENTS];
        self.reflected = self.force;
        self.wall = self.force;
        self.passivity.reset();
        self.swings.reset();
        self.shares.reset();
        self.supply.reset();
    }

    /// Other settings of the reflection.
    pub const fn set_feedback(&mut self, settings: &Reflection) {
        self.law.set(settings);
    }

    /// Puts a virtual wall, or takes it away; without a place where the tip is now.
    ///
    /// # Errors
    /// [`TooSmall`]; nothing changes.
    pub fn set_wall(
        &mut self,
        axis: usize,
        upper: bool,
        wall: Option<(Option<Length>, Rate)>,
    ) -> Result<(), TooSmall> {
        let here = Length(self.tip.get(axis).copied().unwrap_or(0));
        let wall = wall.map(|(at, rate)| (at.unwrap_or(here), rate));
        self.walls.set(axis, upper, wall)
    }

    /// The force that acts on the hand.
    #[must_use]
    pub const fn force(&self) -> &[Force; COMPONENTS] {
        &self.force
    }

    /// The pose of the handle.
    #[must_use]
    pub const fn pose(&self) -> Option<&HandPose> {
        self.pose.as_ref()
    }

    /// What recorders want to know.
    #[must_use]
    pub fn snapshot(&self) -> HapticSnapshot {
        let raw = |forces: &[Force; COMPONENTS]| forces.map(|force| force.0);
        HapticSnapshot {
            tip: self.tip,
            force: raw(&self.force),
            reflected: raw(&self.reflected),
            wall: raw(&self.wall),
        }
    }

    /// How the hand stands.
    #[must_use]
    pub fn telemetry(&self, period: u64) -> HandTelemetry {
        let short = |forces: &[Force; COMPONENTS]| {
            forces.map(|force| (force.0 >> 8).clamp(-32768, 32767) as i16)
        };
        let axes = self.pose.map_or([[0; 3]; 3], |pose| pose.axes);
        let direction = |axis: [i32; 3]| axis.map(|part| (part >> 15).clamp(-32767, 32767) as i16);
        HandTelemetry {
            period,
            hand: Hand {
                tip: self.tip,
                rate: self.rates().map(|rate| rate.0 >> 8),
                axes: [direction(axes[0]), direction(axes[2])],
                engaged: self.engaged && self.problem.is_none() && self.pose.is_some(),
            },
            force: short(&self.force),
            reflected: short(&self.reflected),
            wall: short(&self.wall),
            energy: (self.passivity.energy().min(self.swings.energy()) >> 28).clamp(-32768, 32767)
                as i16,
            enabled: self.enabled,
            problem: self.problem,
        }
    }

    /// Adds what was worked out from the configuration to a digest.
    pub fn digest(&self, digest: &mut Digest) {
        Constants::digest(self, digest);
    }
}
