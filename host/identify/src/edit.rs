//! New values in a machine file. Comments and the order of the keys stay; each changed value is
//! marked with the date.

use crate::identify::Identified;
use crate::index_pulses::IndexPulses;
use crate::lost_motion::LostMotion;
use crate::lost_steps::StepLimits;
use crate::servo_loop::Gains;
use crate::tune::rounded;
use haptimill_client::{Error, ErrorKind};
use haptimill_firmware::config::AxisKind;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::scale::per_unit;
use std::path::{Path, PathBuf};
use toml_edit::{DocumentMut, Item, Table, Value};

/// A changed value.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// Joint and key, as `x: inertia_kg`, `x: switch.rate_mm_s`, `pose x: rate_mm_s`.
    pub key: String,
    /// Value before; `None` where the file had none.
    pub before: Option<f64>,
    /// Value after.
    pub after: f64,
}

/// Keys of the law of a joint: inertia, viscous and Coulomb friction.
const fn law_keys(kind: AxisKind) -> [&'static str; 3] {
    if kind.is_rotary() {
        ["inertia_kg_m2", "viscous_n_m_per_deg_s", "coulomb_n_m"]
    } else {
        ["inertia_kg", "viscous_n_per_mm_s", "coulomb_n"]
    }
}

/// Keys of the rate and the acceleration of a joint.
const fn limit_keys(kind: AxisKind) -> [&'static str; 2] {
    if kind.is_rotary() {
        ["rate_deg_s", "acceleration_deg_s2"]
    } else {
        ["rate_mm_s", "acceleration_mm_s2"]
    }
}

/// New values of a section of a joint or a pose coordinate.
struct Section<'a> {
    /// `joint` or `pose`.
    list: &'static str,
    /// Name of the joint or coordinate.
    axis: &'a str,
    /// `law` or `switch`; `None` for the joint or coordinate itself.
    name: Option<&'static str>,
    values: Vec<(&'static str, f64)>,
}

/// The limits of a step motor. The rate of homing, and the limits of the coordinate that is the
/// joint, may not be above those of the joint.
fn limits<'a>(machine: &MachineFile, found: &'a StepLimits) -> Vec<Section<'a>> {
    let axis = found.name.as_str();
    let section = |list, name, values| Section {
        list,
        axis,
        name,
        values,
    };
    let keys = limit_keys(found.kind);
    let values = keys.into_iter().zip(found.proposed());
    let values: Vec<(&str, f64)> = values
        .filter_map(|(key, value)| Some((key, rounded(value?))))
        .collect();
    let lower = |limit: [f64; 2]| -> Vec<(&'static str, f64)> {
        let limits = keys.into_iter().zip(limit);
        let lower = limits.filter_map(|(key, limit)| {
            let own = values.iter().find(|(own, _)| *own == key);
            own.filter(|(_, value)| *value < limit).copied()
        });
        lower.collect()
    };
    let switch = machine.config.joints[found.joint].home.switch();
    let homing = switch.map_or(0.0, |it| f64::from(it.rate.0) / per_unit(found.kind));
    let homing = lower([homing, 0.0]);
    let pose = machine.pose.iter().find(|it| it.name == axis);
    let pose = pose.map_or_else(Vec::new, |it| lower([it.rate, it.acceleration]));
    [
        section("joint", None, values),
        section("joint", Some("switch"), homing),
        section("pose", None, pose),
    ]
    .into_iter()
    .filter(|it| !it.values.is_empty())
    .collect()
}

/// The text of a machine file with the identified values, and what changed.
///
/// # Errors
/// The new text is not a valid machine file.
pub fn with_identified(
    machine: &MachineFile,
    joints: &[Identified],
    steps: &[StepLimits],
    date: &str,
) -> Result<(String, Vec<Change>), Error> {
    let laws = joints.iter().map(|joint| {
        let keys = law_keys(joint.kind);
        let viscous = if joint.friction.viscous < 1e-9 {
            0.0
        } else {
            joint.friction.viscous
        };
        let values = [joint.plant.inertia, viscous, joint.coulomb()];
        Section {
            list: "joint",
            axis: joint.name.as_str(),
            name: Some("law"),
            values: keys.into_iter().zip(values.map(rounded)).collect(),
        }
    });
    let limits = steps.iter().flat_map(|it| limits(machine, it));
    let sections: Vec<Section<'_>> = laws.chain(limits).collect();
    edit(machine, &sections, &format!("identified {date}"))
}

/// The text of a machine file with lost motions as backlash, and what changed.
///
/// # Errors
/// The new text is not a valid machine file.
pub fn with_lost_motion(
    machine: &MachineFile,
    joints: &[LostMotion],
    date: &str,
) -> Result<(String, Vec<Change>), Error> {
    let sections = joints.iter().map(|joint| {
        let key = if joint.kind.is_rotary() {
            "backlash_deg"
        } else {
            "backlash_mm"
        };
        Section {
            list: "joint",
            axis: joint.name.as_str(),
            name: None,
            values: vec![(key, rounded(joint.value()))],
        }
    });
    let sections: Vec<Section<'_>> = sections.collect();
    edit(machine, &sections, &format!("identified {date}"))
}

