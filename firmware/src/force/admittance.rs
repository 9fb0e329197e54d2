//! Admittance law of one axis: the compliant displacement from the peak force (docs/control.md
//! (3.30)-(3.33), in the sign form of 3.3).
//!
//! ```text
//! K_A p_c'' + K_V p_c' = F - sigma f_d     sigma p_c >= 0     p_r = p_d + p_c
//! ```
//!
//! F is the peak force on the tool. sigma is the side of the displacement: the sign of p_c, or of F
//! while p_c is 0. This module counts all values in the direction of sigma, *outward*, so the
//! displacement is never negative. A force above f_d moves the tool outward. Below f_d the tool
//! returns at up to f_d / K_V, and stops at 0.
//!
//! The implementation extends the equation:
//! - **Enable condition.** While it is false ([`EnableCondition`]) a force does not push outward.
//!   The rate decays, and the tool returns as soon as the force is below f_d.
//! - **Limit.** Towards the largest displacement the tool moves at most 1/64 of the remaining
//!   displacement per control period. A limit that is lowered too far to be reached in this way
//!   first allows the distance in which the rate ends, and then follows the returning tool.
//! - **End of the return.** The return moves at most 1/64 of the remaining displacement per control
//!   period. Without this the rate would fall from f_d / K_V to 0 in one period (10 mm/s for K_V =
//!   0.5).
//! - **Contact-stability monitor.** On a stiff contact a damper acts between the tool and the
//!   *workpiece*, D (p_c' + p_d'), see [`super::stability`]. A damper between the tool and the
//!   commanded position would raise the force while the commanded position still advances. Without
//!   contact, and against a retreat, the damper's force is at most f_d: it neither moves a free
//!   tool away nor keeps it displaced.
//! - **Rest.** A drive with friction and lost motion does not follow a creeping reference: the tool
//!   is at rest, the reference winds up, and later the tool moves at once by more than its error.
//!   On a stiff contact (level 1 and above), while the commanded position is constant, the tool
//!   therefore moves at least at the creep rate v_c, or rests. It comes to rest when the error
//!   falls below D v_c / 8, rests while the error is below D v_c / 2 (f_d / 2 at most), and then
//!   moves again at v_c or faster. See [`AdmittanceLaw::resting_below`]; without a creep rate the
//!   tool does not rest.
//!
//! A change of gains or of f_d changes the acceleration; displacement and rate are continuous, so
//! the tool does not jump. When the inverse kinematics refuses the reference,
//! [`AdmittanceAxis::roll_back`] undoes the last control period: the displacement keeps its
//! previous value and the rate is 0, so nothing winds up.
//!
//! **Error.** The displacement differs from the same law in f64 by less than 2^-37 mm per control
//! period and 2^-28 of the distance moved.
//!
//! Callers must pass the reaction on the tool. With the wrong sign the loop moves the tool into the
//! workpiece; [`super::stability`] detects that.

use super::zero_order_hold::{FINENESS, Part, RATE_BITS, ZeroOrderHold, sound};
use super::{EnableCondition, ForceParameter, ForceRefusal, LoopSettings};
use crate::digest::impl_digest;
use crate::rate_filter::frequency;
use haptimill_math::force::{Displacement, Force, VirtualDamping};
use haptimill_math::scale::{multiply_shift, saturate};
use haptimill_math::{Acceleration, Length, Rate};

/// Number of damping levels: K_V alone, and 7 with more.
pub const LEVELS: usize = 8;

/// Stiffest contact that the contact-stability monitor covers, N/mm.
pub const STIFFEST: u32 = 1000;

/// Ratio of the damping of a level to the damping that its stiffest contact needs, at least.
pub const MARGIN: u32 = 4;

/// Stiffness up to which the monitor ignores a contact, N/mm: cutting occasionally appears as stiff
/// as this.
pub const SOFT: u32 = 20;

/// Apparent contact stiffness at which level 1 begins, 2^-8 N/mm; level i begins at 2^(i - 1) times
/// this.
pub const ONSET: u32 = SOFT << 8;

/// K_V of 0.1 N s/mm: below this, [`ZeroOrderHold`] has no scale for T / K_V.
const MIN_DAMPING: u64 = 6554;

/// Displacements below this are 0: 2^-20 mm.
const NOTHING: i64 = 1 << 20;

/// Largest compliance limit, mm.
pub const LARGEST_LIMIT: Length = Length::millimetres(64);

/// Compliant displacement of one axis in a control period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Compliance {
    /// p_c.
    pub displacement: Displacement,
    /// p_c'.
    pub rate: Rate,
    /// p_c''.
    pub acceleration: Acceleration,
    /// The displacement is at its limit, and the force would increase it.
    pub limited: bool,
}

