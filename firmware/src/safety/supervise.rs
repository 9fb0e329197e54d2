//! Supervision of one joint: does it do what it is told, and does its encoder tell the truth?
//!
//! | what is seen | fault |
//! | --- | --- |
//! | the joint runs away from its wanted rate, against its drive | encoder reversed, encoder still |
//! | the drive pushes more and more, and the encoder does not count | encoder still |
//! | the joint is beyond its stroke by more than it may be off at rest | stroke |
//! | the error is larger than the limit, which grows with the wanted rate | following error |
//! | motion was wanted, the encoder saw none, or the opposite | encoder still, encoder reversed |
//! | the count reverses about one place faster than a slide can swing | encoder still |
//! | both channels changed at once, too often; the counter jumped | encoder illegal |
//! | steps and encoder disagree (step/dir) | steps lost |
//! | an index pulse came where none can be ([`crate::drive::index`]) | encoder slip |
//!
//! Limits are in axis units of the joint; all of them come from its [`JointAxis`].

use crate::config::{AxisKind, Drive, JointAxis};
use crate::units::{Coordinate, Effort, Rate};
use haptimill_protocol::message::Fault;

/// What supervision looks at in a period.
#[derive(Debug, Clone, Copy, Default)]
pub struct Seen {
    /// Wanted position.
    pub wanted: Coordinate,
    /// Wanted rate.
    pub wanted_rate: Rate,
    /// Measured position.
    pub measured: Coordinate,
    /// Measured rate; looked at only where the drive [pushes](Watch::pushes).
    pub rate: Rate,
    /// Encoder counts since the period before.
    pub moved: i32,
    /// What the drive was told in the period before (torque drives).
    pub effort: Effort,
    /// Illegal transitions since the joint was enabled.
    pub illegal: u16,
    /// Steps emitted less encoder (step/dir drives).
    pub steps_off: Coordinate,
    /// Control period, microseconds.
    pub period_us: u16,
    /// Periods were missed just before this one: `moved` is the motion of several.
    pub missed: bool,
}

/// The memory of supervision of one joint.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Watch {
    /// Counts of the period before, where they are those of one period.
    moved: Option<i32>,
    /// Wanted and measured position when the present stretch of motion was begun to be looked at.
    since: Option<(Coordinate, Coordinate)>,
    /// Periods in a row in which the joint ran against its drive.
    against: u8,
    /// When the encoder counted last.
    mark: Option<Mark>,
    /// Reversals of the count about one place.
    reversals: Reversals,
}

/// Reversals of a count that stays within [`still`] of one place.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Reversals {
    place: Coordinate,
    /// Sign of the newest motion.
    sign: i32,
    count: u8,
    /// Time since the first of them, microseconds.
    since_us: u32,
}

/// The joint at the newest count that cannot be a reversal about one place, or at the start of commanded motion.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Mark {
    measured: Coordinate,
    /// The effort along the commanded direction that motion needed lately; fades with the way.
    needed: i32,
    /// Growth of the effort counts from here.
    reference: i32,
    /// The largest effort along it since.
    peak: i32,
    /// Sign of the commanded rate.
    direction: i32,
    /// Excess of the effort over what friction can hold; effort units times periods.
    impulse: i64,
}

/// So many periods in a row against the drive are no chance: one wrong rate between two edges is over sooner.
const AGAINST_PERIODS: u8 = 4;

/// So many reversals about one place in this time, microseconds, come from a stuck channel: one for each two counts of motion, from 1.2 mm/s on. A loop
/// that hunts about an edge, or a slide that sticks and swings, reverses 160 times in a second, a third of it.
const REVERSALS: u8 = 24;
const REVERSAL_US: u32 = 50_000;

/// A change of the counts from one period to the next that is never looked at twice.
const STEADY: u32 = 8;

/// What motion needed fades by this part of the difference to the present effort with every two counts and a half.
const FADE: i32 = 64;

/// The acceleration that an impact may give to a motor, in terms of its drive's limit over its inertia.
const IMPACT: i64 = 24;

