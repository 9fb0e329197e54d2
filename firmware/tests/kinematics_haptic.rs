//! The haptic arm against the golden table of docs/control.md 7.2, against f64 geometry, and
//! against virtual work; and how far a hand moves before a faulty encoder is detected.
#![allow(
    clippy::needless_range_loop,
    reason = "an index is an axis here, of several arrays at once"
)]

use crate::arm;
use arm::{
    PER_MM, PER_RADIAN, Sequence, V, add, apply, cross, dot, inverse, norm, random_pose, readings,
    rotation, scaled, sub,
};
use haptimill_kinematics::haptic_arm::statics::Wrench;
use haptimill_kinematics::haptic_arm::{ArmError, ArmPose, HapticArm, HapticGeometry};
use haptimill_math::{Angle, Length};
use nalgebra::Matrix6;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

const LIMIT: f32 = 100.0;
const Q30: f64 = 1_073_741_824.0;

fn millimetres(vector: [i32; 3]) -> V {
    vector.map(|part| f64::from(part) / PER_MM)
}

fn direction(vector: [i32; 3]) -> V {
    vector.map(|part| f64::from(part) / Q30)
}

#[test]
fn the_golden_table() {
    let arm = HapticArm::new(&arm::reference());
    let text = include_str!("../../tests/golden/haptic.csv");
    let (mut rows, mut worst) = (0, [0.0_f64; 4]);
    for line in text.lines().skip(1) {
        let row: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        assert_eq!(row.len(), 33);
        let legs = [0, 1, 2].map(|j| [row[3 * j], row[3 * j + 1], row[3 * j + 2]]);
        let pose = arm.pose(&readings(legs)).expect("a pose");
        let (centre, tip) = (millimetres(pose.centre), millimetres(pose.tip));
        for k in 0..3 {
            worst[0] = worst[0]
                .max((centre[k] - row[9 + k]).abs())
                .max((tip[k] - row[21 + k]).abs());
            for axis in 0..3 {
                let entry = direction(pose.axes[axis])[k];
                worst[1] = worst[1].max((entry - row[12 + 3 * k + axis]).abs());
            }
        }
        let force = [row[24] as f32, row[25] as f32, row[26] as f32];
        let wrench = Wrench {
            force,
            moment: [0.0; 3],
        };
        let efforts = arm.efforts(&pose, &wrench, LIMIT).expect("regular");
        for j in 0..3 {
            worst[2] = worst[2].max((f64::from(efforts[j][0]) - row[27 + 2 * j]).abs());
            worst[3] = worst[3].max((f64::from(efforts[j][1]) - row[28 + 2 * j]).abs());
        }
        rows += 1;
    }
    println!(
        "{rows} rows; worst: {:.2e} mm, {:.2e} rad, {:.2e} N, {:.2e} N mm",
        worst[0], worst[1], worst[2], worst[3]
    );
    assert_eq!(rows, 500);
    // Required: 1 um, 3 urad, 1 mN, 0.1 N mm. Stated by the kinematics: 20 nm, 50 nrad.
    assert!(worst[0] < 2e-5 && worst[1] < 5e-8, "{worst:?}");
    assert!(worst[2] < 1e-5 && worst[3] < 2e-3, "{worst:?}");
}

#[test]
fn the_printed_values_of_the_reference_arm() {
    let arm = HapticArm::new(&arm::reference());
    let home = inverse([0.0, 0.0, 450.0], rotation([0.0, 0.0, 1.0], 0.0)).expect("home");
    assert!(
        (home[0][0] - 295.3295).abs() < 1e-4 && (home[0][2].to_degrees() - 43.7876).abs() < 1e-4
    );
    let pose = arm.pose(&readings(home)).expect("a pose");
    assert_eq!(
        pose.centre
            .map(|part| (f64::from(part) / PER_MM * 1e5).round()),
        [0.0, 0.0, 450e5]
    );
    assert_eq!(
        pose.tip
            .map(|part| (f64::from(part) / PER_MM * 1e5).round()),
        [0.0, 0.0, 600e5]
    );
    let wrench = Wrench {
        force: [3.2, 0.0, 1.2],
        moment: [0.0; 3],
    };
    let efforts = arm.efforts(&pose, &wrench, LIMIT).expect("regular");
    for (effort, torque) in efforts.iter().zip([0.0, -255.69, 255.69]) {
        assert!(
            (effort[0] - 0.2973).abs() < 1e-4 && (effort[1] - torque).abs() < 1e-2,
            "{efforts:?}"
        );
    }
}

