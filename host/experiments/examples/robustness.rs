//! Tool error when the machine differs from its machine file, as a Markdown table:
//! `cargo run --release -p haptimill-experiments --example robustness -- FILE.ngc [MACHINE.toml]`.
//!
//! Inertia, friction, backlash and resonance of all simulated joints are scaled, one at a time. The
//! controller keeps its values. The last column is the largest motion of the tool in the last
//! minute of two minutes at rest after the program.

use haptimill_client::client::Options;
use haptimill_client::session::{
    JobLine as _, JobRecording, NoObserver, Session, SimLine, find_home_pose, rig,
};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::{Model, program_options, settings};
use haptimill_planner::Plan;
use haptimill_report::Statistics;
use haptimill_trace::{Header, Recorder, Recording};
use std::path::Path;
use std::sync::Arc;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// Keys of `[[plant.joint]]` that are scaled together, with their title.
const SCALED: [(&str, &[&str]); 4] = [
    ("inertia", &["inertia"]),
    ("friction", &["coulomb", "viscous"]),
    ("backlash", &["backlash"]),
    ("resonance", &["mode_hz"]),
];

/// Periods at rest: the first minute is not evaluated.
const REST_S: f64 = 120.0;

/// Errors of a run, mm.
struct ProgramResult {
    rms: f64,
    largest: f64,
    at_rest: f64,
}

/// Returns the machine with scaled values of the plant.
fn scaled(machine: &MachineFile, keys: &[&str], factor: f64) -> Result<MachineFile> {
    let mut is_plant_joint = false;
    let mut text = String::new();
    for line in machine.text.lines() {
        if line.starts_with('[') {
            is_plant_joint = line.starts_with("[[plant.joint]]");
        }
        let parts = line.split_once('=').map(|(key, rest)| (key.trim(), rest));
        match parts {
            Some((key, rest)) if is_plant_joint && keys.contains(&key) => {
                let number = rest.split('#').next().unwrap_or_default().trim();
                let value: f64 = number.parse()?;
                text += &format!("{key} = {:?}\n", value * factor);
            }
            _ => {
                text += line;
                text.push('\n');
            }
        }
    }
    Ok(MachineFile::parse(&machine.file, &text)?)
}

fn run(machine: &MachineFile, program: &Path, recording: &Path) -> Result<ProgramResult> {
    let model = Model::new(machine);
    let home = find_home_pose(machine, &model)?;
    let text = std::fs::read(program)?;
    let options = program_options(machine, model.to_engineering_units(&home));
    let name = program.display().to_string();
    let program = haptimill_gcode::read(&name, &text, &options).map_err(|it| it.to_string())?;
    let plan = Plan::new(&program, &settings(machine), &model).map_err(|it| it.to_string())?;
    let line = SimLine::new(rig(machine, None, None, Vec::new())?);
    let mut session = Session::new(line, machine, Options::default(), Arc::default());
    session.connect(1)?;
    session.configure(machine)?;
    session.enable()?;
    session.go_home(machine, &home)?;
    let recorder = Recorder::create(recording, &Header::of(machine, "robustness")?)?;
    let setpoints = plan.setpoints.clone();
    let job = JobRecording::new(recorder, plan.into(), machine);
    session.line_mut().begin_recording(job);
    let end = session.run_job(2, home, setpoints, &mut NoObserver)?;
    session.check_completed(&end)?;
    if let Some(recorder) = session.line_mut().end_recording() {
        recorder.finish()?;
    }
    let recorded = Recording::open(recording)?;
    let mut statistics = Statistics::new(&recorded);
    for record in recorded.iter()? {
        statistics.add(&record?);
    }
    statistics.finish();
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    let begun = session.now_us();
    loop {
        session.step()?;
        let seconds = (session.now_us() - begun) as f64 * 1e-6;
        if seconds > REST_S / 2.0 {
            let pose = session.line_mut().rig().truth().pose;
            for axis in 0..3 {
                low[axis] = low[axis].min(pose[axis]);
                high[axis] = high[axis].max(pose[axis]);
            }
        }
        if seconds > REST_S {
            break;
        }
    }
    let spans = low.iter().zip(high).map(|(low, high)| high - low);
    Ok(ProgramResult {
        rms: statistics.tool_error.rms(),
        largest: statistics.tool_error.max,
        at_rest: spans.fold(0.0, f64::max),
    })
}

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let program = arguments.next().ok_or("name a part program")?;
    let machine = match arguments.next() {
        Some(path) => MachineFile::load(Path::new(&path))?,
        None => MachineFile::built_in()?,
    };
    let recording = std::env::temp_dir().join(format!("robustness-{}.hmr", std::process::id()));
    println!("| plant | rms, um | largest, um | motion at rest, um |");
    println!("| --- | ---: | ---: | ---: |");
    let mut cases = vec![("as in the file".to_string(), machine.clone())];
    for (title, keys) in SCALED {
        for factor in [0.5, 2.0] {
            cases.push((
                format!("{title} x {factor}"),
                scaled(&machine, keys, factor)?,
            ));
        }
    }
    for (title, machine) in cases {
        match run(&machine, Path::new(&program), &recording) {
            Ok(found) => println!(
                "| {title} | {:.1} | {:.1} | {:.2} |",
                found.rms * 1e3,
                found.largest * 1e3,
                found.at_rest * 1e3
            ),
            Err(error) => println!("| {title} | {error} | | |"),
        }
    }
    let _ = std::fs::remove_file(&recording);
    Ok(())
}
