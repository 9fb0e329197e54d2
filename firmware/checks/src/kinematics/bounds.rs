//! Conformance of what supervision relies on: bounds over boxes of poses, from which the stopping
//! envelope and the limits of the joint rates follow, and the search for a reference.

use super::subject::{Reals, Sequence, Subject, raw, raw_pose};
use haptimill_kinematics::descriptor::AxisKind;
use haptimill_kinematics::{Accelerations, BoxBounds, Kinematics, MAX_AXES, Machine, Pose, Rates};
use haptimill_math::{Coordinate, Rate};

/// Sizes of boxes, mm. The coordinates of a box have sizes up to one of these.
const SIZES_MM: [f64; 5] = [0.0, 1e-4, 0.25, 12.0, 90.0];
/// The same of rotary coordinates, radians.
const SIZES_RAD: [f64; 5] = [0.0, 3e-7, 1e-3, 0.05, 0.5];
/// Largest pose rates, mm/s and rad/s.
const RATES: [f64; 2] = [100.0, 1.0];
/// Poses that are checked in each box, beside as many of its corners.
const POSES: usize = 8;

/// The value for a linear or for a rotary axis.
const fn of_kind<T: Copy>(kind: AxisKind, [linear, rotary]: [T; 2]) -> T {
    if kind.is_rotary() { rotary } else { linear }
}

/// A random whole number from 0 to `max`.
fn up_to(sequence: &mut Sequence, max: u32) -> u32 {
    sequence.below(u64::from(max) + 1) as u32
}

/// Checks that every pose of a box has its joints, and their rates, within the bounds of the box,
/// and that the bounds of a single pose are its joints.
///
/// Returns the share of the boxes that were not refused.
///
/// # Panics
/// A claim does not hold.
pub fn boxes_bound_their_poses<S: Subject>(subject: &S, count: usize) -> f64 {
    let (machine, axes) = (subject.machine(), subject.machine().axes());
    let (units, described) = (subject.pose_units(), S::Machine::DESCRIPTOR.pose);
    let mut sequence = Sequence(15);
    let mut answered = 0;
    for round in 0..count {
        let pose = match sequence.below(4) {
            0 => subject.pose_near_a_bound(&mut sequence),
            _ => subject.random_pose(&mut sequence),
        };
        let low = raw_pose(subject, &pose);
        let sizes: Reals = core::array::from_fn(|axis| {
            let Some(axis) = described.get(axis) else {
                return 0.0;
            };
            let max = of_kind(axis.kind, [SIZES_MM, SIZES_RAD])[round % SIZES_MM.len()];
            sequence.between(0.0, max)
        });
        let sizes = raw(&sizes, &units).map(|size| size.0.unsigned_abs());
        let at = |offsets: [u32; MAX_AXES]| {
            let moved = |axis: usize| low.0[axis].0.wrapping_add_unsigned(offsets[axis]);
            Pose(core::array::from_fn(|axis| Coordinate(moved(axis))))
        };
        let high = at(sizes);
        let overflows = |axis: usize| high.0[axis].0 < low.0[axis].0;
        if (0..axes).any(|axis| !described[axis].kind.is_circular() && overflows(axis)) {
            continue;
        }
        let rates: Rates = core::array::from_fn(|axis| {
            if axis >= axes {
                return Rate(0);
            }
            let max = of_kind(described[axis].kind, RATES) / units[axis];
            Rate(sequence.between(0.0, max) as i32)
        });
        let Ok(bounds) = machine.box_bounds(&low, &high, &[rates]) else {
            continue;
        };
        answered += 1;
        for number in 0..2 * POSES {
            let is_corner = number < POSES;
            let pose = at(sizes.map(|size| match is_corner {
                true => size * up_to(&mut sequence, 1),
                false => up_to(&mut sequence, size),
            }));
            let moving = rates.map(|rate| {
                let back = up_to(&mut sequence, 1) == 1;
                let size = match is_corner {
                    true => rate.0,
                    false => up_to(&mut sequence, rate.0.unsigned_abs()) as i32,
                };
                Rate(if back { -size } else { size })
            });
            assert_inside(subject, &bounds, &pose, &moving);
        }
        if low == high {
            let joints = machine.inverse(&low).expect("the box is reachable");
            assert_eq!(bounds.joints, [joints; 2]);
        }
    }
    assert!(answered > count / 20, "{answered} of {count}");
    answered as f64 / count as f64
}