/// The pose of a proptest case, displaced by a small twist about the centre.
fn displaced(centre: V, turn: arm::M, velocity: V, spin: V, by: f64) -> Option<[[f64; 3]; 3]> {
    let angle = norm(spin) * by;
    let turned = if angle == 0.0 {
        turn
    } else {
        arm::times(rotation(spin, angle), turn)
    };
    inverse(add(centre, scaled(velocity, by)), turned)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    /// The work of the motors is the work at the handle, whichever way it moves: rates of the
    /// joints by differences of the inverse geometry.
    #[test]
    fn virtual_work_balances(
        seed in 1_u64..u64::MAX,
        force in prop::array::uniform3(-5.0_f64..5.0), moment in prop::array::uniform3(-200.0_f64..200.0),
        velocity in prop::array::uniform3(-1.0_f64..1.0), spin in prop::array::uniform3(-0.02_f64..0.02),
    ) {
        let (centre, turn) = random_pose(&mut Sequence(seed));
        let step = 1e-3;
        let (Some(here), Some(before), Some(after)) = (
            inverse(centre, turn), displaced(centre, turn, velocity, scaled(spin, -1.0), -step).and(displaced(centre, turn, scaled(velocity, -1.0), scaled(spin, -1.0), step)),
            displaced(centre, turn, velocity, spin, step),
        ) else { return Ok(()) };
        let arm = HapticArm::new(&arm::reference());
        let pose = arm.pose(&readings(here)).expect("a pose");
        let wrench = Wrench { force: force.map(|x| x as f32), moment: moment.map(|x| x as f32) };
        let efforts = arm.efforts(&pose, &wrench, LIMIT).expect("regular");
        let commanded = dot(force, velocity) + dot(moment, spin);
        let (mut done, mut terms) = (0.0, dot(force, velocity).abs() + dot(moment, spin).abs());
        for j in 0..3 {
            for (k, joint) in [(0, 0), (1, 1)] {
                let rate = (after[j][joint] - before[j][joint]) / (2.0 * step);
                done += f64::from(efforts[j][k]) * rate;
                terms += (f64::from(efforts[j][k]) * rate).abs();
            }
        }
        prop_assert!((done - commanded).abs() <= 1e-4 * terms, "{done} {commanded} {terms}");
    }

    /// No reading makes it panic, and what it calls a pose is one: joints 5 are where f64 puts them
    /// and the axes are orthonormal.
    #[test]
    fn any_reading_gives_a_pose_or_an_error(slides: [i32; 3], turns: [i32; 3], leans: [i32; 3]) {
        let arm = HapticArm::new(&arm::reference());
        let legs = core::array::from_fn(|j| haptimill_kinematics::haptic_arm::LegReading {
            slide: Length(slides[j]), turn: Angle(turns[j]), hinge: Angle(leans[j]),
        });
        if let Ok(pose) = arm.pose(&legs) {
            orthonormal(&pose)?;
            let _ = arm.efforts(&pose, &Wrench::default(), LIMIT);
        }
    }

    /// With errors of the readings within the tolerance of the sides, the result is a rotation
    /// within the tolerance of the true one.
    #[test]
    fn noisy_readings_give_a_rotation(seed in 1_u64..u64::MAX) {
        let mut sequence = Sequence(seed);
        let (centre, turn) = random_pose(&mut sequence);
        let Some(mut legs) = inverse(centre, turn) else { return Ok(()) };
        for leg in &mut legs {
            for (k, reading) in leg.iter_mut().enumerate() {
                *reading += sequence.between(-1.0, 1.0) * if k == 0 { 0.1 } else { 5e-4 };
            }
        }
        let arm = HapticArm::new(&arm::reference());
        if let Ok(pose) = arm.pose(&readings(legs)) {
            orthonormal(&pose)?;
            let (n, truth) = (direction(pose.axes[0]), turn.map(|row| row[0]));
            prop_assert!(norm(cross(n, truth)) < 0.008);
        }
    }
}

fn orthonormal(pose: &ArmPose) -> Result<(), TestCaseError> {
    let [n, o, a] = pose.axes.map(direction);
    for (x, y, want) in [
        (n, n, 1.0),
        (o, o, 1.0),
        (a, a, 1.0),
        (n, o, 0.0),
        (o, a, 0.0),
        (a, n, 0.0),
    ] {
        prop_assert!((dot(x, y) - want).abs() < 5e-8, "{x:?} {y:?}");
    }
    prop_assert!(norm(sub(cross(n, o), a)) < 5e-8);
    Ok(())
}

