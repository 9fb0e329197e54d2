//! The controller on an emulated Cortex-M4F and M7 against the controller in this process: equal
//! outputs, speed, and the end of a run that is ended from outside.
//!
//! Needs the feature `emulated`, a compiler for the chip and the emulator. `cargo xtask test`
//! provides them.

use crate::emulator;
use emulator::{part_of_dome, results, root, run_timed, scenario, teleoperate};
use haptimill_client::port::Board;
use haptimill_client::session::pil::{self, Emulator, Instructions};
use haptimill_client::session::rig_around;
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{DriveCommand, Outputs};
use haptimill_firmware::snapshot::Snapshot;
use haptimill_hil_sim::RigOptions;
use haptimill_hil_sim::process::ElasticWall;
use haptimill_hil_sim::process::ProcessConfig;
use haptimill_hil_sim::process::sensor::SensorConfig;
use haptimill_hil_sim::remote::RemoteController;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::force::{EnableCondition, ForceLoop};
use haptimill_protocol::message::{Command as Say, Event, State};
use haptimill_tests::{Bench, line_in_x};
use haptimill_trace::replay::replay;
use haptimill_trace::{Recording, difference};
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

/// Runs a program natively, on the M4F and on the M7, and compares the recordings.
fn equal_outputs(name: &str, program: &Path) {
    let out = |port: &str| results(&format!("{name}-{port}"));
    run_timed(program, "sim", &out("native"), &[]);
    let native = Recording::open(&out("native").join("recording.hmr")).expect("recorded");
    let seconds = native.records() as f64 * native.period_s();
    // The build is not part of the job.
    pil::image(Board::Mps2).expect("builds");
    for (port, folder) in [("pil:mps2", "m4"), ("pil:mps2-m7", "m7")] {
        let took = run_timed(program, port, &out(folder), &[]).as_secs_f64();
        let emulated = Recording::open(&out(folder).join("recording.hmr")).expect("recorded");
        let found = difference(&native, &emulated).expect("readable");
        assert!(
            found.is_none(),
            "{name}, native and {port}: {}",
            found.expect("differs")
        );
        let read =
            |folder: &str| std::fs::read(out(folder).join("recording.hmr")).expect("readable");
        assert!(
            read("native") == read(folder),
            "{name}, native and {port}: the headers differ"
        );
        // A controller in this process gives the outputs of the chip for the same inputs.
        let replayed = replay(&emulated).expect("has its periods");
        let replayed = replayed.unwrap_or_else(|difference| panic!("{name}, {port}: {difference}"));
        assert_eq!(replayed.records, native.records());
        println!(
            "{name}: {} control periods, bit-identical natively and on {port}; {:.1} times real time",
            native.records(),
            seconds / took
        );
    }
}

#[test]
fn chip_and_native_outputs_are_equal_in_the_slot() {
    equal_outputs("e7", &root().join("examples/e7-slot.ngc"));
}

#[test]
fn chip_and_native_outputs_are_equal_in_the_pocket() {
    equal_outputs("e9", &root().join("examples/e9-pocket.ngc"));
}

#[test]
fn chip_and_native_outputs_are_equal_on_the_circle() {
    equal_outputs("e11", &root().join("examples/e11-circle.ngc"));
}

#[test]
fn chip_and_native_outputs_are_equal_in_five_axes() {
    equal_outputs("dome", &part_of_dome(500));
}

/// Runs a tool under force control into a wall. Returns state and outputs of every period.
fn run_into_wall<C: haptimill_hil_sim::Control>(control: C) -> Vec<(Snapshot, Outputs)> {
    let mut bench = Bench::with(&RigOptions::default(), control);
    bench.make_ready();
    bench.steps(500);
    let pose = bench.rig.truth().pose;
    let process = ProcessConfig {
        wall: Some(ElasticWall {
            point: [pose[0] - 0.4, pose[1], pose[2]],
            normal: [1.0, 0.0, 0.0],
            stiffness: 300.0,
            damping: 0.03,
            radius: 0.0,
        }),
        sensor: Some(SensorConfig::default()),
        ..ProcessConfig::default()
    };
    bench.rig.plant_mut().fit(&process).expect("sound");
    bench.steps(100);
    bench.ask(Say::Tare).expect("begun");
    bench.steps(1500);
    assert!(bench.events.contains(&Event::Tared), "{:?}", bench.events);
    let raw = |value: f64| (value * 65_536.0) as u32;
    let settings = ForceLoop {
        setpoint: raw(5.0) as i32,
        mass: raw(0.8),
        damping: raw(4.0),
        limit: 10 << 20,
        rate: 20 << 20,
        enable_condition: EnableCondition::Any,
    };
    bench
        .ask(Say::ForceLoop { axis: 0, settings })
        .expect("accepted");
    bench.ask(Say::ForceMask { mask: 5 }).expect("accepted");
    let start = bench.status().commanded;
    bench.start_job(1, &line_in_x(&start, -1.0, 15));
    let mut seen = Vec::new();
    for _ in 0..9000 {
        bench.step();
        let snapshot = bench.rig.control().snapshot(bench.rig.inputs());
        seen.push((snapshot.expect("configured"), bench.rig.outputs().clone()));
    }
    seen
}

