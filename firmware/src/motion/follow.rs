//! A coordinate that follows what is not planned: a hand.
//!
//! A [`Mover`] has a place and a rate and goes where it is told, in every period anew. Its acceleration is within a bound whatever it is told, its rate goes to within its own, and both are what is fed forward: they are not
//! differences of the target. So a coordinate changes hands while it moves: the mover takes over place and rate, and nothing steps.
//!
//! The target passes two stages of 1/k. The first smooths it (encoders make steps, a remote hand makes stairs). The second asks for the rate at which the way that is left can still be braked on: k e near the target, sqrt(2 a e) farther off. So a
//! target that stands is not overshot if it can be stopped at, and is come to with no rest. The lag behind a hand at rate v is 1/k + 1/k up to v = a'/k, and 1/k + v / 2a' + a' / (2 k^2 v) above, a' being 7/8 of the acceleration: 20 ms for k = 100/s and a slow hand, 39 ms at 10 mm/s and 200 mm/s^2.
//!
//! Units as in [`super::jog`]: 2^-20 axis units (per period). Misuse: a target beyond the bounds of the coordinate. The mover stops where it is told; whoever tells it holds the target within them.

use super::Wanted;
use super::jog::{per_period, slope, slower};
use super::sweep::SLOWED_LOAD;
use crate::config::PoseAxis;
use crate::safety::integrity::constants;
use crate::units::root::Root;
use crate::units::scale::{multiply_high, saturate};
use crate::units::{Acceleration, Coordinate, Rate};

/// Fraction bits of places and rates.
const FRACTION: u32 = 20;

/// Bounds of a mover, worked out from those of a pose coordinate.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct MoverLimits {
    /// Most change of the rate in a period, and 1 / it: 2^(`whole` + 31) / step, 2^30 to 2^31, so that nothing is divided in a period.
    step: i64,
    inverse: u32,
    whole: u32,
    rate: i64,
    /// k T, 2^-32.
    pull: u32,
    /// Where the profile of the rate is a root: from here on, and as far as the rate may rise.
    bend: i64,
    far: i64,
    /// Twice the acceleration of the profile, and half the shift with which its product with a distance fits a word of 62 bits.
    twice: i64,
    shift: u32,
    low: i64,
    high: i64,
    periods_per_second: i64,
}

/// A coordinate under way.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Mover {
    place: i64,
    rate: i64,
    /// Change of the rate in the last period.
    change: i64,
    /// The smoothed target.
    led: i64,
}

constants!(MoverLimits { step, inverse, whole, rate, pull, bend, far, twice, shift, low, high, periods_per_second } of {} but {});

impl MoverLimits {
    /// Bounds for a coordinate that follows with the gain k in 1/s, 1 to 1000; `None` where they make no sense.
    #[must_use]
    #[cold]
    pub fn new(axis: &PoseAxis, gain: u16, period_us: u16) -> Option<Self> {
        let step = slope(axis.acceleration, period_us)?;
        let rate = per_period(i64::from(axis.rate.0), period_us);
        if !(8..1 << 41).contains(&step) || rate < 1 || !(1..=1000).contains(&gain) {
            return None;
        }
        // k T, below 2^20 * 2^32 / 10^6.
        let pull = ((u64::from(gain) * u64::from(period_us)) << 32) / 1_000_000;
        if !(1 << 10..1 << 31).contains(&pull) {
            return None;
        }
        let gentle = step * 7 / 8;
        // a' / k T / k T, each quotient below 2^63; the first one ends at 2 mm in a period, which nothing does.
        let coarse = pull as i64 >> 10;
        let bend = ((((gentle << 22) / coarse).min(1 << 41)) << 22) / coarse.max(1);
        // Where the root comes to the largest rate, v^2 / 2 a' farther: v with 31 bits.
        let spare = (64 - rate.leading_zeros()).saturating_sub(31);
        let whole = rate >> spare;
        let reach = (whole * whole / (2 * gentle)).min(1 << (52 - 2 * spare)) << (2 * spare);
        let far = (reach + bend / 2).max(bend);
        let mut shift = 0;
        while (far >> (2 * shift)) > (1 << 61) / (2 * gentle) {
            shift += 1;
        }
        let whole = 63 - step.leading_zeros();
        let quotient = (1_u64 << 62) / step as u64;
        let inverse = match whole {
            ..=31 => quotient >> (31 - whole),
            _ => quotient << (whole - 31),
        };
        Some(Self {
            step,
            inverse: inverse as u32,
            whole,
            rate,
            pull: pull as u32,
            bend,
            far,
            twice: 2 * gentle,
            shift,
            low: i64::from(axis.low.0) << FRACTION,
            high: i64::from(axis.high.0) << FRACTION,
            periods_per_second: 1_000_000 / i64::from(period_us.max(1)),
        })
    }

    /// The rate at which a way can still be braked on.
    fn profile(&self, way: i64) -> i64 {
        let distance = way.abs();
        if distance <= self.bend {
            return multiply_high(way, self.pull).clamp(-self.rate, self.rate);
        }
        let distance = distance.min(self.far) - self.bend / 2;
        let square = (distance >> (2 * self.shift)).wrapping_mul(self.twice);
        let root = i64::from(Root::of(square as u64).rounded()) << self.shift;
        root.min(self.rate) * way.signum()
    }

