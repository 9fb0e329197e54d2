//! Setpoint queue of a job, and interpolation along its path.
//!
//! Time on the path is program time. It passes at the *speed factor*: 1 at the programmed speed,
//! less while the machine decelerates along its path (hold, stop, override, underrun), 0 at
//! standstill. Above 1 it is on parts of the path whose
//! [`OverrideMode`] allows that. The speed factor is a [`Ramp`], which bounds its slope and the
//! change of its slope. The commanded pose never leaves the path.
//!
//! Deceleration on an underrun begins while the queue still covers the stopping distance, so the
//! commanded pose never passes the last setpoint. The bounds on acceleration and jerk of the
//! deceleration are those of the configuration's [`Stopping`], added to the program's own.
//!
//! Units: axis units, wire rates, 2^-32 control periods of program time.

mod accept;
mod override_mode;
mod prefetch;
mod retract;
mod stopping;
mod underrun;

use super::PoseCommand;
use super::cubic::SegmentDuration;
use super::ramp::{Ramp, RampLimits};
use super::segment;
use crate::config::{Config, Stopping};
use crate::digest::impl_digest;
use haptimill_kinematics::Pose;
use haptimill_math::scale::{product, saturate, total};
use haptimill_math::{Acceleration, Coordinate, Rate};
use haptimill_protocol::message::{Action, MAX_AXES, OverrideMode, RATE_SHIFT};
use heapless::Deque;
use override_mode::{AcceptedModes, braking_periods};
use prefetch::{Segment, Segments};
use retract::PASSED;

/// Capacity of the queue, in setpoints.
pub const QUEUE: usize = 256;

/// Speed factor at the programmed speed.
pub const FULL_FACTOR: i64 = 1 << 32;

/// Setpoint in the queue.
#[derive(Debug, Clone, Copy, Default)]
struct Knot {
    pose: [i32; MAX_AXES],
    rates: [i32; MAX_AXES],
    periods: u16,
    action: Action,
}

impl Knot {
    fn is_at_standstill(&self) -> bool {
        self.rates.iter().all(|rate| *rate == 0)
    }

    /// Whether a coordinate stays at standstill from here to `next`.
    fn is_still(&self, next: &Self, axis: usize) -> bool {
        self.pose[axis] == next.pose[axis] && (self.rates[axis] | next.rates[axis]) == 0
    }
}

/// Events on the path in one control period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Progress {
    /// Action of the setpoint that was reached.
    pub action: Action,
    /// Number of the setpoint at which a pause was reached.
    pub paused: Option<u32>,
    /// The last setpoint of the job was reached.
    pub finished: bool,
    /// The program decelerated because offsets or other sources leave too little stopping distance
    /// ahead.
    pub blocked: bool,
    /// The queue ran empty in motion. This is a defect, because deceleration must end before.
    pub queue_empty: bool,
}

/// An underrun.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Underrun {
    /// Number of the late setpoint.
    pub setpoint: u32,
    /// Control periods from the start of deceleration to the arrival of the setpoint.
    pub periods: u32,
}

/// Setpoint queue of a job and the position on its path.
#[derive(Debug, Default)]
pub struct Interpolator {
    axes: usize,
    circular: [bool; MAX_AXES],
    /// Coordinates that wrap around, one bit each.
    wrapping: u8,
    /// In wire units.
    rate_limits: [i32; MAX_AXES],
    acceleration_limits: [Acceleration; MAX_AXES],
    period_us: u16,
    periods_per_second: i64,
    /// Duration of the setpoint checked last; most setpoints have the duration of the one before.
    duration: SegmentDuration,
    braking: Option<RampLimits>,
    /// Program time to decelerate from the full speed factor, in control periods.
    braking_periods: u64,
    /// Control periods in which the speed factor changes by 1, and in which its slope builds up.
    ramp_periods: [u32; 2],

