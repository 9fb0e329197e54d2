//! Supervision of one joint: it must follow its command, and its encoder must be plausible.
//!
//! | observation | fault |
//! | --- | --- |
//! | the joint runs away from its command, against its drive | encoder reversed, encoder stuck |
//! | the effort keeps growing and the encoder does not count | encoder stuck |
//! | the joint is beyond its stroke by more than the following error limit at rest | stroke |
//! | the following error is above its limit, which grows with the rate | following error |
//! | the encoder counts no commanded motion, or its opposite | encoder stuck, encoder reversed |
//! | the count reverses about one position faster than a slide can oscillate | encoder stuck |
//! | both channels changed at once too often | encoder illegal |
//! | the counter jumped | counter jump |
//! | steps and encoder disagree (step/dir) | steps lost |
//! | an index pulse is off its grid ([`crate::joint::index_monitor`]) | encoder slip |
//!
//! All of these need an encoder. A joint without one is supervised for one thing: the board emits
//! the steps that were commanded ([`JointMonitor::check_steps`]).
//!
//! Limits are in axis units of the joint; all of them come from its [`JointSettings`].

use crate::config::{Drive, EncoderSettings, JointSettings};
use crate::joint::reversals::Reversals;
use haptimill_math::scale::product;
use haptimill_math::{Coordinate, Effort, Rate};
use haptimill_protocol::message::Fault;

/// Inputs of the supervision of a joint in one period.
#[derive(Debug, Clone, Copy, Default)]
pub struct JointSample {
    /// Commanded position.
    pub commanded: Coordinate,
    /// Commanded rate.
    pub commanded_rate: Rate,
    /// Measured position.
    pub measured: Coordinate,
    /// Measured rate; used only where the drive [pushes](JointMonitor::pushes).
    pub rate: Rate,
    /// Encoder counts since the previous period.
    pub moved: i32,
    /// Effort commanded in the previous period (torque drives).
    pub effort: Effort,
    /// Part of that effort which accelerates the motor across the lost motion.
    pub crossing: Effort,
    /// Illegal transitions since the joint was enabled.
    pub illegal: u16,
    /// Steps emitted minus encoder (step/dir drives).
    pub step_error: Coordinate,
    /// Control period, microseconds.
    pub period_us: u16,
    /// Periods were missed just before this one, so `moved` covers several periods.
    pub missed: bool,
    /// The position is known well enough to compare it with the stroke.
    pub placed: bool,
}

/// State of the supervision of one joint.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct JointMonitor {
    /// Counts of the previous period; `None` if they cover several periods.
    moved: Option<i32>,
    /// Commanded and measured position at the start of the present motion check.
    since: Option<(Coordinate, Coordinate)>,
    /// Consecutive periods in which the joint moved against the effort of its drive.
    runaway_periods: u8,
    /// State at the last count of the encoder.
    last_count: Option<LastCount>,
    /// Reversals of the count about one position.
    reversals: Reversals,
    /// Position of the steps when the count came to the position of its reversals (step drives).
    reversal_steps: Coordinate,
}

/// The joint at the last count that cannot be a reversal about one position, or at the start of
/// commanded motion.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct LastCount {
    measured: Coordinate,
    /// Effort along the commanded direction that motion needed recently; it fades with travel.
    needed: i32,
    /// Effort from which growth is measured.
    reference: i32,
    /// Largest effort along the commanded direction since.
    peak: i32,
    /// Sign of the commanded rate.
    direction: i32,
    /// Excess of the effort over what friction can hold; effort units times periods.
    impulse: i64,
    /// The encoder counted along the commanded direction since it changed.
    follows: bool,
}

/// Consecutive periods of motion against the effort of the drive that mean a runaway. One wrong
/// rate between two edges ends sooner.
const RUNAWAY_PERIODS: u8 = 4;

/// Change of the counts between two periods up to which the jump check is skipped.
const STEADY: u32 = 8;

/// Control periods and steps by which the emitted steps may be behind their command.
const STEP_PERIODS: i64 = 8;

/// Divisor of the fade: the effort that motion needed fades by this part of its difference to the
/// present effort every two and a half counts.
const FADE: i32 = 64;

