//! Motion at commanded rates: jogging, and the index search of homing.
//!
//! Each pose coordinate has a [`Ramp`] for its rate, which bounds acceleration and jerk for all
//! targets. A jog decelerates when its timeout ends. A coordinate decelerates so that it stops
//! before its soft limit. All coordinates decelerate together before a pose that the machine cannot
//! reach. The stopping point is checked in every control period, so the limits suffice for every
//! stop.
//!
//! Units: 2^-20 axis units (per control period) inside, axis units per second outside.

use super::PoseCommand;
use super::envelope::{Displacements, FULL_UTILISATION, MAX_UTILISATION, StoppingEnvelope};
use super::ramp::{Ramp, RampLimits};
use crate::config::{Config, JERK_SHIFT};
use crate::digest::{Constants, Digest, impl_digest};
use haptimill_kinematics::{Kinematics, Pose};
use haptimill_math::{Acceleration, Coordinate, Rate};
use haptimill_protocol::message::MAX_AXES;

/// Fraction bits of positions and rates in this module: 2^-20 axis units (per control period).
const FRACTION: u32 = 20;

#[derive(Debug, Clone, Copy, Default)]
struct JogAxis {
    /// Position, 2^-20 axis units.
    position: i64,
    /// Rate, 2^-20 axis units per control period.
    rate: Ramp,
    target: i64,
    limits: Option<RampLimits>,
    rate_limit: i64,
    /// Soft limits, 2^-20 axis units; the whole range of the number where there are none.
    low: i64,
    high: i64,
    /// What a program may be beyond them, 2^-20 axis units.
    tolerance: i64,
}

impl_digest!(JogAxis { fields { limits, rate_limit, low, high, tolerance }, nested {}, skip { position, rate, target } });

/// Motion of a coordinate in one period, and its bounds from there to standstill.
#[derive(Debug, Clone, Copy, Default)]
struct JogStep {
    target: i64,
    /// Rate after the period.
    rate: Ramp,
    /// Position after the period, 2^-20 axis units.
    position: i64,
    /// Least and greatest position up to standstill.
    low: i64,
    high: i64,
    /// Largest magnitude of the rate up to standstill.
    peak: i64,
}

impl JogAxis {
    /// Whether the coordinate wraps around.
    #[inline]
    const fn wraps(&self) -> bool {
        self.low == i64::MIN
    }

    /// Moves to a position; one that wraps around stays within half a turn of 0.
    #[inline]
    const fn set_position(&mut self, position: i64) {
        const ABOVE: u32 = 64 - 32 - FRACTION;
        self.position = if self.wraps() {
            (position << ABOVE) >> ABOVE
        } else {
            position
        };
    }
}

/// Steps of all coordinates; `None` for a coordinate whose stopping distance is not known.
type Steps = [Option<JogStep>; MAX_AXES];

/// Motion of all pose coordinates at commanded rates.
#[derive(Debug, Default)]
pub struct Jog {
    axes: usize,
    /// Coordinates that wrap around, one bit each.
    wrapping: u8,
    period_us: u16,
    /// A whole number; the configuration ensures it.
    periods_per_second: i64,
    axis: [JogAxis; MAX_AXES],
    /// Rate utilisation of the requested rates in the last control period. Above
    /// [`MAX_UTILISATION`] it scales the rates down.
    requested_utilisation: u32,
    /// Decelerate in this control period only.
    braking: bool,
    /// Compliant displacement, added to the pose.
    displacement: Displacements,
    /// Steps of this period, once they are planned.
    planned: Option<Steps>,
    /// Coordinate that its soft limit stops, in the planned steps.
    at_limit: Option<u8>,
    /// Control periods left of the jog timeout.
    periods_left: u32,
    /// Soft limits are enforced. Homing disables them, because its coordinates are not yet valid.
    limited: bool,
}

impl Constants for Jog {
    fn digest(&self, digest: &mut Digest) {
        let Self {
            axes,
            wrapping,
            period_us,
            periods_per_second,
            axis,
            requested_utilisation: _,
            braking: _,
            displacement: _,
            planned: _,
            at_limit: _,
            periods_left: _,
            limited: _,
        } = self;
        digest.add(&(axes, wrapping, period_us, periods_per_second));
        axis.iter().for_each(|axis| axis.digest(digest));
    }
}

/// Largest change of a rate in a control period, 2^-20 axis units per control period; `None` beyond
/// 63 bits.
pub(super) fn slope(acceleration: Acceleration, period_us: u16) -> Option<i64> {
    let periods = periods_per_second(period_us);
    (i64::from(acceleration.0) << (8 + FRACTION)).checked_div(periods * periods)
}

