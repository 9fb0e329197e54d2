//! Scenes that the tests of faults begin with, and what they look at.
#![allow(dead_code, reason = "each test binary uses a part")]

pub mod force;
pub mod slide;
pub mod struck;

use haptimill_hil_sim::rig::Control;
use haptimill_protocol::message::{
    Action, AxisValues, Command, Event, SETPOINT_BATCH, SetpointBatch, State,
};
use haptimill_protocol::setpoint::{Setpoint, SetpointCoder};
use haptimill_tests::Bench;
use std::collections::VecDeque;

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
pub fn tool<C: Control>(bench: &Bench<C>) -> [f64; 3] {
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

/// A circle in x and y that begins and ends at rest, of `count` spans of 50 ms; a fifth-order polynomial leads its angle.
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

/// A job as commands: start, batches, end.
pub fn commands(job: u32, start: &AxisValues, setpoints: &[Setpoint]) -> VecDeque<Command> {
    let mut coder = SetpointCoder::new(200, start);
    let begin = Command::JobStart {
        job,
        pose: start.clone(),
    };
    let batches = setpoints
        .chunks(SETPOINT_BATCH)
        .enumerate()
        .map(|(index, batch)| {
            Command::Setpoints(SetpointBatch {
                first: (index * SETPOINT_BATCH) as u32,
                items: batch
                    .iter()
                    .map(|setpoint| coder.encode(setpoint).expect("codes"))
                    .collect(),
            })
        });
    let end = Command::JobEnd {
        count: setpoints.len() as u32,
    };
    core::iter::once(begin)
        .chain(batches)
        .chain([end])
        .collect()
}

/// Says as many of the commands as there is room for.
pub fn pump(bench: &mut Bench, commands: &mut VecDeque<Command>) {
    while let Some(command) = commands.front() {
        if bench.say(command.clone()).is_none() {
            break;
        }
        commands.pop_front();
    }
}

/// Wanted poses without those at which it stood still.
pub fn without_pauses(poses: &[[i32; 6]]) -> Vec<[i32; 6]> {
    let mut path = poses.to_vec();
    path.dedup();
    path
}

/// How far a pose (x, y, z) is from a path of poses, axis units.
pub fn from_path(path: &[[i32; 6]], pose: &[i32; 6]) -> f64 {
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

/// One period; the tool and the wanted pose must not have jumped.
pub fn step_smoothly(bench: &mut Bench, most: f64) {
    let before = wanted(bench);
    bench.step();
    let after = wanted(bench);
    for axis in 0..5 {
        let unit = if axis < 3 { MM } else { DEGREE };
        let step = f64::from(after[axis].wrapping_sub(before[axis])).abs() / unit;
        assert!(step <= most, "axis {axis} jumped by {step}");
    }
}

pub fn rates(of: &[(usize, f64)]) -> AxisValues {
    let mut rates = [0; 5];
    for &(axis, rate) in of {
        rates[axis] = (rate * if axis < 3 { MM } else { DEGREE } / 256.0) as i32;
    }
    rates.into_iter().collect()
}

/// A jog of some coordinates, mm/s or degrees/s.
pub fn jog(epoch: u16, deadline_ms: u16, of: &[(usize, f64)]) -> Command {
    Command::Jog {
        epoch,
        deadline_ms,
        rates: rates(of),
    }
}
