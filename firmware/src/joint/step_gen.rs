//! Step pulse generation from the commanded position of a motor.
//!
//! Every period gives one [`StepSegment`]. A pulse leaves when the ideal position crosses the
//! middle between two steps. The ideal position within a period is the parabola through the
//! commanded positions and rates at both ends of the period. So the phase carries over between
//! periods: at 0.26 steps per period the pulses are evenly spaced and off the grid of periods. At
//! the end of each period the sum of all steps is the commanded position rounded to steps. That sum
//! is compared with the position, not accumulated, so it cannot drift.
//!
//! The timing of the drive has priority over the ideal times. Pulse width, the time between two
//! pulses, direction setup and hold are kept within and across periods. A pulse begins in the
//! period of its crossing and may end in the next one. Where pulses are too dense they are moved,
//! and after a reversal they wait. Steps that do not fit are emitted in the following periods and
//! are reported as lag.
//!
//! Without such a conflict, pulse k of n is within `1 + n/2` ticks of its ideal time at a constant
//! rate, and within `1 + n` ticks where the last crossing is within `1 + n/2` ticks of the end of
//! the period. While the rate changes, the rounding of `ramp` to whole ticks adds up to n^2/16
//! ticks, and the second-order inverse of the parabola adds up to (change of rate / rate)^2 / 8 of
//! a period.
//!
//! Callers must limit the commanded rate. A commanded position that jumps is executed at the
//! highest pulse rate of the timing, which a motor cannot follow.

use super::encoder::difference;
use crate::config::AxisKind;
use crate::digest::impl_digest;
use crate::io::StepSegment;
use haptimill_math::reciprocal::Reciprocal;
use haptimill_math::{Coordinate, Rate};

/// One step in position units (Q32).
const STEP: i64 = 1 << 32;

/// Timing of a step/dir drive, in ticks of the step clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct PulseTiming {
    /// Ticks of a control period, 1 to 1,000,000.
    pub period: u32,
    /// Width of a pulse, and shortest time between two pulses.
    pub pulse: u16,
    /// Direction setup time before the first pulse.
    pub setup: u16,
    /// Direction hold time after the end of the last pulse.
    pub hold: u16,
}

impl PulseTiming {
    /// Whether at least one pulse fits into a period, also after a reversal.
    pub const fn fits(&self) -> bool {
        let (pulse, setup) = (self.pulse as u32, self.setup as u32);
        self.period > 0
            && self.period <= 1_000_000
            && pulse > 0
            && setup + pulse <= self.period
            && 2 * pulse <= self.period
    }
}

/// Plan of a period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Planned {
    /// The pulses.
    pub segment: StepSegment,
    /// Steps still due at the end of the period, signed.
    pub lag: i32,
    /// Some steps did not fit into the period.
    pub ceiling: bool,
}

/// Step generator of one joint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StepPlanner {
    kind: AxisKind,
    timing: PulseTiming,
    /// Steps per axis unit, Q62, signed; at most 2^62.
    steps_per_unit: i64,
    /// Steps per period for a rate of 1 au/s, Q62.
    steps_per_rate: i64,
    last: Coordinate,
    /// Travel since the start or the last folding, axis units.
    travel: i64,
    /// Commanded position at the end of the last period, steps Q32.
    position: i64,
    /// Commanded rate there, steps per period Q32.
    rate: i64,
    /// Steps emitted since the start, minus the folded ones.
    emitted: i64,
    /// Steps folded away.
    folded: i64,
    /// Position at which `travel` is zero, steps Q32; within a step of zero.
    origin: i64,
    /// Level of the direction line: -1, 1, or 0 for unknown.
    level: i64,
    /// Ticks into the next period before which no pulse may leave.
    ready: u32,
    /// Ticks into the next period before which the direction must stay.
    hold_left: u32,
}

impl_digest!(StepPlanner { fields {
    kind, timing, steps_per_unit, steps_per_rate
}, nested {}, skip { last, travel, position, rate, emitted, folded, origin, level, ready, hold_left } });