/// B of (3.41) in f64 from the loop-closure geometry, moments divided by r_p.
fn matrix(centre: V, turn: arm::M) -> Option<[[f64; 6]; 6]> {
    let legs = inverse(centre, turn)?;
    let mut b = [[0.0; 6]; 6];
    for j in 0..3 {
        let frame = arm::times(
            rotation([0.0, 0.0, 1.0], j as f64 * std::f64::consts::TAU / 3.0),
            rotation([0.0, 1.0, 0.0], -std::f64::consts::PI / 6.0),
        );
        let [_, t3, t4] = legs[j];
        let link = apply(
            frame,
            [
                libm::cos(t3) * libm::sin(t4),
                libm::sin(t3) * libm::sin(t4),
                libm::cos(t4),
            ],
        );
        let across = apply(frame, [libm::sin(t3), -libm::cos(t3), 0.0]);
        let out = apply(
            turn,
            apply(
                rotation([0.0, 0.0, 1.0], j as f64 * std::f64::consts::TAU / 3.0),
                [-1.0, 0.0, 0.0],
            ),
        );
        for (k, push) in [scaled(link, -1.0), across].into_iter().enumerate() {
            b[2 * j + k][..3].copy_from_slice(&cross(push, out));
            b[2 * j + k][3..].copy_from_slice(&push);
        }
    }
    Some(b)
}

/// Condition number, by singular values.
fn condition(b: &[[f64; 6]; 6]) -> f64 {
    let values = Matrix6::from(*b).singular_values();
    values.max() / values.min().max(1e-300)
}

/// The guard refuses whatever has a condition above its limit, all the way to the singularity, and
/// nothing in the workspace.
#[test]
fn condition_number_limit_is_enforced() {
    let arm = HapticArm::new(&arm::reference());
    let mut sequence = Sequence(7);
    let (mut worst, mut bound_worst, mut refused, mut ratio) = (0.0_f64, 0.0_f64, 0, 0.0_f64);
    let bound = |pose: &ArmPose| {
        // The bound itself is reported when nothing is allowed.
        let singular = arm
            .efforts(pose, &Wrench::default(), 0.0)
            .expect_err("limit 0");
        f64::from(singular.condition)
    };
    for _ in 0..3000 {
        let (centre, turn) = random_pose(&mut sequence);
        let (Some(b), Some(legs)) = (matrix(centre, turn), inverse(centre, turn)) else {
            continue;
        };
        let pose = arm.pose(&readings(legs)).expect("a pose");
        let (true_one, bound) = (condition(&b), bound(&pose));
        assert!(bound >= true_one, "{bound} {true_one}");
        worst = worst.max(true_one);
        bound_worst = bound_worst.max(bound);
        ratio = ratio.max(bound / true_one);
    }
    println!(
        "workspace: condition to {worst:.2}, bound to {bound_worst:.1}, at most {ratio:.1} times too large"
    );
    assert!(worst < 4.7 && bound_worst < 60.0);
    // Between the two signs of the determinant is a singular pose: approach it by
    // halves.
    let determinant = |(centre, axis, angle): (V, V, f64)| {
        let (b, legs) = (
            matrix(centre, rotation(axis, angle))?,
            inverse(centre, rotation(axis, angle))?,
        );
        Some((
            b,
            Matrix6::from(b).determinant(),
            arm.pose(&readings(legs)).ok()?,
        ))
    };
    while refused < 300 {
        let mut wide = |size: f64| [0; 3].map(|_| sequence.between(-size, size));
        let mut ends = [
            (add([0.0, 0.0, 450.0], wide(40.0)), wide(1.0), 0.0),
            (add([0.0, 0.0, 420.0], wide(150.0)), wide(1.0), 1.2),
        ];
        let (Some(first), Some(second)) = (determinant(ends[0]), determinant(ends[1])) else {
            continue;
        };
        if (first.1 > 0.0) == (second.1 > 0.0) {
            continue;
        }
        for _ in 0..40 {
            let middle = (
                scaled(add(ends[0].0, ends[1].0), 0.5),
                scaled(add(ends[0].1, ends[1].1), 0.5),
                (ends[0].2 + ends[1].2) / 2.0,
            );
            let Some((b, sign, pose)) = determinant(middle) else {
                break;
            };
            let (condition, bound) = (condition(&b), bound(&pose));
            // f32 near the singularity: the determinant has a relative error of some 1e-6 times the
            // condition.
            assert!(bound >= condition.min(1e4) * 0.98, "{bound} {condition}");
            if condition >= f64::from(LIMIT) * 1.02 {
                let push = Wrench {
                    force: [1.0; 3],
                    moment: [0.0; 3],
                };
                assert!(arm.efforts(&pose, &push, LIMIT).is_err());
                refused += 1;
            }
            ends[usize::from((sign > 0.0) != (first.1 > 0.0))] = middle;
        }
    }
    println!("{refused} poses near the singularity refused");
}

