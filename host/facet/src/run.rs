//! Cuts a gem on the simulated machine: the job over the link, operation by operation, with the
//! stone and the laps in the plant.

use crate::gem::Gem;
use crate::job::{Job, Lap, Mode, Mount, Operation, Pass, in_design};
use crate::measure::Measured;
use crate::reach::check_machine;
use haptimill_client::client::Options;
use haptimill_client::session::{
    ForceLoopChanges, JobObserver, Session, SimLine, commissioned, find_home_pose, rig,
};
use haptimill_client::{Error, ErrorKind};
use haptimill_hil_sim::polyhedron::Polyhedron;
use haptimill_hil_sim::process::LapConfig;
use haptimill_hil_sim::process::grinding::{ForceStatistics, Grinding, Ground, HardSpot, Turn};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::{Model, program_options, settings};
use haptimill_planner::Plan;
use haptimill_protocol::message::{AxisValues, Telemetry};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Axis of force control: z of the lap.
const HEIGHT: u8 = 2;

/// A facet sparks out as long as the displacement of the stone falls by this part in
/// [`PROGRESS_SWEEPS`] spark-outs.
const PROGRESS_PART: f64 = 0.05;

/// Spark-outs in which it must fall.
const PROGRESS_SWEEPS: u32 = 20;

/// Further spark-outs of a facet, at most.
const MAX_SWEEPS: u32 = 2000;

/// Further spark-outs of a facet that is at its depth and whose force does not vanish, at most.
const MAX_FORCE_SWEEPS: u32 = 60;

/// Longest time in which the stone returns from a displacement, microseconds.
const RETURN_US: u64 = 30_000_000;

/// A facet under force control is done when the stone is displaced by less, mm.
const DONE_MM: f64 = 5e-4;

/// A facet has sparked out when the force of the last second was less, N.
const SPARKED_OUT_N: f64 = 0.08;

/// What the controller reports of a program: the force on the lap in its last second, and when
/// force control displaced the stone.
struct Watch {
    /// Control periods of a second.
    second: u64,
    /// Control period and force, N.
    forces: VecDeque<(u64, f64)>,
    /// First and last control period in which the stone was displaced while it was lowered.
    displaced: Option<[u64; 2]>,
    /// Commanded height, axis units.
    height: i32,
    /// Last control period.
    last: u64,
}

impl Watch {
    /// Largest force of the last second, N; 0 without a sensor.
    fn largest_n(&self) -> f64 {
        self.forces
            .iter()
            .map(|(_, force)| *force)
            .fold(0.0, f64::max)
    }

    /// Seconds before the end between which the stone was displaced.
    fn displaced_s(&self) -> Option<[f64; 2]> {
        let second = self.second as f64;
        let before = |period: u64| self.last.saturating_sub(period) as f64 / second;
        self.displaced.map(|periods| periods.map(before))
    }
}

impl JobObserver for Watch {
    fn progress(&mut self, telemetry: &Telemetry) {
        self.last = telemetry.period;
        let height = telemetry.commanded.get(usize::from(HEIGHT)).copied();
        let is_lowered = height != Some(self.height);
        self.height = height.unwrap_or_default();
        let Some(force) = &telemetry.force else {
            return;
        };
        let newton = f64::from(1 << 16);
        let height = usize::from(HEIGHT);
        let pressure = f64::from(force.high[height]) / newton;
        self.forces.push_back((telemetry.period, pressure));
        let from = telemetry.period.saturating_sub(self.second);
        while self.forces.front().is_some_and(|(at, _)| *at < from) {
            self.forces.pop_front();
        }
        if is_lowered && millimetres(force.displacement[height]) > DONE_MM {
            let [_, last] = self.displaced.get_or_insert([telemetry.period; 2]);
            *last = telemetry.period;
        }
    }

    fn paused(&mut self, _: u32) {}

    fn may_resume(&mut self) -> bool {
        true
    }

    fn held_by_input(&mut self, _: &str) {}
}

/// A displacement of telemetry, mm.
fn millimetres(raw: i32) -> f64 {
    f64::from(raw) / f64::from(1 << 20)
}

/// The stone is near its depth, where it lands, when its tip is no higher above it, mm.
const AT_DEPTH_MM: f64 = 0.01;

/// Options of a run.
#[derive(Debug, Clone, Default)]
pub struct RunOptions {
    /// Seed of the simulated machine.
    pub seed: Option<u64>,
    /// Run-out of each lap, mm.
    pub run_out_mm: f64,
    /// Volume that a lap loses for a volume of the stone.
    pub wear: f64,
    /// Stiffness of the bed of each lap, N/mm^3; `None` for that of [`LapConfig`].
    pub bed_n_mm3: Option<f64>,
    /// A hard spot, in the frame of the design.
    pub hard_spot: Option<HardSpot>,
    /// Only the operations of these facets; empty for all.
    pub only: Vec<usize>,
    /// Set by the user to stop.
    pub interrupted: Arc<AtomicBool>,
}

