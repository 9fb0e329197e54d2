//! `haptimill run`: runs a part program and writes the report.

mod args;
mod emulated;
pub(super) mod job;
mod keys;
mod lost_steps;
mod operator;
pub(crate) mod overrides;
mod parts;
mod progress;
pub(super) mod results;
mod spool;
mod stream;
mod supply;

use super::board::file_of;
use super::program::{Checked, PartProgram, Planned};
use super::{CliError, Exit, sim};
use crate::commands::interrupt;
use haptimill_client::client::Options;
use haptimill_client::port::{Observers, PortSpec};
use haptimill_client::session::{self, PortLine, Session, SimLine};
use haptimill_gcode::Step;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_machine_file::work_data::WorkData;
use haptimill_planner::Figures;
use haptimill_protocol::message::AxisValues;
use haptimill_report::count;
use job::{CheckedWork, Job, Work};
use parts::Questions;
use results::ResultFolder;
use spool::Bytes;
use std::io::Read;

pub use args::RunArgs;
pub(super) use args::{RecordedPart, faults_help, recorded_part};

/// Size of a recording from which it is announced.
const ANNOUNCED_BYTES: f64 = 100e6;

/// Runs a part program.
///
/// # Errors
/// See [`Exit`].
pub fn run(args: RunArgs) -> Result<(), CliError> {
    run_from(args, None)
}

/// Runs a part program while it comes; `args.program` is its name.
///
/// # Errors
/// See [`Exit`].
pub(super) fn run_live(args: RunArgs, input: Box<dyn Read + Send>) -> Result<(), CliError> {
    run_from(args, Some(input))
}

fn run_from(args: RunArgs, input: Option<Box<dyn Read + Send>>) -> Result<(), CliError> {
    args.check()?;
    let chosen = args.machine.load()?;
    let machine = chosen.file.clone();
    if args.force.is_some() {
        session::find_force_config(&machine)?;
    }
    let model = Model::new(&machine);
    let home = session::find_home_pose(&machine, &model)?;
    // Neither a check nor a run of a whole program keeps its steps.
    let is_whole = args.changes.is_none() && args.program.is_file();
    let program = if args.stream || is_whole {
        PartProgram::streamed(&args.program, args.language)
    } else {
        PartProgram::load(&args.program, args.language)?.with_changes(args.changes)
    };
    let mut program = program.at_spindle_override(args.spindle_override);
    if args.check {
        return check(&args, &program, &machine, &model, &home);
    }
    let stock = args.stock.load(&machine)?;
    let work = if args.stream {
        let (bytes, is_live) = match input {
            Some(input) => (spool::spool(input)?, true),
            None => spool::open(&args.program)?,
        };
        // The duration is not known.
        let growth = describe_growth(args.recording_bytes(&machine, 3600.0));
        if let Some(growth) = growth.filter(|_| !args.record.keeps_last()) {
            args.print_message(&growth);
        }
        Work::Stream(bytes, is_live)
    } else if is_whole {
        let (bytes, text) = spool::keep(&args.program)?;
        program.text = text;
        check_whole(&args, &program, &machine, (&model, &home), bytes)?
    } else {
        // The steps are interpreted once. Only a program that asks the machine is interpreted
        // again: to check it, and while it runs, with the answers.
        let options = program.options(&machine, &model, &home)?;
        let steps = program.read(&options)?;
        let mut questions = Questions::default();
        steps.steps.iter().for_each(|step| questions.note(step));
        if questions.has_any() {
            check_parts(&args, &program, &machine, (&model, &home), &questions)?
        } else {
            let planned = program.plan_steps(steps, &machine, &model, &options)?;
            check_planned(&args, &program, &machine, planned)?
        }
    };
    // The folder stays locked to the end of the command.
    let folder = ResultFolder::open(&args.out_dir())?;
    let interrupted = interrupt::flag();
    let mut job = Job {
        args: &args,
        machine: &machine,
        program: &program,
        home,
        stock,
        folder,
    };
    match &args.port.port {
        PortSpec::Simulator => {
            let simulator = &args.simulator;
            let faults = simulator.fault.clone();
            let rig = session::rig(&machine, simulator.seed, args.port.baud, faults)?;
            let options = paced_options(args.port.baud);
            let mut session = Session::new(SimLine::new(rig), &machine, options, interrupted);
            // A constant session number makes every run of a simulated job bit-identical.
            session.connect(1)?;
            session.configure(&machine)?;
            job.run(&mut session, work)
        }
        PortSpec::Emulated(board) => emulated::run(job, work, *board),
        PortSpec::EmulatedPins => emulated::run_with_pins(job, work),
        spec => {
            let baud = args.port.baud_or_default();
            let observers = args
                .serve
                .as_ref()
                .map(|address| serve_observers(&args, address))
                .transpose()?;
            let line = PortLine::opened(spec, baud)?;
            let serial = matches!(spec, PortSpec::Serial(_));
            let options = paced_options(serial.then_some(baud));
            let mut session = Session::new(line, &machine, options, interrupted);
            session.connect(session::fresh_number())?;
            // The program was checked against the built-in machine where --machine is missing.
            // The command ends here if the board is configured as another machine.
            let machine = file_of(&chosen, &mut session)?;
            job.home = session::find_home_pose(&machine, session.model())?;
            if let Some(observers) = observers {
                session.line_mut().observe(observers, &machine);
            }
            let job = Job {
                machine: &machine,
                ..job
            };
            job.run(&mut session, work)
        }
    }
}

