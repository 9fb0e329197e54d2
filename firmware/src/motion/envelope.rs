//! The box that the pose sweeps before it can be at rest.
//!
//! Whoever moves the machine by hand, or beside its program, must be able to stop it before a bound. Coordinates come to rest at different times, so the
//! way to rest is not known as a line but as a box: each coordinate stays between two values. If the machine can take the corners of the box, going on
//! for one more period is safe; if not, braking now is, because the box of the period before was.
//!
//! Joint rates are bounded in the same way: near a bound of the workspace, and near a singularity, a joint moves many times as fast as the tool, and the tool
//! cannot brake as fast as that factor grows. [`StoppingEnvelope::rates`] are the largest rates of the coordinates on the way to rest. If no joint exceeds its maximum rate with
//! these rates at any corner ([`StoppingEnvelope::load`]), none does on the way: braking neither leaves the box nor raises a rate.

use haptimill_kinematics::{Kinematics, Pose, Rates};
use haptimill_math::scale::saturate;
use haptimill_math::{Coordinate, Rate};
use haptimill_protocol::message::MAX_AXES;

/// Between which values each coordinate stays.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StoppingEnvelope {
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

impl StoppingEnvelope {
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

    /// Whether the machine can take the poses of the box.
    pub fn is_reachable(&self, machine: &impl Kinematics) -> bool {
        self.load(&[], machine).is_some()
    }

    /// The largest part of its maximum rate that a joint reaches in the box, for each of `rates` ([`Kinematics::load`]); `None` if the machine cannot take a pose of it.
    pub fn load(&self, rates: &[Rates], machine: &impl Kinematics) -> Option<[u32; 2]> {
        machine.load(&self.low, &self.high, rates).ok()
    }
}

/// From this load on what follows a hand goes no faster.
pub const SLOWED_LOAD: u32 = FULL_LOAD - FULL_LOAD / 8;

/// An offset of some coordinates, and its rates.
pub type Excursion = [(i32, Rate); 3];

/// Periods between two attempts at a wider box where there was none.
const PATIENCE: u8 = 64;

/// What is known of the reach around the machine: a box that is reachable, with room. A sweep in it needs no look of its own.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ReachableBox {
    known: Option<(StoppingEnvelope, u32)>,
    patience: u8,
}

impl ReachableBox {
    /// The load of a sweep, or a little more; `None` if the machine cannot take it: see [`StoppingEnvelope::load`]. `room`: how much wider a box is made, `may`: the coordinates that
    /// may move from now on, a bit each. Call it once a period.
    pub fn holds(
        &mut self,
        sweep: &StoppingEnvelope,
        (room, may): (&[i32; MAX_AXES], u8),
        axes: usize,
        machine: &impl Kinematics,
    ) -> Option<u32> {
        if let Some((known, load)) = &self.known
            && sweep.is_within(known, axes)
        {
            return Some(*load);
        }
        self.patience = self.patience.saturating_sub(1);
        if self.patience == 0 {
            let wide = sweep.with_room(room, may);
            let load = wide.load(&[wide.rates], machine).map(|loads| loads[0]);
            // What is near its maximum is looked at as it is, and not with room.
            if let Some(load) = load.filter(|load| *load <= SLOWED_LOAD) {
                self.known = Some((wide, load));
                return Some(load);
            }
            self.patience = PATIENCE;
        }
        Some(sweep.load(&[sweep.rates], machine)?[0])
    }
}
