//! What no section of a machine file says alone.

use super::document::Document;
use super::{h4, scale};
use haptimill_firmware::config::Config;
use haptimill_kinematics::{Joints, Kinematics};
use haptimill_protocol::message::ConfigField;
use toml::de::DeTable;

/// The pose at the home preset must exist and lie inside the soft limits: that is where every job begins.
pub(super) fn home_pose(document: &Document<'_>, root: &DeTable<'_>, config: &Config) {
    let mut preset = Joints::default();
    for (joint, axis) in preset.0.iter_mut().zip(&config.joints) {
        *joint = axis.preset;
    }
    let offset = root.get("joint").map_or(0, |value| value.span().start);
    let pose = match config.kinematics().forward(&preset) {
        Ok(pose) => pose,
        Err(error) => {
            let what = format!(
                "the presets of the joints hold no pose of this geometry ({})",
                crate::model::pose_error_code(error)
            );
            document.report(offset, "joint", what, "correct the presets or the geometry");
            return;
        }
    };
    for ((value, axis), (name, _)) in pose.0.iter().zip(&config.pose).zip(h4::POSE) {
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

/// What the controller would refuse, whatever the sections say one by one: its own check has the last word.
pub(super) fn acceptable(document: &Document<'_>, root: &DeTable<'_>, config: &Config) {
    let Err(problem) = config.check() else {
        return;
    };
    let offset = |section: &str| root.get(section).map_or(0, |value| value.span().start);
    let axis = problem.axis.map_or("", |axis| {
        let name = h4::POSE.get(usize::from(axis));
        name.map_or("an axis", |(name, _)| *name)
    });
    match problem.field {
        ConfigField::StopTime => document.report(
            offset("stopping"),
            "stopping",
            format!(
                "from its full rate {axis} would brake with more than four times its acceleration"
            ),
            "raise time_ms, lower ramp_ms or raise the acceleration",
        ),
        field => document.report(
            0,
            "",
            format!("the controller would refuse this: {field} {axis}").trim_end(),
            "correct it",
        ),
    }
}
