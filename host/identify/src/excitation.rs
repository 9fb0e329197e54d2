//! Motions along a line: moves at a constant rate, and sines on top of a constant rate.
//!
//! The sines ride on a rate that never changes its sign. Coulomb friction is then a constant and
//! the flanks of the screw stay in contact, so effort and motion at a frequency have the ratio of
//! the linear plant.

use crate::line::{Geometry, Line};
use haptimill_client::{Error, ErrorKind};
use haptimill_protocol::setpoint::Setpoint;
use std::f64::consts::{PI, TAU};

/// Longest segment in motion, seconds.
const SPAN: f64 = 0.01;

/// Segments in one cycle of a low sine. A cubic that is not quite a sine does no harm, because
/// effort and motion are measured.
pub const PER_CYCLE: f64 = 8.0;
/// Shortest segment, seconds: the controller takes a setpoint in several control periods.
pub const SHORTEST: f64 = 1.2e-3;

/// Time in which a sine ramps up and down, seconds.
pub const TAPER: f64 = 0.15;

/// Time after the start of a constant rate that is not measured, seconds.
const SETTLE: f64 = 0.25;

/// A time of a motion that is measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// Seconds since the start of the motion.
    pub from: f64,
    /// Its end.
    pub to: f64,
    /// Rate along the line, which it has without the sine.
    pub rate: f64,
    /// Frequency of the sine, Hz; 0 without one.
    pub frequency: f64,
}

/// A sine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Burst {
    /// Hz.
    pub frequency: f64,
    /// Amplitude of the commanded acceleration, mm/s^2 or deg/s^2.
    pub acceleration: f64,
}

/// Setpoints of a motion, and what of it is measured.
#[derive(Debug, Default)]
pub struct Stimulus {
    /// The setpoints.
    pub setpoints: Vec<Setpoint>,
    /// The measured times.
    pub windows: Vec<Window>,
}

/// Time of a change of the rate, seconds.
pub(crate) fn ramp_time(line: &Line, change: f64) -> f64 {
    // Half of what the machine may do: its limits are those of a perfect loop.
    (PI * change.abs() / line.acceleration).max(0.05)
}

/// Time of one sine of `seconds` on a carrier, with its ramps.
pub(crate) fn burst_time(line: &Line, rate: f64, seconds: f64) -> f64 {
    seconds + 2.0 * TAPER + ramp_time(line, rate) + SETTLE
}

/// Change of the rate from and to standstill.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ramp {
    /// Maximum acceleration, mm/s^2 or deg/s^2.
    pub acceleration: f64,
    /// Time in which the acceleration builds up, and dies away, seconds.
    pub build_up: f64,
}

impl Ramp {
    /// Time of the build-up to a rate; a low rate is reached before it ends.
    fn build_up_at(&self, rate: f64) -> f64 {
        self.build_up.min(rate / self.acceleration)
    }

    /// The maximum rate up to `rate` that fits into a travel.
    #[must_use]
    pub fn slowed(&self, mut rate: f64, travel: f64) -> f64 {
        while self.travel(rate, 0.01) > travel && rate > 1e-3 {
            rate *= 0.9;
        }
        rate
    }

    /// Travel to a rate and back to standstill, with `cruise` seconds at the rate.
    #[must_use]
    pub fn travel(&self, rate: f64, cruise: f64) -> f64 {
        rate * (rate / self.acceleration + self.build_up_at(rate) + cruise)
    }
}

/// Builds a motion along a line.
pub struct Builder<'a> {
    geometry: &'a Geometry<'a>,
    line: &'a Line,
    period: f64,
    motion: Stimulus,
    /// Periods, and the place on the line.
    now: u64,
    place: f64,
}

impl<'a> Builder<'a> {
    /// A motion that begins at a place of the line, with control periods of `period` seconds.
    #[must_use]
    pub fn new(geometry: &'a Geometry<'a>, line: &'a Line, period: f64, place: f64) -> Self {
        Self {
            geometry,
            line,
            period,
            motion: Stimulus::default(),
            now: 0,
            place,
        }
    }

    fn time(&self) -> f64 {
        self.now as f64 * self.period
    }

