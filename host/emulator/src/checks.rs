//! Checks of a run: what the board commanded is what the controller in this process commands, and
//! what left its pins is what it commanded.

use crate::chip::CLOCK_HZ;
use crate::pico2::{Pico2, Stack};
use haptimill_client::session::pins::record::{JOINTS, Period};
use haptimill_firmware::config::Drive;
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{DriveCommand, Outputs};
use haptimill_firmware::profiler::{STAGES, Stage};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_pulses::{AxisSignals, Capture, Clock, Planned, Report, Rules, Signal, check};
use std::fmt;

/// Times of lines are rounded down to 1 fs, and so are the commanded ones.
const TOLERANCE: i64 = 2;

/// Result of the checks of a run.
#[derive(Debug, Clone)]
pub struct Checks {
    /// The pins against the commands.
    pub pulses: Report,
    /// Completed control periods.
    pub periods: u64,
    /// Missed control periods while the drives were off: the activation of a configuration takes
    /// some.
    pub missed: u64,
    /// Missed control periods while a drive was on.
    pub missed_enabled: u64,
    /// The first control period whose commands have other bits than those of the controller in
    /// this process, or that is not in the record.
    pub differing: Option<u64>,
    /// Joints whose steps the board counted, and the number at their pins, where they differ.
    pub miscounted: Vec<(String, i64, i64)>,
    /// Cycles of the control periods with pulses.
    pub cycles: Cycles,
    /// Cycles from the start of a control period to the end of its work, all handlers included: the
    /// largest number while a drive was on.
    pub busy: u32,
    /// Cycles of a control period.
    pub available: u32,
    /// Cycles from the time of a control period to the first work of its handler: the smallest and
    /// the largest number.
    pub late: (u32, u32),
    /// The stack.
    pub stack: Stack,
}

/// Cycles of control periods.
#[derive(Debug, Clone, Copy, Default)]
pub struct Cycles {
    /// Number of control periods.
    pub periods: u64,
    /// Sum, and largest number, of a period.
    pub sum: u64,
    /// Largest number of a period.
    pub worst: u32,
    /// Sums of the stages of the controller, and of the words for the PIO at the end.
    pub stages: [u64; STAGES + 1],
    /// Largest numbers of the stages.
    pub worst_stages: [u32; STAGES + 1],
}

impl Cycles {
    fn add(&mut self, period: &Period) {
        self.periods += 1;
        self.sum += u64::from(period.cycles());
        self.worst = self.worst.max(period.cycles());
        let stages = period.stages.iter().chain([&period.words]);
        for (stage, cycles) in stages.enumerate() {
            self.stages[stage] += u64::from(*cycles);
            self.worst_stages[stage] = self.worst_stages[stage].max(*cycles);
        }
    }

    /// Mean of a period.
    #[must_use]
    pub const fn mean(&self) -> u64 {
        self.sum / if self.periods == 0 { 1 } else { self.periods }
    }
}

/// Whether a control period has pulses.
fn has_pulses(period: &Period) -> bool {
    let steps = |command: &DriveCommand| match command {
        DriveCommand::Steps(segment) => segment.count != 0,
        _ => false,
    };
    period.commands.iter().any(steps)
}

/// Whether a drive is on.
fn is_on(period: &Period) -> bool {
    period.commands.iter().any(|it| *it != DriveCommand::Off)
}

/// Missed periods while a drive was on, or while all were off.
fn missed(periods: &[Period], enabled: bool) -> u64 {
    let pairs = periods.iter().zip(periods.iter().skip(1));
    pairs
        .filter(|(before, _)| is_on(before) == enabled)
        .map(|(_, period)| u64::from(period.inputs.missed))
        .sum()
}

/// The first period whose commands are not those of a controller in this process that is given the
/// same inputs.
fn first_difference(periods: &[Period], period_us: u16) -> Option<u64> {
    let mut controller = Controller::new(period_us);
    let mut outputs = Outputs::default();
    let mut next = 0;
    for period in periods {
        let number = period.inputs.period;
        next += u64::from(period.inputs.missed);
        if number != next {
            return Some(next);
        }
        next += 1;
        outputs.transmit.clear();
        controller.tick(&period.inputs, &mut outputs, &mut ());
        if outputs.joints[..JOINTS] != period.commands {
            return Some(number);
        }
    }
    None
}

