//! The table of keys of machine files, with those of all models.

use super::models;
use haptimill_kinematics::DESCRIPTORS;
use haptimill_kinematics::descriptor::AxisKind;
use haptimill_machine_keys::{Key, Section};

/// All sections, in the order of a machine file. Sections of one path follow each other.
#[must_use]
pub fn sections() -> Vec<Section> {
    let mut sections = Vec::new();
    for section in haptimill_machine_keys::sections() {
        if section.path == "plant.joint" {
            sections.extend(models::sections().map(|[_, plant]| plant));
        }
        sections.push(*section);
        if section.path == "kinematics" {
            sections.extend(models::sections().map(|[kinematics, _]| kinematics));
        }
    }
    sections
}

/// The keys of the section at a path without list indices, such as `joint.drive`; empty for a
/// section without keys in the table.
pub fn keys_of(path: &str) -> impl Iterator<Item = &'static Key> {
    sections()
        .into_iter()
        .filter(move |section| section.path == path)
        .flat_map(|section| section.keys)
}

/// Names and kinds of the coordinates and joints of a model in their order, as a sentence; empty
/// for an unknown model.
#[must_use]
pub fn axes_of(model: &str) -> String {
    let Some(machine) = DESCRIPTORS.iter().find(|it| it.code == model) else {
        return String::new();
    };
    // In the order of the model, which is that of the sections of a machine file.
    let list = |axes: &[(&str, AxisKind)]| {
        let groups = axes.chunk_by(|one, next| one.1 == next.1);
        let texts = groups.map(|group| {
            let names: Vec<_> = group.iter().map(|axis| axis.0).collect();
            let word = match group[0].1 {
                AxisKind::Linear => "linear",
                AxisKind::Rotary => "rotary",
                AxisKind::MultiTurn => "rotary, multi-turn",
            };
            format!("{} ({word})", names.join(", "))
        });
        texts.collect::<Vec<_>>().join(", ")
    };
    let pose: Vec<_> = machine.pose.iter().map(|it| (it.name, it.kind)).collect();
    let joints: Vec<_> = machine.joints.iter().map(|it| (it.name, it.kind)).collect();
    format!("Coordinates: {}. Joints: {}.", list(&pose), list(&joints))
}