/// Result of an operation.
#[derive(Debug, Clone, PartialEq)]
pub struct OperationResult {
    /// Number of the pass over the stone, from 0.
    pub pass: usize,
    /// Index of the facet in the design.
    pub facet: usize,
    /// Duration of the grinding with its spark-outs, s.
    pub seconds: f64,
    /// Number of additional spark-outs, until the force was gone.
    pub sweeps: u32,
    /// Force on the stone.
    pub force: ForceStatistics,
    /// Turns of the lap until the stone was within 10 um of its depth.
    pub turns: Vec<Turn>,
    /// Turns in which force control displaced the stone while the program lowered it: their force
    /// is that of the setpoint. Then the stone lands.
    pub held: Vec<Turn>,
}

/// A stone that was cut.
#[derive(Debug, Clone)]
pub struct Cutting {
    /// The stone in the frame of the design; tags are numbers in `ground`.
    pub stone: Polyhedron,
    /// Facets as they left the lap.
    pub ground: Vec<Ground>,
    /// The measured stone against the design.
    pub measured: Measured,
    /// Results in the order of cutting.
    pub operations: Vec<OperationResult>,
    /// Wear of the last lap by radius, mm.
    pub wear: Vec<f64>,
    /// Why the job ended before its last facet; the other fields are those of the stone as it was
    /// then.
    pub stopped: Option<Error>,
}

impl Cutting {
    /// The stone, if the job ended at its last facet.
    ///
    /// # Errors
    /// Why the job ended before.
    pub fn whole(self) -> Result<Self, Error> {
        match self.stopped {
            Some(error) => Err(error),
            None => Ok(self),
        }
    }
}

/// What was observed while a facet was ground.
struct FacetRun {
    /// Further spark-outs.
    sweeps: u32,
    /// As in [`OperationResult`].
    turns: Vec<Turn>,
    held: Vec<Turn>,
}

/// The machine in the simulator.
struct Bench<'a> {
    session: Session<SimLine>,
    machine: &'a MachineFile,
    job: u32,
}

fn lap_config(lap: &Lap, options: &RunOptions) -> LapConfig {
    let default = LapConfig::default();
    LapConfig {
        preston_mm2_n: lap.preston_mm2_n,
        bed_n_mm3: options.bed_n_mm3.unwrap_or(default.bed_n_mm3),
        run_out_mm: options.run_out_mm,
        wear: options.wear,
        ..default
    }
}

fn refused<E: ToString>(problems: Vec<E>) -> Error {
    let problems: Vec<String> = problems.iter().map(ToString::to_string).collect();
    Error::new(ErrorKind::BadInput, problems.join("\n"))
}