/// Segments of a joint, by the period in which their pulses leave: the next one that was not
/// missed.
fn planned(periods: &[Period], joint: usize) -> Vec<Planned> {
    let pairs = periods.iter().zip(&periods[1..]);
    let steps = pairs.filter_map(|(period, next)| match period.commands[joint] {
        DriveCommand::Steps(segment) if segment.count != 0 => Some(Planned {
            period: next.inputs.period,
            segment,
        }),
        _ => None,
    });
    steps.collect()
}

/// Rules of the drives of a machine.
fn rules(machine: &MachineFile) -> Rules {
    let mut rules = Rules {
        clock: Clock {
            ticks_per_us: (CLOCK_HZ / 2_000_000) as u32,
            period_us: u32::from(machine.config.period_us),
        },
        tolerance: TOLERANCE,
        width: 0,
        pause: 0,
        setup: 0,
        hold: 0,
        exact_width: None,
    };
    let clock = rules.clock;
    let mut widths = Vec::new();
    for joint in &machine.config.joints {
        let Drive::Steps {
            pulse, setup, hold, ..
        } = joint.drive
        else {
            continue;
        };
        let min = |ticks: u16| clock.femtoseconds(i64::from(ticks)) - TOLERANCE;
        widths.push(u32::from(pulse));
        rules.width = rules.width.max(min(pulse));
        rules.pause = rules.pause.max(min(pulse));
        rules.setup = rules.setup.max(min(setup));
        rules.hold = rules.hold.max(min(hold));
    }
    // Joints of one width only: the rule is for all.
    rules.exact_width = widths
        .first()
        .copied()
        .filter(|first| widths.iter().all(|width| width == first));
    rules
}

impl Checks {
    /// Checks the run of a board since its start. A board that still moves has pulses in the last
    /// period whose commands are not compared.
    #[must_use]
    pub fn of(board: &mut Pico2, machine: &MachineFile) -> Self {
        let stack = board.stack();
        let board = &*board;
        let periods = &board.periods;
        let model = Model::new(machine);
        let names = model.joint_names();
        let commanded: Vec<Vec<Planned>> = (0..names.len().min(JOINTS))
            .map(|joint| match periods.len() {
                0 => Vec::new(),
                _ => planned(periods, joint),
            })
            .collect();
        let axes: Vec<AxisSignals<'_>> = commanded
            .iter()
            .enumerate()
            .map(|(joint, planned)| AxisSignals {
                name: names[joint],
                step: &board.lines.step[joint],
                direction: &board.lines.direction[joint],
                planned: Some(planned),
            })
            .collect();
        let capture = Capture {
            resolution: 1,
            start: 0,
            end: board.time(),
            signals: Vec::new(),
        };
        let pulses = check(&capture, &axes, Some(&board.lines.enable), &rules(machine));
        let mut cycles = Cycles::default();
        periods
            .iter()
            .filter(|it| has_pulses(it))
            .for_each(|period| cycles.add(period));
        let on = periods.iter().filter(|period| is_on(period));
        let busy = on.map(|period| period.busy).max().unwrap_or(0);
        let late = periods.iter().map(|period| period.late);
        let late = (late.clone().min().unwrap_or(0), late.max().unwrap_or(0));
        // The count of a moving board is one of an earlier moment.
        let at_rest = periods.iter().rev().take(4).all(|it| !has_pulses(it));
        let last = periods.last().filter(|_| at_rest);
        let miscounted = last.map_or_else(Vec::new, |last| {
            let counts = names.iter().zip(&last.inputs.joints).zip(board.steps);
            counts
                .map(|((name, axis), pins)| ((*name).to_string(), i64::from(axis.steps), pins))
                .filter(|(_, counted, pins)| counted != pins)
                .collect()
        });
        Self {
            pulses,
            periods: periods.len() as u64,
            missed: missed(periods, false),
            missed_enabled: missed(periods, true),
            differing: first_difference(periods, machine.config.period_us),
            miscounted,
            cycles,
            busy,
            available: u32::from(machine.config.period_us) * (CLOCK_HZ / 1_000_000) as u32,
            late,
            stack,
        }
    }

