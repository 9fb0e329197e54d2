//! The folder for the results of a run: created, locked, and cleared of earlier results.

use crate::commands::{CliError, Exit};
use haptimill_trace::{RESERVE_BYTES, free_bytes};
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};

/// The locked result folder of a running command.
#[derive(Debug)]
pub(in crate::commands) struct ResultFolder {
    dir: PathBuf,
    /// This command created the folder, and removes it if it stays empty.
    created: bool,
    /// The operating system releases the lock when the process ends.
    _lock: Option<File>,
}

impl ResultFolder {
    /// Creates and locks the folder, and checks that files can be written, before the machine
    /// moves.
    ///
    /// # Errors
    /// [`Exit::Output`]: it cannot be written, or another run uses it.
    pub(in crate::commands) fn open(dir: &Path) -> Result<Self, CliError> {
        let failed = |what: &dyn std::fmt::Display| folder_error(dir, what);
        let created = !dir.exists();
        std::fs::create_dir_all(dir).map_err(|error| failed(&error))?;
        let lock = match lock(dir) {
            Ok(lock) => lock,
            Err(TryLockError::WouldBlock) => {
                return Err(failed(&"another run is writing its results there"));
            }
            Err(TryLockError::Error(error)) => return Err(failed(&error)),
        };
        check_writable(dir).map_err(|error| failed(&error))?;
        Ok(Self {
            dir: dir.to_path_buf(),
            created,
            _lock: lock,
        })
    }

    /// Removes the results of an earlier run. Callers must not clear the folder before the run has
    /// results: a run that fails to start must not destroy an earlier recording.
    ///
    /// # Errors
    /// [`Exit::Output`]: it cannot be removed.
    pub(in crate::commands) fn clear(&self) -> Result<(), CliError> {
        remove_results(&self.dir).map_err(|error| folder_error(&self.dir, &error))
    }
}

/// Refuses a recording of about this size that does not fit on the disk, before the machine moves.
///
/// # Errors
/// [`Exit::Output`].
pub(in crate::commands) fn check_space(dir: &Path, bytes: f64) -> Result<(), CliError> {
    // The folder may not exist yet; its nearest existing parent is on the same disk.
    let existing = dir.ancestors().find(|path| path.is_dir());
    let here = Path::new(".");
    let existing = existing.filter(|path| !path.as_os_str().is_empty());
    let Some(free) = free_bytes(existing.unwrap_or(here)) else {
        return Ok(());
    };
    if bytes + RESERVE_BYTES as f64 <= free as f64 {
        return Ok(());
    }
    let mb = |bytes: f64| bytes / 1e6;
    let what = format!(
        "the recording needs about {:.0} MB and a reserve of {:.0} MB, and {:.0} MB are free; \
         nothing moved",
        mb(bytes),
        mb(RESERVE_BYTES as f64),
        mb(free as f64)
    );
    Err(folder_error(dir, &what))
}

/// The error of a recording that ended before its job.
pub(in crate::commands) fn disk_full(dir: &Path) -> CliError {
    let what = format!(
        "{}: the disk is nearly full, so the machine was stopped along its path; the results up to \
         then are kept; free some space, or choose another folder with --out",
        dir.display()
    );
    CliError::new(Exit::Output, what)
}

/// The error of a recording that cannot be written.
pub(in crate::commands) fn recording_error(dir: &Path, error: &dyn std::fmt::Display) -> CliError {
    let what = format!(
        "{}: {}: {error}; the job was stopped, and the recording is kept up to its last complete \
         block",
        dir.display(),
        haptimill_report::RECORDING_FILE
    );
    CliError::new(Exit::Output, what)
}

impl Drop for ResultFolder {
    fn drop(&mut self) {
        if self.created {
            // Fails if the folder has results.
            let _ = std::fs::remove_dir(&self.dir);
        }
    }
}

fn folder_error(dir: &Path, what: &dyn std::fmt::Display) -> CliError {
    let dir = dir.display();
    let text = format!("{dir}: {what}; choose another folder with --out");
    CliError::new(Exit::Output, text)
}

/// Locks a folder against other runs; none where the file system has no locks.
fn lock(dir: &Path) -> Result<Option<File>, TryLockError> {
    // On Unix the folder itself can be locked. Elsewhere a file in it is locked.
    #[cfg(unix)]
    let file = File::open(dir).map_err(TryLockError::Error)?;
    #[cfg(not(unix))]
    let file = File::create(dir.join("run.lock")).map_err(TryLockError::Error)?;
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(TryLockError::WouldBlock) => Err(TryLockError::WouldBlock),
        // Some network file systems cannot lock a folder; the job runs without the lock.
        Err(TryLockError::Error(_)) => Ok(None),
    }
}

/// Checks that files can be written. Earlier results stay unchanged.
fn check_writable(dir: &Path) -> std::io::Result<()> {
    let recording = dir.join(haptimill_report::RECORDING_FILE);
    let new = !recording.exists();
    File::options().append(true).create(true).open(&recording)?;
    if new {
        std::fs::remove_file(recording)?;
    }
    Ok(())
}

fn remove_results(dir: &Path) -> std::io::Result<()> {
    for name in [
        haptimill_report::RECORDING_FILE,
        // Of a run with --record last that was killed.
        "recording.earlier.hmr",
        "recording.joined.hmr",
        haptimill_report::MCAP_FILE,
        haptimill_report::TRACE_FILE,
        haptimill_report::SUMMARY_FILE,
        haptimill_report::REPORT_FILE,
        "teleop.csv",
        "master.hmr",
    ] {
        let old = dir.join(name);
        if old.exists() {
            std::fs::remove_file(old)?;
        }
    }
    Ok(())
}
