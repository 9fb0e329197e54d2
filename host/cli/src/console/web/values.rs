//! Values of the state as JSON: positions, the tool, work offsets, changes of the stock, and what
//! the page plots.

use super::super::master::PER_REPORTED;
use super::super::view_model::{Axis, ViewModel};
use crate::commands::force::newtons;
use crate::commands::probe_cycle::kept_beside;
use crate::commands::status::path_speed;
use haptimill_firmware::config::AxisKind;
use haptimill_gcode::{SYSTEM_NAMES, WorkOffset};
use haptimill_hil_sim::haptics::geometry::HapticGeometry;
use haptimill_hil_sim::machines::{GeometryConfig, Picture};
use haptimill_hil_sim::plant::GroundTruth;
use haptimill_kinematics::descriptor::Role;
use haptimill_machine_file::model;
use haptimill_machine_file::scale::{PER_MM, per_unit};
use haptimill_machine_file::work_data::{WorkData, axis_index};
use haptimill_machine_file::{AxisLimits, IoNames, MachineFile};
use haptimill_protocol::haptic::{COMPONENT_NAMES, COMPONENTS, MasterPose};
use haptimill_protocol::message::{AxisValues, MAX_AXES};
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

/// Links, and the direction of the tool, from the simulated geometry with the joints at these
/// positions, mm and degrees; links to 0.01 mm.
pub(super) fn picture(geometry: &GeometryConfig, joints: &[f64]) -> Option<Picture> {
    let mut places = [0.0; MAX_AXES];
    for (slot, joint) in places.iter_mut().zip(joints) {
        *slot = *joint;
    }
    let mut picture = geometry.picture(&places)?;
    round(&mut picture.links);
    Some(picture)
}

/// Links of a haptic arm at a pose of its handle, mm; none where it does not reach.
pub(super) fn arm_links(geometry: &HapticGeometry, handle: &MasterPose) -> Vec<Vec<[f64; 3]>> {
    let tip = handle.tip.map(|part| f64::from(part) / PER_MM);
    let axes = handle
        .axes
        .map(|axis| axis.map(|part| f64::from(part) / f64::from(i16::MAX)));
    let mut links = geometry.links(tip, axes);
    round(&mut links);
    links
}

fn round(links: &mut [Vec<[f64; 3]>]) {
    for value in links.iter_mut().flatten().flatten() {
        *value = (*value * 100.0).round() / 100.0;
    }
}

/// Unit vector from the tip towards the spindle, in the workpiece; none for a machine with a rotary
/// coordinate whose role does not say how it turns the tool.
pub(super) fn tool_axis(machine: &MachineFile, pose: Option<&AxisValues>) -> Option<[f64; 3]> {
    let pose = pose.filter(|pose| !pose.is_empty())?;
    let descriptor = machine.config.model.descriptor();
    let mut turning = descriptor.pose.iter().zip(&machine.pose);
    if turning.any(|(axis, limits)| limits.kind.is_rotary() && axis.role == Role::None) {
        return None;
    }
    let mut degrees = [0.0; MAX_AXES];
    for (degrees, value) in degrees.iter_mut().zip(pose) {
        *degrees = f64::from(*value) / per_unit(AxisKind::Rotary);
    }
    Some(model::tool_axis(descriptor).direction(&degrees))
}

