//! Check of the `[plant]` section by the simulator, with the lines of its problems.

use super::document::Document;
use super::pose_difference::{ERROR, PoseDifference};
use super::{MachineFile, Problems};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::plant::Plant;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Reports every problem of the simulated machine, and its differences from the controller.
pub(super) fn check(document: &Document<'_>, root: &DeTable<'_>, machine: &MachineFile) {
    let offset = root.get("plant").map_or(0, |value| value.span().start);
    match machine.plant::<PlantConfig>() {
        Err(Problems(problems, _)) => problems.into_iter().for_each(|p| document.add(p)),
        Ok(plant) => {
            if plant.joint.len() != machine.config.joints.len() {
                let what = format!(
                    "has {} joints, the controller {}",
                    plant.joint.len(),
                    machine.config.joints.len()
                );
                document.report(offset, "plant.joint", what, "write one for each joint");
            } else {
                check_joint_names(document, root, &plant, machine);
            }
            let model = machine.config.model.descriptor().code;
            if !machine.is_master()
                && let Some(geometry) = plant.geometry.as_ref().filter(|it| it.model() != model)
            {
                let (offset, key) = place_in_plant(root, "geometry");
                let what = format!(
                    "is \"{}\", the model of [kinematics] is \"{model}\"",
                    geometry.model()
                );
                document.report(offset, key, what, format!("write [plant.geometry.{model}]"));
            }
            // The machine is built as a simulator builds it, so nothing is refused later.
            for error in Plant::new(&plant, machine.config.period_us)
                .err()
                .unwrap_or_default()
            {
                let (offset, key) = place_in_plant(root, &error.field);
                document.report(offset, key, error.problem, "");
            }
            if document.is_valid() && !machine.is_master() {
                check_poses(document, root, &plant, machine);
            }
        }
    }
}

/// Values of each coordinate in the comparison of poses that every command makes.
const LEVELS: u32 = 3;

/// Checks that the simulated machine is the one that the controller computes.
fn check_poses(
    document: &Document<'_>,
    root: &DeTable<'_>,
    plant: &PlantConfig,
    machine: &MachineFile,
) {
    let difference = PoseDifference::new(machine, plant, LEVELS);
    if let Some(difference) = difference.filter(PoseDifference::is_another_machine) {
        let (offset, key) = place_in_plant(root, "geometry");
        let what = format!(
            "the simulated machine is another one than that of [kinematics]: {difference} (at most \
             {ERROR} mm and {ERROR} deg)"
        );
        let remedy = "correct [plant.geometry], [kinematics] or the presets of [[plant.joint]]";
        document.report(offset, key, what, remedy);
    }
}

/// Checks that plant and controller have the same joint names, which faults and reports use.
fn check_joint_names(
    document: &Document<'_>,
    root: &DeTable<'_>,
    plant: &PlantConfig,
    machine: &MachineFile,
) {
    for (index, (plant, joint)) in plant.joint.iter().zip(&machine.joints).enumerate() {
        if plant.name != joint.name {
            let (offset, key) = place_in_plant(root, &format!("joint {index}: name"));
            let (here, there) = (&plant.name, &joint.name);
            let what = format!("is \"{here}\", the controller's joint is \"{there}\"");
            document.report(offset, key, what, "give it the same name");
        }
        let of = machine.config.joints.get(index).and_then(|axis| {
            let gantry = axis.gantry.as_ref()?;
            Some(machine.joints.get(usize::from(gantry.of))?.name.as_str())
        });
        if plant.gantry_of.as_deref() != of {
            let (offset, key) = place_in_plant(root, &format!("joint {index}: gantry_of"));
            let (what, remedy) = match of {
                Some(of) => (
                    format!("the controller's joint is the second motor of \"{of}\""),
                    format!("write gantry_of = \"{of}\""),
                ),
                None => (
                    "the controller's joint is no second motor".to_string(),
                    "remove the key".to_string(),
                ),
            };
            document.report(offset, key, what, remedy);
        }
    }
}

/// Returns the value of a key of a table.
fn inside<'d, 'i>(
    value: Option<&'d Spanned<DeValue<'i>>>,
    key: &str,
) -> Option<&'d Spanned<DeValue<'i>>> {
    match value?.get_ref() {
        DeValue::Table(table) => table.get(key),
        _ => None,
    }
}

/// Returns the place of a field of the simulator, and its key in the notation of the other
/// sections: `joint 0 (x): drive: limit` is `plant.joint[1].drive.limit`. A part that the file
/// does not have is at the place of its section.
fn place_in_plant(root: &DeTable<'_>, field: &str) -> (usize, String) {
    let mut key = String::from("plant");
    let mut value = root.get("plant");
    let mut offset = value.map_or(0, |value| value.span().start);
    for part in field.split(": ") {
        let index = part
            .strip_prefix("joint ")
            .and_then(|rest| rest.split(' ').next()?.parse::<usize>().ok());
        value = match index {
            Some(index) => {
                key.push_str(&format!(".joint[{}]", index + 1));
                inside(value, "joint").and_then(|joints| match joints.get_ref() {
                    DeValue::Array(joints) => joints.get(index),
                    _ => None,
                })
            }
            None => {
                key.push_str(&format!(".{part}"));
                inside(value, part)
            }
        };
        offset = value.map_or(offset, |value| value.span().start);
    }
    (offset, key)
}