    queue: Deque<Knot, QUEUE>,
    /// The setpoints passed last, newest last.
    passed: Deque<Knot, PASSED>,
    /// Program time to retract once the speed factor is zero, 2^-32 control periods.
    retract_left: u64,
    /// Sum of the durations in the queue, in control periods.
    queued_periods: u64,
    /// Setpoints at standstill that are not reached yet.
    stops_ahead: u32,
    /// The setpoint accepted last (or the start pose).
    tail: Knot,
    /// The setpoint reached last (or the start pose).
    from: Knot,
    /// The segment to the next setpoint, and the one after it.
    segments: Segments,
    /// Time since the start of the segment, 2^-32 control periods.
    time: u64,
    /// Program time at the start of the segment, in control periods.
    elapsed: u64,
    speed_factor: Ramp,
    /// Speed factor that the overrides give at the present override mode.
    override_factor: i64,
    /// Feed and rapid override, percent.
    overrides: [u8; 2],
    override_mode: OverrideMode,
    accepted_modes: AcceptedModes,
    accepted: u32,
    reached: u32,
    total: Option<u32>,
    started: bool,
    paused: bool,
    /// The underrun in progress: its setpoint, and the control periods since deceleration began.
    underrunning: Option<Underrun>,
    ended_underrun: Option<Underrun>,
}

impl_digest!(Interpolator { fields {
    axes, circular, wrapping, rate_limits, acceleration_limits, period_us, periods_per_second, braking, braking_periods, ramp_periods
}, nested {}, skip {
    queue, queued_periods, stops_ahead, tail, from, segments, time, elapsed, speed_factor, override_factor, overrides, override_mode, accepted_modes, accepted, reached, total, started, paused,
    underrunning, ended_underrun, duration, passed, retract_left
} });

/// Bounds of the speed factor for a configuration's [`Stopping`]; `None` if the times are
/// inconsistent.
#[must_use]
pub fn braking_limits(stopping: &Stopping, period_us: u16) -> Option<RampLimits> {
    let (time, ramp) = (
        i64::from(stopping.time_ms) * 1000,
        i64::from(stopping.ramp_ms) * 1000,
    );
    if ramp == 0 || time < 2 * ramp || period_us == 0 {
        return None;
    }
    let period = i64::from(period_us);
    let slope = FULL_FACTOR * period / (time - ramp);
    RampLimits::new(slope, slope * period / ramp)
}

impl Interpolator {
    /// Creates an empty program for the machine of `config`.
    #[must_use]
    pub fn new(config: &Config) -> Self {
        // Configured in place: the queue is large, and a second one would be the deepest stack use
        // of the controller.
        let mut program = Self::default();
        program.configure(config);
        program
    }

    /// Configures an empty program in place for the machine of `config`.
    pub(super) fn configure(&mut self, config: &Config) {
        let program = self;
        program.axes = config.pose.len();
        program.wrapping = config.wrapping();
        program.period_us = config.period_us;
        program.periods_per_second = 1_000_000 / i64::from(config.period_us.max(1));
        program.braking = braking_limits(&config.stopping, config.period_us);
        program.ramp_periods = braking_periods(&config.stopping, config.period_us);
        program.overrides = [100; 2];
        program.set_override_mode(OverrideMode::FEED);
        for (axis, pose) in config.pose.iter().enumerate() {
            program.circular[axis] = pose.kind.is_circular();
            // A margin of 2 % for the rounding of setpoints.
            let rate = i64::from(pose.rate.0) + i64::from(pose.rate.0) / 50;
            program.rate_limits[axis] = (rate >> RATE_SHIFT) as i32;
            program.acceleration_limits[axis] =
                Acceleration(pose.acceleration.0.saturating_mul(16));
        }
        program.braking_periods = program.braking.map_or(0, |limits| {
            Ramp::at(FULL_FACTOR)
                .stopping_range(&limits)
                .map_or(0, |(_, ahead)| ahead)
                .unsigned_abs()
                >> 32
        });
    }

    /// Begins a job at `pose`.
    pub fn begin(&mut self, pose: &Pose) {
        self.passed.clear();
        self.retract_left = 0;
        self.queue.clear();
        self.queued_periods = 0;
        self.stops_ahead = 0;
        self.tail = Knot::default();
        self.tail.pose = pose.0.map(|coordinate| coordinate.0);
        self.from = self.tail;
        self.segments.clear();
        self.time = 0;
        self.elapsed = 0;
        self.speed_factor = Ramp::at(FULL_FACTOR);
        self.accepted = 0;
        self.reached = 0;
        self.total = None;
        self.started = false;
        self.paused = false;
        self.underrunning = None;
        self.ended_underrun = None;
        self.accepted_modes.begin();
        self.set_override_mode(OverrideMode::FEED);
    }

    /// Number of setpoints in the queue.
    #[must_use]
    pub fn queued(&self) -> usize {
        self.queue.len()
    }

    /// Whether the queue has received all setpoints of the job.
    #[must_use]
    pub const fn is_complete(&self) -> bool {
        self.total.is_some()
    }