/// Admittance law with its coefficients for every damping level.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct AdmittanceLaw {
    settings: LoopSettings,
    poles: [ZeroOrderHold; LEVELS],
    /// Damping that each level adds to K_V, 2^-16 N s/mm, below 2^31.
    added: [i32; LEVELS],
    highest: usize,
    /// Displacement per control period at the maximum rate, in the scale of the rate.
    rate_limit: i64,
    /// Largest displacement, 2^-40 mm.
    limit: i64,
    /// Conversion from the scale of the rate to 2^-20 mm/s.
    to_rate: Part,
    /// Creep rate in the scale of the rate, and the force D v_c on each level to move at it, 2^-16
    /// N.
    creep: i64,
    creeping: [i32; LEVELS],
    frequency: u32,
}

impl AdmittanceLaw {
    /// Creates a law with only its first level computed. [`AdmittanceLaw::prepare`] computes the
    /// others, one per control period: each takes about 2000 instructions.
    ///
    /// `delay_us` is the delay that the monitor assumes from a change of the tool's position to a
    /// change of the peak force: window of the peak, drive, latch.
    ///
    /// # Errors
    ///
    /// Returns the first invalid parameter, with its bound.
    pub fn begin(
        settings: &LoopSettings,
        period_us: u16,
        delay_us: u32,
        largest_force: Force,
    ) -> Result<Self, ForceRefusal> {
        let delay_us = delay_us.clamp(1, DELAY_MAX_US);
        let highest = check(settings, period_us, delay_us, largest_force)?;
        let first = ZeroOrderHold::new(settings.mass, settings.damping, period_us);
        let mut added = [0; LEVELS];
        for (level, added) in added.iter_mut().enumerate() {
            *added =
                (damping(settings, delay_us, level.min(highest)).0 - settings.damping.0) as i32;
        }
        Ok(Self {
            settings: settings.clone(),
            poles: [first; LEVELS],
            added,
            highest,
            rate_limit: rate_per_period(i64::from(settings.rate.0.max(1)), period_us),
            limit: Displacement::from_length(settings.limit).0,
            // 10^6 / T_us / 2^(20 + FINENESS), below 1.
            to_rate: Part::ratio(1_000_000, u64::from(period_us.max(1)) << (20 + FINENESS)),
            creep: 0,
            creeping: [0; LEVELS],
            frequency: frequency(period_us),
        })
    }

    /// The same law for a drive that does not follow a reference slower than `creep` (its magnitude
    /// counts): on a stiff contact the tool moves at least at this rate, or rests. 0 is a drive
    /// that follows any rate.
    #[must_use]
    pub fn resting_below(mut self, creep: Rate, period_us: u16) -> Self {
        let creep = u64::from(creep.0.unsigned_abs());
        self.creep = rate_per_period(creep as i64, period_us);
        for (creeping, added) in self.creeping.iter_mut().zip(self.added) {
            // Below 2^27 + 2^31, times 2^31.
            let damping = u64::from(self.settings.damping.0.saturating_add_signed(added));
            *creeping = ((damping * creep) >> 20).min(Force::MAX.0 as u64) as i32;
        }
        self
    }

    /// Computes one damping level.
    #[cold]
    pub fn prepare(&mut self, level: usize, period_us: u16) {
        let added = self.added.get(level).copied().unwrap_or(0);
        let damping = VirtualDamping(self.settings.damping.0.saturating_add_signed(added));
        if let Some(pole) = self.poles.get_mut(level) {
            *pole = ZeroOrderHold::new(self.settings.mass, damping, period_us);
        }
    }

    /// Creates a law with all its levels, for a configuration.
    ///
    /// # Errors
    ///
    /// As [`AdmittanceLaw::begin`].
    pub fn new(
        settings: &LoopSettings,
        period_us: u16,
        delay_us: u32,
        largest_force: Force,
    ) -> Result<Self, ForceRefusal> {
        let mut law = Self::begin(settings, period_us, delay_us, largest_force)?;
        for level in 1..LEVELS {
            law.prepare(level, period_us);
        }
        Ok(law)
    }

    /// The settings of this law.
    #[must_use]
    pub const fn settings(&self) -> &LoopSettings {
        &self.settings
    }

    /// The highest damping level of this law.
    #[must_use]
    pub const fn highest(&self) -> usize {
        self.highest
    }
}

/// Longest delay accepted: half a second.
const DELAY_MAX_US: u32 = 500_000;