#[test]
fn chip_and_native_outputs_are_equal_under_force_control() {
    let machine = MachineFile::built_in().expect("sound");
    let native = run_into_wall(Controller::new(machine.config.period_us));
    let displacements = native
        .iter()
        .map(|(snapshot, _)| snapshot.force.displacement[0]);
    let max = displacements.max().unwrap_or(0);
    assert!(max > 1 << 19, "the displacement is {max} units only");
    let image = pil::image(Board::Mps2).expect("builds");
    let emulator = Emulator::start(Board::Mps2, &image).expect("starts");
    let remote = RemoteController::begin(emulator, machine.config.period_us).expect("begins");
    let cost = remote.cost();
    let emulated = run_into_wall(remote);
    for (period, (native, emulated)) in native.iter().zip(&emulated).enumerate() {
        assert_eq!(native, emulated, "period {period}");
    }
    assert_eq!(native.len(), emulated.len());
    let cost = Instructions::of(&cost.lock().expect("not poisoned"));
    println!(
        "force control against a wall, {} periods: {cost:?}",
        native.len()
    );
}

/// Returns the speed of a job on the chip relative to real time, with telemetry at an interval or
/// without.
fn real_time_factor(every: u16) -> (f64, u64) {
    let image = pil::image(Board::Mps2).expect("builds");
    let mut bench = Bench::with(
        &RigOptions::default(),
        emulator::remote(Board::Mps2, &image, &[]),
    );
    bench.make_ready();
    bench.steps(500);
    let start = bench.status().commanded;
    bench.ask(Say::Telemetry { every }).expect("accepted");
    bench.start_job(1, &line_in_x(&start, -10.0, 40));
    bench.steps(500);
    let (mut frames, mut last) = (0, 0);
    let periods = 15_000;
    let begun = Instant::now();
    for _ in 0..periods {
        bench.step();
        let newest = bench
            .telemetry
            .as_ref()
            .map_or(0, |telemetry| telemetry.period);
        frames += u64::from(newest != last);
        last = newest;
    }
    let took = begun.elapsed().as_secs_f64();
    let machine = f64::from(periods) * f64::from(bench.rig.plant().period_us()) * 1e-6;
    assert_eq!(bench.status().state, State::Run);
    (machine / took, frames)
}

/// The speed depends on the load of the computer. So the bounds are a tenth of the goals (3 and
/// 0.5).
#[test]
fn an_emulated_job_reaches_its_speed() {
    for (every, words, min) in [(0, "setpoints only", 0.3), (5, "telemetry at 1 kHz", 0.05)] {
        let (times, frames) = real_time_factor(every);
        println!("{words}: {times:.2} times real time, {frames} telemetry frames in 3 s");
        assert!(
            if every == 0 {
                frames <= 1
            } else {
                frames > 2_950
            },
            "{frames}"
        );
        assert!(times > min);
    }
}

/// A scenario cuts, measures forces and the surface with the controller on the chip as natively.
#[test]
fn a_scenario_runs_on_the_chip() {
    let out = results("scenario-m4");
    scenario("e7", "pil:mps2", &out).expect("runs");
    let summary = std::fs::read_to_string(out.join("e7/summary.json")).expect("written");
    let summary: serde_json::Value = serde_json::from_str(&summary).expect("JSON");
    let claims = summary["claims"].as_array().expect("a table");
    assert!(claims.len() > 5, "{summary:#}");
    let native = results("scenario-native");
    scenario("e7", "sim", &native).expect("runs");
    let expected = std::fs::read_to_string(native.join("e7/summary.json")).expect("written");
    let expected: serde_json::Value = serde_json::from_str(&expected).expect("JSON");
    assert_eq!(summary["claims"], expected["claims"]);
    let begun = Instant::now();
    let refused = scenario("e7", "tcp:localhost:1", &out).expect_err("has no simulated work");
    assert!(refused.message.contains("pil:mps2"), "{refused}");
    assert!(begun.elapsed() < Duration::from_secs(2));
}

/// A master moves the tool and feels the cut: kinematics, statics and force feedback of the haptic
/// arm on the chip.
#[test]
fn chip_and_native_outputs_are_equal_in_teleoperation() {
    let out = |port: &str| results(&format!("e8-{port}"));
    scenario("e8", "sim", &out("native")).expect("runs");
    scenario("e8", "pil:mps2", &out("m4")).expect("runs");
    let recording = |folder: &str| out(folder).join("e8/cut/recording.hmr");
    let open = |folder: &str| Recording::open(&recording(folder)).expect("recorded");
    let (native, emulated) = (open("native"), open("m4"));
    assert!(native.records() > 40_000, "{}", native.records());
    if let Some(found) = difference(&native, &emulated).expect("readable") {
        panic!("{found}");
    }
    let read = |folder: &str| std::fs::read(recording(folder)).expect("readable");
    assert!(read("native") == read("m4"), "the headers differ");
}

