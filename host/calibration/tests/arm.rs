//! Calibration of the H-4 arm: lengths and joint offsets that differ are found from readings of a
//! laser tracker, and the tip is right where it was not measured.

use haptimill_calibration::arm::{NAMES, fit, readings, tip};
use haptimill_calibration::noise::Noise;
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::machines::GeometryConfig;
use haptimill_hil_sim::machines::h4::ArmGeometry;
use haptimill_kinematics::{Kinematics, Pose};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_math::Coordinate;

fn nominal(machine: &MachineFile) -> ArmGeometry {
    let plant: PlantConfig = machine.plant().unwrap();
    match plant.geometry {
        Some(GeometryConfig::H4(geometry)) => geometry,
        _ => panic!("the built-in machine is an H-4 arm"),
    }
}

/// Joint positions of random poses about the home pose, mm and degrees.
fn poses(machine: &MachineFile, count: usize, seed: u64) -> Vec<[f64; 6]> {
    let model = Model::new(machine);
    let home = haptimill_client::session::find_home_pose(machine, &model).unwrap();
    let kinematics = machine.config.kinematics();
    let mut noise = Noise::new(seed, 0);
    let mut all = Vec::new();
    while all.len() < count {
        let mut pose = Pose::default();
        for (axis, value) in home.iter().enumerate() {
            let reach = if axis < 3 {
                60.0 * f64::from(1 << 20)
            } else {
                0.0
            };
            pose.0[axis] = Coordinate(value + (reach * noise.uniform()) as i32);
        }
        let Ok(joints) = kinematics.inverse(&pose) else {
            continue;
        };
        let mut values = [0.0; 6];
        for (index, joint) in machine.config.joints.iter().enumerate() {
            let unit = haptimill_machine_file::scale::per_unit(joint.kind);
            values[index] = f64::from(joints.0[index].0) / unit;
        }
        all.push(values);
    }
    all
}

#[test]
fn the_arm_is_found_and_its_tip_is_right_elsewhere() {
    let machine = MachineFile::built_in().unwrap();
    let nominal = nominal(&machine);
    let truth = [0.12, -0.05, 0.04, 0.03, -0.08, 0.06, -0.07, 0.05, -0.04];
    assert_eq!(truth.len(), NAMES.len());
    // A tracker of 2 um.
    let measured = readings(&nominal, &truth, &poses(&machine, 80, 1), 2e-3, 1);
    let fit = fit(&nominal, &measured).unwrap();
    println!("before {:?} mm, after {:?} mm", fit.before, fit.after);
    assert!(fit.before[0] > 0.05);
    // Three coordinates of 2 um each, less the fitted parameters.
    assert!((fit.after[0] - 3.4e-3).abs() < 0.4e-3, "{:?}", fit.after);
    // At poses that were not measured, without noise: the error table of the arm.
    let mut largest = [0.0_f64; 2];
    for joints in poses(&machine, 200, 2) {
        let exact = tip(&nominal, &truth, &joints).unwrap();
        for (by, largest) in [[0.0; 9], fit.by].iter().zip(&mut largest) {
            let model = tip(&nominal, by, &joints).unwrap();
            let off: f64 = exact
                .iter()
                .zip(model)
                .map(|(a, b)| (a - b) * (a - b))
                .sum();
            *largest = largest.max(off.sqrt());
        }
    }
    println!("largest error elsewhere {largest:?} mm");
    assert!(largest[0] > 0.1 && largest[1] < 5e-3, "{largest:?}");
}
