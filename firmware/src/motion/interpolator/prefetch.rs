//! The way to the next setpoint, and the one after it.
//!
//! To work out a whole segment takes half as long as all else in a period. So the next one is made in parts while the machine is under way on the present one: its
//! end and its span, then one coordinate after the other ([`Program::prefetch`]). Whatever is missing when it begins is made then; the bits are the same.

use super::{Knot, Program};
use crate::motion::cubic::{Cubic, SegmentDuration};
use crate::motion::segment::SegmentPolynomial;
use haptimill_math::Coordinate;
use haptimill_protocol::message::MAX_AXES;

/// The cubics on the way to a setpoint.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Segment {
    pub(super) polynomials: [SegmentPolynomial; MAX_AXES],
    pub(super) span: SegmentDuration,
    pub(super) to: Knot,
}

/// The present segment and the next one, which take turns in two places: they are large.
#[derive(Debug, Default)]
pub(super) struct Segments {
    pair: [Segment; 2],
    /// The present one has the second place.
    second: bool,
    /// There is a present one.
    begun: bool,
    /// So many parts of the next one are made.
    parts: usize,
    /// From this time into the present one on its end is near.
    near_from: u64,
    /// The machine goes back: what follows the present one is not what waits in the queue.
    back: bool,
}

impl Segments {
    /// None is there, and nothing is made.
    pub(super) const fn clear(&mut self) {
        self.begun = false;
        self.parts = 0;
        self.near_from = 0;
        self.back = false;
    }

    /// The present one.
    #[inline]
    pub(super) fn present(&self) -> Option<&Segment> {
        let [first, second] = &self.pair;
        self.begun
            .then_some(if self.second { second } else { first })
    }

    /// The one that was present last, and the one that is next.
    const fn both(&mut self) -> (&Segment, &mut Segment) {
        let [first, second] = &mut self.pair;
        if self.second {
            (second, first)
        } else {
            (first, second)
        }
    }
}

impl Program {
    /// Makes a part of the next segment, if one is missing and there is time for it: when the period was `held` free for the path ([`Program::is_busy`]), or is `idle`.
    #[inline]
    pub fn prefetch(&mut self, held: bool, idle: impl FnOnce() -> bool) {
        if self.misses_part() && ((held && self.is_pressed()) || idle()) {
            self.make_part();
        }
    }

    #[inline]
    pub(super) fn misses_part(&self) -> bool {
        self.segments.parts <= self.axes && !self.queue.is_empty() && !self.segments.back
    }

    /// Whether a part of the next segment is to be made soon.
    #[inline]
    pub(super) fn is_pressed(&self) -> bool {
        self.is_near_end() && self.misses_part()
    }

    /// Whether the present segment is so near its end that there may be more to do than to follow it.
    #[inline]
    pub(super) const fn is_near_end(&self) -> bool {
        self.time >= self.segments.near_from
    }

    /// Says from when on the end of the present segment is near: two periods before it for each part of the next one that is missing. Where segments are so
    /// short that hearing would suffer from it there is no hurry, and it is the last period; what is missing is made when the next one begins.
    fn look_at_end(&mut self) {
        let parts = self.axes as u64 + 1;
        let missing = parts.saturating_sub(self.segments.parts as u64);
        let from = self.segment().map_or(0, |segment| {
            let periods = u64::from(segment.span.periods());
            let hurries = missing > 0 && periods >= 3 * parts;
            periods.saturating_sub(if hurries { 2 * missing + 2 } else { 1 })
        });
        self.segments.near_from = from << 32;
    }

    /// Makes the next part of the next segment. There is none to a setpoint that could not have been taken.
    #[inline(never)]
    fn make_part(&mut self) -> Option<()> {
        let to = self.queue.front()?;
        let Segments { begun, parts, .. } = self.segments;
        let (before, next) = self.segments.both();
        if let Some(axis) = parts.checked_sub(1) {
            let from = if begun { &before.to } else { &self.from };
            next.join(from, axis, self.rotary[axis])?;
        } else {
            next.begin(to, before, self.period_us)?;
        }
        self.segments.parts = parts + 1;
        self.look_at_end();
        Some(())
    }

    /// The next segment becomes the present one; false if there is none.
    pub(super) fn begin_next(&mut self) -> bool {
        while self.segments.parts <= self.axes {
            if self.make_part().is_none() {
                return false;
            }
        }
        self.queue.pop_front();
        let segments = &mut self.segments;
        segments.second = !segments.second;
        segments.begun = true;
        segments.parts = 0;
        self.look_at_end();
        let segments = &self.segments;
        let periods = segments
            .present()
            .map_or(0, |segment| segment.span.periods());
        self.queued_periods -= u64::from(periods);
        true
    }

    /// The end of the present segment is reached.
    pub(super) fn pass(&mut self) {
        self.remember(self.from);
        if let Some(segment) = self.segments.present() {
            self.from = segment.to;
        }
        self.segments.begun = false;
        self.segments.near_from = 0;
    }

    /// The way from the setpoint reached last to `to` becomes the present segment.
    #[inline(never)]
    pub(super) fn begin_back(&mut self, to: &Knot) {
        self.segments.clear();
        self.segments.back = true;
        let (before, next) = self.segments.both();
        if next.begin(to, before, self.period_us).is_none() {
            return;
        }
        for axis in 0..self.axes {
            if next.join(&self.from, axis, self.rotary[axis]).is_none() {
                return;
            }
        }
        self.segments.second = !self.segments.second;
        self.segments.begun = true;
    }
}

impl Segment {
    /// A segment to a setpoint; most are as long as the one before.
    fn begin(&mut self, to: &Knot, before: &Self, period_us: u16) -> Option<()> {
        self.to = *to;
        self.span = if before.span.periods() == to.periods && to.periods != 0 {
            before.span
        } else {
            SegmentDuration::new(to.periods, period_us)?
        };
        Some(())
    }

    /// The way of one axis to the end of the segment.
    fn join(&mut self, from: &Knot, axis: usize, wrap: bool) -> Option<()> {
        let (start, rate) = (Coordinate(from.pose[axis]), from.rates[axis]);
        let (end, end_rate) = (Coordinate(self.to.pose[axis]), self.to.rates[axis]);
        let cubic = Cubic::new(start, rate, end, end_rate, &self.span, wrap)?;
        self.polynomials[axis].set(&cubic, &self.span);
        Some(())
    }
}
