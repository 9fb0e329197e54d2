//! Calibration of the H-4 arm through its controller: lengths and index positions of the simulated
//! arm that differ are found from readings of a laser tracker, and the tip is right elsewhere.

use haptimill_calibration::arm::{Plan, calibrate, perturbed};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_machine_file::MachineFile;

#[test]
fn the_arm_is_found_and_its_tip_is_right_elsewhere() {
    let machine = MachineFile::built_in().unwrap();
    let other = perturbed(&machine, 0.1, 1).unwrap();
    assert_eq!(other.config, machine.config, "the controller knows nothing");
    let plan = Plan::default();
    let found = calibrate(&other, &plan, &Default::default(), |_| ()).unwrap();
    println!("{found}");
    // The distances are those of a tracker with 2 um a coordinate.
    let noise = plan.noise * 3.0_f64.sqrt();
    assert!(found.fit.before.rms > 0.1, "{:?}", found.fit);
    assert!(
        (found.fit.after.rms / noise - 1.0).abs() < 0.15,
        "{:?}",
        found.fit
    );
    assert!(found.before.largest > 0.1, "{:?}", found.before);
    assert!(found.after.largest < 0.005, "{:?}", found.after);
    // The file has the simulated arm as it was, and another controller.
    assert_ne!(found.machine.config, machine.config);
    assert_eq!(
        format!("{:?}", found.machine.plant::<PlantConfig>().unwrap()),
        format!("{:?}", other.plant::<PlantConfig>().unwrap())
    );
}

/// Another machine than the arm is refused before anything moves.
#[test]
fn another_machine_is_refused() {
    let mill = haptimill_calibration::scenario::machine().unwrap();
    let refused = calibrate(&mill, &Plan::default(), &Default::default(), |_| ()).unwrap_err();
    assert!(refused.message.contains("is no H-4 arm"), "{refused}");
    assert!(perturbed(&mill, 0.1, 1).is_err());
}
