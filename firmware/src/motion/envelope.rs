//! Stopping envelope: the box that bounds the pose up to standstill.
//!
//! A source other than the program must be able to stop the machine before a bound. Coordinates
//! come to standstill at different times, so the path to standstill is unknown, and the bounds of
//! each coordinate form a box. If the machine can reach the corners of the box, one more period of
//! motion is safe. If not, decelerating now is safe, because the box of the period before was
//! reachable.
//!
//! Joint rates are bounded in the same way. Near a bound of the workspace and near a singularity a
//! joint moves many times as fast as the tool, and the tool cannot decelerate as fast as that
//! factor grows. [`StoppingEnvelope::rates`] are the largest rates of the coordinates up to
//! standstill. If no joint exceeds its maximum rate with these rates at any corner
//! ([`StoppingEnvelope::rate_utilisation`]), none does on the path: deceleration neither leaves the
//! box nor raises a rate.
//!
//! Units: axis units, axis units per second; a rate utilisation of [`FULL_UTILISATION`] is the
//! maximum rate of a joint.

use haptimill_kinematics::{Kinematics, Pose, Rates};
use haptimill_math::scale::saturate;
use haptimill_math::{Coordinate, Rate};
use haptimill_protocol::message::MAX_AXES;

/// Axis-aligned bounds of all positions up to standstill.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StoppingEnvelope {
    /// Lower bounds.
    pub low: Pose,
    /// Upper bounds.
    pub high: Pose,
    /// Largest magnitudes of the rates, axis units per second.
    pub rates: Rates,
    /// Coordinates that wrap around, one bit each: their bounds are an arc from low upwards to
    /// high.
    pub wrapping: u8,
}

/// Rate utilisation at which a joint is commanded its maximum rate.
pub const FULL_UTILISATION: u32 = 1 << 16;

/// Maximum rate utilisation of an unplanned motion. It is less than full by 1/128, because only the
/// corners of a box are checked. Between them the joint rates of a box of some degrees are larger
/// by up to 0.3 % of the maximum.
pub const MAX_UTILISATION: u32 = FULL_UTILISATION - FULL_UTILISATION / 128;

impl StoppingEnvelope {
    /// Creates the envelope of a pose at standstill.
    #[must_use]
    pub const fn at(pose: &Pose) -> Self {
        Self {
            low: *pose,
            high: *pose,
            rates: [Rate::ZERO; MAX_AXES],
            wrapping: 0,
        }
    }

    /// The envelope with these coordinates wrapping around, one bit each.
    #[must_use]
    pub const fn with_wrapping(self, wrapping: u8) -> Self {
        Self { wrapping, ..self }
    }

    #[inline]
    const fn wraps(&self, axis: usize) -> bool {
        self.wrapping >> axis & 1 != 0
    }

    /// Length of the arc of a coordinate that wraps around, axis units.
    #[inline]
    fn arc(&self, axis: usize) -> u32 {
        self.high.0[axis].wrapping_sub(self.low.0[axis]).0 as u32
    }

    /// Extends the rate bound of a coordinate to a rate, axis units per second.
    pub fn extend_rate(&mut self, axis: usize, rate: i64) {
        let rate = Rate(saturate(rate.abs()));
        self.rates[axis] = self.rates[axis].max(rate);
    }

    /// Shifts the box by an offset of some coordinates, and adds the rates of the offset.
    pub fn displace(&mut self, displacement: &Displacements) {
        for (axis, (by, rate)) in displacement.iter().enumerate() {
            let moved = |value: Coordinate| Coordinate(value.0.saturating_add(*by));
            self.low.0[axis] = moved(self.low.0[axis]);
            self.high.0[axis] = moved(self.high.0[axis]);
            self.rates[axis] =
                self.rates[axis].saturating_add(Rate(saturate(i64::from(rate.0).abs())));
        }
    }

    /// Extends the box by the motion of a coordinate from a place in the box, `low` below it to
    /// `high` above it.
    pub fn reach_from(&mut self, axis: usize, from: i32, low: i64, high: i64) {
        if !self.wraps(axis) {
            self.reach(axis, i64::from(from) + low);
            self.reach(axis, i64::from(from) + high);
            return;
        }
        // Both parts of the arc that is known, from here.
        let below = i64::from(from.wrapping_sub(self.low.0[axis].0) as u32).max(-low);
        let above = i64::from(self.high.0[axis].0.wrapping_sub(from) as u32).max(high);
        let (low, high) = if below + above < i64::from(u32::MAX) {
            let end = |by: i64| from.wrapping_add(by as i32);
            (end(-below), end(above))
        } else {
            (i32::MIN, i32::MAX)
        };
        self.low.0[axis] = Coordinate(low);
        self.high.0[axis] = Coordinate(high);
    }

