//! The queue of timed setpoints, and the walk along it.
//!
//! Time on the path is program time: it passes at the *path rate*, 1 when all is well, less while the machine slows down along its path
//! (hold, stop, override, or setpoints that are late), 0 at rest. The path rate is a [`Ramp`]: braking builds up and dies away within
//! its bounds, and the path itself is never left.
//!
//! Slowing down for want of setpoints begins while the queue still covers the stopping distance, so the last setpoint is never passed.
//! The bounds on acceleration and jerk of the braking are those of the configuration's [`Stopping`], on top of the program's own.

mod ahead;
mod coverage;
mod retreat;
mod stopping;

use super::Wanted;
use super::cubic::{Cubic, Span};
use super::ramp::{Ramp, RampLimits};
use super::way;
use crate::config::{AxisKind, Config, Stopping};
use crate::kinematics::Pose;
use crate::safety::integrity::constants;
use crate::units::scale::{product, saturate, total};
use crate::units::{Acceleration, Coordinate, Rate};
use ahead::{Segment, Segments};
use core::ops::Range;
use haptimill_protocol::message::{Action, MAX_AXES, RATE_SHIFT, Refusal};
use haptimill_protocol::setpoint::Setpoint;
use heapless::Deque;
use retreat::PASSED;

/// How many setpoints the queue holds.
pub const QUEUE: usize = 256;

/// The path rate of the programmed speed.
pub const FULL_RATE: i64 = 1 << 32;

/// A setpoint in the queue.
#[derive(Debug, Clone, Copy, Default)]
struct Knot {
    pose: [i32; MAX_AXES],
    rates: [i32; MAX_AXES],
    periods: u16,
    action: Action,
}

impl Knot {
    fn at_rest(&self) -> bool {
        self.rates.iter().all(|rate| *rate == 0)
    }
}

/// What happened on the path in one period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Progress {
    /// A new spindle speed, rev/min.
    pub spindle: Option<i16>,
    /// A pause was reached, at this setpoint.
    pub paused: Option<u32>,
    /// The last setpoint of the job was reached.
    pub finished: bool,
    /// It went no farther, because what was moved by hand leaves no room to stop on the way ahead.
    pub blocked: bool,
    /// The queue ended in motion: a defect, since braking must have ended before.
    pub ran_dry: bool,
}

/// Setpoints were late.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Late {
    /// The setpoint that was late.
    pub setpoint: u32,
    /// Periods from the beginning of the braking to its arrival.
    pub periods: u32,
}

/// A job: its queue and where on it the machine is.
#[derive(Debug, Default)]
pub struct Program {
    axes: usize,
    rotary: [bool; MAX_AXES],
    /// Wire units.
    rate_limits: [i32; MAX_AXES],
    acceleration_limits: [Acceleration; MAX_AXES],
    period_us: u16,
    periods_per_second: i64,
    /// The span of the setpoint that was taken last: most have the length of the one before.
    span: Span,
    braking: Option<RampLimits>,
    /// Program time that braking from the full rate takes, in periods.
    braking_periods: u64,

    queue: Deque<Knot, QUEUE>,
    /// The setpoints that were passed last, newest last.
    passed: Deque<Knot, PASSED>,
    /// Program time that is still to be gone back once the machine rests, 2^-32 periods.
    back: u64,
    /// Sum of the spans in the queue, in periods.
    queued_periods: u64,
    /// Setpoints at rest that are not reached yet.
    rests_ahead: u32,
    /// The newest setpoint taken (or the start pose).
    tail: Knot,
    /// The setpoint reached last (or the start pose).
    from: Knot,
    /// The way to the next setpoint, and the one after that.
    segments: Segments,
    /// Time into the segment, 2^-32 periods.
    time: u64,
    /// Program time at the start of the segment, in periods.
    elapsed: u64,
    path_rate: Ramp,
    override_rate: i64,
    accepted: u32,
    reached: u32,
    total: Option<u32>,
    started: bool,
    paused: bool,
    /// Periods since braking began because of this setpoint.
    starving: Option<Late>,
    late: Option<Late>,
}

