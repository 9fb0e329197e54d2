//! Time of one pose through the kinematics of the H-4 arm and of the faceting machine, and of the
//! functions they are made of.
//!
//! Each figure is the mean over an array of varied arguments, so neither a branch predictor
//! nor a cache learns the sequence.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use haptimill_kinematics::facet::chain::{Chain, ChainJoints};
use haptimill_kinematics::facet::{Facet, FacetGeometry};
use haptimill_kinematics::h4::H4;
use haptimill_kinematics::h4::H4Geometry;
use haptimill_kinematics::{Accelerations, Joints, Kinematics, Machine, Pose, Rates};
use haptimill_math::root::isqrt;
use haptimill_math::trig::{atan2, sin_cos};
use haptimill_math::{Acceleration, Angle, Coordinate, Length, Rate};
use std::hint::black_box;

/// How many arguments a round has.
const COUNT: usize = 1024;

/// A reproducible sequence (splitmix64).
struct Sequence(u64);

impl Sequence {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// From -size to size.
    fn within(&mut self, size: i32) -> i32 {
        ((self.next() % (2 * size as u64 + 1)) as i64 - i64::from(size)) as i32
    }
}

fn arm() -> H4 {
    H4::new(&H4Geometry {
        lateral: Length::millimetres(250),
        half_spacing: Length::millimetres(100),
        half_height: Length::millimetres(100),
        joint_offset: Length::millimetres(50),
        rod: Length::millimetres(480),
        rail_offset: Length::millimetres(25),
        tool: Length::millimetres(150),
        x_offset: Length::millimetres(810),
        y_offset: Length::ZERO,
        z_offset: Length::ZERO,
        table_height: Length::millimetres(600),
        below: true,
        singularity_margin: Length::millimetres(5),
    })
}

/// Poses all over the workspace that the arm can take: +-100 mm, theta and alpha +-30 degrees.
fn poses(arm: &H4) -> Vec<Pose> {
    let mut sequence = Sequence(1);
    let mut poses = Vec::with_capacity(COUNT);
    while poses.len() < COUNT {
        let mut pose = Pose::default();
        for coordinate in &mut pose.0[..3] {
            *coordinate = Coordinate(sequence.within(100 << 20));
        }
        for coordinate in &mut pose.0[3..5] {
            *coordinate = Coordinate(sequence.within(Angle::degrees(30).0));
        }
        if arm.inverse(&pose).is_ok() {
            poses.push(pose);
        }
    }
    poses
}

fn kinematics(criterion: &mut Criterion) {
    let arm = arm();
    let poses = poses(&arm);
    let joints: Vec<Joints> = poses
        .iter()
        .map(|pose| arm.inverse(pose).unwrap())
        .collect();
    let mut sequence = Sequence(2);
    let rates: Vec<Rates> = poses
        .iter()
        .map(|_| std::array::from_fn(|_| Rate(sequence.within(50 << 20))))
        .collect();
    let accelerations: Vec<Accelerations> = poses
        .iter()
        .map(|_| std::array::from_fn(|_| Acceleration(sequence.within(1000 << 12))))
        .collect();

    let mut group = criterion.benchmark_group("kinematics");
    group.throughput(Throughput::Elements(COUNT as u64));
    group.bench_function("inverse", |bencher| {
        bencher.iter(|| {
            for pose in &poses {
                let _ = black_box(arm.inverse(black_box(pose)));
            }
        });
    });
    group.bench_function("forward", |bencher| {
        bencher.iter(|| {
            for joints in &joints {
                let _ = black_box(arm.forward(black_box(joints)));
            }
        });
    });
    group.bench_function("inverse_motion", |bencher| {
        bencher.iter(|| {
            for ((pose, rates), accelerations) in poses.iter().zip(&rates).zip(&accelerations) {
                let _ = black_box(arm.inverse_motion(black_box(pose), rates, accelerations));
            }
        });
    });
    group.finish();
}

/// The faceting machine over all quadrants: its pose, and the chain with the residuals of a frame.
fn facet(criterion: &mut Criterion) {
    let geometry = FacetGeometry {
        l2: Length::millimetres(280),
        l3: Length::millimetres(24),
        l4: Length::millimetres(166),
        z_lap: Length::millimetres(40),
        lap_in_z: false,
        theta2_zero: Angle::HALF,
    };
    let (machine, chain) = (Facet::new(&geometry), Chain::new(&geometry));
    let mut sequence = Sequence(4);
    let mut random = |size: i32| Coordinate(sequence.within(size));
    let poses: Vec<Pose> = (0..COUNT)
        .map(|_| {
            let [x, y, z] = [100, 20, 100].map(|mm| random(mm << 20));
            let [angle, index] = [(); 2].map(|()| random(i32::MAX));
            Pose([x, y, z, angle, index, Coordinate::ZERO])
        })
        .collect();
    let inverse = |pose| machine.inverse(pose).unwrap();
    let joints: Vec<Joints> = poses.iter().map(inverse).collect();
    let links: Vec<ChainJoints> = joints.iter().map(|at| machine.chain(at)).collect();
    let frames: Vec<_> = links.iter().map(|at| chain.forward(at).unwrap()).collect();

    let mut group = criterion.benchmark_group("facet");
    group.throughput(Throughput::Elements(COUNT as u64));
    group.bench_function("inverse", |bencher| {
        bencher.iter(|| {
            for pose in &poses {
                let _ = black_box(machine.inverse(black_box(pose)));
            }
        });
    });
    group.bench_function("forward", |bencher| {
        bencher.iter(|| {
            for joints in &joints {
                let _ = black_box(machine.forward(black_box(joints)));
            }
        });
    });
    group.bench_function("chain_forward", |bencher| {
        bencher.iter(|| {
            for links in &links {
                let _ = black_box(chain.forward(black_box(links)));
            }
        });
    });
    group.bench_function("chain_inverse", |bencher| {
        bencher.iter(|| {
            for frame in &frames {
                let _ = black_box(chain.inverse(black_box(frame)));
            }
        });
    });
    group.finish();
}

fn functions(criterion: &mut Criterion) {
    let mut sequence = Sequence(3);
    let words: Vec<i32> = (0..COUNT).map(|_| sequence.next() as i32).collect();
    let wide: Vec<u64> = (0..COUNT)
        .map(|_| sequence.next() >> (sequence.next() % 40))
        .collect();

    let mut group = criterion.benchmark_group("functions");
    group.throughput(Throughput::Elements(COUNT as u64));
    group.bench_function("sin_cos", |bencher| {
        bencher.iter(|| {
            for &word in &words {
                black_box(sin_cos(Angle(black_box(word))));
            }
        });
    });
    group.bench_function("atan2", |bencher| {
        bencher.iter(|| {
            for pair in words.windows(2) {
                black_box(atan2(black_box(pair[0]), pair[1]));
            }
        });
    });
    group.bench_function("isqrt", |bencher| {
        bencher.iter(|| {
            for &square in &wide {
                black_box(isqrt(black_box(square)));
            }
        });
    });
    group.finish();
}

criterion_group!(benches, kinematics, facet, functions);
criterion_main!(benches);
