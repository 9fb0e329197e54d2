//! The H-4 arm beyond its poses: strokes, statics, distance from the singularity, and geometries
//! that make no arm.
#![allow(
    clippy::needless_range_loop,
    reason = "an index is an axis here, of several arrays at once"
)]

use haptimill_firmware::config::{
    AxisKind, Config, Drive, EncoderSettings, Home, Homing, JointSettings, ServoConfig, ServoForm,
    Stopping, Supervision,
};
use haptimill_firmware::motion::envelope::StoppingEnvelope;
use haptimill_kinematics::Model;
use haptimill_kinematics::h4::H4;
use haptimill_kinematics::h4::H4Geometry;
use haptimill_kinematics::h4::ToolForce;
use haptimill_kinematics::{Joints, Kinematics, Pose, PoseError};
use haptimill_math::{Acceleration, Angle, Coordinate, Effort, Gain, Length, Rate};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

const MM: i32 = Length::PER_MILLIMETRE;

/// REF-G of docs/control.md 7.2.
fn reference() -> H4Geometry {
    H4Geometry {
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
    }
}

/// A joint with a stroke; its drive does not matter here.
fn joint(kind: AxisKind, low: Coordinate, high: Coordinate) -> JointSettings {
    JointSettings {
        kind,
        low,
        high,
        rate: Rate(100 * MM),
        backlash: Coordinate::ZERO,
        backlash_table: Default::default(),
        drive: Drive::Torque {
            full_scale: Effort(1 << 16),
            limit: Effort(1 << 16),
        },
        law: ServoConfig {
            form: ServoForm::Pd,
            kp: Gain(0),
            kd: Gain(0),
            rate_filter_us: 0,
            inertia: 0,
            viscous: 0,
            coulomb: Effort::ZERO,
            coulomb_rate: Rate(1),
            ki: Gain(0),
            friction_adaptation_ms: 0,
        },
        preset: Coordinate::ZERO,
        home: Home::Index,
        encoder: Some(EncoderSettings {
            per_count: 1 << 24,
            following: Coordinate(MM),
            following_lag: 0,
            stuck_distance: Coordinate(MM),
            index: Coordinate::ZERO,
            index_pitch: Coordinate(MM),
            index_slack: 4,
            search: Coordinate::ZERO,
        }),
        active_low: 0,
        keeps_position: false,
        gantry: None,
    }
}

/// The reference arm with slide strokes of +-250 mm about home and a table of +-45 degrees.
fn config() -> Config {
    let mut joints = heapless::Vec::new();
    for home in [1135, 485, 1135, 485] {
        let low = Length::millimetres(home - 250).into();
        let high = Length::millimetres(home + 250).into();
        assert!(joints.push(joint(AxisKind::Linear, low, high)).is_ok());
    }
    let (low, high) = (Angle::degrees(-45).into(), Angle::degrees(45).into());
    assert!(joints.push(joint(AxisKind::Rotary, low, high)).is_ok());
    Config {
        name: heapless::String::new(),
        period_us: 200,
        model: Model::H4(reference()),
        pose: heapless::Vec::new(),
        joints,
        stopping: Stopping {
            time_ms: 100,
            ramp_ms: 20,
        },
        supervision: Supervision {
            heartbeat_ms: 100,
            missed_periods: 3,
            illegal_transitions: 3,
        },
        homing: Homing {
            rate: Rate(MM),
            rotary_rate: Rate(MM),
        },
        force: None,
        follow: None,
        haptic: None,
        volumetric: None,
        io: Default::default(),
    }
}

fn home() -> Joints {
    let mut joints = Joints::default();
    for (joint, home) in joints.0.iter_mut().zip([1135, 485, 1135, 485]) {
        *joint = Length::millimetres(home).into();
    }
    joints
}