/// A whole number: the configuration check ensures it.
const fn periods_per_second(period_us: u16) -> i64 {
    1_000_000 / if period_us == 0 { 1 } else { period_us as i64 }
}

/// Bounds of a rate in 2^-20 axis units per control period, from the limits of a pose coordinate;
/// `None` if they are inconsistent.
#[must_use]
pub fn rate_limits(acceleration: Acceleration, jerk: u32, period_us: u16) -> Option<RampLimits> {
    // Long division in two steps: 128-bit division takes 1 KiB of flash. The cube is at most 10^18,
    // so no shift leaves 64 bits.
    const BELOW: u32 = 4;
    let periods = periods_per_second(period_us);
    let cube = u64::try_from(periods.checked_pow(3)?).ok()?;
    let high = u64::from(jerk) << (JERK_SHIFT + FRACTION - BELOW);
    let low = ((high % cube) << BELOW) / cube;
    let jerk = i64::try_from(((high / cube) << BELOW) + low).ok()?;
    let slope = slope(acceleration, period_us)?;
    RampLimits::new(slope, jerk.min(slope))
}

impl Jog {
    /// Creates a jog at standstill for the machine of `config`.
    #[must_use]
    pub fn new(config: &Config) -> Self {
        let mut jog = Self {
            axes: config.pose.len(),
            wrapping: config.wrapping(),
            period_us: config.period_us,
            periods_per_second: periods_per_second(config.period_us),
            ..Self::default()
        };
        for (axis, pose) in jog.axis.iter_mut().zip(&config.pose) {
            axis.limits = rate_limits(pose.acceleration, pose.jerk, config.period_us);
            axis.rate_limit = per_period(i64::from(pose.rate.0), config.period_us);
            axis.tolerance = i64::from(pose.kind.soft_limit_tolerance()) << FRACTION;
            (axis.low, axis.high) = if pose.wraps() {
                (i64::MIN, i64::MAX)
            } else {
                let [low, high] = [pose.low, pose.high].map(|end| i64::from(end.0) << FRACTION);
                (low, high)
            };
        }
        jog
    }

    /// Starts at standstill at `pose`; `limited` enables the soft limits.
    pub fn begin(&mut self, pose: &Pose, limited: bool) {
        for (axis, coordinate) in self.axis.iter_mut().zip(pose.0) {
            axis.position = i64::from(coordinate.0) << FRACTION;
            axis.rate = Ramp::default();
            axis.target = 0;
        }
        self.periods_left = 0;
        self.limited = limited;
        self.requested_utilisation = 0;
    }

    /// Coordinates that wrap around, one bit each.
    #[must_use]
    pub const fn wrapping(&self) -> u8 {
        self.wrapping
    }

    /// Decelerates in this control period, whatever the targets are. The jog resumes in the next
    /// one.
    pub const fn brake(&mut self) {
        self.braking = true;
    }

    /// Sets the compliant displacement of this control period.
    pub const fn displace(&mut self, displacement: &Displacements) {
        self.displacement = *displacement;
    }

    /// The compliant displacement of this control period.
    #[must_use]
    pub const fn displacement(&self) -> &Displacements {
        &self.displacement
    }

    /// Sets the position of a coordinate that has another source, so that the reach is that of the
    /// true pose.
    pub fn set_coordinate(&mut self, axis: usize, place: Coordinate) {
        if let Some(axis) = self.axis.get_mut(axis) {
            axis.position = i64::from(place.0) << FRACTION;
            axis.rate = Ramp::default();
            axis.target = 0;
        }
    }

    /// Sets the target rates, in axis units per second, for `periods` control periods.
    pub fn set_rates(&mut self, rates: &[i64; MAX_AXES], periods: u32) {
        for (axis, rate) in self.axis.iter_mut().zip(rates) {
            let rate = per_period((*rate).clamp(-(1 << 32), 1 << 32), self.period_us);
            axis.target = rate.max(-axis.rate_limit).min(axis.rate_limit);
        }
        self.periods_left = periods;
    }

    /// Decelerates all coordinates to standstill.
    pub fn release(&mut self) {
        self.periods_left = 0;
    }

    /// Whether all coordinates are at standstill.
    #[must_use]
    #[inline]
    pub fn is_at_standstill(&self) -> bool {
        self.periods_left == 0 && self.axis.iter().all(|axis| axis.rate.is_zero())
    }

