//! The box that the pose sweeps before it can be at rest.
//!
//! Whoever moves the machine by hand, or beside its program, must be able to stop it before a bound. Coordinates come to rest at different times, so the
//! way to rest is not known as a line but as a box: each coordinate stays between two values. If the machine can take the corners of the box, going on
//! for one more period is safe; if not, braking now is, because the box of the period before was.

use haptimill_kinematics::{Kinematics, Pose};
use haptimill_math::Coordinate;
use haptimill_protocol::message::MAX_AXES;

/// Between which values each coordinate stays.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sweep {
    /// The least.
    pub low: Pose,
    /// The greatest.
    pub high: Pose,
}

impl Sweep {
    /// Nothing moves.
    #[must_use]
    pub const fn at(pose: &Pose) -> Self {
        Self {
            low: *pose,
            high: *pose,
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
    }

    /// Whether this box is within another.
    #[must_use]
    pub fn is_within(&self, other: &Self, axes: usize) -> bool {
        (0..axes.min(MAX_AXES)).all(|axis| {
            self.low.0[axis] >= other.low.0[axis] && self.high.0[axis] <= other.high.0[axis]
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
            }
        }
        wide
    }

    /// Whether the machine can take the corners of the box: all of them for up to three moving coordinates, the low and the high one and those next
    /// to them for more (the pose of every period is checked besides).
    pub fn is_reachable(&self, axes: usize, machine: &impl Kinematics) -> bool {
        let moving = self.moving(axes);
        (0..1 << moving.count_ones()).all(|corner| self.takes(corner, moving, machine))
    }

    /// The coordinates that move: a bit each.
    fn moving(&self, axes: usize) -> u32 {
        let moves = |axis: &usize| self.low.0[*axis] != self.high.0[*axis];
        (0..axes.min(MAX_AXES))
            .filter(moves)
            .fold(0, |moving, axis| moving | 1 << axis)
    }

    /// Whether the machine can take a corner; one that is not looked at counts as one that it can.
    fn takes(&self, corner: u32, moving: u32, machine: &impl Kinematics) -> bool {
        let count = moving.count_ones();
        let ones = corner.count_ones();
        if count > 3 && ones > 1 && ones + 1 < count {
            return true;
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
        machine.inverse(&pose).is_ok()
    }
}

/// Periods between two attempts at a wider box where there was none.
const PATIENCE: u8 = 64;

/// What is known of the reach around the machine: a box that is reachable, with room. A sweep in it needs no look at its own corners, and the next box is looked
/// at in time, a corner a period, so that a period in which a hand leads takes one pose more and not eight.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Reach {
    known: Option<Sweep>,
    /// The next one, and the corner that is looked at next.
    next: Option<(Sweep, u32)>,
    patience: u8,
}

impl Reach {
    /// Whether the machine can take a sweep: see [`Sweep::is_reachable`]. `room`: how much wider a box is made, `may`: the coordinates that
    /// may move from now on, a bit each. Call it once a period.
    pub fn holds(
        &mut self,
        sweep: &Sweep,
        (room, may): (&[i32; MAX_AXES], u8),
        axes: usize,
        machine: &impl Kinematics,
    ) -> bool {
        self.look_ahead(sweep, (room, may), axes, machine);
        let known = self.known.as_ref();
        known.is_some_and(|known| sweep.is_within(known, axes)) || sweep.is_reachable(axes, machine)
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
            Some((next, corner)) if sweep.is_within(&next, axes) => {
                let moving = next.moving(axes);
                if !next.takes(corner, moving, machine) {
                    self.next = None;
                    self.patience = PATIENCE;
                } else if corner + 1 < 1 << moving.count_ones() {
                    self.next = Some((next, corner + 1));
                } else {
                    self.next = None;
                    self.known = Some(next);
                }
            }
            _ => {
                let half = room.map(|room| room / 2);
                let near = sweep.with_room(&half, may);
                let enough = self
                    .known
                    .as_ref()
                    .is_some_and(|known| near.is_within(known, axes));
                self.next =
                    (!enough && self.patience == 0).then(|| (sweep.with_room(room, may), 0));
            }
        }
    }
}
