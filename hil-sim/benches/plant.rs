//! Cost of one control period of the simulated machine.

use criterion::{Criterion, criterion_group, criterion_main};
use haptimill_firmware::io::{DriveCommand, HapticOutputs, Inputs, Outputs};
use haptimill_hil_sim::haptics::{HapticArm, HapticConfig};
use haptimill_hil_sim::machines::h4::{Arm, ArmGeometry};
use haptimill_hil_sim::operator::{OperatorConfig, ReferencePart, Trace, Trajectory};
use haptimill_hil_sim::{Control, Plant, PlantConfig, Rig, RigOptions};
use std::hint::black_box;

#[derive(serde::Deserialize)]
struct File {
    plant: PlantConfig,
}

fn config() -> PlantConfig {
    toml::from_str::<File>(include_str!("../tests/refg.toml"))
        .expect("a plant")
        .plant
}

fn plant(criterion: &mut Criterion) {
    let mut plant = Plant::new(&config(), 200).expect("a machine");
    let mut outputs = Outputs::default();
    let mut inputs = Inputs::default();
    let mut period = 0_u32;
    criterion.bench_function(
        "plant: one period, five torque axes, truth and latch",
        |bencher| {
            bencher.iter(|| {
                // All axes oscillate, so that friction, backlash and encoder edges are computed.
                let code = if (period >> 8) & 1 == 0 { 1000 } else { -1000 };
                period = period.wrapping_add(1);
                for axis in 0..5 {
                    outputs.joints[axis] = DriveCommand::Torque(code);
                }
                plant.advance(black_box(&outputs));
                plant.latch(&mut inputs);
                black_box(&inputs);
            });
        },
    );

    struct Shaken(u32);
    impl Control for Shaken {
        fn tick(&mut self, _: &Inputs, outputs: &mut Outputs) {
            self.0 = self.0.wrapping_add(1);
            let code = if (self.0 >> 8) & 1 == 0 { 1000 } else { -1000 };
            outputs.joints[..5].fill(DriveCommand::Torque(code));
            let _ = outputs.transmit.push(1);
        }
    }
    let options = RigOptions {
        baud: Some(115_200),
        ..RigOptions::default()
    };
    let mut rig = Rig::new(&config(), &options, Shaken(0)).expect("a rig");
    let mut received = Vec::new();
    criterion.bench_function("rig: one period, one byte each way", |bencher| {
        bencher.iter(|| {
            rig.host_write(&[0x55]);
            rig.step();
            received.clear();
            rig.host_read(&mut received);
            black_box(rig.truth());
        });
    });

    let mut haptic = HapticArm::new(&HapticConfig::default(), 200, 20, 1).expect("an arm");
    haptic
        .take(Some(&OperatorConfig::default()))
        .expect("a hand");
    let part = ReferencePart::default();
    haptic.clamp_part(Some(part.clone())).expect("a part");
    haptic.set_trajectory(Trajectory::Trace(Trace {
        at_s: 0.0,
        centre_mm: part.centre_mm,
        radius_mm: part.path_radius(),
        turns: 1e4,
        pace_mm_s: 5.0,
        ramp_s: 0.3,
        quarters: [1.0; 4],
        press_n: 2.0,
    }));
    criterion.bench_function(
        "haptic arm: one period, moved along the edge of a part",
        |bencher| {
            bencher.iter(|| {
                haptic.advance(black_box(&HapticOutputs::default()), true);
                black_box(haptic.inputs())
            });
        },
    );

    let slides = [1135.0, 485.0, 1135.0, 485.0];
    let mut arm = Arm::new(
        ArmGeometry::of(config().geometry.as_ref()).expect("an arm"),
        &slides,
    )
    .expect("an arm");
    let mut phase = 0.0;
    criterion.bench_function("geometry: true pose of moving slides", |bencher| {
        bencher.iter(|| {
            // 4 mm/s: 0.8 um per period.
            phase += 0.0008;
            let shift = if phase < 10.0 {
                phase
            } else if phase < 20.0 {
                20.0 - phase
            } else {
                0.0
            };
            if phase >= 20.0 {
                phase = 0.0;
            }
            let moved = [
                slides[0] + shift,
                slides[1] - 0.5 * shift,
                slides[2] + 0.3 * shift,
                slides[3],
            ];
            let tip = arm.follow(black_box(&moved)).expect("a pose");
            black_box(arm.in_work(&tip, shift))
        });
    });
}

criterion_group!(benches, plant);
criterion_main!(benches);
