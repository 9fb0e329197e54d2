//! Position loop of a joint.
//!
//! With the error e = commanded - measured, both forms compute an acceleration and convert it into
//! an effort:
//!
//! - [`ServoForm::Pd`], docs/control.md (3.29): inertia (K_P e + K_D e') + friction. The printed
//!   equation adds k_d times the measured rate, which is positive feedback and unstable. The
//!   corrected sign is used here, on the rate of the *error*, so a ramp leaves no lag of K_D / K_P.
//! - [`ServoForm::ModelBased`], docs/control.md (3.35)-(3.37): inertia (l_e'' + K_D e' + K_P e) +
//!   viscous l_e' + friction, which leaves e'' + K_D e' + K_P e = 0 (3.38).
//!
//! e' is the rate of e through a first-order filter ([`RateFilter`]). Encoder counts are steps:
//! differentiating one count within a period would command K_D / period times a count. Friction
//! compensation uses the commanded rate ([`super::friction`]). The integrator and the adaptation of
//! the friction are optional ([`super::disturbance`]). The integrator is frozen while the output is
//! at its limit and the error would drive it further in, and it never holds more than the limit.
//!
//! All gains are converted into effort factors when the configuration becomes active, so a term
//! costs one 32-bit multiplication per period. A term saturates at no less than four times the
//! drive's limit, and the sum saturates.
//!
//! Units are those of [`haptimill_math`]; gains come from [`crate::config::ServoConfig`]. No input
//! can overflow: values beyond a range saturate, and the saturation is reported.
//!
//! Callers must not pass the error of a commanded position that jumps. They must call
//! [`ServoLaw::reset`] before the first period after an enable.

use super::disturbance::{Disturbance, DisturbanceLimits, FRACTION as INTEGRAL_FRACTION};
use super::friction::Friction;
use crate::config::{ServoConfig, ServoForm};
use crate::digest::impl_digest;
use crate::rate_filter::{CHANGE_FRACTION, RateFilter};
use haptimill_math::reciprocal::{Factor, Scale, saturate};
use haptimill_math::scale::shift_right;
use haptimill_math::{Acceleration, Coordinate, Effort, Rate};

/// Position loop of one joint.
///
/// Internal efforts have `fraction` more bits than [`Effort`], as many as leave a term room for
/// four times the limit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServoLaw {
    form: ServoForm,
    /// Effort per error.
    proportional: Scale,
    /// Effort per change of the error in a period; the change is shifted right by `coarse` first.
    derivative: Scale,
    coarse: u32,
    /// Effort per commanded acceleration, and per commanded rate.
    acceleration: Scale,
    viscous: Scale,
    friction: Friction,
    error_rate: RateFilter,
    disturbance: Disturbance,
    limit: i32,
    fraction: u32,
    /// Half a unit of effort.
    rounding: i32,
    /// Bits that internal efforts lack, the opposite of `fraction`, for drives of more than 2 kN.
    lift: u32,
    /// The integrator and `lift` are both unused.
    plain: bool,
}

impl_digest!(ServoLaw { fields {
    form, proportional, derivative, coarse, acceleration, viscous, friction, limit, fraction, rounding, lift, plain
}, nested { error_rate, disturbance }, skip {} });

