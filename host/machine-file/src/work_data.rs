//! Work offsets and tool table of a machine: files beside the machine file.
//!
//! `mill.toml` has `mill.offsets.toml` and `mill.tools.toml`. Values are mm and degrees:
//!
//! ```toml
//! [g54]
//! x = 12.5
//! rotation = 0.0
//!
//! [g28]
//! z = 100.0
//! ```
//! ```toml
//! [t1]
//! z = 52.25
//! diameter = 6.0
//! ```
//!
//! A file is written to a new name and renamed, so that it is never half written; the old one stays
//! as `.bak`.

use crate::MachineFile;
use crate::input::{self, SETTINGS_BYTES};
use haptimill_gcode::{Offsets, PerLetter, SYSTEM_NAMES, Tool, ToolTable};
use std::fmt::Write as _;
use std::fs::File;
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Keys of the axes, in the order of [`PerLetter`].
const AXES: [&str; 9] = ["x", "y", "z", "a", "b", "c", "u", "v", "w"];

/// First line of a file of offsets.
const OFFSETS_HEAD: &str = "# Work offsets: origins in machine coordinates, mm, degrees. The last \
                            line is \"# end\".\n";

/// First line of a tool table.
const TOOLS_HEAD: &str = "# Tool table: lengths and diameters, mm. The last line is \"# end\".\n";

/// Last line of both: a file without it was cut.
const END: &str = "# end";

/// Largest magnitude of an offset, mm or degrees.
const LARGEST: f64 = 1e6;

/// Work offsets and tool table.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct WorkData {
    /// Work offsets and reference positions.
    pub offsets: Offsets,
    /// Tools by number.
    pub tools: ToolTable,
}

/// Returns the file of the work offsets of a machine file.
#[must_use]
pub fn offsets_path(machine: &Path) -> PathBuf {
    machine.with_extension("offsets.toml")
}

/// Returns the file of the tool table of a machine file.
#[must_use]
pub fn tools_path(machine: &Path) -> PathBuf {
    machine.with_extension("tools.toml")
}

fn backup_path(path: &Path) -> PathBuf {
    path.with_extension("toml.bak")
}

impl WorkData {
    /// Loads the files beside the file of a machine; a machine that is built in has none.
    ///
    /// # Errors
    ///
    /// As [`WorkData::load`].
    pub fn beside(machine: &MachineFile) -> Result<WorkData, String> {
        let path = Path::new(&machine.file);
        if !path.is_file() {
            return Ok(WorkData::default());
        }
        Self::load(path)
    }

    /// Loads the files beside a machine file; a file that does not exist is empty.
    ///
    /// # Errors
    ///
    /// A file cannot be read or is damaged; the text names it, the remedy and its backup.
    pub fn load(machine: &Path) -> Result<WorkData, String> {
        let mut data = WorkData::default();
        let path = offsets_path(machine);
        for (name, table) in &sections(&path, OFFSETS_HEAD)? {
            let refuse = |what: String| damaged(&path, &what);
            if let Some(index) = system_index(name) {
                let system = &mut data.offsets.systems[index];
                system.rotation = read_values(name, table, &mut system.origin, "rotation")
                    .map_err(refuse)?
                    .unwrap_or(0.0);
                continue;
            }
            let values = match name.as_str() {
                "g28" => &mut data.offsets.g28,
                "g30" => &mut data.offsets.g30,
                _ => {
                    let what = format!("[{name}] is not one of g54 to g59_3, g28, g30");
                    return Err(refuse(what));
                }
            };
            read_values(name, table, values, "").map_err(refuse)?;
        }
        let path = tools_path(machine);
        for (name, table) in &sections(&path, TOOLS_HEAD)? {
            let refuse = |what: String| damaged(&path, &what);
            let number = name
                .strip_prefix('t')
                .and_then(|text| text.parse::<u32>().ok())
                .filter(|number| (1..=99_999).contains(number))
                .ok_or_else(|| refuse(format!("[{name}] is not one of t1 to t99999")))?;
            if data.tools.contains_key(&number) {
                return Err(refuse(format!("[{name}] is tool {number} again")));
            }
            let mut tool = Tool::default();
            tool.diameter = read_values(name, table, &mut tool.offset, "diameter")
                .map_err(refuse)?
                .unwrap_or(0.0);
            // Compensation would go to the other side of the contour.
            if tool.diameter < 0.0 {
                return Err(refuse(format!("[{name}] diameter is below 0")));
            }
            data.tools.insert(number, tool);
        }
        Ok(data)
    }

