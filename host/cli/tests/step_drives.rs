//! Jobs on machines with step/direction drives, alone and together with torque drives.

use crate::scene;
use haptimill::commands::CliError;
use haptimill_client::client::Options;
use haptimill_client::session::{self, JobEnd, NoObserver, Session, SimLine};
use haptimill_firmware::io::DriveCommand;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::{Model, program_options, settings};
use haptimill_planner::Plan;
use haptimill_protocol::message::State;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use scene::{TestFolder, haptimill, number};

fn machines() -> PathBuf {
    scene::root().join("machines")
}

/// A machine file with the sections `[[joint]]` and `[[plant.joint]]` of some joints taken from
/// another file.
fn mixed(step: &str, torque: &str, from_torque: &[&str]) -> String {
    let parts = |text: &str| -> Vec<String> {
        let mut parts = vec![String::new()];
        for line in text.lines() {
            // The sections of the joints, and the sections after them.
            if line.starts_with("[[")
                || line.starts_with("[planner]")
                || line.starts_with("[plant]")
            {
                parts.push(String::new());
            }
            let part = parts.last_mut().unwrap();
            part.push_str(line);
            part.push('\n');
        }
        parts
    };
    let (step, torque) = (parts(step), parts(torque));
    let taken = |part: &String| {
        let of_a_joint = ["[[joint]]", "[[plant.joint]]"]
            .into_iter()
            .find(|heading| part.starts_with(heading))?;
        let name = from_torque
            .iter()
            .map(|name| format!("name = \"{name}\""))
            .find(|name| part.contains(name))?;
        let other = torque
            .iter()
            .find(|part| part.starts_with(of_a_joint) && part.contains(&name));
        Some(other.expect("the joint is in both files").clone())
    };
    let chosen = step
        .iter()
        .map(|part| taken(part).unwrap_or_else(|| part.clone()));
    chosen.collect()
}

/// Runs the slot program and returns the simulator with its pulse report.
fn run(machine: &MachineFile) -> Result<(JobEnd, SimLine), CliError> {
    let model = Model::new(machine);
    let home = model.home(machine).unwrap();
    let options = program_options(machine, model.to_engineering_units(&home));
    let text = std::fs::read(scene::root().join("examples/e7-slot.ngc")).unwrap();
    let program = haptimill_gcode::read("e7-slot.ngc", &text, &options).unwrap();
    let plan = Plan::new(&program, &settings(machine), &model).unwrap();
    let line = SimLine::new(session::rig(machine, None, None, Vec::new())?);
    let mut session = Session::new(line, machine, Options::default(), Arc::default());
    session.connect(1)?;
    session.configure(machine)?;
    session.enable()?;
    session.go_home(machine, &home)?;
    let end = session.run_job(2, home, plan.setpoints, &mut NoObserver)?;
    Ok((end, session.into_line()))
}

/// Every pulse keeps the timing of the drive's data sheet, and every commanded step is made.
fn expect_clean_pulses(machine: &MachineFile, stepped: &[usize]) {
    let (end, line) = run(machine).unwrap();
    assert_eq!(
        (
            end.status.state,
            end.faults.as_slice(),
            end.underruns.as_slice()
        ),
        (State::Idle, &[][..], &[][..])
    );
    let rig = line.rig();
    assert_eq!(rig.plant().misdirected(), 0);
    for axis in 0..5 {
        let report = rig.plant().pulse_report(axis);
        assert_eq!(report.is_some(), stepped.contains(&axis), "joint {axis}");
        let joint = rig.control().machine().unwrap().joints().nth(axis).unwrap();
        assert_eq!(
            matches!(joint.command, DriveCommand::Steps(_)),
            stepped.contains(&axis)
        );
        let Some(report) = report else { continue };
        assert_eq!((report.violations, report.first), (0, None), "joint {axis}");
        assert!(
            report.shortest_interval.is_some(),
            "joint {axis} made no step"
        );
        // 320 steps/mm: a lost electrical turn would be four full steps, 0.2 mm.
        let lost = end.status.following_error[axis];
        assert!(
            lost.abs() < (0.02 * f64::from(1 << 20)) as i32,
            "joint {axis} is off by {lost}"
        );
    }
}

#[test]
fn step_drives_make_every_step() {
    let machine = MachineFile::load(&machines().join("h4-step.toml")).unwrap();
    expect_clean_pulses(&machine, &[0, 1, 2, 3]);
    let folder = TestFolder::new();
    let out = folder.path("out");
    haptimill(&[
        "run",
        "examples/e7-slot.ngc",
        "--machine",
        "machines/h4-step.toml",
        "--out",
        &out,
        "--json",
    ])
    .expect_code(0);
    let summary = folder.summary("out");
    println!("step drives: {summary:#}");
    assert!(number(&summary, "tool_error_rms_mm") <= 0.02, "{summary:#}");
    assert!(number(&summary, "tool_error_max_mm") <= 0.05, "{summary:#}");
    assert!(folder.read("out/trace.csv").starts_with("time_s,"));
    assert!(folder.read("out/trace.csv").contains("l1_drive_steps"));
}

#[test]
fn step_and_torque_drives_work_together() {
    let read = |name: &str| std::fs::read_to_string(machines().join(name)).unwrap();
    let text = mixed(&read("h4-step.toml"), &read("h4.toml"), &["l2", "l3"]);
    let folder = TestFolder::new();
    let file = folder.file("mixed.toml", text);
    let machine = MachineFile::load(Path::new(&file)).unwrap();
    expect_clean_pulses(&machine, &[0, 3]);
    let out = folder.path("out");
    haptimill(&[
        "run",
        "examples/e9-pocket.ngc",
        "--machine",
        &file,
        "--out",
        &out,
        "--json",
    ])
    .expect_code(0);
    let summary = folder.summary("out");
    println!("two step drives, two torque drives: {summary:#}");
    assert!(number(&summary, "tool_error_max_mm") <= 0.05, "{summary:#}");
}