/// 2^-20 mm/s to 2^-(40 + FINENESS) mm per control period: below 2^31 * 2^10 * 2^20 / 10^6 before
/// it is clamped.
fn rate_per_period(rate: i64, period_us: u16) -> i64 {
    (rate * i64::from(period_us) * (1 << 20) / 1_000_000).min(1 << RATE_BITS) << FINENESS
}

/// Damping of a level for its stiffest contact, k = 2^level [`ONSET`]: the largest of [`MARGIN`] k
/// tau for the delay, 2 sqrt(k K_A) against oscillation, and K_V.
fn damping(settings: &LoopSettings, delay_us: u32, level: usize) -> VirtualDamping {
    let lowest = settings.damping;
    if level == 0 {
        return lowest;
    }
    let stiffest = u64::from(ONSET) << level;
    // 2^-8 N/mm * us: below 2^21 * 2^19 * 4.
    let product = stiffest * u64::from(MARGIN) * u64::from(delay_us);
    let late = (product << 8) / 1_000_000;
    // The root of 2^-8 N/mm * 2^-16 N s^2/mm is 2^-12 N s/mm; the stiffest is below 2^21, an
    // accepted mass is at most 2^26.
    let critical = (stiffest * u64::from(settings.mass.0.min(1 << 26))).isqrt() << 5;
    let damping = late.max(critical).min(1 << 30) as u32;
    VirtualDamping(damping.max(lowest.0))
}

/// Checks settings. Returns the highest damping level, which covers a contact of [`STIFFEST`].
fn check(
    settings: &LoopSettings,
    period_us: u16,
    delay_us: u32,
    largest_force: Force,
) -> Result<usize, ForceRefusal> {
    let refuse = |parameter, bound: u64| ForceRefusal {
        parameter,
        bound: bound.min(i32::MAX as u64) as i32,
    };
    let setpoint = settings.setpoint;
    if setpoint < LoopSettings::MIN_SETPOINT {
        return Err(refuse(
            ForceParameter::SetpointTooSmall,
            u64::from(LoopSettings::MIN_SETPOINT.magnitude()),
        ));
    }
    // Above three quarters of the range too little range is left to measure the excess force.
    let max = largest_force.held().0.max(0) / 4 * 3;
    if setpoint.0 > max {
        return Err(refuse(ForceParameter::SetpointTooLarge, max as u64));
    }
    // Level 0 must be stable on contacts that the monitor ignores: K_V >= k tau.
    let min = ((u64::from(SOFT) * u64::from(delay_us)) << 16).div_ceil(1_000_000);
    let min = min.max(MIN_DAMPING);
    if u64::from(settings.damping.0) < min {
        return Err(refuse(ForceParameter::DampingTooSmall, min));
    }
    if settings.damping.0 > 1 << 26 {
        return Err(refuse(ForceParameter::DampingTooLarge, 1 << 26));
    }
    // The last level covers the stiffest contact.
    let mut highest = 0;
    while ONSET << highest < STIFFEST << 8 && highest < LEVELS - 1 {
        highest += 1;
    }
    // K_A >= K_V T for the most damped level, and K_A <= 2^18 K_V T for the least damped one.
    let max = u64::from(damping(settings, delay_us, highest).0);
    let lightest = (max * u64::from(period_us)).div_ceil(1_000_000).max(1);
    if u64::from(settings.mass.0) < lightest {
        return Err(refuse(ForceParameter::MassTooSmall, lightest));
    }
    let step = u64::from(settings.damping.0) * u64::from(period_us);
    let heaviest = ((step << 18) / 1_000_000).min(1 << 26);
    if u64::from(settings.mass.0) > heaviest || !sound(settings.mass, settings.damping, period_us) {
        return Err(refuse(ForceParameter::MassTooLarge, heaviest));
    }
    if settings.limit.0 <= 0 || settings.limit > LARGEST_LIMIT {
        return Err(refuse(ForceParameter::Limit, LARGEST_LIMIT.0 as u64));
    }
    if settings.rate.0 <= 0 {
        return Err(refuse(ForceParameter::Rate, 1));
    }
    Ok(highest)
}

/// Input of an axis in a control period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct DrivingForce {
    /// Peak force on the tool.
    pub force: Force,
    /// p_d'.
    pub commanded_rate: Rate,
    /// The axis is under force control. Otherwise the force counts as 0, and the tool returns.
    pub active: bool,
    /// Hold the displacement, whatever the force: the rate decays with the highest damping level.
    pub held: bool,
    /// Damping level of the contact-stability monitor.
    pub level: usize,
    /// The tool touches something, or did within the last revolutions.
    pub touching: bool,
}

