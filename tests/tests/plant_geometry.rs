//! Simulated geometry of every machine file, against the roles of its coordinates and the
//! conservation of power: a mistake here moves the machine rightly, and cuts wrongly.

use haptimill_firmware::config::AxisKind;
use haptimill_hil_sim::config::PlantConfig;
use haptimill_kinematics::{Kinematics, Pose};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::tool_axis;
use haptimill_machine_file::scale::per_unit;
use haptimill_math::Coordinate;
use haptimill_tests::storm::rng::Rng;
use std::path::Path;

/// Poses that are tried on each machine.
const POSES: usize = 200;

/// A random pose within the soft limits, mm and degrees, and its joint positions; `None` out of
/// reach.
fn draw(machine: &MachineFile, rng: &mut Rng) -> Option<([f64; 6], [f64; 6])> {
    let mut pose = Pose::default();
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
        pose.0[index] = Coordinate((values[index] * unit) as i32);
    }
    let joints = machine.config.kinematics().inverse(&pose).ok()?;
    let mut positions = [0.0; 6];
    for (index, joint) in machine.config.joints.iter().enumerate() {
        // A second motor of a gantry is where the first one is.
        let of = machine.config.model.descriptor().joints.len();
        if index < of {
            positions[index] = f64::from(joints.0[index].0) / per_unit(joint.kind);
        }
    }
    Some((values, positions))
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
        check(&name, &machine, &plant);
        checked += 1;
    }
    assert!(checked >= 16, "{checked} machine files");
}
