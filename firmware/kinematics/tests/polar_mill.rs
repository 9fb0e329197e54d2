//! The sign of the table, its half turn, and sound lengths of the polar mill: what the conformance
//! suite does not check.

use haptimill_kinematics::polar_mill::{PolarMill, PolarMillGeometry};
use haptimill_kinematics::{
    BoundedKinematics, JointLimits, Joints, Kinematics, Machine, Model, Pose, PoseError,
};
use haptimill_math::{Coordinate, Length, Rate};

fn geometry(x: i32, y: i32, margin: i32) -> PolarMillGeometry {
    PolarMillGeometry {
        origin: [Length::millimetres(x), Length::millimetres(y)],
        singularity_margin: Length::millimetres(margin),
    }
}

fn mills() -> [PolarMill; 3] {
    [
        geometry(0, 0, 20),
        geometry(110, 0, 15),
        geometry(-40, 250, 40),
    ]
    .map(|geometry| {
        assert!(PolarMill::is_sound(&geometry));
        PolarMill::new(&geometry)
    })
}

fn pose(x: i32, y: i32) -> Pose {
    let mut pose = Pose::default();
    pose.0[0] = Coordinate(x << 20);
    pose.0[1] = Coordinate(y << 20);
    pose
}

/// A quarter turn of the table, right-handed, brings +x of the workpiece to +y of the machine, so
/// the tool on +x of the machine is on -y of the workpiece.
#[test]
fn the_tool_goes_round_against_the_table() {
    let [mill, ..] = mills();
    let mut joints = Joints::default();
    joints.0[0] = Coordinate(100 << 20);
    joints.0[1] = Coordinate(1 << 30);
    let found = mill.forward(&joints).expect("a pose");
    assert!(found.0[0].0.abs() < 4, "{found:?}");
    assert!((found.0[1].0 + (100 << 20)).abs() < 4, "{found:?}");
}

/// A box across the half turn is an arc of a table that wraps around, and beyond the stroke of one
/// that does not.
#[test]
fn a_stroke_ends_at_the_half_turn() {
    let limits = |low: i32, high: i32| JointLimits {
        low: Coordinate(low),
        high: Coordinate(high),
        rate: Rate(1 << 30),
    };
    let whole = limits(i32::MIN, i32::MAX);
    let end = i32::MAX - (1 << 24);
    let stroke = limits(-end, end);
    let model = Model::PolarMill(geometry(0, 0, 20));
    let slide = limits(0, 300 << 20);
    let free = BoundedKinematics::new(&model, [slide, whole, limits(-1, 1)]);
    let held = BoundedKinematics::new(&model, [slide, stroke, limits(-1, 1)]);
    let (low, high) = (pose(-100, -80), pose(-90, 80));
    assert!(free.box_bounds(&low, &high, &[]).is_ok());
    assert!(held.inverse(&low).is_ok() && held.inverse(&pose(-90, 80)).is_ok());
    assert!(held.box_bounds(&low, &high, &[]).is_err());
    assert!(held.box_bounds(&pose(90, -80), &pose(100, 80), &[]).is_ok());
}

/// A margin of less than 1 mm is unsound, and such a machine has no pose.
#[test]
fn unsound_lengths_have_no_pose() {
    let far = |margin: i32| PolarMillGeometry {
        origin: [Length(i32::MIN), Length(i32::MAX)],
        singularity_margin: Length(margin),
    };
    for unsound in [geometry(0, 0, 0), geometry(0, 0, -5), far(i32::MIN)] {
        assert!(!PolarMill::is_sound(&unsound));
        let mill = PolarMill::new(&unsound);
        let mut joints = Joints::default();
        joints.0[0] = Coordinate(i32::MAX);
        assert!(mill.forward(&joints).is_err());
        for (x, y) in [(0, 0), (100, 0), (-2000, 2000)] {
            assert!(mill.inverse(&pose(x, y)).is_err(), "{unsound:?}");
        }
    }
    // Sound, but the workpiece is beyond the slide.
    let mill = PolarMill::new(&far(1 << 20));
    assert_eq!(mill.inverse(&pose(0, 0)), Err(PoseError::Unreachable));
    let [mill, ..] = mills();
    assert!(mill.inverse(&pose(100, 0)).is_ok());
    assert!(matches!(
        mill.inverse(&pose(3, 4)),
        Err(PoseError::NearSingularity { distance }) if distance == 5 << 20
    ));
}
