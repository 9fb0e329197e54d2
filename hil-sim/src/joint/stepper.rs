//! Step/direction drive with its motor, and the check of the pulses that reach it.
//!
//! The motor follows the commanded position through its magnetic field: effort = pull-out effort *
//! sin(2 pi lag / electrical turn). An electrical turn is two full steps for each phase: four of a
//! 2-phase motor, ten of a 5-phase motor. Beyond half of it the rotor settles at the next stable
//! position. Steps are therefore lost in multiples of an electrical turn, and the drive does not
//! detect it.
//!
//! Pulses are checked against the drive's data sheet: width, pause, direction set-up and hold. Each
//! pulse must begin within its period. A pulse that violates the data sheet is emitted and counted,
//! but the drive ignores it. This is the worse of the two possible reactions of a drive.
//!
//! Times within a period are in ticks of the board's step clock.

use crate::joint::{JointConfig, StepDrive};
use haptimill_firmware::io::StepSegment;
use std::collections::VecDeque;

/// Violation of the pulse timing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PulseProblem {
    /// The pulse is shorter than the drive can detect.
    Width,
    /// The pulse came too soon after the one before.
    Interval,
    /// The pulse came too soon after a change of direction.
    Setup,
    /// The direction changed too soon after a pulse.
    Hold,
    /// The pulse would begin after the period; such a pulse is not emitted.
    BeyondPeriod,
}

/// A pulse that violated the data sheet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PulseViolation {
    /// Tick of the step clock since the start.
    pub tick: i64,
    /// Kind of violation.
    pub problem: PulseProblem,
}

/// Report on the pulses of a drive.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PulseReport {
    /// Number of pulses that violated the data sheet.
    pub violations: u64,
    /// First violation.
    pub first: Option<PulseViolation>,
    /// Shortest time between two pulses so far, ticks.
    pub shortest_interval: Option<i64>,
}

/// A step motor with its drive.
#[derive(Debug, Clone)]
pub struct Stepper {
    /// Axis units per step, with the sign of the direction.
    per_step: f64,
    /// Electrical turns per axis unit.
    per_electrical_turn: f64,
    pull_out: f64,
    damping: f64,
    /// Coordinate of the field at step 0.
    origin: f64,
    /// Steps that the drive accepted.
    seen: i64,
    /// Steps that the board emitted.
    emitted: i32,
    period_ticks: i64,
    width_ticks: f64,
    min_width_ticks: f64,
    min_interval_ticks: f64,
    setup_ticks: f64,
    hold_ticks: f64,
    /// Tick at the start of the current period.
    period_start: i64,
    up: bool,
    direction_tick: i64,
    last_pulse: Option<i64>,
    /// Pulses of the current period, with times in ticks.
    segment: StepSegment,
    next: i64,
    /// Pulses that were seen on the line of a board: tick of the current period, and direction.
    seen_pulses: VecDeque<(i64, bool)>,
    report: PulseReport,
}

/// sin(2 pi turns). The error is below 1e-7, and the result has the same bits on every host.
fn sine_of_turns(turns: f64) -> f64 {
    // Nearest integer.
    let turns = turns - libm::rint(turns);
    let folded = if turns > 0.25 {
        0.5 - turns
    } else if turns < -0.25 {
        -0.5 - turns
    } else {
        turns
    };
    let x = folded * core::f64::consts::TAU;
    let square = x * x;
    let series = -1.0 / 39_916_800.0;
    let series = series * square + 1.0 / 362_880.0;
    let series = series * square - 1.0 / 5040.0;
    let series = series * square + 1.0 / 120.0;
    let series = series * square - 1.0 / 6.0;
    x + x * square * series
}

impl Stepper {
    /// Creates the drive of a joint whose motor is at `motor`; the field is aligned with it.
    pub fn new(joint: &JointConfig, drive: &StepDrive, motor: f64, period_us: u16) -> Self {
        let full_step = joint.lead / f64::from(drive.full_steps);
        let ticks = f64::from(drive.ticks_per_us) * 1e-3;
        let sign = if drive.reversed { -1.0 } else { 1.0 };
        Self {
            per_step: sign * full_step / f64::from(drive.microsteps),
            per_electrical_turn: 1.0 / (2.0 * f64::from(drive.phases) * full_step),
            pull_out: drive.pull_out,
            damping: drive.damping,
            origin: motor,
            seen: 0,
            emitted: 0,
            period_ticks: i64::from(period_us) * i64::from(drive.ticks_per_us),
            width_ticks: drive.pulse_ns * ticks,
            min_width_ticks: drive.min_high_ns * ticks,
            min_interval_ticks: (drive.pulse_ns + drive.min_low_ns) * ticks,
            setup_ticks: drive.setup_ns * ticks,
            hold_ticks: drive.hold_ns * ticks,
            period_start: 0,
            up: true,
            direction_tick: i64::MIN / 2,
            last_pulse: None,
            segment: StepSegment::default(),
            next: 0,
            seen_pulses: VecDeque::new(),
            report: PulseReport::default(),
        }
    }