#[test]
fn strokes_are_checked_in_both_directions() {
    let machine = config().kinematics();
    assert_eq!(machine.axes(), 5);
    let pose = machine.forward(&home()).unwrap();
    // All slides move together with x: 250 mm are their whole stroke.
    for (shift, joint, by) in [(251, 0, MM), (-251, 0, -MM), (300, 0, 50 * MM)] {
        let mut joints = home();
        for joint in &mut joints.0[..4] {
            joint.0 += shift * MM;
        }
        let error = PoseError::OutOfStroke { joint, by };
        assert_eq!(machine.forward(&joints), Err(error));
        let mut far = pose;
        far.0[0].0 += shift * MM;
        let PoseError::OutOfStroke {
            joint: at,
            by: excess,
        } = machine.inverse(&far).unwrap_err()
        else {
            panic!("not refused by stroke");
        };
        assert_eq!(at, joint);
        assert!((excess - by).abs() <= 4, "{excess}");
        let motion = machine.inverse_motion(&far, &Default::default(), &Default::default());
        assert_eq!(motion.unwrap_err(), machine.inverse(&far).unwrap_err());
    }
    let mut turned = home();
    turned.0[4] = Angle::degrees(50).into();
    let by = Angle::degrees(50).0 - Angle::degrees(45).0;
    assert_eq!(
        machine.forward(&turned),
        Err(PoseError::OutOfStroke { joint: 4, by })
    );
}

#[test]
fn unconfigured_joint_does_not_move() {
    let mut config = config();
    config.joints.truncate(3);
    let machine = config.kinematics();
    let error = PoseError::OutOfStroke {
        joint: 3,
        by: 485 * MM,
    };
    assert_eq!(machine.forward(&home()), Err(error));
}

#[test]
fn invalid_geometry_refuses_all_poses() {
    let broken: [fn(&mut H4Geometry); 8] = [
        |g| g.half_spacing = Length::ZERO,
        |g| g.half_spacing = Length::MIN,
        |g| g.rod = Length(-1),
        |g| g.rod = Length::MAX,
        |g| g.lateral = Length::ZERO,
        |g| g.lateral = Length::MIN,
        |g| g.tool = Length::MIN,
        |g| g.singularity_margin = Length::ZERO,
    ];
    for change in broken {
        let mut geometry = reference();
        change(&mut geometry);
        assert!(!H4::is_sound(&geometry));
        let arm = H4::new(&geometry);
        let pose = H4::new(&reference()).forward(&home()).unwrap();
        assert!(arm.inverse(&pose).is_err());
        assert!(arm.forward(&home()).is_err());
        assert!(arm.jacobian(&pose).is_err());
        assert!(arm.singularity_distance(&pose).is_err());
        assert!(arm.slide_forces(&pose, &ToolForce::default()).is_err());
    }
}

/// A configuration has narrower bounds than the kinematics alone.
#[test]
fn a_model_beyond_its_bounds_is_unsound() {
    assert!(Model::H4(reference()).is_sound());
    let broken: [fn(&mut H4Geometry); 7] = [
        |g| g.rod = Length::millimetres(1001),
        |g| g.tool = Length::millimetres(1001),
        |g| g.half_spacing = Length(1 << 19),
        |g| g.y_offset = Length::millimetres(-1001),
        |g| g.table_height = Length::millimetres(1001),
        |g| g.singularity_margin = Length(1 << 19),
        |g| g.singularity_margin = Length::millimetres(101),
    ];
    for (index, change) in broken.iter().enumerate() {
        let mut geometry = reference();
        change(&mut geometry);
        assert!(!Model::H4(geometry).is_sound(), "change {index}");
    }
}

#[test]
fn singularity_distance_matches_the_reference_arm() {
    // At home D = 0 and y = 0: the distance is -Z = 578.768 - 25 - 250 mm.
    let arm = H4::new(&reference());
    let mut pose = arm.forward(&home()).unwrap();
    let distance = arm.singularity_distance(&pose).unwrap();
    assert!((distance.0 as f64 / MM as f64 - 303.768004).abs() < 1e-4);
    // Lift the platform through the plane of the rails: the same distance on the wrong side is
    // refused, with its sign.
    pose.0[2].0 += 2 * distance.0;
    let wrong = arm.singularity_distance(&pose).unwrap();
    assert!((wrong.0 + distance.0).abs() <= 2);
    let error = arm.inverse(&pose).unwrap_err();
    assert_eq!(error, PoseError::NearSingularity { distance: wrong.0 });
}

