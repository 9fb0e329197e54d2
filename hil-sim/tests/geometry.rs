//! The arm's geometry against its closed loops and against the reference table of REF-G.

use haptimill_hil_sim::machines::Geometry;
use haptimill_hil_sim::machines::h4::{Arm, H4, Tip};
use haptimill_hil_sim::machines::h4::{ArmGeometry, Branch};
use proptest::prelude::*;

const HOME: [f64; 4] = [1135.0, 485.0, 1135.0, 485.0];

fn reference() -> ArmGeometry {
    ArmGeometry {
        a: 400.0,
        b: 100.0,
        c: 100.0,
        d: 100.0,
        e: 50.0,
        w: 50.0,
        r: 480.0,
        ge: 25.0,
        tl: 150.0,
        p: 30.0,
        h: 600.0,
        x_off: 780.0,
        y_off: 0.0,
        z_off: 0.0,
        branch: Branch::Below,
    }
}

/// Moves from home to `slides` in small steps, as a machine does.
fn walk(arm: &mut Arm, slides: &[f64; 4]) -> Tip {
    let mut tip = Tip::default();
    for step in 1..=100 {
        let part = f64::from(step) / 100.0;
        let at: [f64; 4] = std::array::from_fn(|i| HOME[i] + part * (slides[i] - HOME[i]));
        tip = arm.follow(&at).expect("closes");
    }
    tip
}

/// Lengths of the four rods, calculated from the drawing alone.
fn rods(tip: &Tip, slides: &[f64; 4]) -> [f64; 4] {
    let g = reference();
    let theta = tip.sin_theta.asin();
    let platform = |along: f64, side: f64| {
        [
            tip.x + along * theta.sin(),
            tip.y + side * g.b,
            tip.z + along * theta.cos(),
        ]
    };
    let upper = g.tl + 2.0 * g.c;
    let ends = [
        (
            [slides[0] - g.w, g.a - g.e, g.d - g.ge],
            platform(upper, 1.0),
        ),
        (
            [slides[1] + g.w, g.a - g.e, g.d - g.ge],
            platform(upper, 1.0),
        ),
        (
            [slides[2] - g.w, -(g.a - g.e), -g.d - g.ge],
            platform(g.tl, -1.0),
        ),
        (
            [slides[3] + g.w, -(g.a - g.e), -g.d - g.ge],
            platform(g.tl, -1.0),
        ),
    ];
    ends.map(|(slide, joint)| {
        (0..3)
            .map(|k| (slide[k] - joint[k]) * (slide[k] - joint[k]))
            .sum::<f64>()
            .sqrt()
    })
}

#[test]
fn forward_kinematics_match_the_reference_table() {
    // docs/control.md 7.2: x_w, y_w, z_w, theta, alpha, and the slides.
    let table = [
        (
            [0.0, 0.0, 21.232, 0.0, 0.0],
            [1135.000004, 484.999996, 1135.000004, 484.999996],
        ),
        (
            [-30.0, 0.0, 21.232, 0.0, 0.0],
            [1105.000004, 454.999996, 1105.000004, 454.999996],
        ),
        (
            [-15.0, 15.0, 19.232, 0.0, 0.0],
            [1130.798758, 459.201242, 1103.226509, 486.773491],
        ),
        (
            [10.0, -5.0, 40.0, 10.0, 0.0],
            [1215.541455, 546.012270, 1192.435266, 499.659187],
        ),
        (
            [10.0, -5.0, 40.0, 0.0, 15.0],
            [1148.085804, 491.914196, 1174.161314, 465.838686],
        ),
        (
            [-20.0, 12.0, 60.0, -12.0, 20.0],
            [1065.760027, 368.701790, 1126.184311, 391.442182],
        ),
    ];
    for (pose, slides) in table {
        let mut arm = Arm::new(&reference(), &HOME).expect("home");
        let tip = walk(&mut arm, &slides);
        let work = arm.in_work(&tip, pose[4]);
        for k in 0..5 {
            assert!(
                (work[k] - pose[k]).abs() < 1e-5,
                "{slides:?}: coordinate {k} is {} not {}",
                work[k],
                pose[k]
            );
        }
    }
}

#[test]
fn home_pose_and_base_frame_are_as_defined() {
    let mut arm = Arm::new(&reference(), &HOME).expect("home");
    for (slides, x, y, z, theta) in [
        (HOME, 810.0, 0.0, -578.768004, 0.0),
        (
            [1120.0, 480.0, 1110.0, 470.0],
            782.5,
            0.154207,
            -582.907941,
            2.865984,
        ),
        (
            [1150.0, 470.0, 1130.0, 500.0],
            818.75,
            13.912619,
            -575.827061,
            -1.432544,
        ),
    ] {
        let tip = arm.follow(&slides).expect("closes");
        assert!((tip.x - x).abs() < 1e-6);
        assert!((tip.y - y).abs() < 1e-6);
        assert!((tip.z - z).abs() < 1e-6);
        assert!((tip.sin_theta.asin().to_degrees() - theta).abs() < 1e-6);
    }
}