impl StepPlanner {
    /// A generator with `per_step` axis units per step, times 2^24. A negative value means that a
    /// positive step moves down; a magnitude below one axis unit counts as one.
    pub const fn new(kind: AxisKind, per_step: i64, timing: PulseTiming, period_us: u16) -> Self {
        let size = per_step.unsigned_abs();
        let size = if size < 1 << 24 { 1 << 24 } else { size };
        // 2^86 / 2^24 = 2^62 at most.
        let magnitude = inverse(size);
        let whole = magnitude / 1_000_000 * period_us as i64;
        let per_rate = whole + magnitude % 1_000_000 * period_us as i64 / 1_000_000;
        let negative = per_step < 0;
        Self {
            kind,
            timing,
            steps_per_unit: if negative { -magnitude } else { magnitude },
            steps_per_rate: if negative { -per_rate } else { per_rate },
            last: Coordinate(0),
            travel: 0,
            position: 0,
            rate: 0,
            emitted: 0,
            folded: 0,
            origin: 0,
            level: 0,
            ready: 0,
            hold_left: 0,
        }
    }

    /// Starts at standstill at `coordinate`, which becomes step 0. The timing of the pulses already
    /// emitted still applies.
    pub const fn start(&mut self, coordinate: Coordinate) {
        self.last = coordinate;
        self.travel = 0;
        self.position = 0;
        self.rate = 0;
        self.emitted = 0;
        self.folded = 0;
        self.origin = 0;
        self.level = 0;
    }

    /// Shifts all coordinates by `shift` after a reference was found; nothing moves.
    pub fn rebase(&mut self, shift: Coordinate) {
        self.last = super::encoder::sum(self.kind, self.last, shift);
    }

    /// Steps emitted since the start.
    pub const fn emitted(&self) -> i64 {
        self.folded.wrapping_add(self.emitted)
    }

    /// Plans the pulses of the next period, at whose end the motor must be at `target` with `rate`.
    #[inline(never)]
    pub fn plan(&mut self, target: Coordinate, rate: Rate) -> Planned {
        if self.emitted.unsigned_abs() > 1 << 24 {
            self.fold();
        }
        let moved = if self.kind.is_circular() {
            i64::from(difference(self.kind, target, self.last).0)
        } else {
            i64::from(target.0) - i64::from(self.last.0)
        };
        self.last = target;
        self.travel = self.travel.saturating_add(moved);
        let (start, rate_before) = (self.position, self.rate);
        self.position = self.origin + steps(self.travel, self.steps_per_unit);
        self.rate = steps(i64::from(rate.0), self.steps_per_rate);
        let due = ((self.position + STEP / 2) >> 32) - self.emitted;

        // The common case of a slow machine is that no step is due.
        let planned = if due == 0 {
            None
        } else {
            // |rates| <= 2^62, so their difference may need 64 bits; each is halved first.
            let bend = self.rate / 2 - rate_before / 2;
            self.plan_segment(due, start, bend)
        };
        let timing = self.timing;
        match planned {
            Some(segment) => {
                let steps = i64::from(segment.count);
                let last = i64::from(segment.delay) + offset(&segment, steps.abs() - 1);
                let last = u32::try_from(last).unwrap_or(timing.period);
                self.emitted += steps;
                self.level = steps.signum();
                let pulse = u32::from(timing.pulse);
                self.ready = (last + 2 * pulse).saturating_sub(timing.period);
                self.hold_left =
                    (last + pulse + u32::from(timing.hold)).saturating_sub(timing.period);
                let lag = due - steps;
                Planned {
                    segment,
                    lag: haptimill_math::reciprocal::saturate(lag),
                    ceiling: lag != 0,
                }
            }
            None => {
                self.ready = self.ready.saturating_sub(timing.period);
                self.hold_left = self.hold_left.saturating_sub(timing.period);
                Planned {
                    segment: StepSegment::default(),
                    lag: haptimill_math::reciprocal::saturate(due),
                    ceiling: due != 0,
                }
            }
        }
    }

    /// Moves the origin to the motor position, so that a table that turns one way endlessly stays
    /// within the range of positions. The error is less than 2^-20 step in 2^24.
    fn fold(&mut self) {
        let whole = self.position >> 32;
        self.origin = self.position - whole * STEP;
        self.position = self.origin;
        self.travel = 0;
        self.emitted -= whole;
        self.folded = self.folded.wrapping_add(whole);
    }

