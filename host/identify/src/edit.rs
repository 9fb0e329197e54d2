//! New values in a machine file. Comments and the order of the keys stay; each changed value is
//! marked with the date.

use crate::identify::Identified;
use crate::servo_loop::Gains;
use crate::tune::rounded;
use haptimill_client::{Error, ErrorKind};
use haptimill_firmware::config::AxisKind;
use haptimill_machine_file::MachineFile;
use std::path::{Path, PathBuf};
use toml_edit::{DocumentMut, Item, Table, Value};

/// A changed value.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// Joint and key, as `x: inertia_kg`.
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

/// The text of a machine file with the identified values, and what changed.
///
/// # Errors
/// The new text is not a valid machine file.
pub fn with_identified(
    machine: &MachineFile,
    joints: &[Identified],
    date: &str,
) -> Result<(String, Vec<Change>), Error> {
    let values = joints.iter().map(|joint| {
        let keys = law_keys(joint.kind);
        let viscous = if joint.friction.viscous < 1e-9 {
            0.0
        } else {
            joint.friction.viscous
        };
        let values = [joint.plant.inertia, viscous, joint.coulomb()];
        let list = keys.into_iter().zip(values.map(rounded)).collect();
        (joint.name.as_str(), list)
    });
    edit(machine, values.collect(), &format!("identified {date}"))
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
        let list = vec![
            ("kp", gains.kp),
            ("kd", gains.kd),
            ("ki", gains.ki),
            ("rate_filter_ms", rounded(gains.rate_filter * 1e3)),
        ];
        (name.as_str(), list)
    });
    edit(machine, values.collect(), &format!("tuned {date}"))
}

fn edit(
    machine: &MachineFile,
    values: Vec<(&str, Vec<(&'static str, f64)>)>,
    mark: &str,
) -> Result<(String, Vec<Change>), Error> {
    let internal =
        |what: String| Error::new(ErrorKind::BadInput, format!("{}: {what}", machine.file));
    let mut document: DocumentMut = machine
        .text
        .parse()
        .map_err(|error: toml_edit::TomlError| internal(error.to_string()))?;
    let mut changes = Vec::new();
    let tables = document
        .get_mut("joint")
        .and_then(Item::as_array_of_tables_mut);
    for table in tables.into_iter().flat_map(|tables| tables.iter_mut()) {
        let name = table.get("name").and_then(Item::as_str);
        let found = values.iter().find(|(joint, _)| Some(*joint) == name);
        let Some((name, list)) = found else { continue };
        let law = table.get_mut("law").and_then(Item::as_table_mut);
        let law = law.ok_or_else(|| internal(format!("joint {name} has no [joint.law]")))?;
        for (key, after) in list {
            let before = set(law, key, *after, mark);
            if before != Some(*after) {
                changes.push(Change {
                    key: format!("{name}: {key}"),
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
    let mut new = Value::from(after);
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
}
