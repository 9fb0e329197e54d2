//! Directions of the belts, and the ends of the integers: what the conformance suite does not check
//! by name. The machine has no lengths that could be unsound.

use haptimill_kinematics::corexy::{Corexy, CorexyGeometry};
use haptimill_kinematics::{Joints, Kinematics, Machine, PoseError};
use haptimill_math::Coordinate;

fn forward(a: i32, b: i32) -> Result<[i32; 2], PoseError> {
    let machine = Corexy::new(&CorexyGeometry {});
    let mut joints = Joints::default();
    (joints.0[0], joints.0[1]) = (Coordinate(a), Coordinate(b));
    let pose = machine.forward(&joints)?;
    let back = machine.inverse(&pose).expect("verified");
    for (joint, back) in joints.0.iter().zip(back.0) {
        let off = i64::from(joint.0) - i64::from(back.0);
        assert!((0..=1).contains(&off), "{joints:?} {back:?}");
    }
    Ok([pose.0[0].0, pose.0[1].0])
}

/// Both motors move the tool along x, one against the other along y, one alone along a diagonal.
#[test]
fn two_motors_move_one_coordinate() {
    let belt = 10 << 20;
    assert_eq!(forward(belt, belt), Ok([belt, 0]));
    assert_eq!(forward(belt, -belt), Ok([0, belt]));
    assert_eq!(forward(belt, 0), Ok([belt / 2, belt / 2]));
    assert_eq!(forward(0, belt), Ok([belt / 2, -belt / 2]));
}

/// At the ends of the integers a pose gives the belts back, or is refused.
#[test]
fn ends_of_the_range_are_verified_or_refused() {
    let ends = [i32::MIN, i32::MIN + 1, -1, 0, 1, i32::MAX - 1, i32::MAX];
    for (a, b) in ends.into_iter().flat_map(|a| ends.map(|b| (a, b))) {
        let refused = forward(a, b).is_err();
        // The halves are rounded down, and belt a cannot be a unit below the least number.
        assert_eq!(refused, a == i32::MIN && b % 2 != 0, "{a} {b}");
    }
}