/// Largest acceleration of a motor by an impact, in multiples of its drive's limit over its
/// inertia.
const IMPACT: i64 = 24;

/// Motion of the steps after which the rotor of a step motor no longer resonates about its former
/// position, in multiples of the apparent motion by a stuck channel.
const RESONANCE: u32 = 4;

impl JointMonitor {
    /// Resets the monitor, after enabling and after the coordinate was set.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// Whether a torque drive makes at least an eighth of its limit. A joint can run away only
    /// then.
    #[must_use]
    #[inline]
    pub const fn pushes(config: &JointSettings, effort: Effort) -> bool {
        match config.drive {
            Drive::Torque { limit, .. } => effort.0.unsigned_abs() >= limit.0.unsigned_abs() / 8,
            Drive::Steps { .. } => false,
        }
    }

    /// Checks one period of `joint`.
    #[inline]
    pub fn check(
        &mut self,
        joint: u8,
        config: &JointSettings,
        encoder: &EncoderSettings,
        illegal_limit: u16,
        sample: &JointSample,
    ) -> Option<Fault> {
        if sample.illegal > illegal_limit {
            return Some(Fault::EncoderIllegal {
                joint,
                count: sample.illegal,
            });
        }
        self.check_jump(joint, config, encoder, sample)
            .or_else(|| Self::check_lost_steps(joint, config, sample))
            .or_else(|| self.check_runaway(joint, config, encoder, sample))
            .or_else(|| self.check_stuck_channel(joint, config, encoder, sample))
            .or_else(|| self.check_effort(joint, config, encoder, sample))
            .or_else(|| self.check_motion(joint, config, encoder, sample))
            .or_else(|| Self::check_stroke(joint, config, encoder, sample))
            .or_else(|| Self::check_following_error(joint, config, encoder, sample))
    }

    /// Checks one period of a joint without an encoder: the emitted steps follow the command. The
    /// pulses of a command are counted two periods later, and missed periods delay them, so the
    /// limit is the travel of eight periods at the commanded rate, plus eight steps and the
    /// backlash.
    #[cold]
    #[inline(never)]
    pub fn check_steps(joint: u8, config: &JointSettings, sample: &JointSample) -> Option<Fault> {
        let Drive::Steps { per_step, .. } = config.drive else {
            return None;
        };
        let off = difference(config, sample.commanded, sample.measured);
        let rate = i64::from(config.rate.0).abs();
        let travel = rate * i64::from(sample.period_us) * STEP_PERIODS / 1_000_000;
        let steps = (per_step.unsigned_abs() >> 24).min(1 << 20) as i64 * STEP_PERIODS;
        let limit = travel + steps + magnitude(config.backlash);
        (off.abs() > limit && !sample.missed).then_some(Fault::FollowingError {
            joint,
            error: saturate(off),
            limit: saturate(limit),
        })
    }

    /// A counter jump: the counts per period changed by more in one period than an impact can
    /// cause. The limit is 24 times the drive's limit over the inertia, plus two counts for the
    /// grid of the counter (20 um on a slide of 40 kg and 750 N). The position is unknown after it.
    /// Smaller jumps are found by the index pulses.
    #[inline]
    fn check_jump(
        &mut self,
        joint: u8,
        config: &JointSettings,
        encoder: &EncoderSettings,
        sample: &JointSample,
    ) -> Option<Fault> {
        let now = if sample.missed {
            None
        } else {
            Some(sample.moved)
        };
        let before = core::mem::replace(&mut self.moved, now).zip(now)?.0;
        let change = sample.moved.wrapping_sub(before).unsigned_abs();
        if change <= STEADY {
            return None;
        }
        Self::impact(config, encoder, sample.period_us, change).then_some(Fault::CounterJump {
            joint,
            counts: change,
        })
    }

