//! Native cost of a control period: the controller alone, also in a cut under force control, and
//! with the whole simulator.

#[path = "../tests/setup/mod.rs"]
#[allow(dead_code, reason = "the tests use all of it")]
mod setup;

use criterion::{Criterion, criterion_group, criterion_main};
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{Inputs, Outputs};
use haptimill_hil_sim::rig::{Control, RigOptions};
use haptimill_protocol::force::EnableCondition;
use haptimill_tests::{Bench, line_in_x};
use std::time::{Duration, Instant};

/// A controller whose calls are timed.
struct Timed {
    controller: Controller,
    spent: Duration,
}

impl Timed {
    fn new() -> Self {
        Self {
            controller: Controller::new(200),
            spent: Duration::ZERO,
        }
    }
}

impl Control for Timed {
    fn tick(&mut self, inputs: &Inputs, outputs: &mut Outputs) {
        let start = Instant::now();
        self.controller.tick(inputs, outputs, &mut ());
        self.spent += start.elapsed();
    }
}

/// A machine in the middle of a job of 5,000,000 periods (1000 s at 0.2 mm/s).
fn moving<C: Control>(control: C) -> Bench<C> {
    let mut bench = Bench::with(&RigOptions::default(), control);
    bench.make_ready();
    let start = bench.status().commanded;
    bench.start_job(1, &line_in_x(&start, -1.0, 200));
    bench.steps(2000);
    bench
}

/// A machine that cuts at 4 mm/s under force control of x and complies, with 1 s left.
fn cutting() -> Bench<Timed> {
    let mut bench = Bench::with(&RigOptions::default(), Timed::new());
    bench.make_ready();
    bench.steps(500);
    let is_displaced = |bench: &Bench<Timed>| {
        let machine = bench.rig.control().controller.machine();
        let force = &machine.expect("configured").force;
        force.as_ref().expect("has a sensor").compliance()[0]
            .displacement
            .0
            != 0
    };
    let process = setup::force::block(setup::tool(&bench), 3.0);
    bench.rig.plant_mut().fit(&process).expect("sound");
    bench.steps(100);
    setup::force::tare(&mut bench);
    let law = setup::force::force_settings(1.0, 5.0, EnableCondition::AgainstMotion);
    setup::force::control(&mut bench, 0, law);
    setup::force::job(&mut bench, -4.0, 40, 0.0);
    while !is_displaced(&bench) {
        bench.step();
    }
    bench
}

/// Mean time of the controller over periods of which a machine has `max`.
fn controller(iterations: u64, max: u64, machine: impl Fn() -> Bench<Timed>) -> Duration {
    let mut spent = Duration::ZERO;
    let mut left = iterations;
    while left > 0 {
        let now = left.min(max);
        let mut bench = machine();
        bench.rig.control_mut().spent = Duration::ZERO;
        for _ in 0..now {
            bench.rig.step();
        }
        spent += bench.rig.control().spent;
        left -= now;
    }
    spent
}
fn period(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("period");
    group
        .measurement_time(Duration::from_secs(5))
        .sample_size(30);
    group.bench_function("controller", |bencher| {
        bencher.iter_custom(|iterations| controller(iterations, 80_000, || moving(Timed::new())));
    });
    group.bench_function("controller under force control", |bencher| {
        bencher.iter_custom(|iterations| controller(iterations, 5_000, cutting));
    });
    group.bench_function("simulator", |bencher| {
        bencher.iter_custom(|iterations| {
            let mut bench = moving(Controller::new(200));
            let mut spent = Duration::ZERO;
            let mut left = iterations;
            while left > 0 {
                let now = left.min(80_000);
                let start = Instant::now();
                for _ in 0..now {
                    bench.rig.step();
                }
                spent += start.elapsed();
                left -= now;
                if left > 0 {
                    bench = moving(Controller::new(200));
                }
            }
            spent
        });
    });
    group.finish();
}

criterion_group!(benches, period);
criterion_main!(benches);
