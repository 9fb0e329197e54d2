//! Time that a job takes at overrides: the speed factor of the controller, without its link.

use haptimill_firmware::motion::interpolator::{FULL_FACTOR, braking_limits};
use haptimill_firmware::motion::ramp::{Ramp, RampLimits};
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::{Action, OverrideMode};
use haptimill_protocol::setpoint::Setpoint;

/// Sums up the time of a job that nothing stops, setpoint by setpoint. Pauses take no time.
#[derive(Debug)]
pub struct RunTime {
    /// Feed and rapid override, percent.
    overrides: [u8; 2],
    limits: Option<RampLimits>,
    period_s: f64,
    rate: Ramp,
    target: i64,
    /// Control periods so far, and program time beyond the last setpoint, 2^-32 periods.
    periods: u64,
    time: i64,
}

impl RunTime {
    /// Begins at the overrides of feed (at least 1 %) and of rapid moves (at least 1 %).
    #[must_use]
    pub fn new(machine: &MachineFile, feed: u8, rapid: u8) -> Self {
        let config = &machine.config;
        let target = target(OverrideMode::FEED, [feed.max(1), rapid.max(1)]);
        Self {
            overrides: [feed.max(1), rapid.max(1)],
            limits: braking_limits(&config.stopping, config.period_us),
            period_s: f64::from(config.period_us) * 1e-6,
            rate: Ramp::at(target),
            target,
            periods: 0,
            time: 0,
        }
    }

    /// Adds the motion to a setpoint.
    pub fn add(&mut self, setpoint: &Setpoint) {
        let end = i64::from(setpoint.periods) * FULL_FACTOR;
        while self.time < end {
            let steady = self.rate == Ramp::at(self.target);
            match &self.limits {
                Some(limits) if !steady => {
                    self.time += self.rate.advance(self.target, limits).max(0);
                    self.periods += 1;
                }
                _ => {
                    let periods = (end - self.time + self.target - 1) / self.target;
                    self.time += periods * self.target;
                    self.periods += periods as u64;
                }
            }
        }
        self.time -= end;
        if let Action::OverrideMode(mode) = setpoint.action {
            let is_steady = self.rate == Ramp::at(self.target);
            self.target = target(mode, self.overrides);
            // The controller begins a motion at its override.
            if is_steady && setpoint.rates.iter().all(|rate| *rate == 0) {
                self.rate = Ramp::at(self.target);
            }
        }
    }

    /// The time so far, seconds.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        self.periods as f64 * self.period_s
    }
}

/// Rows of a [`TimeTable`] at most.
const ROWS: usize = 2000;

/// Time that is left of a job at overrides, by its program time.
#[derive(Debug, Clone, Default)]
pub struct TimeTable {
    /// Program time in control periods, and the time until then, seconds.
    rows: Vec<(u64, f64)>,
}

impl TimeTable {
    /// Creates the table of a job at the overrides of feed and of rapid moves, percent.
    #[must_use]
    pub fn new(machine: &MachineFile, setpoints: &[Setpoint], feed: u8, rapid: u8) -> Self {
        let mut time = RunTime::new(machine, feed, rapid);
        let mut rows = vec![(0, 0.0)];
        let mut periods = 0;
        let every = setpoints.len().div_ceil(ROWS).max(1);
        for (number, setpoint) in (1..).zip(setpoints) {
            periods += u64::from(setpoint.periods);
            time.add(setpoint);
            if number % every == 0 || number == setpoints.len() {
                rows.push((periods, time.seconds()));
            }
        }
        Self { rows }
    }

    /// Time of the whole job, seconds.
    #[must_use]
    pub fn total_s(&self) -> f64 {
        self.rows.last().map_or(0.0, |row| row.1)
    }

    /// Time that is left behind a program time in control periods, seconds.
    #[must_use]
    pub fn left_s(&self, program_periods: u64) -> f64 {
        let next = self.rows.partition_point(|row| row.0 <= program_periods);
        let (Some(before), Some(after)) =
            (self.rows.get(next.wrapping_sub(1)), self.rows.get(next))
        else {
            return 0.0;
        };
        let part = (program_periods - before.0) as f64 / (after.0 - before.0).max(1) as f64;
        self.total_s() - (before.1 + part * (after.1 - before.1))
    }
}

/// Times of a job whose setpoints are not kept, in memory that does not depend on its length.
#[derive(Debug, Clone, Default)]
pub struct TimeProfile {
    /// Program time in control periods at each override mode, in parts of the job with equally many
    /// setpoints; the last part is not full.
    parts: Vec<Vec<(OverrideMode, u64)>>,
    /// Setpoints of a part, and of the last one.
    every: usize,
    in_last: usize,
    override_mode: OverrideMode,
}

