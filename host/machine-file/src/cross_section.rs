//! Cross-section checks: checks that compare several sections of a machine file.

use super::document::Document;
use super::scale;
use haptimill_firmware::config::Config;
use haptimill_kinematics::{Joints, Kinematics, PoseError};
use haptimill_protocol::message::ConfigField;
use toml::de::{DeTable, DeValue};

/// Checks that the presets give a pose within the soft limits. Every job starts there.
pub(super) fn check_home_pose(document: &Document<'_>, root: &DeTable<'_>, config: &Config) {
    let mut preset = Joints::default();
    for (joint, axis) in preset.0.iter_mut().zip(&config.joints) {
        *joint = axis.preset;
    }
    let offset = root.get("joint").map_or(0, |value| value.span().start);
    let pose = match config.kinematics().forward(&preset) {
        Ok(pose) => pose,
        Err(error) => {
            let (what, remedy) = match error {
                PoseError::NearSingularity { distance } => (
                    format!(
                        "at the presets of the joints the singularity distance is {:.3} mm, below \
                         its margin",
                        f64::from(distance) / scale::PER_MM
                    ),
                    "correct the presets, the branch of [kinematics] or the margin",
                ),
                PoseError::Geometry { code } => {
                    let errors = config.model.descriptor().errors;
                    let sentence = errors
                        .get(usize::from(code))
                        .map_or("the geometry refuses it", |error| error.sentence);
                    (format!("the presets of the joints: {sentence}"), "")
                }
                PoseError::Unreachable | PoseError::OutOfStroke { .. } => (
                    "the presets of the joints give no pose of this geometry".to_string(),
                    "correct the presets or the geometry",
                ),
            };
            document.report(offset, "joint", what, remedy);
            return;
        }
    };
    let machine = config.model.descriptor();
    for ((value, axis), described) in pose.0.iter().zip(&config.pose).zip(machine.pose) {
        let name = described.name;
        if *value < axis.low || *value > axis.high {
            let value = f64::from(value.0) / scale::per_unit(axis.kind);
            let what = format!(
                "at the presets of the joints {name} is {value:.3}, outside its soft limits"
            );
            document.report(
                offset,
                "joint",
                what,
                "correct the presets or the soft limits",
            );
        }
    }
}

/// Checks that a machine with force control or a master has the roles for them.
pub(super) fn check_roles(document: &Document<'_>, root: &DeTable<'_>, config: &Config) {
    let machine = config.model.descriptor();
    if machine.pose.is_empty() {
        return;
    }
    for (section, is_there, purpose) in [
        (
            "force",
            config.force.is_some() && !machine.has_force_axes(),
            "force control moves x, y and z of the tool",
        ),
        (
            "follow",
            config.follow.is_some() && !machine.has_guided_tool(),
            "a master moves x, y and z of the tool, its tilt and the rotation of the workpiece",
        ),
    ] {
        if is_there {
            let offset = root.get(section).map_or(0, |value| value.span().start);
            let what = format!(
                "{purpose}, in this order; the coordinates of the model \"{}\" have other roles",
                machine.code
            );
            let remedy = format!("remove the section [{section}]");
            document.report(offset, section, what, remedy);
        }
    }
}

/// Applies the controller's own check, which is stricter than the ranges of single keys.
pub(super) fn check_by_controller(document: &Document<'_>, root: &DeTable<'_>, config: &Config) {
    let Err(problem) = config.check() else {
        return;
    };
    let offset = |section: &str| root.get(section).map_or(0, |value| value.span().start);
    let machine = config.model.descriptor();
    let index = problem.index.map(usize::from);
    let (list, name) = if problem.is_of_pose() {
        let axis = index.and_then(|index| machine.pose.get(index));
        ("pose", axis.map(|axis| axis.name))
    } else {
        // The second motors of gantries come after the joints of the model.
        let joint = index.and_then(|index| machine.joints.get(index));
        ("joint", joint.map(|joint| joint.name))
    };
    if problem.field == ConfigField::StopTime {
        document.report(
            offset("stopping"),
            "stopping",
            format!(
                "from its full rate {} would decelerate with more than four times its acceleration",
                name.unwrap_or("a coordinate")
            ),
            "raise time_ms, lower ramp_ms or raise the acceleration",
        );
        return;
    }
    let of = name.map_or(String::new(), |name| format!(" of {name}"));
    let what = format!("the controller would refuse this: {}{of}", problem.field);
    let remedy = "see docs/machine-files.md for the limits of the controller";
    let section = index.and_then(|index| match root.get(list)?.get_ref() {
        DeValue::Array(sections) => Some((index, sections.get(index)?.span().start)),
        _ => None,
    });
    match section {
        Some((index, offset)) => {
            document.report(offset, format!("{list}[{}]", index + 1), what, remedy);
        }
        None => document.report(0, "", what, remedy),
    }
}
