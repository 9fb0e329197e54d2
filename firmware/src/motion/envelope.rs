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
//! ([`StoppingEnvelope::load`]), none does on the path: deceleration neither leaves the box nor
//! raises a rate.
//!
//! Units: axis units, axis units per second; a load of [`FULL_LOAD`] is the maximum rate of a
//! joint.

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
}

/// Load at which a joint is commanded its maximum rate.
pub const FULL_LOAD: u32 = 1 << 16;

/// Largest load of an unplanned motion. It is less than full by 1/128, because only the corners of
/// a box are checked. Between them the joint rates of a box of some degrees are larger by up to 0.3
/// % of the maximum.
pub const MOST_LOAD: u32 = FULL_LOAD - FULL_LOAD / 128;

impl StoppingEnvelope {
    /// Creates the envelope of a pose at standstill.
    #[must_use]
    pub const fn at(pose: &Pose) -> Self {
        Self {
            low: *pose,
            high: *pose,
            rates: [Rate::ZERO; MAX_AXES],
        }
    }

    /// Extends the rate bound of a coordinate to a rate, axis units per second.
    pub fn quicken(&mut self, axis: usize, rate: i64) {
        let rate = Rate(saturate(rate.abs()));
        self.rates[axis] = self.rates[axis].max(rate);
    }

    /// Shifts the box by an offset of some coordinates, and adds the rates of the offset.
    pub fn displace(&mut self, excursion: &Excursion) {
        for (axis, (by, rate)) in excursion.iter().enumerate() {
            let moved = |value: Coordinate| Coordinate(value.0.saturating_add(*by));
            self.low.0[axis] = moved(self.low.0[axis]);
            self.high.0[axis] = moved(self.high.0[axis]);
            self.rates[axis] =
                self.rates[axis].saturating_add(Rate(saturate(i64::from(rate.0).abs())));
        }
    }

    /// Extends the box to a value of a coordinate; values beyond the range of a [`Coordinate`] are
    /// clamped.
    pub fn reach(&mut self, axis: usize, value: i64) {
        let value = Coordinate(value.clamp(i64::from(-i32::MAX), i64::from(i32::MAX)) as i32);
        self.low.0[axis] = self.low.0[axis].min(value);
        self.high.0[axis] = self.high.0[axis].max(value);
    }

    /// Takes over the bounds of a coordinate from `other`, shifted by `offset`.
    pub fn take(&mut self, axis: usize, other: &Self, offset: i32) {
        let moved = |value: Coordinate| Coordinate(value.0.saturating_add(offset));
        self.low.0[axis] = moved(other.low.0[axis]);
        self.high.0[axis] = moved(other.high.0[axis]);
        self.rates[axis] = other.rates[axis];
    }

    /// Whether this box lies within another, in its first `axes` coordinates.
    #[must_use]
    pub fn is_within(&self, other: &Self, axes: usize) -> bool {
        (0..axes.min(MAX_AXES)).all(|axis| {
            self.low.0[axis] >= other.low.0[axis]
                && self.high.0[axis] <= other.high.0[axis]
                && self.rates[axis] <= other.rates[axis]
        })
    }

    /// The box with `room` added on both sides of each coordinate that moves, and of each
    /// coordinate in `may`, one bit each.
    #[must_use]
    fn with_room(&self, room: &[i32; MAX_AXES], may: u8) -> Self {
        let mut wide = *self;
        for (axis, room) in room.iter().enumerate() {
            let (low, high) = (self.low.0[axis].0, self.high.0[axis].0);
            if low != high || may & (1 << axis) != 0 {
                wide.reach(axis, i64::from(low) - i64::from(*room));
                wide.reach(axis, i64::from(high) + i64::from(*room));
                wide.quicken(axis, i64::from(self.rates[axis].0) + 2 * i64::from(*room));
            }
        }
        wide
    }

    /// Whether the machine can reach the corners of the box. With up to three moving coordinates
    /// all corners are checked; with more, the low and the high corner and their neighbours. The
    /// pose of every control period is checked as well.
    pub fn is_reachable(&self, axes: usize, machine: &impl Kinematics) -> bool {
        self.load(&[], axes, machine).is_some()
    }

