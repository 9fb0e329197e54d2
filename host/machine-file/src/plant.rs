//! Check of the `[plant]` section by the simulator, with the lines of its problems.

use super::document::Document;
use super::place::unit;
use super::pose_difference::{ERROR, PoseDifference};
use super::scale::{PER_COUNT, per_unit};
use super::{MachineFile, Problems};
use haptimill_firmware::config::{Drive, Home, JointSettings, SwitchInput};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::fault::Switch;
use haptimill_hil_sim::joint::{DriveConfig, JointConfig, SwitchSide};
use haptimill_hil_sim::plant::Plant;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Reports every problem of the simulated machine, and its differences from the controller.
pub(super) fn check(document: &Document<'_>, root: &DeTable<'_>, machine: &MachineFile) {
    let offset = root.get("plant").map_or(0, |value| value.span().start);
    let model = machine.config.model.descriptor().code;
    if !machine.is_master()
        && let Some(other) = simulated_model(root).filter(|it| *it != model)
    {
        let (offset, key) = place_in_plant(root, "geometry");
        let what = format!("is \"{other}\", the model of [kinematics] is \"{model}\"");
        document.report(offset, key, what, format!("write [plant.geometry.{model}]"));
        return;
    }
    match machine.plant::<PlantConfig>() {
        Err(Problems(problems, _)) => problems.into_iter().for_each(|p| document.add(p)),
        Ok(plant) => {
            let are_named = if plant.joint.len() != machine.config.joints.len() {
                let what = format!(
                    "has {} joints, the controller {}",
                    plant.joint.len(),
                    machine.config.joints.len()
                );
                // The joints of the controller may be what is wrong.
                if !document.has_problem(|key| key == "joint") {
                    document.report(offset, "plant.joint", what, "write one for each joint");
                }
                false
            } else {
                check_joint_names(document, root, &plant, machine)
            };
            if !are_named {
                // The geometry would be asked about other joints.
                return;
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
                check_scales(document, root, &plant, machine);
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
            "the simulated machine is another one than [kinematics] describes: {difference} (at most \
             {ERROR} mm and {ERROR} deg)"
        );
        let remedy = "correct [plant.geometry], [kinematics] or the presets of [[plant.joint]]";
        document.report(offset, key, what, remedy);
    }
}

/// Relative difference of a scale, above which it is that of another machine. No screw is as wrong.
const SCALE: f64 = 0.01;

/// Distance of the home switch of a simulated joint from that of the controller, mm or degrees,
/// above which it is another switch.
const SWITCH: f64 = 1.0;

/// Distance of the index pulse of a simulated joint from that of the controller, mm or degrees,
/// above which it is another pulse. What `identify` and `calibrate arm` find is less.
const INDEX: f64 = 1.0;

/// Part of a stroke beyond a hard stop of the simulated joint, mm or degrees, above which it is a
/// mistake: the stop yields.
const STOP: f64 = 0.01;

/// Checks that a step and a count move the simulated joint as far as the controller computes, that
/// its switches are those that the controller expects, and that it can reach its whole stroke.
fn check_scales(
    document: &Document<'_>,
    root: &DeTable<'_>,
    plant: &PlantConfig,
    machine: &MachineFile,
) {
    for (index, (simulated, joint)) in plant.joint.iter().zip(&machine.config.joints).enumerate() {
        let report = |field: &str, what: String, remedy: &str| {
            let (offset, key) = place_in_plant(root, &format!("joint {index}: {field}"));
            document.report(offset, key, what, remedy);
        };
        let unit = unit(joint.kind);
        let per_unit = per_unit(joint.kind);
        let scale = |field: &str, item: &str, raw: i64, truth: f64, remedy: &str| {
            let computed = raw.unsigned_abs() as f64 / (PER_COUNT * per_unit);
            if (truth / computed - 1.0).abs() > SCALE {
                let what = format!(
                    "a {item} moves the simulated joint by {truth:.6} {unit}, the controller \
                     computes {computed:.6} {unit}"
                );
                report(field, what, remedy);
            }
        };
        let direction = |field: &str, what: &str, computed: bool, simulated: bool, remedy: &str| {
            if computed != simulated {
                let way = |down| if down { "down" } else { "up" };
                let what = format!(
                    "{what} is {} in the simulated joint, and {} by the `direction` of [[joint]]",
                    way(simulated),
                    way(computed)
                );
                report(field, what, remedy);
            }
        };
        let reversed = "change `reversed` here, or `direction` in [[joint]]";
        let [low, high] = [joint.low, joint.high].map(|end| f64::from(end.0) / per_unit);
        for (key, end, stop, beyond) in [
            ("low", low, simulated.low, simulated.low - low),
            ("high", high, simulated.high, high - simulated.high),
        ] {
            if beyond > STOP {
                let what = format!(
                    "the hard stop of the simulated joint is at {stop} {unit}, the stroke of the \
                     controller ends at {end} {unit}"
                );
                report(key, what, "correct it, or the stroke in [[joint]]");
            }
        }
        if let (Some(encoder), Some(read)) = (&simulated.encoder, &joint.encoder) {
            let truth = simulated.per_count(encoder);
            let remedy = "correct lead or counts_per_turn, here or in [[joint]]";
            scale("encoder", "count", read.per_count, truth, remedy);
            let (computed, simulated) = (read.per_count < 0, encoder.reversed);
            direction("encoder", "a positive count", computed, simulated, reversed);
            let pitch = f64::from(read.index_pitch.0) / per_unit;
            let expected = (f64::from(read.index.0) / per_unit * 1e6).round() / 1e6;
            let apart = (encoder.index - expected) / pitch;
            if matches!(joint.home, Home::Index | Home::SwitchAndIndex(_))
                && (apart - apart.round()).abs() * pitch > INDEX
            {
                let what = format!(
                    "the index pulses are at {} {unit} and whole turns of the motor from it, the \
                     controller expects one at {expected} {unit}",
                    encoder.index
                );
                report(
                    "encoder",
                    what,
                    "correct it, or the place of the index in [[joint]]",
                );
            }
        }
        if let (DriveConfig::Torque(drive), Drive::Torque { full_scale, .. }) =
            (&simulated.drive, &joint.drive)
        {
            let (computed, simulated) = (full_scale.0 < 0, drive.full_scale < 0.0);
            let remedy = "change the sign of `full_scale` here, or `direction` in [[joint]]";
            let field = "drive: torque: full_scale";
            direction(field, "a positive effort", computed, simulated, remedy);
        }
        if let (
            DriveConfig::Steps(drive),
            Drive::Steps {
                per_step,
                ticks_per_us,
                pulse,
                setup,
                hold,
                ..
            },
        ) = (&simulated.drive, &joint.drive)
        {
            if drive.ticks_per_us != *ticks_per_us {
                let what = format!(
                    "ticks_per_us = {} is not the step clock of the controller, {ticks_per_us}",
                    drive.ticks_per_us
                );
                report(
                    "drive: steps: ticks_per_us",
                    what,
                    "write the same number in both",
                );
            }
            let steps = f64::from(drive.full_steps) * f64::from(drive.microsteps);
            let remedy = "correct lead, full_steps and microsteps here, or lead (gear_ratio) and \
                          steps_per_turn in [[joint]]";
            scale("drive", "step", *per_step, simulated.lead / steps, remedy);
            let (computed, turned) = (*per_step < 0, drive.reversed);
            direction(
                "drive: steps",
                "a positive step",
                computed,
                turned,
                reversed,
            );
            for (key, of, ticks, min) in [
                ("min_high_ns", "pulse_us", *pulse, drive.min_high_ns),
                ("min_low_ns", "pulse_us", *pulse, drive.min_low_ns),
                ("setup_ns", "setup_us", *setup, drive.setup_ns),
                ("hold_ns", "hold_us", *hold, drive.hold_ns),
            ] {
                let sent = f64::from(ticks) / f64::from(*ticks_per_us) * 1e3;
                if sent < min {
                    let what = format!(
                        "the simulated drive needs {min} ns, the controller has {sent:.0} ns"
                    );
                    let remedy = format!("correct it, or raise {of} in [[joint]]");
                    report(&format!("drive: steps: {key}"), what, &remedy);
                }
            }
            if drive.pull_out <= simulated.coulomb {
                let what = format!(
                    "the simulated motor has {} at most, and the friction is {}: it never moves",
                    drive.pull_out, simulated.coulomb
                );
                report("drive: steps: pull_out", what, "raise it above `coulomb`");
            }
        }
        check_switches(simulated, joint, &report);
    }
}

/// Checks that the switch that a joint searches is there, where the controller expects it, and that
/// the lines of the switches have the levels that the controller expects.
fn check_switches(
    simulated: &JointConfig,
    joint: &JointSettings,
    report: &dyn Fn(&str, String, &str),
) {
    let (unit, per_unit) = (unit(joint.kind), per_unit(joint.kind));
    let home = simulated.home.as_ref();
    let below = |is_below: bool| {
        if is_below {
            SwitchSide::Below
        } else {
            SwitchSide::Above
        }
    };
    // Key, name of the controller's key, place and active side of each switch.
    let switches = [
        (SwitchInput::Home, "home", home.map(|it| (it.at, it.active))),
        (
            SwitchInput::LimitLow,
            "limit_low",
            simulated.limit_low.map(|at| (at, SwitchSide::Below)),
        ),
        (
            SwitchInput::LimitHigh,
            "limit_high",
            simulated.limit_high.map(|at| (at, SwitchSide::Above)),
        ),
    ];
    for (input, key, switch) in switches {
        if let Some(search) = joint.home.switch().filter(|search| search.input == input) {
            let expected = f64::from(search.coordinate.0) / per_unit;
            let (what, remedy) = match switch {
                None => (
                    format!("is missing; the controller searches it at {expected} {unit}"),
                    "add it, or correct [joint.switch] of the controller",
                ),
                Some((at, _)) if (at - expected).abs() > SWITCH => (
                    format!(
                        "the switch is at {at} {unit}, the controller expects it at {expected} \
                         {unit}"
                    ),
                    "correct it, or [joint.switch] of the controller",
                ),
                Some((_, side)) if side != below(search.downwards) => (
                    "the switch is active on the side from which the controller comes".to_string(),
                    "correct `active`, or `towards` in [joint.switch] of the controller",
                ),
                Some(_) => (String::new(), ""),
            };
            if !what.is_empty() {
                report(key, what, remedy);
            }
        }
        let is_low = |is_low: bool| if is_low { "low" } else { "high" };
        let [expected, level] = [
            joint.active_low & input.bit() != 0,
            simulated.active_low.iter().any(|it| of(*it) == input),
        ];
        // The line of a switch that is not there is low.
        if expected != level && (switch.is_some() || expected) {
            let what = format!(
                "the line of {key} is {} while it is active, the controller expects {}",
                is_low(level),
                is_low(expected)
            );
            let remedy = "correct it, or the level of the switch in [[joint]]";
            report("active_low", what, remedy);
        }
    }
}

/// The input of the controller to which a simulated switch belongs.
const fn of(switch: Switch) -> SwitchInput {
    match switch {
        Switch::Home => SwitchInput::Home,
        Switch::LimitLow => SwitchInput::LimitLow,
        Switch::LimitHigh => SwitchInput::LimitHigh,
    }
}

/// The model of the simulated geometry.
fn simulated_model<'d>(root: &'d DeTable<'_>) -> Option<&'d str> {
    let geometry = inside(root.get("plant"), "geometry")?;
    match geometry.get_ref() {
        DeValue::Table(table) => table.keys().next().map(|key| key.get_ref().as_ref()),
        _ => None,
    }
}

/// Checks that plant and controller have the same joint names, which faults and reports use, and
/// the same gantries; returns whether they have.
fn check_joint_names(
    document: &Document<'_>,
    root: &DeTable<'_>,
    plant: &PlantConfig,
    machine: &MachineFile,
) -> bool {
    let mut are_equal = true;
    for (index, (plant, joint)) in plant.joint.iter().zip(&machine.joints).enumerate() {
        let named = format!("joint[{}].name", index + 1);
        if plant.name != joint.name && !document.has_problem(|key| key == named) {
            let (offset, key) = place_in_plant(root, &format!("joint {index}: name"));
            let (here, there) = (&plant.name, &joint.name);
            let what = format!("is \"{here}\", the controller's joint is \"{there}\"");
            document.report(offset, key, what, "give it the same name");
            are_equal = false;
        }
        let of = machine.config.joints.get(index).and_then(|axis| {
            let gantry = axis.gantry.as_ref()?;
            Some(machine.joints.get(usize::from(gantry.of))?.name.as_str())
        });
        let joint = format!("joint[{}].gantry_of", index + 1);
        let is_unknown = document.has_problem(|key| key == joint);
        if plant.gantry_of.as_deref() != of && !is_unknown {
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
            are_equal = false;
        }
    }
    are_equal
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
