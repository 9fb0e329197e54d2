//! Time of reading, ordering and clearing: from the bytes of a drawing to the text of a program.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use haptimill_engrave::drawing::Drawing;
use haptimill_engrave::gcode::{Rates, program};
use haptimill_engrave::job::{Job, Operation, Options, Ordering, plan};
use haptimill_engrave::read::{ReadOptions, read};
use haptimill_engrave::shape::Clearing;
use std::hint::black_box;

/// A DXF of lines of 1 to 8 units at places of a linear congruential generator.
fn random_lines(count: usize) -> Vec<u8> {
    let mut state = 1_u64;
    let mut next = |span: f64| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64 * span
    };
    let mut text = String::from("0\nSECTION\n2\nENTITIES\n");
    for _ in 0..count {
        let (x, y, length, angle) = (
            next(1000.0),
            next(1000.0),
            1.0 + next(7.0),
            next(std::f64::consts::TAU),
        );
        let (u, v) = (x + length * angle.cos(), y + length * angle.sin());
        text += &format!("0\nLINE\n8\n0\n10\n{x:.4}\n20\n{y:.4}\n11\n{u:.4}\n21\n{v:.4}\n");
    }
    text += "0\nENDSEC\n0\nEOF\n";
    text.into_bytes()
}

/// A DXF of circles of 8 units with an island of 2 units, in rows.
fn washers(count: usize) -> Vec<u8> {
    let mut text = String::from("0\nSECTION\n2\nENTITIES\n");
    for k in 0..count {
        let (x, y) = ((k % 20) as f64 * 20.0, (k / 20) as f64 * 20.0);
        for radius in [8.0, 2.0] {
            text += &format!("0\nCIRCLE\n8\n0\n10\n{x:.4}\n20\n{y:.4}\n40\n{radius}\n");
        }
    }
    text += "0\nENDSEC\n0\nEOF\n";
    text.into_bytes()
}

/// A DXF of a circle of 50 units as a program traces it from a picture: a polyline of 4,000
/// vertices that are off by up to 0.02 units.
fn traced_circle() -> Vec<u8> {
    const COUNT: usize = 4_000;
    let mut state = 1_u64;
    let mut text = format!("0\nSECTION\n2\nENTITIES\n0\nLWPOLYLINE\n8\n0\n90\n{COUNT}\n70\n1\n");
    for k in 0..COUNT {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let noise = (state >> 11) as f64 / (1_u64 << 53) as f64 * 0.04 - 0.02;
        let angle = k as f64 / COUNT as f64 * std::f64::consts::TAU;
        let (sin, cos) = angle.sin_cos();
        let radius = 50.0 + noise;
        text += &format!("10\n{:.6}\n20\n{:.6}\n", radius * cos, radius * sin);
    }
    text += "0\nENDSEC\n0\nEOF\n";
    text.into_bytes()
}

fn drawing(bytes: &[u8]) -> Drawing {
    read(bytes, &ReadOptions::default()).expect("readable")
}

fn text(job: &Job) -> String {
    let rates = Rates {
        feed: 300.0,
        plunge: 60.0,
        speed: 10_000.0,
        lift_mm: 1.0,
    };
    program(&job.toolpath, rates, [0.0; 2], &[])
}

fn benchmarks(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("engrave");
    group.sample_size(10);
    for count in [1_000, 10_000, 50_000] {
        let bytes = random_lines(count);
        group.throughput(Throughput::Elements(count as u64));
        group.bench_function(format!("read {count} lines"), |bencher| {
            bencher.iter(|| drawing(black_box(&bytes)))
        });
        let lines = drawing(&bytes);
        group.bench_function(format!("order {count} lines"), |bencher| {
            bencher.iter(|| plan(black_box(&lines), &Options::default()))
        });
        group.bench_function(format!("file to program, {count} lines"), |bencher| {
            bencher
                .iter(|| plan(&drawing(black_box(&bytes)), &Options::default()).map(|j| text(&j)))
        });
    }
    group.bench_function("order greedy 50000 lines", |bencher| {
        let lines = drawing(&random_lines(50_000));
        let greedy = Options {
            ordering: Ordering::Greedy,
            ..Options::default()
        };
        bencher.iter(|| plan(black_box(&lines), &greedy))
    });
    let path = format!("{}/../../examples/plate.dxf", env!("CARGO_MANIFEST_DIR"));
    let mut picture = drawing(&std::fs::read(path).expect("the example is there"));
    let layer = haptimill_engrave::drawing::LayerChoice {
        only: vec!["PICTURE".into()],
        without: Vec::new(),
    };
    picture.select_layers(&layer).expect("the layer is there");
    let washers = drawing(&washers(400));
    let traced = drawing(&traced_circle());
    for (name, drawing, tool_mm) in [
        ("the picture of the plate", &picture, 0.3),
        ("400 washers", &washers, 1.0),
        ("a traced circle", &traced, 2.0),
    ] {
        group.throughput(Throughput::Elements(drawing.paths.len() as u64));
        for clearing in [Clearing::Contour, Clearing::Zigzag, Clearing::OneWay] {
            let options = Options {
                operation: Operation::Pocket,
                clearing,
                tool_mm,
                step_mm: tool_mm,
                ..Options::default()
            };
            group.bench_function(format!("clear {name}, {clearing:?}"), |bencher| {
                bencher.iter(|| plan(black_box(drawing), &options).expect("a pocket"))
            });
        }
    }
    group.finish();
}

criterion_group!(benches, benchmarks);
criterion_main!(benches);