    /// Whether `change` counts are more than an impact can cause in a period.
    #[cold]
    #[inline(never)]
    fn impact(
        config: &JointSettings,
        encoder: &EncoderSettings,
        period_us: u16,
        change: u32,
    ) -> bool {
        let Drive::Torque { limit, .. } = config.drive else {
            // [`JointMonitor::check_lost_steps`] finds lost steps.
            return false;
        };
        // Axis units per second squared (see `ServoLaw` for the 28 bits), below 2^59; a period has
        // 1000 us at most.
        let acceleration =
            (magnitude(Coordinate(limit.0)) << 28) / i64::from(config.law.inertia.max(1));
        let period = i64::from(period_us.min(1000));
        let max = acceleration.min(1 << 40) * period * period / 1_000_000_000_000 * IMPACT;
        let counts = i64::from(count(encoder));
        i64::from(change) * counts > max + 2 * counts
    }

    /// Lost steps.
    fn check_lost_steps(joint: u8, config: &JointSettings, sample: &JointSample) -> Option<Fault> {
        let Drive::Steps { lost, .. } = config.drive else {
            return None;
        };
        (magnitude(sample.step_error) > magnitude(lost)).then_some(Fault::StepsLost {
            joint,
            by: sample.step_error.0,
        })
    }

    /// The measured position against the stroke. The commanded position is always within the stroke
    /// (the solve stage checks it); the measured one may be off by the following error.
    fn check_stroke(
        joint: u8,
        config: &JointSettings,
        encoder: &EncoderSettings,
        sample: &JointSample,
    ) -> Option<Fault> {
        if !sample.placed || (config.low..=config.high).contains(&sample.measured) {
            return None;
        }
        let measured = i64::from(sample.measured.0);
        let (low, high) = (i64::from(config.low.0), i64::from(config.high.0));
        let by = measured - measured.max(low).min(high.max(low));
        (by.abs() > magnitude(encoder.following)).then_some(Fault::Stroke {
            joint,
            by: saturate(by),
        })
    }

    /// A joint that runs away from its commanded rate against the effort of its drive.
    ///
    /// With a reversed encoder the position loop is unstable: the error grows e-fold in 1/482 s at
    /// K_P = 40,000 1/s^2, K_D = 400 1/s. At a following error of 0.3 mm the slide moves at 100
    /// mm/s and coasts for millimetres with its drive off. The rate detects it sooner. Its limit is
    /// 50/s times the following error limit (15 mm/s for 0.3 mm) plus a quarter of the commanded
    /// rate. An external push stronger than the drive looks the same and is as dangerous to people
    /// nearby.
    fn check_runaway(
        &mut self,
        joint: u8,
        config: &JointSettings,
        encoder: &EncoderSettings,
        sample: &JointSample,
    ) -> Option<Fault> {
        let Drive::Torque { limit: max, .. } = config.drive else {
            return None;
        };
        if sample.effort.0.unsigned_abs() < max.0.unsigned_abs() / 8 {
            // The usual case.
            self.runaway_periods = 0;
            return None;
        }
        let commanded = i64::from(sample.commanded_rate.0);
        let off = i64::from(sample.rate.0) - commanded;
        let effort = i64::from(sample.effort.0);
        let limit = magnitude(encoder.following) * 50 + commanded.abs() / 4;
        let is_against = off.abs() > limit && effort.signum() == -off.signum();
        self.runaway_periods = if is_against {
            self.runaway_periods + 1
        } else {
            0
        };
        if self.runaway_periods < RUNAWAY_PERIODS {
            return None;
        }
        self.runaway_periods = 0;
        // With a faulty encoder the rate is off long before the error is large. If the error came
        // first, the slide is jammed and springs back on its screw.
        let error = difference(config, sample.commanded, sample.measured);
        let limit = magnitude(encoder.following) / 2;
        Some(if error.abs() > limit {
            Fault::FollowingError {
                joint,
                error: saturate(error),
                limit: saturate(limit),
            }
        } else if sample.rate.0 == 0 {
            Fault::EncoderStuck { joint }
        } else {
            Fault::EncoderReversed { joint }
        })
    }

    /// An encoder with one stuck channel. The edges of the other channel count up and down in turn,
    /// whatever is commanded, and with the drive off as well. The rotor of a step motor resonates
    /// about the position of its steps, so its reversals count only where the steps have moved on.
    #[inline]
    pub fn check_stuck_channel(
        &mut self,
        joint: u8,
        config: &JointSettings,
        encoder: &EncoderSettings,
        sample: &JointSample,
    ) -> Option<Fault> {
        let position = Coordinate(self.reversals.place());
        let is_away = sample.moved != 0
            && distance(config, sample.measured, position) > stuck_distance(encoder);
        let (now, period_us) = (sample.measured.0, sample.period_us);
        let is_stuck = self.reversals.update(sample.moved, is_away, now, period_us);
        if matches!(config.drive, Drive::Steps { .. })
            && self.resonates(config, encoder, sample, is_away)
        {
            return None;
        }
        is_stuck.then_some(Fault::EncoderStuck { joint })
    }

