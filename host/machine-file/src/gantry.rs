//! Joints of a machine file, with the second motors of gantries behind those of the model.

use super::axes::{AxisLimits, read_joint_axis};
use super::axis_places::place_axes;
use super::document::Section;
use super::drive_chip;
use haptimill_firmware::config::{AxisKind, JointSettings, SwitchHome};
use haptimill_machine_keys::controller::joint;
use haptimill_protocol::message::MAX_AXES;

/// Reads all joints. `places` are those of the model, `period` is in seconds.
pub(super) fn read_joints(
    root: &Section<'_, '_>,
    places: &[(&'static str, AxisKind)],
    period: f64,
) -> Vec<(JointSettings, AxisLimits)> {
    let sections = root.list("joint");
    let count = sections.len();
    let has_key = |section: &Section<'_, '_>| section.has(joint::gantry_of.name);
    let own: Vec<Option<&str>> = sections
        .iter()
        .filter(|section| !has_key(section))
        .map(|section| section.peek_text("name"))
        .collect();
    // The only joint with a name of the model is that joint, not a second motor.
    let is_of_model = |section: &Section<'_, '_>| {
        let name = section.peek_text("name");
        places.iter().any(|(place, _)| Some(*place) == name) && !own.contains(&name)
    };
    for section in sections.iter().filter(|it| has_key(it) && is_of_model(it)) {
        let what = "is for second motors, and this is a joint of the model";
        let remedy = "remove it, or rename the joint";
        let _ = section.text(joint::gantry_of.name, remedy);
        section.refuse(joint::gantry_of, what, remedy);
    }
    // Only second motors have a racking, so one without the key is known by it.
    let racks = |section: &Section<'_, '_>| {
        let name = section.peek_text("name");
        places.iter().all(|(place, _)| Some(*place) != name) && section.has(joint::racking.name)
    };
    let is_second =
        |section: &Section<'_, '_>| (has_key(section) && !is_of_model(section)) || racks(section);
    let first_second = sections.iter().position(is_second).unwrap_or(count);
    for section in sections.iter().skip(first_second) {
        if !is_second(section) {
            let what = "is after the second motor of a gantry";
            let remedy = "write the joints of the model first";
            section.report("name", what, remedy);
        }
    }
    let (seconds, firsts): (Vec<_>, Vec<_>) = sections.into_iter().partition(is_second);
    if count > MAX_AXES && !seconds.is_empty() {
        let what = format!("has {count} sections");
        let remedy = format!("a machine has up to {MAX_AXES} joints, with those of gantries");
        root.report("joint", what, remedy);
    }
    let firsts = place_axes(root, "joint", firsts, places);
    let mut joints: Vec<_> = firsts
        .iter()
        .map(|(section, place)| read_joint_axis(section, *place, None, period))
        .collect();
    for section in &seconds {
        let of = section.text(joint::gantry_of.name, "name a joint of the model");
        let found = joints
            .iter()
            .position(|(axis, limits)| axis.gantry.is_none() && Some(limits.name.as_str()) == of);
        if let (Some(name), None) = (of, found) {
            let names: Vec<_> = places.iter().map(|(name, _)| *name).collect();
            let what = format!("\"{name}\" is no joint of the model");
            section.report(
                "gantry_of",
                what,
                format!("write one of {}", names.join(", ")),
            );
        }
        let name = section.peek_text("name");
        if joints
            .iter()
            .any(|(_, limits)| Some(limits.name.as_str()) == name)
        {
            section.report("name", "is a duplicate", "rename one");
        }
        let of = found.unwrap_or(0);
        let (axis, limits) = read_joint_axis(section, None, Some(of), period);
        if found.is_some() {
            check(section, &joints, of, (&axis, &limits));
        }
        joints.push((axis, limits));
    }
    let sections = firsts.iter().map(|(section, _)| section).chain(&seconds);
    drive_chip::check_places(sections, &joints);
    joints
}

/// Checks a second motor against the first one.
fn check(
    section: &Section<'_, '_>,
    joints: &[(JointSettings, AxisLimits)],
    of: usize,
    (axis, limits): (&JointSettings, &AxisLimits),
) {
    let Some((first, first_limits)) = joints.get(of) else {
        return;
    };
    let name = &first_limits.name;
    let mut seconds = joints.iter().filter_map(|(axis, _)| axis.gantry.as_ref());
    if seconds.any(|gantry| usize::from(gantry.of) == of) {
        let what = format!("\"{name}\" has a second motor already");
        section.report("gantry_of", what, "remove one");
    }
    if axis.kind != AxisKind::Linear || first.kind != AxisKind::Linear {
        section.report("gantry_of", "needs two linear joints", "remove the key");
        return;
    }
    if axis.preset != first.preset {
        let what = format!("is not that of \"{name}\"");
        section.refuse(joint::preset, what, "write the same");
    }
    if axis.low > first.low || axis.high < first.high {
        let (low, high) = (first_limits.low, first_limits.high);
        let what = format!(
            "{} to {} mm do not contain the stroke of \"{name}\", {low} to {high} mm",
            limits.low, limits.high
        );
        section.refuse(joint::low, what, "widen it");
    }
    if axis.rate < first.rate {
        let what = format!(
            "{} is below that of \"{name}\", {}",
            limits.rate, first_limits.rate
        );
        section.refuse(joint::rate, what, "raise it");
    }
    match (first.home.switch(), axis.home.switch()) {
        (Some(first), Some(second)) => {
            if let Some(key) = differing(first, second) {
                let what = format!("{key} is not that of \"{name}\"");
                section.report("switch", what, "write the same: the motors search together");
            }
        }
        (None, _) => {
            let what = format!("\"{name}\" does not home by a switch, which squares a gantry");
            section.report("gantry_of", what, "give both joints a home switch");
        }
        (_, None) => {
            let what = "is not by a switch, which squares a gantry";
            section.report("home", what, "write \"switch\"");
        }
    }
}

/// A key of the search that differs between the two motors.
fn differing(first: &SwitchHome, second: &SwitchHome) -> Option<&'static str> {
    let keys = [
        ("home_order", first.order == second.order),
        ("towards", first.downwards == second.downwards),
        ("rate_mm_s", first.rate == second.rate),
        ("touch_rate_mm_s", first.touch_rate == second.touch_rate),
        ("back_off_mm", first.back_off == second.back_off),
        (
            "acceleration_mm_s2 of the joint",
            first.acceleration == second.acceleration,
        ),
    ];
    keys.into_iter()
        .find(|(_, equal)| !equal)
        .map(|(key, _)| key)
}
