//! Acceptance of setpoints: the checks of the next setpoint, and its place in the queue.

use super::{Interpolator, QUEUE};
use crate::motion::PoseCommand;
use crate::motion::cubic::{Cubic, SegmentDuration};
use crate::motion::segment;
use core::ops::Range;
use haptimill_math::Coordinate;
use haptimill_protocol::message::{Action, Refusal};
use haptimill_protocol::setpoint::Setpoint;

impl Interpolator {
    /// Appends the next setpoint.
    ///
    /// # Errors
    ///
    /// Returns a [`Refusal`] if the setpoint is invalid or the queue is full. A refused setpoint
    /// changes nothing.
    pub fn push(&mut self, setpoint: &Setpoint) -> Result<(), Refusal> {
        self.push_checked(setpoint, 0)
    }

    /// Checks whether the coordinates `axes` may move to the next setpoint; a part of the checks of
    /// [`Interpolator::push`].
    ///
    /// # Errors
    ///
    /// Returns the [`Refusal`] that [`Interpolator::push`] would return for these coordinates.
    #[inline(never)]
    pub fn allows(&mut self, setpoint: &Setpoint, axes: Range<usize>) -> Result<(), Refusal> {
        let number = self.accepted;
        let bad = Refusal::Setpoint { setpoint: number };
        if setpoint.pose.len() != self.axes || setpoint.rates.len() != self.axes {
            return Err(Refusal::CoordinateCount);
        }
        if self.total.is_some_and(|total| number >= total) {
            return Err(Refusal::OutOfOrder { expected: number });
        }
        if matches!(setpoint.action, Action::Pause) && setpoint.rates.iter().any(|rate| *rate != 0)
        {
            return Err(bad);
        }
        if matches!(setpoint.action, Action::OverrideMode(mode) if !mode.is_valid()) {
            return Err(bad);
        }
        self.set_duration(setpoint.periods).ok_or(bad)?;
        let to = setpoint.pose.iter().zip(&setpoint.rates).enumerate();
        for (axis, (place, rate)) in to.take(axes.end).skip(axes.start) {
            if !self.is_within_limits(axis, *place, *rate) {
                return Err(bad);
            }
        }
        Ok(())
    }

    /// Whether the machine stays at standstill from the newest setpoint to the next one.
    #[must_use]
    pub fn stays_until(&self, setpoint: &Setpoint) -> bool {
        let still = |(place, to): (&i32, &i32)| place == to;
        self.tail.is_at_standstill()
            && setpoint.rates.iter().all(|rate| *rate == 0)
            && self.tail.pose.iter().zip(&setpoint.pose).all(still)
    }

    /// Pose and rates `periods` control periods after the newest setpoint, on the path to the next
    /// one. Callers must call [`Interpolator::allows`] for this setpoint in the same control
    /// period.
    #[must_use]
    pub fn sample_to(&self, setpoint: &Setpoint, periods: u16) -> Option<PoseCommand> {
        let mut commanded = PoseCommand::default();
        let half = segment::half(self.duration.fraction(u32::from(periods) << 16));
        let to = setpoint.pose.iter().zip(&setpoint.rates).enumerate();
        for (axis, (place, rate)) in to {
            let (start, wrap) = (Coordinate(self.tail.pose[axis]), self.circular[axis]);
            let (from, end) = (self.tail.rates[axis], Coordinate(*place));
            let cubic = Cubic::new(start, from, end, *rate, &self.duration, wrap)?;
            let sample = segment::SegmentPolynomial::new(&cubic, &self.duration).sample(half);
            commanded.pose.0[axis] = sample.position;
            commanded.rates[axis] = sample.rate;
        }
        Some(commanded)
    }

    /// Whether a duration of `periods` control periods equals the one checked last. Other durations
    /// take a little longer to check.
    #[must_use]
    pub const fn expects(&self, periods: u16) -> bool {
        self.duration.periods() == periods
    }

    /// Appends the next setpoint, whose first `checked` coordinates are already checked.
    ///
    /// # Errors
    ///
    /// Returns a [`Refusal`] as [`Interpolator::push`] does. A refused setpoint changes nothing.
    pub fn push_checked(&mut self, setpoint: &Setpoint, checked: usize) -> Result<(), Refusal> {
        self.allows(setpoint, checked..self.axes)?;
        if self.queue.is_full() {
            return Err(Refusal::QueueFull);
        }
        let number = self.accepted;
        let tail = &mut self.tail;
        tail.periods = setpoint.periods;
        tail.action = setpoint.action;
        let places = tail.pose.iter_mut().zip(&mut tail.rates);
        let to = setpoint.pose.iter().zip(&setpoint.rates);
        for ((place, rate), (to, to_rate)) in places.zip(to) {
            (*place, *rate) = (*to, *to_rate);
        }
        // Cannot fail: the queue was checked above.
        let _ = self.queue.push_back(self.tail);
        self.queued_periods += u64::from(setpoint.periods);
        self.stops_ahead += u32::from(self.tail.is_at_standstill());
        self.accepted_modes.accept(setpoint, self.ramp_periods);
        self.accepted = self.accepted.wrapping_add(1);
        if let Some(underrunning) = self.underrunning
            && underrunning.setpoint == number
        {
            self.ended_underrun = Some(underrunning);
        }
        Ok(())
    }

    /// Sets the number of setpoints of the job.
    ///
    /// # Errors
    ///
    /// Returns a [`Refusal`] if `count` differs from the number of accepted setpoints, or if the
    /// last one is not at standstill.
    pub fn end(&mut self, count: u32) -> Result<(), Refusal> {
        if count != self.accepted {
            return Err(Refusal::OutOfOrder {
                expected: self.accepted,
            });
        }
        if !self.tail.is_at_standstill() {
            return Err(Refusal::Setpoint {
                setpoint: count.saturating_sub(1),
            });
        }
        self.total = Some(count);
        Ok(())
    }

    /// Number of the first setpoint for which the queue has no room.
    #[must_use]
    pub fn credit(&self) -> u32 {
        self.accepted
            .wrapping_add((QUEUE - self.queue.len()) as u32)
    }

    /// Sets the segment duration. It is recomputed only if it changed.
    fn set_duration(&mut self, periods: u16) -> Option<()> {
        if self.duration.periods() != periods || periods == 0 {
            self.duration = SegmentDuration::new(periods, self.period_us)?;
        }
        Some(())
    }

    /// Whether an axis may move from the newest setpoint to the next one. The rate at the end, the
    /// mean rate and all rates between must be within the axis limit. The acceleration must be
    /// within 16 times that of a jog. A setpoint beyond these bounds is an error of the host.
    fn is_within_limits(&self, axis: usize, place: i32, rate: i32) -> bool {
        let (duration, mut limit) = (&self.duration, self.rate_limits[axis]);
        let max = i32::from(self.max_percent());
        if max > 100 {
            limit = limit / max * 100;
        }
        if rate.unsigned_abs() > limit.unsigned_abs() {
            return false;
        }
        let (tail, wrap) = (&self.tail, self.circular[axis]);
        let (start, start_rate) = (Coordinate(tail.pose[axis]), tail.rates[axis]);
        let Some(cubic) = Cubic::new(start, start_rate, Coordinate(place), rate, duration, wrap)
        else {
            return false;
        };
        cubic.is_at_standstill()
            || (cubic.keeps_mean_rate(limit, duration)
                && cubic.keeps_rate(limit, duration)
                && cubic.keeps_acceleration(self.acceleration_limits[axis], duration))
    }
}
