//! The loops of the haptic arm against independent data, and against differences.
//!
//! The data are 50 rows of the reference geometry REF-M: joints, pose, tip, and the motor efforts
//! that hold a force.

use haptimill_firmware::io::HapticOutputs;
use haptimill_hil_sim::haptics::dynamics::Dynamics;
use haptimill_hil_sim::haptics::geometry::{Actuated, rotated, solved, turned};
use haptimill_hil_sim::haptics::{Geometry, HandlePose, HapticArm, HapticConfig, HapticGeometry};
use proptest::prelude::*;

/// A row: nine joints, centre, frame, tip, force, six efforts.
struct Row {
    joints: [[f64; 3]; 3],
    pose: HandlePose,
    tip: [f64; 3],
    force: [f64; 3],
    efforts: [f64; 6],
}

fn rows() -> Vec<Row> {
    let rows: Vec<Row> = include_str!("haptic.csv")
        .lines()
        .skip(1)
        .map(|line| {
            let v: Vec<f64> = line
                .split(',')
                .map(|field| field.parse().expect(line))
                .collect();
            let three = |at: usize| [v[at], v[at + 1], v[at + 2]];
            Row {
                joints: [three(0), three(3), three(6)],
                pose: HandlePose {
                    centre: three(9),
                    frame: [three(12), three(15), three(18)],
                },
                tip: three(21),
                force: three(24),
                efforts: core::array::from_fn(|k| v[27 + k]),
            }
        })
        .collect();
    assert_eq!(rows.len(), 50);
    rows
}

fn geometry() -> Geometry {
    Geometry::new(&HapticGeometry::default())
}

fn actuated(joints: &[[f64; 3]; 3]) -> Actuated {
    core::array::from_fn(|k| joints[k / 2][k % 2])
}

fn apart(a: &HandlePose, b: &HandlePose) -> (f64, f64) {
    let way = (0..3)
        .map(|i| (a.centre[i] - b.centre[i]).abs())
        .fold(0.0, f64::max);
    let turn = (0..9)
        .map(|k| (a.frame[k / 3][k % 3] - b.frame[k / 3][k % 3]).abs())
        .fold(0.0, f64::max);
    (way, turn)
}

#[test]
fn inverse_kinematics_match_the_reference_table() {
    let geometry = geometry();
    for row in rows() {
        let joints = geometry.inverse(&row.pose).expect("reaches");
        for (ours, expected) in joints.iter().flatten().zip(row.joints.iter().flatten()) {
            assert!((ours - expected).abs() < 2e-8, "{ours} {expected}");
        }
        let tip = row.pose.point(geometry.tip());
        for (ours, expected) in tip.iter().zip(row.tip) {
            assert!((ours - expected).abs() < 1e-7, "{ours} {expected}");
        }
    }
}

#[test]
fn the_home_pose_is_that_of_the_reference_geometry() {
    let geometry = geometry();
    for [slide, turn, hinge] in geometry.inverse(&geometry.home()).expect("home") {
        assert!((slide - 295.3295).abs() < 1e-4, "{slide}");
        assert!(turn.abs() < 1e-12);
        assert!((hinge.to_degrees() - 43.7876).abs() < 1e-4);
    }
}

#[test]
fn forward_kinematics_return_to_the_pose() {
    let geometry = geometry();
    for row in rows() {
        let pose = geometry
            .forward(&actuated(&row.joints), &geometry.home())
            .expect("closes");
        let (way, turn) = apart(&pose, &row.pose);
        assert!(way < 1e-6 && turn < 1e-8, "{way} {turn}");
    }
}

/// The efforts of the table, through our own rows, give the force of the table: J^T tau = F,
/// without a moment.
#[test]
fn the_efforts_of_the_table_give_its_force() {
    let geometry = geometry();
    for row in rows() {
        let legs = geometry.legs(&row.pose).expect("reaches");
        let mut wrench = [0.0; 6];
        for (effort, rates) in row.efforts.iter().zip(Dynamics::rows(&legs)) {
            for (sum, rate) in wrench.iter_mut().zip(rates) {
                *sum += effort * rate;
            }
        }
        for axis in 0..3 {
            assert!((wrench[axis] - row.force[axis]).abs() < 1e-6, "{wrench:?}");
            assert!(wrench[3 + axis].abs() < 1e-4, "{wrench:?}");
        }
    }
}

/// The efforts of the table from our own rows.
#[test]
fn the_jacobian_rows_give_the_efforts_of_the_table() {
    let geometry = geometry();
    for row in rows() {
        let rates = Dynamics::rows(&geometry.legs(&row.pose).expect("reaches"));
        let columns = core::array::from_fn(|i| core::array::from_fn(|k| rates[k][i]));
        let [x, y, z] = row.force;
        let ours = solved(columns, [x, y, z, 0.0, 0.0, 0.0]).expect("regular");
        for (ours, expected) in ours.iter().zip(row.efforts) {
            assert!(
                (ours - expected).abs() < 1e-6 * (1.0 + expected.abs()),
                "{ours} {expected}"
            );
        }
    }
}

