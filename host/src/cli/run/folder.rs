//! The folder for the results of a run: made, emptied of what an earlier run left, and held against another run.

use super::{CliError, Exit};
use crate::report;
use std::fs::{File, TryLockError};
use std::path::Path;

/// The folder of a run that is under way.
#[derive(Debug)]
pub(in crate::cli) struct Folder {
    /// Its lock goes with this file, however the process ends; nothing stays behind.
    _lock: Option<File>,
}

impl Folder {
    /// Sees to it that the results can be written, before anything moves, and that no other run writes them.
    ///
    /// # Errors
    /// [`Exit::Output`]: it cannot be written, or another run has it.
    pub(in crate::cli) fn take(dir: &Path) -> Result<Self, CliError> {
        let failed = |what: &dyn std::fmt::Display| {
            CliError::new(
                Exit::Output,
                format!(
                    "{}: {what}; choose another folder with --out",
                    dir.display()
                ),
            )
        };
        std::fs::create_dir_all(dir).map_err(|error| failed(&error))?;
        let lock = match lock(dir) {
            Ok(lock) => lock,
            Err(TryLockError::WouldBlock) => {
                return Err(failed(&"another run is writing its results there"));
            }
            Err(TryLockError::Error(error)) => return Err(failed(&error)),
        };
        empty(dir).map_err(|error| failed(&error))?;
        Ok(Self { _lock: lock })
    }
}

/// Locks a folder against other runs; none where the file system knows no locks.
fn lock(dir: &Path) -> Result<Option<File>, TryLockError> {
    // On Unix the folder itself can be locked. Elsewhere it cannot be opened, and a file in it stands for it.
    #[cfg(unix)]
    let file = File::open(dir).map_err(TryLockError::Error)?;
    #[cfg(not(unix))]
    let file = File::create(dir.join("run.lock")).map_err(TryLockError::Error)?;
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(TryLockError::WouldBlock) => Err(TryLockError::WouldBlock),
        // Some network file systems lock no folders; a job is not to fail for that.
        Err(TryLockError::Error(_)) => Ok(None),
    }
}

/// Tries to write, and removes what an earlier run left: it would be taken for the result of this one.
fn empty(dir: &Path) -> std::io::Result<()> {
    let recording = dir.join(report::RECORDING_FILE);
    File::options().append(true).create(true).open(&recording)?;
    for name in [
        report::RECORDING_FILE,
        report::MCAP_FILE,
        report::TRACE_FILE,
        report::SUMMARY_FILE,
        report::REPORT_FILE,
        "hand.csv",
        "hand.hmr",
    ] {
        let old = dir.join(name);
        if old.exists() {
            std::fs::remove_file(old)?;
        }
    }
    Ok(())
}
