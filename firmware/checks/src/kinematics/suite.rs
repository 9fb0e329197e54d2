//! The conformance checks, for any machine. Requirements: 0.1 um and 1 urad against f64, no wrong
//! pose in a million. A failed check shows poses and joints in mm and radians, and the least
//! margin.

use super::subject::{Reals, Sequence, Subject, raw_pose, real};
use core::fmt::Debug;
use haptimill_kinematics::{Joints, Kinematics, MAX_AXES, Machine, Pose, PoseError};
use haptimill_math::{Acceleration, Coordinate, Rate};

/// Tolerance: 0.1 um, or 1 urad. The size of a raw unit distinguishes millimetres from radians.
fn tolerance(unit: f64) -> f64 {
    if unit > 1e-8 { 1e-4 } else { 1e-6 }
}

/// Multiple of the tolerance of the margins within which rounding may decide.
const GREY: f64 = 1.0;

/// Least margin of a pose at which derivatives are compared: 2 mm, or 5 mrad.
const ROOM: f64 = 20_000.0;

/// Asserts that the coordinates agree. Angles that differ by a turn do not agree.
#[track_caller]
fn agree(axes: usize, got: &Reals, want: &Reals, units: &Reals, context: &dyn Debug) -> f64 {
    let mut worst: f64 = 0.0;
    for axis in 0..axes {
        let share = (got[axis] - want[axis]).abs() / tolerance(units[axis]);
        assert!(
            share <= 1.0,
            "axis {axis}: {} instead of {}; {:?}",
            got[axis],
            want[axis],
            context
        );
        worst = worst.max(share);
    }
    worst
}

/// Returns a pose of one of the kinds, in turn.
fn any_pose<S: Subject>(subject: &S, sequence: &mut Sequence) -> Pose {
    let values = if sequence.next() & 1 == 0 {
        subject.random_pose(sequence)
    } else {
        subject.pose_near_a_bound(sequence)
    };
    raw_pose(subject, &values)
}

/// Checks that the inverse kinematics closes the loops, that it refuses exactly the poses that
/// violate a condition, and that the forward kinematics inverts it.
///
/// Returns the largest errors of inverse and forward kinematics as fractions of their tolerance.
///
/// # Panics
/// A claim does not hold.
pub fn inverse_against_closure<S: Subject>(subject: &S, count: usize) -> (f64, f64) {
    let (machine, axes) = (subject.machine(), subject.machine().axes());
    let (pose_units, joint_units) = (subject.pose_units(), subject.joint_units());
    let mut sequence = Sequence(11);
    let (mut answered, mut refused) = (0, 0);
    let (mut worst, mut worst_forward): (f64, f64) = (0.0, 0.0);
    while answered < count {
        let pose = any_pose(subject, &mut sequence);
        let truth = real(&pose.0, &pose_units);
        let margins = subject.margins(&truth);
        let context = (truth, margins.smallest());
        match machine.inverse(&pose) {
            Ok(joints) => {
                answered += 1;
                assert!(
                    margins.smallest() >= -GREY,
                    "a pose beyond the bounds is accepted: {context:?}"
                );
                let want = subject.close(&truth).expect("closes");
                let got = real(&joints.0, &joint_units);
                worst = worst.max(agree(axes, &got, &want, &joint_units, &context));
                // The rounded joint positions belong to a nearby pose: the one that Newton's method
                // finds, on the same branch.
                match machine.forward(&joints) {
                    Ok(back) => {
                        let back = real(&back.0, &pose_units);
                        assert!(
                            subject.measured_margins(&back).smallest() >= -GREY,
                            "the pose of the joints is beyond the bounds: {context:?}"
                        );
                        let want = subject.solve(&got, &back).expect("converges");
                        let share = agree(axes, &back, &want, &pose_units, &context);
                        worst_forward = worst_forward.max(share);
                    }
                    Err(error) => {
                        assert!(
                            margins.deserve(&error),
                            "no pose for the joints of a pose, {error:?}: {context:?}"
                        );
                    }
                }
            }
            Err(error) => {
                refused += 1;
                assert!(
                    margins.deserve(&error),
                    "a pose within the bounds is refused, {error:?}: {context:?}"
                );
            }
        }
    }
    if S::HAS_BOUNDS {
        // Both sides of the bounds were tested.
        assert!(
            refused > count / 20,
            "only {refused} of {count} poses are beyond the bounds"
        );
    } else {
        assert_eq!(refused, 0, "a geometry without bounds refused poses");
    }
    (worst, worst_forward)
}