impl Watch {
    /// Forgets what was; after enabling and after the coordinate was set.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// Whether a torque drive makes an eighth of its limit or more: only then a joint can run away.
    #[must_use]
    #[inline]
    pub const fn pushes(config: &JointAxis, effort: Effort) -> bool {
        match config.drive {
            Drive::Torque { limit, .. } => effort.0.unsigned_abs() >= limit.0.unsigned_abs() / 8,
            Drive::Steps { .. } => false,
        }
    }

    /// Looks at one period of joint `axis`.
    #[inline]
    pub fn look(
        &mut self,
        axis: u8,
        config: &JointAxis,
        illegal_limit: u16,
        seen: &Seen,
    ) -> Option<Fault> {
        if seen.illegal > illegal_limit {
            return Some(Fault::EncoderIllegal {
                axis,
                count: seen.illegal,
            });
        }
        self.jump(axis, config, seen)
            .or_else(|| Self::slip(axis, config, seen))
            .or_else(|| self.runaway(axis, config, seen))
            .or_else(|| self.toggles(axis, config, seen))
            .or_else(|| self.pushed(axis, config, seen))
            .or_else(|| self.motion(axis, config, seen))
            .or_else(|| Self::stroke(axis, config, seen))
            .or_else(|| Self::error(axis, config, seen))
    }

    /// A counter whose rate changed by more in one period than an impact can change that of a motor: 24 times the drive's limit over the inertia, and two counts for
    /// the grid of the counter (20 um on a slide of 40 kg and 750 N). Where the joint is, is not known any more. What is less is found by its index pulses.
    #[inline]
    fn jump(&mut self, axis: u8, config: &JointAxis, seen: &Seen) -> Option<Fault> {
        let now = if seen.missed { None } else { Some(seen.moved) };
        let before = core::mem::replace(&mut self.moved, now).zip(now)?.0;
        let change = seen.moved.wrapping_sub(before).unsigned_abs();
        if change <= STEADY {
            return None;
        }
        Self::impact(config, seen.period_us, change).then_some(Fault::EncoderIllegal {
            axis,
            count: change.min(u32::from(u16::MAX)) as u16,
        })
    }

    /// Whether no impact changes the counts of a period by so much.
    #[cold]
    #[inline(never)]
    fn impact(config: &JointAxis, period_us: u16, change: u32) -> bool {
        let Drive::Torque { limit, .. } = config.drive else {
            // Lost steps are found by [`Watch::slip`].
            return false;
        };
        // Axis units per second squared (see `PositionLaw` for the 28 bits), below 2^59; a period has 1000 us at most.
        let acceleration =
            (magnitude(Coordinate(limit.0)) << 28) / i64::from(config.law.inertia.max(1));
        let period = i64::from(period_us.min(1000));
        let most = acceleration.min(1 << 40) * period * period / 1_000_000_000_000 * IMPACT;
        let counts = i64::from(count(config));
        i64::from(change) * counts > most + 2 * counts
    }

    /// Steps that were lost.
    fn slip(axis: u8, config: &JointAxis, seen: &Seen) -> Option<Fault> {
        let Drive::Steps { lost, .. } = config.drive else {
            return None;
        };
        (magnitude(seen.steps_off) > magnitude(lost)).then_some(Fault::StepsLost {
            axis,
            by: seen.steps_off.0,
        })
    }

    /// The measured joint against its stroke. What is wanted is always within (stage *place* sees to it), and what is measured may be off.
    fn stroke(axis: u8, config: &JointAxis, seen: &Seen) -> Option<Fault> {
        if (config.low..=config.high).contains(&seen.measured) {
            return None;
        }
        let measured = i64::from(seen.measured.0);
        let (low, high) = (i64::from(config.low.0), i64::from(config.high.0));
        let by = measured - measured.max(low).min(high.max(low));
        (by.abs() > magnitude(config.following)).then_some(Fault::Stroke {
            axis,
            by: saturate(by),
        })
    }