    /// Takes over the offsets and tools of a program, and writes the files that change. Without the
    /// file of a machine nothing is written. Returns whether the offsets and whether the tools
    /// differ.
    ///
    /// # Errors
    ///
    /// A file cannot be written; the old one is unchanged.
    pub fn keep(
        &mut self,
        offsets: Offsets,
        tools: &ToolTable,
        machine: Option<&Path>,
    ) -> Result<[bool; 2], String> {
        let kept = &self.offsets;
        let new_offsets =
            offsets.systems != kept.systems || offsets.g28 != kept.g28 || offsets.g30 != kept.g30;
        let new_tools = *tools != self.tools;
        self.offsets = offsets;
        self.tools.clone_from(tools);
        if let Some(machine) = machine {
            if new_offsets {
                self.save_offsets(machine)?;
            }
            if new_tools {
                self.save_tools(machine)?;
            }
        }
        Ok([new_offsets, new_tools])
    }

    /// Writes the work offsets of a machine file.
    ///
    /// # Errors
    ///
    /// The file cannot be written; the old one is unchanged.
    pub fn save_offsets(&self, machine: &Path) -> Result<(), String> {
        let mut text = String::from(OFFSETS_HEAD);
        for (name, system) in SYSTEM_NAMES.iter().zip(&self.offsets.systems) {
            let key = name.to_ascii_lowercase().replace('.', "_");
            write_section(
                &mut text,
                &key,
                &system.origin,
                ("rotation", system.rotation),
            );
        }
        write_section(&mut text, "g28", &self.offsets.g28, ("", 0.0));
        write_section(&mut text, "g30", &self.offsets.g30, ("", 0.0));
        let _ = writeln!(text, "\n{END}");
        replace(&offsets_path(machine), &text)
    }

    /// Writes the tool table of a machine file.
    ///
    /// # Errors
    ///
    /// The file cannot be written; the old one is unchanged.
    pub fn save_tools(&self, machine: &Path) -> Result<(), String> {
        let mut text = String::from(TOOLS_HEAD);
        for (number, tool) in &self.tools {
            let _ = writeln!(text, "\n[t{number}]");
            write_values(&mut text, &tool.offset, ("diameter", tool.diameter));
        }
        let _ = writeln!(text, "\n{END}");
        replace(&tools_path(machine), &text)
    }
}

/// Returns the index of a work coordinate system from its name, as `g54` or `G59.1`.
#[must_use]
pub fn system_index(name: &str) -> Option<usize> {
    let name = name.replace('_', ".");
    SYSTEM_NAMES
        .iter()
        .position(|system| system.eq_ignore_ascii_case(&name))
}

/// Returns the index of an axis from its letter.
#[must_use]
pub fn axis_index(letter: &str) -> Option<usize> {
    AXES.iter()
        .position(|axis| axis.eq_ignore_ascii_case(letter))
}

fn damaged(path: &Path, what: &str) -> String {
    let backup = backup_path(path);
    let remedy = if backup.exists() {
        format!("correct it, or restore its backup {}", backup.display())
    } else {
        "correct it, or remove it; it has no backup".to_owned()
    };
    format!("{}: {what}; {remedy}", path.display())
}

