//! Origins of work coordinate systems, which are kept beside a machine file.

use crate::commands::{CliError, Exit};
use haptimill_gcode::SYSTEM_NAMES;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::work_data::{self, WorkData, system_index};
use std::path::{Path, PathBuf};

/// The machine file that the offsets and tools are kept beside.
pub(crate) fn kept_beside(machine: &MachineFile) -> Result<PathBuf, CliError> {
    let path = PathBuf::from(&machine.file);
    if path.is_file() {
        // Damaged files are refused before the machine moves.
        WorkData::load(&path).map_err(|error| CliError::new(Exit::BadInput, error))?;
        return Ok(path);
    }
    let what = "offsets and tools are kept beside a machine file, and this machine is built in; \
                give a copy of its file with --machine (`haptimill machine init`)";
    Err(CliError::new(Exit::Usage, what))
}

/// Index of a work coordinate system.
pub(super) fn find_system(name: &str) -> Result<usize, CliError> {
    system_index(name).ok_or_else(|| {
        let known = SYSTEM_NAMES.map(str::to_lowercase).join(", ");
        let what = format!("{name}: no work coordinate system; write one of {known}");
        CliError::new(Exit::Usage, what)
    })
}

/// Index of a work coordinate system whose single coordinates can be set, and the work data.
pub(super) fn settable_system(file: &Path, name: &str) -> Result<(usize, WorkData), CliError> {
    let index = find_system(name)?;
    let data = WorkData::load(file).map_err(|error| CliError::new(Exit::BadInput, error))?;
    if data.offsets.systems[index].rotation == 0.0 {
        return Ok((index, data));
    }
    let what = format!(
        "{name} is turned about z, so its origin does not follow from single coordinates; set \
         rotation=0 first (`haptimill offset set`)"
    );
    Err(CliError::new(Exit::Refused, what))
}

/// Writes coordinates of the origin of a work coordinate system: indices of pose coordinates, and
/// mm or degrees of the machine.
///
/// # Errors
/// The name of the system is wrong, it is turned, or the file cannot be written.
pub(crate) fn set_origin(
    machine: &MachineFile,
    file: &Path,
    system: &str,
    origins: &[(usize, f64)],
) -> Result<(), CliError> {
    let (index, mut data) = settable_system(file, system)?;
    let described = machine.config.model.descriptor().pose;
    for (axis, origin) in origins {
        let letter = described.get(*axis).map(|axis| axis.letter.to_string());
        let slot = letter.and_then(|letter| work_data::axis_index(&letter));
        if let Some(slot) = slot {
            data.offsets.systems[index].origin[slot] = *origin;
        }
    }
    data.save_offsets(file)
        .map_err(|error| CliError::new(Exit::Output, error))
}