#[test]
fn the_other_assembly_branch_is_the_mirror_image() {
    // With d = c the rails are symmetric at theta = 0: the mirror image of z_c + g_e.
    let mut above = Arm::new(
        &ArmGeometry {
            branch: Branch::Above,
            ..reference()
        },
        &HOME,
    )
    .expect("home");
    let mut below = Arm::new(&reference(), &HOME).expect("home");
    let (high, low) = (
        above.follow(&HOME).expect("closes"),
        below.follow(&HOME).expect("closes"),
    );
    let middle = |tip: &Tip| tip.z + 250.0 + 25.0;
    assert!((middle(&high) + middle(&low)).abs() < 1e-9);
    assert!(middle(&high) > 0.0);
}

#[test]
fn slides_without_a_pose_are_refused() {
    let mut arm = Arm::new(&reference(), &HOME).expect("home");
    // The slides move apart until the rods are too short.
    let mut refused = false;
    for step in 0..400 {
        let apart = f64::from(step);
        let slides = [1135.0 + apart, 485.0 - apart, 1135.0 + apart, 485.0 - apart];
        match arm.follow(&slides) {
            Ok(tip) => {
                assert!(!refused, "came back from where nothing closes");
                assert!(
                    rods(&tip, &slides)
                        .iter()
                        .all(|rod| (rod - 480.0).abs() < 1e-9)
                );
            }
            Err(_) => refused = true,
        }
    }
    assert!(refused);
    assert!(Arm::new(&reference(), &[1700.0, 0.0, 1700.0, 0.0]).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn loops_close_over_the_workspace(shift in -80.0..80.0_f64, open in prop::array::uniform2(-60.0..60.0_f64), tilt in -60.0..60.0_f64) {
        let slides = [
            HOME[0] + shift + tilt + open[0],
            HOME[1] + shift + tilt - open[0],
            HOME[2] + shift - tilt + open[1],
            HOME[3] + shift - tilt - open[1],
        ];
        let mut arm = Arm::new(&reference(), &HOME).expect("home");
        let tip = walk(&mut arm, &slides);
        for rod in rods(&tip, &slides) {
            prop_assert!((rod - 480.0).abs() < 1e-9, "rod {rod}");
        }
        prop_assert!(arm.residual(&tip, &slides) < 1e-9);
        // Built there from the slides alone, it is the same machine.
        let mut built = Arm::new(&reference(), &slides).expect("closes");
        let direct = built.follow(&slides).expect("closes");
        prop_assert!((direct.x - tip.x).abs() < 1e-9 && (direct.z - tip.z).abs() < 1e-8 && (direct.y - tip.y).abs() < 1e-8);
    }

    #[test]
    fn the_table_turns_the_workpiece_rigidly(alpha in -60.0..60.0_f64, dy in -50.0..50.0_f64, dz in -50.0..50.0_f64) {
        let arm = Arm::new(&reference(), &HOME).expect("home");
        let one = arm.in_work(&Tip { x: 800.0, y: 0.0, z: -560.0, sin_theta: 0.0 }, alpha);
        let other = arm.in_work(&Tip { x: 800.0, y: dy, z: -560.0 + dz, sin_theta: 0.0 }, alpha);
        let distance = (other[1] - one[1]).hypot(other[2] - one[2]);
        prop_assert!((distance - dy.hypot(dz)).abs() < 1e-9);
        // A step of the tool along z is a step towards +y of the workpiece when a positive alpha
        // tilts the table up.
        let up = arm.in_work(&Tip { x: 800.0, y: 0.0, z: -559.0, sin_theta: 0.0 }, alpha);
        prop_assert!((up[1] - one[1] - alpha.to_radians().sin()).abs() < 1e-9);
    }
}

/// Slides with rates at which the arm closes.
fn moving() -> impl Strategy<Value = ([f64; 4], [f64; 4], f64, f64)> {
    (
        prop::array::uniform4(-40.0..40.0_f64),
        prop::array::uniform4(-10.0..10.0_f64),
        -30.0..30.0_f64,
        -5.0..5.0_f64,
    )
        .prop_map(|(offsets, rates, alpha, turning)| {
            (
                std::array::from_fn(|i| HOME[i] + offsets[i]),
                rates,
                alpha,
                turning,
            )
        })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]

    /// Power balance: the power of the force at the tool equals that of the joint loads. The
    /// velocity is from differences of the closed loops, not from the Jacobian.
    #[test]
    fn joint_loads_balance_power(
        (slides, rates, alpha, turning) in moving(),
        force in prop::array::uniform3(-50.0..50.0_f64),
        above in 0.0..20.0_f64,
    ) {
        let mut arm = Arm::new(&reference(), &HOME).expect("an arm");
        walk(&mut arm, &slides);
        let step = 1e-4;
        let mut point = |side: f64| {
            let at: [f64; 4] = std::array::from_fn(|i| slides[i] + side * step * rates[i]);
            let tip = arm.follow(&at).expect("closes");
            let cos = (1.0 - tip.sin_theta * tip.sin_theta).sqrt();
            let raised = Tip {
                x: tip.x + above * tip.sin_theta,
                z: tip.z + above * cos,
                ..tip
            };
            arm.in_work(&raised, alpha + side * step * turning)
        };
        let (after, before) = (point(1.0), point(-1.0));
        let tip = arm.follow(&slides).expect("closes");
        let loads = arm.joint_loads(&tip, &slides, alpha, force, above).expect("regular");
        let (mut outside, mut inside) = (0.0, 0.0);
        for i in 0..3 {
            outside += force[i] * (after[i] - before[i]) / (2.0 * step);
        }
        for i in 0..4 {
            inside += loads[i] * rates[i];
        }
        // N m and degrees per second to N mm per second.
        inside += loads[4] * 1e3 * turning * std::f64::consts::PI / 180.0;
        let size: f64 = force.iter().map(|part| part.abs()).sum::<f64>() * 50.0;
        prop_assert!((outside - inside).abs() < 1e-5 * size + 1e-6, "{outside} {inside}");
    }

    /// Turning a vector into the base frame and back changes nothing, and agrees with the transform
    /// of positions.
    #[test]
    fn vectors_turn_like_positions(vector in prop::array::uniform3(-50.0..50.0_f64), alpha in -80.0..80.0_f64) {
        let [one, two, three, four] = HOME;
        let machine = H4::new(&reference(), &[one, two, three, four, 0.0, 0.0]).expect("a machine");
        let axes = machine.workpiece_axes(&[0.0, 0.0, 0.0, 0.0, alpha, 0.0]);
        let base: [f64; 3] = std::array::from_fn(|k| (0..3).map(|i| axes[i][k] * vector[i]).sum());
        for i in 0..3 {
            let again: f64 = (0..3).map(|k| axes[i][k] * base[k]).sum();
            prop_assert!((again - vector[i]).abs() < 1e-12);
        }
        let arm = Arm::new(&reference(), &HOME).expect("an arm");
        let origin = arm.in_work(&Tip::default(), alpha);
        let place = arm.in_work(
            &Tip { x: base[0], y: base[1], z: base[2], sin_theta: 0.0 },
            alpha,
        );
        for i in 0..3 {
            prop_assert!((place[i] - origin[i] - vector[i]).abs() < 1e-9);
        }
    }
}

