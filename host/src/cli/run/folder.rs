//! The folder for the results of a run: made, held against another run, and emptied of what an earlier run left once there is something new.

use super::{CliError, Exit};
use crate::report;
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};

/// The folder of a run that is under way.
#[derive(Debug)]
pub(in crate::cli) struct Folder {
    dir: PathBuf,
    /// Its lock goes with this file, however the process ends; nothing stays behind.
    _lock: Option<File>,
}

impl Folder {
    /// Sees to it that the results can be written, before anything moves, and that no other run writes them.
    ///
    /// # Errors
    /// [`Exit::Output`]: it cannot be written, or another run has it.
    pub(in crate::cli) fn take(dir: &Path) -> Result<Self, CliError> {
        let failed = |what: &dyn std::fmt::Display| failed(dir, what);
        std::fs::create_dir_all(dir).map_err(|error| failed(&error))?;
        let lock = match lock(dir) {
            Ok(lock) => lock,
            Err(TryLockError::WouldBlock) => {
                return Err(failed(&"another run is writing its results there"));
            }
            Err(TryLockError::Error(error)) => return Err(failed(&error)),
        };
        writable(dir).map_err(|error| failed(&error))?;
        Ok(Self {
            dir: dir.to_path_buf(),
            _lock: lock,
        })
    }

    /// Removes what an earlier run left, which would be taken for the result of this one. Not before this one has a result of its own: a run that
    /// does not begin says nothing that would be worth another's recording.
    ///
    /// # Errors
    /// [`Exit::Output`]: it cannot be removed.
    pub(in crate::cli) fn empty(&self) -> Result<(), CliError> {
        empty(&self.dir).map_err(|error| failed(&self.dir, &error))
    }
}

fn failed(dir: &Path, what: &dyn std::fmt::Display) -> CliError {
    let dir = dir.display();
    let text = format!("{dir}: {what}; choose another folder with --out");
    CliError::new(Exit::Output, text)
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

/// Tries to write. What an earlier run left stays as it is.
fn writable(dir: &Path) -> std::io::Result<()> {
    let recording = dir.join(report::RECORDING_FILE);
    let new = !recording.exists();
    File::options().append(true).create(true).open(&recording)?;
    if new {
        std::fs::remove_file(recording)?;
    }
    Ok(())
}

fn empty(dir: &Path) -> std::io::Result<()> {
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