/// Reads a file that begins with `head`, if the project wrote it.
fn sections(path: &Path, head: &str) -> Result<Table, String> {
    if let Err(error) = path.metadata()
        && error.kind() == ErrorKind::NotFound
    {
        let backup = backup_path(path);
        if !backup.exists() {
            return Ok(Table::new());
        }
        return Err(format!(
            "{}: is missing beside its backup; restore {}, or remove it as well",
            path.display(),
            backup.display()
        ));
    }
    let bytes = input::read(path, SETTINGS_BYTES).map_err(|error| damaged(path, &error.what))?;
    let text = String::from_utf8(bytes).map_err(|_| damaged(path, "is not UTF-8"))?;
    let is_ours = text.starts_with(head);
    if is_ours && text.lines().next_back() != Some(END) {
        return Err(damaged(
            path,
            "the last line \"# end\" is missing, so the file was cut",
        ));
    }
    if !is_ours && head.starts_with(&text) && backup_path(path).exists() {
        return Err(damaged(
            path,
            "is empty beside its backup, so the file was cut",
        ));
    }
    text.parse::<Table>()
        .map_err(|error| damaged(path, error.to_string().trim_end()))
}

/// Reads the axes of a section, and a further key.
fn read_values(
    name: &str,
    table: &Value,
    values: &mut PerLetter,
    further: &str,
) -> Result<Option<f64>, String> {
    let table = table
        .as_table()
        .ok_or_else(|| format!("{name} is not a section"))?;
    let mut found = None;
    for (key, value) in table {
        let number = value
            .as_float()
            .or_else(|| value.as_integer().map(|whole| whole as f64))
            .filter(|number| number.abs() <= LARGEST)
            .ok_or_else(|| format!("[{name}] {key} is not a number up to {LARGEST}"))?;
        if key == further && !further.is_empty() {
            found = Some(number);
        } else if let Some(axis) = AXES.iter().position(|axis| axis == key) {
            values[axis] = number;
        } else {
            return Err(format!("[{name}] has the unknown key {key}"));
        }
    }
    Ok(found)
}

fn write_section(text: &mut String, name: &str, values: &PerLetter, further: (&str, f64)) {
    if values.iter().all(|value| *value == 0.0) && further.1 == 0.0 {
        return;
    }
    let _ = writeln!(text, "\n[{name}]");
    write_values(text, values, further);
}

/// Writes the values that are not 0.
fn write_values(text: &mut String, values: &PerLetter, further: (&str, f64)) {
    for (axis, value) in AXES.iter().zip(values) {
        if *value != 0.0 {
            let _ = writeln!(text, "{axis} = {value:?}");
        }
    }
    if further.1 != 0.0 {
        let _ = writeln!(text, "{} = {:?}", further.0, further.1);
    }
}

/// Replaces a file at once; the old one becomes the backup.
fn replace(path: &Path, text: &str) -> Result<(), String> {
    let failed = |what: &str, error: std::io::Error| {
        format!("{}: {what}: {error}; check the folder", path.display())
    };
    let new = path.with_extension("toml.new");
    let replaced = File::create(&new)
        .and_then(|mut file| {
            file.write_all(text.as_bytes())?;
            file.sync_all()
        })
        .map_err(|error| failed("cannot be written", error))
        .and_then(|()| keep_backup(path, failed))
        .and_then(|()| {
            std::fs::rename(&new, path).map_err(|error| failed("cannot be replaced", error))
        });
    if replaced.is_err() {
        // The first error is the one to report.
        let _ = std::fs::remove_file(&new);
    }
    replaced
}

