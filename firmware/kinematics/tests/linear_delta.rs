//! Bounds over boxes, and the search for a reference, of the linear delta: what the conformance
//! suite does not check.

use haptimill_kinematics::linear_delta::{LinearDelta, LinearDeltaGeometry};
use haptimill_kinematics::{Accelerations, Kinematics, Machine, Pose, Rates};
use haptimill_math::{Coordinate, Length, Rate};

const MM: i32 = 1 << 20;

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
#[test]
fn boxes_hold_the_joints_and_rates_of_their_poses() {
    let mut sequence = Sequence(1);
    for machine in machines() {
        let mut boxes = 0;
        for round in 0..40_000 {
            let size = [0, 100, MM / 4, 12 * MM, 90 * MM][round % 5];
            let mut low = Pose::default();
            let mut high = Pose::default();
            for axis in 0..3 {
                let at = sequence.between(-200 * MM, 200 * MM);
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
                    assert!(
                        (least..=most).contains(&joint),
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
        assert!(boxes > 10_000, "{boxes}");
    }
}

/// In the search for a reference one slide moves and the others stand still.
#[test]
fn a_search_moves_one_slide() {
    let mut sequence = Sequence(3);
    for machine in machines() {
        let mut poses = 0;
        for _ in 0..2_000 {
            let mut pose = Pose::default();
            for axis in 0..3 {
                pose.0[axis] = Coordinate(sequence.between(-200 * MM, 200 * MM));
            }
            if machine.inverse(&pose).is_err() {
                continue;
            }
            poses += 1;
            for joint in 0..3 {
                let rate = 5 * i64::from(MM);
                let rates = machine
                    .search_rates(joint, &pose, rate)
                    .map(|it| Rate(it as i32));
                let motion = machine.inverse_motion(&pose, &rates, &Accelerations::default());
                for (other, found) in motion.expect("inside").rates.iter().enumerate() {
                    let want = if other == joint { rate } else { 0 };
                    let off = (i64::from(found.0) - want).abs();
                    assert!(off < 50, "joint {joint}, {other}: {found:?} not {want}");
                }
            }
        }
        assert!(poses > 400, "{poses}");
    }
}
