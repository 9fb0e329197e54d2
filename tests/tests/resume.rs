//! Resume: it never makes the machine jump, and a late setpoint is reported once.

use crate::setup;
use haptimill_protocol::message::{
    AxisValues, Command, Event, SETPOINT_BATCH, SetpointBatch, State,
};
use haptimill_protocol::setpoint::{Setpoint, SetpointCoder};
use haptimill_tests::{Bench, line_in_x};
use setup::{commanded, ready, state};

const MM: f64 = (1 << 20) as f64;

/// A host that sends setpoints in parts.
struct Feeder {
    coder: SetpointCoder,
    points: Vec<Setpoint>,
    next: usize,
}

impl Feeder {
    fn start(bench: &mut Bench, points: Vec<Setpoint>) -> Self {
        let start: AxisValues = commanded(bench)[..5].iter().copied().collect();
        bench
            .ask(Command::JobStart {
                job: 1,
                pose: start.clone(),
            })
            .expect("started");
        Self {
            coder: SetpointCoder::new(200, &start),
            points,
            next: 0,
        }
    }

    /// Returns the next setpoints as one message.
    fn batch(&mut self, count: usize) -> Command {
        let first = self.next;
        self.next = (first + count).min(self.points.len());
        let points = self.points[first..self.next].iter();
        let items = points.map(|point| self.coder.encode(point).expect("codes"));
        Command::Setpoints(SetpointBatch {
            first: first as u32,
            items: items.collect(),
        })
    }

    fn send_next_setpoints(&mut self, bench: &mut Bench, count: usize) {
        let end = self.next + count;
        while self.next < end {
            let batch = self.batch(SETPOINT_BATCH.min(end - self.next));
            bench.ask(batch).expect("accepted");
        }
    }
}

/// Runs periods. Returns the speed in x of each, mm/s; it may change by `max` in one.
fn run_smoothly(bench: &mut Bench, periods: usize, speed: &mut f64, max: f64) {
    for period in 0..periods {
        let before = commanded(bench)[0];
        bench.step();
        let now = f64::from(commanded(bench)[0] - before) / MM / 2e-4;
        assert!(
            (now - *speed).abs() <= max,
            "period {period}: from {speed} to {now} mm/s in one period, {:?}",
            state(bench)
        );
        *speed = now;
    }
}

/// Returns a machine at 10 mm/s with fewer setpoints than it needs to stop (300 ms), and its speed.
fn short_of_setpoints() -> (Bench, Feeder, f64) {
    let mut bench = ready();
    let start = bench.status().commanded;
    // 20 segments of 100 ms at 10 mm/s; 300 ms to brake.
    let mut feeder = Feeder::start(&mut bench, line_in_x(&start, 10.0, 40));
    feeder.send_next_setpoints(&mut bench, 8);
    let mut speed = 0.0;
    run_smoothly(&mut bench, 1200, &mut speed, 0.3);
    assert!(speed > 9.0);
    (bench, feeder, speed)
}

/// An operator holds and resumes, or resumes an underrun, while the queue is shorter than the
/// stopping time.
#[test]
fn a_resume_causes_no_jump() {
    let (mut bench, mut feeder, mut speed) = short_of_setpoints();
    bench.send(Command::Hold).expect("room");
    run_smoothly(&mut bench, 2500, &mut speed, 0.3);
    assert_eq!((state(&bench), speed), (State::Hold, 0.0));
    bench.send(Command::Resume).expect("room");
    run_smoothly(&mut bench, 100, &mut speed, 0.3);
    for _ in 0..8 {
        let batch = feeder.batch(4);
        bench.send(batch).expect("room");
        run_smoothly(&mut bench, 40, &mut speed, 0.3);
    }
    run_smoothly(&mut bench, 2000, &mut speed, 0.3);
}

/// A resume while the machine runs: a second key press, or a repeated command.
#[test]
fn a_resume_of_a_running_machine_changes_nothing() {
    let (mut bench, _, mut speed) = short_of_setpoints();
    bench.send(Command::Resume).expect("room");
    run_smoothly(&mut bench, 500, &mut speed, 0.3);
}

/// A late setpoint is reported once. A job that is dropped while it waits has its own fault.
#[test]
fn a_late_setpoint_is_reported_once() {
    let mut bench = ready();
    let start = bench.status().commanded;
    let mut feeder = Feeder::start(&mut bench, line_in_x(&start, 4.0, 40));
    feeder.send_next_setpoints(&mut bench, 12);
    bench.steps(8000);
    feeder.send_next_setpoints(&mut bench, 1);
    bench.steps(500);
    bench.ask(Command::Stop).expect("stops");
    bench.steps(500);
    let named = |commanded: u32| {
        bench
            .events
            .iter()
            .filter(
                |event| matches!(event, Event::Underrun { setpoint, .. } if *setpoint == commanded),
            )
            .count()
    };
    assert_eq!((named(12), named(13)), (1, 1), "{:?}", bench.events);
}
