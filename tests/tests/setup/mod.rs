//! Set-ups of the tests, and common assertions.
pub mod enable;
pub mod force;
pub mod joint_fault;
pub mod single_joint;
pub mod slides;

use haptimill_firmware::config::EncoderSettings;
use haptimill_hil_sim::rig::Control;
use haptimill_protocol::message::{Action, AxisValues, Command, Event, State};
use haptimill_protocol::setpoint::Setpoint;
use haptimill_tests::{Bench, batches};
use std::collections::VecDeque;

/// Axis units of a millimetre.
pub const MM: f64 = (1 << 20) as f64;

/// Axis units of a degree.
pub const DEGREE: f64 = 4_294_967_296.0 / 360.0;

/// Returns a homed machine at standstill.
pub fn ready() -> Bench {
    let mut bench = Bench::new();
    bench.make_ready();
    bench.steps(500);
    bench
}

/// Returns a line of one coordinate: 0.1 s to `speed` (mm/s or degrees/s), `spans` times 0.1 s at
/// it, 0.1 s to standstill.
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

/// Returns a homed machine in the middle of a line at `speed` (mm/s or degrees/s), 0.6 s after its
/// start; idle for 0.
pub fn moving(axis: usize, speed: f64) -> Bench {
    let mut bench = ready();
    if speed != 0.0 {
        let start = bench.status().commanded;
        bench.start_job(1, &line(&start, axis, speed, 28));
        bench.steps(3000);
        assert_eq!(state(&bench), State::Run);
    }
    bench
}

/// Returns the encoder of a joint in the configuration to be sent.
pub fn encoder(bench: &mut Bench, joint: usize) -> &mut EncoderSettings {
    let joint = &mut bench.machine.config.joints[joint];
    joint.encoder.as_mut().expect("an encoder")
}

/// Returns the state of the controller.
pub fn state(bench: &Bench) -> State {
    bench.rig.control().safety().state()
}

/// Returns the commanded pose.
pub fn commanded(bench: &Bench) -> [i32; 6] {
    bench
        .rig
        .control()
        .machine()
        .expect("configured")
        .motion
        .commanded()
        .pose
        .0
        .map(|coordinate| coordinate.0)
}

/// Returns the distance of the true tool from a position, mm.
pub fn distance(bench: &Bench, pose: [f64; 3]) -> f64 {
    let truth = bench.rig.plant().truth().pose;
    (0..3)
        .map(|axis| (truth[axis] - pose[axis]).powi(2))
        .sum::<f64>()
        .sqrt()
}

/// Returns the true position of the tool, mm.
pub fn tool<C: Control>(bench: &Bench<C>) -> [f64; 3] {
    let truth = bench.rig.plant().truth().pose;
    [truth[0], truth[1], truth[2]]
}

/// Returns the distance of a true joint from its commanded position, mm or degrees.
pub fn following_error(bench: &Bench, joint: usize) -> f64 {
    let target = bench
        .rig
        .control()
        .machine()
        .expect("configured")
        .target()
        .joints
        .0[joint]
        .0;
    let unit = if joint == 4 { DEGREE } else { MM };
    (bench.rig.truth().joints[joint] - f64::from(target) / unit).abs()
}

/// Returns whether every drive output is off.
pub fn drives_off(bench: &Bench) -> bool {
    bench
        .rig
        .outputs()
        .joints
        .iter()
        .all(|command| *command == haptimill_firmware::io::DriveCommand::Off)
        && bench.rig.outputs().spindle_rpm == 0
}

/// Resets after a fault or a stop, and enables if the drives went off; nothing may jump.
pub fn recover(bench: &mut Bench, expected: State) {
    bench.steps(2500);
    bench.ask(Command::Reset).expect("reset");
    bench.steps(5);
    assert_eq!(state(bench), expected);
    let before = tool(bench);
    if expected == State::Disabled {
        bench.ask(Command::Enable).expect("enabled");
    }
    let mut max = 0.0_f64;
    for _ in 0..1000 {
        bench.step();
        max = max.max(distance(bench, before));
    }
    assert_eq!(state(bench), State::Idle);
    assert!(max < 0.02, "the tool jumped by {max} mm");
}

/// Returns the faults that were reported.
pub fn reported_faults(bench: &Bench) -> Vec<&Event> {
    bench
        .events
        .iter()
        .filter(|event| matches!(event, Event::Fault(_)))
        .collect()
}

