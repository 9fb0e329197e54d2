//! Migration of machine files of an earlier format. Comments and the order of the keys stay.

use super::document::Document;
use super::format::{FORMAT, Kind, check, kind};
use super::keys::sections;
use super::problem::Problems;
use super::renamed::{DOOR_RUN_UP, IN_FORMAT_2, Renamed, renamed, split};
use toml_edit::{DocumentMut, Item, Key, Table, TableLike, value};

/// A machine file that was rewritten for [`FORMAT`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Migrated {
    /// Format of the file before; [`FORMAT`] for a fragment, which states none.
    pub from: u32,
    /// The new text.
    pub text: String,
    /// What was changed, one sentence each.
    pub changes: Vec<String>,
}

/// Names that differ between format 1 and format 2, in the order in which they change: the keys of
/// a section before the section.
const FORMAT_2: &[Renamed] = &[
    renamed("plant.arm", "plant.geometry.h4"),
    renamed("plant.hand", "plant.operator"),
    renamed("homing.table_rate_deg_s", "homing.rate_deg_s"),
    renamed("joint.still_mm", "joint.encoder_stuck_mm"),
    renamed("joint.still_deg", "joint.encoder_stuck_deg"),
    renamed("force.axis.gate", "force.axis.enable_condition"),
    renamed("haptic.ball_mm", "haptic.tip_ball_mm"),
    renamed("haptic.step_n", "haptic.force_step_n"),
    renamed("haptic.range.lean_low_deg", "haptic.range.hinge_low_deg"),
    renamed("haptic.range.lean_high_deg", "haptic.range.hinge_high_deg"),
    renamed(
        "haptic.leg.lean_counts_per_turn",
        "haptic.leg.hinge_counts_per_turn",
    ),
    renamed("haptic.leg.lean_home_deg", "haptic.leg.hinge_home_deg"),
    renamed("haptic.reflection.x_most_n", "haptic.reflection.x_limit_n"),
    renamed("haptic.reflection.y_most_n", "haptic.reflection.y_limit_n"),
    renamed("haptic.reflection.z_most_n", "haptic.reflection.z_limit_n"),
    renamed(
        "haptic.reflection.boost_n_s_per_mm",
        "haptic.reflection.damping_n_s_per_mm",
    ),
    renamed(
        "haptic.reflection.boost_below_n",
        "haptic.reflection.damping_below_n",
    ),
    renamed("haptic.reflection", "haptic.feedback"),
    renamed("haptic.wall.most_n", "haptic.wall.limit_n"),
    renamed("haptic.wall", "haptic.fixture"),
    renamed(
        "haptic.passivity.credit_n_mm",
        "haptic.passivity.surplus_n_mm",
    ),
    renamed(
        "haptic.passivity.debt_n_mm",
        "haptic.passivity.deficit_n_mm",
    ),
];

/// Rewrites the text of a machine file or fragment for [`FORMAT`]; `file` is its name in messages.
///
/// # Errors
///
/// Returns the problems of a text that is not TOML, not a machine file, or of a newer format.
pub fn migrate(file: &str, text: &str) -> Result<Migrated, Problems> {
    let document = Document::new(file, text, sections());
    let Some(root) = document.parse() else {
        return Err(document.into_problems());
    };
    let (from, states_format) = match kind(&document, root.get_ref()) {
        Some(Kind::Machine(from)) if from <= FORMAT => (from, true),
        Some(Kind::Fragment(_)) => (FORMAT, false),
        Some(_) => {
            check(&document, root.get_ref(), file);
            return Err(document.into_problems());
        }
        None => return Err(document.into_problems()),
    };
    let mut edited: DocumentMut = match text.parse() {
        Ok(edited) => edited,
        Err(error) => {
            // The two TOML parsers have the same grammar.
            document.report(0, "", error.to_string(), "correct the TOML");
            return Err(document.into_problems());
        }
    };
    let mut changes = Vec::new();
    if from < 2 || !states_format {
        to_format_2(&mut edited, &mut changes);
    }
    rename_all(&mut edited, IN_FORMAT_2, &mut changes);
    rename_door_run_up(&mut edited, &mut changes);
    rename_role(&mut edited, &mut changes);
    if from < FORMAT {
        set_format(&mut edited);
        changes.push(format!("format: {from} became {FORMAT}"));
    }
    Ok(Migrated {
        from,
        text: edited.to_string(),
        changes,
    })
}

