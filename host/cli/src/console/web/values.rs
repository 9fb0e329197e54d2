//! Values of the state as JSON: positions, the tool, work offsets, changes of the stock, and what
//! the page plots.

use super::super::view_model::{Axis, ViewModel};
use crate::commands::force::newtons;
use crate::commands::probe_cycle::kept_beside;
use haptimill_firmware::config::AxisKind;
use haptimill_gcode::{SYSTEM_NAMES, WorkOffset};
use haptimill_hil_sim::process::ToolPose;
use haptimill_kinematics::descriptor::Role;
use haptimill_machine_file::scale::per_unit;
use haptimill_machine_file::work_data::{WorkData, axis_index};
use haptimill_machine_file::{AxisLimits, MachineFile};
use haptimill_protocol::message::{AxisValues, FULL_PATH_RATE};
use serde_json::{Value, json};
use std::fmt::Write as _;

/// Numbers of a JSON array, to 1 um.
pub(super) fn numbers(values: &[f32]) -> String {
    let mut text = String::with_capacity(8 * values.len());
    for value in values {
        if !text.is_empty() {
            text.push(',');
        }
        // Writing to a string cannot fail; adding 0 makes -0 a 0.
        let _ = write!(text, "{}", (f64::from(*value) * 1e3).round() / 1e3 + 0.0);
    }
    text
}

/// The runs of heights that changed, as JSON arrays of an index and the heights from there on.
pub(super) fn changed_runs(before: &[f32], now: &[f32]) -> String {
    let mut text = String::new();
    let mut index = 0;
    while index < now.len() {
        let run = before[index..].iter().zip(&now[index..]);
        let length = run.take_while(|(before, now)| before != now).count();
        if length > 0 {
            let comma = if text.is_empty() { "" } else { "," };
            let heights = numbers(&now[index..index + length]);
            let _ = write!(text, "{comma}[{index},{heights}]");
        }
        index += length.max(1);
    }
    text
}

/// The work coordinate systems of a machine whose origin is not zero, in the order of its
/// coordinates; or why it has none.
pub(super) fn offsets(machine: &MachineFile) -> Value {
    let data = match kept_beside(machine) {
        Ok(file) => WorkData::load(&file),
        Err(error) => Err(error.message),
    };
    let data = match data {
        Ok(data) => data,
        Err(what) => return json!({ "error": what }),
    };
    let pose = machine.config.model.descriptor().pose;
    let systems = SYSTEM_NAMES.iter().zip(&data.offsets.systems);
    let is_set = |system: &WorkOffset| {
        system.rotation != 0.0 || system.origin.iter().any(|origin| *origin != 0.0)
    };
    let systems = systems
        .filter(|(_, system)| is_set(system))
        .map(|(name, system)| {
            let origin = pose.iter().map(|axis| {
                let index = axis_index(&axis.letter.to_string());
                index.map_or(0.0, |index| system.origin[index])
            });
            json!({
                "name": name,
                "origin": origin.collect::<Vec<_>>(),
                "rotation": system.rotation,
            })
        });
    json!({
        "letters": pose.iter().map(|axis| axis.letter.to_ascii_lowercase()).collect::<Vec<_>>(),
        "systems": systems.collect::<Vec<_>>(),
    })
}

pub(super) fn rows(
    view: &ViewModel,
    axes: &[Axis],
    commanded: Option<&AxisValues>,
    actual: Option<&AxisValues>,
    limits: &[AxisLimits],
) -> Vec<Value> {
    let rows = axes.iter().enumerate().map(|(index, axis)| {
        let limit = |value: f64| value.is_finite().then_some(value);
        let value = |values: Option<&AxisValues>| {
            let value = values?.get(index)?;
            Some(view.unwound(axis, *value) as f64 / per_unit(axis.kind))
        };
        json!({
            "name": axis.name,
            "unit": if axis.kind.is_rotary() { "deg" } else { "mm" },
            "commanded": value(commanded),
            "actual": value(actual),
            "low": limits.get(index).and_then(|it| limit(it.low)),
            "high": limits.get(index).and_then(|it| limit(it.high)),
        })
    });
    rows.collect()
}

