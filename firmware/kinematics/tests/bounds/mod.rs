//! Checks of bounds over boxes and of the search for a reference, which the conformance suite does
//! not make.

use haptimill_kinematics::{Accelerations, Kinematics, Machine, Pose, Rates};
use haptimill_math::{Coordinate, Rate};

const MM: i32 = 1 << 20;

/// Numbers without a pattern (splitmix64).
struct Sequence(u64);

impl Sequence {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A whole number from `low` to `high`.
    fn between(&mut self, low: i32, high: i32) -> i32 {
        let width = (i64::from(high) - i64::from(low) + 1) as u64;
        (i64::from(low) + (self.next() % width) as i64) as i32
    }
}

/// Every pose of a box has its joints, and their rates, within the bounds.
///
/// Boxes begin within `reach_mm` of the origin; each machine needs more than `least` boxes that it
/// reaches.
pub fn boxes_hold_the_joints_and_rates_of_their_poses<M: Kinematics + Machine>(
    machines: &[M],
    reach_mm: i32,
    least: usize,
) {
    let mut sequence = Sequence(1);
    for machine in machines {
        let mut boxes = 0;
        for round in 0..40_000 {
            let size = [0, 100, MM / 4, 12 * MM, 90 * MM][round % 5];
            let mut low = Pose::default();
            let mut high = Pose::default();
            for axis in 0..3 {
                let at = sequence.between(-reach_mm * MM, reach_mm * MM);
                low.0[axis] = Coordinate(at);
                high.0[axis] = Coordinate(at + sequence.between(0, size));
            }
            let rates: Rates = core::array::from_fn(|axis| match axis {
                0..3 => Rate(sequence.between(0, 100 * MM)),
                _ => Rate(0),
            });
            let Ok(bounds) = machine.box_bounds(&low, &high, &[rates]) else {
                continue;
            };
            boxes += 1;
            for corner in 0..12 {
                let mut pose = Pose::default();
                let mut moving = Rates::default();
                for axis in 0..3 {
                    let (from, to) = (low.0[axis].0, high.0[axis].0);
                    pose.0[axis] = Coordinate(match corner {
                        0..8 if corner >> axis & 1 == 0 => from,
                        0..8 => to,
                        _ => sequence.between(from, to),
                    });
                    let most = rates[axis].0;
                    moving[axis] = Rate(sequence.between(-most, most));
                }
                let motion = machine
                    .inverse_motion(&pose, &moving, &Accelerations::default())
                    .unwrap_or_else(|error| panic!("{error:?}: {pose:?} in {low:?} {high:?}"));
                for axis in 0..3 {
                    let joint = motion.joints.0[axis];
                    let [least, most] = [0, 1].map(|end| bounds.joints[end].0[axis]);
                    // The bounds of a joint that wraps around are an arc from low upwards.
                    let ahead = |of: Coordinate| of.wrapping_sub(least).0 as u32;
                    assert!(
                        ahead(joint) <= ahead(most),
                        "joint {axis}: {joint:?} not in {least:?} {most:?}"
                    );
                    let (rate, limit) = (motion.rates[axis].0, bounds.rates[0][axis]);
                    assert!(
                        rate.unsigned_abs() <= limit,
                        "rate {axis}: {rate} above {limit}"
                    );
                }
                if low == high {
                    assert_eq!(bounds.joints, [motion.joints; 2]);
                }
            }
        }
        println!("{boxes} boxes");
        assert!(boxes > least, "{boxes}");
    }
}

/// In the search for a reference one joint moves and the others are at rest.
///
/// `rates` are those of the search, in axis units per second; a rate may be off by `tolerance`.
pub fn a_search_moves_one_joint<M: Kinematics + Machine>(
    machines: &[M],
    reach_mm: i32,
    rates: [i64; 3],
    tolerance: i64,
) {
    let mut sequence = Sequence(3);
    for machine in machines {
        let mut poses = 0;
        for _ in 0..2_000 {
            let mut pose = Pose::default();
            for axis in 0..3 {
                pose.0[axis] = Coordinate(sequence.between(-reach_mm * MM, reach_mm * MM));
            }
            if machine.inverse(&pose).is_err() {
                continue;
            }
            poses += 1;
            for (joint, rate) in rates.into_iter().enumerate() {
                let rates = machine
                    .search_rates(joint, &pose, rate)
                    .map(|it| Rate(it as i32));
                let motion = machine.inverse_motion(&pose, &rates, &Accelerations::default());
                for (other, found) in motion.expect("inside").rates.iter().enumerate() {
                    let want = if other == joint { rate } else { 0 };
                    let off = (i64::from(found.0) - want).abs();
                    assert!(
                        off < tolerance,
                        "joint {joint}, {other}: {found:?} not {want}"
                    );
                }
            }
        }
        assert!(poses > 400, "{poses}");
    }
}
