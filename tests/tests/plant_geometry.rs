//! Simulated geometry of every machine file, against the roles of its coordinates, the conservation
//! of power, and what force control assumes: a mistake here moves the machine rightly, and cuts or
//! measures wrongly.

use haptimill_firmware::config::AxisKind;
use haptimill_hil_sim::config::PlantConfig;
use haptimill_kinematics::{Kinematics, Pose};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::tool_axis;
use haptimill_machine_file::scale::per_unit;
use haptimill_math::Coordinate;
use haptimill_tests::fuzz::rng::Rng;
use std::path::Path;

/// Poses that are tried on each machine.
const POSES: usize = 200;

/// A random pose within the soft limits, mm and degrees, and its joint positions; `None` out of
/// reach.
fn draw(machine: &MachineFile, rng: &mut Rng) -> Option<([f64; 6], [f64; 6])> {
    let mut values = [0.0; 6];
    for (index, axis) in machine.config.pose.iter().enumerate() {
        let unit = per_unit(axis.kind);
        let ends = [axis.low, axis.high].map(|end| f64::from(end.0) / unit);
        // One that wraps around has no limits.
        let [low, high] = if ends[0] < ends[1] {
            ends
        } else {
            [-179.0, 179.0]
        };
        values[index] = rng.uniform(low, high);
    }
    Some((values, joints_of(machine, &values)?))
}

/// A pose in the units of the controller.
fn in_units(machine: &MachineFile, values: &[f64; 6]) -> Pose {
    let mut pose = Pose::default();
    for (index, axis) in machine.config.pose.iter().enumerate() {
        pose.0[index] = Coordinate((values[index] * per_unit(axis.kind)).round() as i64 as i32);
    }
    pose
}

/// The joint positions of a pose, mm and degrees; `None` out of reach.
fn joints_of(machine: &MachineFile, pose: &[f64; 6]) -> Option<[f64; 6]> {
    let pose = in_units(machine, pose);
    let joints = machine.config.kinematics().inverse(&pose).ok()?;
    let mut positions = [0.0; 6];
    for (index, joint) in machine.config.joints.iter().enumerate() {
        // A second motor of a gantry is where the first one is.
        let of = machine.config.model.descriptor().joints.len();
        if index < of {
            positions[index] = f64::from(joints.0[index].0) / per_unit(joint.kind);
        }
    }
    Some(positions)
}

/// Checks the controller's knowledge of the force sensor: along which directions a pose moves the
/// tool under force control, and how the weight on the sensor turns.
fn check_sensor(name: &str, machine: &MachineFile, plant: &PlantConfig) {
    if !machine.config.model.descriptor().has_force_axes() {
        return;
    }
    let geometry = plant.geometry.as_ref().expect("checked before");
    let kinematics = machine.config.kinematics();
    let mut rng = Rng::new(8, 0);
    let mut compared = 0;
    for _ in 0..POSES {
        let Some((pose, joints)) = draw(machine, &mut rng) else {
            continue;
        };
        let (Some([workpiece, sensor]), Some(tool)) =
            (geometry.frames(&joints), geometry.tool(&joints))
        else {
            continue;
        };
        let [tilt, turn] = kinematics
            .sensor_rotation(&in_units(machine, &pose))
            .map(|angle| f64::from(angle.0) / 2f64.powi(32) * std::f64::consts::TAU);
        let upwards = [tilt.sin() * turn.sin(), tilt.sin() * turn.cos(), tilt.cos()];
        for (axis, expected) in sensor.iter().zip(upwards) {
            assert!(
                (axis[2] - expected).abs() < 0.002,
                "{name} at {pose:?}: upwards is {:?} along the sensor, {upwards:?} by the controller",
                sensor.map(|axis| axis[2])
            );
        }
        for direction in 0..3 {
            let step = 0.01;
            let mut moved = pose;
            moved[direction] += step;
            let Some(after) = joints_of(machine, &moved).and_then(|joints| geometry.tool(&joints))
            else {
                continue;
            };
            let by = [0, 1, 2].map(|index| (after.tip[index] - tool.tip[index]) / step);
            let in_machine = [0, 1, 2].map(|row| {
                let parts = workpiece.iter().zip(by);
                parts.map(|(axis, by)| axis[row] * by).sum::<f64>()
            });
            for (index, axis) in sensor.iter().enumerate() {
                let along: f64 = axis.iter().zip(in_machine).map(|(a, b)| a * b).sum();
                let expected = if index == direction { 1.0 } else { 0.0 };
                assert!(
                    (along - expected).abs() < 0.01,
                    "{name} at {pose:?}: coordinate {direction} moves the tool {along} along \
                     axis {index} of the sensor"
                );
            }
            compared += 1;
        }
    }
    assert!(compared > POSES / 10, "{name}: {compared} directions");
}

