//! The position loop of a joint.
//!
//! With e = wanted - measured, both forms ask for an acceleration and turn it into an effort:
//!
//! - [`LawForm::Pd`], spec h4-milling (3.29): inertia (K_P e + K_D e') + friction. The printed equation adds k_d times the measured rate, which is positive feedback and
//!   unstable; the corrected sign is used, on the rate of the *error*, so a ramp leaves no lag of K_D / K_P.
//! - [`LawForm::ModelBased`], spec (3.35)-(3.37): inertia (l_e'' + K_D e' + K_P e) + viscous l_e' + friction, which leaves e'' + K_D e' + K_P e = 0 (3.38).
//!
//! e' is the rate of e through a first-order filter ([`filter::RateFilter`]): encoder counts are steps, and differentiating one within a period would ask for
//! K_D / period times a count. Friction is compensated by the wanted rate ([`friction`]). The integrator is optional; it stands still while the output is at
//! its limit and the error would drive it further in, and never holds more than the limit.
//!
//! Units are those of [`crate::units`]; gains come from [`crate::config::Law`]. No input can overflow: what is too large saturates, and is reported.
//!
//! Misuse: feeding the error of a wanted position that jumps. [`PositionLaw::reset`] belongs before the first period after an enable.

pub mod filter;
pub mod friction;

use crate::config::{Law, LawForm};
use crate::drive::reciprocal::{mul_shift, saturate};
use crate::safety::integrity::constants;
use crate::units::{Acceleration, Coordinate, Effort, Rate};
use filter::RateFilter;
use friction::Friction;

/// The largest acceleration that is asked for, au/s^2; 2^37 mm/s^2.
const ACCELERATION_LIMIT: i64 = 1 << 57;

/// Fractional bits of the integrator.
const INTEGRAL_FRACTION: u32 = 20;

/// Position loop of one joint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PositionLaw {
    form: LawForm,
    kp: u32,
    kd: u32,
    inertia: u32,
    viscous: u32,
    friction: Friction,
    error_rate: RateFilter,
    /// K_I times the period, 1/s^2, Q20.
    ki_period: u32,
    /// au/s^2, Q20.
    integral: i64,
    integral_limit: i64,
    limit: i32,
}

constants!(PositionLaw {
    form, kp, kd, inertia, viscous, friction, ki_period, integral_limit, limit
} of { error_rate } but { integral });

impl PositionLaw {
    /// A loop that runs every `period_us` (50 to 1000) and may ask for `limit` either way.
    pub const fn new(law: &Law, limit: Effort, period_us: u16) -> Self {
        let limit = if limit.0 == i32::MIN {
            i32::MAX
        } else {
            limit.0.abs()
        };
        // Q8 to Q20, per second to per period; a gain of more than 4096 1/s^2 per period saturates.
        let ki = ((law.ki.0 as u64) << 12) * period_us as u64 / 1_000_000;
        let inertia = if law.inertia == 0 { 1 } else { law.inertia } as i64;
        let most = ((limit as i64) << 28) / inertia;
        let most = if most > 1 << 42 { 1 << 42 } else { most };
        Self {
            form: law.form,
            kp: law.kp.0,
            kd: law.kd.0,
            inertia: law.inertia,
            viscous: law.viscous,
            friction: Friction::new(law.coulomb, law.coulomb_rate),
            error_rate: RateFilter::new(period_us, law.rate_filter_us),
            ki_period: if ki > u32::MAX as u64 {
                u32::MAX
            } else {
                ki as u32
            },
            integral: 0,
            integral_limit: most << INTEGRAL_FRACTION,
            limit,
        }
    }

    /// Starts without a bump: `error` has been there for ever, so its rate is zero, and the integrator is empty.
    pub const fn reset(&mut self, error: Coordinate) {
        self.error_rate.rest(error.0);
        self.integral = 0;
    }

    /// The effort of a period, and whether it was cut at the limit.
    #[inline]
    pub fn effort(
        &mut self,
        error: Coordinate,
        rate: Rate,
        acceleration: Acceleration,
    ) -> (Effort, bool) {
        let error_rate = self.error_rate.rate(error.0);
        // Each is below 2^63: 2^32 * 2^31; 2^44 * 2^32 / 2^16; the sum of the four is below 2^61.
        let proportional = (i64::from(error.0) * i64::from(self.kp)) >> 8;
        let derivative = mul_shift::<16>(error_rate, self.kd);
        let integral = self.integral >> INTEGRAL_FRACTION;
        let mut asked = proportional + derivative + integral;
        let mut effort = i64::from(self.friction.effort(rate).0);
        if self.form == LawForm::ModelBased {
            asked += i64::from(acceleration.0) << 8;
            effort += (i64::from(rate.0) * i64::from(self.viscous)) >> 24;
        }
        // 256 au/s^2 a unit and Q20 of inertia: 28 bits. 2^57 * 2^32 / 2^28 = 2^61.
        effort += mul_shift::<28>(
            asked.clamp(-ACCELERATION_LIMIT, ACCELERATION_LIMIT),
            self.inertia,
        );
        let limit = i64::from(self.limit);
        let allowed = effort.clamp(-limit, limit);
        let deeper = allowed != effort && (effort < 0) == (error.0 < 0);
        if self.ki_period != 0 && !deeper {
            // The integrator is within +-2^62 and a step below 2^63.
            let step = i64::from(error.0) * i64::from(self.ki_period);
            self.integral = self
                .integral
                .saturating_add(step)
                .clamp(-self.integral_limit, self.integral_limit);
        }
        (Effort(saturate(allowed)), allowed != effort)
    }
}