    /// A joint that runs away from its wanted rate while its drive pushes the other way.
    ///
    /// With the encoder reversed the position loop is unstable: what is off grows e-fold in 1/482 s at K_P = 40,000 1/s^2, K_D = 400 1/s. When
    /// it has become a following error of 0.3 mm the slide is at 100 mm/s and coasts for millimetres with its drive off. The rate says it
    /// sooner: 50/s times the following error (15 mm/s for 0.3 mm) and a quarter of the wanted rate. A push stronger than the
    /// drive looks the same, and is the same to whoever stands beside.
    fn runaway(&mut self, axis: u8, config: &JointAxis, seen: &Seen) -> Option<Fault> {
        let Drive::Torque { limit: most, .. } = config.drive else {
            return None;
        };
        if seen.effort.0.unsigned_abs() < most.0.unsigned_abs() / 8 {
            // Nearly always.
            self.against = 0;
            return None;
        }
        let wanted = i64::from(seen.wanted_rate.0);
        let off = i64::from(seen.rate.0) - wanted;
        let effort = i64::from(seen.effort.0);
        let limit = magnitude(config.following) * 50 + wanted.abs() / 4;
        let against = off.abs() > limit && effort.signum() == -off.signum();
        self.against = if against { self.against + 1 } else { 0 };
        if self.against < AGAINST_PERIODS {
            return None;
        }
        self.against = 0;
        // With an encoder that lies the rate is off long before the error is large. Where the error came first, the slide is jammed, and
        // springs back on its screw.
        let error = difference(config, seen.wanted, seen.measured);
        let limit = magnitude(config.following) / 2;
        Some(if error.abs() > limit {
            Fault::FollowingError {
                axis,
                error: saturate(error),
                limit: saturate(limit),
            }
        } else if seen.rate.0 == 0 {
            Fault::EncoderStill { axis }
        } else {
            Fault::EncoderReversed { axis }
        })
    }

    /// An encoder with one stuck channel: the other one goes on, and its edges count up and down in turn, whatever is commanded.
    #[inline]
    fn toggles(&mut self, axis: u8, config: &JointAxis, seen: &Seen) -> Option<Fault> {
        let reversals = &mut self.reversals;
        if seen.moved != 0 {
            let sign = way(seen.moved);
            if distance(config, seen.measured, reversals.place) > still(config) {
                *reversals = Reversals {
                    place: seen.measured,
                    sign,
                    ..Reversals::default()
                };
            } else if sign != reversals.sign {
                reversals.sign = sign;
                reversals.count += 1;
                if reversals.count >= REVERSALS {
                    reversals.count = 0;
                    return Some(Fault::EncoderStill { axis });
                }
            }
        }
        if reversals.count != 0 {
            reversals.since_us = reversals.since_us.saturating_add(u32::from(seen.period_us));
            if reversals.since_us > REVERSAL_US {
                reversals.count /= 2;
                reversals.since_us /= 2;
            }
        } else {
            reversals.since_us = 0;
        }
        None
    }

    /// A joint that is driven, and whose encoder does not count.
    ///
    /// The loop pushes a slide whose encoder stands still harder and harder, and the slide goes: 0.2 mm of commanded motion at 4 mm/s, which is a
    /// following error of 320 N, sets 40 kg going at 150 mm/s. So the growth of the effort is summed up over time, less what friction can hold: an impulse that must have set the
    /// joint moving. It may be that of 12.5/s times the following error (4 mm/s for 0.3 mm).
    ///
    /// Growth counts from the largest effort that motion needed lately, not from that of the newest count: a slide that sticks and slips needs little as it slips, and
    /// its breakaway force again afterwards. Static loads are in both, and do not count. After a rest or a reversal it counts from there, or from twice the friction above the
    /// present effort. Friction is what is compensated, and no less than a 32nd of the drive's limit; so much growth is let pass.
    fn pushed(&mut self, axis: u8, config: &JointAxis, seen: &Seen) -> Option<Fault> {
        let Drive::Torque { limit: most, .. } = config.drive else {
            return None;
        };
        let direction = way(seen.wanted_rate.0);
        let along = seen.effort.0.saturating_mul(direction);
        let holds = friction(config, most.0.unsigned_abs()).min(1 << 28) as i32;
        let needed = self.mark.map_or(0, |mark| mark.needed);
        let begun = Mark {
            measured: seen.measured,
            needed,
            reference: along.saturating_add(2 * holds).max(needed),
            peak: along,
            direction,
            impulse: 0,
        };
        let mark = self.mark.get_or_insert(begun);
        if direction == 0 || direction != mark.direction {
            *mark = begun;
            return None;
        }
        mark.peak = mark.peak.max(along);
        if distance(config, seen.measured, mark.measured) > still(config) {
            let fade = needed.saturating_sub(along) / FADE;
            let needed = mark.peak.max(needed.saturating_sub(fade));
            *mark = Mark {
                needed,
                reference: needed,
                ..begun
            };
            return None;
        }
        let growth = i64::from(along) - i64::from(mark.reference);
        mark.impulse += (growth - i64::from(holds)).max(0);
        if mark.impulse == 0 {
            // No limit is below it, and a limit costs a division.
            return None;
        }
        let rate = (magnitude(config.following) * 25 / 2) >> 8;
        let momentum = (i64::from(config.law.inertia) * rate) >> 20;
        let limit = momentum * 1_000_000 / i64::from(seen.period_us.max(1));
        (mark.impulse > limit).then_some(Fault::EncoderStill { axis })
    }