    /// Adds a motion of `duration` seconds in segments of `span`. `at(t)` gives its distance and
    /// rate.
    fn add(
        &mut self,
        duration: f64,
        span: f64,
        at: impl Fn(f64) -> (f64, f64),
    ) -> Result<(), Error> {
        let periods = (duration / self.period).round().max(1.0) as u64;
        let longest = ((span / self.period).floor() as u64).max(1);
        let count = periods.div_ceil(longest);
        let (start, place) = (self.now, self.place);
        for index in 1..=count {
            let end = periods * index / count;
            let (distance, rate) = at(end as f64 * self.period);
            let length = (start + end - self.now) as u16;
            let setpoint = self
                .geometry
                .setpoint(self.line, length, place + distance, rate)?;
            self.motion.setpoints.push(setpoint);
            self.now = start + end;
            self.place = place + distance;
        }
        Ok(())
    }

    /// Changes the rate smoothly.
    fn ramp(&mut self, from: f64, to: f64) -> Result<(), Error> {
        let duration = self.ramp_time(to - from);
        self.add(duration, SPAN, |t| {
            let part = t / duration;
            let distance = from * t + (to - from) * (t - duration / PI * (PI * part).sin()) / 2.0;
            (
                distance,
                from + (to - from) * (1.0 - (PI * part).cos()) / 2.0,
            )
        })
    }

    fn ramp_time(&self, change: f64) -> f64 {
        ramp_time(self.line, change)
    }

    /// Stands still.
    ///
    /// # Errors
    /// The machine cannot reach the place.
    pub fn rest(&mut self, seconds: f64) -> Result<(), Error> {
        self.add(seconds, 1.0, |_| (0.0, 0.0))
    }

    /// Moves to a place at a rate. The time at the rate is measured, where it is long enough.
    ///
    /// # Errors
    /// The machine cannot reach the place.
    pub fn move_to(&mut self, place: f64, rate: f64) -> Result<(), Error> {
        let distance = place - self.place;
        // A short distance has a lower rate: two ramps are rate * ramp time long.
        let mut rate = rate.abs();
        while rate * self.ramp_time(rate) > 0.8 * distance.abs() && rate > 1e-3 {
            rate *= 0.8;
        }
        if distance.abs() < 1e-9 {
            return Ok(());
        }
        let signed = rate * distance.signum();
        self.ramp(0.0, signed)?;
        let cruise = (place - self.place).abs() / rate - self.ramp_time(rate) / 2.0;
        let from = self.time() + SETTLE;
        self.add(cruise, 0.1, |t| (signed * t, signed))?;
        if cruise > 2.0 * SETTLE {
            self.motion.windows.push(Window {
                from,
                to: self.time(),
                rate: signed,
                frequency: 0.0,
            });
        }
        self.ramp(signed, 0.0)?;
        // The last ramp ends within the motion of a period.
        let rest = place - self.place;
        let duration = 0.05;
        self.add(duration, duration, |_| (rest, 0.0))
    }

    /// Moves to a place at a rate. The acceleration builds up linearly to `ramp.acceleration`,
    /// stays there, and decreases linearly. Durations are whole periods, so rate and acceleration
    /// are a little lower than given over a short distance.
    ///
    /// # Errors
    /// The distance is too short for the rate, or the machine cannot reach the place.
    pub fn stroke(&mut self, place: f64, rate: f64, ramp: &Ramp) -> Result<(), Error> {
        let distance = place - self.place;
        let up = (ramp.build_up_at(rate) / self.period).round().max(2.0);
        let hold = (rate / ramp.acceleration / self.period - up)
            .round()
            .max(0.0);
        let ramps = 2.0 * up + hold;
        let cruise = (distance.abs() / rate / self.period - ramps).ceil();
        if cruise < 0.0 {
            let what = format!(
                "a distance of {:.1} mm or degrees is too short for {rate:.1} per second; lengthen \
                 --travel",
                distance.abs()
            );
            return Err(Error::new(ErrorKind::Refused, what));
        }
        let [up_s, hold_s, cruise_s] = [up, hold, cruise].map(|it| it * self.period);
        let rate = distance / (ramps + cruise) / self.period;
        let slope = rate / (up_s + hold_s) / up_s;
        let (first, last) = (slope * up_s * up_s / 2.0, rate - slope * up_s * up_s / 2.0);
        let build = |rate: f64, slope: f64| {
            move |t: f64| {
                (
                    rate * t + slope * t * t * t / 6.0,
                    rate + slope * t * t / 2.0,
                )
            }
        };
        let even = |rate: f64, slope: f64| {
            move |t: f64| (rate * t + slope * t * t / 2.0, rate + slope * t)
        };
        let fade = |rate: f64, slope: f64| {
            move |t: f64| {
                let distance = (up_s / 2.0 - t / 6.0) * slope * t * t;
                (rate * t + distance, rate + slope * t * (up_s - t / 2.0))
            }
        };
        self.piece(up_s, build(0.0, slope))?;
        self.piece(hold_s, even(first, slope * up_s))?;
        self.piece(up_s, fade(last, slope))?;
        self.piece(cruise_s, even(rate, 0.0))?;
        self.piece(up_s, build(rate, -slope))?;
        self.piece(hold_s, even(last, -slope * up_s))?;
        self.piece(up_s, fade(first, -slope))
    }