/// Returns a setpoint at standstill.
pub fn rest(pose: &AxisValues, periods: u16) -> Setpoint {
    Setpoint {
        periods,
        pose: pose.clone(),
        rates: pose.iter().map(|_| 0).collect(),
        action: Action::None,
    }
}

/// Returns a circle in x and y of `count` segments of 50 ms. A polynomial of fifth order gives its
/// angle.
pub fn circle(start: &AxisValues, radius: f64, count: usize) -> Vec<Setpoint> {
    use core::f64::consts::TAU;
    let total = count as f64 * 0.05;
    (1..=count)
        .map(|index| {
            let s = index as f64 / count as f64;
            let angle = TAU * s * s * s * (10.0 - 15.0 * s + 6.0 * s * s);
            let rate = TAU * 30.0 * s * s * (1.0 - s) * (1.0 - s) / total;
            let mut setpoint = rest(start, 250);
            setpoint.pose[0] += (radius * (angle.cos() - 1.0) * MM) as i32;
            setpoint.pose[1] += (radius * angle.sin() * MM) as i32;
            setpoint.rates[0] = (-radius * angle.sin() * rate * MM / 256.0) as i32;
            setpoint.rates[1] = (radius * angle.cos() * rate * MM / 256.0) as i32;
            setpoint
        })
        .collect()
}

/// Returns a job as commands: start, batches, end.
pub fn commands(job: u32, start: &AxisValues, setpoints: &[Setpoint]) -> VecDeque<Command> {
    let begin = Command::JobStart {
        job,
        pose: start.clone(),
    };
    let end = Command::JobEnd {
        count: setpoints.len() as u32,
    };
    core::iter::once(begin)
        .chain(batches(200, start, setpoints))
        .chain([end])
        .collect()
}

/// Sends as many of the commands as there is room for.
pub fn send_available(bench: &mut Bench, commands: &mut VecDeque<Command>) {
    while let Some(command) = commands.front() {
        if bench.send(command.clone()).is_none() {
            break;
        }
        commands.pop_front();
    }
}

/// Returns poses without repetitions.
pub fn without_repetitions(poses: &[[i32; 6]]) -> Vec<[i32; 6]> {
    let mut path = poses.to_vec();
    path.dedup();
    path
}

/// Returns the distance of a pose (x, y, z) from a path of poses, axis units.
pub fn distance_from_path(path: &[[i32; 6]], pose: &[i32; 6]) -> f64 {
    let point = |pose: &[i32; 6]| [0, 1, 2].map(|axis| f64::from(pose[axis]));
    let p = point(pose);
    path.windows(2)
        .map(|pair| {
            let (a, b) = (point(&pair[0]), point(&pair[1]));
            let along: f64 = (0..3).map(|i| (p[i] - a[i]) * (b[i] - a[i])).sum();
            let length: f64 = (0..3).map(|i| (b[i] - a[i]).powi(2)).sum();
            let s = if length > 0.0 {
                (along / length).clamp(0.0, 1.0)
            } else {
                0.0
            };
            (0..3)
                .map(|i| (a[i] + s * (b[i] - a[i]) - p[i]).powi(2))
                .sum::<f64>()
        })
        .fold(f64::INFINITY, f64::min)
        .sqrt()
}

/// Runs one period, and asserts that the commanded pose did not jump.
pub fn step_smoothly(bench: &mut Bench, max: f64) {
    let before = commanded(bench);
    bench.step();
    let after = commanded(bench);
    for axis in 0..5 {
        let unit = if axis < 3 { MM } else { DEGREE };
        let step = f64::from(after[axis].wrapping_sub(before[axis])).abs() / unit;
        assert!(step <= max, "axis {axis} jumped by {step}");
    }
}

pub fn rates(of: &[(usize, f64)]) -> AxisValues {
    let mut rates = [0; 5];
    for &(axis, rate) in of {
        rates[axis] = (rate * if axis < 3 { MM } else { DEGREE } / 256.0) as i32;
    }
    rates.into_iter().collect()
}

/// Returns a jog of some coordinates, mm/s or degrees/s.
pub fn jog(epoch: u16, timeout_ms: u16, of: &[(usize, f64)]) -> Command {
    Command::Jog {
        epoch,
        timeout_ms,
        rates: rates(of),
    }
}