/// A jump, a stuck and a reversed encoder, each of the nine: found by the sides of the platform,
/// with the leg named. How far hand and joint moved until then.
#[test]
fn wrong_arm_encoder_is_detected() {
    let geometry: HapticGeometry = arm::reference();
    let arm = HapticArm::new(&geometry);
    let mut sequence = Sequence(11);
    let home = inverse([0.0, 0.0, 450.0], rotation([0.0, 0.0, 1.0], 0.0)).expect("home");
    // [kind][sensor]: worst travel of the joint itself and of the hand until it is found.
    let mut travel = [[0.0_f64; 3]; 2];
    let mut hand = [[0.0_f64; 3]; 2];
    let (mut named, mut found, mut silent) = (0, 0, 0);
    for run in 0..900 {
        let (kind, sensor, leg) = (run % 2, (run / 2) % 3, (run / 6) % 3);
        let (goal, turn_axis) = (random_pose(&mut sequence).0, random_pose(&mut sequence).0);
        let angle = sequence.between(-0.3, 0.3);
        let mut discovered = false;
        for step in 0..=400 {
            let part = f64::from(step) / 400.0;
            let centre = add(
                [0.0, 0.0, 450.0],
                scaled(sub(goal, [0.0, 0.0, 450.0]), part),
            );
            let turn = rotation(turn_axis, angle * part);
            let Some(mut legs) = inverse(centre, turn) else {
                break;
            };
            let moved = legs[leg][sensor] - home[leg][sensor];
            legs[leg][sensor] = if kind == 0 {
                home[leg][sensor]
            } else {
                home[leg][sensor] - moved
            };
            if let Err(error) = arm.pose(&readings(legs)) {
                found += 1;
                discovered = true;
                if let ArmError::Side { leg: blamed, .. } = error {
                    named += usize::from(usize::from(blamed) == leg);
                }
                travel[kind][sensor] = travel[kind][sensor].max(moved.abs());
                hand[kind][sensor] = hand[kind][sensor].max(norm(sub(centre, [0.0, 0.0, 450.0])));
                break;
            }
        }
        silent += usize::from(!discovered);
    }
    println!("found {found}, leg named in {named}, never left the tolerance {silent}");
    println!(
        "stuck: joint travel d {:.2} mm, theta3 {:.2} mrad, theta4 {:.2} mrad; hand {:?}",
        travel[0][0],
        travel[0][1] * 1e3,
        travel[0][2] * 1e3,
        hand[0]
    );
    println!(
        "reversed: d {:.2} mm, theta3 {:.2} mrad, theta4 {:.2} mrad; hand {:?}",
        travel[1][0],
        travel[1][1] * 1e3,
        travel[1][2] * 1e3,
        hand[1]
    );
    assert!(
        travel[0][0] < 3.0 && travel[0][1] < 0.012 && travel[0][2] < 0.012,
        "{travel:?}"
    );
    assert!(
        travel[1][0] < 1.6 && travel[1][1] < 0.006 && travel[1][2] < 0.006,
        "{travel:?}"
    );
    assert!(named * 100 >= found * 97 && silent * 50 < found);
    // A jump, anywhere in the workspace: at once, from 3 mm of d or 12 mrad.
    for run in 0..900 {
        let (sensor, leg) = (run % 3, (run / 3) % 3);
        let (centre, turn) = random_pose(&mut sequence);
        let Some(mut legs) = inverse(centre, turn) else {
            continue;
        };
        let by = if sensor == 0 { 3.0 } else { 0.012 };
        legs[leg][sensor] += if sequence.unit() < 0.5 { by } else { -by };
        assert!(
            arm.pose(&readings(legs)).is_err(),
            "sensor {sensor} of leg {leg}"
        );
    }
}

#[test]
fn geometry_out_of_range_is_refused() {
    let sound = arm::reference();
    assert!(sound.is_sound());
    let with = |change: fn(&mut HapticGeometry)| {
        let mut geometry = sound;
        change(&mut geometry);
        geometry.is_sound()
    };
    assert!(!with(|g| g.link = Length::millimetres(401)));
    assert!(!with(|g| g.platform_radius = Length::millimetres(9)));
    assert!(!with(|g| g.tilt = Angle::degrees(81)));
    assert!(!with(|g| g.tip[1] = Length::millimetres(-401)));
    assert!(!with(|g| g.side_tolerance = Length::ZERO));
    let _ = PER_RADIAN;
}
