//! Standstill, pause and resume on the queue: the speed factor never jumps, and every motion can be
//! stopped before the queue ends.

use crate::reference;
use haptimill_firmware::motion::interpolator::{FULL_FACTOR, Interpolator, QUEUE, braking_limits};
use haptimill_kinematics::Pose;
use haptimill_math::{Acceleration, Coordinate};
use haptimill_protocol::message::Action;
use haptimill_protocol::setpoint::Setpoint;
use reference::{h4, mm};

const PERIOD_S: f64 = 2e-4;

fn setpoint(x: f64, speed: f64, periods: u16) -> Setpoint {
    Setpoint {
        periods,
        pose: [mm(x), 0, mm(20.0), 0, 0].into_iter().collect(),
        rates: [(speed * 4096.0) as i32, 0, 0, 0, 0].into_iter().collect(),
        action: Action::None,
    }
}

/// A job that has not begun, on a machine with limits that short segments need.
fn start() -> Interpolator {
    let mut config = h4();
    config.pose[0].acceleration = Acceleration(mm(2000.0 / 256.0));
    let mut program = Interpolator::new(&config);
    let mut pose = Pose::default();
    pose.0[2] = Coordinate(mm(20.0));
    program.begin(&pose);
    program
}

/// Advances some periods. The rate of program time changes by at most the braking slope.
fn go(program: &mut Interpolator, periods: usize, halt: bool, before: &mut i64) {
    let slope = braking_limits(&h4().stopping, 200).expect("sound").slope();
    for period in 0..periods {
        let time = program.program_time();
        let (_, progress) = program.advance(halt);
        let now = (program.program_time() - time) as i64;
        assert!(!progress.queue_empty, "queue empty in motion");
        let change = (now - *before) as f64 / FULL_FACTOR as f64;
        assert!(
            (now - *before).abs() <= slope + 2,
            "period {period}: {change} of the programmed speed in one period"
        );
        *before = now;
    }
}

/// A line at 10 mm/s with `count` setpoints of 20 ms in the queue.
fn line(count: usize) -> Interpolator {
    let mut program = start();
    let mut x = 0.1;
    program.push(&setpoint(x, 10.0, 100)).expect("taken");
    for _ in 1..count {
        x += 0.2;
        program.push(&setpoint(x, 10.0, 100)).expect("taken");
    }
    program
}

/// Resume without a hold, or while the machine still brakes.
#[test]
fn resume_in_motion_keeps_the_speed_factor() {
    let mut program = line(14);
    program.advance(false);
    let mut rate = FULL_FACTOR;
    go(&mut program, 600, false, &mut rate);
    program.leave_pause();
    go(&mut program, 2000, false, &mut rate);
}

/// Hold, standstill on the path, resume with a short queue; more setpoints come later.
#[test]
fn resume_after_hold_ramps_up() {
    let mut program = line(14);
    program.advance(false);
    let mut rate = FULL_FACTOR;
    go(&mut program, 600, false, &mut rate);
    go(&mut program, 1000, true, &mut rate);
    assert!(program.is_at_standstill());
    program.leave_pause();
    go(&mut program, 10, false, &mut rate);
    let mut x = 0.1 + 13.0 * 0.2;
    for _ in 0..40 {
        x += 0.2;
        program.push(&setpoint(x, 10.0, 100)).expect("room");
    }
    go(&mut program, 2000, false, &mut rate);
}

/// Standstill within a job, with or without a pause. The queue behind it is full of segments so
/// short that it does not cover the stopping distance.
fn standstill_then_short_segments(action: Action) {
    let mut program = start();
    program
        .push(&Setpoint {
            action,
            ..setpoint(0.0, 0.0, 100)
        })
        .expect("taken");
    let (mut x, mut v, mut taken, mut paused) = (0.0, 0.0_f64, 0, false);
    program.advance(false);
    for _ in 0..2000 {
        while program.queued() < QUEUE && taken < QUEUE {
            let next = (v + 0.02).min(2.0);
            x += (v + next) / 2.0 * PERIOD_S;
            v = next;
            program.push(&setpoint(x, v, 1)).expect("taken");
            taken += 1;
        }
        let (_, progress) = program.advance(false);
        if progress.paused.is_some() {
            paused = true;
        } else if paused {
            paused = false;
            program.leave_pause();
        }
        assert!(!progress.queue_empty, "queue empty in motion");
    }
}

#[test]
fn short_segments_after_standstill_do_not_empty_the_queue() {
    standstill_then_short_segments(Action::None);
    standstill_then_short_segments(Action::Pause);
}
