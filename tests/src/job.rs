//! Jobs on a simulated machine, planned and run as the host does.

use haptimill_client::client::Options;
use haptimill_client::session::{
    self, JobEnd, JobLine, JobRecording, NoObserver, Session, SimLine,
};
use haptimill_hil_sim::fault::Fault;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::{Model, program_options, settings};
use haptimill_planner::Plan;
use haptimill_protocol::message::AxisValues;
use haptimill_trace::{Header, Record, Recorder};
use std::path::Path;
use std::sync::Arc;

/// Plans a program from the home pose.
///
/// # Errors
///
/// The message of what the language or the machine refuses.
///
/// # Panics
///
/// The machine file has no home pose.
pub fn plan(machine: &MachineFile, program: &str) -> Result<Plan, String> {
    let model = Model::new(machine);
    let start = model.to_engineering_units(&home(machine));
    let options = program_options(machine, start);
    let read = haptimill_gcode::read("test", program.as_bytes(), &options)
        .map_err(|refused| refused.to_string())?;
    Plan::new(&read, &settings(machine), &model).map_err(|refused| refused.to_string())
}

/// Home pose of a machine, axis units.
///
/// # Panics
///
/// The machine file has none.
#[must_use]
pub fn home(machine: &MachineFile) -> AxisValues {
    session::find_home_pose(machine, &Model::new(machine)).expect("a home pose")
}

/// A simulated machine that is connected, configured, enabled, homed and at its home pose.
///
/// # Panics
///
/// One of these steps fails.
#[must_use]
pub fn homed(machine: &MachineFile, faults: Vec<Fault>) -> Session<SimLine> {
    let rig = session::rig(machine, None, None, faults).expect("a simulated machine");
    let line = SimLine::new(rig);
    let mut session = Session::new(line, machine, Options::default(), Arc::default());
    session.connect(1).expect("a session");
    session.configure(machine).expect("configured");
    session.enable().expect("enabled");
    session
        .go_home(machine, &home(machine))
        .unwrap_or_else(|error| panic!("{}: {error}", machine.config.name));
    session
}

/// Records what follows. `observe` sees each record.
///
/// # Panics
///
/// The file cannot be written.
pub fn begin_recording(
    session: &mut Session<SimLine>,
    path: &Path,
    plan: &Plan,
    machine: &MachineFile,
    observe: impl FnMut(&Record) + Send + 'static,
) {
    let header = Header::of(machine, "test").expect("encoded");
    let recorder = Recorder::create(path, &header).expect("a recording");
    let recording = JobRecording::new(recorder.observed(observe), plan.clone().into(), machine);
    session.line_mut().begin_recording(recording);
}

/// Ends a recording.
///
/// # Panics
///
/// The file cannot be written.
pub fn end_recording(session: &mut Session<SimLine>) {
    let recorder = session.line_mut().end_recording().expect("a recording");
    recorder.finish().expect("written");
}

/// Runs a planned program from the home pose to its end.
///
/// # Panics
///
/// It does not end as planned.
pub fn run(session: &mut Session<SimLine>, job: u32, machine: &MachineFile, plan: &Plan) -> JobEnd {
    let end = session
        .run_job(job, home(machine), plan.setpoints.clone(), &mut NoObserver)
        .unwrap_or_else(|error| panic!("{}: {error}", machine.config.name));
    session
        .check_completed(&end)
        .unwrap_or_else(|error| panic!("{}: {error}", machine.config.name));
    end
}