/// A force on the handle, and motors with the table's efforts against it: the remaining
/// acceleration is below one percent, including codes of 14 bits.
#[test]
fn the_efforts_of_the_table_hold_a_force_on_the_handle() {
    let mut config = HapticConfig::default();
    for actuator in [&mut config.slide, &mut config.turn] {
        actuator.coulomb = 0.0;
        actuator.viscous = 0.0;
        actuator.limit = 1e4;
    }
    for row in rows() {
        let size = row.force.iter().map(|f| f * f).sum::<f64>().sqrt();
        let accelerated = |share: f64| {
            let mut arm = HapticArm::new(&config, 200, 20, 1).expect("fine");
            arm.put(&row.pose).expect("reaches");
            arm.set_push(row.force.map(|f| -f));
            let mut outputs = HapticOutputs {
                enabled: true,
                ..HapticOutputs::default()
            };
            for (motor, effort) in row.efforts.into_iter().enumerate() {
                let full = [20.0, 2000.0][motor % 2];
                outputs.currents[motor / 2][motor % 2] =
                    (share * effort / full * 8192.0).round() as i16;
            }
            let mut speeds = [[0.0; 3]; 2];
            for period in 0..50 {
                arm.advance(&outputs, true);
                if period == 24 || period == 49 {
                    let twist = arm.truth().twist;
                    speeds[usize::from(period == 49)] = [twist[0], twist[1], twist[2]];
                }
            }
            (0..3)
                .map(|i| (speeds[1][i] - speeds[0][i]).powi(2))
                .sum::<f64>()
                .sqrt()
        };
        let (free, held) = (accelerated(0.0), accelerated(1.0));
        assert!(held < 0.01 * free, "{size:.1} N: {held} of {free}");
        assert!(accelerated(0.9) > 0.05 * free);
    }
}

#[test]
fn amplifier_codes_give_the_force_of_the_table_at_the_handle() {
    // The row of docs/control.md 7.2: at home, F = (3.2, 0, 1.2) N is 0.2973 N along each slide and
    // 0, -255.69, 255.69 N mm about them.
    let mut config = HapticConfig::default();
    for actuator in [&mut config.slide, &mut config.turn] {
        actuator.coulomb = 0.0;
    }
    let mut arm = HapticArm::new(&config, 200, 20, 1).expect("fine");
    let code = |effort: f64, full: f64| (effort / full * 8192.0).round() as i16;
    let mut outputs = HapticOutputs {
        enabled: true,
        ..HapticOutputs::default()
    };
    for (leg, turn) in [0.0, -255.69, 255.69].into_iter().enumerate() {
        outputs.currents[leg] = [code(0.2973, 20.0), code(turn, 2000.0)];
    }
    // 4 ms are eight time constants of the amplifier; the handle has hardly moved.
    for _ in 0..20 {
        arm.advance(&outputs, true);
    }
    let feedback = arm.truth().feedback;
    for (ours, expected) in feedback.iter().zip([3.2, 0.0, 1.2, 0.0, 0.0, 0.0]) {
        // 1 % of the force; moments in N mm, at about a tenth of a mm of travel.
        let bound = if expected == 0.0 {
            0.1
        } else {
            0.01 * expected
        };
        assert!((ours - expected).abs() < bound, "{feedback:?}");
    }
}

fn pose_near_home(v: &[f64; 6]) -> HandlePose {
    let home = geometry().home();
    HandlePose {
        centre: [
            home.centre[0] + 40.0 * v[0],
            home.centre[1] + 40.0 * v[1],
            home.centre[2] + 40.0 * v[2],
        ],
        frame: rotated(&home.frame, [0.2 * v[3], 0.2 * v[4], 0.2 * v[5]]),
    }
}

proptest! {
    #[test]
    fn forward_undoes_inverse(v in prop::array::uniform6(-1.0..1.0f64)) {
        let geometry = geometry();
        let pose = pose_near_home(&v);
        if let Ok(joints) = geometry.inverse(&pose) {
            let again = geometry.forward(&actuated(&joints), &geometry.home());
            if let Ok(again) = again {
                let (way, turn) = apart(&again, &pose);
                prop_assert!(way < 1e-7 && turn < 1e-9, "{} {}", way, turn);
            } else {
                prop_assert!(false, "does not close");
            }
        }
    }

    /// Rates of the joints from the rows against central differences of the joints.
    #[test]
    fn the_jacobian_rows_are_the_derivatives(v in prop::array::uniform6(-0.8..0.8f64), twist in prop::array::uniform6(-1.0..1.0f64)) {
        let geometry = geometry();
        let pose = pose_near_home(&v);
        let twist = [10.0 * twist[0], 10.0 * twist[1], 10.0 * twist[2], 0.1 * twist[3], 0.1 * twist[4], 0.1 * twist[5]];
        let h = 1e-4;
        let moved = |sign: f64| HandlePose {
            centre: core::array::from_fn(|i| pose.centre[i] + sign * h * twist[i]),
            frame: rotated(&pose.frame, [3, 4, 5].map(|i: usize| sign * h * twist[i])),
        };
        let (before, after) = (geometry.inverse(&moved(-1.0)), geometry.inverse(&moved(1.0)));
        prop_assume!(before.is_ok() && after.is_ok());
        let (before, after) = (before.unwrap(), after.unwrap());
        let legs = geometry.legs(&pose).unwrap();
        for (index, leg) in legs.iter().enumerate() {
            for (sensor, row) in [leg.slide_row(), leg.turn_row(), leg.hinge_row(geometry.link())].iter().enumerate() {
                let rate: f64 = (0..6).map(|k| row[k] * twist[k]).sum();
                let difference = (after[index][sensor] - before[index][sensor]) / (2.0 * h);
                prop_assert!((rate - difference).abs() < 1e-6 * (1.0 + rate.abs()), "{} {}", rate, difference);
            }
        }
    }
}

#[test]
fn a_pose_out_of_reach_is_refused() {
    let geometry = geometry();
    let mut pose = geometry.home();
    pose.centre = [400.0, 0.0, 450.0];
    assert!(geometry.legs(&pose).is_err());
    assert!(geometry.forward(&[1e4; 6], &geometry.home()).is_err());
    assert_eq!(turned(&pose.frame, [1.0, 2.0, 3.0]), [1.0, 2.0, 3.0]);
}
