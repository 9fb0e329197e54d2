//! The stability guard: what a stiff contact would feed into the force loop is damped before it can.
//!
//! **The energy.** The force that the loop sees is late: a peak over a revolution falls up to one revolution after the force, the drive lags, a period passes. Let the whole delay be tau. On
//! a contact of stiffness k an oscillation of the tool sees F(t - tau) = -k p(t - tau), of which the part in phase with the rate is +k sin(w tau)/w p': negative damping, at most k tau. In a cycle
//! of amplitude A it feeds pi k tau w A^2 into the loop, and K_V takes pi K_V w A^2 out. A loop with a damping of at least k tau takes out more than it is fed.
//!
//! The exact limit says the same. K_A s^2 + K_V s + k e^(-s tau) has its roots on the left as long as
//!
//! ```text
//! k < (K_V / tau) y / sin y     with  y tan y = K_V tau / K_A
//! ```
//!
//! (421 N/mm for K_A = 1, K_V = 5, tau = 12 ms; 383 for 13.2 ms), and y / sin y is never below 1: **K_V > k tau is enough, whatever K_A is.**
//!
//! **The observer.** k is measured: the regression of the peak force of the last revolution on the *deepest measured position* of the same revolution, over the last 32 looks, four in a
//! revolution. Peak and deepest position belong together whatever the delay of the window or the drive, so the regression has no phase to lose. It counts when at least half of the change of the
//! force is explained by the position, and when the force changes by more than [`NOISE`]. Cutting shows 10 N/mm or so: there the tool goes a long way with the force almost constant. Deepest is
//! towards the side on which the tool is pressed. A force that changes its side, as along the axes across a plunge, is not that of one contact, and its regression begins anew: deepest positions of both sides
//! in one regression would be a stiffness by themselves. Nor does it count while the loop is open: a tool that has not yielded, under a force up to f_d, stays where it is desired whatever the force does. So where a
//! feed begins, and the force of the cut rises with it within some um, is no contact either.
//!
//! **The controller.** Level 0 is K_V alone and stands for k below 20 N/mm ([`ONSET`]). Level i stands for k up to 2^i of that, with K_V or more: four times the damping
//! that the stiffest of these needs ([`super::admittance::MARGIN`]: two for the delay that friction adds, two for the gain margin), and with critical damping: less of it swings across the lost motion of
//! a drive without end. What is added acts between the tool and the work (p_c' + p_d'), so a steady push by the desired motion costs no force. A level is taken at once. It is left, one at a time, when [`PATIENCE`] looks have
//! not shown a contact so stiff, and the tool has gone [`WAY`] from where it was last shown, while the force changed by less than half of what such a contact would have done on that way (the other half
//! is for lost motion, which the encoders do not see). A tool that stands still proves nothing, and keeps its level. At level 0 the law is the equation alone.
//!
//! **The sign.** By the same regression: a force that grows the further the tool goes *along* it comes from a sensor with the wrong sign. It is looked for until the first contact has
//! shown the right one.
//!
//! Misuse: a delay larger than the configured one. The levels are then too low.

use super::admittance::{AdmittanceLaw, ONSET};
use haptimill_math::Coordinate;
use haptimill_math::force::Force;

/// Weight of a look: 2^-5, a memory of 32 looks (8 revolutions).
const MEMORY: u32 = 5;

/// A change of the force with less than this deviation says nothing, 2^-16 N: 0.05 N.
pub const NOISE: i64 = 3277;

/// A deviation of the position of at least this is motion: 2^-20 mm, 0.5 um.
const MOTION: i64 = 524;

/// The least deviation of the position of which a stiffness is worked out: 2^-20 mm, 1.5 um, some times what is lost in the counts of an encoder. A force that comes and goes with less is no contact that moves
/// the loop: the tool is pushed aside by a plunge, or stands.
const TELLING: i64 = 1573;

/// Looks without a contact so stiff after which a level may be left.
pub const PATIENCE: u8 = 48;

