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
use super::reciprocal::{mul_shift, saturate};
use crate::config::AxisKind;
use crate::position::filter::{approach, frequency};
use crate::safety::integrity::constants;
use crate::units::{Coordinate, Rate};

/// Time constant of each of the two filters, in microseconds.
pub const SHIFT_US: u16 = 4_000;

/// Fractional bits of the filters' states.
const FRACTION: u32 = 24;

/// Backlash of one joint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Backlash {
    kind: AxisKind,
    /// Half of the play, axis units.
    half: i32,
    /// Rate beyond which the wanted direction is believed.
    hysteresis: i32,
    /// 1 - pole of each filter, Q32.
    approach: u32,
    /// Periods per second, Q16.
    frequency: u32,
    /// The side wanted: -1, 0 (not known yet) or 1.
    side: i32,
    /// States of the filters, axis units Q24; both within +-half.
    first: i64,
    second: i64,
    slide: Coordinate,
}

constants!(Backlash {
    kind, half, hysteresis, approach, frequency
} of {} but { side, first, second, slide });

impl Backlash {
    /// Backlash of the whole width `play` (its magnitude counts; 0 switches everything here off).
    pub const fn new(kind: AxisKind, play: Coordinate, period_us: u16) -> Self {
        // At most 2^30.
        let half = (play.0.unsigned_abs() / 2) as i32;
        Self {
            kind,
            half,
            hysteresis: saturate(2 * half as i64),
            approach: approach(period_us, SHIFT_US),
            frequency: frequency(period_us),
            side: 0,
            first: 0,
            second: 0,
            slide: Coordinate(0),
        }
    }

    /// The motor was measured at `motor`; gives where the slide is, within what the play leaves open.
    #[inline]
    pub fn carry(&mut self, motor: Coordinate) -> Coordinate {
        let ahead = difference(self.kind, motor, self.slide)
            .0
            .clamp(-self.half, self.half);
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
            .clamp(-self.half, self.half);
        self.side = 0;
        self.first = i64::from(ahead) << FRACTION;
        self.second = self.first;
    }

    /// What is to be added to the wanted coordinate and rate of the slide, one period on, for a wanted rate of the slide.
    #[inline]
    pub fn shift(&mut self, rate: Rate) -> (Coordinate, Rate) {
        if self.half == 0 {
            return (Coordinate(0), Rate(0));
        }
        if rate.0 > self.hysteresis {
            self.side = 1;
        } else if rate.0 < -self.hysteresis {
            self.side = -1;
        }
        // With no side known yet it stays where it started. States within +-2^54, differences within 2^55.
        let goal = if self.side == 0 {
            self.first
        } else {
            i64::from(self.side * self.half) << FRACTION
        };
        self.first += mul_shift::<32>(goal - self.first, self.approach);
        let change = mul_shift::<32>(self.first - self.second, self.approach);
        self.second += change;
        // Q24 * Q16 / 2^32 = Q8.
        let rate = mul_shift::<32>(change, self.frequency) >> 8;
        (
            Coordinate(saturate((self.second + (1 << (FRACTION - 1))) >> FRACTION)),
            Rate(saturate(rate)),
        )
    }
}