impl Bench<'_> {
    /// Runs a part program from where the machine stands.
    fn run(&mut self, text: &str) -> Result<Watch, Error> {
        let start: AxisValues = self.session.status()?.commanded;
        let model = Model::new(self.machine);
        let options = program_options(self.machine, model.to_engineering_units(&start));
        let program = haptimill_gcode::read("facet.ngc", text.as_bytes(), &options)
            .map_err(|refused| Error::refused(ErrorKind::Internal, &refused))?;
        let plan = Plan::new(&program, &settings(self.machine), &model)
            .map_err(|refused| Error::refused(ErrorKind::Refused, &refused))?;
        self.job += 1;
        let mut watch = Watch {
            second: 1_000_000 / u64::from(self.machine.config.period_us.max(1)),
            forces: VecDeque::new(),
            displaced: None,
            height: 0,
            last: 0,
        };
        let end = self
            .session
            .run_job(self.job, start, plan.setpoints, &mut watch)?;
        self.session.check_completed(&end)?;
        Ok(watch)
    }

    fn grinding(&mut self) -> Result<&mut Grinding, Error> {
        let plant = self.session.line_mut().rig_mut().plant_mut();
        plant
            .process_mut()
            .and_then(|process| process.grinding_mut())
            .ok_or_else(|| Error::new(ErrorKind::Internal, "the simulated machine has no lap"))
    }

    /// Displacement of the stone under force control, mm.
    fn displacement_mm(&mut self) -> Result<f64, Error> {
        let status = self.session.status()?;
        let force = status.force.as_ref();
        let raw = force.map_or(0, |force| force.displacement[usize::from(HEIGHT)]);
        Ok(millimetres(raw))
    }

    /// Turns of the lap of the facet on it since its contact began.
    fn turns(&mut self) -> Result<Vec<Turn>, Error> {
        Ok(self.grinding()?.turns().to_vec())
    }

    /// Grinds a facet. A facet that does not reach its depth under force control is an error.
    fn operate(&mut self, operation: &Operation, mode: Mode, lap: &Lap) -> Result<FacetRun, Error> {
        let watch = self.run(&operation.grind)?;
        // Turns are as long as those of the lap, and end with the program.
        let turns = self.turns()?;
        let held = watch.displaced_s().map_or(Vec::new(), |[first, last]| {
            let at = |seconds: f64| {
                let left = (seconds * lap.rpm.abs() / 60.0).ceil() as usize;
                turns.len().saturating_sub(left)
            };
            turns[at(first)..at(last)].to_vec()
        });
        let mut pressure_n = watch.largest_n();
        let mut sweeps = 0;
        let mut at_depth = 0;
        let mut before_mm = f64::INFINITY;
        loop {
            let displaced_mm = if mode.has_force() {
                self.displacement_mm()?.abs()
            } else {
                0.0
            };
            let is_displaced = displaced_mm > DONE_MM;
            if !is_displaced && pressure_n < SPARKED_OUT_N {
                break;
            }
            if is_displaced && sweeps % PROGRESS_SWEEPS == 0 {
                if displaced_mm > (1.0 - PROGRESS_PART) * before_mm {
                    break;
                }
                before_mm = displaced_mm;
            }
            at_depth += u32::from(!is_displaced);
            if sweeps >= MAX_SWEEPS || at_depth > MAX_FORCE_SWEEPS {
                break;
            }
            pressure_n = self.run(&operation.sweep)?.largest_n();
            sweeps += 1;
        }
        let end = operation.depth_mm + AT_DEPTH_MM;
        let turns = self.turns()?.into_iter();
        let turns = turns.take_while(|turn| turn.height_mm > end).collect();
        let left = if mode.has_force() {
            self.displacement_mm()?.abs()
        } else {
            0.0
        };
        self.run(&operation.retract)?;
        if left > DONE_MM {
            let what = format!(
                "is not at its depth after {sweeps} spark-outs: the stone is still displaced by \
                 {left:.4} mm on an area of {:.1} mm^2; raise force_n of the lap, lower the stock \
                 before it, or grind by feed",
                operation.area_mm2
            );
            return Err(Error::new(ErrorKind::Stopped, what));
        }
        Ok(FacetRun {
            sweeps,
            turns,
            held,
        })
    }
}

/// An error at a facet, with its place in the design and its lap.
fn at_facet(gem: &Gem, job: &Job, operation: &Operation, error: Error) -> Error {
    let lap = &job.settings.laps[operation.lap].name;
    let place = gem.place(operation.facet);
    Error::new(
        error.kind,
        format!("{place} on lap {lap}: {}", error.message),
    )
}

/// Cuts a gem. `progress` gets the number of operations that are done, and of all. A job that
/// stops at a facet returns the stone as it is then, see [`Cutting::stopped`].
///
/// # Errors
/// The machine cannot make a motion of the job ([`check_machine`]), the machine file has no
/// simulated machine that can grind, or the machine stopped before the first facet.
pub fn cut(
    gem: &Gem,
    job: &Job,
    machine: &MachineFile,
    options: &RunOptions,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Cutting, Error> {
    check_machine(gem, job, machine).map_err(|refused| Error::new(ErrorKind::Refused, refused))?;
    let model = Model::new(machine);
    let home = find_home_pose(machine, &model)?;
    let rig = rig(machine, options.seed, None, Vec::new())?;
    // The controller is configured before, so nothing is logged from its power-on.
    let rig = commissioned(rig, machine).map_err(|(_, error)| error)?;
    let line = SimLine::new(rig);
    let interrupted = Arc::clone(&options.interrupted);
    let mut session = Session::new(line, machine, Options::default(), interrupted);
    session.connect(1)?;
    session.configure(machine)?;
    session.enable()?;
    session.go_home(machine, &home)?;
    let bench = Bench {
        session,
        machine,
        job: 2,
    };
    let mut cut = Cut {
        gem,
        job,
        options,
        bench,
        mount: None,
        operations: Vec::new(),
    };
    let stopped = cut.all(progress).err();
    let Cut {
        mut bench,
        mount,
        operations,
        ..
    } = cut;
    let Some(mount) = mount else {
        let nothing = || Error::new(ErrorKind::BadInput, "the job has no facet");
        return Err(stopped.unwrap_or_else(nothing));
    };
    let grinding = bench.grinding()?;
    grinding.lift_off();
    let ground = grinding.ground().to_vec();
    let wear = grinding.wear().to_vec();
    let stone = in_design(grinding.stone(), &mount);
    Ok(Cutting {
        measured: Measured::new(gem, &stone, &ground),
        stone,
        ground,
        operations,
        wear,
        stopped,
    })
}

/// A job on the machine.
struct Cut<'a> {
    gem: &'a Gem,
    job: &'a Job,
    options: &'a RunOptions,
    bench: Bench<'a>,
    /// How the stone sits on the dop; `None` before the first pass.
    mount: Option<Mount>,
    /// Operations that are done.
    operations: Vec<OperationResult>,
}

