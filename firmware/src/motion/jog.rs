//! Motion at a rate: jogging, and the search of homing.
//!
//! Every pose coordinate has a [`Ramp`] for its rate, so acceleration and jerk are bounded whatever the targets do. A jog lives until its
//! deadline; then it brakes. Before a soft limit it brakes so that it stops in front of it, and before a pose that the machine cannot take all
//! coordinates brake together: the stopping point is tested every period, so the machine never has to stop harder than its limits allow.

use super::Wanted;
use super::ramp::{Ramp, RampLimits};
use super::sweep::{Excursion, FULL_LOAD, MOST_LOAD, Sweep};
use crate::config::{Config, JERK_SHIFT};
use crate::kinematics::{Kinematics, Pose};
use crate::safety::integrity::{Constants, Digest, constants};
use crate::units::{Acceleration, Coordinate, Rate};
use haptimill_protocol::message::MAX_AXES;

/// Fraction bits of positions and rates here: 2^-20 axis units (per period).
const FRACTION: u32 = 20;

#[derive(Debug, Clone, Copy, Default)]
struct Axis {
    /// Position, 2^-20 axis units.
    position: i64,
    /// Rate, 2^-20 axis units per period.
    rate: Ramp,
    target: i64,
    limits: Option<RampLimits>,
    rate_limit: i64,
    low: i64,
    high: i64,
}

constants!(Axis { limits, rate_limit, low, high } of {} but { position, rate, target });

/// Motion of all pose coordinates at wanted rates.
#[derive(Debug, Default)]
pub struct Jog {
    axes: usize,
    period_us: u16,
    /// A whole number: the configuration sees to it.
    periods_per_second: i64,
    axis: [Axis; MAX_AXES],
    /// The load that the rates that are asked for had in the last period: they are made smaller by it where it is too large.
    asked_load: u32,
    /// It brakes in this period, and goes on after it.
    braking: bool,
    /// What is added to the pose beside it, by a tool that yields.
    excursion: Excursion,
    /// Periods that the present targets still live.
    alive: u32,
    /// Soft limits are respected (not while homing: coordinates are not yet right).
    limited: bool,
}

impl Constants for Jog {
    fn digest(&self, digest: &mut Digest) {
        let Self {
            axes,
            period_us,
            periods_per_second,
            axis,
            asked_load: _,
            braking: _,
            excursion: _,
            alive: _,
            limited: _,
        } = self;
        digest.add(&(axes, period_us, periods_per_second));
        axis.iter().for_each(|axis| axis.digest(digest));
    }
}

/// Most change of a rate in a period, 2^-20 axis units per period; `None` where it is beyond 63 bits.
pub(super) fn slope(acceleration: Acceleration, period_us: u16) -> Option<i64> {
    // Once per configuration: wide arithmetic costs nothing here. (au/s^2) (us)^2 / 10^12.
    let period = i128::from(period_us);
    let slope =
        ((i128::from(acceleration.0) * period * period) << (8 + FRACTION)) / 1_000_000_000_000;
    i64::try_from(slope).ok()
}

/// Bounds of a rate in 2^-20 axis units per period, from the limits of a pose coordinate; `None` if they make no sense.
#[must_use]
pub fn rate_limits(acceleration: Acceleration, jerk: u32, period_us: u16) -> Option<RampLimits> {
    let period = i128::from(period_us);
    // (au/s^3) (us)^3 / 10^18.
    let jerk = ((i128::from(jerk) * period * period * period) << (JERK_SHIFT + FRACTION))
        / 1_000_000_000_000_000_000;
    let slope = slope(acceleration, period_us)?;
    RampLimits::new(slope, i64::try_from(jerk).ok()?.min(slope))
}

impl Jog {
    /// At rest, for the machine of `config`.
    #[must_use]
    pub fn new(config: &Config) -> Self {
        let mut jog = Self {
            axes: config.pose.len(),
            period_us: config.period_us,
            periods_per_second: 1_000_000 / i64::from(config.period_us.max(1)),
            ..Self::default()
        };
        for (axis, pose) in jog.axis.iter_mut().zip(&config.pose) {
            axis.limits = rate_limits(pose.acceleration, pose.jerk, config.period_us);
            axis.rate_limit = per_period(i64::from(pose.rate.0), config.period_us);
            axis.low = i64::from(pose.low.0) << FRACTION;
            axis.high = i64::from(pose.high.0) << FRACTION;
        }
        jog
    }