    /// Whether the rotor of a step motor may resonate about the position of its steps: they have
    /// not moved on since the count came to that position.
    #[cold]
    #[inline(never)]
    fn resonates(
        &mut self,
        config: &JointSettings,
        encoder: &EncoderSettings,
        sample: &JointSample,
        is_away: bool,
    ) -> bool {
        let steps = sample.measured.wrapping_add(sample.step_error);
        if is_away {
            self.reversal_steps = steps;
        }
        let moved = distance(config, steps, self.reversal_steps);
        moved <= stuck_distance(encoder).saturating_mul(RESONANCE)
    }

    /// A driven joint whose encoder does not count.
    ///
    /// The servo loop pushes a slide harder and harder while its encoder does not count, until the
    /// slide moves: 0.2 mm of commanded motion at 4 mm/s is a following error of 320 N and
    /// accelerates 40 kg to 150 mm/s. So the growth of the effort above what friction can hold is
    /// summed over time. The sum is an impulse that must have moved the joint. Its limit is the
    /// momentum at 10/s times the following error limit (3 mm/s for 0.3 mm).
    ///
    /// Growth is measured from the largest effort that motion needed recently, not from the effort
    /// at the last count: a slide with stick-slip needs little effort while it slips, and its
    /// breakaway force again afterwards. Static loads are in both efforts and cancel. The effort
    /// that accelerates the motor across the lost motion is no friction and does not count. After a
    /// standstill or a reversal growth is measured from the same effort, or from twice the friction
    /// above the present effort if that is more. Friction is the compensated friction, and at least
    /// a 32nd of the drive's limit; growth up to that value is ignored.
    ///
    /// After a reversal a slide may move on against its command by less than a stuck channel
    /// counts, and its friction changes its sign late. So each count against the command that comes
    /// before the first count along it sets the effort anew.
    fn check_effort(
        &mut self,
        joint: u8,
        config: &JointSettings,
        encoder: &EncoderSettings,
        sample: &JointSample,
    ) -> Option<Fault> {
        let Drive::Torque { limit: max, .. } = config.drive else {
            return None;
        };
        let direction = direction_of(sample.commanded_rate.0);
        let effort = sample.effort.0.saturating_sub(sample.crossing.0);
        let along = effort.saturating_mul(direction);
        let holds = friction(config, max.0.unsigned_abs()).min(1 << 28) as i32;
        let needed = self.last_count.map_or(0, |last_count| last_count.needed);
        let begun = LastCount {
            measured: sample.measured,
            needed,
            reference: along.saturating_add(2 * holds).max(needed),
            peak: along,
            direction,
            impulse: 0,
            follows: false,
        };
        let last_count = self.last_count.get_or_insert(begun);
        if direction == 0 || direction != last_count.direction {
            *last_count = begun;
            return None;
        }
        last_count.peak = last_count.peak.max(along);
        if distance(config, sample.measured, last_count.measured) > stuck_distance(encoder) {
            if difference(config, sample.measured, last_count.measured).signum()
                != i64::from(direction)
            {
                // The joint still moves against the command: friction has yet to change its sign.
                *last_count = begun;
                return None;
            }
            let fade = needed.saturating_sub(along) / FADE;
            let needed = last_count.peak.max(needed.saturating_sub(fade));
            *last_count = LastCount {
                needed,
                reference: needed,
                follows: true,
                ..begun
            };
            return None;
        }
        if !last_count.follows && sample.moved != 0 {
            last_count.follows = counts_along(encoder, sample.moved, direction);
            if !last_count.follows {
                last_count.reference = last_count.reference.max(begun.reference);
            }
        }
        let growth = i64::from(along) - i64::from(last_count.reference);
        last_count.impulse += (growth - i64::from(holds)).max(0);
        if last_count.impulse == 0 {
            return None;
        }
        let rate = (magnitude(encoder.following) * 10) >> 8;
        let momentum = (i64::from(config.law.inertia) * rate) >> 20;
        // In effort units times microseconds: the quotient of the limit would cost a division.
        let impulse = product(last_count.impulse, i64::from(sample.period_us.max(1)));
        (impulse > product(momentum, 1_000_000)).then_some(Fault::EncoderStuck { joint })
    }

