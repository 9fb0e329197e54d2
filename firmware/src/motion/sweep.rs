//! The box that the pose sweeps before it can be at rest.
//!
//! Whoever moves the machine by hand, or beside its program, must be able to stop it before a bound. Coordinates come to rest at different times, so the
//! way to rest is not known as a line but as a box: each coordinate stays between two values. If the machine can take the corners of the box, going on
//! for one more period is safe; if not, braking now is, because the box of the period before was.
//!
//! Joint rates are bounded in the same way: near a bound of the workspace, and near a singularity, a joint moves many times as fast as the tool, and the tool
//! cannot brake as fast as that factor grows. [`Sweep::rates`] are the largest rates of the coordinates on the way to rest. If no joint exceeds its maximum rate with
//! these rates at any corner ([`Sweep::load`]), none does on the way: braking neither leaves the box nor raises a rate.

use crate::kinematics::{Kinematics, Pose, Rates};
use crate::units::scale::saturate;
use crate::units::{Coordinate, Rate};
use haptimill_protocol::message::MAX_AXES;

/// Between which values each coordinate stays.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sweep {
    /// The least.
    pub low: Pose,
    /// The greatest.
    pub high: Pose,
    /// Largest magnitudes of the rates.
    pub rates: Rates,
}

/// A load at which a joint is commanded its maximum rate.
pub const FULL_LOAD: u32 = 1 << 16;

/// The largest load of a motion that is not planned: less than full by 1/128, because a box is bounded by its corners alone. Between them the
/// joint rates of a box of some degrees are larger by up to 0.3 % of the maximum.
pub const MOST_LOAD: u32 = FULL_LOAD - FULL_LOAD / 128;

impl Sweep {
    /// Nothing moves.
    #[must_use]
    pub const fn at(pose: &Pose) -> Self {
        Self {
            low: *pose,
            high: *pose,
            rates: [Rate::ZERO; MAX_AXES],
        }
    }

    /// A coordinate may also have a rate of this magnitude.
    pub fn quicken(&mut self, axis: usize, rate: i64) {
        let rate = Rate(saturate(rate.abs()));
        self.rates[axis] = self.rates[axis].max(rate);
    }

    /// The box moves by an offset of some coordinates, which changes at these rates.
    pub fn displace(&mut self, excursion: &Excursion) {
        for (axis, (by, rate)) in excursion.iter().enumerate() {
            let moved = |value: Coordinate| Coordinate(value.0.saturating_add(*by));
            self.low.0[axis] = moved(self.low.0[axis]);
            self.high.0[axis] = moved(self.high.0[axis]);
            self.rates[axis] =
                self.rates[axis].saturating_add(Rate(saturate(i64::from(rate.0).abs())));
        }
    }

    /// A coordinate may also come to this value; one beyond the range of a [`Coordinate`] counts as its end.
    pub fn reach(&mut self, axis: usize, value: i64) {
        let value = Coordinate(value.clamp(i64::from(-i32::MAX), i64::from(i32::MAX)) as i32);
        self.low.0[axis] = self.low.0[axis].min(value);
        self.high.0[axis] = self.high.0[axis].max(value);
    }

    /// A coordinate's part of the box becomes that of `other`, moved by `offset`.
    pub fn take(&mut self, axis: usize, other: &Self, offset: i32) {
        let moved = |value: Coordinate| Coordinate(value.0.saturating_add(offset));
        self.low.0[axis] = moved(other.low.0[axis]);
        self.high.0[axis] = moved(other.high.0[axis]);
        self.rates[axis] = other.rates[axis];
    }

    /// Whether this box is within another.
    #[must_use]
    pub fn is_within(&self, other: &Self, axes: usize) -> bool {
        (0..axes.min(MAX_AXES)).all(|axis| {
            self.low.0[axis] >= other.low.0[axis]
                && self.high.0[axis] <= other.high.0[axis]
                && self.rates[axis] <= other.rates[axis]
        })
    }

    /// The box with so much more room for each coordinate that moves, either way; and for those that may, a bit each.
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

    /// Whether the machine can take the corners of the box: all of them for up to three moving coordinates, the low and the high one and those next
    /// to them for more (the pose of every period is checked besides).
    pub fn is_reachable(&self, axes: usize, machine: &impl Kinematics) -> bool {
        self.load(&[], axes, machine).is_some()
    }

    /// The largest part of its maximum rate that a joint reaches at these corners, for each of `rates` ([`Kinematics::load`]); `None` if the machine cannot take one of them.
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

    /// The coordinates that move: a bit each.
    fn moving(&self, axes: usize) -> u32 {
        let moves = |axis: &usize| self.low.0[*axis] != self.high.0[*axis];
        (0..axes.min(MAX_AXES))
            .filter(moves)
            .fold(0, |moving, axis| moving | 1 << axis)
    }

    /// The loads at a corner, if the machine can take it; one that is not looked at has none.
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

/// From this load on what follows a hand goes no faster.
pub const SLOWED_LOAD: u32 = FULL_LOAD - FULL_LOAD / 8;

/// An offset of some coordinates, and its rates.
pub type Excursion = [(i32, Rate); 3];

/// Periods between two attempts at a wider box where there was none.
const PATIENCE: u8 = 64;

/// What is known of the reach around the machine: a box that is reachable, with room. A sweep in it needs no look at its own corners, and the next box is looked
/// at in time, a corner a period, so that a period in which a hand leads takes one pose more and not eight.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Reach {
    known: Option<(Sweep, u32)>,
    /// The next one, its load so far, and the corner that is looked at next.
    next: Option<(Sweep, u32, u32)>,
    patience: u8,
}

impl Reach {
    /// The load of a sweep, or a little more; `None` if the machine cannot take it: see [`Sweep::load`]. `room`: how much wider a box is made, `may`: the coordinates that
    /// may move from now on, a bit each. Call it once a period.
    pub fn holds(
        &mut self,
        sweep: &Sweep,
        (room, may): (&[i32; MAX_AXES], u8),
        axes: usize,
        machine: &impl Kinematics,
    ) -> Option<u32> {
        self.look_ahead(sweep, (room, may), axes, machine);
        match &self.known {
            Some((known, load)) if sweep.is_within(known, axes) => Some(*load),
            _ => Some(sweep.load(&[sweep.rates], axes, machine)?[0]),
        }
    }

    /// Looks at one corner of the next box.
    fn look_ahead(
        &mut self,
        sweep: &Sweep,
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
                // What is near its maximum is looked at as it is, and not with room.
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