    /// Motion that was wanted and not seen, or seen the other way round.
    fn motion(&mut self, axis: u8, config: &JointAxis, seen: &Seen) -> Option<Fault> {
        let (wanted_then, measured_then) = *self.since.get_or_insert((seen.wanted, seen.measured));
        if distance(config, seen.wanted, wanted_then) < config.still.magnitude() {
            return None;
        }
        let wanted = difference(config, seen.wanted, wanted_then);
        let measured = difference(config, seen.measured, measured_then);
        self.since = None;
        if measured.abs() < wanted.abs() / 8 {
            return Some(Fault::EncoderStill { axis });
        }
        (measured.signum() != wanted.signum()).then_some(Fault::EncoderReversed { axis })
    }

    /// The following error against its limit.
    fn error(axis: u8, config: &JointAxis, seen: &Seen) -> Option<Fault> {
        if distance(config, seen.wanted, seen.measured) <= config.following.magnitude() {
            return None;
        }
        let speed = i64::from(seen.wanted_rate.0).abs();
        let limit = magnitude(config.following) + ((speed * i64::from(config.following_lag)) >> 16);
        let error = difference(config, seen.wanted, seen.measured);
        if error.abs() <= limit {
            return None;
        }
        Some(Fault::FollowingError {
            axis,
            error: saturate(error),
            limit: saturate(limit),
        })
    }
}

/// The sign: -1, 0 or 1, in half of the instructions of `signum`.
#[inline(always)]
const fn way(value: i32) -> i32 {
    (value >> 31) | (value.wrapping_neg() as u32 >> 31) as i32
}

/// A count of a joint's encoder, axis units.
fn count(config: &JointAxis) -> u32 {
    u32::try_from(config.per_count.unsigned_abs() >> 24).unwrap_or(u32::MAX)
}

/// Motion that a stuck channel, which lets the count go to and fro by one, cannot show.
fn still(config: &JointAxis) -> u32 {
    count(config).saturating_mul(5) / 2
}

/// Effort that friction may take: what is compensated, and no less than a 32nd of the drive's limit `most`.
fn friction(config: &JointAxis, most: u32) -> u32 {
    config.law.coulomb.0.unsigned_abs().max(most / 32)
}

/// How far it is from `b` to `a`; the shorter way round on a rotary joint.
#[inline]
fn distance(config: &JointAxis, a: Coordinate, b: Coordinate) -> u32 {
    match config.kind {
        AxisKind::Linear => a.0.abs_diff(b.0),
        AxisKind::Rotary => a.0.wrapping_sub(b.0).unsigned_abs(),
    }
}

/// `a - b`; the shorter way round on a rotary joint.
fn difference(config: &JointAxis, a: Coordinate, b: Coordinate) -> i64 {
    match config.kind {
        AxisKind::Linear => i64::from(a.0) - i64::from(b.0),
        AxisKind::Rotary => i64::from(a.0.wrapping_sub(b.0)),
    }
}

fn saturate(x: i64) -> i32 {
    x.clamp(i64::from(-i32::MAX), i64::from(i32::MAX)) as i32
}

fn magnitude(x: Coordinate) -> i64 {
    i64::from(x.0).abs()
}