/// Checks that every pose of the forward kinematics satisfies all conditions and closes the loops
/// with the given joint positions, for any joint positions.
///
/// # Panics
/// A claim does not hold.
pub fn forward_is_verified<S: Subject>(subject: &S, count: usize) -> f64 {
    let (machine, axes) = (subject.machine(), subject.machine().axes());
    let (pose_units, joint_units) = (subject.pose_units(), subject.joint_units());
    let mut sequence = Sequence(12);
    let (mut answered, mut worst): (usize, f64) = (0, 0.0);
    for _ in 0..count {
        let joints = match sequence.below(4) {
            0 => {
                // Joint positions of a pose near a bound, on either side.
                let pose = subject.pose_near_a_bound(&mut sequence);
                let Some(joints) = subject.close(&pose) else {
                    continue;
                };
                Joints(super::subject::raw(&joints, &joint_units))
            }
            _ => subject.random_joints(&mut sequence),
        };
        let Ok(pose) = machine.forward(&joints) else {
            continue;
        };
        answered += 1;
        let got = real(&pose.0, &pose_units);
        let margins = subject.measured_margins(&got);
        let context = (real(&joints.0, &joint_units), got, margins.smallest());
        assert!(
            margins.smallest() >= -GREY,
            "joint positions give a pose beyond the bounds: {context:?}"
        );
        let commanded = real(&joints.0, &joint_units);
        let want = subject.solve(&commanded, &got).expect("closes");
        worst = worst.max(agree(axes, &got, &want, &pose_units, &context));
    }
    assert!(
        answered > count / 20,
        "only {answered} of {count} joint positions have a pose"
    );
    worst
}

/// Checks that any numbers give a valid answer or an error, and no panic of the kinematics.
///
/// # Panics
/// A claim does not hold.
pub fn extremes<S: Subject>(subject: &S, count: usize) {
    let machine = subject.machine();
    let corners = [
        i32::MIN,
        i32::MIN + 1,
        -(1 << 30) - 1,
        -(1 << 30),
        -(1 << 30) + 1,
        -1,
        0,
        1,
        (1 << 30) - 1,
        1 << 30,
        (1 << 30) + 1,
        i32::MAX - 1,
        i32::MAX,
    ];
    let mut sequence = Sequence(13);
    for round in 0..count {
        let mut values = [Coordinate(0); MAX_AXES];
        for value in &mut values {
            value.0 = match sequence.below(3) {
                0 => corners[sequence.below(corners.len() as u64) as usize],
                1 => sequence.next() as i32,
                _ => (sequence.next() as i32) >> sequence.below(31),
            };
        }
        let pose = Pose(values);
        let truth = real(&values, &subject.pose_units());
        let fast = round % 2 == 0;
        let rates = core::array::from_fn(|_| {
            Rate(if fast {
                i32::MIN
            } else {
                sequence.next() as i32
            })
        });
        let accelerations = core::array::from_fn(|_| {
            Acceleration(if fast {
                i32::MAX
            } else {
                sequence.next() as i32
            })
        });
        let result = machine.inverse(&pose);
        match result {
            Ok(_) => assert!(
                subject.margins(&truth).smallest() >= -GREY,
                "a pose beyond the bounds is accepted: {truth:?} (mm, rad)"
            ),
            Err(error) => {
                // Joint positions beyond the range of a word are not reachable either.
                let held = |joints: Reals| {
                    joints
                        .iter()
                        .zip(subject.joint_units())
                        .all(|(joint, unit)| joint.abs() < unit * 2_147_483_000.0 || unit == 0.0)
                };
                assert!(
                    subject.margins(&truth).deserve(&error)
                        || (error == PoseError::Unreachable
                            && !subject.close(&truth).is_some_and(held)),
                    "a pose within the bounds is refused, {error:?}: {truth:?} (mm, rad)"
                );
            }
        }
        let motion = machine.inverse_motion(&pose, &rates, &accelerations);
        assert_eq!(result, motion.map(|motion| motion.joints));
        assert_eq!(result.err(), machine.jacobian(&pose).err().or(result.err()));
        if let Ok(pose) = machine.forward(&Joints(values)) {
            let pose = real(&pose.0, &subject.pose_units());
            assert!(
                subject.measured_margins(&pose).smallest() >= -GREY,
                "joint positions give a pose beyond the bounds: {pose:?} (mm, rad)"
            );
        }
    }
}

/// Returns first and second differences of the closure along a moving pose, of fourth order.
fn differences(values: [Reals; 5], step: f64, joint: usize) -> (f64, f64) {
    let [a, b, c, d, e] = values.map(|value| value[joint]);
    (
        (a - 8.0 * b + 8.0 * d - e) / (12.0 * step),
        (-a + 16.0 * b - 30.0 * c + 16.0 * d - e) / (12.0 * step * step),
    )
}

