//! Search of the trunnion mill for its references.

use haptimill_kinematics::trunnion::{Trunnion, TrunnionGeometry};
use haptimill_kinematics::{Accelerations, Kinematics as _, Machine as _, Pose};
use haptimill_math::{Coordinate, Length, Rate};

/// 1 mm in axis units.
const MM: i32 = 1 << 20;

/// In the search for a reference one joint moves and the others stand still, wherever the rotary
/// axes are: an index pulse comes within a turn of the motor only then.
#[test]
fn a_search_moves_one_joint() {
    let mill = Trunnion::new(&TrunnionGeometry {
        tilt_y: Length(MM / 3),
        tilt_z: Length(-120 * MM),
        table_x: Length(MM / 5),
        table_y: Length(-MM / 7),
        origin: [Length(MM / 5), Length(-MM / 7), Length(-100 * MM)],
        tool: Length(100 * MM),
    });
    // A degree is 2^32 / 360 axis units.
    let degrees = |angle: i64| Coordinate(((angle << 32) / 360) as i32);
    for tilt in [-60, -10, 0, 25, 60] {
        for turn in [-170, -126, -90, 0, 45, 90, 135] {
            let mut pose = Pose::default();
            pose.0[..3].copy_from_slice(&[-19 * MM, 10 * MM, 30 * MM].map(Coordinate));
            pose.0[3] = degrees(tilt);
            pose.0[4] = degrees(turn);
            for joint in 0..5 {
                // 5 mm or 2 degrees per second.
                let rate = if joint < 3 {
                    5 * i64::from(MM)
                } else {
                    23_860_929
                };
                let rates = mill
                    .search_rates(joint, &pose, rate)
                    .map(|it| Rate(it as i32));
                let motion = mill.inverse_motion(&pose, &rates, &Accelerations::default());
                for (other, found) in motion.expect("inside").rates.iter().enumerate() {
                    let want = if other == joint { rate } else { 0 };
                    let off = (i64::from(found.0) - want).abs();
                    assert!(
                        off < 4000,
                        "a {tilt}, c {turn}, joint {joint}, {other}: {found:?} not {want}"
                    );
                }
            }
        }
    }
}