    /// Largest part of its maximum rate that a joint reaches at these corners, for each of `rates`
    /// ([`Kinematics::load`]); `None` if the machine cannot reach one of them.
    pub fn load(
        &self,
        rates: &[Rates],
        axes: usize,
        machine: &impl Kinematics,
    ) -> Option<[u32; 2]> {
        let moving = self.moving(axes);
        let mut most = [0; 2];
        for corner in 0..1 << moving.count_ones() {
            let loads = self.takes(corner, moving, rates, machine)?;
            most = [most[0].max(loads[0]), most[1].max(loads[1])];
        }
        Some(most)
    }

    /// Coordinates that move, one bit each.
    fn moving(&self, axes: usize) -> u32 {
        let moves = |axis: &usize| self.low.0[*axis] != self.high.0[*axis];
        (0..axes.min(MAX_AXES))
            .filter(moves)
            .fold(0, |moving, axis| moving | 1 << axis)
    }

    /// Loads at a corner, if the machine can reach it; a skipped corner has load 0.
    fn takes(
        &self,
        corner: u32,
        moving: u32,
        rates: &[Rates],
        machine: &impl Kinematics,
    ) -> Option<[u32; 2]> {
        let count = moving.count_ones();
        let ones = corner.count_ones();
        if count > 3 && ones > 1 && ones + 1 < count {
            return Some([0; 2]);
        }
        let mut pose = self.low;
        let mut left = corner;
        for (axis, place) in pose.0.iter_mut().enumerate() {
            if moving & (1 << axis) != 0 {
                if left & 1 != 0 {
                    *place = self.high.0[axis];
                }
                left >>= 1;
            }
        }
        machine.load(&pose, rates).ok()
    }
}

/// Load above which the rate of a tracker no longer rises.
pub const SLOWED_LOAD: u32 = FULL_LOAD - FULL_LOAD / 8;

/// Offset of up to three coordinates, and its rates.
pub type Excursion = [(i32, Rate); 3];

/// Control periods between two attempts at a wider box after a failed one.
const PATIENCE: u8 = 64;

/// A box around the machine that is known to be reachable, with a margin. A stopping envelope
/// within it needs no check of its own corners. The next box is checked ahead, one corner per
/// control period, so a period with a master solves one additional pose instead of eight.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ReachableBox {
    known: Option<(StoppingEnvelope, u32)>,
    /// Next box, its load so far, and the next corner to check.
    next: Option<(StoppingEnvelope, u32, u32)>,
    patience: u8,
}

impl ReachableBox {
    /// Upper bound of the load of a stopping envelope; `None` if the machine cannot reach it: see
    /// [`StoppingEnvelope::load`]. `room` is the margin of a box, `may` the coordinates that may
    /// move from now on, one bit each. Callers must call it once per control period.
    pub fn holds(
        &mut self,
        sweep: &StoppingEnvelope,
        (room, may): (&[i32; MAX_AXES], u8),
        axes: usize,
        machine: &impl Kinematics,
    ) -> Option<u32> {
        self.prefetch(sweep, (room, may), axes, machine);
        match &self.known {
            Some((known, load)) if sweep.is_within(known, axes) => Some(*load),
            _ => Some(sweep.load(&[sweep.rates], axes, machine)?[0]),
        }
    }

    /// Checks one corner of the next box.
    fn prefetch(
        &mut self,
        sweep: &StoppingEnvelope,
        (room, may): (&[i32; MAX_AXES], u8),
        axes: usize,
        machine: &impl Kinematics,
    ) {
        self.patience = self.patience.saturating_sub(1);
        match self.next {
            Some((next, load, corner)) if sweep.is_within(&next, axes) => {
                let moving = next.moving(axes);
                let loads = next.takes(corner, moving, &[next.rates], machine);
                let load = loads.map_or(FULL_LOAD, |loads| loads[0].max(load));
                // A load near the maximum is checked without a margin.
                if load > SLOWED_LOAD {
                    self.next = None;
                    self.patience = PATIENCE;
                } else if corner + 1 < 1 << moving.count_ones() {
                    self.next = Some((next, load, corner + 1));
                } else {
                    self.next = None;
                    self.known = Some((next, load));
                }
            }
            _ => {
                let half = room.map(|room| room / 2);
                let near = sweep.with_room(&half, may);
                let enough = self
                    .known
                    .as_ref()
                    .is_some_and(|(known, _)| near.is_within(known, axes));
                self.next =
                    (!enough && self.patience == 0).then(|| (sweep.with_room(room, may), 0, 0));
            }
        }
    }
}
