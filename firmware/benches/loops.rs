//! One control period of five joints: sense and drive.

use criterion::{Criterion, criterion_group, criterion_main};
use haptimill_firmware::config::{
    AxisKind, Drive, EncoderSettings, Home, JointSettings, ServoConfig, ServoForm,
};
use haptimill_firmware::io::{DriveCommand, JointInputs};
use haptimill_firmware::joint::JointDrive;
use haptimill_math::{Acceleration, Coordinate, Effort, Gain, Rate};
use std::hint::black_box;

/// A 40 kg slide on a 10 mm screw with 8000 counts a turn.
fn slide(drive: Drive) -> JointSettings {
    JointSettings {
        kind: AxisKind::Linear,
        low: Coordinate(0),
        high: Coordinate(i32::MAX),
        rate: Rate(60 << 20),
        backlash: Coordinate(10_486),
        backlash_table: Default::default(),
        drive,
        law: ServoConfig {
            form: ServoForm::ModelBased,
            kp: Gain(40_000 << 8),
            kd: Gain(400 << 8),
            rate_filter_us: 1500,
            inertia: 671_089,
            viscous: 10_000,
            coulomb: Effort(32 << 16),
            coulomb_rate: Rate(104_858),
            ki: Gain(0),
            friction_adaptation_ms: 0,
        },
        preset: Coordinate(0),
        home: Home::Index,
        encoder: Some(EncoderSettings {
            per_count: 21_990_232_556,
            following: Coordinate(1 << 18),
            following_lag: 0,
            stuck_distance: Coordinate(1 << 17),
            index: Coordinate(0),
            index_pitch: Coordinate(10 << 20),
            index_slack: 4,
            search: Coordinate(0),
        }),
        active_low: 0,
        keeps_position: false,
        gantry: None,
    }
}

/// Moves five joints back and forth at 4 mm/s, with their encoders following a count behind.
fn period(bencher: &mut Criterion, name: &str, servo: &Drive) {
    let settings = slide(servo.clone());
    let Ok(joint) = JointDrive::new(&settings, 200) else {
        return;
    };
    let mut joints = [
        joint.clone(),
        joint.clone(),
        joint.clone(),
        joint.clone(),
        joint,
    ];
    let mut inputs = JointInputs::default();
    let mut command = DriveCommand::Off;
    for joint in &mut joints {
        joint.measure(&inputs, 0);
        joint.enable();
    }
    let (mut time, mut place, mut rate) = (0u32, 0i32, 4 << 20);
    bencher.bench_function(name, |bencher| {
        bencher.iter(|| {
            time = time.wrapping_add(200_000);
            place += rate / 5000;
            if place.abs() > 50 << 20 {
                rate = -place.signum() * (4 << 20);
            }
            let counts = place / 1311;
            if counts != inputs.counts {
                inputs.counts = counts;
                inputs.edge_time_ns = time.wrapping_sub(50_000);
            }
            for joint in &mut joints {
                black_box(joint.measure(black_box(&inputs), time).coordinate);
                let (coordinate, rate) = black_box((Coordinate(place), Rate(rate)));
                black_box(joint.servo(coordinate, rate, Acceleration(0), &mut command));
            }
        });
    });
}

fn loops(criterion: &mut Criterion) {
    let torque = Drive::Torque {
        full_scale: Effort(1000 << 16),
        limit: Effort(800 << 16),
    };
    period(criterion, "period of 5 torque joints", &torque);
    let steps = Drive::Steps {
        per_step: 54_975_581_389,
        ticks_per_us: 72,
        pulse: 144,
        setup: 360,
        hold: 360,
        lost: Coordinate(1 << 18),
        chip: None,
    };
    period(criterion, "period of 5 step/dir joints", &steps);
}

criterion_group!(benches, loops);
criterion_main!(benches);
