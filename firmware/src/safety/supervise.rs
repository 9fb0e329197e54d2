//! Supervision of one joint: does it do what it is told, and does its encoder tell the truth?
//!
//! | what is seen | fault |
//! | --- | --- |
//! | the joint runs away from its wanted rate, against its drive | encoder reversed, encoder still |
//! | the drive pushes more and more, and the encoder does not count | encoder still |
//! | the joint is beyond its stroke by more than it may be off at rest | stroke |
//! | the error is larger than the limit, which grows with the wanted rate | following error |
//! | motion was wanted, the encoder saw none, or the opposite | encoder still, encoder reversed |
//! | both channels changed at once, too often | encoder illegal |
//! | steps and encoder disagree (step/dir) | steps lost |
//! | an index pulse came where none can be ([`crate::drive::index`]) | encoder slip |
//!
//! Limits are in axis units of the joint; all of them come from its [`JointAxis`].

use crate::config::{AxisKind, Drive, JointAxis};
use crate::safety::integrity::constants;
use haptimill_math::{Coordinate, Effort, Rate};
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
}

/// The part of it that a glance is at.
#[derive(Debug, Clone, Copy)]
pub struct Glimpse {
    /// Wanted position.
    pub wanted: Coordinate,
    /// Wanted rate.
    pub wanted_rate: Rate,
    /// Measured position.
    pub measured: Coordinate,
    /// Encoder counts since the period before.
    pub moved: i32,
    /// What the drive was told in the period before (torque drives).
    pub effort: Effort,
}

impl From<&Seen> for Glimpse {
    #[inline(always)]
    fn from(seen: &Seen) -> Self {
        Self {
            wanted: seen.wanted,
            wanted_rate: seen.wanted_rate,
            measured: seen.measured,
            moved: seen.moved,
            effort: seen.effort,
        }
    }
}

/// What a glance at a joint needs, worked out from its configuration once. Within these bounds nothing is wrong; beyond them something may be.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
struct Bounds {
    /// An eighth of the effort that a torque drive may make; 0 on a step/dir axis, at which a glance is never enough.
    weak: u32,
    /// Motion that a stuck channel cannot show.
    still: i32,
    /// Effort that friction may take.
    friction: i32,
    /// Error that is allowed at rest.
    following: i32,
    /// One less than the wanted motion after which the measured one is compared with it.
    stretch: i32,
    /// Lower end of the stroke, and its length.
    low: Coordinate,
    width: u32,
}

/// The widest bound of a glance: 64 mm. Strokes end at 1900 mm, so two places that are farther apart do not seem nearer around the ends of the type.
const WIDEST: u32 = 64 << 20;

/// The memory of supervision of one joint.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Watch {
    bounds: Bounds,
    /// Wanted and measured position when the present stretch of motion was begun to be looked at.
    since: Option<(Coordinate, Coordinate)>,
    /// Periods in a row in which the joint ran against its drive.
    against: u8,
    /// When the encoder counted last.
    mark: Option<Mark>,
    /// Time since it had turned round [`TURNS`] times, microseconds. Not in the mark, which is made anew in nearly every period.
    turning_us: u32,
}

constants!(Watch { bounds } of {} but { since, against, mark, turning_us });

/// How a joint was when its encoder counted last, or when motion began to be wanted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Mark {
    measured: Coordinate,
    wanted: Coordinate,
    effort: Effort,
    /// How often the counts turned round since then, and which way they went last.
    turns: u8,
    last: i32,
    /// Which way motion is wanted since then.
    direction: i32,
    /// It stood, or turned round: friction has yet to be overcome.
    standing: bool,
    /// What the drive pushed since then, beyond what friction may have taken; effort units times periods.
    impulse: i64,
}

/// So many periods in a row against the drive are no chance: one wrong rate between two edges is over sooner.
const AGAINST_PERIODS: u8 = 4;

/// A count that turned round so often, while so many counts of motion were wanted one way, has a stuck channel.
const TURNS: u8 = 8;
const COUNTS: u32 = 10;

/// So many more within this time, microseconds, are no slide that sticks and swings, nor a loop that hunts about an edge (both do some 160 in a second): it runs, a
/// turn for each two counts, however little was wanted.
const MORE_TURNS: u8 = 24;
const FAST_US: u32 = 40_000;