    /// A rate in axis units per second.
    fn per_second(&self, rate: i64) -> i64 {
        (rate * self.periods_per_second) >> FRACTION
    }
}

impl Mover {
    /// At a place, under way at a rate.
    #[must_use]
    pub fn at(place: Coordinate, rate: Rate, limits: &MoverLimits) -> Self {
        let place = i64::from(place.0) << FRACTION;
        Self {
            place,
            rate: (i64::from(rate.0) << FRACTION) / limits.periods_per_second.max(1),
            change: 0,
            led: place,
        }
    }

    /// Whether it stands.
    #[must_use]
    pub const fn is_still(&self) -> bool {
        self.rate == 0
    }

    /// Where it is.
    #[must_use]
    pub fn place(&self) -> Coordinate {
        // To nearest; within the range of a coordinate, or at its end.
        Coordinate(saturate((self.place + (1 << (FRACTION - 1))) >> FRACTION))
    }

    /// How far it goes if it brakes from now on, and a little more.
    fn stopping(&self, limits: &MoverLimits) -> i64 {
        if self.rate == 0 {
            return 0;
        }
        // Rounded down twice, by less than a period each time.
        let periods =
            (multiply_high(self.rate.abs(), limits.inverse) >> (limits.whole.max(1) - 1)) + 3;
        self.rate.saturating_mul(periods) / 2
    }

    /// Where it would come to rest.
    #[must_use]
    pub fn rest(&self, limits: &MoverLimits) -> Coordinate {
        Coordinate(saturate(
            self.place.saturating_add(self.stopping(limits)) >> FRACTION,
        ))
    }

    /// Between which values it stays if it goes on towards a target for one period, or brakes already, and brakes then.
    #[must_use]
    pub fn sweep(&self, target: Option<Coordinate>, limits: &MoverLimits) -> (i64, i64) {
        let mut next = *self;
        if target.is_some() {
            next.advance(target, limits);
        }
        let ends = [
            self.place,
            next.place,
            next.place.saturating_add(next.stopping(limits)),
        ];
        let least = ends.iter().fold(i64::MAX, |least, end| least.min(*end));
        let most = ends.iter().fold(i64::MIN, |most, end| most.max(*end));
        (least >> FRACTION, (most >> FRACTION) + 1)
    }

    /// The largest magnitude of its rate, axis units per second, if it goes on towards a target for one period, or brakes already, and brakes then.
    #[must_use]
    pub fn peak(&self, target: Option<Coordinate>, load: u32, limits: &MoverLimits) -> i64 {
        let mut next = *self;
        if target.is_some() {
            next.advance_under(target, load, limits);
        }
        limits.per_second(self.rate.abs().max(next.rate.abs())) + 1
    }

    /// One period as [`Mover::advance`], under a load of the joints in the period before: where that is large it goes no faster than the joints allow.
    pub fn advance_under(&mut self, target: Option<Coordinate>, load: u32, limits: &MoverLimits) {
        let slowed = |wanted: i64, rate: i64| {
            // A little more, so that a coordinate at rest can begin beside others.
            let most = slower(rate.abs(), load) + limits.step / 16;
            wanted.clamp(-most, most)
        };
        self.go(target, limits, |wanted, rate| {
            if load > SLOWED_LOAD {
                slowed(wanted, rate)
            } else {
                wanted
            }
        });
    }

    /// One period: towards a target within the bounds of the coordinate, or to rest without one.
    pub fn advance(&mut self, target: Option<Coordinate>, limits: &MoverLimits) {
        self.go(target, limits, |wanted, _| wanted);
    }

    #[inline]
    fn go(
        &mut self,
        target: Option<Coordinate>,
        limits: &MoverLimits,
        slowed: impl Fn(i64, i64) -> i64,
    ) {
        let wanted = match target {
            Some(target) => {
                let target = (i64::from(target.0) << FRACTION)
                    .min(limits.high)
                    .max(limits.low);
                self.led += multiply_high(target - self.led, limits.pull);
                slowed(limits.profile(self.led - self.place), self.rate)
            }
            None => 0,
        };
        self.change = (wanted - self.rate).clamp(-limits.step, limits.step);
        self.rate += self.change;
        // The rate of the period's end is the derivative of the place there: the mean of both ends is the way.
        self.place += self.rate - self.change / 2;
        if target.is_none() {
            self.led = self.place;
        }
    }

    /// Becomes the wanted value of a coordinate.
    pub fn tell(&self, axis: usize, limits: &MoverLimits, wanted: &mut Wanted) {
        wanted.pose.0[axis] = self.place();
        wanted.rates[axis] = Rate(saturate(limits.per_second(self.rate)));
        let acceleration = (limits.per_second(self.change) * limits.periods_per_second) >> 8;
        wanted.accelerations[axis] = Acceleration(saturate(acceleration));
    }
}