/// Any geometry whatever, sound or not.
fn any_geometry() -> impl Strategy<Value = H4Geometry> {
    let length = || {
        prop_oneof![
            any::<i32>(),
            (0..1i32 << 30),
            (1i32 << 20..1i32 << 29),
            Just(1 << 20),
            Just(1 << 28),
            Just(1 << 30),
            Just((1 << 29) - 1)
        ]
        .prop_map(Length)
    };
    (
        [
            length(),
            length(),
            length(),
            length(),
            length(),
            length(),
            length(),
        ],
        [length(), length(), length(), length(), length()],
        any::<bool>(),
    )
        .prop_map(|(a, b, below)| H4Geometry {
            lateral: a[0],
            half_spacing: a[1],
            half_height: a[2],
            joint_offset: a[3],
            rod: a[4],
            rail_offset: a[5],
            tool: a[6],
            x_offset: b[0],
            y_offset: b[1],
            z_offset: b[2],
            table_height: b[3],
            below,
            singularity_margin: b[4],
        })
}

proptest! {
    #![proptest_config(ProptestConfig {
            cases: 100_000,
            rng_seed: RngSeed::Fixed(1),
            ..ProptestConfig::default()
        })]

    /// No geometry, pose, joints or rates make the arithmetic overflow, and what is answered comes
    /// back.
    #[test]
    fn no_geometry_overflows(
        geometry in any_geometry(),
        values: [i32; 6],
        shifts in [0u32..32, 0u32..32, 0u32..32, 0u32..32, 0u32..32, 0u32..32],
        // A pose that the arm may well have: reach and tilt as shares.
        share in [0.05f64..1.0, 0.05f64..1.0, -0.99f64..0.99],
    ) {
        let arm = H4::new(&geometry);
        let values: [Coordinate; 6] = std::array::from_fn(|i| Coordinate(values[i] >> shifts[i]));
        let force = ToolForce {
            force: [Effort(values[0].0), Effort(values[1].0), Effort(values[2].0)],
            moment: Effort(values[3].0),
        };
        let rates = values.map(|value| Rate(value.0));
        let accelerations = values.map(|value| Acceleration(value.0));
        let mut likely = Joints::default();
        for i in 0..4 {
            let side = if i % 2 == 0 { 1.0 } else { -1.0 };
            let pair = if i < 2 { 1.0 } else { -1.0 };
            let reach = share[i / 2] * geometry.rod.0 as f64 + geometry.joint_offset.0 as f64;
            let tilt = pair * share[2] * geometry.half_spacing.0 as f64;
            likely.0[i] = Coordinate((side * reach + tilt) as i32);
        }
        for joints in [Joints(values), likely] {
            let mut poses = vec![Pose(values)];
            let answer = arm.forward(&joints);
            prop_assert!(H4::is_sound(&geometry) || answer.is_err());
            poses.extend(answer);
            for pose in poses {
                let inverse = arm.inverse(&pose);
                let motion = arm.inverse_motion(&pose, &rates, &accelerations);
                prop_assert_eq!(motion.map(|motion| motion.joints), inverse);
                prop_assert_eq!(arm.jacobian(&pose).err(), arm.slide_forces(&pose, &force).err());
                let _ = arm.singularity_distance(&pose);
                if let (Ok(back), Ok(_)) = (inverse, answer)
                    && pose.0 != values
                {
                    // A few units in the pose, slopes up to 10, and a long tool on a short platform
                    // magnifies the tilt's rounding.
                    let spacing = geometry.half_spacing.0 as i64;
                    let bound = 400 + 100 * (geometry.tool.0 as i64 / spacing);
                    for i in 0..4 {
                        let error = (back.0[i].0 as i64 - joints.0[i].0 as i64).abs();
                        prop_assert!(error <= bound, "{} {:?} {:?}", error, geometry, joints);
                    }
                }
            }
        }
    }

    /// Virtual work: the slides' forces do on every small motion the work that the tool force does.
    #[test]
    fn slide_forces_satisfy_virtual_work(
        place in [-80i32 * MM..80 * MM, -80i32 * MM..80 * MM, -40i32 * MM..150 * MM],
        theta in -30i32..30,
        force in [-500i32 << 16..500 << 16, -500i32 << 16..500 << 16, -500i32 << 16..500 << 16],
        moment in -50i32 << 16..50 << 16,
    ) {
        let arm = H4::new(&reference());
        let mut pose = Pose::default();
        for (coordinate, value) in pose.0.iter_mut().zip(place) {
            coordinate.0 = value;
        }
        pose.0[3] = Angle::degrees(theta).into();
        // The table at 0, so that the Jacobian in table coordinates is the one of the base.
        let Ok(slopes) = arm.jacobian(&pose) else { return Ok(()) };
        let tool = ToolForce { force: force.map(Effort), moment: Effort(moment) };
        let slides = arm.slide_forces(&pose, &tool).unwrap();
        let newton = 65536.0;
        for column in 0..4 {
            let scale = if column < 3 {
                1.0 / 4_294_967_296.0
            } else {
                // Raw lengths per raw angle to metres per radian.
                1.0 / (2.0 * std::f64::consts::PI * MM as f64 * 1000.0)
            };
            let work: f64 = (0..4)
                .map(|row| slides[row].0 as f64 / newton * slopes.0[row][column] as f64 * scale)
                .sum();
            let want = if column < 3 { force[column] } else { moment } as f64 / newton;
            prop_assert!((work - want).abs() < 1e-3, "{column}: {work} not {want}");
        }
    }
}

