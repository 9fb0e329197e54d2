//! Stopping envelope of a program: the bounds of its coordinates up to standstill on its path.

use super::{Interpolator, Ramp};
use crate::motion::envelope::StoppingEnvelope;
use crate::motion::segment;
use haptimill_protocol::message::{Action, RATE_SHIFT};

impl Interpolator {
    /// The stopping envelope of the program's coordinates, if it continues for one period and
    /// decelerates along its path then.
    ///
    /// A cubic stays within the hull of its control points: its ends, and the points that its end
    /// rates reach in a third of its duration. The present segment counts from the present time on,
    /// those in the queue as a whole. The cost is proportional to the number of setpoints within
    /// the stopping distance.
    #[must_use]
    pub fn envelope(&self) -> StoppingEnvelope {
        let commanded = self.commanded().pose;
        let mut envelope = StoppingEnvelope::at(&commanded).with_wrapping(self.wrapping);
        let Some(braking) = self.braking.filter(|_| !self.paused) else {
            return envelope;
        };
        let mut rate = if self.started {
            self.speed_factor
        } else {
            Ramp::at(self.override_factor)
        };
        let next = rate.advance(self.override_factor, &braking).max(0) as u64;
        // Upper bound of the speed factor up to standstill, 2^-16.
        let factor = rate.peak(&braking).max(self.speed_factor.value()) >> 16;
        let stopping = rate.stopping_range(&braking);
        let mut ahead =
            next.saturating_add(stopping.map_or(u64::MAX, |(_, far)| far.unsigned_abs()));
        let mut from = self.from;
        if let Some(segment) = self.segment() {
            let left = (u64::from(segment.duration.periods()) << 32).saturating_sub(self.time);
            let time = self.time + left.min(ahead);
            let microseconds = ((left.min(ahead) >> 16) as i64 * i64::from(self.period_us)) >> 16;
            let third = third(microseconds);
            let half = |time: u64| segment::half(segment.duration.fraction((time >> 16) as u32));
            for axis in 0..self.axes {
                if segment.polynomials[axis].is_at_standstill() {
                    continue;
                }
                let [begin, end] =
                    [self.time, time].map(|time| segment.polynomials[axis].sample(half(time)));
                self.extend_by_hull(
                    &mut envelope,
                    axis,
                    [begin.position.0, end.position.0],
                    [begin.rate.0, end.rate.0].map(i64::from),
                    (third, factor),
                );
            }
            ahead = ahead.saturating_sub(left);
            from = segment.to;
        }
        for knot in &self.queue {
            if ahead == 0 || matches!(from.action, Action::Pause) {
                break;
            }
            let microseconds = i64::from(knot.periods) * i64::from(self.period_us);
            let third = third(microseconds);
            for axis in 0..self.axes {
                if from.is_still(knot, axis) {
                    continue;
                }
                self.extend_by_hull(
                    &mut envelope,
                    axis,
                    [from.pose[axis], knot.pose[axis]],
                    [from.rates[axis], knot.rates[axis]].map(|rate| i64::from(rate) << RATE_SHIFT),
                    (third, factor),
                );
            }
            ahead = ahead.saturating_sub(u64::from(knot.periods) << 32);
            from = *knot;
        }
        envelope
    }

    /// Adds the control points of one axis between two positions. The rates are in axis units per
    /// second (below 2^32), `third` is a [`third`] of the time, and `factor` is the largest speed
    /// factor in it. The rates of the box are those at its ends.
    fn extend_by_hull(
        &self,
        envelope: &mut StoppingEnvelope,
        axis: usize,
        [from, to]: [i32; 2],
        rates: [i64; 2],
        (third, factor): (i64, i64),
    ) {
        for rate in rates {
            envelope.extend_rate(axis, (rate * factor) >> 16);
        }
        let distance = self.distance(axis, from, to);
        let [first, second] = rates.map(|rate| (rate * third) >> 22);
        let points = [first, distance - second, distance];
        let low = points.iter().fold(0, |low, point| low.min(*point));
        let high = points.iter().fold(0, |high, point| high.max(*point));
        envelope.reach_from(axis, from, low, high);
    }
}

/// A third of a time below 2^26 us, in 2^-22 s: below 2^27.
fn third(microseconds: i64) -> i64 {
    (microseconds << 22) / 3_000_000
}