constants!(Program {
    axes, rotary, rate_limits, acceleration_limits, period_us, periods_per_second, braking, braking_periods
} of {} but {
    queue, queued_periods, rests_ahead, tail, from, segments, time, elapsed, path_rate, override_rate, accepted, reached, total, started, paused,
    starving, late, span, passed, back
});

/// Bounds of the path rate that a configuration's [`Stopping`] means; `None` if it makes no sense.
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
    let slope = FULL_RATE * period / (time - ramp);
    RampLimits::new(slope, slope * period / ramp)
}

impl Program {
    /// An empty program for the machine of `config`.
    #[must_use]
    pub fn new(config: &Config) -> Self {
        // Filled where it lies: the queue is large, and a second one on the stack would be the controller's deepest.
        let mut program = Self::default();
        program.set_up(config);
        program
    }

    /// An empty program becomes that of the machine of `config`.
    pub(super) fn set_up(&mut self, config: &Config) {
        let program = self;
        program.axes = config.pose.len();
        program.period_us = config.period_us;
        program.periods_per_second = 1_000_000 / i64::from(config.period_us.max(1));
        program.braking = braking_limits(&config.stopping, config.period_us);
        program.override_rate = FULL_RATE;
        for (axis, pose) in config.pose.iter().enumerate() {
            program.rotary[axis] = pose.kind == AxisKind::Rotary;
            // Two hundredths more, for the rounding of setpoints.
            let rate = i64::from(pose.rate.0) + i64::from(pose.rate.0) / 50;
            program.rate_limits[axis] = (rate >> RATE_SHIFT) as i32;
            program.acceleration_limits[axis] =
                Acceleration(pose.acceleration.0.saturating_mul(16));
        }
        program.braking_periods = program.braking.map_or(0, |limits| {
            Ramp::at(FULL_RATE)
                .stopping_range(&limits)
                .map_or(0, |(_, ahead)| ahead)
                .unsigned_abs()
                >> 32
        });
    }

    /// Begins a job at `pose`.
    pub fn begin(&mut self, pose: &Pose) {
        self.passed.clear();
        self.back = 0;
        self.queue.clear();
        self.queued_periods = 0;
        self.rests_ahead = 0;
        self.tail = Knot::default();
        self.tail.pose = pose.0.map(|coordinate| coordinate.0);
        self.from = self.tail;
        self.segments.clear();
        self.time = 0;
        self.elapsed = 0;
        self.path_rate = Ramp::at(FULL_RATE);
        self.accepted = 0;
        self.reached = 0;
        self.total = None;
        self.started = false;
        self.paused = false;
        self.starving = None;
        self.late = None;
    }

    /// Takes the next setpoint; a refused one changes nothing.
    pub fn push(&mut self, setpoint: &Setpoint) -> Result<(), Refusal> {
        self.push_tried(setpoint, 0)
    }

    /// Whether `axes` of the coordinates may go to the next setpoint as it says; a part of what [`Program::push`] looks at.
    #[inline(never)]
    pub fn allows(&mut self, setpoint: &Setpoint, axes: Range<usize>) -> Result<(), Refusal> {
        let number = self.accepted;
        let bad = Refusal::Setpoint { setpoint: number };
        if setpoint.pose.len() != self.axes || setpoint.rates.len() != self.axes {
            return Err(Refusal::AxisCount);
        }
        if self.total.is_some_and(|total| number >= total) {
            return Err(Refusal::OutOfOrder { expected: number });
        }
        if matches!(setpoint.action, Action::Pause) && setpoint.rates.iter().any(|rate| *rate != 0)
        {
            return Err(bad);
        }
        self.measure(setpoint.periods).ok_or(bad)?;
        let to = setpoint.pose.iter().zip(&setpoint.rates).enumerate();
        for (axis, (place, rate)) in to.take(axes.end).skip(axes.start) {
            if !self.may_go(axis, *place, *rate) {
                return Err(bad);
            }
        }
        Ok(())
    }

    /// Whether the machine rests from the newest setpoint to the next one.
    #[must_use]
    pub fn rests_until(&self, setpoint: &Setpoint) -> bool {
        let still = |(place, to): (&i32, &i32)| place == to;
        self.tail.at_rest()
            && setpoint.rates.iter().all(|rate| *rate == 0)
            && self.tail.pose.iter().zip(&setpoint.pose).all(still)
    }