    /// One period of a coordinate towards `target`; `None` if its stopping distance is too large to
    /// compute.
    fn step(axis: &JogAxis, target: i64) -> Option<JogStep> {
        let limits = axis.limits.as_ref()?;
        let mut rate = axis.rate;
        let position = axis.position.checked_add(rate.advance(target, limits))?;
        let (low, high, peak) = rate.stopping_bounds(limits)?;
        Some(JogStep {
            target,
            rate,
            position,
            low: position.checked_add(low)?.min(axis.position),
            high: position.checked_add(high)?.max(axis.position),
            peak: peak.max(axis.rate.value().abs()),
        })
    }

    /// Plans the steps of this period: towards the targets, less where the rate utilisation of a
    /// joint would be too large, and towards standstill where a soft limit is near.
    fn plan(&mut self) -> Steps {
        if let Some(steps) = self.planned {
            return steps;
        }
        let mut steps = [None; MAX_AXES];
        self.at_limit = None;
        for (index, axis) in self.axis[..self.axes].iter().enumerate() {
            let target = if self.requested_utilisation > MAX_UTILISATION {
                slower(axis.target, self.requested_utilisation)
            } else {
                axis.target
            };
            let mut step = Self::step(axis, target);
            if self.limited && Self::is_blocked(axis, step.as_ref()) {
                step = Self::step(axis, 0);
                self.at_limit = Some(index as u8);
            }
            steps[index] = step;
        }
        self.planned = Some(steps);
        steps
    }

    /// Steps towards standstill.
    fn brake_steps(&self) -> Steps {
        let mut steps = [None; MAX_AXES];
        for (step, axis) in steps.iter_mut().zip(&self.axis[..self.axes]) {
            *step = Self::step(axis, 0);
        }
        steps
    }

    /// Advances one control period. The number names a coordinate that was limited by its soft
    /// limit, or by the machine's reach.
    pub fn advance(&mut self, machine: &impl Kinematics) -> (PoseCommand, Option<u8>) {
        if self.is_at_standstill() {
            self.planned = None;
            let pose = self.pose();
            return (
                PoseCommand {
                    pose,
                    ..PoseCommand::default()
                },
                None,
            );
        }
        let mut limited = None;
        let mut steps = None;
        if self.periods_left > 0 {
            let planned = self.plan();
            limited = self.at_limit;
            match self.utilisations(machine, &planned) {
                Some([utilisation, requested_utilisation]) => {
                    self.requested_utilisation = requested_utilisation;
                    steps = (utilisation <= MAX_UTILISATION && !self.braking).then_some(planned);
                }
                None => {
                    let mut moving = planned.iter().take(self.axes);
                    limited = moving
                        .position(|step| step.is_none_or(|step| step.target != 0))
                        .map(|index| index as u8)
                        .or(limited);
                }
            }
        }
        self.periods_left = self.periods_left.saturating_sub(1);
        self.planned = None;
        self.braking = false;
        let mut commanded = PoseCommand::default();
        for (index, axis) in self.axis[..self.axes].iter_mut().enumerate() {
            let Some(limits) = axis.limits else { continue };
            if let Some(Some(step)) = steps.as_ref().map(|steps| steps[index]) {
                axis.rate = step.rate;
                axis.set_position(step.position);
            } else {
                let by = axis.rate.advance(0, &limits);
                axis.set_position(axis.position + by);
            }
            commanded.pose.0[index] = Coordinate((axis.position >> FRACTION) as i32);
            commanded.rates[index] = Rate(saturate(per_second(
                axis.rate.value(),
                self.periods_per_second,
            )));
            let slope = per_second(axis.rate.slope(), self.periods_per_second);
            commanded.accelerations[index] =
                Acceleration(saturate((slope * self.periods_per_second) >> 8));
        }
        (commanded, limited)
    }

    /// The present pose, rounded down to whole axis units.
    fn pose(&self) -> Pose {
        let mut pose = Pose::default();
        for (place, axis) in pose.0.iter_mut().zip(&self.axis[..self.axes]) {
            *place = Coordinate((axis.position >> FRACTION) as i32);
        }
        pose
    }

    /// Whether a coordinate must decelerate now to stop before its soft limit.
    fn is_blocked(axis: &JogAxis, step: Option<&JogStep>) -> bool {
        let Some(step) = step else {
            return true;
        };
        (axis.target > 0 && step.high > axis.high) || (axis.target < 0 && step.low < axis.low)
    }

