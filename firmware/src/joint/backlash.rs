//! Backlash of a screw whose encoder sits on the motor.
//!
//! The slide hangs in the play of the nut: its coordinate is within half the play of the motor's. Three things follow.
//!
//! - **Where the slide is.** Ways and wipers hold it by friction until a flank pushes it: the play operator, `slide` stays where it is as long as
//!   `|motor - slide| <= play / 2` and is carried along otherwise. It is driven by the measured motor, not by what was wanted, so it is also right when
//!   the drives are off and somebody turns the screw. After power on the flank is unknown and the middle is assumed, until the first motion of more than the play.
//! - **Where the motor must be.** Half the play ahead of the slide on the side to which the slide shall go next. The side changes with
//!   the wanted rate (never the measured one, whose noise would make the motor chatter between the flanks), with a hysteresis of one play per second,
//!   and keeps its side at rest: a machine that stands does not move.
//! - **How it gets there.** A step of the wanted motor position would be a blow of K_P * play. The shift passes two equal first-order
//!   filters in a row, so position and rate are continuous, and a change of mind in mid-way needs no special case. With [`SHIFT_US`] = 4 ms the crossing is 95 %
//!   done in 19 ms. On the 30 mm circle at 4 mm/s the hysteresis takes 9 ms and the slide
//!   should have moved 0.4 um by then: that is the error which is left.
//!
//! What is compensated is the lost motion of a reversal as it is measured on a machine: the play, and twice the wind-up of the screw under the slide's friction.
//!
//! The loop is closed on the motor, where its error is wanted + shift - motor. Closing it on the estimated slide would put the play inside the loop, which then
//! has no gain within the play and limit-cycles across it.

use super::encoder::{difference, sum};
use crate::config::AxisKind;
use crate::config::digest::constants;
use crate::joint::rate_filter::approach;
use haptimill_math::reciprocal::{Factor, Scale, saturate};
use haptimill_math::{Coordinate, Rate};

/// Time constant of each of the two filters, in microseconds.
pub const SHIFT_US: u16 = 4_000;

/// The most fractional bits of the filters' states; a play of more than 0.12 um has fewer, so that a state is a word.
const FRACTION: u32 = 24;

/// Backlash of one joint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Backlash {
    kind: AxisKind,
    /// Half of the play, axis units.
    half: i32,
    /// Rate beyond which the wanted direction is believed.
    hysteresis: i32,
    /// 1 - pole of each filter, Q31.
    approach: i32,
    /// From changes of a state in a period to a rate.
    rate: Scale,
    /// Fractional bits of the states; half a unit with them; half of the play with them.
    fraction: u32,
    rounding: i32,
    flank: i32,
    /// Where the states shall go; unknown until a direction is wanted: where they started.
    goal: i32,
    /// States of the filters, axis units; both within +-half, which is below 2^30 with their fraction.
    first: i32,
    second: i32,
    /// The states no longer change.
    settled: bool,
    slide: Coordinate,
}

constants!(Backlash {
    kind, half, hysteresis, approach, rate, fraction, rounding, flank
} of {} but { goal, first, second, settled, slide });

impl Backlash {
    /// Backlash of the whole width `play` (its magnitude counts; 0 switches everything here off).
    pub const fn new(kind: AxisKind, play: Coordinate, period_us: u16) -> Self {
        let half = (play.0.unsigned_abs() / 2) as i32;
        let half = if half >= 1 << 30 { (1 << 30) - 1 } else { half };
        let room = half.leading_zeros() - 2;
        let fraction = if room > FRACTION { FRACTION } else { room };
        let period = if period_us < 50 { 50 } else { period_us as u64 };
        Self {
            kind,
            half,
            hysteresis: saturate(2 * half as i64),
            approach: (approach(period_us, SHIFT_US) >> 1) as i32,
            rate: Factor::of(1_000_000)
                .over(Factor::of(period))
                .shifted(-(fraction as i32))
                .scale(),
            fraction,
            rounding: (1 << fraction) >> 1,
            flank: half << fraction,
            goal: 0,
            first: 0,
            second: 0,
            settled: true,
            slide: Coordinate(0),
        }
    }

    /// The motor was measured at `motor`; gives where the slide is, within what the play leaves open.
    // In every period, and once when a configuration changes: not to be called for that.
    #[inline(always)]
    pub fn carry(&mut self, motor: Coordinate) -> Coordinate {
        let ahead = difference(self.kind, motor, self.slide)
            .0
            .max(-self.half)
            .min(self.half);
        self.slide = difference(self.kind, motor, Coordinate(ahead));
        self.slide
    }

    /// The slide is at the motor's coordinate, flank unknown.
    pub const fn place(&mut self, motor: Coordinate) {
        self.slide = motor;
    }

    /// All coordinates grew by `shift`: a reference was found.
    pub fn rebase(&mut self, shift: Coordinate) {
        self.slide = sum(self.kind, self.slide, shift);
    }

    /// Starts with the motor at `motor` as what is wanted for the slide where it is: nothing moves.
    pub fn hold(&mut self, motor: Coordinate) {
        let ahead = difference(self.kind, motor, self.slide)
            .0
            .max(-self.half)
            .min(self.half);
        self.goal = ahead << self.fraction;
        self.first = self.goal;
        self.second = self.goal;
        self.settled = true;
    }

    /// What is to be added to the wanted coordinate and rate of the slide, one period on, for a wanted rate of the slide.
    #[inline]
    pub fn shift(&mut self, rate: Rate) -> (Coordinate, Rate) {
        if self.half == 0 {
            return (Coordinate(0), Rate(0));
        }
        let goal = if rate.0 > self.hysteresis {
            self.flank
        } else if rate.0 < self.hysteresis.wrapping_neg() {
            self.flank.wrapping_neg()
        } else {
            self.goal
        };
        let mut rate = Rate(0);
        if goal != self.goal || !self.settled {
            self.goal = goal;
            // All three are within +-2^30, differences within the word.
            let first = self.part(goal.wrapping_sub(self.first));
            self.first = self.first.wrapping_add(first);
            let change = self.part(self.first.wrapping_sub(self.second));
            self.second = self.second.wrapping_add(change);
            self.settled = first == 0 && change == 0;
            rate = Rate(self.rate.apply(change));
        }
        let shift = self
            .second
            .wrapping_add(self.rounding)
            .wrapping_shr(self.fraction);
        (Coordinate(shift), rate)
    }

    /// What a filter goes of the way to its input in a period.
    const fn part(&self, way: i32) -> i32 {
        ((way as i64 * self.approach as i64) >> 31) as i32
    }
}