/// A remote master moves a machine whose controller runs on the chip.
#[test]
fn chip_and_native_outputs_are_equal_with_a_remote_master() {
    let script = results("remote-master.toml");
    let text = "end_s = 3.0\n[[button]]\nat_s = 0.2\nheld = true\n\
                [[stroke]]\nat_s = 0.6\nto_mm = [-8.0, 0.0, 0.0]\npace_mm_s = 6.0\nramp_s = 0.5\n";
    std::fs::write(&script, text).expect("written");
    let out = |port: &str| results(&format!("remote-master-{port}"));
    teleoperate(&script, "sim", &out("native")).expect("runs");
    teleoperate(&script, "pil:mps2", &out("m4")).expect("runs");
    let open =
        |folder: &str| Recording::open(&out(folder).join("recording.hmr")).expect("recorded");
    let (native, emulated) = (open("native"), open("m4"));
    assert!(native.records() > 10_000, "{}", native.records());
    if let Some(found) = difference(&native, &emulated).expect("readable") {
        panic!("{found}");
    }
}

/// `explain` finds the one difference that was made, and no other.
#[test]
fn a_difference_of_recordings_is_explained() {
    let program = root().join("examples/e7-slot.ngc");
    let (one, other) = (results("seed-1"), results("seed-2"));
    run_timed(&program, "sim", &one, &["--seed", "1"]);
    run_timed(&program, "sim", &other, &["--seed", "2"]);
    let open = |folder: &Path| Recording::open(&folder.join("recording.hmr")).expect("recorded");
    let found = difference(&open(&one), &open(&other))
        .expect("readable")
        .expect("differs");
    let mut records = open(&one)
        .iter()
        .expect("readable")
        .zip(open(&other).iter().expect("readable"));
    let first = records.position(|(one, other)| one.expect("whole") != other.expect("whole"));
    assert_eq!(first, Some(found.record as usize));
    assert_ne!(found.first, found.second, "{found}");
}

/// Returns an idle rig around the emulated board, and the emulator's process number.
fn idle_rig() -> (haptimill_hil_sim::Rig<RemoteController<Emulator>>, u32) {
    let machine = MachineFile::built_in().expect("sound");
    let image = pil::image(Board::Mps2).expect("builds");
    let emulator = Emulator::start(Board::Mps2, &image).expect("starts");
    let process = emulator.process();
    let remote = RemoteController::begin(emulator, machine.config.period_us).expect("begins");
    let mut rig = rig_around(remote, &machine, None, None, Vec::new()).expect("sound");
    for _ in 0..1000 {
        assert!(rig.step());
    }
    assert_eq!(haptimill_hil_sim::Control::failure(rig.control()), None);
    (rig, process)
}

fn process_exists(process: u32) -> bool {
    Path::new(&format!("/proc/{process}")).exists()
}

/// The shell's built-in `kill`: a minimal machine has no other.
fn signal(name: &str, process: u32) {
    let status = Command::new("sh")
        .args(["-c", &format!("kill {name} {process}")])
        .status();
    assert!(status.expect("a shell").success());
}

/// Steps until the rig reports a failed controller. Returns the reason and the time that it took.
fn run_until_failure(
    rig: &mut haptimill_hil_sim::Rig<RemoteController<Emulator>>,
) -> (String, Duration) {
    let begun = Instant::now();
    loop {
        rig.step();
        if let Some(reason) = haptimill_hil_sim::Control::failure(rig.control()) {
            assert!(
                rig.outputs()
                    .joints
                    .iter()
                    .all(|joint| *joint == DriveCommand::Off)
            );
            return (reason.to_string(), begun.elapsed());
        }
        assert!(
            begun.elapsed() < Duration::from_secs(5),
            "no fault was detected"
        );
    }
}

#[test]
fn a_killed_emulator_is_detected_at_once() {
    let (mut rig, process) = idle_rig();
    signal("-KILL", process);
    let (reason, after) = run_until_failure(&mut rig);
    println!("after {after:?}: {reason}");
    assert!(reason.contains("emulator"), "{reason}");
    assert!(after < Duration::from_secs(2));
}

#[test]
fn a_stalled_emulator_is_terminated() {
    let (mut rig, process) = idle_rig();
    signal("-STOP", process);
    let (reason, after) = run_until_failure(&mut rig);
    println!("after {after:?}: {reason}");
    assert!(after < Duration::from_millis(2500));
    assert!(process_exists(process));
    drop(rig);
    assert!(!process_exists(process), "the emulator is still there");
}

#[test]
fn a_finished_run_leaves_no_process() {
    let (rig, process) = idle_rig();
    let cost = rig.control().cost();
    drop(rig);
    assert!(!process_exists(process), "the emulator is still there");
    let cost = cost.lock().expect("not poisoned");
    assert!(cost.stack_bytes > 0, "the image did not end by itself");
}