/// The role of a machine that follows a master had another name, in both formats.
fn rename_role(edited: &mut DocumentMut, changes: &mut Vec<String>) {
    if let Some(role) = edited.get_mut("role").and_then(Item::as_value_mut)
        && role.as_str() == Some("slave")
    {
        let decor = role.decor().clone();
        *role = "machine".into();
        *role.decor_mut() = decor;
        changes.push("role: \"slave\" became \"machine\"".to_string());
    }
}

/// Rewrites the run-up time of a door in seconds.
fn rename_door_run_up(edited: &mut DocumentMut, changes: &mut Vec<String>) {
    let (path, name) = split(DOOR_RUN_UP.from);
    let (_, new_name) = split(DOOR_RUN_UP.to);
    each(edited.as_table_mut(), &path, &mut |input| {
        if !rename_in_place(input, name, new_name) {
            return;
        }
        if let Some(time) = input.get_mut(new_name).and_then(Item::as_value_mut) {
            let whole = time.as_integer().map(|time| time as f64);
            if let Some(time_ms) = time.as_float().or(whole) {
                let decor = time.decor().clone();
                *time = (time_ms / 1000.0).into();
                *time.decor_mut() = decor;
            }
        }
        changes.push(format!(
            "{} became {}, in seconds",
            DOOR_RUN_UP.from, DOOR_RUN_UP.to
        ));
    });
}

/// Format 2 has an explicit geometry of the simulated machine, and terms of the glossary.
fn to_format_2(edited: &mut DocumentMut, changes: &mut Vec<String>) {
    rename_all(edited, FORMAT_2, changes);
    remove_laws_of_step_drives(edited, changes);
    add_geometry(edited, changes);
}

fn rename_all(edited: &mut DocumentMut, names: &[Renamed], changes: &mut Vec<String>) {
    for renamed in names {
        if rename(edited.as_table_mut(), renamed) {
            changes.push(format!("{} became {}", renamed.from, renamed.to));
        }
    }
}

/// Removes the servo loops of step drives, which format 1 required and the controller did not use.
fn remove_laws_of_step_drives(edited: &mut DocumentMut, changes: &mut Vec<String>) {
    let joints = edited
        .get_mut("joint")
        .and_then(Item::as_array_of_tables_mut);
    for (index, joint) in joints
        .into_iter()
        .flat_map(|joints| joints.iter_mut())
        .enumerate()
    {
        let kind = joint.get("drive").and_then(|drive| drive.get("kind"));
        let has_step_drive = kind.and_then(Item::as_str) == Some("step");
        if has_step_drive && joint.remove("law").is_some() {
            changes.push(format!(
                "joint[{}].law was removed: a step drive has its own servo loop",
                index + 1
            ));
        }
    }
}