impl Cut<'_> {
    /// Runs all operations.
    fn all(&mut self, progress: &mut dyn FnMut(usize, usize)) -> Result<(), Error> {
        let (job, only) = (self.job, &self.options.only);
        let chosen = |operation: &&Operation| only.is_empty() || only.contains(&operation.facet);
        let all = job.passes.iter().flat_map(|pass| &pass.operations);
        let total = all.filter(chosen).count();
        for (number, pass) in job.passes.iter().enumerate() {
            self.put_on(pass)?;
            for operation in pass.operations.iter().filter(chosen) {
                self.operate(number, operation)
                    .map_err(|error| at_facet(self.gem, job, operation, error))?;
                progress(self.operations.len(), total);
            }
        }
        Ok(())
    }

    /// Puts the lap of a pass on, and the stone on the dop.
    fn put_on(&mut self, pass: &Pass) -> Result<(), Error> {
        let lap = lap_config(&self.job.settings.laps[pass.lap], self.options);
        let bench = &mut self.bench;
        if let Some(before) = self.mount {
            let grinding = bench.grinding()?;
            grinding.set_lap(lap).map_err(refused)?;
            if before != pass.mount {
                let design = in_design(grinding.stone(), &before);
                grinding.set_stone(Job::mounted(&design, &pass.mount));
            }
        } else {
            let mounted = Job::mounted(&self.gem.rough_body(), &pass.mount);
            let grinding = Grinding::new(lap, mounted).map_err(refused)?;
            let plant = bench.session.line_mut().rig_mut().plant_mut();
            let Some(process) = plant.process_mut() else {
                let what = "the simulated machine has no spindle; add [plant.spindle]";
                return Err(Error::new(ErrorKind::BadInput, what));
            };
            process.set_grinding(Some(grinding));
        }
        if self.mount != Some(pass.mount) {
            let axes = pass.mount.axes();
            let spot = self.options.hard_spot.map(|spot| HardSpot {
                centre: core::array::from_fn(|i| (0..3).map(|k| axes[k][i] * spot.centre[k]).sum()),
                ..spot
            });
            bench.grinding()?.set_hard_spot(spot);
        }
        self.mount = Some(pass.mount);
        bench.tare(self.job.settings.mode)
    }

    /// Grinds a facet of the pass of this number.
    fn operate(&mut self, pass: usize, operation: &Operation) -> Result<(), Error> {
        let (bench, settings) = (&mut self.bench, &self.job.settings);
        let from = bench.session.now_us();
        let before = bench.grinding()?.ground().len();
        bench.set_force(settings.mode, operation.force_n)?;
        let done = bench.operate(operation, settings.mode, &settings.laps[operation.lap])?;
        let seconds = (bench.session.now_us() - from) as f64 * 1e-6;
        let grinding = bench.grinding()?;
        let longest = grinding.ground()[before..]
            .iter()
            .max_by_key(|ground| ground.force.turns);
        self.operations.push(OperationResult {
            pass,
            facet: operation.facet,
            seconds,
            sweeps: done.sweeps,
            turns: done.turns,
            held: done.held,
            force: longest.map_or(ForceStatistics::default(), |ground| ground.force),
        });
        Ok(())
    }
}

impl Bench<'_> {
    /// Tares the force sensor for a lap, with the stone in the air and no axis under force control.
    fn tare(&mut self, mode: Mode) -> Result<(), Error> {
        if self.machine.config.force.is_none() {
            if !mode.has_force() {
                return Ok(());
            }
            let what = "the machine has no force sensor; grind by feed";
            return Err(Error::new(ErrorKind::BadInput, what));
        }
        self.session.set_force_mask(&[])?;
        // The stone returns from its displacement before the sensor gets its zero.
        let by = self.session.now_us() + RETURN_US;
        while self.displacement_mm()? != 0.0 && self.session.now_us() < by {}
        self.session.tare()
    }

    /// Sets the force of a facet, with the stone in the air.
    fn set_force(&mut self, mode: Mode, force_n: f64) -> Result<(), Error> {
        if !mode.has_force() {
            return Ok(());
        }
        let changes = ForceLoopChanges {
            setpoint_n: Some(force_n),
            ..ForceLoopChanges::default()
        };
        self.session
            .set_force_loops(self.machine, &[HEIGHT], &changes)?;
        self.session.set_force_mask(&[HEIGHT])
    }
}
