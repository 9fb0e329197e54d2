//! Running a pass: the simulated machine is homed, the stock clamped, the program run and recorded.

use super::definition::{Pass, Teleoperation};
use super::obstacle::NO_FORCE_CONTROL;
use super::pass_data::PassData;
use super::sampled_trace::SampledTrace;
use super::teleoperation;
use haptimill_client::client::Options;
use haptimill_client::port::Board;
#[cfg(unix)]
use haptimill_client::session::pil;
use haptimill_client::session::{
    self, JobEnd, JobLine, JobRecording, Line as _, NoObserver, Session, SimLine,
};
use haptimill_client::{Error, ErrorKind};

use haptimill_hil_sim::config::PlantConfig;
#[cfg(unix)]
use haptimill_hil_sim::remote::RemoteController;
use haptimill_hil_sim::rig::Control as Controlled;
use haptimill_machine_file::model::{Model, program_options, settings};
use haptimill_machine_file::{MachineFile, stock};
use haptimill_math::force::{Force, VirtualDamping, VirtualMass};
use haptimill_planner::Plan;
use haptimill_protocol::message::AxisValues;
use haptimill_report::JobOutcome;
use haptimill_trace::{Header, Recorder, Recording};
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};

/// Control periods per row of the trace: 5 ms at 5 kHz.
const TRACE_EVERY: u32 = 25;

/// Table of master and tool of a teleoperated pass, and its milliseconds per row.
const TELEOPERATION_FILE: &str = "teleop.csv";
const TELEOPERATION_EVERY: usize = 5;

/// The machine with the force control of a pass; none when the machine has no force control.
fn with_force_control(machine: &MachineFile, pass: &Pass) -> Option<MachineFile> {
    let mut machine = machine.clone();
    if let Some(control) = &pass.force_control {
        let force = machine.config.force.as_mut()?;
        let scaled = |value: f64| (value * 65_536.0).round() as u32;
        for axis in &control.axes {
            let axis = force.axes.get_mut(axis.index())?;
            axis.setpoint = Force(scaled(control.setpoint_n) as i32);
            axis.mass = VirtualMass(scaled(control.virtual_mass));
            axis.damping = VirtualDamping(scaled(control.virtual_damping));
        }
    }
    Some(machine)
}

/// Where the controller of the simulated machine runs.
#[derive(Debug, Clone, Copy)]
pub enum Target {
    /// In this process.
    InProcess,
    /// On an emulated board; its instruction counts are written too.
    Board(Board),
}

/// Runs a pass; writes recording, trace, summary and report of the job to `dir`.
///
/// # Errors
/// The program is refused, the job does not complete, or a file cannot be written.
pub fn run_pass(
    machine: &MachineFile,
    pass: &Pass,
    dir: &Path,
    target: Target,
    interrupted: &Arc<AtomicBool>,
) -> Result<PassData, Error> {
    let machine = match &pass.teleoperation {
        Some(_) => machine.with_haptic_arm()?,
        None => machine.clone(),
    };
    let machine = with_force_control(&machine, pass)
        .ok_or_else(|| Error::new(ErrorKind::Refused, NO_FORCE_CONTROL))?;
    match target {
        Target::InProcess => {
            let line = SimLine::new(session::rig(&machine, None, None, Vec::new())?);
            run_job(line, &machine, pass, dir, interrupted)
        }
        Target::Board(board) => run_on_board(board, &machine, pass, dir, interrupted),
    }
}

/// Runs a pass with the controller on an emulated board.
#[cfg(unix)]
fn run_on_board(
    board: Board,
    machine: &MachineFile,
    pass: &Pass,
    dir: &Path,
    interrupted: &Arc<AtomicBool>,
) -> Result<PassData, Error> {
    let image = pil::image_for(board, machine)?;
    let emulator = pil::Emulator::start(board, &image)?;
    let period_us = machine.config.period_us;
    let mut remote = RemoteController::begin(emulator, period_us)
        .map_err(|reason| Error::new(ErrorKind::Port, format!("{board}: {reason}")))?;
    remote.set_budget(pil::counts(pil::budget(period_us)));
    let cost = remote.cost();
    let rig = session::rig_around(remote, machine, None, None, Vec::new())?;
    let line = SimLine::named(rig, &board.to_string());
    let data = run_job(line, machine, pass, dir, interrupted)?;
    pil::Instructions::write_to(&cost, dir)?;
    Ok(data)
}

/// Refuses: emulated boards need named pipes.
#[cfg(not(unix))]
fn run_on_board(
    board: Board,
    _: &MachineFile,
    _: &Pass,
    _: &Path,
    _: &Arc<AtomicBool>,
) -> Result<PassData, Error> {
    let what = format!("{board}: emulated boards need a Unix system");
    Err(Error::new(ErrorKind::Usage, what))
}