/// Returns the pose after a time, with constant acceleration.
fn moved(pose: &Reals, rate: &Reals, acceleration: &Reals, time: f64) -> Reals {
    core::array::from_fn(|axis| {
        pose[axis] + rate[axis] * time + 0.5 * acceleration[axis] * time * time
    })
}

/// Checks that the Jacobian, and the rates and accelerations of the joints, are the derivatives of
/// the closure.
///
/// # Panics
/// A claim does not hold.
pub fn derivatives_against_differences<S: Subject>(subject: &S, count: usize) {
    let (machine, axes) = (subject.machine(), subject.machine().axes());
    let (coordinates, joints) = (S::Machine::DESCRIPTOR.pose, S::Machine::DESCRIPTOR.joints);
    let (pose_units, joint_units) = (subject.pose_units(), subject.joint_units());
    let mut sequence = Sequence(14);
    let mut done = 0;
    while done < count {
        let pose = raw_pose(subject, &subject.random_pose(&mut sequence));
        let truth = real(&pose.0, &pose_units);
        // Differences need room on both sides. The other checks approach the bounds.
        if subject.margins(&truth).smallest() < ROOM {
            continue;
        }
        // Small compared with S / S', large compared with the noise of f64 (3e-5 mm/s^2 in the
        // second difference).
        let step = 1e-4;
        let along = |rate: &Reals, acceleration: &Reals| -> Option<[Reals; 5]> {
            let mut values = [[0.0; MAX_AXES]; 5];
            for (i, value) in values.iter_mut().enumerate() {
                let time = (i as f64 - 2.0) * step;
                *value = subject.close(&moved(&truth, rate, acceleration, time))?;
            }
            Some(values)
        };
        let jacobian = machine.jacobian(&pose).expect("inside");
        for column in 0..axes {
            let mut rate = [0.0; MAX_AXES];
            // 1 mm/s or 0.01 rad/s.
            rate[column] = if tolerance(pose_units[column]) > 1e-5 {
                1.0
            } else {
                0.01
            };
            let values = along(&rate, &[0.0; MAX_AXES]).expect("inside");
            for row in 0..axes {
                let want = differences(values, step, row).0 / rate[column];
                let scale = joint_units[row] / pose_units[column] / 4_294_967_296.0;
                let got = jacobian.0[row][column] as f64 * scale;
                let bound = 1e-6 * (want.abs() + 1.0 + 350.0 * f64::from(rate[column] < 0.1));
                assert!(
                    (got - want).abs() < bound,
                    "Jacobian of {} by {}: {got} instead of {want} (mm, rad) at {truth:?}",
                    joints[row].name,
                    coordinates[column].name
                );
            }
        }

        let mut rates = [Rate(0); MAX_AXES];
        let mut accelerations = [Acceleration(0); MAX_AXES];
        for axis in 0..axes {
            // Up to +-60 mm/s or 0.5 rad/s, +-1000 mm/s^2 or 1.5 rad/s^2.
            let (fast, hard) = if tolerance(pose_units[axis]) > 1e-5 {
                (60.0, 1000.0)
            } else {
                (0.5, 1.5)
            };
            rates[axis] = Rate((sequence.between(-fast, fast) / pose_units[axis]) as i32);
            let unit = pose_units[axis] * 256.0;
            accelerations[axis] = Acceleration((sequence.between(-hard, hard) / unit) as i32);
        }
        let rate: Reals = core::array::from_fn(|axis| rates[axis].0 as f64 * pose_units[axis]);
        let acceleration: Reals =
            core::array::from_fn(|axis| accelerations[axis].0 as f64 * pose_units[axis] * 256.0);
        let motion = machine
            .inverse_motion(&pose, &rates, &accelerations)
            .expect("inside");
        assert_eq!(Ok(motion.joints), machine.inverse(&pose));
        let values = along(&rate, &acceleration).expect("inside");
        for joint in 0..axes {
            let (first, second) = differences(values, step, joint);
            let got = motion.rates[joint].0 as f64 * joint_units[joint];
            // An angular rate is exact to 1e-9 rad/s; a lever has up to 600 mm, a slope up to 10.
            let bound = 1e-6 * first.abs() + 1e-5;
            assert!(
                (got - first).abs() < bound,
                "rate of {}: {got} instead of {first} (mm/s, rad/s) at {truth:?}",
                joints[joint].name
            );
            let got = motion.accelerations[joint].0 as f64 * joint_units[joint] * 256.0;
            // Rates enter squared, with 1 / S. Angular accelerations are exact to 2e-7 rad/s^2;
            // levers have up to 600 mm, slopes up to 10.
            let bound = 1e-5 * second.abs() + 0.02;
            assert!(
                (got - second).abs() < bound,
                "acceleration of {}: {got} instead of {second} (mm/s^2, rad/s^2) at {truth:?}",
                joints[joint].name
            );
        }
        done += 1;
    }
}