/// The way on which a contact must show whether it is still there, 2^-20 mm: 50 um, some times the lost motion of a drive.
pub const WAY: i64 = 52_429;

/// Looks after which a contact that is not felt any more is gone: four revolutions.
const TOUCH: u8 = 16;

/// Looks in a row with the force growing along itself that are a wrong sign.
const WRONG_LOOKS: u8 = 4;

/// What is known of the sign of the sensor.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Sign {
    /// No contact yet.
    #[default]
    Unknown,
    /// The force falls when the tool yields to it.
    Right,
    /// The force grows when the tool yields to it.
    Wrong,
}

/// The observer of one axis.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct StabilityMonitor {
    begun: bool,
    /// Least and greatest measured position since the last look, and in the three quarters before.
    now: Reach,
    quarters: [Reach; 3],
    /// Running means, 2^-20 mm and 2^-16 N, with [`MEMORY`] more bits each.
    mean_position: i64,
    mean_force: i64,
    /// Variances and covariance in raw units squared, below 2^54.
    position_variance: i64,
    force_variance: i64,
    covariance: i64,
    level: u8,
    calm: u8,
    /// Deepest position and peak force when the level was last shown, or left for the one below.
    shown: (i32, i32),
    /// The tool is pressed downwards.
    downward: bool,
    touch: u8,
    wrong: u8,
    sign: Sign,
}

/// Least and greatest position of a stretch of time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Reach {
    low: i32,
    high: i32,
}

impl Default for Reach {
    fn default() -> Self {
        Self {
            low: i32::MAX,
            high: i32::MIN,
        }
    }
}

impl Reach {
    fn with(self, other: Self) -> Self {
        Self {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
        }
    }
}

/// Deviations are held within this: 16 mm, 256 N.
const WIDEST: i64 = 1 << 24;

impl StabilityMonitor {
    /// The level of damping.
    #[must_use]
    pub fn level(&self) -> usize {
        usize::from(self.level)
    }

    /// The peak force was at least half of the desired one in the last four revolutions.
    #[must_use]
    pub const fn touching(&self) -> bool {
        self.touch > 0
    }

    /// What is known of the sign.
    #[must_use]
    pub const fn sign(&self) -> Sign {
        self.sign
    }

    /// Forgets the contact; `sign` says whether the sensor must show its sign again.
    pub fn reset(&mut self, sign: bool) {
        *self = Self {
            sign: if sign { Sign::Unknown } else { self.sign },
            ..Self::default()
        };
    }

    /// Where the tool is, in every period.
    #[inline]
    pub fn note(&mut self, position: Coordinate) {
        self.now = self.now.with(Reach {
            low: position.0,
            high: position.0,
        });
    }

    /// One look, four times in a revolution: the peak force, the law that is to be guarded, and whether the tool has yielded.
    #[inline(never)]
    pub fn look(&mut self, force: Force, law: &AdmittanceLaw, yielded: bool) {
        let highest = law.highest();
        let desired = law.settings().desired;
        self.touch = if force.magnitude() >= desired.magnitude() / 2 {
            TOUCH
        } else {
            self.touch.saturating_sub(1)
        };
        let [first, second, third] = self.quarters;
        let reach = first.with(second).with(third).with(self.now);
        self.quarters = [second, third, self.now];
        self.now = Reach::default();
        if reach.low > reach.high {
            return;
        }
        let downward = force.0 < 0;
        let turned = downward != self.downward && force.magnitude() >= desired.magnitude() / 4;
        if turned {
            self.downward = downward;
        }
        let open = !yielded && force.magnitude() <= desired.magnitude();
        if turned || open {
            self.begun = false;
            self.position_variance = 0;
            self.force_variance = 0;
            self.covariance = 0;
        }
        // What presses the tool downwards is above it.
        let deepest = if self.downward { reach.high } else { reach.low };
        let position = i64::from(deepest) << MEMORY;
        let seen = i64::from(force.held().0) << MEMORY;
        if !self.begun {
            self.begun = !open;
            self.mean_position = position;
            self.mean_force = seen;
        }
        let off = ((position - self.mean_position) >> MEMORY).clamp(-WIDEST, WIDEST);
        let more = ((seen - self.mean_force) >> MEMORY).clamp(-WIDEST, WIDEST);
        self.mean_position += (position - self.mean_position) >> MEMORY;
        self.mean_force += (seen - self.mean_force) >> MEMORY;
        // Products below 2^48; sums below 2^49.
        self.position_variance = weigh(self.position_variance, off * off);
        self.force_variance = weigh(self.force_variance, more * more);
        self.covariance = weigh(self.covariance, off * more);
        self.judge_stiffness(highest, (deepest, force.held().0));
        if self.sign == Sign::Unknown {
            self.judge_sign(force, desired);
        }
    }