/// Further values that the page plots, by name. `truth` is that of a simulated machine.
pub(super) fn columns(view: &ViewModel, names: &IoNames, truth: Option<&GroundTruth>) -> Value {
    let mut columns = serde_json::Map::new();
    let Some(now) = &view.telemetry else {
        return Value::Null;
    };
    let unit = |axis: &Axis| if axis.kind.is_rotary() { "deg" } else { "mm" };
    let joints = view.static_info.joints.iter().zip(&now.joints);
    for ((axis, measured), error) in joints.zip(&now.following_error) {
        let (name, fine) = (
            &axis.name,
            if axis.kind.is_rotary() { "mdeg" } else { "um" },
        );
        let error = f64::from(*error) / per_unit(axis.kind);
        columns.insert(
            format!("following error {name}, {fine}"),
            json!(error * 1e3),
        );
        let measured = view.unwound(axis, *measured) as f64 / per_unit(axis.kind);
        // With the drives off nothing is commanded.
        let commanded = (!now.state.has_drives_off()).then_some(measured + error);
        let name = format!("joint {name} commanded, {}", unit(axis));
        columns.insert(name, json!(commanded));
    }
    if let Some(truth) = truth.filter(|truth| truth.pose_valid) {
        for (axis, value) in view.static_info.pose.iter().zip(truth.pose) {
            columns.insert(
                format!("true tool {}, {}", axis.name, unit(axis)),
                json!(value),
            );
        }
        for (name, newtons) in COMPONENT_NAMES.iter().zip(truth.force) {
            columns.insert(format!("true force {name}, N"), json!(newtons));
        }
    }
    let drives = view
        .static_info
        .joints
        .iter()
        .zip(&view.static_info.analogue);
    for ((axis, analogue), drive) in drives.zip(&now.drive) {
        // A converter code, or the steps of a control period.
        let unit = if *analogue { "code" } else { "steps" };
        columns.insert(format!("drive {}, {unit}", axis.name), json!(drive));
    }
    columns.insert("homed".to_string(), json!(u8::from(now.homed)));
    columns.insert("state".to_string(), json!(now.state.number()));
    columns.insert(
        "speed factor, %".to_string(),
        json!(path_speed(now) * 100.0),
    );
    columns.insert(
        "program line".to_string(),
        json!(view.program.as_ref().map(|it| it.line)),
    );
    columns.insert("setpoint".to_string(), json!(now.setpoint));
    let time = f64::from(now.program_periods) * view.static_info.period_s;
    columns.insert("program time, s".to_string(), json!(time));
    let arm = view.master.as_ref().and_then(|master| master.arm.as_ref());
    if let Some(report) = arm.and_then(|arm| arm.report.as_ref()) {
        for (axis, name) in COMPONENT_NAMES.iter().enumerate() {
            let newtons = |force: &[i16; COMPONENTS]| f64::from(force[axis]) / PER_REPORTED;
            let tip = f64::from(report.pose.tip[axis]) / PER_MM;
            for (column, value) in [
                (format!("handle {name}, mm"), tip),
                (format!("handle force {name}, N"), newtons(&report.force)),
                (
                    format!("handle feedback {name}, N"),
                    newtons(&report.feedback),
                ),
                (
                    format!("handle fixture {name}, N"),
                    newtons(&report.fixture),
                ),
            ] {
                columns.insert(column, json!(value));
            }
        }
    }
    if let Some(io) = &now.io {
        for (kind, names, bits) in [
            ("input", &names.inputs, io.inputs),
            ("output", &names.outputs, io.outputs),
        ] {
            for (index, name) in names.iter().enumerate() {
                columns.insert(format!("{kind} {name}"), json!(bits >> index & 1));
            }
        }
        for (kind, names, codes) in [
            ("input", &names.analog_inputs, &io.analog_inputs),
            ("output", &names.analog_outputs, &io.analog_outputs),
        ] {
            for (analog, code) in names.iter().zip(codes) {
                let column = match analog.unit.as_str() {
                    "" => format!("{kind} {}", analog.name),
                    unit => format!("{kind} {}, {unit}", analog.name),
                };
                columns.insert(column, json!(analog.value(*code)));
            }
        }
    }
    if let Some(force) = &now.force {
        let (high, low) = (newtons(force.high), newtons(force.low));
        for (axis, name) in COMPONENT_NAMES.iter().enumerate() {
            columns.insert(format!("force {name}, N"), json!(high[axis]));
            columns.insert(format!("opposite force {name}, N"), json!(low[axis]));
            let displacement = f64::from(force.displacement[axis]) / PER_MM;
            // The servo loops follow the commanded pose, moved by the displacement.
            if let Some(commanded) = now.commanded.get(axis) {
                let reference = f64::from(*commanded) / PER_MM + displacement;
                columns.insert(format!("{name} reference, mm"), json!(reference));
            }
            columns.insert(format!("displacement {name}, mm"), json!(displacement));
        }
    }
    Value::Object(columns)
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptimill_hil_sim::config::PlantConfig;
    use haptimill_machine_file::model::Model;
    use std::io::ErrorKind;
    use std::path::Path;
    use std::process::{Command, Stdio};

    /// What the page gets of a machine at its home pose.
    fn at_home(machine: &MachineFile) -> Value {
        let rows = |limits: &[AxisLimits], values: &[f64]| -> Vec<Value> {
            let limit = |value: f64| value.is_finite().then_some(value);
            let rows = limits.iter().zip(values).map(|(axis, actual)| {
                json!({
                    "name": axis.name,
                    "unit": if axis.kind.is_rotary() { "deg" } else { "mm" },
                    "actual": actual,
                    "low": limit(axis.low),
                    "high": limit(axis.high),
                })
            });
            rows.collect()
        };
        let model = Model::new(machine);
        let home = model.home(machine);
        let joints: AxisValues = machine.preset().iter().map(|joint| joint.0).collect();
        let joints = model.joints_to_engineering_units(&joints);
        let pose = home.as_ref().map(|home| model.to_engineering_units(home));
        let plant: PlantConfig = machine.plant().unwrap();
        let drawn = plant
            .geometry
            .as_ref()
            .map(|geometry| picture(geometry, &joints).unwrap());
        let links = match (&drawn, &plant.haptic) {
            (Some(drawn), _) => drawn.links.clone(),
            (None, Some(arm)) => {
                let geometry = &arm.geometry;
                let tip = [0, 1, 2].map(|k| geometry.home_mm[k] + geometry.tip_mm[k]);
                let handle = MasterPose {
                    tip: tip.map(|part| (part * PER_MM) as i32),
                    axes: [[i16::MAX, 0, 0], [0, 0, i16::MAX]],
                    ..MasterPose::default()
                };
                arm_links(geometry, &handle)
            }
            (None, None) => Vec::new(),
        };
        json!({
            "pose": rows(&machine.pose, pose.as_ref().map_or(&[][..], |pose| &pose[..])),
            "joints": rows(&machine.joints, &joints),
            "referenced": true,
            "tip_axes": machine.config.model.descriptor().tool_tip_parts(),
            "tip": tip(machine, home.as_ref()),
            "tool_axis": tool_axis(machine, home.as_ref()).or(drawn.map(|it| it.tool_axis)),
            "links": links,
            "force": [0.0, 0.0, 20.0],
        })
    }

    /// Each machine file has a picture of links or of rails and dials, and the first view contains
    /// it, on a wide screen and on a phone. Needs Node.js, and passes with a note without it.
    #[test]
    fn every_machine_file_has_a_picture_within_the_view() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let mut machines = serde_json::Map::new();
        for entry in std::fs::read_dir(root.join("machines")).unwrap() {
            let path = entry.unwrap().path();
            let text = std::fs::read_to_string(&path).unwrap();
            // The others are sections to be appended.
            if text.lines().any(|line| line.starts_with("format = ")) {
                let machine = MachineFile::load(&path).unwrap_or_else(|error| panic!("{error}"));
                let name = path.file_stem().unwrap().to_string_lossy().into_owned();
                machines.insert(name, at_home(&machine));
            }
        }
        assert!(machines.len() > 12);
        let mut node = Command::new("node");
        let script = root.join("host/web/tests/picture.js");
        let node = node.arg(script).arg(root.join("host/viewer/src/viewer.js"));
        let node = node.arg(root.join("host/web/src/machine.js"));
        let started = node.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn();
        let mut node = match started {
            Err(error) if error.kind() == ErrorKind::NotFound => {
                println!("not tested: Node.js is not installed");
                return;
            }
            started => started.unwrap(),
        };
        serde_json::to_writer(node.stdin.take().unwrap(), &machines).unwrap();
        let out = node.wait_with_output().unwrap();
        assert!(out.status.success());
        let pictures: Value = serde_json::from_slice(&out.stdout).unwrap();
        for name in machines.keys() {
            let picture = &pictures[name];
            let parts = |layer: &str| picture["segments"][layer].as_u64().unwrap_or(0);
            assert!(parts("links") + parts("joints") >= 3, "{name}: {picture}");
            // A tool whose direction is known is not a ball: the ball is 6 mm high.
            let tool = picture["tool_mm"].as_f64();
            assert!(tool.is_none_or(|height| height > 40.0), "{name}: {picture}");
            assert!(tool.is_some() || machines[name]["tip"].is_null(), "{name}");
            for view in picture["views"].as_array().unwrap() {
                let number = |key: &str| view[key].as_f64().unwrap();
                let inside = |low: f64, high: f64, size: f64| low >= 0.0 && high <= size;
                let fits = inside(number("left"), number("right"), number("width"))
                    && inside(number("top"), number("bottom"), number("height"))
                    && inside(number("near") + 1.0, number("far") + 1.0, 2.0);
                assert!(fits, "{name}: {view}");
                // And fills a good part of it.
                let wide = (number("right") - number("left")) / number("width");
                let high = (number("bottom") - number("top")) / number("height");
                assert!(wide.max(high) > 0.5, "{name}: {view}");
            }
        }
    }

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