/// Reads every input of a run but its program, and opens its port and its result folder for a
/// moment: for a program that is not there yet.
///
/// # Errors
/// As [`run`], before it reads the program.
pub(super) fn check_before_program(args: &RunArgs) -> Result<(), CliError> {
    args.check()?;
    let machine = args.machine.load()?.file;
    if args.force.is_some() {
        session::find_force_config(&machine)?;
    }
    session::find_home_pose(&machine, &Model::new(&machine))?;
    WorkData::beside(&machine).map_err(|error| CliError::new(Exit::BadInput, error))?;
    args.stock.load(&machine)?;
    args.token_file
        .as_deref()
        .map(sim::read_token)
        .transpose()?;
    if args.check {
        return Ok(());
    }
    ResultFolder::open(&args.out_dir())?;
    if !args.port.is_simulated() {
        PortLine::opened(&args.port.port, args.port.baud_or_default())?;
    }
    Ok(())
}

/// Checks a program without a run.
fn check(
    args: &RunArgs,
    program: &PartProgram,
    machine: &MachineFile,
    model: &Model,
    home: &AxisValues,
) -> Result<(), CliError> {
    let (checked, approach) = if args.changes.is_none() && args.program.is_file() {
        let mut questions = Questions::default();
        let (mut bytes, _) = spool::open(&args.program)?;
        let start = (model, home);
        let note = |step: &Step| questions.note(step);
        let mut checked = program.check_bytes(&mut bytes, machine, start, note)?;
        parts::check_inputs(machine, program, &questions, &checked.called)?;
        // A program that asks the machine has no setpoints before it runs.
        if !args.is_at_full_speed() && !questions.has_any() {
            let times = job::times_of(args, program, machine, start, &mut bytes, &checked)?;
            checked.duration_s = times.duration_s;
        }
        (checked, None)
    } else {
        let planned = program.plan(machine, model, home)?;
        let duration_s = args.duration_s(machine, &planned.plan);
        planned.into_checked(duration_s)
    };
    args.stock.load(machine)?;
    print_check(args, program, &checked);
    if let Some(approach) = approach {
        args.print_message(&approach);
    }
    Ok(())
}

/// Checks a whole program, which runs as it was checked.
fn check_whole(
    args: &RunArgs,
    program: &PartProgram,
    machine: &MachineFile,
    start: (&Model, &AxisValues),
    mut bytes: Bytes,
) -> Result<Work, CliError> {
    let mut questions = Questions::default();
    let note = |step: &Step| questions.note(step);
    let checked = program.check_bytes(&mut bytes, machine, start, note)?;
    let called = &checked.called;
    parts::check_inputs(machine, program, &questions, called)?;
    for notice in &checked.notices {
        args.print_message(notice);
    }
    questions.check_pauses(args, program, called)?;
    if questions.has_any() {
        return Ok(Work::Parts(bytes, checked.figures.spindle_rpm));
    }
    let times = job::times_of(args, program, machine, start, &mut bytes, &checked)?;
    announce(args, program, machine, times.duration_s, &checked.figures)?;
    Ok(Work::Checked(Box::new(CheckedWork {
        bytes,
        figures: checked.figures,
        times,
    })))
}