/// Compliant displacement of one axis.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AdmittanceAxis {
    law: AdmittanceLaw,
    /// Outward is the positive direction.
    upward: bool,
    /// Outward displacement, 2^-40 mm, 0 to 2^46.
    away: i64,
    /// Its outward rate, 2^-(40 + FINENESS) mm per control period.
    rate: i64,
    /// `away` before this control period.
    before: i64,
    /// Rate in the last result.
    shown: Rate,
    /// Largest displacement, 2^-40 mm: the limit of the law, or more after the limit was lowered.
    limit: i64,
    /// The tool rests and ignores a small error.
    resting: bool,
}

impl_digest!(AdmittanceAxis { fields { law }, nested {}, skip { upward, away, rate, before, shown, limit, resting } });

impl AdmittanceAxis {
    /// Creates an axis with displacement 0.
    #[must_use]
    pub const fn new(law: AdmittanceLaw) -> Self {
        Self {
            limit: law.limit,
            resting: false,
            law,
            upward: true,
            away: 0,
            rate: 0,
            before: 0,
            shown: Rate::ZERO,
        }
    }

    /// The admittance law.
    #[must_use]
    pub const fn law(&self) -> &AdmittanceLaw {
        &self.law
    }

    /// Adopts another law; displacement and rate are kept.
    pub fn adopt(&mut self, law: AdmittanceLaw) {
        self.law = law;
        // With 1/64 of the distance left for each control period the rate ends by itself: below
        // 2^46 + 2^50.
        let needed = self.rate.max(0).wrapping_shr(FINENESS).wrapping_shl(6);
        self.limit = self.law.limit.max(self.away.wrapping_add(needed));
    }

    /// Resets the displacement to 0: after an enable, or when the commanded position became the
    /// measured one.
    pub const fn reset(&mut self) {
        self.away = 0;
        self.rate = 0;
        self.before = 0;
        self.shown = Rate::ZERO;
        self.limit = self.law.limit;
        self.resting = false;
    }

    /// Whether displacement and rate are 0, now and in the control period before.
    #[must_use]
    pub const fn is_at_rest(&self) -> bool {
        self.away == 0 && self.before == 0 && self.rate == 0 && self.shown.0 == 0
    }

    /// Compliant displacement p_c.
    #[must_use]
    pub const fn displacement(&self) -> Displacement {
        Displacement(if self.upward {
            self.away
        } else {
            self.away.wrapping_neg()
        })
    }

    /// Restores the displacement from before this control period, at rate 0, because the reference
    /// was refused.
    pub const fn roll_back(&mut self) -> Compliance {
        self.stop_at(self.before)
    }

    /// Clamps the displacement to `max`, at rate 0.
    pub fn clamp_displacement(&mut self, max: Displacement) -> Compliance {
        let outward = if self.upward {
            max.0
        } else {
            max.0.saturating_neg()
        };
        self.stop_at(outward.clamp(0, self.away))
    }

    const fn stop_at(&mut self, away: i64) -> Compliance {
        self.away = away;
        self.rate = 0;
        self.shown = Rate::ZERO;
        Compliance {
            displacement: self.displacement(),
            rate: Rate::ZERO,
            acceleration: Acceleration::ZERO,
            limited: true,
        }
    }

    /// Advances one control period. Not inlined: three copies in the caller's loop would be no
    /// faster, because registers run out.
    #[inline(never)]
    pub fn advance(&mut self, push: &DrivingForce) -> Compliance {
        let force = if push.active { push.force.held().0 } else { 0 };
        if self.away == 0 && self.rate <= 0 {
            self.rate = 0;
            self.upward = force >= 0;
        }
        let level = if push.held { LEVELS } else { push.level }.min(self.law.highest);
        let drive = self.drive(push, force, level);
        let (drive, level) = self.rest(push, drive, level);
        self.before = self.away;
        if self.away == 0 && self.rate == 0 && drive <= 0 && self.shown.0 == 0 {
            return Compliance::default();
        }
        let law = &self.law;
        let Some(pole) = law.poles.get(level) else {
            return self.compliance(false);
        };
        let (step, rate) = pole.step(drive, self.rate);
        let mut max = law.rate_limit;
        if self.rate > max || self.rate < -max {
            // A lowered rate limit takes effect within some hundred control periods, without a jump
            // of the rate.
            let fast = self.rate.abs();
            max = max.max(fast.wrapping_sub(fast >> 8));
        }
        let (mut step, mut rate) = (step.min(max), rate.min(max));
        if step < 0 || rate < 0 {
            // The return is limited to 1/64 of the remaining displacement: 2^40 units in the finest
            // scale are below 2^58.
            let landing = (self.away >> 6)
                .wrapping_shl(FINENESS)
                .min(max)
                .wrapping_neg();
            (step, rate) = (step.max(landing), rate.max(landing));
        }
        if step > 0 || rate > 0 {
            // The same towards the limit.
            let room = self.limit.wrapping_sub(self.away).max(0) >> 6;
            let landing = room.wrapping_shl(FINENESS);
            (step, rate) = (step.min(landing), rate.min(landing));
        }
        // Below 2^50 + 2^41.
        let mut away = self.away.wrapping_add(step.wrapping_shr(FINENESS));
        let limited = drive > 0 && away > self.limit.wrapping_sub(NOTHING);
        if limited {
            away = self.limit;
            rate = rate.min(0);
        }
        if rate <= 0 {
            // A lowered limit follows the returning tool.
            self.limit = law.limit.max(away);
        }
        if away < NOTHING && rate <= 0 {
            away = 0;
            rate = 0;
        }
        self.away = away.max(0);
        self.rate = rate;
        self.compliance(limited)
    }

