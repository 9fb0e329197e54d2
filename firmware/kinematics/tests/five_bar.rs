//! Bounds over boxes, the search for a reference, the other assembly and sound lengths of the
//! five-bar arm: what the conformance suite does not check.

use haptimill_kinematics::five_bar::{FiveBar, FiveBarGeometry};
use haptimill_kinematics::{Accelerations, Joints, Kinematics, Machine, Pose, PoseError, Rates};
use haptimill_math::{Coordinate, Length, Rate};

const MM: i32 = 1 << 20;

fn geometry(half_base: i32, proximal: i32, distal: i32) -> FiveBarGeometry {
    FiveBarGeometry {
        half_base: Length::millimetres(half_base),
        proximal: Length::millimetres(proximal),
        distal: Length::millimetres(distal),
        origin: [Length::millimetres(-35), Length::millimetres(120)],
        singularity_margin: Length::millimetres(20),
    }
}

fn arms() -> [FiveBar; 3] {
    [(80, 220, 280), (0, 250, 190), (140, 200, 200)].map(|(half_base, proximal, distal)| {
        let geometry = geometry(half_base, proximal, distal);
        assert!(FiveBar::is_sound(&geometry));
        FiveBar::new(&geometry)
    })
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
    for arm in arms() {
        let mut boxes = 0;
        for round in 0..40_000 {
            let size = [0, 100, MM / 4, 12 * MM, 90 * MM][round % 5];
            let mut low = Pose::default();
            let mut high = Pose::default();
            for axis in 0..3 {
                let at = sequence.between(-480 * MM, 480 * MM);
                low.0[axis] = Coordinate(at);
                high.0[axis] = Coordinate(at + sequence.between(0, size));
            }
            let rates: Rates = core::array::from_fn(|axis| match axis {
                0..3 => Rate(sequence.between(0, 100 * MM)),
                _ => Rate(0),
            });
            let Ok(bounds) = arm.box_bounds(&low, &high, &[rates]) else {
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
                let motion = arm
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
        assert!(boxes > 5_000, "{boxes}");
    }
}

/// In the search for a reference one joint turns and the others stand still.
#[test]
fn a_search_turns_one_joint() {
    let mut sequence = Sequence(3);
    for arm in arms() {
        let mut poses = 0;
        for _ in 0..2_000 {
            let mut pose = Pose::default();
            for axis in 0..3 {
                pose.0[axis] = Coordinate(sequence.between(-480 * MM, 480 * MM));
            }
            if arm.inverse(&pose).is_err() {
                continue;
            }
            poses += 1;
            for joint in 0..3 {
                // 2 degrees or 5 mm per second.
                let rate = [23_860_929, 23_860_929, 5 * i64::from(MM)][joint];
                let rates = arm
                    .search_rates(joint, &pose, rate)
                    .map(|it| Rate(it as i32));
                let motion = arm.inverse_motion(&pose, &rates, &Accelerations::default());
                for (other, found) in motion.expect("inside").rates.iter().enumerate() {
                    let want = if other == joint { rate } else { 0 };
                    let off = (i64::from(found.0) - want).abs();
                    assert!(off < 4000, "joint {joint}, {other}: {found:?} not {want}");
                }
            }
        }
        assert!(poses > 400, "{poses}");
    }
}

/// Degrees as a joint position.
fn degrees(value: f64) -> Coordinate {
    Coordinate((value / 360.0 * 4_294_967_296.0) as i32)
}

/// Elbows that the distal links cannot span, and arms bent inwards, have no pose.
#[test]
fn joints_of_another_assembly_are_refused() {
    let [arm, ..] = arms();
    let mut joints = Joints::default();
    for (theta1, theta2, found) in [
        (46.0, -46.0, true),
        (80.0, -80.0, false),
        // The tip is beyond the line of both left links: its elbow is on the right of it.
        (-60.0, -60.0, false),
        (60.0, 60.0, false),
    ] {
        joints.0[0] = degrees(theta1);
        joints.0[1] = degrees(theta2);
        let pose = arm.forward(&joints);
        assert_eq!(pose.is_ok(), found, "{theta1} {theta2}: {pose:?}");
        if !found {
            let near = matches!(pose, Err(PoseError::NearSingularity { .. }));
            assert!(near, "{pose:?}");
        }
    }
}

/// Lengths outside of the range of the arithmetic are unsound, and such a machine has no pose.
#[test]
fn unsound_lengths_have_no_pose() {
    let sound = geometry(80, 220, 280);
    let far = FiveBarGeometry {
        origin: [Length::millimetres(1501), sound.origin[1]],
        ..sound.clone()
    };
    let longest = FiveBarGeometry {
        distal: Length(i32::MAX),
        ..sound.clone()
    };
    let pose = Pose::default();
    assert!(FiveBar::new(&sound).inverse(&pose).is_ok());
    for geometry in [
        geometry(501, 220, 280),
        geometry(-1, 220, 280),
        geometry(80, 15, 280),
        geometry(80, 220, 1001),
        far,
        longest,
    ] {
        assert!(!FiveBar::is_sound(&geometry), "{geometry:?}");
        let arm = FiveBar::new(&geometry);
        assert!(arm.inverse(&pose).is_err(), "{geometry:?}");
        assert!(arm.forward(&Joints::default()).is_err(), "{geometry:?}");
    }
}
