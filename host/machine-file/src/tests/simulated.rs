//! The simulated machine of a file, compared with the machine that the file describes.

use super::{STEP, problems};
use crate::pose_difference::PoseDifference;
use crate::*;
use haptimill_hil_sim::config::PlantConfig;

#[test]
fn master_has_the_same_haptic_arm_and_reports_missing_sections() {
    let master = MachineFile::built_in_master().unwrap();
    let with_arm = MachineFile::built_in().unwrap().with_haptic_arm().unwrap();
    assert_eq!(master.config.haptic, with_arm.config.haptic);
    assert_eq!(master.config.period_us, with_arm.config.period_us);
    assert!(master.is_master() && !with_arm.is_master());
    assert_eq!(master.config.check(), Ok(()));
    // The simulated arm and the operator model are the same, too.
    let plant = |machine: &MachineFile| machine.plant::<PlantConfig>().unwrap();
    assert_eq!(plant(&master).haptic, plant(&with_arm).haptic);
    assert_eq!(plant(&master).operator, plant(&with_arm).operator);
    // A machine follows a remote master as it follows a haptic arm on its own board.
    let remote = MachineFile::built_in().unwrap().with_follow().unwrap();
    assert_eq!(remote.config.follow, with_arm.config.follow);
    assert!(remote.config.haptic.is_none());
    let twice = remote.with_follow().unwrap();
    assert_eq!(twice.text, remote.text);

    let reported = |text: &str| MachineFile::parse("m.toml", text).unwrap_err().to_string();
    let without = MASTER.replace("role = \"master\"", "role = \"leader\"");
    assert!(
        reported(&without).contains("\"leader\" is not known; write \"machine\" or \"master\""),
        "{}",
        reported(&without)
    );
    let homing = format!("{MASTER}\n[homing]\nrate_mm_s = 5.0\n");
    assert!(
        reported(&homing).contains("homing"),
        "{}",
        reported(&homing)
    );
    let bare = "format = 2\nname = \"m\"\nrole = \"master\"\nperiod_us = 200\n";
    let bare = reported(bare);
    assert!(
        bare.contains("[supervision]") && bare.contains("[haptic]"),
        "{bare}"
    );
}

#[test]
fn simulated_geometry_of_another_model_is_reported() {
    let text = include_str!("../../../../machines/mill3-servo.toml");
    let start = text.find("[plant.geometry.cartesian]").unwrap();
    let end = start + text[start..].find("[plant.spindle]").unwrap();
    let other = format!(
        "{}[plant.geometry.joints]\n\n{}",
        &text[..start],
        &text[end..]
    );
    let problems = MachineFile::parse("mill", &other).unwrap_err().to_string();
    assert!(
        problems.contains("write [plant.geometry.cartesian]"),
        "{problems}"
    );
    assert!(MachineFile::parse("mill", text).is_ok());
}

/// [`BUILT_IN`] with another length of the simulated rods, mm.
fn with_true_rods(length: f64) -> String {
    let (controller, plant) = BUILT_IN.split_once("[plant]").expect("a plant");
    let plant = plant.replacen("r = 480.0", &format!("r = {length:.1}"), 1);
    format!("{controller}[plant]{plant}")
}

/// The largest pose difference of the machine with rods of this length.
fn rod_difference(length: f64) -> PoseDifference {
    let machine = MachineFile::parse("rods.toml", &with_true_rods(length))
        .unwrap_or_else(|problems| panic!("{length}: {problems}"));
    let plant = machine.plant().expect("a plant");
    PoseDifference::new(&machine, &plant, 5).expect("a geometry")
}

#[test]
fn poses_of_a_simulated_machine_with_other_rods_differ() {
    let same = rod_difference(480.0);
    assert!(same.compared > 100, "{same:?}");
    assert!(!same.is_notable() && same.largest() < 1e-4, "{same:?}");

    // At the presets the rods descend sqrt(R^2 - 275^2 - 250^2) mm: 304.27 with R = 480. Half a
    // millimetre more is 0.789 mm there, and more where the rods are flatter.
    let longer = rod_difference(480.5);
    assert!(longer.is_notable() && !longer.is_another_machine());
    assert!((0.789..5.0).contains(&longer.linear_mm), "{longer}");
    let text = longer.to_string();
    assert!(text.contains("mm, theta = "), "{text}");

    let problems = problems(&with_true_rods(520.0));
    assert!(problems.contains("plant.geometry"), "{problems}");
    assert!(problems.contains("is another one"), "{problems}");
}

