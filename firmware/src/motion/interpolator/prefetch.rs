//! Segment prefetch: preparation of the next segment before the present one ends.
//!
//! A whole segment takes half as much computation as the rest of a control period. The next segment
//! is therefore prepared in parts while the present one is interpolated: first its end and
//! duration, then one coordinate at a time ([`Interpolator::prefetch`]). Parts that are missing
//! when the segment begins are prepared then, with the same result to the bit.

use super::{Interpolator, Knot};
use crate::motion::cubic::{Cubic, SegmentDuration};
use crate::motion::segment::SegmentPolynomial;
use haptimill_math::Coordinate;
use haptimill_protocol::message::MAX_AXES;

/// Segment polynomials up to a setpoint.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Segment {
    pub(super) polynomials: [SegmentPolynomial; MAX_AXES],
    pub(super) duration: SegmentDuration,
    pub(super) to: Knot,
}

/// The present segment and the next one. They alternate between two buffers, because they are
/// large.
#[derive(Debug, Default)]
pub(super) struct Segments {
    pair: [Segment; 2],
    /// The present segment is in the second buffer.
    second: bool,
    /// A present segment exists.
    begun: bool,
    /// Number of prepared parts of the next segment.
    parts: usize,
    /// Time in the present segment from which its end is near, 2^-32 control periods.
    end_near_from: u64,
    /// The machine retracts: the next segment is not at the front of the queue.
    reverse: bool,
}

impl Segments {
    /// Discards both segments.
    pub(super) const fn clear(&mut self) {
        self.begun = false;
        self.parts = 0;
        self.end_near_from = 0;
        self.reverse = false;
    }

    /// The present segment.
    #[inline]
    pub(super) fn present(&self) -> Option<&Segment> {
        let [first, second] = &self.pair;
        self.begun
            .then_some(if self.second { second } else { first })
    }

    /// The segment that was present last, and the next one.
    const fn last_and_next(&mut self) -> (&Segment, &mut Segment) {
        let [first, second] = &mut self.pair;
        if self.second {
            (second, first)
        } else {
            (first, second)
        }
    }
}

impl Interpolator {
    /// Prepares one part of the next segment if one is missing and there is time for it: the
    /// control period is `reserved` for interpolation ([`Interpolator::is_busy`]), or is `idle`.
    #[inline]
    pub fn prefetch(&mut self, reserved: bool, idle: impl FnOnce() -> bool) {
        if self.is_part_missing() && ((reserved && self.is_part_due()) || idle()) {
            self.prepare_part();
        }
    }

    #[inline]
    pub(super) fn is_part_missing(&self) -> bool {
        self.segments.parts <= self.axes && !self.queue.is_empty() && !self.segments.reverse
    }

    /// Whether a part of the next segment is due soon.
    #[inline]
    pub(super) fn is_part_due(&self) -> bool {
        self.is_near_end() && self.is_part_missing()
    }

    /// Whether the end of the present segment is so near that more than interpolation may be due.
    #[inline]
    pub(super) const fn is_near_end(&self) -> bool {
        self.time >= self.segments.end_near_from
    }

    /// Sets the time from which the end of the present segment is near: two control periods for
    /// each missing part of the next segment. Short segments would delay reception, so for them it
    /// is the last period; missing parts are then prepared when the next segment begins.
    fn update_end_near(&mut self) {
        let parts = self.axes as u64 + 1;
        let missing = parts.saturating_sub(self.segments.parts as u64);
        let from = self.segment().map_or(0, |segment| {
            let periods = u64::from(segment.duration.periods());
            let spread = missing > 0 && periods >= 3 * parts;
            periods.saturating_sub(if spread { 2 * missing + 2 } else { 1 })
        });
        self.segments.end_near_from = from << 32;
    }

    /// Prepares the next part of the next segment. `None` if the queue is empty, or for a setpoint
    /// that would have been refused.
    #[inline(never)]
    fn prepare_part(&mut self) -> Option<()> {
        let to = self.queue.front()?;
        let Segments { begun, parts, .. } = self.segments;
        let (before, next) = self.segments.last_and_next();
        if let Some(axis) = parts.checked_sub(1) {
            let from = if begun { &before.to } else { &self.from };
            next.set_axis(from, axis, self.circular[axis])?;
        } else {
            next.begin(to, before, self.period_us)?;
        }
        self.segments.parts = parts + 1;
        self.update_end_near();
        Some(())
    }

    /// Makes the next segment the present one; false if there is none.
    pub(super) fn begin_next(&mut self) -> bool {
        while self.segments.parts <= self.axes {
            if self.prepare_part().is_none() {
                return false;
            }
        }
        self.queue.pop_front();
        let segments = &mut self.segments;
        segments.second = !segments.second;
        segments.begun = true;
        segments.parts = 0;
        self.update_end_near();
        let segments = &self.segments;
        let periods = segments
            .present()
            .map_or(0, |segment| segment.duration.periods());
        self.queued_periods -= u64::from(periods);
        true
    }

    /// Ends the present segment at its setpoint.
    pub(super) fn end_segment(&mut self) {
        self.store_passed(self.from);
        if let Some(segment) = self.segments.present() {
            self.from = segment.to;
        }
        self.segments.begun = false;
        self.segments.end_near_from = 0;
    }

    /// Makes the path from the setpoint reached last to `to` the present segment.
    #[inline(never)]
    pub(super) fn begin_retract(&mut self, to: &Knot) {
        self.segments.clear();
        self.segments.reverse = true;
        let (before, next) = self.segments.last_and_next();
        if next.begin(to, before, self.period_us).is_none() {
            return;
        }
        for axis in 0..self.axes {
            if next
                .set_axis(&self.from, axis, self.circular[axis])
                .is_none()
            {
                return;
            }
        }
        self.segments.second = !self.segments.second;
        self.segments.begun = true;
    }
}

impl Segment {
    /// Sets end and duration of a segment. Most segments last as long as the one before.
    fn begin(&mut self, to: &Knot, before: &Self, period_us: u16) -> Option<()> {
        self.to = *to;
        self.duration = if before.duration.periods() == to.periods && to.periods != 0 {
            before.duration
        } else {
            SegmentDuration::new(to.periods, period_us)?
        };
        Some(())
    }

    /// Sets the polynomial of one axis.
    fn set_axis(&mut self, from: &Knot, axis: usize, wrap: bool) -> Option<()> {
        let (start, rate) = (Coordinate(from.pose[axis]), from.rates[axis]);
        let (end, end_rate) = (Coordinate(self.to.pose[axis]), self.to.rates[axis]);
        let cubic = Cubic::new(start, rate, end, end_rate, &self.duration, wrap)?;
        self.polynomials[axis].set(&cubic, &self.duration);
        Some(())
    }
}
