//! Contact-stability monitor: raises the damping of the admittance law on a stiff contact.
//!
//! **Energy.** The force in the loop is late: the peak over a revolution falls up to one revolution
//! after the force, and drive and control period add to the delay. Let the total delay be tau. On a
//! contact of stiffness k an oscillation of the tool is subject to F(t - tau) = -k p(t - tau). Its
//! part in phase with the rate is +k sin(w tau)/w p': negative damping of at most k tau. In a cycle
//! of amplitude A it adds the energy pi k tau w A^2, and K_V dissipates pi K_V w A^2. A loop with a
//! damping of at least k tau dissipates more than it gains.
//!
//! The exact limit agrees. The roots of K_A s^2 + K_V s + k e^(-s tau) are in the left half plane
//! as long as
//!
//! ```text
//! k < (K_V / tau) y / sin y     with  y tan y = K_V tau / K_A
//! ```
//!
//! (421 N/mm for K_A = 1, K_V = 5, tau = 12 ms; 383 for 13.2 ms). y / sin y is never below 1, so
//! **K_V > k tau suffices for every K_A.**
//!
//! **Observer.** k is estimated by regression of the peak force of the last revolution on the
//! *deepest measured position* of the same revolution, over the last 32 updates, four per
//! revolution. Peak and deepest position belong together for any delay of window and drive, so the
//! regression loses no phase. Deepest means towards the side on which the tool is pressed. The
//! estimate counts if the position explains at least half of the change of the force, and the force
//! changes by more than [`NOISE`]. Cutting shows about 10 N/mm, because the tool moves far at an
//! almost constant force.
//!
//! The regression restarts in two cases. A force that changes its side, as along the axes across a
//! plunge, is not that of one contact: deepest positions of both sides in one regression would
//! appear as a stiffness. While the loop is open (displacement 0, force up to f_d) the tool stays
//! at the commanded position whatever the force does. A cutting force that rises within some um at
//! the start of a feed is therefore not a contact.
//!
//! **Controller.** Level 0 is K_V alone and covers k below 20 N/mm ([`ONSET`]). Level i covers k up
//! to 2^i times that, with K_V or more: four times the damping that the stiffest of these contacts
//! needs ([`super::admittance::MARGIN`]: two for the delay that friction adds, two for the gain
//! margin), and at least critical damping, because with less the tool oscillates across the lost
//! motion of a drive without end. The added damping acts between the tool and the workpiece (p_c' +
//! p_d'), so a steady push by the commanded motion costs no force.
//!
//! A level rises at once. It falls by one when three conditions hold: [`MIN_CALM_UPDATES`] updates
//! showed no contact of this stiffness; the tool has moved by [`MIN_TRAVEL`] since it was last
//! detected; the force changed by less than half of what such a contact causes over that distance.
//! The other half allows for lost motion, which the encoders do not measure. A tool at standstill
//! gives no evidence and keeps its level. At level 0 the law is the equation alone.
//!
//! **Sign.** The same regression finds a sensor with the wrong sign: its force grows as the tool
//! moves *along* it. The check runs until the first contact shows the right sign. It does not judge
//! a tool that moves mostly across this axis (`ACROSS`): the force of such a cut grows with the
//! feed along the other axis, and the compliance along this one follows it.
//!
//! The delay must not exceed the configured one; otherwise the levels are too low.

use super::admittance::{AdmittanceLaw, ONSET};
use haptimill_math::Coordinate;
use haptimill_math::force::Force;

/// Weight of an update: 2^-5, a memory of 32 updates (8 revolutions).
const MEMORY: u32 = 5;

/// Smallest standard deviation of the force that counts as a change, 2^-16 N: 0.05 N.
pub const NOISE: i64 = 3277;

/// Smallest standard deviation of the position that counts as motion: 2^-20 mm, 0.5 um.
const MOTION: i64 = 524;

