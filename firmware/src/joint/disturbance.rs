//! Disturbance of a joint: an integrator, and an adaptation of the friction compensation
//! ((C42) in docs/control.md).
//!
//! The integrator removes the static error that a constant disturbance leaves: K_I times the
//! integral of the error. While the joint moves, it is transferred to an estimate of the friction
//! that the configuration does not contain. The estimate acts on the side of the commanded rate and
//! changes its sign with the friction at a reversal. The integrator alone leaves a spike there.
//!
//! The integrator has no limit cycle at rest: while the commanded rate is 0 it ignores errors
//! within a dead band of one and a half encoder counts. A joint whose breakaway friction is far
//! above its Coulomb friction jumps across that band. Each time the error comes out on its other
//! side after 0.5 s on one, the band doubles, to 16 times its width at most; the next
//! motion makes it narrow again. A loop that settles after a motion changes sides faster.
//!
//! Units: those of the sum of [`super::servo::ServoLaw`], with [`FRACTION`] more fractional bits.
//! The integrator is within the drive's limit. The friction estimate is between the negative
//! configured Coulomb friction and half of that limit. No input can overflow.

use crate::digest::impl_digest;
use crate::rate_filter::approach;
use haptimill_math::{Coordinate, Rate};

/// Fractional bits of integrator and friction estimate. The least gain that they allow fills the
/// integrator in more than a day at an error of one encoder count.
pub const FRACTION: u32 = 20;

/// Half a unit of the sum.
const HALF: i64 = 1 << (FRACTION - 1);

/// Widest dead band at rest, in multiples of the narrow one: 24 counts.
const WIDEST: u32 = 16;

/// Time on one side of the dead band from which on a change of the side is hunting, microseconds.
const SIDE_CHANGE_US: u32 = 500_000;

/// Constants of a [`Disturbance`], in units of the sum.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DisturbanceLimits {
    /// Largest magnitude of the integrator, below 2^27.
    pub integral: i32,
    /// Configured Coulomb friction, at most 2^30: the estimate does not make the compensation
    /// negative.
    pub coulomb: i32,
}

/// Integrator and friction estimate of one joint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Disturbance {
    /// Change of the integrator in a period for an error of one axis unit; 0 without an integrator.
    gain: i32,
    /// Part of the integrator that is transferred to the friction estimate in a period, Q31; 0
    /// without adaptation.
    drain: i32,
    dead_band: u32,
    /// [`SIDE_CHANGE_US`] in control periods.
    side_change_periods: u32,
    limit: i64,
    min_friction: i64,
    max_friction: i64,
    integral: i64,
    friction: i64,
    /// Dead band of the present rest, the sign of the last error beyond it, and the control periods
    /// beyond it on that side.
    band: u32,
    side: i32,
    since: u32,
}

impl_digest!(Disturbance { fields { gain, drain, dead_band, side_change_periods, limit, min_friction, max_friction }, nested {}, skip { integral, friction, band, side, since } });

impl Disturbance {
    /// A disturbance with the change of the integrator in a period for an error of one axis unit
    /// (with [`FRACTION`] bits), the time constant of the adaptation (0: none), and the size of an
    /// encoder count.
    pub const fn new(
        gain: i32,
        adaptation_ms: u16,
        period_us: u16,
        count: Coordinate,
        limits: DisturbanceLimits,
    ) -> Self {
        let count = count.magnitude();
        let milliseconds = adaptation_ms as u32 * 1000;
        // `approach` takes microseconds of 16 bits: a longer time is a smaller part.
        let drain = match adaptation_ms {
            0 => 0,
            1..=65 => approach(period_us, (milliseconds) as u16),
            _ => (((period_us as u64) << 32) / milliseconds as u64) as u32,
        };
        Self {
            gain,
            drain: (drain >> 1) as i32,
            dead_band: count.saturating_add(count / 2),
            side_change_periods: SIDE_CHANGE_US / if period_us == 0 { 1 } else { period_us as u32 },
            limit: (limits.integral as i64) << FRACTION,
            min_friction: -((limits.coulomb as i64) << FRACTION),
            max_friction: ((limits.integral / 2) as i64) << FRACTION,
            integral: 0,
            friction: 0,
            band: count.saturating_add(count / 2),
            side: 0,
            since: 0,
        }
    }

    /// Whether the joint has an integrator.
    #[inline]
    pub const fn is_active(&self) -> bool {
        self.gain != 0
    }

    /// Empties integrator and friction estimate.
    pub const fn reset(&mut self) {
        self.integral = 0;
        self.friction = 0;
    }

    /// The integrator, rounded to units of the sum.
    #[inline]
    pub const fn integral(&self) -> i32 {
        ((self.integral + HALF) >> FRACTION) as i32
    }

    /// Friction beyond the configured one, rounded to units of the sum.
    #[inline]
    pub const fn friction(&self) -> i32 {
        ((self.friction + HALF) >> FRACTION) as i32
    }

    /// Takes the error of a period at a commanded rate. `saturated`: the output is at its limit and
    /// the error would drive it further in. `full`: the friction compensation acts in full at this
    /// rate.
    #[inline]
    pub fn update(&mut self, error: Coordinate, rate: Rate, saturated: bool, full: bool) {
        if rate.0 == 0 {
            if error.magnitude() <= self.band {
                return;
            }
            let side = error.0.signum();
            if side == self.side {
                self.since = self.since.saturating_add(1);
            } else {
                if self.side != 0 && self.since >= self.side_change_periods {
                    let widest = self.dead_band.saturating_mul(WIDEST);
                    self.band = self.band.saturating_mul(2).min(widest);
                }
                self.side = side;
                self.since = 0;
            }
        } else {
            self.band = self.dead_band;
            self.side = 0;
        }
        if saturated {
            return;
        }
        // The integrator is within +-2^47 and a step within +-2^62.
        let integral = self.integral + i64::from(error.0) * i64::from(self.gain);
        self.integral = integral.max(-self.limit).min(self.limit);
        if full && self.drain != 0 {
            self.adapt(rate);
        }
    }

    /// Moves a part of the integrator into the friction estimate.
    #[inline]
    fn adapt(&mut self, rate: Rate) {
        // Below 2^27 times 2^31, of which 31 - FRACTION bits are dropped.
        let product = i64::from(self.integral()) * i64::from(self.drain);
        let part = product >> (31 - FRACTION);
        let along = if rate.0 < 0 { -part } else { part };
        let friction = (self.friction + along)
            .max(self.min_friction)
            .min(self.max_friction);
        let moved = friction - self.friction;
        self.friction = friction;
        self.integral -= if rate.0 < 0 { -moved } else { moved };
    }
}
