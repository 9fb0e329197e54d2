//! Backlash compensation for a screw whose encoder is on the motor.
//!
//! The slide is within half the play of the motor coordinate.
//!
//! - **Slide position.** Friction of the guideways and wipers holds the slide until a flank of the
//!   nut pushes it. This is the play operator: `slide` stays while `|motor - slide| <= play / 2`
//!   and is carried along otherwise. Its input is the measured motor coordinate, not the commanded
//!   one, so it is also right when the drives are off and somebody turns the screw. After power-on
//!   the flank is unknown. The middle is assumed until the first motion of more than the play.
//! - **Commanded motor position.** It is half the play ahead of the slide, on the side of the next
//!   motion. The side changes with the commanded rate, with a hysteresis of one play per second.
//!   The noise of the measured rate would make the motor chatter between the flanks. The side does
//!   not change at standstill, so a standing machine does not move.
//! - **Transition.** A step of the commanded motor position would be a blow of K_P * play. The
//!   shift passes two equal first-order filters in series, so position and rate are continuous, and
//!   a reversal during the transition needs no special case. With [`SHIFT_US`] = 4 ms the crossing
//!   is 95 % done in 19 ms. On the 30 mm circle at 4 mm/s the hysteresis takes 9 ms, in which the
//!   slide should have moved 0.4 um: that is the remaining error.
//!
//! The compensated value is the lost motion of a reversal as measured on a machine: the play plus
//! twice the wind-up of the screw under the friction of the slide.
//!
//! The loop is closed on the motor, with the error commanded + shift - motor. A loop closed on the
//! estimated slide would contain the play. It would have no gain within the play and would
//! limit-cycle across it.

use super::encoder::{difference, sum};
use crate::config::AxisKind;
use crate::config::digest::constants;
use crate::joint::rate_filter::approach;
use haptimill_math::reciprocal::{Factor, Scale, saturate};
use haptimill_math::{Coordinate, Rate};

/// Time constant of each of the two filters, in microseconds.
pub const SHIFT_US: u16 = 4_000;

/// Largest number of fractional bits of the filter states. A play of more than 0.12 um has fewer,
/// so that a state fits into 32 bits.
const FRACTION: u32 = 24;

/// Backlash compensation of one joint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Backlash {
    kind: AxisKind,
    /// Half of the play, axis units.
    half: i32,
    /// Rate above which the commanded direction is valid.
    hysteresis: i32,
    /// 1 - pole of each filter, Q31.
    approach: i32,
    /// Conversion of the change of a state per period to a rate.
    rate: Scale,
    /// Fractional bits of the states. `rounding` is half a unit and `flank` half of the play, both
    /// with these bits.
    fraction: u32,
    rounding: i32,
    flank: i32,
    /// Target of the states; their initial value until a direction is commanded.
    goal: i32,
    /// Filter states, axis units; both within +-half, which is below 2^30 with their fraction.
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
    /// Compensation of the full play `play` (its magnitude counts; 0 switches the compensation
    /// off).
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

    /// Updates the slide with the measured motor coordinate `motor` and returns the slide's
    /// coordinate, within the uncertainty of the play.
    // Inlined although it has two callers: one is the control period, the other a configuration
    // change.
    #[inline(always)]
    pub fn carry(&mut self, motor: Coordinate) -> Coordinate {
        let ahead = difference(self.kind, motor, self.slide)
            .0
            .max(-self.half)
            .min(self.half);
        self.slide = difference(self.kind, motor, Coordinate(ahead));
        self.slide
    }

    /// Sets the slide to the motor coordinate, flank unknown.
    pub const fn place(&mut self, motor: Coordinate) {
        self.slide = motor;
    }

    /// Shifts the slide by `shift` after a reference was found.
    pub fn rebase(&mut self, shift: Coordinate) {
        self.slide = sum(self.kind, self.slide, shift);
    }

    /// Starts with `motor` as the commanded motor position for the present slide, so nothing moves.
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

    /// Returns the shift of the commanded coordinate and rate for the next period, from the
    /// commanded rate of the slide.
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
            // All three are within +-2^30, so differences fit into 32 bits.
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

    /// The part of `distance` that a filter covers in a period.
    const fn part(&self, distance: i32) -> i32 {
        ((distance as i64 * self.approach as i64) >> 31) as i32
    }
}