    /// A creeping reference moves nothing. Returns the driving force and the level with which the
    /// tool moves at least at the creep rate, or rests.
    #[inline]
    fn rest(&mut self, push: &DrivingForce, drive: i32, level: usize) -> (i32, usize) {
        let law = &self.law;
        let creeping = law.creeping.get(level).copied().unwrap_or(0);
        let stands = push.active && !push.held && push.commanded_rate.0 == 0 && self.away > 0;
        if level == 0 || creeping == 0 || !stands {
            self.resting = false;
            return (drive, level);
        }
        let error = drive.wrapping_abs();
        let zone = creeping.min(law.settings.setpoint.0) / 2;
        let moving = self.rate.abs() > law.creep / 4 && (self.rate > 0) == (drive > 0);
        self.resting = error <= zone && (self.resting || !moving || error <= zone / 4);
        if self.resting {
            return (0, law.highest);
        }
        let min = drive.signum().wrapping_mul(creeping);
        (if error < creeping { min } else { drive }, level)
    }

    /// Driving force outward, 2^-16 N, within +-2^27.
    #[inline]
    fn drive(&self, push: &DrivingForce, force: i32, level: usize) -> i32 {
        if push.held {
            return 0;
        }
        let law = &self.law;
        let outward = |value: i32| {
            if self.upward {
                value
            } else {
                value.wrapping_neg()
            }
        };
        let setpoint = law.settings.setpoint.0;
        let commanded_rate = outward(push.commanded_rate.0.max(-i32::MAX));
        let mut drive = outward(force).wrapping_sub(setpoint);
        // An axis without force control has no damping: its monitor may run but must not move the
        // tool.
        if level > 0 && push.active {
            // D p_d', 2^-16 N: a product of words.
            let added = law.added.get(level).copied().unwrap_or(0);
            let resisted = multiply_shift(-commanded_rate, added, 20);
            let setpoint = i64::from(setpoint);
            let max = if push.touching { 1 << 28 } else { setpoint };
            drive = drive.wrapping_add(resisted.min(max).max(-setpoint) as i32);
        }
        let open = match law.settings.enable_condition {
            EnableCondition::AgainstMotion => commanded_rate < 0,
            EnableCondition::Any => true,
            EnableCondition::Positive => self.upward,
            EnableCondition::Negative => !self.upward,
        };
        // From displacement 0 only a force above f_d moves the tool, not the damping against the
        // commanded motion.
        let open = open && (self.away > 0 || outward(force) > setpoint);
        let max = if open { Force::MAX.0 } else { 0 };
        drive.min(max).max(-Force::MAX.0)
    }

    #[inline]
    fn compliance(&mut self, limited: bool) -> Compliance {
        let rate = saturate(self.law.to_rate.of(self.rate));
        let rate = if self.upward {
            rate
        } else {
            rate.wrapping_neg()
        };
        // 2^-20 mm/s times control periods per second in Q16: 2^-36, to 2^-12 mm/s^2. The rate is
        // below 2^31 * (1 - 2^-8): see `AdmittanceLaw::begin`.
        let change = i64::from(rate).wrapping_sub(i64::from(self.shown.0));
        let acceleration = multiply_shift(saturate(change), self.law.frequency as i32, 24);
        self.shown = Rate(rate);
        Compliance {
            displacement: self.displacement(),
            rate: Rate(rate),
            acceleration: Acceleration(saturate(acceleration)),
            limited,
        }
    }
}
