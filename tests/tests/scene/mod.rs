//! Scenes that the tests of faults begin with, and what they look at.
#![allow(dead_code, reason = "each test binary uses a part")]

use haptimill_protocol::message::{Action, AxisValues, Command, Event, State};
use haptimill_protocol::setpoint::Setpoint;
use haptimill_tests::Bench;

/// Axis units of a millimetre.
pub const MM: f64 = (1 << 20) as f64;

/// Axis units of a degree.
pub const DEGREE: f64 = 4_294_967_296.0 / 360.0;

/// A homed machine, at rest.
pub fn ready() -> Bench {
    let mut bench = Bench::new();
    bench.make_ready();
    bench.steps(500);
    bench
}

/// A line of one coordinate: 0.1 s up to `speed` (mm/s or degrees/s), so many spans of 0.1 s along, 0.1 s down.
pub fn line(start: &AxisValues, axis: usize, speed: f64, spans: usize) -> Vec<Setpoint> {
    let unit = if axis < 3 { MM } else { DEGREE };
    let mut place = f64::from(start[axis]);
    (0..spans + 2)
        .map(|span| {
            let ends = span == 0 || span == spans + 1;
            place += if ends { speed / 2.0 } else { speed } * 0.1 * unit;
            let mut setpoint = rest(start, 500);
            setpoint.pose[axis] = place as i32;
            if span != spans + 1 {
                setpoint.rates[axis] = (speed * unit / 256.0) as i32;
            }
            setpoint
        })
        .collect()
}

/// A homed machine in the middle of a line at `speed` (mm/s or degrees/s), 0.6 s after its start; 0 is a machine that holds in Idle.
pub fn moving(axis: usize, speed: f64) -> Bench {
    let mut bench = ready();
    if speed != 0.0 {
        let start = bench.status().wanted;
        bench.start_job(1, &line(&start, axis, speed, 28));
        bench.steps(3000);
        assert_eq!(state(&bench), State::Run);
    }
    bench
}

/// State of the controller, now.
pub fn state(bench: &Bench) -> State {
    bench.rig.control().safety().state()
}

/// The wanted pose, now.
pub fn wanted(bench: &Bench) -> [i32; 6] {
    bench
        .rig
        .control()
        .machinery()
        .expect("configured")
        .motion
        .wanted()
        .pose
        .0
        .map(|coordinate| coordinate.0)
}

/// Distance of the true tool from a pose in mm, tilt and table left out.
pub fn distance(bench: &Bench, pose: [f64; 3]) -> f64 {
    let truth = bench.rig.plant().truth().pose;
    (0..3)
        .map(|axis| (truth[axis] - pose[axis]).powi(2))
        .sum::<f64>()
        .sqrt()
}

/// Where the true tool is, mm.
pub fn tool(bench: &Bench) -> [f64; 3] {
    let truth = bench.rig.plant().truth().pose;
    [truth[0], truth[1], truth[2]]
}

/// How far a true joint is from where it is wanted, mm or degrees.
pub fn joint_off(bench: &Bench, joint: usize) -> f64 {
    let target = bench
        .rig
        .control()
        .machinery()
        .expect("configured")
        .target()
        .joints
        .0[joint]
        .0;
    let unit = if joint == 4 { DEGREE } else { MM };
    (bench.rig.truth().joints[joint] - f64::from(target) / unit).abs()
}

/// Whether every drive is told to be off.
pub fn drives_off(bench: &Bench) -> bool {
    bench
        .rig
        .outputs()
        .axes
        .iter()
        .all(|command| *command == haptimill_firmware::io::DriveCommand::Off)
        && bench.rig.outputs().spindle_rpm == 0
}

/// After a fault or a stop: reset, enable when the drives went off, and nothing may jump.
pub fn recover(bench: &mut Bench, expected: State) {
    bench.steps(2500);
    bench.ask(Command::Reset).expect("reset");
    bench.steps(5);
    assert_eq!(state(bench), expected);
    let before = tool(bench);
    if expected == State::Disabled {
        bench.ask(Command::Enable).expect("enabled");
    }
    let mut most = 0.0_f64;
    for _ in 0..1000 {
        bench.step();
        most = most.max(distance(bench, before));
    }
    assert_eq!(state(bench), State::Idle);
    assert!(most < 0.02, "the tool jumped by {most} mm");
}

/// The one fault that was told.
pub fn told(bench: &Bench) -> Vec<&Event> {
    bench
        .events
        .iter()
        .filter(|event| matches!(event, Event::Fault(_)))
        .collect()
}

/// A setpoint at rest, for a job that only waits.
pub fn rest(pose: &AxisValues, periods: u16) -> Setpoint {
    Setpoint {
        periods,
        pose: pose.clone(),
        rates: pose.iter().map(|_| 0).collect(),
        action: Action::None,
    }
}