/// A simulated joint that starts elsewhere is another machine, too.
#[test]
fn presets_of_the_simulated_machine_are_compared() {
    let (controller, plant) = BUILT_IN.split_once("[plant]").expect("a plant");
    let all = plant.replacen("preset = 1135.0", "preset = 1105.0", 1);
    let problems = problems(&format!("{controller}[plant]{all}"));
    assert!(problems.contains("is another one"), "{problems}");
}

/// Whoever enters the lead, the steps or the switch of his machine for the controller alone had "no
/// problem", and a simulated cut 54 mm beside the block.
#[test]
fn steps_counts_and_switches_of_the_simulated_machine_are_compared() {
    let mill = include_str!("../../../../machines/mill3.toml");
    let servo = include_str!("../../../../machines/mill3-servo.toml");
    for (text, from, to, key, what) in [
        (
            mill,
            "lead_mm = 5.0",
            "lead_mm = 4.0",
            "plant.joint[1].drive",
            "a step moves the simulated joint by 0.001563 mm, the controller computes 0.001250 mm",
        ),
        (
            mill,
            "steps_per_turn = 3200",
            "steps_per_turn = 1600",
            "plant.joint[1].drive",
            "the controller computes 0.003125 mm",
        ),
        (
            servo,
            "counts_per_turn = 8000",
            "counts_per_turn = 4000",
            "plant.joint[1].encoder",
            "a count moves the simulated joint by",
        ),
        (
            mill,
            "at_mm = -150.0",
            "at_mm = -140.0",
            "plant.joint[1].home",
            "the switch is at -150 mm, the controller expects it at -140 mm",
        ),
        (
            servo,
            "index_mm = -0.9",
            "index_mm = 0.9",
            "plant.joint[2].encoder",
            "the index pulses are at -0.9 mm and whole turns of the motor from it, the controller \
             expects one at 0.9 mm",
        ),
        (
            mill,
            "low = -160.0",
            "low = -154.0",
            "plant.joint[1].low",
            "the hard stop of the simulated joint is at -154 mm, the stroke of the controller ends \
             at -155 mm",
        ),
        (
            mill,
            "high_mm = 155.0",
            "high_mm = 165.0",
            "plant.joint[1].high",
            "is at 160 mm, the stroke of the controller ends at 165 mm",
        ),
    ] {
        assert!(MachineFile::parse("machine.toml", text).is_ok());
        assert!(text.contains(from), "{from}");
        let problems = problems(&text.replacen(from, to, 1));
        assert!(
            problems.contains(key) && problems.contains(what),
            "{to}: {problems}"
        );
    }
}

/// A machine file without a problem has a simulated machine that can be built: nothing is refused
/// by `run` or `sim serve` that was accepted before.
#[test]
fn a_simulated_machine_that_cannot_be_built_is_reported() {
    let with_arm = |from: &str, to: &str| {
        assert!(HAPTIC_ARM.contains(from), "{from}");
        let arm = HAPTIC_ARM.replacen(from, to, 1);
        problems(&format!("{BUILT_IN}\n{arm}"))
    };
    assert_eq!(with_arm("[follow]", "[follow]"), "no problem\n");
    // The legs of the arm do not reach 450 mm above its home.
    let reported = with_arm("start_mm = [0.0, 0.0, 0.0]", "start_mm = [0.0, 0.0, 450.0]");
    assert!(reported.contains("plant.haptic.start_mm"), "{reported}");
    for file in [
        BUILT_IN,
        STEP,
        include_str!("../../../../machines/mill3-servo.toml"),
    ] {
        // Each part of the process at the tool may be missing.
        for part in ["spindle", "cutter", "structure", "sensor"] {
            let key = format!("[plant.{part}]");
            let Some(start) = file.find(&key) else {
                continue;
            };
            let length = file[start + 1..].find("\n[").expect("a section behind") + 1;
            let without = format!("{}{}", &file[..start], &file[start + length..]);
            if let Ok(machine) = MachineFile::parse("without", &without) {
                let plant: PlantConfig = machine.plant().expect("a plant");
                let built = haptimill_hil_sim::plant::Plant::new(&plant, machine.config.period_us);
                assert!(built.is_ok(), "{part}: {:?}", built.err());
            }
        }
    }
}
