//! Carrying out a pass: the simulated machine is homed, the work clamped, the program run, everything recorded.

use super::Pass;
use super::course::Course;
use haptimill_client::client::Options;
use haptimill_client::port::Board;
#[cfg(unix)]
use haptimill_client::session::pil;
use haptimill_client::session::{
    self, HapticTrace, JobEnd, JobLine, JobRecording, NoObserver, Session, SimLine,
};
use haptimill_client::{Error, ErrorKind};

use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::process::Workpiece;
#[cfg(unix)]
use haptimill_hil_sim::remote::RemoteController;
use haptimill_hil_sim::rig::Control as Controlled;
use haptimill_machine_file::model::{Model, program_options, settings};
use haptimill_machine_file::{MachineFile, work};
use haptimill_math::Length;
use haptimill_math::force::{Force, VirtualDamping, VirtualMass};
use haptimill_planner::Plan;
use haptimill_protocol::message::AxisValues;
use haptimill_report::{Outcome, Summary};
use haptimill_trace::{Header, Recorder, Recording};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// A row of the trace every so many control periods: 5 ms at 5 kHz.
const TRACE_EVERY: u32 = 25;

/// The table of what hand and tool did while a hand led, and a row of it every so many milliseconds.
pub const HAND_FILE: &str = "hand.csv";
const HAND_EVERY: usize = 5;

/// What a pass left.
pub struct Cut {
    /// What was recorded, at a thousand samples a second.
    pub course: Course,
    /// The work with its cut surface.
    pub work: Workpiece,
    /// The summary of the job.
    pub summary: Summary,
    /// What hand and tool did while a hand led.
    pub hand: Option<HapticTrace>,
}

/// The most that a tool under force control may yield, mm: the machine file's 10 mm are enough for the thesis's gains (6 mm), and too little for (0.25, 0.5) at 4 mm/s, which yields 13 mm and would press with
/// 10 N at the limit instead of showing what the gains do. It is a setting of the loop, not of the plant.
const LIMIT_MM: i32 = 20;

/// Axes of the work along which the tool yields in a pass.
fn yields(pass: &Pass) -> &'static [u8] {
    pass.led.map_or(&[0], |led| led.yields)
}

/// The machine with the force loop of a pass; `None` when the machine has no force control.
fn controlled(machine: &MachineFile, pass: &Pass) -> Option<MachineFile> {
    let mut machine = machine.clone();
    if let Some(control) = pass.control {
        let force = machine.config.force.as_mut()?;
        let scaled = |value: f64| (value * 65_536.0).round() as u32;
        for axis in yields(pass) {
            let axis = force.axes.get_mut(usize::from(*axis))?;
            axis.desired = Force(scaled(control.desired_n) as i32);
            axis.mass = VirtualMass(scaled(control.mass));
            axis.damping = VirtualDamping(scaled(control.damping));
            axis.limit = Length(LIMIT_MM << 20);
        }
    }
    Some(machine)
}

/// What carries out the control periods of a pass.
#[derive(Debug, Clone, Copy)]
pub enum On {
    /// The controller in this process.
    Here,
    /// The controller on an emulated board, which leaves what it cost as well. The machine around it is the simulated one in either case.
    Board(Board),
}

/// Carries out a pass; `dir` gets the recording, the trace, the summary and the report of the job.
///
/// # Errors
/// The program is refused, the job does not end as it should, or a file cannot be written.
pub fn carry(
    machine: &MachineFile,
    pass: &Pass,
    dir: &Path,
    on: On,
    interrupted: &Arc<AtomicBool>,
) -> Result<Cut, Error> {
    let machine = match &pass.led {
        Some(_) => machine.with_hand()?,
        None => machine.clone(),
    };
    let machine = controlled(&machine, pass)
        .ok_or_else(|| Error::new(ErrorKind::Refused, NO_FORCE_CONTROL))?;
    match on {
        On::Here => {
            let line = SimLine::new(session::rig(&machine, None, None, Vec::new())?);
            cut(line, &machine, pass, dir, interrupted)
        }
        On::Board(board) => on_board(board, &machine, pass, dir, interrupted),
    }
}

/// On an emulated board.
#[cfg(unix)]
fn on_board(
    board: Board,
    machine: &MachineFile,
    pass: &Pass,
    dir: &Path,
    interrupted: &Arc<AtomicBool>,
) -> Result<Cut, Error> {
    let image = pil::image_for(board, machine)?;
    let emulator = pil::Emulator::start(board, &image)?;
    let period_us = machine.config.period_us;
    let mut remote = RemoteController::begin(emulator, period_us)
        .map_err(|reason| Error::new(ErrorKind::Port, format!("{board}: {reason}")))?;
    remote.set_budget(pil::counts(pil::budget(period_us)));
    let cost = remote.cost();
    let rig = session::rig_around(remote, machine, None, None, Vec::new())?;
    let line = SimLine::named(rig, &board.to_string());
    let cut = cut(line, machine, pass, dir, interrupted)?;
    pil::Instructions::write_to(&cost, dir)?;
    Ok(cut)
}

/// Emulated boards need named pipes.
#[cfg(not(unix))]
fn on_board(
    board: Board,
    _: &MachineFile,
    _: &Pass,
    _: &Path,
    _: &Arc<AtomicBool>,
) -> Result<Cut, Error> {
    let what = format!("{board}: emulated boards need a Unix system");
    Err(Error::new(ErrorKind::Usage, what))
}

