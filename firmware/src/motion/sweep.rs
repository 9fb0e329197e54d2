//! The box that the pose sweeps before it can be at rest.
//!
//! Whoever moves the machine by hand, or beside its program, must be able to stop it before a bound. Coordinates come to rest at different times, so the
//! way to rest is not known as a line but as a box: each coordinate stays between two values. If the machine can take the corners of the box, going on
//! for one more period is safe; if not, braking now is, because the box of the period before was.

use crate::kinematics::{Kinematics, Pose};
use crate::units::Coordinate;
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

    /// Whether the machine can take the corners of the box: all of them for up to three moving coordinates, the low and the high one and those next
    /// to them for more (the pose of every period is checked besides).
    pub fn is_reachable(&self, axes: usize, machine: &impl Kinematics) -> bool {
        let moving: heapless::Vec<usize, MAX_AXES> = (0..axes.min(MAX_AXES))
            .filter(|&axis| self.low.0[axis] != self.high.0[axis])
            .collect();
        let all = (1_u32 << moving.len()) - 1;
        let few = moving.len() <= 3;
        (0..=all)
            .filter(|corner| few || corner.count_ones() <= 1 || (all & !corner).count_ones() <= 1)
            .all(|corner| {
                let mut pose = self.low;
                for (bit, &axis) in moving.iter().enumerate() {
                    if corner & (1 << bit) != 0 {
                        pose.0[axis] = self.high.0[axis];
                    }
                }
                machine.inverse(&pose).is_ok()
            })
    }
}