    /// Number of setpoints reached.
    #[must_use]
    #[inline]
    pub const fn reached(&self) -> u32 {
        self.reached
    }

    /// Number of the next expected setpoint.
    #[must_use]
    pub const fn accepted(&self) -> u32 {
        self.accepted
    }

    /// Program time since the job began, in 2^-32 control periods. It passes at the speed factor.
    #[must_use]
    pub const fn program_time(&self) -> u64 {
        (self.elapsed << 32).wrapping_add(self.time)
    }

    /// The speed factor; [`FULL_FACTOR`] is the programmed speed.
    #[must_use]
    #[inline]
    pub const fn speed_factor(&self) -> i64 {
        self.speed_factor.value()
    }

    /// Whether interpolation needs more time in this control period than in others: the next
    /// setpoint may be reached, or a part of the next segment is due.
    #[must_use]
    #[inline]
    pub fn is_busy(&self) -> bool {
        self.is_near_end() && (self.may_reach_setpoint() || self.is_part_missing())
    }

    /// Whether the next setpoint may be reached in this control period, which begins a new segment.
    #[inline(never)]
    fn may_reach_setpoint(&self) -> bool {
        self.started
            && !self.paused
            && self.segment().is_none_or(|segment| {
                let end = u64::from(segment.duration.periods()) << 32;
                // The highest speed factor possible in the next control period.
                let slope = self.braking.map_or(0, |braking| braking.slope());
                let value = self.speed_factor.value();
                let max = FULL_FACTOR.max(value).max(self.override_factor);
                let highest = (value + slope).clamp(0, max);
                self.time + highest as u64 >= end
            })
    }

    /// Resumes after a pause.
    pub fn leave_pause(&mut self) {
        if core::mem::take(&mut self.paused) {
            self.started = self.started && self.can_pass_stop();
        }
    }

    /// Takes the report of an ended underrun.
    #[inline]
    pub fn take_underrun(&mut self) -> Option<Underrun> {
        self.ended_underrun.take()
    }

    /// The underrun in progress: the setpoint that is missing, and the control periods since
    /// deceleration began.
    #[must_use]
    pub const fn underrunning(&self) -> Option<Underrun> {
        match self.underrunning {
            Some(Underrun { periods, .. }) => Some(Underrun {
                setpoint: self.accepted,
                periods,
            }),
            None => None,
        }
    }

    /// Whether nothing moves along the path: the speed factor is zero, the program waits, or it is
    /// paused.
    #[must_use]
    #[inline]
    pub fn is_at_standstill(&self) -> bool {
        (self.speed_factor.is_zero() && self.retract_left == 0)
            || self.paused
            || !self.started
            || (self.segment().is_none() && self.queue.is_empty())
    }

    /// Advances one control period along the path; `halt` decelerates to standstill and keeps the
    /// position on the path.
    pub fn advance(&mut self, halt: bool) -> (PoseCommand, Progress) {
        let mut commanded = PoseCommand::default();
        let progress = self.advance_to(halt, &mut commanded);
        (commanded, progress)
    }

    /// As [`Interpolator::advance`], writing pose, rates and accelerations into `commanded`.
    #[inline]
    pub fn advance_to(&mut self, halt: bool, commanded: &mut PoseCommand) -> Progress {
        let progress = self.advance_time(halt);
        self.sample(commanded);
        progress
    }

    #[inline]
    fn advance_time(&mut self, halt: bool) -> Progress {
        let mut progress = Progress::default();
        let Some(braking) = self.braking else {
            return progress;
        };
        // A pause at the last setpoint delays the end of the job like any other pause.
        let finished = self.total == Some(self.reached) && !self.paused;
        if !self.started {
            self.started = !halt && self.can_start();
            // At standstill any speed factor gives the same motion: begin at the factor of the
            // overrides. With a queue full of durations too short to stop on, begin at 0.
            self.speed_factor = Ramp::at(if self.can_pass_stop() {
                self.override_factor
            } else {
                0
            });
            // Motion begins in the next period: this one may have accepted the awaited setpoint,
            // and both operations take long.
            progress.finished = finished;
            return progress;
        }
        if finished || self.paused {
            progress.finished = finished;
            return progress;
        }
        if halt && self.retract_left > 0 && self.is_retracting(&braking) {
            return progress;
        }
        self.monitor_underrun(&braking);
        let target = if halt || self.underrunning.is_some() {
            0
        } else {
            self.override_factor
        };
        self.time += self.speed_factor.advance(target, &braking).max(0) as u64;
        self.advance_segments(&mut progress);
        progress
    }