    /// Steps that the board emitted, wraps around.
    pub const fn emitted(&self) -> i32 {
        self.emitted
    }

    /// Position of the field, axis units.
    pub fn commanded(&self) -> f64 {
        self.origin + self.per_step * self.seen as f64
    }

    /// Report on all pulses so far.
    pub const fn report(&self) -> PulseReport {
        self.report
    }

    fn violate(&mut self, tick: i64, problem: PulseProblem) {
        self.report.violations += 1;
        self.report
            .first
            .get_or_insert(PulseViolation { tick, problem });
    }

    /// Begins a period with this segment; a drive that is off gets an empty one.
    pub fn begin(&mut self, segment: StepSegment) {
        self.segment = segment;
        self.next = 0;
        let up = segment.count > 0;
        if segment.count != 0 && up != self.up {
            if self.last_pulse.is_some_and(|last| {
                ((self.period_start - last) as f64) < self.width_ticks + self.hold_ticks
            }) {
                self.violate(self.period_start, PulseProblem::Hold);
            }
            self.up = up;
            self.direction_tick = self.period_start;
        }
    }

    /// Adds a pulse that was seen on the line of a board, at this tick of the current period, in
    /// the order of the ticks. Its timing is not checked here.
    pub fn add_pulse(&mut self, tick: i64, up: bool) {
        self.seen_pulses.push_back((tick, up));
    }

    /// Emits the remaining pulses of the period and moves to the next period.
    pub fn end(&mut self) {
        // A pulse that was seen in the very last moment of the period belongs to it, too: left in
        // the queue it would hold up all later ones.
        self.take_seen(i64::MAX);
        self.advance_to(self.period_ticks);
        let left = i64::from(self.segment.count).abs() - self.next;
        for _ in 0..left {
            self.violate(
                self.period_start + self.period_ticks,
                PulseProblem::BeyondPeriod,
            );
        }
        self.period_start += self.period_ticks;
        self.segment = StepSegment::default();
        self.next = 0;
    }

    /// Emits the pulses that start before this tick of the period.
    fn advance_to(&mut self, tick: i64) {
        self.take_seen(tick);
        while self.next < i64::from(self.segment.count).abs() {
            let k = self.next;
            let leaves = i64::from(self.segment.delay)
                + k * i64::from(self.segment.interval)
                + i64::from(self.segment.ramp) * k * (k - 1) / 2;
            if leaves >= tick.min(self.period_ticks) {
                break;
            }
            self.next += 1;
            self.pulse(self.period_start + leaves);
        }
    }

    /// Moves the field by the pulses on the line of a board before this tick of the period.
    fn take_seen(&mut self, tick: i64) {
        while let Some(&(at, up)) = self.seen_pulses.front()
            && at < tick
        {
            self.seen_pulses.pop_front();
            let step = if up { 1 } else { -1 };
            self.emitted = self.emitted.wrapping_add(step);
            self.seen += i64::from(step);
        }
    }

    fn pulse(&mut self, tick: i64) {
        let sign = if self.up { 1 } else { -1 };
        self.emitted = self.emitted.wrapping_add(sign);
        let interval = self.last_pulse.map(|last| tick - last);
        self.last_pulse = Some(tick);
        if let Some(interval) = interval {
            self.report.shortest_interval = Some(
                self.report
                    .shortest_interval
                    .map_or(interval, |min| min.min(interval)),
            );
        }
        if self.width_ticks < self.min_width_ticks {
            self.violate(tick, PulseProblem::Width);
        } else if interval.is_some_and(|interval| (interval as f64) < self.min_interval_ticks) {
            self.violate(tick, PulseProblem::Interval);
        } else if ((tick - self.direction_tick) as f64) < self.setup_ticks {
            self.violate(tick, PulseProblem::Setup);
        } else {
            self.seen += i64::from(sign);
        }
    }

    /// Effort of the motor at a fraction 0 to 1 of the period, with its rotor at `motor` and
    /// `rate`.
    pub fn effort(&mut self, part: f64, motor: f64, rate: f64) -> f64 {
        self.advance_to((part * self.period_ticks as f64) as i64);
        let lag = self.commanded() - motor;
        self.pull_out * sine_of_turns(lag * self.per_electrical_turn) - self.damping * rate
    }
}

#[cfg(test)]
mod tests {
    use super::sine_of_turns;

    #[test]
    fn sine_of_turns_is_a_sine() {
        for step in -4000..4000 {
            let turns = f64::from(step) / 1234.5;
            let want = libm::sin(core::f64::consts::TAU * turns);
            assert!((sine_of_turns(turns) - want).abs() < 1e-7, "{turns}");
        }
    }
}