    /// As [`Builder::add`], nothing in no time.
    fn piece(&mut self, duration: f64, at: impl Fn(f64) -> (f64, f64)) -> Result<(), Error> {
        if duration < self.period / 2.0 {
            return Ok(());
        }
        self.add(duration, SPAN, at)
    }

    /// Moves to and fro between the ends of the line at `rate`, with the sines on top, each for
    /// `seconds` and its tapers, in segments of at least `shortest` seconds.
    ///
    /// # Errors
    /// The machine cannot reach a place.
    pub fn sweep(
        &mut self,
        bursts: &[Burst],
        rate: f64,
        seconds: f64,
        shortest: f64,
    ) -> Result<(), Error> {
        let (low, high) = (self.line.low + 1.0, self.line.high - 1.0);
        let one = rate * (seconds + 2.0 * TAPER);
        let mut waiting = bursts;
        while !waiting.is_empty() {
            let forward = self.place < (low + high) / 2.0;
            let target = if forward { high } else { low };
            let room = (target - self.place).abs() - rate * (self.ramp_time(rate) + SETTLE);
            // The distances of one sine in both directions are equal, except for rounding.
            if room < 0.999 * one {
                let what = format!(
                    "a line of {:.0} mm or degrees is too short for an excitation at {rate:.1} per \
                     second; lengthen --travel",
                    high - low
                );
                return Err(Error::new(ErrorKind::Refused, what));
            }
            let count = ((room / one).floor() as usize).clamp(1, waiting.len());
            let (now, later) = waiting.split_at(count);
            waiting = later;
            let signed = if forward { rate } else { -rate };
            self.ramp(0.0, signed)?;
            self.add(SETTLE, 0.1, |t| (signed * t, signed))?;
            for burst in now {
                self.burst(*burst, signed, seconds, shortest)?;
            }
            self.ramp(signed, 0.0)?;
            self.rest(0.05)?;
        }
        Ok(())
    }

    fn burst(&mut self, burst: Burst, rate: f64, seconds: f64, shortest: f64) -> Result<(), Error> {
        let omega = TAU * burst.frequency;
        let total = seconds + 2.0 * TAPER;
        let span = (1.0 / (PER_CYCLE * burst.frequency)).clamp(shortest, SPAN.max(shortest));
        let amplitude = burst.acceleration / (omega * omega);
        let start = self.time();
        self.add(total, span, |t| {
            // The envelope, and its slope.
            let edge = t.min(total - t).clamp(0.0, TAPER);
            let sign = if t < total / 2.0 { 1.0 } else { -1.0 };
            let (sine, cosine) = (PI * edge / TAPER).sin_cos();
            let envelope = (1.0 - cosine) / 2.0;
            let slope = if edge < TAPER {
                sign * PI / TAPER * sine / 2.0
            } else {
                0.0
            };
            let distance = amplitude * envelope * (omega * t).sin();
            let speed =
                amplitude * (slope * (omega * t).sin() + envelope * omega * (omega * t).cos());
            (rate * t + distance, rate + speed)
        })?;
        self.motion.windows.push(Window {
            from: start + TAPER,
            to: start + TAPER + seconds,
            rate,
            frequency: burst.frequency,
        });
        Ok(())
    }

    /// The motion, and the place where it ends.
    #[must_use]
    pub fn finish(self) -> (Stimulus, f64) {
        (self.motion, self.place)
    }
}