/// Smallest standard deviation of the position for a stiffness estimate: 2^-20 mm, 1.5 um, a
/// multiple of the encoder quantization. A force that varies with less motion is no contact that
/// moves the loop: a plunge displaces the tool sideways, or the tool is at standstill.
const SIGNIFICANT_MOTION: i64 = 1573;

/// Updates without a contact of this stiffness after which a level may fall.
pub const MIN_CALM_UPDATES: u8 = 48;

/// Distance over which a contact must show whether it persists, 2^-20 mm: 50 um, a multiple of the
/// lost motion of a drive.
pub const MIN_TRAVEL: i64 = 52_429;

/// Updates without a contact force after which the contact has ended: four revolutions.
const TOUCH: u8 = 16;

/// Consecutive updates with a force that grows along itself that are a wrong sign.
const WRONG_SIGN_PERIODS: u8 = 4;

/// The sign is not judged while the tool moves more than this many times as far along another axis.
const ACROSS: i32 = 4;

/// Sign of the sensor, as far as it is known.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Sign {
    /// No contact has occurred yet.
    #[default]
    Unknown,
    /// The force falls as the tool moves along it.
    Right,
    /// The force grows as the tool moves along it.
    Wrong,
}

/// Observer of one axis.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct StabilityMonitor {
    begun: bool,
    /// Range of the measured position since the last update, and in the three quarters before.
    now: Reach,
    quarters: [Reach; 3],
    /// Running means, 2^-20 mm and 2^-16 N, with [`MEMORY`] more bits each.
    mean_position: i64,
    mean_force: i64,
    /// Variances and covariance in squared raw units, below 2^54.
    position_variance: i64,
    force_variance: i64,
    covariance: i64,
    level: u8,
    calm: u8,
    /// Deepest position and peak force when the contact of this level was last detected, or when
    /// the level fell.
    shown: (i32, i32),
    /// The tool is pressed downwards.
    downward: bool,
    touch: u8,
    wrong: u8,
    sign: Sign,
    /// Range of the measured position in the last revolution, 2^-20 mm.
    extent: i32,
}

/// Range of the position in an interval.
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

/// Bound of the deviations: 16 mm, 256 N.
const WIDEST: i64 = 1 << 24;

impl StabilityMonitor {
    /// The damping level.
    #[must_use]
    pub fn level(&self) -> usize {
        usize::from(self.level)
    }

    /// Whether the peak force was at least half of the force setpoint in the last four revolutions.
    #[must_use]
    pub const fn touching(&self) -> bool {
        self.touch > 0
    }

    /// Sign of the sensor, as far as it is known.
    #[must_use]
    pub const fn sign(&self) -> Sign {
        self.sign
    }

    /// Range of the measured position in the last revolution, 2^-20 mm.
    #[must_use]
    pub const fn extent(&self) -> i32 {
        self.extent
    }

    /// Resets the contact; with `sign` the sensor must confirm its sign again.
    pub fn reset(&mut self, sign: bool) {
        *self = Self {
            sign: if sign { Sign::Unknown } else { self.sign },
            ..Self::default()
        };
    }

    /// Records the position of the tool in every control period.
    #[inline]
    pub fn record_position(&mut self, position: Coordinate) {
        self.now = self.now.with(Reach {
            low: position.0,
            high: position.0,
        });
    }

    /// Clears the recorded positions: those up to the next update count alone.
    pub fn clear_positions(&mut self) {
        self.now = Reach::default();
        self.quarters = [Reach::default(); 3];
    }