    /// Extends the box to a value of a coordinate. Values beyond the range of a [`Coordinate`] are
    /// clamped; a coordinate that wraps around takes the shorter way from its lower bound.
    pub fn reach(&mut self, axis: usize, value: i64) {
        if self.wraps(axis) {
            let from = self.low.0[axis].0;
            let by = i64::from((value as i32).wrapping_sub(from));
            return self.reach_from(axis, from, by.min(0), by.max(0));
        }
        let value = Coordinate(value.clamp(i64::from(-i32::MAX), i64::from(i32::MAX)) as i32);
        self.low.0[axis] = self.low.0[axis].min(value);
        self.high.0[axis] = self.high.0[axis].max(value);
    }

    /// Takes over the bounds of a coordinate from `other`, shifted by `offset`.
    pub fn take(&mut self, axis: usize, other: &Self, offset: i32) {
        let wraps = self.wraps(axis);
        let moved = |value: Coordinate| {
            Coordinate(if wraps {
                value.0.wrapping_add(offset)
            } else {
                value.0.saturating_add(offset)
            })
        };
        self.low.0[axis] = moved(other.low.0[axis]);
        self.high.0[axis] = moved(other.high.0[axis]);
        self.rates[axis] = other.rates[axis];
    }

    /// Whether this box lies within another, in its first `axes` coordinates.
    #[must_use]
    pub fn is_within(&self, other: &Self, axes: usize) -> bool {
        (0..axes.min(MAX_AXES)).all(|axis| {
            let inside = if self.wraps(axis) {
                let ahead = self.low.0[axis].wrapping_sub(other.low.0[axis]).0 as u32;
                u64::from(ahead) + u64::from(self.arc(axis)) <= u64::from(other.arc(axis))
            } else {
                self.low.0[axis] >= other.low.0[axis] && self.high.0[axis] <= other.high.0[axis]
            };
            inside && self.rates[axis] <= other.rates[axis]
        })
    }

    /// The box with `margins` added on both sides of each coordinate that moves, and of each
    /// coordinate in `may`, one bit each.
    #[must_use]
    fn with_margins(&self, margins: &[i32; MAX_AXES], may: u8) -> Self {
        let mut wide = *self;
        for (axis, margins) in margins.iter().enumerate() {
            let (low, high) = (self.low.0[axis].0, self.high.0[axis].0);
            if low != high || may & (1 << axis) != 0 {
                let margin = i64::from(*margins);
                wide.reach_from(axis, low, -margin, 0);
                wide.reach_from(axis, high, 0, margin);
                wide.extend_rate(
                    axis,
                    i64::from(self.rates[axis].0) + 2 * i64::from(*margins),
                );
            }
        }
        wide
    }

    /// Whether the machine can take the poses of the box.
    pub fn is_reachable(&self, machine: &impl Kinematics) -> bool {
        self.rate_utilisation(&[], machine).is_some()
    }

    /// The largest part of its maximum rate that a joint reaches in the box, for each of `rates`
    /// ([`Kinematics::rate_utilisation`]); `None` if the machine cannot take a pose of it.
    pub fn rate_utilisation(&self, rates: &[Rates], machine: &impl Kinematics) -> Option<[u32; 2]> {
        machine.rate_utilisation(&self.low, &self.high, rates).ok()
    }
}

/// Rate utilisation above which the rate of a tracker no longer rises.
pub const SLOWED_UTILISATION: u32 = FULL_UTILISATION - FULL_UTILISATION / 8;

/// Offset of up to three coordinates, and its rates.
pub type Displacements = [(i32, Rate); 3];

/// Control periods between two attempts at a wider box after a failed one.
const RETRY_PERIODS: u8 = 64;

/// The last box that was checked and found reachable, with margins. A stopping envelope within it
/// needs no check.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ReachableBox {
    known: Option<(StoppingEnvelope, u32)>,
    retry_in: u8,
}

impl ReachableBox {
    /// Upper bound of the rate utilisation of a stopping envelope; `None` if the machine cannot
    /// reach it: see [`StoppingEnvelope::rate_utilisation`]. `margins` is the margin of a box,
    /// `may` the coordinates that may move from now on, one bit each. Callers must call it once per
    /// control period.
    pub fn utilisation_bound(
        &mut self,
        envelope: &StoppingEnvelope,
        (margins, may): (&[i32; MAX_AXES], u8),
        axes: usize,
        machine: &impl Kinematics,
    ) -> Option<u32> {
        if let Some((known, utilisation)) = &self.known
            && envelope.is_within(known, axes)
        {
            return Some(*utilisation);
        }
        self.retry_in = self.retry_in.saturating_sub(1);
        if self.retry_in == 0 {
            let wide = envelope.with_margins(margins, may);
            let utilisation = wide
                .rate_utilisation(&[wide.rates], machine)
                .map(|utilisations| utilisations[0]);
            // Near the maximum rate utilisation the envelope is checked without margins.
            if let Some(utilisation) =
                utilisation.filter(|utilisation| *utilisation <= SLOWED_UTILISATION)
            {
                self.known = Some((wide, utilisation));
                return Some(utilisation);
            }
            self.retry_in = RETRY_PERIODS;
        }
        Some(envelope.rate_utilisation(&[envelope.rates], machine)?[0])
    }
}