    /// Places as many of the due steps as fit, each as near to its ideal time as the timing allows.
    fn plan_segment(&self, due: i64, start: i64, bend: i64) -> Option<StepSegment> {
        let sign = due.signum();
        let reverses = sign != self.level;
        if reverses && self.hold_left > 0 {
            return None;
        }
        let pulse = u32::from(self.timing.pulse);
        let gap = 2 * pulse.max(1);
        let earliest = if reverses {
            self.ready.max(u32::from(self.timing.setup))
        } else {
            self.ready
        };
        let latest = self.timing.period.saturating_sub(1);
        let room = latest.checked_sub(earliest)? / gap + 1;
        let count = u32::try_from(due.unsigned_abs())
            .unwrap_or(u32::MAX)
            .min(room)
            .min(i16::MAX as u32);

        let ideal = Ideal::new(
            (self.position - start) * sign,
            bend * sign,
            self.timing.period,
        );
        // Distance from the start of the period to the first crossing; positive if the crossing is
        // ahead.
        let first_crossing = (self.emitted * STEP - start) * sign + STEP / 2;
        let first = ideal.time(first_crossing).max(earliest).min(latest);
        let signed = |count: u32| (count as i16) * (sign as i16);
        if count == 1 {
            return Some(StepSegment {
                count: signed(1),
                delay: first,
                interval: 0,
                ramp: 0,
            });
        }
        let intervals = count - 1;
        let last_crossing = first_crossing + i64::from(intervals) * STEP;
        let mut last = ideal.time(last_crossing).max(first).min(latest);
        let mut delay = first;
        let mut ramp = 0;
        if last - delay < intervals * gap {
            // Too dense: extend to the end of the period, then towards its start; `room` ensures
            // that it fits.
            last = latest.min(delay + intervals * gap);
            delay = delay.min(last - intervals * gap);
        } else {
            ramp = ideal.ramp(intervals);
        }
        let spread = Spread {
            duration: (last - delay) as i32,
            max: (latest - delay) as i32,
            intervals: intervals as i32,
            gap: gap as i32,
        };
        let (interval, ramp) = spread.intervals(ramp);
        Some(StepSegment {
            count: signed(count),
            delay,
            interval,
            ramp,
        })
    }
}

/// Intervals between pulses, in ticks; all are at most 1,000,000, and `intervals * gap <= span <=
/// most`.
struct Spread {
    /// Ideal time from the first to the last pulse.
    duration: i32,
    /// Upper limit of that time.
    max: i32,
    intervals: i32,
    /// The shortest interval.
    gap: i32,
}

impl Spread {
    /// Returns the first interval and the growth of each further one: `ramp` if it keeps all
    /// limits, 0 otherwise. 32-bit divisions only.
    fn intervals(&self, ramp: i32) -> (u32, i32) {
        let n = self.intervals;
        // Total bend that `ramp` adds up to at the last pulse. A bend of several spans is a jump,
        // not an acceleration.
        let bent = i64::from(ramp) * (i64::from(n) * i64::from(n - 1) / 2);
        if ramp != 0 && bent.abs() <= 4 * i64::from(self.duration) {
            let bent = bent as i32;
            for rounding in [n / 2, 0] {
                let interval = (self.duration - bent + rounding).div_euclid(n);
                let shortest = interval + ramp.min(0) * (n - 1);
                if shortest >= self.gap && n * interval + bent <= self.max {
                    return (interval.unsigned_abs(), ramp);
                }
            }
        }
        let rounded = (self.duration + n / 2) / n;
        let even = if n * rounded <= self.max {
            rounded
        } else {
            self.duration / n
        };
        (even.unsigned_abs(), 0)
    }
}

/// `k * interval + ramp * k (k - 1) / 2`.
const fn offset(segment: &StepSegment, k: i64) -> i64 {
    k * segment.interval as i64 + segment.ramp as i64 * (k * (k - 1) / 2)
}

/// 2^86 / `size`, for a size of at least 2^24. One bit at a time: 128-bit division takes 1 KiB of
/// flash.
const fn inverse(size: u64) -> i64 {
    let (mut quotient, mut rest) = ((size == 1 << 24) as i64, (1 << 24) % size);
    let mut bit = 0;
    while bit < 62 {
        // The top bit is lost where the rest is doubled beyond the word.
        let beyond = rest >> 63 != 0;
        rest <<= 1;
        quotient <<= 1;
        if beyond || rest >= size {
            rest = rest.wrapping_sub(size);
            quotient |= 1;
        }
        bit += 1;
    }
    quotient
}

