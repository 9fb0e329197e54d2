//! Lost steps of a step/dir drive: comparison of the emitted steps with the encoder, and the lock
//! of the rotor after its drive was switched on.

use super::encoder::{difference, sum};
use crate::config::AxisKind;
use crate::digest::impl_digest;
use haptimill_math::Coordinate;
use haptimill_math::reciprocal::saturate;

/// Comparison of the emitted steps with the encoder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct StepSupervision {
    per_step: i64,
    lost: i32,
    /// Free-running step counter and motor coordinate at the start of supervision.
    last_steps: i32,
    steps: i64,
    start: Coordinate,
    /// State of the rotor lock, until the rotor has locked.
    lock: Option<Lock>,
}

impl_digest!(StepSupervision { fields { per_step, lost }, nested {}, skip { last_steps, steps, start, lock } });

/// Rotor that moves to a detent after its drive was switched on.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Lock {
    /// Motor coordinate when the drive was switched on.
    origin: Coordinate,
    /// Middle of the band in which the rotor stays, and the number of periods in that band.
    middle: Coordinate,
    quiet: u32,
}

impl StepSupervision {
    /// Creates the comparison: size of a step in axis units, 2^-24, and limit of the lost steps.
    pub(super) const fn new(per_step: i64, lost: Coordinate) -> Self {
        Self {
            per_step,
            lost: lost.0,
            last_steps: 0,
            steps: 0,
            start: Coordinate(0),
            lock: None,
        }
    }

    /// Starts at a count of the step counter and the motor coordinate there.
    pub(super) const fn start(&mut self, steps: i32, motor: Coordinate) {
        self.last_steps = steps;
        self.start = motor;
    }

    /// Starts the rotor lock: the drive was switched on at the motor coordinate `motor`.
    pub(super) const fn begin_lock(&mut self, motor: Coordinate) {
        self.lock = Some(Lock {
            origin: motor,
            middle: motor,
            quiet: 0,
        });
    }

    /// Updates the rotor lock by one period. Returns the distance of the rotor from where its drive
    /// was switched on, and the number of periods for which it has stayed within an eighth of the
    /// limit of lost steps, or within two counts. `None` without a lock.
    pub(super) fn locking(
        &mut self,
        kind: AxisKind,
        motor: Coordinate,
        per_count: i64,
    ) -> Option<(Coordinate, u32)> {
        let band = u64::from(self.lost.unsigned_abs() / 8).max(per_count.unsigned_abs() >> 23);
        let lock = self.lock.as_mut()?;
        let moved = difference(kind, motor, lock.middle).magnitude();
        if u64::from(moved) > band {
            lock.middle = motor;
            lock.quiet = 0;
        } else {
            lock.quiet = lock.quiet.saturating_add(1);
        }
        Some((difference(kind, motor, lock.origin), lock.quiet))
    }

    /// Whether the rotor is in its lock phase.
    pub(super) const fn is_locking(&self) -> bool {
        self.lock.is_some()
    }

    /// Shifts the motor coordinate of the start, after a reference was found.
    pub(super) fn rebase(&mut self, kind: AxisKind, shift: Coordinate) {
        self.start = sum(kind, self.start, shift);
    }

    /// Restarts the comparison with steps and encoder in agreement.
    pub(super) const fn restart(&mut self, motor: Coordinate) {
        self.steps = 0;
        self.start = motor;
        self.lock = None;
    }

    /// Steps minus encoder, and whether the difference is above the limit.
    #[inline(never)]
    pub(super) fn compare(
        &mut self,
        kind: AxisKind,
        enabled: bool,
        steps: i32,
        motor: Coordinate,
    ) -> (Coordinate, bool) {
        self.steps = self
            .steps
            .wrapping_add(i64::from(steps.wrapping_sub(self.last_steps)));
        self.last_steps = steps;
        // Without an encoder there is nothing to compare.
        if !enabled || self.lock.is_some() || self.lost == 0 {
            return (Coordinate(0), false);
        }
        let by_steps = match kind {
            AxisKind::Linear | AxisKind::MultiTurn => {
                let travel = self
                    .steps
                    .saturating_mul(self.per_step)
                    .saturating_add(1 << 23)
                    >> 24;
                sum(kind, self.start, Coordinate(saturate(travel)))
            }
            AxisKind::Rotary => {
                let travel = self.steps.wrapping_mul(self.per_step).wrapping_add(1 << 23) >> 24;
                sum(kind, self.start, Coordinate(travel as i32))
            }
        };
        let slip = difference(kind, by_steps, motor);
        (slip, slip.0.unsigned_abs() > self.lost.unsigned_abs())
    }
}