fn run_job<C: Controlled>(
    line: SimLine<C>,
    machine: &MachineFile,
    pass: &Pass,
    dir: &Path,
    interrupted: &Arc<AtomicBool>,
) -> Result<PassData, Error> {
    let output = |error: &dyn std::fmt::Display| {
        Error::new(ErrorKind::Output, format!("{}: {error}", dir.display()))
    };
    let model = Model::new(machine);
    let home = session::find_home_pose(machine, &model)?;
    let plan = plan(machine, &model, &home, pass)?;

    let plant: PlantConfig = machine.plant()?;
    let stock = stock::parse(&pass.stock, pass.stock_text())?;
    let cutting = plant.cutting(stock);

    std::fs::create_dir_all(dir).map_err(|error| output(&error))?;
    let mut session = Session::new(line, machine, Options::default(), Arc::clone(interrupted));
    session.connect(1)?;
    session.configure(machine)?;
    session.enable()?;
    session
        .go_home(machine, &home)
        .map_err(|error| with_program(pass, error))?;
    session.line_mut().clamp(&cutting)?;
    if machine.config.force.is_some() {
        session.tare()?;
        if let Some(control) = &pass.force_control {
            session.set_force_mask(&control.axis_indices())?;
        }
    }
    if let Some(settings) = &pass.teleoperation {
        teleoperation::set_up(settings, &mut session)?;
    }

    let header = Header::of(machine, pass.program_name())
        .map_err(|error| Error::new(ErrorKind::Internal, error))?;
    let recorder = Recorder::create(&dir.join(haptimill_report::RECORDING_FILE), &header)
        .map_err(|error| output(&error))?;
    let setpoints = plan.setpoints.clone();
    session
        .line_mut()
        .begin_recording(JobRecording::new(recorder, plan.into(), machine));
    let mut record = None;
    let mut pauses = 0;
    let mut at_pause = |session: &mut Session<SimLine<C>>| {
        pauses += 1;
        match (&pass.teleoperation, pauses) {
            (Some(settings), 1) => teleoperation::begin(settings, session),
            (Some(settings), 2) => {
                record = teleoperation::end(settings, session)?;
                Ok(())
            }
            _ => Ok(()),
        }
    };
    let end = session.run_job_with(2, home, setpoints, &mut NoObserver, &mut at_pause)?;
    check_end(&session, pass, &end)?;
    let recorded = session
        .line_mut()
        .end_recording()
        .ok_or_else(|| Error::new(ErrorKind::Internal, "the recording was lost"))?
        .finish()
        .map_err(|error| output(&error))?;
    if recorded.disk_full {
        return Err(output(&"the disk is nearly full; free some space"));
    }
    let outcome = JobOutcome {
        setpoints: u64::from(end.setpoints),
        underruns: end.underruns.len() as u64,
        faults: Vec::new(),
        injected: Vec::new(),
        completed: true,
        final_state: Some(end.status.state),
        position_kept: end.status.homed,
        bytes_per_setpoint: f64::from(end.sent.message_bytes) / f64::from(end.setpoints.max(1)),
        line_bytes_per_setpoint: f64::from(end.sent.bytes) / f64::from(end.setpoints.max(1)),
        // The page of the experiment has the cut surface.
        cut: None,
        spindle_rpm: None,
        recorded_part: None,
    };
    let summary = haptimill_report::write_all(dir, &recorded, &outcome, TRACE_EVERY, None)
        .map_err(|error| output(&error))?;
    let recording = Recording::open(&dir.join(haptimill_report::RECORDING_FILE))
        .map_err(|error| output(&error))?;
    let axes_of =
        |settings: &Teleoperation| settings.axes.iter().map(|axis| axis.index()).collect();
    let teleoperated: Vec<usize> = pass.teleoperation.as_ref().map(axes_of).unwrap_or_default();
    let trace = SampledTrace::new(&recording, &teleoperated).map_err(|error| output(&error))?;
    if let Some(record) = &record {
        let table = record.to_csv(TELEOPERATION_EVERY);
        std::fs::write(dir.join(TELEOPERATION_FILE), table).map_err(|error| output(&error))?;
    }
    let mut line = session.into_line();
    let settled = line
        .rig_mut()
        .plant_mut()
        .process_mut()
        .and_then(|process| process.cutting_mut())
        .ok_or_else(|| Error::new(ErrorKind::Internal, "the stock is missing"))?;
    settled.settle();
    Ok(PassData {
        trace,
        stock: settled.workpiece().clone(),
        cutting,
        summary,
        teleoperation: record,
        shares: OnceLock::new(),
    })
}

fn plan(
    machine: &MachineFile,
    model: &Model,
    home: &AxisValues,
    pass: &Pass,
) -> Result<Plan, Error> {
    let options = program_options(machine, model.to_engineering_units(home));
    let program = haptimill_gcode::read(
        pass.program_name(),
        pass.program_text().as_bytes(),
        &options,
    )
    .map_err(|refused| Error::refused(ErrorKind::BadInput, &refused))?;
    Plan::new(&program, &settings(machine), model)
        .map_err(|refused| Error::refused(ErrorKind::Refused, &refused))
}

/// Refuses a job that did not complete.
fn check_end<C: Controlled>(
    session: &Session<SimLine<C>>,
    pass: &Pass,
    end: &JobEnd,
) -> Result<(), Error> {
    session
        .check_completed(end)
        .map_err(|error| with_program(pass, error))?;
    if session.is_interrupted() {
        return Err(Error::new(ErrorKind::Stopped, "stopped by the user"));
    }
    Ok(())
}

/// Adds the name of the program to an error, except when the user stopped the run.
fn with_program(pass: &Pass, error: Error) -> Error {
    if error.kind == ErrorKind::Stopped {
        return error;
    }
    Error::new(
        error.kind,
        format!("{}: {}", pass.program_name(), error.message),
    )
}