impl ServoLaw {
    /// A loop with a period of `period_us` (50 to 1000), an effort within +-`limit`, and an encoder
    /// with counts of the size `count`.
    pub const fn new(law: &ServoConfig, limit: Effort, period_us: u16, count: Coordinate) -> Self {
        let limit = if limit.0 == i32::MIN {
            i32::MAX
        } else {
            limit.0.abs()
        };
        let inertia = if law.inertia == 0 { 1 } else { law.inertia };
        // A term saturates at 2^29 at least, the limit is below 2^27.
        let fraction = limit.leading_zeros().saturating_sub(5);
        let fraction = if fraction > 16 { 16 } else { fraction };
        let lift = 5_u32.saturating_sub(limit.leading_zeros());
        let bits = fraction as i32 - lift as i32;
        // 256 au/s^2 a unit and Q20 of inertia: 28 bits.
        let force = Factor::of(inertia as u64).shifted(bits - 28);
        let period = if period_us < 50 { 50 } else { period_us as u64 };
        // Gains have 8 fraction bits.
        let derivative = force
            .times(Factor::of(law.kd.0 as u64))
            .times(Factor::of(1_000_000))
            .over(Factor::of(period))
            .shifted(-8 - CHANGE_FRACTION as i32);
        // The largest change that affects the output has 31 bits after the shift.
        let coarse = derivative.coarseness();
        let (acceleration, viscous) = match law.form {
            ServoForm::Pd => (Factor::of(0), Factor::of(0)),
            ServoForm::ModelBased => (
                force.shifted(8),
                Factor::of(law.viscous as u64).shifted(bits - 24),
            ),
        };
        let coulomb = ((law.coulomb.0 as i64) << fraction) >> lift;
        let max_coulomb = 1 << 30;
        let coulomb = if coulomb > max_coulomb {
            max_coulomb
        } else if coulomb < -max_coulomb {
            -max_coulomb
        } else {
            coulomb
        };
        let integral = force
            .times(Factor::of(law.ki.0 as u64))
            .times(Factor::of(period))
            .over(Factor::of(1_000_000))
            .shifted(-8 + INTEGRAL_FRACTION as i32);
        let limits = DisturbanceLimits {
            integral: (((limit as i64) << fraction) >> lift) as i32,
            coulomb: (coulomb as i32).saturating_abs(),
        };
        let disturbance = Disturbance::new(
            if law.ki.0 == 0 { 0 } else { integral.whole() },
            law.friction_adaptation_ms,
            period_us,
            count,
            limits,
        );
        Self {
            form: law.form,
            proportional: force.times(Factor::of(law.kp.0 as u64)).shifted(-8).scale(),
            derivative: derivative.shifted(coarse as i32).scale(),
            coarse,
            acceleration: acceleration.scale(),
            viscous: viscous.scale(),
            friction: Friction::new(Effort(coulomb as i32), law.coulomb_rate),
            error_rate: RateFilter::new(period_us, law.rate_filter_us),
            disturbance,
            limit,
            fraction,
            rounding: (1 << fraction) >> 1,
            lift,
            plain: law.ki.0 == 0 && lift == 0,
        }
    }

    /// Starts without a bump: the rate of `error` is zero, and the integrator is empty.
    pub const fn reset(&mut self, error: Coordinate) {
        self.error_rate.rest(error.0);
        self.disturbance.reset();
    }

    /// Takes a change of the error out of its rate: it happened over several periods.
    pub fn shift(&mut self, by: Coordinate) {
        self.error_rate.shift(by.0);
    }

    /// Part of the effort that a commanded acceleration causes.
    #[must_use]
    pub fn feedforward(&self, acceleration: Acceleration) -> Effort {
        let effort = self.acceleration.apply(acceleration.0);
        let effort = effort.wrapping_shr(self.fraction);
        Effort(saturate(i64::from(effort) << self.lift))
    }

    /// Returns the effort of a period and whether it was clamped at the limit.
    #[inline(always)]
    pub fn effort(
        &mut self,
        error: Coordinate,
        rate: Rate,
        acceleration: Acceleration,
    ) -> (Effort, bool) {
        let change = saturate(shift_right(self.error_rate.change(error.0), self.coarse));
        let mut sum = self
            .proportional
            .apply(error.0)
            .saturating_add(self.derivative.apply(change))
            .saturating_add(
                self.friction
                    .effort(rate, Effort(self.disturbance.friction()))
                    .0,
            );
        if self.form == ServoForm::ModelBased {
            sum = sum
                .saturating_add(self.acceleration.apply(acceleration.0))
                .saturating_add(self.viscous.apply(rate.0));
        }
        if !self.plain {
            return self.integrated(sum, error, rate);
        }
        self.cut(
            sum.saturating_add(self.rounding)
                .wrapping_shr(self.fraction),
        )
    }

    /// The effort of a period with an integrator, or of a drive of more than 2 kN.
    #[inline(never)]
    fn integrated(&mut self, mut sum: i32, error: Coordinate, rate: Rate) -> (Effort, bool) {
        sum = sum.saturating_add(self.disturbance.integral());
        let effort = sum
            .saturating_add(self.rounding)
            .wrapping_shr(self.fraction);
        let effort = saturate(i64::from(effort) << self.lift);
        let (allowed, cut) = self.cut(effort);
        if self.disturbance.is_active() {
            let deeper = cut && (effort < 0) == (error.0 < 0);
            let full = self.friction.is_full(rate);
            self.disturbance.update(error, rate, deeper, full);
        }
        (allowed, cut)
    }

    /// Clamps an effort to the limit. Returns the result and whether it was clamped.
    #[inline(always)]
    fn cut(&self, effort: i32) -> (Effort, bool) {
        // The limit is above 0.
        let allowed = effort.max(self.limit.wrapping_neg()).min(self.limit);
        (Effort(allowed), allowed != effort)
    }
}