impl Watch {
    /// Supervision of the joint of a configuration, with nothing seen yet.
    #[must_use]
    pub fn of(config: &JointAxis) -> Self {
        let held = |bound: u32| bound.min(WIDEST) as i32;
        let most = match config.drive {
            Drive::Torque { limit, .. } => limit.0.unsigned_abs(),
            Drive::Steps { .. } => 0,
        };
        Self {
            bounds: Bounds {
                weak: most / 8,
                still: held(still(config)),
                friction: friction(config, most).min(1 << 28) as i32,
                following: held(config.following.magnitude()),
                stretch: held(config.still.magnitude()).wrapping_sub(1),
                low: config.low,
                width: if config.low <= config.high {
                    config.high.0.wrapping_sub(config.low.0) as u32
                } else {
                    0
                },
            },
            ..Self::default()
        }
    }

    /// Forgets what was; after enabling and after the coordinate was set.
    pub fn reset(&mut self) {
        *self = Self {
            bounds: self.bounds,
            ..Self::default()
        };
    }

    /// Whether a torque drive makes an eighth of its limit or more: only then a joint can run away.
    #[must_use]
    pub const fn pushes(&self, effort: Effort) -> bool {
        self.bounds.weak != 0 && effort.0.unsigned_abs() >= self.bounds.weak
    }

    /// Looks at one period of joint `axis`, of whose configuration it was [made](Self::of).
    #[inline]
    pub fn look(
        &mut self,
        axis: u8,
        config: &JointAxis,
        illegal_limit: u16,
        seen: &Seen,
    ) -> Option<Fault> {
        if seen.illegal <= illegal_limit && self.glance(&Glimpse::from(seen)) {
            return None;
        }
        self.examine(axis, config, illegal_limit, seen)
    }

    /// Whether the period is one of those in which nothing can be wrong: nearly all are. It is noted then as [`Watch::examine`] would note it; otherwise
    /// nothing has changed.
    #[inline(always)]
    pub fn glance(&mut self, seen: &Glimpse) -> bool {
        let bounds = &self.bounds;
        if seen.effort.0.unsigned_abs() >= bounds.weak
            || !within(seen.wanted, seen.measured, bounds.following)
            || seen.measured.0.wrapping_sub(bounds.low.0) as u32 > bounds.width
        {
            return false;
        }
        let since = match self.since {
            Some(begun) if within(seen.wanted, begun.0, bounds.stretch) => Some(begun),
            // The stretch is over, and was gone; in the next period another one is begun.
            Some(begun) if kept_up(seen, begun) => None,
            Some(_) => return false,
            None => Some((seen.wanted, seen.measured)),
        };
        let Some(mark) = &mut self.mark else {
            return false;
        };
        let direction = way(seen.wanted_rate.0);
        if direction != mark.direction || direction == 0 {
            *mark = Mark::of(seen, true);
        } else if !within(seen.measured, mark.measured, bounds.still) {
            *mark = Mark::of(seen, false);
        } else {
            let grown = seen.effort.0.saturating_sub(mark.effort.0);
            let grown = if direction < 0 {
                grown.saturating_neg()
            } else {
                grown
            };
            // Twice as much again where it has yet to be overcome.
            let friction = bounds.friction * if mark.standing { 3 } else { 1 };
            if mark.turns >= TURNS || grown > friction || !mark.counts_on(seen.moved) {
                return false;
            }
        }
        self.since = since;
        self.against = 0;
        true
    }

    /// Looks at everything.
    #[inline(never)]
    pub fn examine(
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
        Self::jump(axis, config, seen)
            .or_else(|| Self::slip(axis, config, seen))
            .or_else(|| self.runaway(axis, config, seen))
            .or_else(|| self.pushed(axis, config, seen))
            .or_else(|| self.motion(axis, config, seen))
            .or_else(|| Self::stroke(axis, config, seen))
            .or_else(|| Self::error(axis, config, seen))
    }