    /// Begins at rest at `pose`; `limited` says whether soft limits count.
    pub fn begin(&mut self, pose: &Pose, limited: bool) {
        for (axis, coordinate) in self.axis.iter_mut().zip(pose.0) {
            axis.position = i64::from(coordinate.0) << FRACTION;
            axis.rate = Ramp::default();
            axis.target = 0;
        }
        self.alive = 0;
        self.limited = limited;
        self.asked_load = 0;
    }

    /// Brakes in this period, whatever it is asked for; it goes on in the next one.
    pub const fn brake(&mut self) {
        self.braking = true;
    }

    /// The displacement of a tool that yields, in this period.
    pub const fn displace(&mut self, excursion: &Excursion) {
        self.excursion = *excursion;
    }

    /// That displacement.
    #[must_use]
    pub const fn excursion(&self) -> &Excursion {
        &self.excursion
    }

    /// A coordinate that is moved by something else stands at `place`: the reach is that of the true pose.
    pub fn carry(&mut self, axis: usize, place: Coordinate) {
        if let Some(axis) = self.axis.get_mut(axis) {
            axis.position = i64::from(place.0) << FRACTION;
            axis.rate = Ramp::default();
            axis.target = 0;
        }
    }

    /// New rates, in axis units per second, for so many periods.
    pub fn aim(&mut self, rates: &[i64; MAX_AXES], periods: u32) {
        for (axis, rate) in self.axis.iter_mut().zip(rates) {
            let rate = per_period((*rate).clamp(-(1 << 32), 1 << 32), self.period_us);
            axis.target = rate.max(-axis.rate_limit).min(axis.rate_limit);
        }
        self.alive = periods;
    }

    /// Brakes all coordinates.
    pub fn release(&mut self) {
        self.alive = 0;
    }

    /// Whether nothing moves.
    #[must_use]
    #[inline]
    pub fn is_still(&self) -> bool {
        self.alive == 0 && self.axis.iter().all(|axis| axis.rate.is_zero())
    }

    /// Between which positions a coordinate stays if it goes on for one period and brakes then; 2^-20 axis units, `None` when they
    /// are too far to say. The third is its largest rate, either way.
    fn sweep(axis: &Axis, target: i64) -> Option<(i64, i64, i64)> {
        let limits = axis.limits.as_ref()?;
        let mut rate = axis.rate;
        let next = axis.position.checked_add(rate.advance(target, limits))?;
        let (low, high) = rate.stopping_range(limits)?;
        Some((
            next.checked_add(low)?.min(axis.position),
            next.checked_add(high)?.max(axis.position),
            rate.peak(limits).max(axis.rate.value().abs()),
        ))
    }

    /// One period. The flag names a coordinate that was kept from going on by its soft limit, or by the machine's reach.
    pub fn advance(&mut self, machine: &impl Kinematics) -> (Wanted, Option<u8>) {
        if self.is_still() {
            let pose = self.standing();
            return (
                Wanted {
                    pose,
                    ..Wanted::default()
                },
                None,
            );
        }
        let mut limited = None;
        let braking = self.alive == 0;
        self.alive = self.alive.saturating_sub(1);
        let mut targets = [0_i64; MAX_AXES];
        if !braking {
            for (index, axis) in self.axis[..self.axes].iter().enumerate() {
                targets[index] = axis.target;
                if self.limited && Self::blocked(axis) {
                    targets[index] = 0;
                    limited = Some(index as u8);
                }
            }
            let asked = targets;
            if self.asked_load > MOST_LOAD {
                for target in &mut targets {
                    *target = slower(*target, self.asked_load);
                }
            }
            match self.loads(machine, &targets, &asked) {
                Some([load, asked_load]) => {
                    self.asked_load = asked_load;
                    if load > MOST_LOAD || core::mem::take(&mut self.braking) {
                        targets = [0; MAX_AXES];
                    }
                }
                None => {
                    limited = (0..self.axes)
                        .find(|&index| targets[index] != 0)
                        .map(|index| index as u8)
                        .or(limited);
                    targets = [0; MAX_AXES];
                }
            }
        }
        self.braking = false;
        let mut wanted = Wanted::default();
        for (index, axis) in self.axis[..self.axes].iter_mut().enumerate() {
            let Some(limits) = axis.limits else { continue };
            axis.position += axis.rate.advance(targets[index], &limits);
            wanted.pose.0[index] = Coordinate((axis.position >> FRACTION) as i32);
            wanted.rates[index] = Rate(saturate(per_second(
                axis.rate.value(),
                self.periods_per_second,
            )));
            let slope = per_second(axis.rate.slope(), self.periods_per_second);
            wanted.accelerations[index] =
                Acceleration(saturate((slope * self.periods_per_second) >> 8));
        }
        (wanted, limited)
    }