/// Place of the tool tip, mm; none where the pose is not known.
pub(super) fn tip(machine: &MachineFile, pose: Option<&AxisValues>) -> Option<[f64; 3]> {
    let pose = pose.filter(|pose| !pose.is_empty())?;
    let parts = machine.config.model.descriptor().tool_tip_parts();
    Some(parts.map(|index| {
        let value = index.and_then(|index| pose.get(index)).copied();
        f64::from(value.unwrap_or(0)) / per_unit(AxisKind::Linear)
    }))
}

/// Unit vector from the tip towards the spindle, in the workpiece; none for a machine with a rotary
/// coordinate whose role does not say how it turns the tool.
pub(super) fn tool_axis(machine: &MachineFile, pose: Option<&AxisValues>) -> Option<[f64; 3]> {
    let pose = pose.filter(|pose| !pose.is_empty())?;
    let described = machine.config.model.descriptor().pose;
    let known = |role| matches!(role, Role::ToolTilt | Role::WorkpieceRotation);
    let mut turning = described.iter().zip(&machine.pose);
    if turning.any(|(axis, limits)| limits.kind.is_rotary() && !known(axis.role)) {
        return None;
    }
    let angle = |role| {
        let index = described.iter().position(|axis| axis.role == role);
        let value = index
            .and_then(|index| pose.get(index))
            .copied()
            .unwrap_or(0);
        f64::from(value) / per_unit(AxisKind::Rotary)
    };
    let tool = ToolPose::leaning(
        [0.0; 3],
        angle(Role::ToolTilt),
        angle(Role::WorkpieceRotation),
    );
    Some(tool.axis)
}

/// Further values that the page plots, by name.
pub(super) fn columns(view: &ViewModel) -> Value {
    let mut columns = serde_json::Map::new();
    let Some(now) = &view.telemetry else {
        return Value::Null;
    };
    for (axis, error) in view.static_info.joints.iter().zip(&now.following_error) {
        let unit = if axis.kind.is_rotary() { "mdeg" } else { "um" };
        let value = f64::from(*error) / per_unit(axis.kind) * 1e3;
        columns.insert(
            format!("following error {}, {unit}", axis.name),
            json!(value),
        );
    }
    for (axis, drive) in view.static_info.joints.iter().zip(&now.drive) {
        columns.insert(format!("drive {}", axis.name), json!(drive));
    }
    let rate = f64::from(now.path_rate) / f64::from(FULL_PATH_RATE) * 100.0;
    columns.insert("path rate, %".to_string(), json!(rate));
    columns.insert(
        "program line".to_string(),
        json!(view.program.as_ref().map(|it| it.line)),
    );
    if let Some(io) = &now.io {
        columns.insert("inputs, bits".to_string(), json!(io.inputs));
        columns.insert("outputs, bits".to_string(), json!(io.outputs));
    }
    if let Some(force) = &now.force {
        let (high, low) = (newtons(force.high), newtons(force.low));
        for (axis, name) in ["x", "y", "z"].iter().enumerate() {
            columns.insert(format!("force {name}, N"), json!(high[axis]));
            columns.insert(format!("opposite force {name}, N"), json!(low[axis]));
            let displacement = f64::from(force.displacement[axis]) / f64::from(1 << 20);
            columns.insert(format!("displacement {name}, mm"), json!(displacement));
        }
    }
    Value::Object(columns)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changed_heights_are_sent_as_runs() {
        let before = [1.0, 1.0, 1.0, 1.0, 1.0, 1.0];
        let now = [1.0, 0.5, 0.25, 1.0, 1.0, -0.0001];
        let runs: Value =
            serde_json::from_str(&format!("[{}]", changed_runs(&before, &now))).unwrap();
        assert_eq!(runs, json!([[1, 0.5, 0.25], [5, 0]]));
        assert_eq!(changed_runs(&before, &before), "");
        // A viewer that applies the runs has the new surface, to 1 um.
        let mut seen = before.map(f64::from);
        for run in runs.as_array().unwrap() {
            let run: Vec<f64> = run
                .as_array()
                .unwrap()
                .iter()
                .filter_map(Value::as_f64)
                .collect();
            let first = run[0] as usize;
            seen[first..first + run.len() - 1].copy_from_slice(&run[1..]);
        }
        assert!(
            seen.iter()
                .zip(now)
                .all(|(seen, now)| (seen - f64::from(now)).abs() < 1e-3)
        );
    }
}
