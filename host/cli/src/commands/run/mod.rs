//! `haptimill run`: runs a part program and writes the report.

mod args;
mod emulated;
pub(super) mod job;
mod progress;
pub(super) mod results;

use super::board::file_of;
use super::program::{PartProgram, Planned};
use super::{CliError, Exit};
use crate::commands::interrupt;
use haptimill_client::client::Options;
use haptimill_client::port::PortSpec;
use haptimill_client::session::{self, PortLine, Session, SimLine};
use haptimill_machine_file::model::Model;
use haptimill_report::count;
use job::Job;
use results::ResultFolder;

pub use args::RunArgs;
pub(super) use args::{bytes_per_s, faults_help};

/// Runs a part program.
///
/// # Errors
/// See [`Exit`].
pub fn run(args: RunArgs) -> Result<(), CliError> {
    args.check()?;
    let chosen = args.machine.load()?;
    let machine = chosen.file.clone();
    if args.force.is_some() {
        session::find_force_config(&machine)?;
    }
    let model = Model::new(&machine);
    let home = session::find_home_pose(&machine, &model)?;
    let program = PartProgram::load(&args.program, args.language)?;
    let planned = program.plan(&machine, &model, &home)?;
    for notice in &planned.notices {
        args.print_message(notice);
    }
    let stock = args.stock.load(&machine)?;
    if args.check {
        print_check(&args, &program, &planned);
        return Ok(());
    }
    if !args.skips_pauses() {
        program.check_pauses(&planned)?;
    }
    results::check_space(
        &args.out_dir(),
        args.recording_bytes(&machine, planned.plan.figures.duration_s),
    )?;
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
            job.run(session, planned)
        }
        PortSpec::Emulated(board) => emulated::run(job, planned, *board),
        spec => {
            let baud = args.port.baud_or_default();
            let line = PortLine::opened(spec, baud)?;
            let serial = matches!(spec, PortSpec::Serial(_));
            let options = paced_options(serial.then_some(baud));
            let mut session = Session::new(line, &machine, options, interrupted);
            session.connect(session::fresh_number())?;
            // The program was checked against the built-in machine where --machine is missing.
            // The command ends here if the board is configured as another machine.
            let machine = file_of(&chosen, &mut session)?;
            job.home = session::find_home_pose(&machine, session.model())?;
            let job = Job {
                machine: &machine,
                ..job
            };
            job.run(session, planned)
        }
    }
}

/// Prints the result of `--check`.
fn print_check(args: &RunArgs, program: &PartProgram, planned: &Planned) {
    let plan = &planned.plan;
    if args.json {
        let value = serde_json::json!({
            "program": program.name,
            "blocks": plan.figures.blocks,
            "setpoints": plan.setpoints.len(),
            "path_length_mm": plan.figures.path_length_mm,
            "duration_s": plan.figures.duration_s / args.path_rate(),
        });
        print_line!("{value:#}");
    }
    args.print_message(&format!(
        "{}: no problem; {}, {}, {:.1} mm, {}",
        program.name,
        count(plan.figures.blocks, "block"),
        count(plan.setpoints.len(), "setpoint"),
        plan.figures.path_length_mm,
        args.describe_duration(plan.figures.duration_s)
    ));
}

/// Options of a client on a serial line. The client sends no faster than the line transmits, so a
/// stop never waits behind buffered bytes.
fn paced_options(baud: Option<u32>) -> Options {
    let mut options = Options::default();
    options.timing.line_rate = baud.map_or(0, |baud| baud / 10);
    options
}