/// The text of a machine file with places of index pulses and their slack, and what changed.
///
/// # Errors
/// The new text is not a valid machine file.
pub fn with_index_pulses(
    machine: &MachineFile,
    joints: &[IndexPulses],
    date: &str,
) -> Result<(String, Vec<Change>), Error> {
    let sections = joints.iter().map(|joint| {
        let key = if joint.kind.is_rotary() {
            "index_deg"
        } else {
            "index_mm"
        };
        let place = joint.proposed().map(|place| (key, place));
        let slack = ("index_slack_counts", f64::from(joint.slack()));
        Section {
            list: "joint",
            axis: joint.name.as_str(),
            name: None,
            values: place.into_iter().chain([slack]).collect(),
        }
    });
    let sections: Vec<Section<'_>> = sections.collect();
    edit(machine, &sections, &format!("identified {date}"))
}

/// The text of a machine file with gains, and what changed.
///
/// # Errors
/// The new text is not a valid machine file.
pub fn with_gains(
    machine: &MachineFile,
    gains: &[(String, Gains)],
    date: &str,
) -> Result<(String, Vec<Change>), Error> {
    let values = gains.iter().map(|(name, gains)| {
        let values = vec![
            ("kp", gains.kp),
            ("kd", gains.kd),
            ("ki", gains.ki),
            ("rate_filter_ms", rounded(gains.rate_filter * 1e3)),
        ];
        Section {
            list: "joint",
            axis: name.as_str(),
            name: Some("law"),
            values,
        }
    });
    edit(
        machine,
        &values.collect::<Vec<_>>(),
        &format!("tuned {date}"),
    )
}