impl TimeProfile {
    /// Adds the motion to a setpoint.
    pub fn add(&mut self, setpoint: &Setpoint) {
        if self.parts.is_empty() || self.in_last == self.every {
            if self.parts.len() == 2 * ROWS {
                self.merge_pairs();
            }
            self.every = self.every.max(1);
            self.parts.push(Vec::new());
            self.in_last = 0;
        }
        if let Some(part) = self.parts.last_mut() {
            add_periods(part, self.override_mode, u64::from(setpoint.periods));
        }
        self.in_last += 1;
        if let Action::OverrideMode(mode) = setpoint.action {
            self.override_mode = mode;
        }
    }

    fn merge_pairs(&mut self) {
        let merged = self.parts.chunks(2).map(|pair| {
            let mut whole = Vec::new();
            for (mode, periods) in pair.iter().flatten() {
                add_periods(&mut whole, *mode, *periods);
            }
            whole
        });
        self.parts = merged.collect();
        self.every *= 2;
    }

    /// The table of the job at the overrides of feed and of rapid moves, percent. The time in which
    /// the controller changes from one override mode to another is left out.
    #[must_use]
    pub fn table(&self, machine: &MachineFile, feed: u8, rapid: u8) -> TimeTable {
        let period_s = f64::from(machine.config.period_us) * 1e-6;
        let mut rows = vec![(0, 0.0)];
        let (mut periods, mut seconds) = (0, 0.0);
        for part in &self.parts {
            for (mode, count) in part {
                let factor = f64::from(mode.factor(feed.max(1), rapid.max(1))) / 100.0;
                periods += count;
                seconds += *count as f64 * period_s / factor;
            }
            rows.push((periods, seconds));
        }
        TimeTable { rows }
    }
}

fn add_periods(part: &mut Vec<(OverrideMode, u64)>, mode: OverrideMode, periods: u64) {
    match part.iter_mut().find(|(known, _)| *known == mode) {
        Some((_, sum)) => *sum += periods,
        None => part.push((mode, periods)),
    }
}

fn target(mode: OverrideMode, [feed, rapid]: [u8; 2]) -> i64 {
    FULL_FACTOR * i64::from(mode.factor(feed, rapid)) / 100
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptimill_protocol::message::AxisValues;

    /// A standstill of 5 s at feed, then one of 5 s in a rapid move, in spans of 0.1 s.
    fn setpoints() -> Vec<Setpoint> {
        let rest = |number: u32| Setpoint {
            periods: 500,
            pose: AxisValues::from_slice(&[0; 5]).expect("five axes"),
            rates: AxisValues::from_slice(&[0; 5]).expect("five axes"),
            action: match number {
                49 => Action::OverrideMode(OverrideMode::RAPID),
                _ => Action::None,
            },
        };
        (0..100).map(rest).collect()
    }

    /// The profile of a long job has as many parts as that of a short one, and the times of the
    /// table of all setpoints.
    #[test]
    fn a_profile_has_the_times_of_the_setpoints() {
        let machine = MachineFile::built_in().expect("the built-in machine");
        let short = setpoints();
        let long: Vec<Setpoint> = short.iter().cycle().take(500_000).cloned().collect();
        for setpoints in [&short, &long] {
            let mut profile = TimeProfile::default();
            setpoints.iter().for_each(|setpoint| profile.add(setpoint));
            assert!(profile.parts.len() <= 2 * ROWS);
            for (feed, rapid) in [(100, 100), (50, 100), (100, 25), (200, 50)] {
                let table = profile.table(&machine, feed, rapid);
                let exact = TimeTable::new(&machine, setpoints, feed, rapid);
                let total = exact.total_s();
                for part in 0..=10 {
                    let periods = setpoints.len() as u64 * 500 * part / 10;
                    let error = table.left_s(periods) - exact.left_s(periods);
                    assert!(
                        error.abs() < 0.02 * total,
                        "{feed} {rapid} {part}: {error} of {total}"
                    );
                }
            }
        }
    }

    #[test]
    fn the_time_that_is_left_follows_both_overrides() {
        let machine = MachineFile::built_in().expect("the built-in machine");
        for (feed, rapid, total) in [
            (100, 100, 10.0),
            (50, 100, 15.0),
            (100, 25, 25.0),
            (10, 10, 100.0),
        ] {
            let table = TimeTable::new(&machine, &setpoints(), feed, rapid);
            assert!(
                (table.total_s() - total).abs() < 0.01,
                "{}",
                table.total_s()
            );
            // Behind a quarter, three quarters, all.
            let slow = [feed, rapid].map(|percent| 100.0 / f64::from(percent));
            for (periods, left) in [
                (12_500, 2.5 * slow[0] + 5.0 * slow[1]),
                (37_500, 2.5 * slow[1]),
                (37_600, 2.48 * slow[1]),
                (50_000, 0.0),
                (60_000, 0.0),
            ] {
                let is = table.left_s(periods);
                assert!(
                    (is - left).abs() < 0.01,
                    "{is} s instead of {left} at {feed}, {rapid}"
                );
            }
        }
        assert_eq!(TimeTable::default().left_s(5), 0.0);
    }
}