/// At home the table of slide coordinates gives the Jacobian by hand (docs/control.md 7.2): f =
/// J^-T F.
#[test]
fn joint_loads_at_home_are_those_of_the_reference_jacobian() {
    let mut arm = Arm::new(&reference(), &HOME).expect("an arm");
    let tip = arm.follow(&HOME).expect("closes");
    let loads = arm
        .joint_loads(&tip, &HOME, 0.0, [12.0, 0.0, 0.0], 0.0)
        .expect("regular");
    // J^T f = F with the rows of dl/d(x, y, z, theta).
    let rows = [
        [1.0, 0.90909, 1.10461, 350.0],
        [1.0, -0.90909, -1.10461, 350.0],
        [1.0, -0.90909, 1.10461, 150.0],
        [1.0, 0.90909, -1.10461, 150.0],
    ];
    for force in [[12.0, 0.0, 0.0], [0.0, -7.0, 0.0], [0.0, 0.0, 5.0]] {
        let loads = arm
            .joint_loads(&tip, &HOME, 0.0, force, 0.0)
            .expect("regular");
        for (column, expected) in [force[0], force[1], force[2], 0.0].into_iter().enumerate() {
            let sum: f64 = (0..4).map(|i| rows[i][column] * loads[i]).sum();
            assert!((sum - expected).abs() < 2e-3, "{column}: {sum} {expected}");
        }
    }
    // Fx alone without a moment: the lower pair holds the tilt, the upper pair pulls back.
    assert!((loads[0] - loads[1]).abs() < 1e-6 && (loads[2] - loads[3]).abs() < 1e-6);
    assert!((loads.iter().take(4).sum::<f64>() - 12.0).abs() < 1e-6);
}
