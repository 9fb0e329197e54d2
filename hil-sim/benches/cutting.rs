//! Cost of the cut: one control period of 200 us in a slot, in a second pass, in the air, and with
//! the shank on the material.

use criterion::{Criterion, criterion_group, criterion_main};
use haptimill_firmware::io::{DriveCommand, Outputs};
use haptimill_hil_sim::process::ProcessConfig;
use haptimill_hil_sim::process::sensor::SensorConfig;
use haptimill_hil_sim::process::structure::StructureConfig;
use haptimill_hil_sim::process::{Area, Cutting, CuttingConfig, ToolPose, WorkpieceConfig};
use haptimill_hil_sim::{Plant, PlantConfig};
use std::hint::black_box;

const TURNS: f64 = 5000.0 / 60.0 * 200e-6;

/// Back and forth along a line of 30 mm; with `aside` above 0 every pass is moved by that distance
/// into fresh material.
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
                // A new workpiece.
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

/// The whole machine in a slot at 4 mm/s; a position loop of the benchmark holds the slides.
fn machine(criterion: &mut Criterion) {
    #[derive(serde::Deserialize)]
    struct File {
        plant: PlantConfig,
    }
    let config = toml::from_str::<File>(include_str!("../tests/refg.toml"))
        .expect("a plant")
        .plant;
    let fresh = || {
        let mut plant = Plant::new(&config, 200).expect("a machine");
        let [x, y, z, ..] = plant.truth().pose;
        let around = |reach: f64| Area {
            x_min: x - reach,
            x_max: x + 5.0,
            y_min: y - 0.3 * reach,
            y_max: y + 0.3 * reach,
        };
        let workpiece = WorkpieceConfig {
            stock: Area {
                x_max: x - 4.0,
                ..around(90.0)
            },
            map: around(60.0),
            top_mm: z + 2.0,
            bottom_mm: z - 20.0,
            ..WorkpieceConfig::default()
        };
        let process = ProcessConfig {
            cutting: Some(CuttingConfig {
                workpiece,
                ..CuttingConfig::default()
            }),
            structure: Some(StructureConfig::default()),
            sensor: Some(SensorConfig::default()),
            ..ProcessConfig::default()
        };
        plant.fit(&process).expect("a process");
        let goal = plant.bodies().motor;
        (plant, goal, 0.0)
    };
    let (mut plant, mut goal, mut way) = fresh();
    let mut outputs = Outputs {
        spindle_rpm: 5000,
        ..Outputs::default()
    };
    criterion.bench_function(
        "plant: one period, slot 2 mm deep at 4 mm/s, structure, sensor",
        |bencher| {
            bencher.iter(|| {
                way += 4.0 * 200e-6;
                if way > 55.0 {
                    (plant, goal, way) = fresh();
                }
                for (axis, joint) in config.joint.iter().enumerate() {
                    let rate = if axis < 4 { -4.0 } else { 0.0 };
                    goal[axis] += rate * 200e-6;
                    let bodies = plant.bodies();
                    let effort = (25_600.0 * (goal[axis] - bodies.motor[axis])
                        + 320.0 * (rate - bodies.motor_rate[axis]))
                        * joint.inertia
                        / joint.kind.acceleration_unit();
                    let full = if axis < 4 { 800.0 } else { 40.0 };
                    outputs.joints[axis] = DriveCommand::Torque(
                        (effort / full * 8192.0).clamp(-8192.0, 8191.0) as i16,
                    );
                }
                plant.advance(black_box(&outputs));
                black_box(plant.force_codes())
            });
        },
    );
}

criterion_group!(benches, cutting, machine);
criterion_main!(benches);