    /// Whether the position explains at least half of the variance of the force, and that is more than noise.
    fn explained(&self) -> bool {
        if self.force_variance < NOISE * NOISE {
            return false;
        }
        // covariance^2 >= variance * variance / 2, with 31 bits of each.
        let most = self
            .position_variance
            .max(self.force_variance)
            .max(self.covariance.abs());
        let shift = 33u32.saturating_sub(most.leading_zeros());
        let (position, force) = (
            self.position_variance >> shift,
            self.force_variance >> shift,
        );
        let both = self.covariance >> shift;
        both * both >= (position * force) >> 1
    }

    fn judge_stiffness(&mut self, highest: usize, now: (i32, i32)) {
        let mut level = 0;
        let telling = self.position_variance >= TELLING * TELLING;
        if telling && self.covariance < 0 && self.explained() {
            // N/mm are 2^-4 raw units of force per raw unit of position, and the onset has 8 more bits.
            let fell = -self.covariance;
            let mut edge = stiff(self.position_variance);
            while level < highest && fell >= edge {
                level += 1;
                edge = edge.saturating_mul(2);
            }
        }
        let level = level as u8;
        if level >= self.level {
            self.level = level;
            self.calm = 0;
            self.shown = now;
            return;
        }
        self.calm = self.calm.saturating_add(1);
        let way = (i64::from(now.0) - i64::from(self.shown.0)).abs();
        if self.calm < PATIENCE || way < WAY {
            return;
        }
        let change = (i64::from(now.1) - i64::from(self.shown.1)).abs();
        // The softest contact of this level; half of its force: below 2^24 * 2^21.
        let softest = i64::from(ONSET) << (self.level - 1);
        if change < (way.min(WIDEST) * softest) >> 13 {
            self.level -= 1;
        }
        self.calm = 0;
        self.shown = now;
    }

    fn judge_sign(&mut self, force: Force, desired: Force) {
        let telling = self.explained() && self.position_variance >= MOTION * MOTION;
        let strong = i64::from(force.magnitude());
        let desired = i64::from(desired.magnitude());
        if telling && self.covariance < 0 && strong >= desired / 2 {
            self.sign = Sign::Right;
        } else if telling && self.covariance > 0 && strong >= 2 * desired {
            self.wrong += 1;
            if self.wrong >= WRONG_LOOKS {
                self.sign = Sign::Wrong;
            }
        } else {
            self.wrong = 0;
        }
    }
}

/// A running mean of squares: `mean` goes 2^-5 of the way to `square`.
fn weigh(mean: i64, square: i64) -> i64 {
    mean + ((square - mean) >> MEMORY)
}

/// The fall of the force (as a covariance) that [`ONSET`] means at this variance of the position: `variance * ONSET / 2^12`, for a variance below 2^49.
fn stiff(variance: i64) -> i64 {
    let high = (variance >> 24) * i64::from(ONSET);
    let low = (variance & 0xff_ffff) * i64::from(ONSET);
    // high * 2^24 / 2^12 is below 2^51; both products below 2^38.
    (high << 12) + (low >> 12)
}
