//! What a control period costs natively: the controller alone, and the whole simulator around it.

use criterion::{Criterion, criterion_group, criterion_main};
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{Inputs, Outputs};
use haptimill_hil_sim::rig::{Control, RigOptions};
use haptimill_tests::{Bench, line_in_x};
use std::time::{Duration, Instant};

/// A controller that is timed call by call.
struct Timed {
    controller: Controller,
    spent: Duration,
    calls: u32,
}

impl Control for Timed {
    fn tick(&mut self, inputs: &Inputs, outputs: &mut Outputs) {
        let start = Instant::now();
        self.controller.tick(inputs, outputs, &mut ());
        self.spent += start.elapsed();
        self.calls += 1;
    }
}

/// A machine in the middle of a job of 5,000,000 periods (1000 s at 0.2 mm/s).
fn moving<C: Control>(control: C) -> Bench<C> {
    let mut bench = Bench::with(&RigOptions::default(), control);
    bench.make_ready();
    let start = bench.status().wanted;
    bench.start_job(1, &line_in_x(&start, -1.0, 200));
    bench.steps(2000);
    bench
}

fn period(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("period");
    group
        .measurement_time(Duration::from_secs(5))
        .sample_size(30);
    group.bench_function("controller", |bencher| {
        bencher.iter_custom(|iterations| {
            let mut bench = moving(Timed {
                controller: Controller::new(200),
                spent: Duration::ZERO,
                calls: 0,
            });
            let mut spent = Duration::ZERO;
            let mut left = iterations;
            while left > 0 {
                let now = left.min(80_000);
                bench.rig.control_mut().spent = Duration::ZERO;
                for _ in 0..now {
                    bench.rig.step();
                }
                spent += bench.rig.control().spent;
                left -= now;
                if left > 0 {
                    bench = moving(Timed {
                        controller: Controller::new(200),
                        spent: Duration::ZERO,
                        calls: 0,
                    });
                }
            }
            spent
        });
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
