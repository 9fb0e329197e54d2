//! Bounds over boxes, and the search for a reference, of the SCARA arm: what the conformance suite
//! does not check.

mod bounds;

use haptimill_kinematics::Machine;
use haptimill_kinematics::scara::{Scara, ScaraGeometry};
use haptimill_math::Length;

fn arm(upper: i32, fore: i32, right: bool) -> Scara {
    let geometry = ScaraGeometry {
        upper: Length::millimetres(upper),
        fore: Length::millimetres(fore),
        origin: [Length::millimetres(120), Length::millimetres(-35)],
        right,
        singularity_margin: Length::millimetres(20),
    };
    assert!(Scara::is_sound(&geometry));
    Scara::new(&geometry)
}

fn arms() -> [Scara; 3] {
    [
        arm(250, 200, true),
        arm(180, 240, false),
        arm(200, 200, true),
    ]
}

/// Every pose of a box has its joints, and their rates, within the bounds.
#[test]
fn boxes_hold_the_joints_and_rates_of_their_poses() {
    bounds::boxes_hold_the_joints_and_rates_of_their_poses(&arms(), 480, 10_000);
}

/// In the search for a reference one joint moves and the others are at rest: 2 degrees or
/// 5 mm per second.
#[test]
fn a_search_turns_one_joint() {
    bounds::a_search_moves_one_joint(&arms(), 480, [23_860_929, 23_860_929, 5 << 20], 4000);
}
