//! Backlash compensation for a screw whose encoder is on the motor.
//!
//! The compensated value is the lost motion of a reversal as measured on a machine: the backlash
//! plus twice the wind-up of the screw under the friction of the slide. The slide is within half
//! the lost motion of the motor coordinate.
//!
//! - **Slide position.** Friction of the guideways and wipers holds the slide until a flank of the
//!   nut pushes it: `slide` stays while `|motor - slide|` is at most half the lost motion, and is
//!   carried along otherwise. The input is the measured motor coordinate, not the commanded one, so
//!   it is also correct when the drives are off and the screw is turned by hand. After power-on the
//!   flank is unknown. The middle is assumed until the first motion of more than the lost motion.
//! - **Commanded motor position.** It is half the lost motion ahead of the slide, on the side of
//!   the next motion. The side changes with the commanded rate, with a hysteresis of one lost
//!   motion per second. The noise of the measured rate would make the motor chatter between the
//!   flanks. Slower motion, such as that of a volumetric correction, changes the side after 1/16 of
//!   the lost motion. The side does not change at standstill, so a machine at standstill does not
//!   move.
//! - **Transition.** A step of the commanded motor position would cause an effort step of K_P times
//!   the lost motion. The shift passes two equal first-order filters in series, so position and
//!   rate are continuous, and a reversal during the transition needs no special case. Its rate is
//!   fed forward, and so is half of its acceleration, as the motor crosses alone and has about half
//!   of the inertia of the joint. With [`TORQUE_SHIFT_US`] = 2.6 ms the crossing is 95 % done in 12
//!   ms. A step motor has 4 ms, as it loses steps where its acceleration is too high. On the 30 mm
//!   circle at 4 mm/s the hysteresis takes 9 ms, in which the slide should have moved 0.4 um: that
//!   is the remaining error.
//! - **Position.** A worn screw has more backlash where it was used most. Half the lost motion is
//!   then a table over the stroke, linear between its nodes, taken at the motor for the slide
//!   position and at the commanded slide for the commanded motor position.
//!
//! The loop is closed on the motor, with the error commanded + shift - motor. A loop closed on the
//! estimated slide would contain the backlash. It would have no gain within it and would
//! limit-cycle across it.

use super::JointCommand;
use super::encoder::{difference, sum};
use crate::config::{AxisKind, BACKLASH_NODES, Drive, JointSettings};
use crate::digest::impl_digest;
use crate::rate_filter::approach;
use haptimill_math::reciprocal::{Factor, Scale, saturate};
use haptimill_math::{Acceleration, Coordinate, Rate};
use heapless::Vec;

/// Time constant of each of the two filters for a torque drive, in microseconds.
pub const TORQUE_SHIFT_US: u16 = 2_600;

/// The same for a step/direction drive, with two thirds of the rate and less than half of the
/// acceleration.
pub const STEP_SHIFT_US: u16 = 4_000;

/// Largest number of fractional bits of the filter states. More than 0.12 um have fewer,
/// so that a state fits into 32 bits.
const FRACTION: u32 = 24;

/// Backlash compensation of one joint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Backlash {
    kind: AxisKind,
    /// Half of the lost motion, axis units: the largest, where it has a table.
    half: i32,
    table: Table,
    /// Rate above which the commanded direction is valid.
    hysteresis: i32,
    /// 1 - pole of each filter, Q31.
    approach: i32,
    /// Conversion of the change of a state per period to a rate.
    rate: Scale,
    /// Conversion of the change of that change to half of an acceleration.
    acceleration: Scale,
    /// Fractional bits of the states. `rounding` is half a unit with these bits.
    fraction: u32,
    rounding: i32,
    /// Target of the states; their initial value until a direction is commanded.
    goal: i32,
    /// Filter states, axis units; both within +-half, which is below 2^30 with their fraction.
    first: i32,
    second: i32,
    /// Change of `second` in the last period.
    change: i32,
    /// The states no longer change.
    settled: bool,
    slide: Coordinate,
    /// The commanded slide behind 1/16 of the lost motion: motion that carries it has a direction.
    anchor: Coordinate,
}

