//! Status of a machine, as text and as JSON.

use super::io_status::IoStatus;
use haptimill_machine_file::model::Model;
use haptimill_protocol::message::{
    AxisValues, FULL_SPEED_FACTOR, InputProblem, Kept, MAX_AXES, State, Telemetry,
};
use serde_json::Value;
use std::fmt::{Display, Formatter, Write as _};

/// A status.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct StatusReport {
    text: String,
    json: Value,
}

/// Adds a line.
macro_rules! line {
    ($text:ident, $($part:tt)*) => {{
        // Writing to a text cannot fail.
        let _ = writeln!($text, $($part)*);
    }};
}

/// Names of the lines of a joint: its switches in the order of `ActiveLines::switches`, its drive.
const LINES: [&str; 4] = ["home", "limit-low", "limit-high", "alarm"];

/// The active lines of the joints that have one, and the emergency stop circuit.
struct ActiveLines<'n> {
    joints: Vec<(&'n str, Vec<&'static str>)>,
    is_stop_open: bool,
}

impl<'n> ActiveLines<'n> {
    fn new(joints: &'n [String], status: &Telemetry) -> Self {
        let active = status.lines();
        let [home, low, high] = active.switches;
        let lines = [home, low, high, active.alarms.joints()];
        let of_joint = |(joint, name): (usize, &'n String)| {
            let active = LINES.iter().zip(lines);
            let active = active.filter(|(_, joints)| joints >> joint & 1 != 0);
            let active: Vec<_> = active.map(|(line, _)| *line).collect();
            (!active.is_empty()).then_some((name.as_str(), active))
        };
        Self {
            joints: joints.iter().enumerate().filter_map(of_joint).collect(),
            is_stop_open: active.emergency_stop,
        }
    }

    fn json(&self) -> Value {
        let joints = self.joints.iter();
        joints
            .map(|(joint, lines)| ((*joint).to_string(), lines.clone()))
            .collect()
    }
}

impl Display for ActiveLines<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let mut active: Vec<String> = self
            .joints
            .iter()
            .map(|(joint, lines)| format!("{joint} {}", lines.join(" and ")))
            .collect();
        if self.is_stop_open {
            active.push("emergency stop".to_string());
        }
        if active.is_empty() {
            return f.write_str("no switch, alarm or emergency stop is active");
        }
        write!(f, "active: {}", active.join(", "))
    }
}

/// What a board keeps without a supply; `None` for a board without such a memory.
fn describe_kept(kept: Kept, configuration: u32, model: &Model) -> Option<String> {
    let replace = "`haptimill store --machine FILE` replaces it";
    Some(match kept {
        Kept::Unsupported => return None,
        Kept::Nothing => "no machine file; `haptimill store` lets the board keep it".to_string(),
        Kept::Config(crc) if crc == configuration => {
            "this machine file; the board activates it after a reset".to_string()
        }
        Kept::Config(crc) => format!("another machine file (CRC {crc:08x}); {replace}"),
        Kept::OtherVersion => {
            format!("a machine file by another version of the image, which is ignored; {replace}")
        }
        Kept::Refused(refusal) => {
            let why = model.with_axes(|axes| axes.describe(&refusal).to_string());
            format!("a machine file that the board refuses: {why}; {replace}")
        }
    })
}

/// A sentence for each drive that reports an alarm.
fn alarms(model: &Model, status: &Telemetry) -> Vec<String> {
    let alarms = status.lines().alarms;
    let joints = (0..MAX_AXES).filter_map(|joint| Some((joint as u8, alarms.of(joint)?)));
    let sentence = |(joint, alarm)| {
        let problem = InputProblem::Drive { joint, alarm };
        model.with_axes(|axes| axes.describe(&problem).to_string())
    };
    joints.map(sentence).collect()
}

