//! A multi-turn rotary coordinate: the axis a of `machines/mill4.toml`.
//!
//! The true angle of the simulated axis counts turns in f64, apart from the controller's integers.

use haptimill_firmware::config::AxisKind;
use haptimill_firmware::motion::jog::Jog;
use haptimill_kinematics::{Joints, Kinematics};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_machine_file::scale::per_unit;
use haptimill_protocol::message::MAX_AXES;
use haptimill_tests::job;
use haptimill_trace::{Recording, replay};
use std::path::Path;
use std::sync::LazyLock;

static MACHINE: LazyLock<MachineFile> = LazyLock::new(|| {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../machines/mill4.toml");
    MachineFile::load(&file).unwrap_or_else(|problems| panic!("{problems}"))
});

/// The rotary axis in a pose and in the joints.
const A: usize = 3;
/// Seconds of a control period.
const PERIOD: f64 = 2e-4;

#[test]
fn a_program_winds_the_axis_up_and_unwinds_it() {
    let machine = &*MACHINE;
    let model = Model::new(machine);
    // 28 turns up at two turns per second, 50 down with a move of x, then to two angles.
    let text = "G21 G90 F43200\nG1 A10080\nG0 A-7920 X3\nG1 A-90\nG0 A725.25\nM30\n";
    let plan = job::plan(machine, text).unwrap_or_else(|refused| panic!("{refused}"));
    let mut session = job::homed(machine, vec![]);
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("recording.hmr");
    job::begin_recording(&mut session, &path, &plan, machine, |_| ());
    let end = job::run(&mut session, 2, machine, &plan);
    job::end_recording(&mut session);
    assert!(end.status.homed);
    let status = session.status().expect("a status");
    let measured = model.to_engineering_units(&status.measured)[A];
    assert!((measured - 725.25).abs() < 0.05, "{measured}");
    let truth = session.line_mut().rig().plant().truth().joints[A];
    assert!((truth - 725.25).abs() < 0.05, "{truth}");
    // Home is two turns back, not the same angle a quarter turn away.
    session
        .go_home(machine, &job::home(machine))
        .expect("homed again");
    let truth = session.into_line().rig().plant().truth().joints[A];
    assert!(truth.abs() < 0.05, "{truth}");

    let recording = Recording::open(&path).expect("readable");
    let unit = recording.pose_units()[A];
    let (mut low, mut high, mut worst, mut fastest) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
    let mut before = None;
    for record in recording.iter().expect("records") {
        let record = record.expect("a record");
        let [commanded, tool] =
            [record.commanded[A], record.tool[A]].map(|at| f64::from(at) * unit);
        (low, high) = (low.min(commanded), high.max(commanded));
        worst = worst.max((commanded - tool).abs());
        fastest = fastest.max(before.map_or(0.0, |before: f64| (commanded - before).abs()));
        before = Some(commanded);
    }
    println!("largest difference from the command: {worst:.4} deg");
    assert!((high - 10_080.0).abs() < 0.01 && (low + 7920.0).abs() < 0.01);
    // 120 revolutions per minute.
    assert!((fastest / PERIOD - 720.0).abs() < 1.0, "{fastest}");
    // The lag of the servo loop at that rate.
    assert!(worst < 2.0, "{worst}");
    assert!(replay::replay(&recording).expect("replayable").is_ok());
}

#[test]
fn turns_beyond_the_limits_are_refused_by_name() {
    assert!(job::plan(&MACHINE, "G21 G90\nG0 A10799\nM30\n").is_ok());
    for angle in ["A10801", "A-10801", "A190000", "A1e9"] {
        let Err(refused) = job::plan(&MACHINE, &format!("G21 G90\nG0 {angle}\nM30\n")) else {
            panic!("{angle} is accepted");
        };
        assert!(refused.contains(":2:"), "{refused}");
        if angle != "A1e9" {
            assert!(refused.contains("-10800 to 10800 deg"), "{refused}");
        }
    }
}

/// A jog turns on over turns, at its full rate, and stops before its limit.
#[test]
fn a_jog_stops_at_the_limit_of_the_turns() {
    let config = &MACHINE.config;
    assert_eq!(config.pose[A].kind, AxisKind::MultiTurn);
    let kinematics = config.kinematics();
    let mut joints = Joints::default();
    for (joint, preset) in joints.0.iter_mut().zip(MACHINE.preset()) {
        *joint = preset;
    }
    let home = kinematics.forward(&joints).expect("a pose");
    for sign in [1, -1] {
        let mut jog = Jog::new(config);
        jog.begin(&home, true);
        let mut rates = [0; MAX_AXES];
        rates[A] = sign * i64::from(config.pose[A].rate.0);
        // 30 turns take 15 s.
        let periods = 100_000;
        jog.set_rates(&rates, periods);
        let (mut at, mut fastest) = (0_i64, 0_i64);
        for _ in 0..periods {
            let (commanded, _) = jog.advance(&kinematics);
            let now = i64::from(commanded.pose.0[A].0);
            fastest = fastest.max((now - at).abs());
            at = now;
        }
        let degrees = at as f64 / per_unit(AxisKind::MultiTurn);
        let reached = degrees * f64::from(sign as i32);
        assert!((10_790.0..=10_800.0).contains(&reached), "{degrees} deg");
        let rate = fastest as f64 / per_unit(AxisKind::MultiTurn) / PERIOD;
        assert!((rate - 720.0).abs() < 1.0, "{rate} deg/s");
    }
}