/// Asserts that joints and rates of a moving pose are within the bounds.
fn assert_inside<S: Subject>(subject: &S, bounds: &BoxBounds, pose: &Pose, moving: &Rates) {
    let machine = subject.machine();
    let motion = machine
        .inverse_motion(pose, moving, &Accelerations::default())
        .unwrap_or_else(|error| panic!("{error:?}: {pose:?} is in a box that was not refused"));
    for axis in 0..machine.axes() {
        let joint = motion.joints.0[axis];
        let [min, max] = [0, 1].map(|end| bounds.joints[end].0[axis]);
        // The bounds of a joint that wraps around are an arc from the least one upwards.
        let ahead = |of: Coordinate| of.wrapping_sub(min).0 as u32;
        assert!(
            ahead(joint) <= ahead(max),
            "joint {axis}: {joint:?} not in {min:?} {max:?}; {pose:?}"
        );
        let (rate, limit) = (motion.rates[axis].0, bounds.rates[0][axis]);
        assert!(
            rate.unsigned_abs() <= limit,
            "rate {axis}: {rate} above {limit}; {pose:?}"
        );
    }
}

/// Checks that the search for the reference of a joint moves no joint with another search
/// coordinate: a reference is found within a turn of the motor only then.
///
/// # Panics
/// A claim does not hold.
pub fn a_search_moves_its_joints<S: Subject>(subject: &S, count: usize) {
    let (machine, axes) = (subject.machine(), subject.machine().axes());
    let (units, described) = (subject.joint_units(), S::Machine::DESCRIPTOR.joints);
    // Rounding, mm/s and rad/s: of slides alone, and with the sines of rotary joints.
    let rounding = if described.iter().any(|axis| axis.kind.is_rotary()) {
        [4e-3, 6e-6]
    } else {
        [5e-5, 0.0]
    };
    let mut sequence = Sequence(16);
    let mut done = 0;
    while done < count {
        let pose = raw_pose(subject, &subject.random_pose(&mut sequence));
        if machine.inverse(&pose).is_err() {
            continue;
        }
        done += 1;
        for joint in 0..axes {
            // 5 mm/s or 35 mrad/s.
            let coordinate = S::Machine::search_coordinate(joint);
            let rate = of_kind(described[joint].kind, [5.0, 0.035]) / units[joint];
            let rates = machine.search_rates(joint, &pose, rate as i64);
            let rates: Rates =
                rates.map(|rate| Rate(i32::try_from(rate).expect("a search is slow")));
            let motion = machine.inverse_motion(&pose, &rates, &Accelerations::default());
            let motion = motion.expect("inside");
            let moves = rates[coordinate].0 != 0;
            assert!(moves, "joint {joint}: coordinate {coordinate} is at rest");
            for other in 0..axes {
                let found = f64::from(motion.rates[other].0) * units[other];
                let rounding = of_kind(described[other].kind, rounding);
                if S::Machine::search_coordinate(other) == coordinate {
                    continue;
                }
                assert!(
                    found.abs() < rounding,
                    "joint {other} moves by {found} /s in the search of {joint}; {pose:?}"
                );
            }
            let own = f64::from(motion.rates[joint].0) * units[joint];
            let expected = rate * units[joint];
            let rounding = of_kind(described[joint].kind, rounding);
            assert!(
                (own - expected).abs() < rounding,
                "joint {joint}: {own} /s instead of {expected}; {pose:?}"
            );
        }
    }
}
