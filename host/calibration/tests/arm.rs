//! Calibration of the H-4 arm through its controller: lengths and index positions of the simulated
//! arm that differ are found from readings of a laser tracker, and the tip is right elsewhere.

use haptimill_calibration::arm::{NAMES, Plan, calibrate, perturbed};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::joint::mechanics::JointArray;
use haptimill_hil_sim::machines::GeometryConfig;
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
    // A tracker without noise finds the injected parameters, but for one motion that no pose shows:
    // w longer by d, x_off shorter by d, and the joints 2 and 4 behind by 2 d.
    let exact = Plan { noise: 0.0, ..plan };
    let exact = calibrate(&other, &exact, &Default::default(), |_| ()).unwrap();
    let injected = injected(&machine, &other);
    for (name, found, exact, injected) in [
        ("r", 0, 0, 0.0),
        ("c", 1, 1, 0.0),
        ("ge", 3, 3, 0.0),
        ("l1", 5, 5, 0.0),
        ("l3", 7, 7, 0.0),
        ("w + x_off", 2, 4, 1.0),
        ("l2 + 2 w", 6, 2, 2.0),
        ("l4 + 2 w", 8, 2, 2.0),
    ]
    .map(|(name, first, second, weight)| {
        let sum = |by: &[f64; NAMES.len()]| by[first] + weight * by[second];
        (name, sum(&found.fit.by), sum(&exact.fit.by), sum(&injected))
    }) {
        println!(
            "{name:<9} injected {injected:>8.4} found {found:>8.4}, without noise {exact:>8.4}"
        );
        assert!((exact - injected).abs() < 0.001, "{name}");
        // 2 um of noise in 120 readings.
        assert!((found - injected).abs() < 0.015, "{name}");
    }
    // The file has the simulated arm as it was, and another controller.
    assert_ne!(found.machine.config, machine.config);
    assert_eq!(
        format!("{:?}", found.machine.plant::<PlantConfig>().unwrap()),
        format!("{:?}", other.plant::<PlantConfig>().unwrap())
    );
}

/// Why only sums of four parameters are found: an arm with w longer by d, x_off shorter by d and
/// the joints 2 and 4 behind by 2 d has the same pose everywhere. One length alone moves it.
#[test]
fn one_motion_of_the_parameters_shows_nowhere() {
    let plant: PlantConfig = MachineFile::built_in().unwrap().plant().unwrap();
    let Some(GeometryConfig::H4(nominal)) = plant.geometry else {
        panic!("an arm");
    };
    let d = 0.1;
    let pose = |w: f64, x_off: f64, offset: f64, mut joints: JointArray| {
        let mut geometry = nominal.clone();
        geometry.w += w;
        geometry.x_off += x_off;
        joints[1] += offset;
        joints[3] += offset;
        GeometryConfig::H4(geometry).pose(&joints).unwrap()
    };
    for offsets in [[0.0; 4], [5.0, -8.0, 11.0, 3.0], [-20.0, 6.0, -9.0, 14.0]] {
        let mut joints = JointArray::default();
        joints[..4].copy_from_slice(&[1135.0, 485.0, 1135.0, 485.0]);
        for (joint, offset) in joints.iter_mut().zip(offsets) {
            *joint += offset;
        }
        let plain = pose(0.0, 0.0, 0.0, joints);
        let distance = |other: JointArray| {
            let pairs = plain.iter().zip(other);
            pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
        };
        let hidden = distance(pose(d, -d, -2.0 * d, joints));
        assert!(hidden < 1e-9, "{offsets:?}: {hidden}");
        for alone in [pose(d, 0.0, 0.0, joints), pose(0.0, -d, 0.0, joints)] {
            assert!(distance(alone) > 0.05, "{offsets:?}");
        }
    }
}

/// Lengths and index positions of a simulated arm less those of another one, mm, from the text of
/// their files.
fn injected(nominal: &MachineFile, other: &MachineFile) -> [f64; NAMES.len()] {
    let value = |machine: &MachineFile, name: &str| {
        let document: toml_edit::DocumentMut = machine.text.parse().unwrap();
        let plant = &document["plant"];
        let joints = plant["joint"].as_array_of_tables().unwrap();
        let joint = joints
            .iter()
            .find(|joint| joint["name"].as_str() == Some(name));
        let item = match joint {
            Some(joint) => &joint["encoder"]["index"],
            None => &plant["geometry"]["h4"][name],
        };
        item.as_float()
            .unwrap_or_else(|| item.as_integer().unwrap() as f64)
    };
    NAMES.map(|name| value(other, name) - value(nominal, name))
}

/// Another machine than the arm is refused before anything moves.
#[test]
fn another_machine_is_refused() {
    let mill = haptimill_calibration::scenario::machine().unwrap();
    let refused = calibrate(&mill, &Plan::default(), &Default::default(), |_| ()).unwrap_err();
    assert!(refused.message.contains("is no H-4 arm"), "{refused}");
    assert!(perturbed(&mill, 0.1, 1).is_err());
}