    /// A counter that went farther in one period than a joint can: twice what it may be off, and twice what was wanted of it. So where the joint is
    /// is not known any more. A jump that is smaller than what a joint may be off is not seen before the next search for the reference.
    fn jump(axis: u8, config: &JointAxis, seen: &Seen) -> Option<Fault> {
        let following = config.following.magnitude();
        if distance(config, seen.wanted, seen.measured) <= following {
            return None;
        }
        let moved = u64::from(seen.moved.unsigned_abs()) * u64::from(count(config));
        let rate = u64::from(seen.wanted_rate.0.unsigned_abs());
        let wanted = rate * u64::from(seen.period_us) / 1_000_000;
        let possible = 2 * (u64::from(following) + wanted);
        (moved > possible).then_some(Fault::EncoderIllegal {
            axis,
            count: seen.moved.unsigned_abs().min(u32::from(u16::MAX)) as u16,
        })
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

    /// A joint that is pushed, and whose encoder does not count.
    ///
    /// The loop pushes a slide whose encoder stands still harder and harder, and the slide goes: 0.2 mm of wanted motion at 4 mm/s, which is a
    /// following error of 320 N, sets 40 kg going at 150 mm/s. So the push is summed up from the last count on: what it grew by since, less
    /// friction (what is compensated, and no less than a 32nd of the drive's limit; three times that after the joint stood or turned round), is an impulse that must have set the joint moving.
    /// It may be that of 12.5/s times the following error (4 mm/s for 0.3 mm). Static loads do not grow, and do not count.
    ///
    /// At creeping speeds that takes millimetres. But there a stuck channel gives itself away: the other one goes on, and its edges count up and down in
    /// turn. A slide that sticks may swing over an edge as well, so some of them count only together with a wanted motion of more than it may stick for; as many as no slide that swings makes
    /// in so short a time count alone. (At 0.02 mm/s the wanted motion takes 0.6 s, and in that time the slide ran 29 mm.)
    fn pushed(&mut self, axis: u8, config: &JointAxis, seen: &Seen) -> Option<Fault> {
        let Drive::Torque { limit: most, .. } = config.drive else {
            return None;
        };
        let direction = seen.wanted_rate.0.signum();
        let mark = self.mark.get_or_insert(Mark::of(&seen.into(), true));
        if direction == 0 || direction != mark.direction {
            *mark = Mark::of(&seen.into(), true);
            return None;
        }
        if distance(config, seen.measured, mark.measured) > still(config) {
            *mark = Mark::of(&seen.into(), false);
            return None;
        }
        if seen.moved.signum() == -mark.last && mark.last != 0 {
            mark.turns = mark.turns.saturating_add(1);
        }
        if seen.moved != 0 {
            mark.last = seen.moved.signum();
        }
        self.turning_us = if mark.turns < TURNS {
            0
        } else {
            self.turning_us.saturating_add(u32::from(seen.period_us))
        };
        if mark.turns >= TURNS
            && (mark.turns_fast(&mut self.turning_us)
                || distance(config, seen.wanted, mark.wanted)
                    > count(config).saturating_mul(COUNTS))
        {
            return Some(Fault::EncoderStill { axis });
        }
        let growth = (i64::from(seen.effort.0) - i64::from(mark.effort.0)) * i64::from(direction);
        let friction =
            i64::from(friction(config, most.0.unsigned_abs())) * if mark.standing { 3 } else { 1 };
        mark.impulse += (growth - friction).max(0);
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

impl Mark {
    /// Here motion begins to be looked at; the joint is `standing` where friction has yet to be overcome.
    #[inline(always)]
    fn of(seen: &Glimpse, standing: bool) -> Self {
        Self {
            measured: seen.measured,
            wanted: seen.wanted,
            effort: seen.effort,
            turns: 0,
            last: way(seen.moved),
            direction: way(seen.wanted_rate.0),
            standing,
            impulse: 0,
        }
    }

    /// One period with [`TURNS`] turns or more, `turning_us` after the first of them: whether [`MORE_TURNS`] came within [`FAST_US`]. Slower ones are counted anew.
    const fn turns_fast(&mut self, turning_us: &mut u32) -> bool {
        if *turning_us > FAST_US {
            *turning_us = 0;
            self.turns = TURNS;
        }
        self.turns >= TURNS + MORE_TURNS
    }

    /// Notes which way the encoder counted, unless that is the opposite of the way it counted last.
    #[inline(always)]
    const fn counts_on(&mut self, moved: i32) -> bool {
        if moved == 0 {
            return true;
        }
        let way = way(moved);
        if self.last == 0 {
            self.last = way;
        }
        self.last == way
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

/// Whether two places are no farther apart than `bound`, which is below 2^30; around the ends of the type they are near to each other.
#[inline(always)]
const fn within(a: Coordinate, b: Coordinate, bound: i32) -> bool {
    a.0.wrapping_sub(b.0).wrapping_add(bound) as u32 <= (bound as u32).wrapping_mul(2)
}

/// Whether at least an eighth of the motion that was wanted since then was measured, the same way; false also where ways are too long to tell at a glance.
#[inline(always)]
const fn kept_up(seen: &Glimpse, (wanted, measured): (Coordinate, Coordinate)) -> bool {
    let wanted = seen.wanted.0.wrapping_sub(wanted.0);
    let measured = seen.measured.0.wrapping_sub(measured.0);
    let (asked, gone) = (wanted.unsigned_abs(), measured.unsigned_abs());
    wanted ^ measured >= 0 && gone >= asked / 8 && gone != 0 && (asked | gone) < WIDEST
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