impl_digest!(Backlash { fields {
    kind, half, table, hysteresis, approach, rate, acceleration, fraction, rounding
}, nested {}, skip { goal, first, second, change, settled, slide, anchor } });

/// Direction of a motion.
enum Direction {
    Up,
    Down,
    None,
}

/// Half of the lost motion along the stroke.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Table {
    /// Halves at the nodes; empty where the lost motion is the same everywhere.
    halves: Vec<i32, BACKLASH_NODES>,
    /// Place of the first node.
    low: i32,
    /// 2^47 divided by the distance of two nodes.
    reciprocal: i64,
}

impl Table {
    fn new(joint: &JointSettings) -> Self {
        let spans = joint.backlash_table.len().saturating_sub(1).max(1) as i64;
        let pitch = (i64::from(joint.high.0) - i64::from(joint.low.0)) / spans;
        let halves = joint
            .backlash_table
            .iter()
            .map(|lost_motion| half_of(*lost_motion));
        Self {
            halves: halves.collect(),
            low: joint.low.0,
            reciprocal: (1 << 47) / pitch.max(1 << 16),
        }
    }

    /// Half of the lost motion at a coordinate, `None` without a table. Beyond its ends it is
    /// constant.
    #[inline(always)]
    fn at(&self, coordinate: Coordinate) -> Option<i32> {
        let last = self.halves.len().checked_sub(2)?;
        // Below 2^32 times 2^31.
        let from = (i64::from(coordinate.0) - i64::from(self.low)).max(0);
        let place = (from * self.reciprocal) >> 23;
        let (node, part) = ((place >> 24) as usize, place & 0xFF_FFFF);
        let (node, part) = if node > last {
            (last, 1 << 24)
        } else {
            (node, part)
        };
        let (lower, upper) = (self.halves.get(node)?, self.halves.get(node + 1)?);
        Some(lower + ((i64::from(upper - lower) * part) >> 24) as i32)
    }
}

/// Half of a lost motion, below 2^30.
const fn half_of(lost_motion: Coordinate) -> i32 {
    let half = (lost_motion.0.unsigned_abs() / 2) as i32;
    if half >= 1 << 30 { (1 << 30) - 1 } else { half }
}

impl Backlash {
    /// Compensation of the lost motion of a joint (its magnitude counts; 0 switches the
    /// compensation off).
    pub fn new(joint: &JointSettings, period_us: u16) -> Self {
        let half = half_of(joint.backlash);
        let room = half.leading_zeros() - 2;
        let fraction = if room > FRACTION { FRACTION } else { room };
        let period = if period_us < 50 { 50 } else { period_us as u64 };
        let shift_us = match joint.drive {
            Drive::Torque { .. } => TORQUE_SHIFT_US,
            Drive::Steps { .. } => STEP_SHIFT_US,
        };
        let per_second = Factor::of(1_000_000).over(Factor::of(period));
        Self {
            kind: joint.kind,
            half,
            table: Table::new(joint),
            hysteresis: saturate(2 * half as i64),
            approach: (approach(period_us, shift_us) >> 1) as i32,
            rate: per_second.shifted(-(fraction as i32)).scale(),
            acceleration: per_second
                .times(per_second)
                .shifted(-(fraction as i32) - 8 - 1)
                .scale(),
            fraction,
            rounding: (1 << fraction) >> 1,
            goal: 0,
            first: 0,
            second: 0,
            change: 0,
            settled: true,
            slide: Coordinate(0),
            anchor: Coordinate(0),
        }
    }