    /// Pose and rates so many periods after the newest setpoint on the way to the next one, of which [`Program::allows`] was asked in this period.
    #[must_use]
    pub fn sample_to(&self, setpoint: &Setpoint, periods: u16) -> Option<Wanted> {
        let mut wanted = Wanted::default();
        let half = way::half(self.span.fraction(u32::from(periods) << 16));
        let to = setpoint.pose.iter().zip(&setpoint.rates).enumerate();
        for (axis, (place, rate)) in to {
            let (start, wrap) = (Coordinate(self.tail.pose[axis]), self.rotary[axis]);
            let (from, end) = (self.tail.rates[axis], Coordinate(*place));
            let cubic = Cubic::new(start, from, end, *rate, &self.span, wrap)?;
            let sample = way::Way::new(&cubic, &self.span).sample(half);
            wanted.pose.0[axis] = sample.position;
            wanted.rates[axis] = sample.rate;
        }
        Some(wanted)
    }

    /// Whether a setpoint so many periods after the one before is as far from it as that was: others take a little longer to look at.
    #[must_use]
    pub const fn expects(&self, periods: u16) -> bool {
        self.span.periods() == periods
    }

    /// Takes the next setpoint, whose first `tried` coordinates may go to it; a refused one changes nothing.
    pub fn push_tried(&mut self, setpoint: &Setpoint, tried: usize) -> Result<(), Refusal> {
        self.allows(setpoint, tried..self.axes)?;
        if self.queue.is_full() {
            return Err(Refusal::QueueFull);
        }
        let number = self.accepted;
        let tail = &mut self.tail;
        tail.periods = setpoint.periods;
        tail.action = setpoint.action;
        let places = tail.pose.iter_mut().zip(&mut tail.rates);
        let to = setpoint.pose.iter().zip(&setpoint.rates);
        for ((place, rate), (to, to_rate)) in places.zip(to) {
            (*place, *rate) = (*to, *to_rate);
        }
        // There is room.
        let _ = self.queue.push_back(self.tail);
        self.queued_periods += u64::from(setpoint.periods);
        self.rests_ahead += u32::from(self.tail.at_rest());
        self.accepted = self.accepted.wrapping_add(1);
        if let Some(starving) = self.starving
            && starving.setpoint == number
        {
            self.late = Some(starving);
        }
        Ok(())
    }

    /// Says how many setpoints the job has.
    pub fn end(&mut self, count: u32) -> Result<(), Refusal> {
        if count != self.accepted {
            return Err(Refusal::OutOfOrder {
                expected: self.accepted,
            });
        }
        if !self.tail.at_rest() {
            return Err(Refusal::Setpoint {
                setpoint: count.saturating_sub(1),
            });
        }
        self.total = Some(count);
        Ok(())
    }

    /// Number of the first setpoint that the queue has no room for.
    #[must_use]
    pub fn credit(&self) -> u32 {
        self.accepted
            .wrapping_add((QUEUE - self.queue.len()) as u32)
    }

    /// Setpoints that wait in the queue.
    #[must_use]
    pub fn queued(&self) -> usize {
        self.queue.len()
    }

    /// Whether the host has said that all setpoints of the job are here.
    #[must_use]
    pub const fn is_complete(&self) -> bool {
        self.total.is_some()
    }

    /// Setpoints that were reached.
    #[must_use]
    #[inline]
    pub const fn reached(&self) -> u32 {
        self.reached
    }

    /// The setpoint that is expected next.
    #[must_use]
    pub const fn accepted(&self) -> u32 {
        self.accepted
    }

    /// Program time since the job began, in 2^-32 periods: it passes at the path rate.
    #[must_use]
    pub const fn program_time(&self) -> u64 {
        (self.elapsed << 32).wrapping_add(self.time)
    }

    /// The path rate, [`FULL_RATE`] for the programmed speed.
    #[must_use]
    #[inline]
    pub const fn path_rate(&self) -> i64 {
        self.path_rate.value()
    }

    /// Speed along the path in percent of the programmed one.
    pub fn set_override(&mut self, percent: u8) {
        self.override_rate = FULL_RATE * i64::from(percent.clamp(1, 100)) / 100;
    }