fn edit(
    machine: &MachineFile,
    sections: &[Section<'_>],
    mark: &str,
) -> Result<(String, Vec<Change>), Error> {
    let internal =
        |what: String| Error::new(ErrorKind::BadInput, format!("{}: {what}", machine.file));
    let mut document: DocumentMut = machine
        .text
        .parse()
        .map_err(|error: toml_edit::TomlError| internal(error.to_string()))?;
    let mut changes = Vec::new();
    for section in sections {
        let Section { list, axis, .. } = *section;
        let tables = document
            .get_mut(list)
            .and_then(Item::as_array_of_tables_mut);
        let named = |table: &&mut Table| table.get("name").and_then(Item::as_str) == Some(axis);
        let table = tables.and_then(|tables| tables.iter_mut().find(named));
        let table = table.ok_or_else(|| internal(format!("has no [[{list}]] {axis}")))?;
        let (table, mut place) = match section.name {
            Some(name) => {
                let inner = table.get_mut(name).and_then(Item::as_table_mut);
                let missing = || internal(format!("{list} {axis} has no [{list}.{name}]"));
                (inner.ok_or_else(missing)?, format!("{axis}: {name}."))
            }
            None => (table, format!("{axis}: ")),
        };
        // The keys of a law are unique.
        if section.name == Some("law") {
            place = format!("{axis}: ");
        } else if list == "pose" {
            place = format!("pose {axis}: ");
        }
        for (key, after) in &section.values {
            let before = set(table, key, *after, mark);
            if before != Some(*after) {
                changes.push(Change {
                    key: format!("{place}{key}"),
                    before,
                    after: *after,
                });
            }
        }
    }
    let text = document.to_string();
    MachineFile::parse(&machine.file, &text).map_err(|problems| {
        let what = format!("the new values are refused, and nothing is written:\n{problems}");
        Error::new(ErrorKind::Refused, what)
    })?;
    Ok((text, changes))
}

/// Sets a number and marks it; returns the one before. An equal number is not changed.
fn set(table: &mut Table, key: &str, after: f64, mark: &str) -> Option<f64> {
    let old = table.get(key).and_then(Item::as_value);
    let before = old.and_then(|it| it.as_float().or(it.as_integer().map(|it| it as f64)));
    if before == Some(after) {
        return before;
    }
    let comment = old
        .and_then(|it| it.decor().suffix()?.as_str())
        .unwrap_or_default()
        .trim()
        .trim_start_matches('#');
    // The date of an earlier identification is replaced.
    let kept = comment.split("; identified ").next().unwrap_or_default();
    let kept = kept.split("; tuned ").next().unwrap_or_default().trim();
    let is_mark = kept.starts_with("identified ") || kept.starts_with("tuned ");
    let suffix = if kept.is_empty() || is_mark {
        format!("  # {mark}")
    } else {
        format!("  # {kept}; {mark}")
    };
    // A machine file has counts as whole numbers.
    let mut new = if key.ends_with("_counts") {
        Value::from(after as i64)
    } else {
        Value::from(after)
    };
    new.decor_mut().set_prefix(" ");
    new.decor_mut().set_suffix(suffix);
    table.insert(key, Item::Value(new));
    before
}

/// Writes the new text to a file, with the old one beside it; returns the name of the old one.
///
/// # Errors
/// A file cannot be written. The machine file is then unchanged.
pub fn replace(path: &Path, before: &str, after: &str, date: &str) -> Result<PathBuf, Error> {
    let failed = |path: &Path, error: std::io::Error| {
        Error::new(ErrorKind::Output, format!("{}: {error}", path.display()))
    };
    let backup = (0..1000)
        .map(|number| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            let count = if number == 0 {
                String::new()
            } else {
                format!(".{number}")
            };
            path.with_file_name(format!("{name}.{date}{count}.bak"))
        })
        .find(|path| !path.exists())
        .unwrap_or_else(|| path.with_extension("bak"));
    let new = path.with_extension("toml.new");
    let replaced = std::fs::write(&backup, before)
        .map_err(|error| failed(&backup, error))
        .and_then(|()| std::fs::write(&new, after).map_err(|error| failed(&new, error)))
        .and_then(|()| std::fs::rename(&new, path).map_err(|error| failed(path, error)));
    if let Err(error) = replaced {
        // The machine file is unchanged; neither file has the whole text for certain.
        let _ = std::fs::remove_file(&backup);
        let _ = std::fs::remove_file(&new);
        return Err(error);
    }
    Ok(backup)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lost_steps::untested_joint;
    use crate::servo_loop::Gains;

    #[test]
    fn comments_stay_and_changes_are_dated() -> Result<(), Box<dyn std::error::Error>> {
        let machine = MachineFile::built_in()?;
        let gains = Gains {
            kp: 30_000.0,
            kd: 346.0,
            ki: 1_000_000.0,
            rate_filter: 1.5e-3,
            inertia: 40.0,
        };
        let list = [("l2".to_string(), gains)];
        let (text, changes) = with_gains(&machine, &list, "2026-11-23")?;
        let keys: Vec<&str> = changes.iter().map(|it| it.key.as_str()).collect();
        assert_eq!(keys, ["l2: kp", "l2: kd"]);
        // Two lines differ; all others are the same, comments included.
        let before: Vec<&str> = machine.text.lines().collect();
        let after: Vec<&str> = text.lines().collect();
        assert_eq!(before.len(), after.len());
        let changed: Vec<&&str> = after
            .iter()
            .zip(&before)
            .filter(|(after, before)| after != before)
            .map(|(after, _)| after)
            .collect();
        assert_eq!(
            changed,
            [
                &"kp = 30000.0  # tuned 2026-11-23",
                &"kd = 346.0  # tuned 2026-11-23"
            ]
        );
        // A second time replaces the mark, and an unstable loop is refused.
        let again = MachineFile::parse("again", &text)?;
        let list = [("l2".to_string(), Gains { kp: 2e4, ..gains })];
        let (text, _) = with_gains(&again, &list, "2026-11-24")?;
        assert!(
            text.contains("kp = 20000.0  # tuned 2026-11-24\n"),
            "{text}"
        );
        let wild = Gains { kp: 1e7, ..gains };
        assert!(with_gains(&machine, &[("l2".to_string(), wild)], "x").is_err());
        Ok(())
    }

    /// A joint that loses steps above 41 mm/s and 500 mm/s^2.
    fn weak_joint() -> StepLimits {
        let mut joint = untested_joint();
        while let Some(motion) = joint.next() {
            let is_lost = motion.rate > 41.0 || motion.acceleration > 500.0;
            joint.record(motion, if is_lost { 64.0 } else { 0.0 });
        }
        joint
    }

    #[test]
    fn limits_of_a_joint_also_bound_its_coordinate_and_its_homing()
    -> Result<(), Box<dyn std::error::Error>> {
        let text = include_str!("../../../machines/mill3.toml");
        let text = text.replacen("rate_mm_s = 20.0 ", "rate_mm_s = 30.0 ", 1);
        let machine = MachineFile::parse("mill3.toml", &text)?;
        let (text, changes) = with_identified(&machine, &[], &[weak_joint()], "2026-11-27")?;
        let keys: Vec<&str> = changes.iter().map(|it| it.key.as_str()).collect();
        let expected = [
            "x: rate_mm_s",
            "x: acceleration_mm_s2",
            "x: switch.rate_mm_s",
            "pose x: rate_mm_s",
        ];
        assert_eq!(keys, expected);
        let edited = MachineFile::parse("edited", &text)?;
        // 70 % of what the search found, within 3 % and 5 % below the true limits.
        let [rate, acceleration] = [edited.joints[0].rate, edited.joints[0].acceleration];
        assert!((0.97 * 28.7..=28.75).contains(&rate), "{rate}");
        assert!((0.95 * 350.0..=350.5).contains(&acceleration));
        assert_eq!(edited.pose[0].rate.to_bits(), rate.to_bits());
        // The coordinate keeps an acceleration that is low enough.
        assert_eq!(edited.pose[0].acceleration, 300.0);
        assert_eq!(edited.joints[1..], machine.joints[1..]);
        let mark = "# rate to the switch; identified 2026-11-27\n";
        assert_eq!(text.matches(mark).count(), 1, "{text}");
        Ok(())
    }
}