impl StatusReport {
    /// Describes telemetry of a machine with this name (empty without a configuration), check of
    /// its configuration, and what its board keeps.
    pub(crate) fn new(
        machine: &str,
        (configuration, kept): (u32, Kept),
        model: &Model,
        status: &Telemetry,
    ) -> Self {
        let fault = status
            .fault
            .map(|fault| model.with_axes(|axes| axes.describe(&fault).to_string()));
        let mut text = String::new();
        let pose = |values: &AxisValues| -> Vec<(String, f64)> {
            let units = model.unwound_pose(values, status);
            model
                .pose_names()
                .iter()
                .zip(units)
                .take(values.len())
                .map(|(name, value)| ((*name).to_string(), value))
                .collect()
        };
        let joints = |values: &AxisValues| -> Vec<(String, f64)> {
            model
                .joint_names()
                .iter()
                .map(ToString::to_string)
                .zip(model.joints_to_engineering_units(values))
                .collect()
        };
        let io = IoStatus::new(model.io(), status.io.as_ref());
        let joint_names: Vec<String> = model
            .joint_names()
            .iter()
            .map(ToString::to_string)
            .collect();
        let is_open = |joint: usize| status.open_loop >> joint & 1 != 0;
        let open_loop: Vec<&String> = (joint_names.iter().enumerate())
            .filter(|(joint, _)| is_open(*joint))
            .map(|(_, name)| name)
            .collect();
        let lines = ActiveLines::new(&joint_names, status);
        let alarms = alarms(model, status);
        let kept = describe_kept(kept, configuration, model);
        let map = |values: Vec<(String, f64)>| serde_json::Value::from_iter(values);
        let value = serde_json::json!({
            "machine": machine,
            "configuration_crc": format!("{configuration:08x}"),
            "state": format!("{:?}", status.state),
            "homed": status.homed,
            "fault": fault,
            "period": status.period,
            "setpoint": status.setpoint,
            "speed_factor": path_speed(status),
            // With the drives off nothing is commanded, as the text says.
            "commanded": (!status.state.has_drives_off()).then(|| map(pose(&status.commanded))),
            "measured": map(pose(&status.measured)),
            "joints": map(joint_names.iter().cloned().zip(model.unwound_joints(status)).collect()),
            // Without a machine file the joints have no names.
            "open_loop": (!joint_names.is_empty()).then_some(&open_loop),
            "active_lines": (!joint_names.is_empty()).then(|| lines.json()),
            "alarms": alarms,
            "kept": kept,
            "emergency_stop_open": status.lines().emergency_stop,
            "following_error": map(joints(&status.following_error)),
            "compensation_percent": status.compensation(),
            "bad_frames": status.bad_frames,
            "lost_bytes": status.lost_bytes,
            "inputs": io.inputs_json(),
            "outputs": io.outputs_json(),
        });
        let line = |values: Vec<(String, f64)>, units: Vec<&str>| -> String {
            values
                .iter()
                .zip(units)
                .map(|((name, value), unit)| format!("  {name} {value:.4} {unit}"))
                .collect()
        };
        let yes_no = |flag: bool| if flag { "yes" } else { "no" };
        let name = if machine.is_empty() {
            "no configuration".to_string()
        } else {
            machine.to_string()
        };
        line!(
            text,
            "{name}: {}, homed: {}",
            status.state.to_string().trim_start_matches("in "),
            yes_no(status.homed)
        );
        if let Some(fault) = fault {
            line!(text, "fault      {fault}");
        }
        for alarm in &alarms {
            line!(text, "alarm      {alarm}");
        }
        if let Some(kept) = &kept {
            line!(text, "kept       {kept}");
        }
        if status.lost_bytes > 0 {
            line!(
                text,
                "line       the controller lost {} bytes because its receive buffer was full",
                status.lost_bytes
            );
        }
        let names_axes = !model.pose_units().is_empty();
        if !status.measured.is_empty() && !names_axes {
            line!(
                text,
                "positions  not shown; `--machine FILE` names the machine file"
            );
        }
        if !status.measured.is_empty() && names_axes {
            if !status.homed {
                line!(
                    text,
                    "positions  not referenced; `haptimill home` finds the reference"
                );
            }
            let (pose_units, joint_units) = (model.pose_units(), model.joint_units());
            let measured = line(pose(&status.measured), pose_units.clone());
            line!(text, "measured {measured}");
            if status.state.has_drives_off() {
                line!(text, "commanded  nothing: the drives are off");
            } else {
                line!(
                    text,
                    "commanded{}",
                    line(pose(&status.commanded), pose_units)
                );
            }
            if !open_loop.is_empty() {
                let names: Vec<&str> = open_loop.iter().map(|name| name.as_str()).collect();
                line!(
                    text,
                    "open loop  {}: counted steps, not measured",
                    names.join(", ")
                );
            }
            line!(text, "lines      {lines}");
            let unwound = joint_names.into_iter().zip(model.unwound_joints(status));
            line!(text, "joints   {}", line(unwound.collect(), joint_units));
        }
        if let Some(percent) = status.compensation() {
            line!(text, "compensation  {percent} %");
        }
        io.write(&mut text);
        Self { text, json: value }
    }

    /// Reads the answer of another process.
    #[cfg(unix)]
    pub(super) fn of_answer(answer: &str) -> Option<Self> {
        let mut answer: Value = serde_json::from_str(answer).ok()?;
        let mut done: Value = serde_json::from_str(answer["done"].take().as_str()?).ok()?;
        Some(Self {
            text: done["text"].as_str()?.to_string(),
            json: done["status"].take(),
        })
    }

    /// The answer to another process.
    pub(crate) fn answer(&self) -> String {
        serde_json::json!({ "text": self.text, "status": self.json }).to_string()
    }

    /// Prints it.
    pub(super) fn print(&self, json: bool) {
        if json {
            print_line!("{:#}", self.json);
        } else {
            print_line!("{}", self.text.trim_end());
        }
    }
}

/// Speed along the path of a program as a fraction of the programmed one; 0 where no program runs.
pub(crate) fn path_speed(status: &Telemetry) -> f64 {
    match status.state {
        State::Run | State::Hold => f64::from(status.speed_factor) / f64::from(FULL_SPEED_FACTOR),
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptimill_machine_file::MachineFile;

    #[test]
    fn an_answer_is_the_same_status() {
        let machine = MachineFile::built_in().expect("the built-in machine");
        let telemetry = Telemetry::default();
        let report = StatusReport::new("h4", (7, Kept::Nothing), &Model::new(&machine), &telemetry);
        let answer = serde_json::json!({ "done": report.answer() }).to_string();
        assert_eq!(StatusReport::of_answer(&answer), Some(report));
        assert_eq!(StatusReport::of_answer("{\"error\": \"no link\"}"), None);
    }
}
