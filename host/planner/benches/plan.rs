//! Blocks per second of reading and planning, and time of one evaluation of the programmed path.

#[path = "../tests/plan/h4.rs"]
mod h4;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use haptimill_gcode::{Options, read};
use haptimill_planner::{Cursor, Plan};
use std::hint::black_box;

fn benchmarks(criterion: &mut Criterion) {
    let options = Options::of_letters("XYZBA", h4::HOME);
    let settings = h4::settings();
    let text = |name: &str| {
        std::fs::read(format!(
            "{}/../../examples/{name}",
            env!("CARGO_MANIFEST_DIR")
        ))
        .expect("the example is there")
    };
    let dome_text = text("dome.ngc");
    let dome = read("dome.ngc", &dome_text, &options).expect("readable");

    let mut group = criterion.benchmark_group("program");
    group.throughput(Throughput::Elements(dome.steps.len() as u64));
    group.bench_function("read dome", |bencher| {
        bencher.iter(|| read("dome.ngc", black_box(&dome_text), &options))
    });
    group.bench_function("plan dome", |bencher| {
        bencher.iter(|| Plan::new(black_box(&dome), &settings, &h4::H4))
    });
    group.finish();

    let mut group = criterion.benchmark_group("programmed");
    for name in ["dome.ngc", "e11-circle.ngc"] {
        let program = read(name, &text(name), &options).expect("readable");
        let plan = Plan::new(&program, &settings, &h4::H4).expect("plannable");
        let (mut cursor, mut period) = (Cursor::default(), 0u64);
        let periods = (plan.figures.duration_s / plan.period_s) as u64;
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                period = (period + 1) % periods;
                plan.programmed(&mut cursor, period as f64 * plan.period_s)
            });
        });
    }
    group.finish();
}

criterion_group!(benches, benchmarks);
criterion_main!(benches);
