//! Runs part programs on an observed machine.

use crate::observed::{ObservedLine, Sample};
use haptimill_client::client::Options;
use haptimill_client::session::{self, NoObserver, Session, SimLine};
use haptimill_client::{Error, ErrorKind};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::{Model, program_options, settings};
use haptimill_planner::Plan;
use haptimill_protocol::message::{AxisValues, Command, Telemetry};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Control periods between two samples of a run with standstills.
pub const SLOW: u64 = 25;

/// Distance within which a commanded position is a target, mm or degrees. A target is rounded to
/// 1e-6.
const AT_TARGET: f64 = 2e-6;

/// A machine that is homed and ready for programs.
pub struct Machine {
    session: Session<ObservedLine>,
    machine: MachineFile,
    model: Model,
    jobs: u32,
}

impl Machine {
    /// Powers the simulated machine on, configures and homes it. It samples every `every` periods.
    ///
    /// # Errors
    /// The machine file has no simulated machine, or the machine does not home.
    pub fn new(
        machine: &MachineFile,
        every: u64,
        interrupted: &Arc<AtomicBool>,
    ) -> Result<Self, Error> {
        let mut powered = Self::without_homing(machine, every, interrupted)?;
        let home = session::find_home_pose(machine, &powered.model)?;
        powered.session.go_home(machine, &home)?;
        Ok(powered)
    }

    /// As [`Machine::new`], without homing: no program runs on it.
    ///
    /// # Errors
    /// The machine file has no simulated machine.
    pub fn without_homing(
        machine: &MachineFile,
        every: u64,
        interrupted: &Arc<AtomicBool>,
    ) -> Result<Self, Error> {
        let rig = session::rig(machine, None, None, Vec::new())?;
        let line = ObservedLine::new(SimLine::new(rig), machine, every);
        let mut session = Session::new(line, machine, Options::default(), Arc::clone(interrupted));
        session.connect(1)?;
        session.configure(machine)?;
        session.enable()?;
        Ok(Self {
            session,
            machine: machine.clone(),
            model: Model::new(machine),
            jobs: 1,
        })
    }

    /// Switches volumetric compensation on or off, and waits until it has faded.
    ///
    /// # Errors
    /// The machine has no error tables.
    pub fn compensate(&mut self, on: bool) -> Result<(), Error> {
        self.session.ask(Command::Compensation { on })?;
        let end = if on { 100 } else { 0 };
        for _ in 0..100 {
            if self.status()?.compensation() == Some(end) {
                return Ok(());
            }
            for _ in 0..200 {
                self.session.step()?;
            }
        }
        let what = "volumetric compensation does not fade: it needs a homed machine with its drives on; \
                    home it first";
        Err(Error::new(ErrorKind::Command, what))
    }

    /// The newest telemetry.
    ///
    /// # Errors
    /// The session failed.
    pub fn status(&mut self) -> Result<Telemetry, Error> {
        self.session.status()
    }

    fn program_options(&self, start: &AxisValues) -> haptimill_gcode::Options {
        program_options(&self.machine, self.model.to_engineering_units(start))
    }

    /// Runs a part program from the present pose, and returns the samples of its run.
    ///
    /// # Errors
    /// The program is refused or does not complete.
    pub fn run(&mut self, name: &str, text: &str) -> Result<Vec<Sample>, Error> {
        let start = self.status()?.commanded;
        let options = self.program_options(&start);
        let program = haptimill_gcode::read(name, text.as_bytes(), &options)
            .map_err(|refused| Error::refused(ErrorKind::BadInput, &refused))?;
        let plan = Plan::new(&program, &settings(&self.machine), &self.model)
            .map_err(|refused| Error::refused(ErrorKind::Refused, &refused))?;
        self.jobs += 1;
        self.session.line_mut().begin();
        let end = self
            .session
            .run_job(self.jobs, start, plan.setpoints, &mut NoObserver)?;
        self.session.check_completed(&end)?;
        Ok(self.session.line_mut().end())
    }

    /// Moves to each target, waits there, and returns the machine at standstill at each: the mean
    /// over the last `window` seconds of each wait. Targets have the first coordinates of a pose,
    /// mm and degrees.
    ///
    /// # Errors
    /// A target is out of reach, or the run fails.
    pub fn visit<const N: usize>(
        &mut self,
        targets: &[[f64; N]],
        feed: f64,
        wait: f64,
        window: f64,
    ) -> Result<Vec<Sample>, Error> {
        let mut text = format!("G21 G90 G61 G94 F{}\n", feed * 60.0);
        let coordinates = self.machine.config.model.descriptor().pose;
        for target in targets {
            text.push_str("G1");
            for (coordinate, value) in coordinates.iter().zip(target) {
                text.push_str(&format!(" {}{value:.6}", coordinate.letter));
            }
            text.push_str(&format!("\nG4 P{wait}\n"));
        }
        text.push_str("M30\n");
        let samples = self.run("targets", &text)?;
        standstills(&samples, targets, wait, window)
    }
}

/// The machine at standstill at each target, in their order: the mean over the last `window`
/// seconds of the wait there.
fn standstills<const N: usize>(
    samples: &[Sample],
    targets: &[[f64; N]],
    wait: f64,
    window: f64,
) -> Result<Vec<Sample>, Error> {
    let mut at = 0;
    let mut means = Vec::new();
    for target in targets {
        let is_there = |sample: &Sample| {
            let places = sample.commanded.iter().zip(target);
            places
                .into_iter()
                .all(|(place, target)| (place - target).abs() < AT_TARGET)
        };
        let from = samples[at..]
            .iter()
            .position(is_there)
            .map(|first| at + first);
        let missing = || {
            let what = format!(
                "the machine did not stand still at {target:?} mm for the window of the readings; \
                 wait longer"
            );
            Error::new(ErrorKind::Internal, what)
        };
        let from = from.ok_or_else(missing)?;
        let count = samples[from..]
            .iter()
            .take_while(|sample| is_there(sample))
            .count();
        // Two targets in a row may be the same place.
        let start = samples[from].time;
        let inside = samples[from..from + count]
            .iter()
            .filter(|sample| (start + wait - window..start + wait).contains(&sample.time));
        let inside: Vec<&Sample> = inside.collect();
        let mean = mean(&inside).ok_or_else(missing)?;
        let next = samples[from..from + count]
            .iter()
            .position(|sample| sample.time >= start + wait);
        at = from + next.unwrap_or(count);
        means.push(mean);
    }
    Ok(means)
}

fn mean(samples: &[&Sample]) -> Option<Sample> {
    let mut sum = **samples.first()?;
    for sample in &samples[1..] {
        let add = |sum: &mut [f64], by: &[f64]| {
            sum.iter_mut().zip(by).for_each(|(sum, by)| *sum += by);
        };
        add(&mut sum.commanded, &sample.commanded);
        add(&mut sum.reported, &sample.reported);
        add(&mut sum.tool, &sample.tool);
        add(&mut sum.carriages, &sample.carriages);
    }
    let count = samples.len() as f64;
    let Sample {
        commanded,
        reported,
        tool,
        carriages,
        ..
    } = &mut sum;
    for values in [commanded, reported, tool, carriages] {
        values.iter_mut().for_each(|value| *value /= count);
    }
    Some(sum)
}