    /// Part of the control period that is left in the worst one, %; negative if it ended too late.
    #[must_use]
    pub fn margin_percent(&self) -> f64 {
        100.0 - 100.0 * f64::from(self.busy) / f64::from(self.available)
    }

    /// No fault was found.
    #[must_use]
    pub fn passed(&self) -> bool {
        let counts = |axis: &haptimill_pulses::AxisReport| axis.commanded == Some(axis.count);
        self.pulses.fault_count() == 0
            && self.pulses.axes.iter().all(counts)
            && self.differing.is_none()
            && self.miscounted.is_empty()
    }
}

impl fmt::Display for Checks {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for axis in &self.pulses.axes {
            writeln!(out, "{axis}")?;
        }
        for (name, counted, pins) in &self.miscounted {
            writeln!(
                out,
                "{name}: the board counts {counted}, its pins made {pins}"
            )?;
        }
        match self.differing {
            Some(period) => writeln!(
                out,
                "control period {period}: the commands are not those of the controller in this process"
            )?,
            None => writeln!(
                out,
                "{} control periods, {} missed with the drives on, {} with the drives off; their \
                 commands have the bits of the controller in this process",
                self.periods, self.missed_enabled, self.missed
            )?,
        }
        writeln!(
            out,
            "{} cycles a control period with pulses, at most {}; the words for the PIO at most {}",
            self.cycles.mean(),
            self.cycles.worst,
            self.cycles.worst_stages[STAGES]
        )?;
        writeln!(
            out,
            "the worst control period with a drive on: {} of {} cycles with all handlers, {:.1} % left",
            self.busy,
            self.available,
            self.margin_percent()
        )?;
        let (min, max) = self.late;
        writeln!(
            out,
            "a control period begins {min} to {max} cycles after its time"
        )?;
        let names = Stage::ALL.iter().map(|stage| stage.name());
        for (stage, name) in names.chain(["words for the PIO"]).enumerate() {
            let mean = self.cycles.stages[stage] / self.cycles.periods.max(1);
            let worst = self.cycles.worst_stages[stage];
            writeln!(out, "  {name}: {mean} cycles, at most {worst}")?;
        }
        write!(
            out,
            "stack: {} of {} bytes were used, {} by the start",
            self.stack.used, self.stack.size, self.stack.start
        )
    }
}

/// Writes the lines that a board drove as a value change dump, in ps.
///
/// # Errors
/// The file cannot be written.
pub fn write_vcd(
    board: &Pico2,
    machine: &MachineFile,
    out: &mut impl std::io::Write,
) -> std::io::Result<()> {
    let model = Model::new(machine);
    let mut lines: Vec<(String, &Signal)> = vec![("enable".to_string(), &board.lines.enable)];
    for (joint, name) in model.joint_names().into_iter().enumerate().take(JOINTS) {
        lines.push((format!("{name}_step"), &board.lines.step[joint]));
        lines.push((format!("{name}_dir"), &board.lines.direction[joint]));
    }
    writeln!(out, "$timescale 1 ps $end\n$scope module board $end")?;
    let code = |line: usize| char::from(b'!' + line as u8);
    for (line, (name, _)) in lines.iter().enumerate() {
        writeln!(out, "$var wire 1 {} {name} $end", code(line))?;
    }
    writeln!(out, "$upscope $end\n$enddefinitions $end\n#0")?;
    for (line, (_, signal)) in lines.iter().enumerate() {
        writeln!(out, "{}{}", u8::from(signal.initial), code(line))?;
    }
    let mut changes: Vec<(i64, usize, bool)> = Vec::new();
    for (line, (_, signal)) in lines.iter().enumerate() {
        let levels = signal.changes.iter().enumerate();
        changes.extend(levels.map(|(at, time)| (*time, line, signal.initial ^ (at % 2 == 0))));
    }
    changes.sort_unstable();
    let mut now = 0;
    for (time, line, level) in changes {
        let stamp = time / 1000;
        if stamp != now {
            writeln!(out, "#{stamp}")?;
            now = stamp;
        }
        writeln!(out, "{}{}", u8::from(level), code(line))?;
    }
    writeln!(out, "#{}", board.time() / 1000)
}