    /// Updates the monitor, four times per revolution, with the peak force, the admittance law,
    /// whether the displacement differs from 0, and the larger extent of the other axes.
    #[inline(never)]
    pub fn update(&mut self, force: Force, law: &AdmittanceLaw, is_displaced: bool, across: i32) {
        let highest = law.highest();
        let setpoint = law.settings().setpoint;
        self.touch = if force.magnitude() >= setpoint.magnitude() / 2 {
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
        self.extent = reach.high.saturating_sub(reach.low);
        let downward = force.0 < 0;
        let turned = downward != self.downward && force.magnitude() >= setpoint.magnitude() / 4;
        if turned {
            self.downward = downward;
        }
        let open = !is_displaced && force.magnitude() <= setpoint.magnitude();
        if turned || open {
            self.begun = false;
            self.position_variance = 0;
            self.force_variance = 0;
            self.covariance = 0;
        }
        // An object that presses the tool downwards is above it.
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
        self.position_variance = smoothed(self.position_variance, off * off);
        self.force_variance = smoothed(self.force_variance, more * more);
        self.covariance = smoothed(self.covariance, off * more);
        self.judge_stiffness(highest, (deepest, force.held().0));
        if self.sign == Sign::Unknown {
            if across > self.extent.saturating_mul(ACROSS) {
                self.wrong = 0;
            } else {
                self.judge_sign(force, setpoint);
            }
        }
    }

    /// Whether the position explains at least half of the variance of the force, and the variance
    /// exceeds the noise.
    fn explained(&self) -> bool {
        if self.force_variance < NOISE * NOISE {
            return false;
        }
        // covariance^2 >= variance * variance / 2, with 31 bits of each.
        let max = self
            .position_variance
            .max(self.force_variance)
            .max(self.covariance.abs());
        let shift = 33u32.saturating_sub(max.leading_zeros());
        let (position, force) = (
            self.position_variance >> shift,
            self.force_variance >> shift,
        );
        let both = self.covariance >> shift;
        both * both >= (position * force) >> 1
    }

    fn judge_stiffness(&mut self, highest: usize, now: (i32, i32)) {
        let mut level = 0;
        let is_significant = self.position_variance >= SIGNIFICANT_MOTION * SIGNIFICANT_MOTION;
        if is_significant && self.covariance < 0 && self.explained() {
            // N/mm are 2^-4 raw units of force per raw unit of position, and the onset has 8 more
            // bits.
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
        let displacement_change = (i64::from(now.0) - i64::from(self.shown.0)).abs();
        if self.calm < MIN_CALM_UPDATES || displacement_change < MIN_TRAVEL {
            return;
        }
        let change = (i64::from(now.1) - i64::from(self.shown.1)).abs();
        // Softest contact of this level; half of its force: below 2^24 * 2^21.
        let softest = i64::from(ONSET) << (self.level - 1);
        if change < (displacement_change.min(WIDEST) * softest) >> 13 {
            self.level -= 1;
        }
        self.calm = 0;
        self.shown = now;
    }

    fn judge_sign(&mut self, force: Force, setpoint: Force) {
        let is_significant = self.explained() && self.position_variance >= MOTION * MOTION;
        let strong = i64::from(force.magnitude());
        let setpoint = i64::from(setpoint.magnitude());
        if is_significant && self.covariance < 0 && strong >= setpoint / 2 {
            self.sign = Sign::Right;
        } else if is_significant && self.covariance > 0 && strong >= 2 * setpoint {
            self.wrong += 1;
            if self.wrong >= WRONG_SIGN_PERIODS {
                self.sign = Sign::Wrong;
            }
        } else {
            self.wrong = 0;
        }
    }
}

/// Running mean of squares: `mean` moves 2^-5 of the distance to `square`.
fn smoothed(mean: i64, square: i64) -> i64 {
    mean + ((square - mean) >> MEMORY)
}

/// Fall of the force (as a covariance) of a contact of stiffness [`ONSET`] at this variance of the
/// position: `variance * ONSET / 2^12`, for a variance below 2^49.
fn stiff(variance: i64) -> i64 {
    let high = (variance >> 24) * i64::from(ONSET);
    let low = (variance & 0xff_ffff) * i64::from(ONSET);
    // high * 2^24 / 2^12 is below 2^51; both products below 2^38.
    (high << 12) + (low >> 12)
}