/// Adds the geometry of the simulated machine, which format 1 took to be the joints themselves.
/// The lengths of a linkage are those of the controller.
fn add_geometry(edited: &mut DocumentMut, changes: &mut Vec<String>) {
    let model = edited
        .get("kinematics")
        .and_then(|section| section.get("model"))
        .and_then(Item::as_str)
        .map(str::to_string);
    let lengths = edited.get("kinematics").and_then(Item::as_table_like);
    let mut geometry = Table::new();
    for (key, item) in lengths.iter().flat_map(|lengths| lengths.iter()) {
        if key != "model" {
            geometry.insert(key, item.clone());
        }
    }
    let plant = edited.get_mut("plant").and_then(Item::as_table_mut);
    let (Some(plant), Some(model)) = (plant, model) else {
        return;
    };
    if plant.contains_key("geometry") {
        return;
    }
    let why = match geometry.is_empty() {
        true => "no errors",
        false => "the lengths of [kinematics]",
    };
    changes.push(format!("plant.geometry.{model} was added, with {why}"));
    // Behind [plant] itself, before its subsections.
    geometry.set_position(plant.position());
    geometry.decor_mut().set_prefix("\n");
    let mut parent = Table::new();
    parent.set_implicit(true);
    parent.insert(&model, Item::Table(geometry));
    plant.insert("geometry", Item::Table(parent));
}

/// Moves a section or key to its new path; returns whether there was one.
fn rename(root: &mut Table, renamed: &Renamed) -> bool {
    let (path, name) = split(renamed.from);
    let (new_path, new_name) = split(renamed.to);
    let mut found = false;
    if path == new_path {
        each(root, &path, &mut |table| {
            found |= rename_in_place(table, name, new_name);
        });
        return found;
    }
    let mut moved = None;
    each(root, &path, &mut |table| moved = table.remove(name));
    let Some(moved) = moved else { return false };
    let mut table: &mut dyn TableLike = root;
    for part in new_path {
        let item = table.entry(part).or_insert_with(|| {
            let mut parent = Table::new();
            parent.set_implicit(true);
            Item::Table(parent)
        });
        match item.as_table_like_mut() {
            Some(inner) => table = inner,
            None => return false,
        }
    }
    table.insert(new_name, moved);
    true
}

/// Calls `with` for every table at a path; a list of sections has several.
fn each(table: &mut dyn TableLike, path: &[&str], with: &mut dyn FnMut(&mut dyn TableLike)) {
    let Some((first, rest)) = path.split_first() else {
        return with(table);
    };
    match table.get_mut(first) {
        Some(Item::ArrayOfTables(list)) => {
            for table in list.iter_mut() {
                each(table, rest, with);
            }
        }
        Some(item) => {
            if let Some(table) = item.as_table_like_mut() {
                each(table, rest, with);
            }
        }
        None => {}
    }
}

/// Renames a key at its place; returns whether there was one.
fn rename_in_place(table: &mut dyn TableLike, name: &str, new_name: &str) -> bool {
    if !table.contains_key(name) {
        return false;
    }
    let names: Vec<String> = table.iter().map(|(key, _)| key.to_string()).collect();
    // The order is that of insertion: every key is taken out and put back.
    for old in names {
        let key = table.key(&old).cloned();
        let (Some(key), Some(item)) = (key, table.remove(&old)) else {
            continue;
        };
        let key = if old == name {
            Key::new(new_name)
                .with_leaf_decor(key.leaf_decor().clone())
                .with_dotted_decor(key.dotted_decor().clone())
        } else {
            key
        };
        table.entry_format(&key).or_insert(item);
    }
    true
}

/// Writes the format as the first key. Comments at the head of the file stay there.
fn set_format(edited: &mut DocumentMut) {
    let table = edited.as_table_mut();
    if table.contains_key("format") {
        table["format"] = value(i64::from(FORMAT));
        return;
    }
    let names: Vec<String> = table.iter().map(|(key, _)| key.to_string()).collect();
    let mut entries = Vec::new();
    for name in names {
        entries.extend(table.remove_entry(&name));
    }
    let mut format = Key::new("format");
    if let Some((first, item)) = entries.first_mut()
        && item.is_value()
    {
        let head = first.leaf_decor().prefix().cloned();
        first.leaf_decor_mut().set_prefix("");
        format.leaf_decor_mut().set_prefix(head.unwrap_or_default());
    }
    table.insert_formatted(&format, value(i64::from(FORMAT)));
    for (key, item) in entries {
        table.insert_formatted(&key, item);
    }
}
