//! The H-4 arm against tables of docs/control.md: golden vectors of 2,000 poses each way, poses
//! that no arm reaches, and the reference geometry's printed values. Within 0.1 um and 1 urad.
#![allow(
    clippy::needless_range_loop,
    reason = "an index is an axis here, of several arrays at once"
)]

use haptimill_kinematics::h4::H4;
use haptimill_kinematics::h4::H4Geometry;
use haptimill_kinematics::{Joints, Kinematics, Pose};
use haptimill_math::{Coordinate, Length};

const PER_MM: f64 = 1_048_576.0;
const PER_DEGREE: f64 = 4_294_967_296.0 / 360.0;
/// 0.1 um and 1 urad.
const MM: f64 = 1e-4;
const DEGREE: f64 = 1e-6 * 180.0 / std::f64::consts::PI;

/// REF-G of docs/control.md 7.2.
fn reference() -> H4Geometry {
    H4Geometry {
        lateral: Length::millimetres(400 - 100 - 50),
        half_spacing: Length::millimetres(100),
        half_height: Length::millimetres(100),
        joint_offset: Length::millimetres(50),
        rod: Length::millimetres(480),
        rail_offset: Length::millimetres(25),
        tool: Length::millimetres(150),
        x_offset: Length::millimetres(30 + 780),
        y_offset: Length::ZERO,
        z_offset: Length::ZERO,
        table_height: Length::millimetres(600),
        below: true,
        singularity_margin: Length::millimetres(5),
    }
}

fn arm() -> H4 {
    H4::new(&reference())
}

fn mm(value: f64) -> Coordinate {
    Coordinate(libm::round(value * PER_MM) as i32)
}

fn degrees(value: f64) -> Coordinate {
    Coordinate(libm::round(value * PER_DEGREE) as i32)
}

fn pose(values: &[f64]) -> Pose {
    let mut pose = Pose::default();
    for i in 0..3 {
        pose.0[i] = mm(values[i]);
    }
    pose.0[3] = degrees(values[3]);
    pose.0[4] = degrees(values[4]);
    pose
}

fn slides(values: &[f64]) -> Joints {
    let mut joints = Joints::default();
    for i in 0..4 {
        joints.0[i] = mm(values[i]);
    }
    joints
}

fn table(text: &str, columns: usize) -> Vec<Vec<f64>> {
    let rows: Vec<Vec<f64>> = text
        .lines()
        .skip(1)
        .map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect())
        .collect();
    assert!(rows.iter().all(|row: &Vec<f64>| row.len() == columns));
    rows
}

#[track_caller]
fn close(got: Coordinate, scale: f64, want: f64, tolerance: f64) {
    let got = got.0 as f64 / scale;
    assert!((got - want).abs() <= tolerance, "{got} instead of {want}");
}

#[test]
fn inverse_table() {
    let rows = table(include_str!("../../tests/golden/h4_ik.csv"), 9);
    assert_eq!(rows.len(), 2000);
    for row in rows {
        let joints = arm().inverse(&pose(&row)).unwrap();
        for i in 0..4 {
            close(joints.0[i], PER_MM, row[5 + i], MM);
        }
        close(joints.0[4], PER_DEGREE, row[4], DEGREE);
    }
}

#[test]
fn forward_table() {
    let rows = table(include_str!("../../tests/golden/h4_fk.csv"), 8);
    assert_eq!(rows.len(), 2000);
    for row in rows {
        let base = arm().base_pose(&slides(&row)).unwrap();
        close(base.x.into(), PER_MM, row[4], MM);
        close(base.y.into(), PER_MM, row[5], MM);
        close(base.z.into(), PER_MM, row[6], MM);
        close(base.theta.into(), PER_DEGREE, row[7], DEGREE);
    }
}

#[test]
fn unreachable_table() {
    let rows = table(include_str!("../../tests/golden/h4_unreachable.csv"), 5);
    assert_eq!(rows.len(), 200);
    for row in rows {
        assert!(arm().inverse(&pose(&row)).is_err(), "{row:?}");
    }
}

#[test]
fn printed_poses_of_the_reference_geometry() {
    let rows = [
        (
            [0., 0., 21.232, 0., 0.],
            [1135.000004, 484.999996, 1135.000004, 484.999996],
        ),
        (
            [-30., 0., 21.232, 0., 0.],
            [1105.000004, 454.999996, 1105.000004, 454.999996],
        ),
        (
            [-15., 15., 19.232, 0., 0.],
            [1130.798758, 459.201242, 1103.226509, 486.773491],
        ),
        (
            [10., -5., 40., 10., 0.],
            [1215.541455, 546.012270, 1192.435266, 499.659187],
        ),
        (
            [10., -5., 40., 0., 15.],
            [1148.085804, 491.914196, 1174.161314, 465.838686],
        ),
        (
            [-20., 12., 60., -12., 20.],
            [1065.760027, 368.701790, 1126.184311, 391.442182],
        ),
    ];
    for (place, want) in rows {
        let joints = arm().inverse(&pose(&place)).unwrap();
        for i in 0..4 {
            close(joints.0[i], PER_MM, want[i], MM);
        }
    }
    let rows = [
        ([1135., 485., 1135., 485.], [810., 0., -578.768004, 0.]),
        (
            [1120., 480., 1110., 470.],
            [782.5, 0.154207, -582.907941, 2.865984],
        ),
        (
            [1150., 470., 1130., 500.],
            [818.75, 13.912619, -575.827061, -1.432544],
        ),
    ];
    for (place, want) in rows {
        let base = arm().base_pose(&slides(&place)).unwrap();
        close(base.x.into(), PER_MM, want[0], MM);
        close(base.y.into(), PER_MM, want[1], MM);
        close(base.z.into(), PER_MM, want[2], MM);
        // Printed with six decimals of a degree.
        close(base.theta.into(), PER_DEGREE, want[3], DEGREE);
    }
}

#[test]
fn printed_slopes_at_home() {
    // The table's rows are d l / d (x, y, z, theta) in mm/mm and mm/rad; at alpha = 0 table and
    // base coordinates agree.
    let want = [
        [1., 0.90909, 1.10461, 350.],
        [1., -0.90909, -1.10461, 350.],
        [1., -0.90909, 1.10461, 150.],
        [1., 0.90909, -1.10461, 150.],
    ];
    let home = slides(&[1135., 485., 1135., 485.]);
    let home = arm().forward(&home).unwrap();
    let slopes = arm().jacobian(&home).unwrap();
    let one = 4_294_967_296.0;
    // Raw lengths per raw angle to millimetres per radian.
    let per_radian = 1.0 / (2.0 * std::f64::consts::PI * PER_MM);
    for i in 0..4 {
        for j in 0..3 {
            let got = slopes.0[i][j] as f64 / one;
            assert!((got - want[i][j]).abs() < 6e-6, "{i} {j} {got}");
        }
        let got = slopes.0[i][3] as f64 * per_radian;
        assert!((got - want[i][3]).abs() < 1e-6, "{i} {got}");
    }
}
