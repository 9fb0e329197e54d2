//! Names that keys and sections of machine files had before.

/// A renamed section or key of a section.
pub(crate) struct Renamed {
    /// Path before; the last part is the name.
    pub from: &'static str,
    /// Path after.
    pub to: &'static str,
}

/// Names that a file of format 2 may still have.
pub(crate) const IN_FORMAT_2: &[Renamed] = &[
    renamed("force.axis.desired_n", "force.axis.setpoint_n"),
    renamed("plant.spindle.run_up_s", "plant.spindle.time_constant_s"),
];

/// The run-up time of the spindle behind a door, which was in milliseconds and is in seconds.
pub(crate) const DOOR_RUN_UP: Renamed = renamed("input.spindle_up_ms", "input.run_up_s");

pub(crate) const fn renamed(from: &'static str, to: &'static str) -> Renamed {
    Renamed { from, to }
}

/// The present name of a key of a section that files of the present format may still have by an old
/// name.
pub(crate) fn new_name(section: &str, key: &str) -> Option<&'static str> {
    let mut renamed = IN_FORMAT_2.iter().chain([&DOOR_RUN_UP]);
    let renamed = renamed.find(|renamed| renamed.from == format!("{section}.{key}"));
    renamed.map(|renamed| split(renamed.to).1)
}

/// As [`new_name`], for a key of any section of the plant.
pub(crate) fn new_name_in_plant(key: &str) -> Option<&'static str> {
    let mut renamed = IN_FORMAT_2.iter();
    let renamed =
        renamed.find(|renamed| renamed.from.starts_with("plant.") && split(renamed.from).1 == key);
    renamed.map(|renamed| split(renamed.to).1)
}

/// What to do about a key that has another name now.
pub(crate) fn remedy(file: &str, new_name: &str) -> String {
    format!("run `haptimill machine migrate {file}`: the key is `{new_name}` now")
}

/// Splits a path into the path of the section and the last name.
pub(crate) fn split(path: &'static str) -> (Vec<&'static str>, &'static str) {
    let mut parts: Vec<_> = path.split('.').collect();
    let name = parts.pop().unwrap_or_default();
    (parts, name)
}