    /// Advances from setpoint to setpoint until the time lies within a segment.
    #[inline]
    fn advance_segments(&mut self, progress: &mut Progress) {
        loop {
            if self.segment().is_none() && !self.begin_next() {
                progress.queue_empty = !self.from.is_at_standstill();
                self.time = 0;
                if progress.queue_empty {
                    self.speed_factor = Ramp::at(0);
                }
                return;
            }
            let Some(segment) = self.segments.present() else {
                return;
            };
            let periods = u64::from(segment.duration.periods());
            let end = periods << 32;
            if self.time < end {
                return;
            }
            self.time -= end;
            self.elapsed += periods;
            self.end_segment();
            self.reached = self.reached.wrapping_add(1);
            if self.from.is_at_standstill() {
                self.stops_ahead = self.stops_ahead.saturating_sub(1);
            }
            match self.from.action {
                Action::None => {}
                Action::OverrideMode(mode) => self.enter_override_mode(mode),
                action @ (Action::Spindle(_)
                | Action::Output { .. }
                | Action::AnalogOutput { .. }) => progress.action = action,
                Action::Pause => {
                    self.paused = true;
                    self.time = 0;
                    progress.paused = Some(self.reached.wrapping_sub(1));
                    return;
                }
            }
            if self.total == Some(self.reached) {
                self.time = 0;
                progress.finished = true;
                return;
            }
            if self.from.is_at_standstill() {
                if !self.can_pass_stop() {
                    self.time = 0;
                    self.started = false;
                    return;
                }
                self.limit_speed_factor();
            }
        }
    }

    /// Pose, rates and accelerations at the present program time and speed factor.
    fn commanded(&self) -> PoseCommand {
        let mut commanded = PoseCommand::default();
        self.sample(&mut commanded);
        commanded
    }

    /// As [`Interpolator::commanded`], written in place.
    #[inline]
    fn sample(&self, commanded: &mut PoseCommand) {
        let Some(segment) = self.segment() else {
            *commanded = PoseCommand {
                pose: Pose(self.from.pose.map(Coordinate)),
                ..PoseCommand::default()
            };
            return;
        };
        let fraction = segment.duration.fraction((self.time >> 16) as u32);
        let PoseCommand {
            pose,
            rates,
            accelerations,
        } = &mut *commanded;
        // A compiler that knows the value to be positive multiplies it as an unsigned word, which
        // takes four instructions for one.
        let half = core::hint::black_box(segment::half(fraction));
        let places = pose.0.iter_mut().zip(rates).zip(accelerations);
        for (polynomial, ((place, rate), acceleration)) in
            segment.polynomials.iter().zip(places).take(self.axes)
        {
            let sample = polynomial.sample(half);
            *place = sample.position;
            *rate = sample.rate;
            *acceleration = sample.acceleration;
        }
        if self.speed_factor != Ramp::at(FULL_FACTOR) {
            self.scale_to_speed_factor(commanded);
        }
    }

    /// Distance between two positions; the shorter one on an axis of one turn.
    fn distance(&self, axis: usize, from: i32, to: i32) -> i64 {
        if self.circular[axis] {
            i64::from(to.wrapping_sub(from))
        } else {
            i64::from(to) - i64::from(from)
        }
    }

    /// Scales rates and accelerations from the programmed speed to the speed factor.
    #[inline(never)]
    fn scale_to_speed_factor(&self, commanded: &mut PoseCommand) {
        let rate = self.speed_factor.value() >> 2;
        let rate_squared = product(rate, rate) >> 30;
        let slope = self.speed_factor.slope();
        let motions = commanded.rates.iter_mut().zip(&mut commanded.accelerations);
        for (axis_rate, acceleration) in motions.take(self.axes) {
            let speed = i64::from(axis_rate.0);
            *axis_rate = Rate((product(speed, rate) >> 30) as i32);
            // d2p/dt2 = p'' r^2 + p' dr/dt, with dr/dt in 2^-32 per control period. Speed factor
            // and its square are below 2^31, its slope is below 2^32: with 31 bits of rate or
            // acceleration all products fit.
            let braking = product(product(speed, slope) >> 32, self.periods_per_second);
            let sum = total(
                product(i64::from(acceleration.0), rate_squared) >> 30,
                braking >> 8,
            );
            *acceleration = Acceleration(saturate(sum));
        }
    }

    #[inline]
    fn segment(&self) -> Option<&Segment> {
        self.segments.present()
    }
}