/// Copies a file to its backup, which is replaced when the copy is complete.
fn keep_backup(path: &Path, failed: impl Fn(&str, std::io::Error) -> String) -> Result<(), String> {
    if !path.exists() {
        return Ok(());
    }
    let new = path.with_extension("toml.bak.new");
    let kept = std::fs::copy(path, &new).and_then(|_| std::fs::rename(&new, backup_path(path)));
    if kept.is_err() {
        let _ = std::fs::remove_file(&new);
    }
    kept.map_err(|error| failed("its backup cannot be written", error))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn machine(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("haptimill-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        folder.join("mill.toml")
    }

    /// A file that was cut anywhere is refused with the name of its backup, and is never taken for
    /// offsets of zero.
    #[test]
    fn a_file_that_was_cut_is_refused() {
        let machine = machine("cut");
        let mut data = WorkData::default();
        data.offsets.systems[0].origin = [12.5, -3.25, 100.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        data.offsets.g28[2] = 80.0;
        data.tools.insert(4, Tool::default());
        for _ in 0..2 {
            data.save_offsets(&machine).expect("written");
            data.save_tools(&machine).expect("written");
        }
        for path in [offsets_path(&machine), tools_path(&machine)] {
            let whole = std::fs::read_to_string(&path).expect("read");
            let length = whole.trim_end().len();
            for cut in 0..length {
                std::fs::write(&path, &whole[..cut]).expect("written");
                let refused = WorkData::load(&machine).expect_err("cut");
                assert!(refused.contains(".toml.bak"), "{cut}: {refused}");
            }
            std::fs::write(&path, &whole[..length]).expect("written");
            assert_eq!(WorkData::load(&machine).expect("whole"), data);
        }
        std::fs::remove_dir_all(machine.parent().expect("a folder")).expect("removed");
    }

    #[test]
    fn offsets_are_kept_with_a_backup() {
        let machine = machine("offsets");
        let mut data = WorkData::load(&machine).expect("empty");
        assert_eq!(data, WorkData::default());
        data.offsets.systems[0].origin[0] = 12.5;
        data.offsets.systems[8].rotation = -0.1;
        data.offsets.g28[2] = 1e-7;
        data.save_offsets(&machine).expect("written");
        assert_eq!(WorkData::load(&machine).expect("read"), data);
        let first = std::fs::read_to_string(offsets_path(&machine)).expect("read");
        data.offsets.systems[0].origin[0] = 0.0;
        data.save_offsets(&machine).expect("written");
        assert_eq!(WorkData::load(&machine).expect("read"), data);
        let backup = machine.with_extension("offsets.toml.bak");
        assert_eq!(std::fs::read_to_string(&backup).expect("backup"), first);
        // A file that is gone beside its backup is no file with offsets of zero.
        std::fs::remove_file(offsets_path(&machine)).expect("removed");
        let refused = WorkData::load(&machine).expect_err("gone");
        assert!(refused.contains("mill.offsets.toml.bak"), "{refused}");
        std::fs::remove_file(backup).expect("removed");
        assert_eq!(
            WorkData::load(&machine).expect("empty"),
            WorkData::default()
        );
        std::fs::remove_dir_all(machine.parent().expect("a folder")).expect("removed");
    }

    #[test]
    fn damaged_files_are_refused_with_their_backup() {
        let machine = machine("damaged");
        let path = offsets_path(&machine);
        for text in [
            "[g54\nx = 1",
            "[g54]\nx = 'a'",
            "[g54]\nq = 1",
            "[g99]\nx = 1",
            "[g54]\nx = nan",
            "g54 = 1",
            "\u{0}",
        ] {
            std::fs::write(&path, text).expect("written");
            let error = WorkData::load(&machine).expect_err(text);
            assert!(error.contains("mill.offsets.toml: "), "{error}");
            assert!(error.contains("it has no backup"), "{error}");
        }
        std::fs::write(path.with_extension("toml.bak"), "").expect("written");
        let error = WorkData::load(&machine).expect_err("damaged");
        assert!(error.contains("mill.offsets.toml.bak"), "{error}");
        std::fs::remove_dir_all(machine.parent().expect("a folder")).expect("removed");
    }

    #[test]
    fn tools_have_lengths_and_diameters() {
        let machine = machine("tools");
        std::fs::write(tools_path(&machine), "[t3]\nz = 52\ndiameter = 6.5\n").expect("written");
        let data = WorkData::load(&machine).expect("read");
        assert_eq!(data.tools[&3].offset[2], 52.0);
        assert_eq!(data.tools[&3].diameter, 6.5);
        let mut more = data.clone();
        more.tools.insert(99, Tool::default());
        more.save_tools(&machine).expect("written");
        assert_eq!(WorkData::load(&machine).expect("read"), more);
        assert!(machine.with_extension("tools.toml.bak").exists());
        std::fs::write(tools_path(&machine), "[t0]\nz = 52\n").expect("written");
        assert!(WorkData::load(&machine).is_err());
        std::fs::write(tools_path(&machine), "[t1]\ndiameter = -5\n").expect("written");
        let error = WorkData::load(&machine).expect_err("below 0");
        assert!(error.contains("[t1] diameter is below 0"), "{error}");
        std::fs::remove_dir_all(machine.parent().expect("a folder")).expect("removed");
    }
}