fn cut<C: Controlled>(
    line: SimLine<C>,
    machine: &MachineFile,
    pass: &Pass,
    dir: &Path,
    interrupted: &Arc<AtomicBool>,
) -> Result<Cut, Error> {
    let output = |error: &dyn std::fmt::Display| {
        Error::new(ErrorKind::Output, format!("{}: {error}", dir.display()))
    };
    let model = Model::new(machine);
    let home = session::find_home_pose(machine, &model)?;
    let plan = planned(machine, &model, &home, pass)?;

    let plant: PlantConfig = machine.plant()?;
    let (file, text) = pass.work.file();
    let mut cutting = plant.cutting(work::parse(file, text)?);
    cutting.cutter.force_scale *= pass.force_scale;

    std::fs::create_dir_all(dir).map_err(|error| output(&error))?;
    let mut session = Session::new(line, machine, Options::default(), Arc::clone(interrupted));
    session.connect(1)?;
    session.configure(machine)?;
    session.enable()?;
    session
        .go_home(machine, &home)
        .map_err(|error| of_pass(pass, error))?;
    session.line_mut().clamp(&cutting)?;
    if machine.config.force.is_some() {
        session.tare()?;
        if pass.control.is_some() {
            session.set_force_mask(yields(pass))?;
        }
    }
    if let Some(led) = &pass.led {
        led.set_up(&mut session)?;
    }

    let header = Header::of(machine, pass.program)
        .map_err(|error| Error::new(ErrorKind::Internal, error))?;
    let recorder = Recorder::create(&dir.join(haptimill_report::RECORDING_FILE), &header)
        .map_err(|error| output(&error))?;
    let setpoints = plan.setpoints.clone();
    session
        .line_mut()
        .begin_recording(JobRecording::new(recorder, Arc::new(plan), machine));
    let mut hand = None;
    let mut pauses = 0;
    let mut at_pause = |session: &mut Session<SimLine<C>>| {
        pauses += 1;
        match (&pass.led, pauses) {
            (Some(led), 1) => led.begin(session),
            (Some(led), 2) => led.end(session).map(|course| hand = course),
            _ => Ok(()),
        }
    };
    let end = session.run_job_with(2, home, setpoints, &mut NoObserver, &mut at_pause)?;
    check_completed(&session, pass, &end)?;
    let recorded = session
        .line_mut()
        .end_recording()
        .ok_or_else(|| Error::new(ErrorKind::Internal, "the recording was lost"))?
        .finish()
        .map_err(|error| output(&error))?;
    if recorded.disk_full {
        return Err(output(&"the disk is nearly full; free some space"));
    }
    let outcome = Outcome {
        setpoints: u64::from(end.setpoints),
        underruns: end.underruns.len() as u64,
        faults: Vec::new(),
        injected: Vec::new(),
        completed: true,
        final_state: Some(end.status.state),
        position_kept: end.status.position_kept,
        bytes_per_setpoint: f64::from(end.sent.message_bytes) / f64::from(end.setpoints.max(1)),
        line_bytes_per_setpoint: f64::from(end.sent.bytes) / f64::from(end.setpoints.max(1)),
    };
    let summary = haptimill_report::write_all(dir, &recorded, &outcome, TRACE_EVERY)
        .map_err(|error| output(&error))?;
    let recording = Recording::open(&dir.join(haptimill_report::RECORDING_FILE))
        .map_err(|error| output(&error))?;
    let led = pass.led.as_ref().map_or(&[][..], |led| led.axes);
    let course = Course::of(&recording, led).map_err(|error| output(&error))?;
    if let Some(course) = &hand {
        std::fs::write(dir.join(HAND_FILE), course.to_csv(HAND_EVERY))
            .map_err(|error| output(&error))?;
    }
    let mut line = session.into_line();
    let cutting = line
        .rig_mut()
        .plant_mut()
        .process_mut()
        .and_then(|process| process.cutting_mut())
        .ok_or_else(|| Error::new(ErrorKind::Internal, "the work is gone"))?;
    cutting.settle();
    Ok(Cut {
        course,
        work: cutting.workpiece().clone(),
        summary,
        hand,
    })
}

/// Why a scenario with force control is not run.
pub const NO_FORCE_CONTROL: &str = "this machine has no force control";

fn planned(
    machine: &MachineFile,
    model: &Model,
    home: &AxisValues,
    pass: &Pass,
) -> Result<Plan, Error> {
    let options = program_options(machine, model.to_people(home));
    let program = haptimill_gcode::read(pass.program, pass.text.as_bytes(), &options)
        .map_err(|refused| Error::refused(ErrorKind::BadInput, &refused))?;
    Plan::new(&program, &settings(machine), model)
        .map_err(|refused| Error::refused(ErrorKind::Refused, &refused))
}

/// A job that did not reach its end leaves nothing to measure.
fn check_completed<C: Controlled>(
    session: &Session<SimLine<C>>,
    pass: &Pass,
    end: &JobEnd,
) -> Result<(), Error> {
    session
        .check_completed(end)
        .map_err(|error| of_pass(pass, error))?;
    if session.is_interrupted() {
        return Err(Error::new(ErrorKind::Stopped, "stopped by the user"));
    }
    Ok(())
}

/// An error of a pass names its program, unless the user wanted it.
fn of_pass(pass: &Pass, error: Error) -> Error {
    if error.kind == ErrorKind::Stopped {
        return error;
    }
    Error::new(error.kind, format!("{}: {}", pass.program, error.message))
}