/// Axis units to steps Q32, or rates likewise, within +-2^60.
#[inline]
fn steps(units: i64, scale: i64) -> i64 {
    let product = (i128::from(units) * i128::from(scale)) >> 30;
    product.clamp(-(1 << 60), 1 << 60) as i64
}

/// Parabola of a period in the direction of motion: the position at the fraction u of the period is
/// `distance u + bend u (u - 1)`.
struct Ideal {
    period: u32,
    /// Distance, at most 32 bits after `shift`.
    distance: u32,
    shift: u32,
    reciprocal: Reciprocal,
    /// bend / distance, Q16, within +-3/4.
    bend: i64,
}

impl Ideal {
    fn new(distance: i64, bend: i64, period: u32) -> Self {
        // Steps are due from before while the commanded position turned back: their only ideal time
        // is the earliest.
        let distance = distance.max(0).unsigned_abs();
        let shift = 32u32.saturating_sub(distance.leading_zeros());
        // Shifted to below 2^32.
        let scaled = (distance >> shift) as u32;
        let reciprocal = Reciprocal::new(scaled);
        let max = (i64::from(scaled) * 3) / 4;
        let bend = (bend >> shift).max(-max).min(max);
        let bend = if scaled == 0 {
            0
        } else {
            reciprocal.scaled(bend, 16)
        };
        Self {
            period,
            distance: scaled,
            shift,
            reciprocal,
            bend,
        }
    }

    /// Ticks at which the position crosses `crossing` (Q32 steps from the start of the period). A
    /// crossing before the period gives 0, one after it gives the period.
    ///
    /// The inverse of the parabola to second order: u = q + bend q (1 - q), q = crossing /
    /// distance.
    fn time(&self, crossing: i64) -> u32 {
        if crossing <= 0 || self.distance == 0 {
            return 0;
        }
        let crossing = (crossing >> self.shift).min(i64::from(self.distance));
        // Q30; at most 2^32 * 2^31.
        let q = self.reciprocal.scaled(crossing, 30).min(1 << 30);
        let curve = (q * ((1 << 30) - q)) >> 30;
        let u = (q + ((self.bend * curve) >> 16)).clamp(0, 1 << 30);
        ((i64::from(self.period) * u + (1 << 29)) >> 30) as u32
    }

    /// Second difference of the times of evenly spaced crossings: -2 bend period / distance^2,
    /// whole ticks.
    fn ramp(&self, intervals: u32) -> i32 {
        if intervals < 2 || self.distance == 0 {
            return 0;
        }
        // One step over the distance, Q30; the distance holds at least two intervals.
        let step = self.reciprocal.scaled(
            ((1i64 << 32) >> self.shift).min(i64::from(self.distance)),
            30,
        );
        let square = (step * step) >> 30;
        // 2^21 * 2^12 * 2^30 reaches 2^63 only if bend and step are 1; they are at most 3/4 and
        // 1/2.
        let twice = i64::from(self.period) * (self.bend >> 4);
        haptimill_math::reciprocal::saturate(-((twice * square + (1 << 40)) >> 41))
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    proptest! {
        #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn scales_of_steps_are_exact(per_step: i64, down in 0_u32..40, period_us in 50_u16..=1000) {
            let per_step = per_step >> down;
            let size = per_step.unsigned_abs().max(1 << 24);
            let magnitude = (1_u128 << 86) / u128::from(size);
            let per_rate = magnitude * u128::from(period_us) / 1_000_000;
            let timing = PulseTiming { period: 16_800, pulse: 1, setup: 1, hold: 1 };
            let planner = StepPlanner::new(AxisKind::Linear, per_step, timing, period_us);
            prop_assert_eq!(planner.steps_per_unit.unsigned_abs(), magnitude as u64);
            prop_assert_eq!(planner.steps_per_rate.unsigned_abs(), per_rate as u64);
            prop_assert_eq!(planner.steps_per_unit < 0, per_step < 0);
        }
    }

    #[test]
    fn the_smallest_step_has_the_largest_inverse() {
        for (size, quotient) in [
            (1 << 24, 1 << 62),
            (1 << 62, 1 << 24),
            (u64::MAX, (1 << 22)),
        ] {
            assert_eq!(inverse(size), quotient);
        }
    }
}