/// A box whose corners are reachable represents the boxes in it: the motion of a master over some
/// periods is checked once. That is no theorem, since the strokes bend the reach inwards; with the
/// margin of a box it holds.
#[test]
fn box_inside_a_reachable_box_is_reachable() {
    let config = config();
    let machine = config.kinematics();
    let mut state = 1_u64;
    let mut random = |size: f64| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        ((state >> 33) as f64 / f64::from(1_u32 << 31) - 0.5) * 2.0 * size
    };
    let millimetres = |value: f64| (value * f64::exp2(20.0)) as i64;
    let (mut wide_ones, mut refused, mut found) = (0, 0, 0);
    for _ in 0..200_000 {
        let mut centre = Pose::default();
        for axis in 0..3 {
            centre.0[axis] = Coordinate(millimetres(random(160.0)) as i32);
        }
        centre.0[3] = Coordinate(Angle::degrees(1).0 * random(50.0) as i32);
        let (mut wide, mut small) = (StoppingEnvelope::at(&centre), StoppingEnvelope::at(&centre));
        for axis in 0..3 {
            let place = i64::from(centre.0[axis].0);
            // A stop from 20 mm/s at 200 mm/s^2, with a tenth of a millimetre of room.
            let stop = 1.0;
            let shift = random(0.1);
            wide.reach(axis, place - millimetres(stop + 0.1));
            wide.reach(axis, place + millimetres(stop + 0.1));
            small.reach(axis, place + millimetres(shift - stop));
            small.reach(axis, place + millimetres(shift + stop));
        }
        if wide.is_reachable(&machine) {
            wide_ones += 1;
            found += u32::from(!small.is_reachable(&machine));
        } else {
            refused += 1;
        }
    }
    println!(
        "{wide_ones} wide boxes reachable, {refused} not; {found} with a small one that is not"
    );
    assert!(wide_ones > 10_000 && refused > 10_000);
    assert_eq!(found, 0);
}