fn check(name: &str, machine: &MachineFile, plant: &PlantConfig) {
    let geometry = plant.geometry.as_ref().expect("checked before");
    let descriptor = machine.config.model.descriptor();
    let axis = tool_axis(descriptor);
    let mut rng = Rng::new(7, 0);
    let (mut compared, mut axes) = (0, 0);
    for _ in 0..POSES {
        let Some((pose, joints)) = draw(machine, &mut rng) else {
            continue;
        };
        let Some(tool) = geometry.tool(&joints) else {
            continue;
        };
        // The pose of some machines is not that of the tip in the workpiece, and what the faceting
        // machine tilts is a stone, which has no length in a tool table.
        let is_at_tip =
            name != "facet.toml" && (0..3).all(|index| (tool.tip[index] - pose[index]).abs() < 0.1);
        if descriptor.tool_tip().is_some() && is_at_tip {
            axes += 1;
            let expected = axis.direction(&pose);
            for (found, expected) in tool.axis.iter().zip(expected) {
                assert!(
                    (found - expected).abs() < 0.01,
                    "{name} at {pose:?}: axis of the tool {:?}, by the roles {expected:?}",
                    tool.axis
                );
            }
        }
        let force = [0; 3].map(|_| rng.uniform(-50.0, 50.0));
        let above = rng.uniform(0.0, 8.0);
        let mut rates = [0.0; 6];
        for rate in rates.iter_mut().take(descriptor.joints.len()) {
            *rate = rng.uniform(-1.0, 1.0);
        }
        let point = |time: f64| {
            let moved = std::array::from_fn(|index| joints[index] + time * rates[index]);
            let tool = geometry.tool(&moved)?;
            Some([0, 1, 2].map(|index| tool.tip[index] + above * tool.axis[index]))
        };
        let step = 1e-4;
        let (Some(before), Some(after)) = (point(-step), point(step)) else {
            continue;
        };
        let Some(loads) = geometry.loads(&joints, force, above) else {
            continue;
        };
        let outside: f64 = (0..3)
            .map(|index| force[index] * (after[index] - before[index]) / (2.0 * step))
            .sum();
        let inside: f64 = descriptor
            .joints
            .iter()
            .enumerate()
            .map(|(index, _)| {
                // N m and degrees per second to N mm per second.
                let unit = match machine.config.joints[index].kind {
                    AxisKind::Linear => 1.0,
                    AxisKind::Rotary | AxisKind::MultiTurn => 1e3_f64.to_radians(),
                };
                loads[index] * rates[index] * unit
            })
            .sum();
        let scale = outside.abs().max(10.0);
        assert!(
            (outside - inside).abs() < 1e-3 * scale,
            "{name} at {pose:?}: power of the force {outside}, of the joints {inside} N mm/s"
        );
        compared += 1;
    }
    assert!(compared > POSES / 10, "{name}: {compared} poses");
    let turns = axis.turns() && name != "facet.toml";
    assert!(!turns || axes > POSES / 10, "{name}: {axes} axes");
}

#[test]
fn the_tool_turns_by_its_roles_and_loads_conserve_power() {
    let machines = Path::new(env!("CARGO_MANIFEST_DIR")).join("../machines");
    let mut checked = 0;
    for entry in std::fs::read_dir(machines).expect("a folder") {
        let path = entry.expect("an entry").path();
        let name = path
            .file_name()
            .expect("a name")
            .to_string_lossy()
            .into_owned();
        let Ok(machine) = MachineFile::load(&path) else {
            continue;
        };
        let plant = machine.plant::<PlantConfig>();
        let Some(plant) = plant.ok().filter(|plant| plant.geometry.is_some()) else {
            continue;
        };
        // A file has a singularity margin if and only if its model has a singularity.
        let has_margin = std::fs::read_to_string(&path)
            .expect("text")
            .contains("\nsingularity_margin_mm");
        let distance = machine
            .config
            .kinematics()
            .singularity_distance(&Pose::default());
        assert_eq!(has_margin, distance.is_some(), "{name}");
        check(&name, &machine, &plant);
        check_sensor(&name, &machine, &plant);
        checked += 1;
    }
    assert!(checked >= 16, "{checked} machine files");
}