    /// Whether the path has more to do in this period than in others: the next setpoint may be reached, or a part of the segment after it is to be made.
    #[must_use]
    #[inline]
    pub fn is_busy(&self) -> bool {
        self.is_near_end() && (self.turns() || self.misses_part())
    }

    /// Whether the next setpoint may be reached in this period, and a new segment begun.
    #[inline(never)]
    fn turns(&self) -> bool {
        self.started
            && !self.paused
            && self.segment().is_none_or(|segment| {
                let end = u64::from(segment.span.periods()) << 32;
                // As fast as the path rate may be in the next period.
                let slope = self.braking.map_or(0, |braking| braking.slope());
                let most = (self.path_rate.value() + slope).clamp(0, FULL_RATE);
                self.time + most as u64 >= end
            })
    }

    /// Goes on after a pause.
    pub fn leave_pause(&mut self) {
        if core::mem::take(&mut self.paused) {
            self.started = self.started && self.may_pass_rest();
        }
    }

    /// The report on setpoints that were late, once.
    #[inline]
    pub fn take_late(&mut self) -> Option<Late> {
        self.late.take()
    }

    /// The setpoint for want of which the machine slows down or waits, and for how long it has.
    #[must_use]
    pub const fn starving(&self) -> Option<Late> {
        match self.starving {
            Some(Late { periods, .. }) => Some(Late {
                setpoint: self.accepted,
                periods,
            }),
            None => None,
        }
    }

    /// Whether nothing moves along the path: braked to rest, waiting, or paused.
    #[must_use]
    #[inline]
    pub fn is_still(&self) -> bool {
        (self.path_rate.is_zero() && self.back == 0)
            || self.paused
            || !self.started
            || (self.segment().is_none() && self.queue.is_empty())
    }

    /// One period along the path; `halt` brakes to rest and keeps the place.
    pub fn advance(&mut self, halt: bool) -> (Wanted, Progress) {
        let mut wanted = Wanted::default();
        let progress = self.advance_to(halt, &mut wanted);
        (wanted, progress)
    }

    /// The same, with the pose, rates and accelerations written where they shall be.
    #[inline]
    pub fn advance_to(&mut self, halt: bool, wanted: &mut Wanted) -> Progress {
        let progress = self.go(halt);
        self.sample(wanted);
        progress
    }

    #[inline]
    fn go(&mut self, halt: bool) -> Progress {
        let mut progress = Progress::default();
        let Some(braking) = self.braking else {
            return progress;
        };
        // A pause at the last setpoint is waited for like any other.
        let finished = self.total == Some(self.reached) && !self.paused;
        if !self.started {
            self.started = !halt && self.may_leave_rest();
            // At rest any path rate is the same motion: begin with the one that is wanted, unless the queue is full of spans so short
            // that there would be no stopping on them.
            self.path_rate = Ramp::at(if self.may_pass_rest() {
                self.override_rate
            } else {
                0
            });
            // The way begins in the next period: this one may have taken the setpoint for which it waited, and both are long.
            progress.finished = finished;
            return progress;
        }
        if finished || self.paused {
            progress.finished = finished;
            return progress;
        }
        if halt && self.back > 0 && self.goes_back(&braking) {
            return progress;
        }
        self.watch_coverage(&braking);
        let target = if halt || self.starving.is_some() {
            0
        } else {
            self.override_rate
        };
        self.time += self.path_rate.advance(target, &braking).max(0) as u64;
        self.walk(&mut progress);
        progress
    }