/// Checks that the recording has space, and announces what is unusual.
fn announce(
    args: &RunArgs,
    program: &PartProgram,
    machine: &MachineFile,
    duration_s: f64,
    figures: &Figures,
) -> Result<(), CliError> {
    let bytes = args.recording_bytes(machine, duration_s);
    results::check_space(&args.out_dir(), bytes)?;
    if let Some(size) = describe_size(bytes) {
        args.print_message(&size);
    }
    if figures.blocks == 0 {
        let name = program.file_name();
        args.print_message(&format!("{name}: no motion; the machine is homed only"));
    }
    Ok(())
}

/// Checks a program that asks the machine.
fn check_parts(
    args: &RunArgs,
    program: &PartProgram,
    machine: &MachineFile,
    (model, home): (&Model, &AxisValues),
    questions: &Questions,
) -> Result<Work, CliError> {
    let checked = program.check(machine, model, home)?;
    parts::check_inputs(machine, program, questions, &checked.called)?;
    parts::check_options(args, program, questions, &checked.called)?;
    for notice in &checked.notices {
        args.print_message(notice);
    }
    let bytes = Box::new(std::io::Cursor::new(program.text.clone()));
    Ok(Work::Parts(bytes, checked.figures.spindle_rpm))
}

/// Checks that a planned program can run: pauses, questions to the operator, space on the disk.
fn check_planned(
    args: &RunArgs,
    program: &PartProgram,
    machine: &MachineFile,
    planned: Planned,
) -> Result<Work, CliError> {
    for notice in &planned.notices {
        args.print_message(notice);
    }
    if !args.skips_pauses() {
        program.check_pauses(&planned)?;
    }
    job::check_can_ask(args, &planned)?;
    let duration_s = args.duration_s(machine, &planned.plan);
    announce(args, program, machine, duration_s, &planned.plan.figures)?;
    Ok(Work::Planned(Box::new(planned)))
}

/// The size of a recording; none for a small one.
pub(super) fn describe_size(bytes: f64) -> Option<String> {
    (bytes >= ANNOUNCED_BYTES).then(|| format!("the recording takes about {:.0} MB", bytes / 1e6))
}

/// The growth of a recording, which has this size after an hour; none for one that stays small.
pub(super) fn describe_growth(hour_bytes: f64) -> Option<String> {
    (hour_bytes >= ANNOUNCED_BYTES).then(|| {
        let mb_s = hour_bytes / 3600.0 / 1e6;
        format!("the recording grows by about {mb_s:.1} MB/s")
    })
}

/// Opens the port of the observers, and prints its address and a new token.
fn serve_observers(args: &RunArgs, address: &PortSpec) -> Result<Observers, CliError> {
    let PortSpec::Tcp(address) = address else {
        let what = format!("--serve {address}: write tcp:HOST:PORT");
        return Err(CliError::new(Exit::Usage, what));
    };
    let given = args
        .token_file
        .as_deref()
        .map(sim::read_token)
        .transpose()?;
    let observers = Observers::listen(address)?;
    let is_local = observers.address().is_ok_and(|at| at.ip().is_loopback());
    let (token, is_new) = sim::token_of(given, is_local)?;
    // Standard output may be the summary as JSON.
    eprintln!("observers  {}", observers.name());
    let Some(token) = token else {
        return Ok(observers);
    };
    if is_new {
        eprintln!("token      {}", token.reveal());
    }
    Ok(observers.with_token(&token))
}

/// Prints the result of `--check`.
fn print_check(args: &RunArgs, program: &PartProgram, checked: &Checked) {
    let figures = &checked.figures;
    if args.json {
        let value = serde_json::json!({
            "program": program.name,
            "blocks": figures.blocks,
            "slowed_blocks": figures.slowed,
            "path_length_mm": figures.path_length_mm,
            "duration_s": checked.duration_s,
        });
        print_line!("{value:#}");
    }
    for notice in &checked.notices {
        args.print_message(notice);
    }
    if figures.blocks == 0 {
        let name = &program.name;
        args.print_message(&format!("{name}: no motion; a run homes the machine only"));
    }
    args.print_message(&format!(
        "{}: no problem; {}, {:.1} mm, {}",
        program.name,
        count(figures.blocks, "block"),
        figures.path_length_mm,
        args.describe_duration(checked.duration_s)
    ));
}

/// Options of a client on a serial line. The client sends no faster than the line transmits, so a
/// stop never waits behind buffered bytes.
fn paced_options(baud: Option<u32>) -> Options {
    let mut options = Options::default();
    options.timing.line_rate = baud.map_or(0, |baud| baud / 10);
    options
}