    /// Where everything is, to the whole unit below.
    fn standing(&self) -> Pose {
        let mut pose = Pose::default();
        for (place, axis) in pose.0.iter_mut().zip(&self.axis[..self.axes]) {
            *place = Coordinate((axis.position >> FRACTION) as i32);
        }
        pose
    }

    /// Whether a coordinate must brake now to stop in front of its soft limit.
    fn blocked(axis: &Axis) -> bool {
        let Some((low, high, _)) = Self::sweep(axis, axis.target) else {
            return true;
        };
        (axis.target > 0 && high > axis.high) || (axis.target < 0 && low < axis.low)
    }

    /// The loads of the joints until everything rests if it goes on towards these rates for one period and brakes then: with the rates that it has on that way, and with
    /// those that are asked for. `None` if the machine cannot take the poses.
    fn loads(
        &self,
        machine: &impl Kinematics,
        targets: &[i64; MAX_AXES],
        asked: &[i64; MAX_AXES],
    ) -> Option<[u32; 2]> {
        let mut sweep = self.sweep_to(targets)?;
        sweep.displace(&self.excursion);
        let mut rates = sweep.rates;
        for (axis, rate) in asked.iter().enumerate() {
            rates[axis] = Rate(saturate(per_second(rate.abs(), self.periods_per_second)));
        }
        sweep.load(&[sweep.rates, rates], self.axes, machine)
    }

    /// What is swept if everything goes on towards these rates for one period and brakes then; `None` if it is too far to say.
    fn sweep_to(&self, targets: &[i64; MAX_AXES]) -> Option<Sweep> {
        let mut sweep = Sweep::at(&Pose::default());
        for (index, axis) in self.axis[..self.axes].iter().enumerate() {
            let (low, high, rate) = Self::sweep(axis, targets[index])?;
            sweep.quicken(index, per_second(rate, self.periods_per_second) + 1);
            let whole = |end: i64| i32::try_from(end >> FRACTION).ok().map(Coordinate);
            (sweep.low.0[index], sweep.high.0[index]) = (whole(low)?, whole(high)?);
        }
        Some(sweep)
    }

    /// What is swept if the jog goes on for one period (or brakes already) and brakes then.
    #[must_use]
    pub fn stopping(&self, goes_on: bool) -> Option<Sweep> {
        if self.is_still() {
            return Some(Sweep::at(&self.standing()));
        }
        let mut targets = [0; MAX_AXES];
        if goes_on && self.alive > 0 {
            for (target, axis) in targets.iter_mut().zip(&self.axis) {
                *target = axis.target;
            }
        }
        self.sweep_to(&targets)
    }

    /// Whether a coordinate stays within its soft limits.
    #[must_use]
    pub fn allows(&self, axis: usize, sweep: &Sweep) -> bool {
        let (low, high) = (sweep.low.0[axis].0, sweep.high.0[axis].0);
        let axis = &self.axis[axis];
        i64::from(low) << FRACTION >= axis.low && i64::from(high) << FRACTION <= axis.high
    }
}

/// A rate that is made smaller by a load, at which the largest one of a joint is the load: to 63/64 of what would have the joint at its maximum rate.
pub(super) fn slower(rate: i64, load: u32) -> i64 {
    const AIM: i64 = (FULL_LOAD - FULL_LOAD / 64) as i64;
    (rate >> 8) * AIM / i64::from(load.max(1)) * (1 << 8)
}

/// Axis units per second -> 2^-20 axis units per period, for |rate| <= 2^32.
pub(super) fn per_period(rate: i64, period_us: u16) -> i64 {
    // 2^20 / 10^6 = 2^14 / 15625.
    (rate * i64::from(period_us) * (1 << 14)) / 15_625
}

/// 2^-20 axis units per period -> axis units per second, with so many whole periods in a second.
fn per_second(rate: i64, periods_per_second: i64) -> i64 {
    ((rate >> 8) * periods_per_second) >> 12
}

fn saturate(x: i64) -> i32 {
    x.clamp(i64::from(-i32::MAX), i64::from(i32::MAX)) as i32
}