    /// Rate utilisation of the joints up to standstill after these steps: with the rates of that
    /// motion, and with the requested rates. `None` if the machine cannot reach the poses.
    fn utilisations(&self, machine: &impl Kinematics, steps: &Steps) -> Option<[u32; 2]> {
        let mut envelope = self.envelope(steps)?;
        envelope.displace(&self.displacement);
        let mut rates = envelope.rates;
        for (index, axis) in self.axis[..self.axes].iter().enumerate() {
            // A coordinate that its soft limit stops is not asked for more.
            let stops = steps[index].is_some_and(|step| step.target == 0);
            let requested = if stops { 0 } else { axis.target.abs() };
            rates[index] = Rate(saturate(per_second(requested, self.periods_per_second)));
        }
        envelope.rate_utilisation(&[envelope.rates, rates], machine)
    }

    /// The stopping envelope after these steps; `None` if a bound is not known.
    fn envelope(&self, steps: &Steps) -> Option<StoppingEnvelope> {
        let mut envelope = StoppingEnvelope::at(&self.pose()).with_wrapping(self.wrapping);
        for (index, step) in steps[..self.axes].iter().enumerate() {
            let step = step.as_ref()?;
            let whole = |end: i64| i32::try_from(end >> FRACTION).ok().map(Coordinate);
            envelope.extend_rate(index, per_second(step.peak, self.periods_per_second) + 1);
            if self.axis[index].wraps() {
                let at = self.axis[index].position >> FRACTION;
                let (low, high) = ((step.low >> FRACTION) - at, (step.high >> FRACTION) - at);
                envelope.reach_from(index, at as i32, low, high);
                continue;
            }
            envelope.low.0[index] = whole(step.low)?;
            envelope.high.0[index] = whole(step.high)?;
        }
        Some(envelope)
    }

    /// The stopping envelope if the jog continues for one period (or decelerates now) and
    /// decelerates then.
    #[must_use]
    pub fn stopping(&mut self, continues: bool) -> Option<StoppingEnvelope> {
        if self.is_at_standstill() {
            return Some(StoppingEnvelope::at(&self.pose()).with_wrapping(self.wrapping));
        }
        let steps = if continues && self.periods_left > 0 {
            self.plan()
        } else {
            self.brake_steps()
        };
        self.envelope(&steps)
    }

    /// Whether a coordinate of `envelope` stays within its soft limits and their tolerance.
    #[must_use]
    pub fn allows(&self, axis: usize, envelope: &StoppingEnvelope) -> bool {
        let (low, high) = (envelope.low.0[axis].0, envelope.high.0[axis].0);
        let axis = &self.axis[axis];
        i64::from(low) << FRACTION >= axis.low.saturating_sub(axis.tolerance)
            && i64::from(high) << FRACTION <= axis.high.saturating_add(axis.tolerance)
    }
}

/// Scales a rate down by a rate utilisation, so that the joint of that rate utilisation moves at
/// 63/64 of its maximum rate.
pub(super) fn slower(rate: i64, utilisation: u32) -> i64 {
    const AIM: i64 = (FULL_UTILISATION - FULL_UTILISATION / 64) as i64;
    (rate >> 8) * AIM / i64::from(utilisation.max(1)) * (1 << 8)
}

/// JogAxis units per second to 2^-20 axis units per control period, for |rate| <= 2^32.
pub(super) fn per_period(rate: i64, period_us: u16) -> i64 {
    // 2^20 / 10^6 = 2^14 / 15625.
    (rate * i64::from(period_us) * (1 << 14)) / 15_625
}

/// 2^-20 axis units per control period to axis units per second, for a whole number of control
/// periods per second.
fn per_second(rate: i64, periods_per_second: i64) -> i64 {
    ((rate >> 8) * periods_per_second) >> 12
}

fn saturate(x: i64) -> i32 {
    x.clamp(i64::from(-i32::MAX), i64::from(i32::MAX)) as i32
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    proptest! {
        #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn limits_of_a_ramp_are_exact(acceleration in 1..i32::MAX, jerk: u32, down in 0_u32..32, choice in 0_usize..6) {
            let period_us = [50_u16, 100, 125, 200, 500, 1000][choice];
            let per_second = i128::from(1_000_000 / u32::from(period_us));
            let (acceleration, jerk) = (acceleration >> down.min(30), jerk >> down);
            let step = (i128::from(acceleration) << (8 + FRACTION)) / per_second.pow(2);
            let turn = (i128::from(jerk) << (JERK_SHIFT + FRACTION)) / per_second.pow(3);
            let exact = RampLimits::new(step as i64, turn.min(step) as i64);
            prop_assert_eq!(rate_limits(Acceleration(acceleration), jerk, period_us), exact);
        }
    }
}