    /// Goes from setpoint to setpoint until the time lies within a segment.
    #[inline]
    fn walk(&mut self, progress: &mut Progress) {
        loop {
            if self.segment().is_none() && !self.begin_next() {
                progress.ran_dry = !self.from.at_rest();
                self.time = 0;
                if progress.ran_dry {
                    self.path_rate = Ramp::at(0);
                }
                return;
            }
            let Some(segment) = self.segments.present() else {
                return;
            };
            let periods = u64::from(segment.span.periods());
            let end = periods << 32;
            if self.time < end {
                return;
            }
            self.time -= end;
            self.elapsed += periods;
            self.pass();
            self.reached = self.reached.wrapping_add(1);
            if self.from.at_rest() {
                self.rests_ahead = self.rests_ahead.saturating_sub(1);
            }
            match self.from.action {
                Action::None => {}
                Action::Spindle(speed) => progress.spindle = Some(speed),
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
            if self.from.at_rest() && !self.may_pass_rest() {
                self.time = 0;
                self.started = false;
                return;
            }
        }
    }

    /// Pose, rates and accelerations at the present time and path rate.
    fn wanted(&self) -> Wanted {
        let mut wanted = Wanted::default();
        self.sample(&mut wanted);
        wanted
    }

    /// The same, written where they shall be.
    #[inline]
    fn sample(&self, wanted: &mut Wanted) {
        let Some(segment) = self.segment() else {
            *wanted = Wanted {
                pose: Pose(self.from.pose.map(Coordinate)),
                ..Wanted::default()
            };
            return;
        };
        let fraction = segment.span.fraction((self.time >> 16) as u32);
        let Wanted {
            pose,
            rates,
            accelerations,
        } = &mut *wanted;
        // A compiler that knows it to be positive multiplies by it as by an unsigned word, which takes four instructions for one.
        let half = core::hint::black_box(way::half(fraction));
        let places = pose.0.iter_mut().zip(rates).zip(accelerations);
        for (way, ((place, rate), acceleration)) in segment.ways.iter().zip(places).take(self.axes)
        {
            let sample = way.sample(half);
            *place = sample.position;
            *rate = sample.rate;
            *acceleration = sample.acceleration;
        }
        if self.path_rate != Ramp::at(FULL_RATE) {
            self.slow_down(wanted);
        }
    }

    /// From one place to another; the short way round on a rotary axis.
    fn distance(&self, axis: usize, from: i32, to: i32) -> i64 {
        if self.rotary[axis] {
            i64::from(to.wrapping_sub(from))
        } else {
            i64::from(to) - i64::from(from)
        }
    }

    /// From rates and accelerations at the programmed speed to those at the path rate.
    #[inline(never)]
    fn slow_down(&self, wanted: &mut Wanted) {
        let rate = self.path_rate.value() >> 2;
        let rate_squared = product(rate, rate) >> 30;
        let slope = self.path_rate.slope();
        let motions = wanted.rates.iter_mut().zip(&mut wanted.accelerations);
        for (axis_rate, acceleration) in motions.take(self.axes) {
            let speed = i64::from(axis_rate.0);
            *axis_rate = Rate((product(speed, rate) >> 30) as i32);
            // d2p/dt2 = p'' r^2 + p' dr/dt, with dr/dt in 2^-32 per period.
            // Path rate and its square are below 2^31, its slope below 2^32: with 31 bits of speed or acceleration all products fit.
            let braking = product(product(speed, slope) >> 32, self.periods_per_second);
            let sum = total(
                product(i64::from(acceleration.0), rate_squared) >> 30,
                braking >> 8,
            );
            *acceleration = Acceleration(saturate(sum));
        }
    }

    /// The span of the setpoint that is looked at becomes one of so many periods; most are as long as the one before.
    fn measure(&mut self, periods: u16) -> Option<()> {
        if self.span.periods() != periods || periods == 0 {
            self.span = Span::new(periods, self.period_us)?;
        }
        Some(())
    }

    #[inline]
    fn segment(&self) -> Option<&Segment> {
        self.segments.present()
    }

    /// Whether an axis may go from the newest setpoint to the next one: neither the rate there nor the mean rate nor any in between is beyond the axis' limit, nor
    /// the acceleration beyond 16 times that of a jog. Such a setpoint is a mistake, not a motion.
    fn may_go(&self, axis: usize, place: i32, rate: i32) -> bool {
        let (span, limit) = (&self.span, self.rate_limits[axis]);
        if rate.unsigned_abs() > limit.unsigned_abs() {
            return false;
        }
        let (tail, wrap) = (&self.tail, self.rotary[axis]);
        let (start, start_rate) = (Coordinate(tail.pose[axis]), tail.rates[axis]);
        let Some(cubic) = Cubic::new(start, start_rate, Coordinate(place), rate, span, wrap) else {
            return false;
        };
        cubic.is_still()
            || (cubic.keeps_mean_rate(limit, span)
                && cubic.keeps_rate(limit, span)
                && cubic.keeps_acceleration(self.acceleration_limits[axis], span))
    }
}
