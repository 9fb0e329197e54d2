//! Bounds over boxes, and the search for a reference, of the linear delta: what the conformance
//! suite does not check.

mod bounds;

use haptimill_kinematics::Machine;
use haptimill_kinematics::linear_delta::{LinearDelta, LinearDeltaGeometry};
use haptimill_math::Length;

fn delta(rods: [i32; 3], columns: [[i32; 2]; 3]) -> LinearDelta {
    let geometry = LinearDeltaGeometry {
        rods: rods.map(Length::millimetres),
        columns: columns.map(|at| at.map(Length::millimetres)),
        height: Length::millimetres(180),
        singularity_margin: Length::millimetres(40),
    };
    assert!(LinearDelta::is_sound(&geometry));
    LinearDelta::new(&geometry)
}

fn machines() -> [LinearDelta; 3] {
    [
        delta([265; 3], [[-104, -60], [104, -60], [0, 120]]),
        delta([301, 288, 342], [[-140, -61], [98, -95], [12, 151]]),
        delta([600; 3], [[-346, -200], [346, -200], [0, 400]]),
    ]
}

/// Every pose of a box has its joints, and their rates, within the bounds.
#[test]
fn boxes_hold_the_joints_and_rates_of_their_poses() {
    bounds::boxes_hold_the_joints_and_rates_of_their_poses(&machines(), 200, 10_000);
}

/// In the search for a reference one joint moves and the others are at rest: 5 mm per
/// second.
#[test]
fn a_search_moves_one_slide() {
    bounds::a_search_moves_one_joint(&machines(), 200, [5 << 20; 3], 50);
}
