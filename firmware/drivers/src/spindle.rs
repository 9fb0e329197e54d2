//! Spindle by PWM and a direction line. The duty over the speed is a curve of measured points,
//! because a frequency converter or a speed controller is seldom linear at its ends.

use embedded_hal::digital::OutputPin;
use embedded_hal::pwm::SetDutyCycle;
use micromath::F32Ext;

/// Largest number of points of a curve.
pub const POINTS: usize = 8;

/// Curve of duty over speed: straight lines between measured points, 0 at standstill.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Curve {
    points: [(f32, f32); POINTS],
    count: usize,
}

/// Reason why points are not a curve.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CurveError {
    /// There is no point, or more than [`POINTS`].
    Count(usize),
    /// The speeds do not rise, a speed is not positive, or a duty is not within 0 and 1; index of
    /// the point.
    Point(usize),
}

impl Curve {
    /// Curve of (rev/min, duty 0 to 1) points, speeds rising.
    ///
    /// # Errors
    /// See [`CurveError`].
    pub fn new(points: &[(f32, f32)]) -> Result<Self, CurveError> {
        if points.is_empty() || points.len() > POINTS {
            return Err(CurveError::Count(points.len()));
        }
        let mut curve = Self {
            points: [(0.0, 0.0); POINTS],
            count: points.len(),
        };
        let mut below = 0.0;
        for (index, (point, slot)) in points.iter().zip(&mut curve.points).enumerate() {
            let (speed, duty) = *point;
            if !(speed > below && speed.is_finite() && (0.0..=1.0).contains(&duty)) {
                return Err(CurveError::Point(index));
            }
            below = speed;
            *slot = *point;
        }
        Ok(curve)
    }

    /// Duty at a speed in rev/min, 0 to 1. Below the first point it is that of the first point,
    /// above the last one that of the last; at 0 it is 0.
    #[must_use]
    pub fn duty(&self, rpm: u16) -> f32 {
        if rpm == 0 {
            return 0.0;
        }
        let speed = f32::from(rpm);
        let points = &self.points[..self.count];
        let mut below = points[0];
        for point in points {
            if speed <= point.0 {
                let span = point.0 - below.0;
                if span <= 0.0 {
                    return point.1;
                }
                return below.1 + (speed - below.0) / span * (point.1 - below.1);
            }
            below = *point;
        }
        below.1
    }
}

/// Reason why the spindle could not be set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Error<W, P> {
    /// The PWM reported an error.
    Pwm(W),
    /// The direction pin reported an error.
    Pin(P),
}

/// A spindle.
pub struct Spindle<W, P> {
    pwm: W,
    direction: P,
    curve: Curve,
    is_reverse: bool,
}

impl<W: SetDutyCycle, P: OutputPin> Spindle<W, P> {
    /// A spindle; the direction line is low for clockwise.
    pub const fn new(pwm: W, direction: P, curve: Curve) -> Self {
        Self {
            pwm,
            direction,
            curve,
            is_reverse: false,
        }
    }

    /// Returns PWM and direction line.
    pub fn release(self) -> (W, P) {
        (self.pwm, self.direction)
    }

    /// Sets the speed in rev/min, counter-clockwise below 0. The direction line changes only while
    /// the duty is 0.
    ///
    /// # Errors
    /// See [`Error`].
    pub fn set_speed(&mut self, rpm: i16) -> Result<(), Error<W::Error, P::Error>> {
        let is_reverse = if rpm == 0 { self.is_reverse } else { rpm < 0 };
        if is_reverse != self.is_reverse {
            self.pwm.set_duty_cycle_fully_off().map_err(Error::Pwm)?;
            let result = if is_reverse {
                self.direction.set_high()
            } else {
                self.direction.set_low()
            };
            result.map_err(Error::Pin)?;
            self.is_reverse = is_reverse;
        }
        let max = self.pwm.max_duty_cycle();
        let duty = self.curve.duty(rpm.unsigned_abs()) * f32::from(max);
        // micromath: `core` has no rounding of f32.
        let duty = F32Ext::round(duty) as u16;
        self.pwm.set_duty_cycle(duty.min(max)).map_err(Error::Pwm)
    }
}