    /// Commanded motion that was not measured, or was measured with the opposite sign.
    fn check_motion(
        &mut self,
        joint: u8,
        config: &JointSettings,
        encoder: &EncoderSettings,
        sample: &JointSample,
    ) -> Option<Fault> {
        let (commanded_then, measured_then) = *self
            .since
            .get_or_insert((sample.commanded, sample.measured));
        if distance(config, sample.commanded, commanded_then) < encoder.stuck_distance.magnitude() {
            return None;
        }
        let commanded = difference(config, sample.commanded, commanded_then);
        let measured = difference(config, sample.measured, measured_then);
        self.since = None;
        if measured.abs() < commanded.abs() / 8 {
            return Some(Fault::EncoderStuck { joint });
        }
        (measured.signum() != commanded.signum()).then_some(Fault::EncoderReversed { joint })
    }

    /// The following error against its limit.
    fn check_following_error(
        joint: u8,
        config: &JointSettings,
        encoder: &EncoderSettings,
        sample: &JointSample,
    ) -> Option<Fault> {
        if distance(config, sample.commanded, sample.measured) <= encoder.following.magnitude() {
            return None;
        }
        let speed = i64::from(sample.commanded_rate.0).abs();
        let limit =
            magnitude(encoder.following) + ((speed * i64::from(encoder.following_lag)) >> 16);
        let error = difference(config, sample.commanded, sample.measured);
        if error.abs() <= limit {
            return None;
        }
        Some(Fault::FollowingError {
            joint,
            error: saturate(error),
            limit: saturate(limit),
        })
    }
}

/// Sign of `value`: -1, 0 or 1, in half of the instructions of `signum`.
#[inline(always)]
const fn direction_of(value: i32) -> i32 {
    (value >> 31) | (value.wrapping_neg() as u32 >> 31) as i32
}

/// Whether `moved` counts are motion in `direction`.
const fn counts_along(encoder: &EncoderSettings, moved: i32, direction: i32) -> bool {
    (moved > 0) == ((encoder.per_count > 0) == (direction > 0))
}

/// Size of an encoder count, axis units.
fn count(encoder: &EncoderSettings) -> u32 {
    u32::try_from(encoder.per_count.unsigned_abs() >> 24).unwrap_or(u32::MAX)
}

/// Limit of the apparent motion by a stuck channel, axis units: two and a half counts. A stuck
/// channel moves the count back and forth by one.
fn stuck_distance(encoder: &EncoderSettings) -> u32 {
    count(encoder).saturating_mul(5) / 2
}

/// Effort that friction may take: the compensated friction, and at least a 32nd of the drive's
/// limit `max`.
fn friction(config: &JointSettings, max: u32) -> u32 {
    config.law.coulomb.0.unsigned_abs().max(max / 32)
}

/// Distance from `b` to `a`, in the shorter direction on a joint of one turn, axis units.
#[inline]
fn distance(config: &JointSettings, a: Coordinate, b: Coordinate) -> u32 {
    if config.kind.is_circular() {
        a.0.wrapping_sub(b.0).unsigned_abs()
    } else {
        a.0.abs_diff(b.0)
    }
}

/// `a - b`; the shorter way round on a joint of one turn.
fn difference(config: &JointSettings, a: Coordinate, b: Coordinate) -> i64 {
    if config.kind.is_circular() {
        i64::from(a.0.wrapping_sub(b.0))
    } else {
        i64::from(a.0) - i64::from(b.0)
    }
}

fn saturate(x: i64) -> i32 {
    x.clamp(i64::from(-i32::MAX), i64::from(i32::MAX)) as i32
}

fn magnitude(x: Coordinate) -> i64 {
    i64::from(x.0).abs()
}
