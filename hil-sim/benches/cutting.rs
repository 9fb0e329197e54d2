//! Cost of the cut: one control period of 200 us in a slot, in a second pass, in the air, and with the body on the material.

use criterion::{Criterion, criterion_group, criterion_main};
use haptimill_hil_sim::cutting::{Cutting, CuttingConfig, ToolPose};
use std::hint::black_box;

const TURNS: f64 = 5000.0 / 60.0 * 200e-6;

/// To and fro along a line of 30 mm; with `aside` above 0 every pass lies so much further and finds fresh material.
struct Passes {
    cutting: Cutting,
    x: f64,
    y: f64,
    depth: f64,
    step: f64,
    aside: f64,
}

impl Passes {
    fn new(depth: f64, feed: f64, aside: f64) -> Self {
        let pose = ToolPose::upright([0.0, 0.0, 5.0]);
        Self {
            cutting: Cutting::new(&CuttingConfig::default(), &pose).expect("a mill"),
            x: 0.0,
            y: -15.0,
            depth,
            step: -feed * 200e-6,
            aside,
        }
    }

    fn step(&mut self, turns: f64) {
        self.x += self.step;
        if self.x < -50.0 || self.x > 0.0 {
            self.step = -self.step;
            self.y += self.aside;
            if self.y > 15.0 {
                // A new block.
                *self = Self::new(self.depth, self.step.abs() / 200e-6, self.aside);
            }
        }
        let pose = ToolPose::upright([self.x, self.y, -self.depth]);
        black_box(self.cutting.step(black_box(&pose), turns));
    }
}

fn cutting(criterion: &mut Criterion) {
    for (name, depth, feed, aside) in [
        ("slots, 2 mm deep, 4 mm/s", 2.0, 4.0, 8.0),
        ("slots, 5 mm deep, 10 mm/s", 5.0, 10.0, 8.0),
        ("pocket passes 2 mm aside, 2 mm deep, 4 mm/s", 2.0, 4.0, 2.0),
        (
            "second passes in the same slot, 2 mm deep, 4 mm/s",
            2.0,
            4.0,
            0.0,
        ),
        ("in the air, 10 mm/s", -1.0, 10.0, 0.0),
    ] {
        let mut passes = Passes::new(depth, feed, aside);
        criterion.bench_function(&format!("cutting: one period, {name}"), |bencher| {
            bencher.iter(|| passes.step(TURNS));
        });
    }
    let mut pressed = Passes::new(2.0, 4.0, 8.0);
    for _ in 0..20_000 {
        pressed.step(TURNS);
    }
    pressed.x -= 0.3;
    pressed.step = 0.0;
    criterion.bench_function(
        "cutting: one period, spindle stands in the material",
        |bencher| {
            bencher.iter(|| pressed.step(0.0));
        },
    );
}

criterion_group!(benches, cutting);
criterion_main!(benches);