    /// Updates the slide with the measured motor coordinate `motor` and returns the slide's
    /// coordinate, within the uncertainty of the lost motion.
    // Inlined although it has two callers: one is the control period, the other a configuration
    // change.
    #[inline(always)]
    pub fn carry(&mut self, motor: Coordinate) -> Coordinate {
        let ahead = self.ahead(motor);
        self.slide = difference(self.kind, motor, Coordinate(ahead));
        self.slide
    }

    /// Sets the slide to the motor coordinate, flank unknown.
    pub const fn set_slide(&mut self, motor: Coordinate) {
        self.slide = motor;
    }

    /// Shifts the slide by `shift` after a reference was found.
    pub fn rebase(&mut self, shift: Coordinate) {
        self.slide = sum(self.kind, self.slide, shift);
        self.anchor = sum(self.kind, self.anchor, shift);
    }

    /// Starts with `motor` as the commanded motor position for the present slide, so nothing moves.
    pub fn hold(&mut self, motor: Coordinate) {
        let ahead = self.ahead(motor);
        self.anchor = self.slide;
        self.goal = ahead << self.fraction;
        self.first = self.goal;
        self.second = self.goal;
        self.change = 0;
        self.settled = true;
    }

    /// How far the motor is ahead of the slide, within half the lost motion.
    #[inline(always)]
    fn ahead(&self, motor: Coordinate) -> i32 {
        let half = self.half_at(motor);
        difference(self.kind, motor, self.slide)
            .0
            .max(-half)
            .min(half)
    }

    /// Half of the lost motion at a place.
    #[inline(always)]
    fn half_at(&self, coordinate: Coordinate) -> i32 {
        self.table.at(coordinate).unwrap_or(self.half)
    }

    /// Returns the shift of the commanded motion for the next period, from the commanded
    /// coordinate and rate of the slide. Its acceleration is the part to feed forward.
    #[inline]
    pub fn shift(&mut self, coordinate: Coordinate, rate: Rate) -> JointCommand {
        let mut shift = JointCommand::default();
        if self.half == 0 {
            return shift;
        }
        let goal = match self.direction(coordinate, rate) {
            Direction::Up => self.half_at(coordinate) << self.fraction,
            Direction::Down => (self.half_at(coordinate) << self.fraction).wrapping_neg(),
            Direction::None => self.goal,
        };
        if goal != self.goal || !self.settled {
            self.goal = goal;
            // All three are within +-2^30, so differences fit into 32 bits.
            let first = self.part(goal.wrapping_sub(self.first));
            self.first = self.first.wrapping_add(first);
            let change = self.part(self.first.wrapping_sub(self.second));
            self.second = self.second.wrapping_add(change);
            self.settled = first == 0 && change == 0;
            shift.rate = Rate(self.rate.apply(change));
            let bend = change.wrapping_sub(self.change);
            shift.acceleration = Acceleration(self.acceleration.apply(bend));
            self.change = change;
        }
        let rounded = self.second.wrapping_add(self.rounding);
        shift.coordinate = Coordinate(rounded.wrapping_shr(self.fraction));
        shift
    }

    /// Direction of the commanded motion.
    #[inline(always)]
    fn direction(&mut self, coordinate: Coordinate, rate: Rate) -> Direction {
        let room = self.half >> 4;
        let ahead = difference(self.kind, coordinate, self.anchor).0;
        let within = ahead.max(room.wrapping_neg()).min(room);
        if ahead != within {
            self.anchor = difference(self.kind, coordinate, Coordinate(within));
        }
        if rate.0 > self.hysteresis {
            Direction::Up
        } else if rate.0 < self.hysteresis.wrapping_neg() {
            Direction::Down
        } else if ahead > within {
            Direction::Up
        } else if ahead < within {
            Direction::Down
        } else {
            Direction::None
        }
    }

    /// The part of `distance` that a filter covers in a period.
    const fn part(&self, distance: i32) -> i32 {
        ((distance as i64 * self.approach as i64) >> 31) as i32
    }
}
