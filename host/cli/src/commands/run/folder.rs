//! The folder for the results of a run: made, held against another run, and emptied of what an earlier run left once there is something new.

use super::{CliError, Exit};
use haptimill_trace::{RESERVE_BYTES, free_bytes};
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};

/// The folder of a run that is under way.
#[derive(Debug)]
pub(in crate::commands) struct Folder {
    dir: PathBuf,
    /// It was not there before: a command that leaves nothing in it takes it away again.
    made: bool,
    /// Its lock goes with this file, however the process ends; nothing stays behind.
    _lock: Option<File>,
}

impl Folder {
    /// Sees to it that the results can be written, before anything moves, and that no other run writes them.
    ///
    /// # Errors
    /// [`Exit::Output`]: it cannot be written, or another run has it.
    pub(in crate::commands) fn take(dir: &Path) -> Result<Self, CliError> {
        let failed = |what: &dyn std::fmt::Display| failed(dir, what);
        let made = !dir.exists();
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
            made,
            _lock: lock,
        })
    }

    /// Removes what an earlier run left, which would be taken for the result of this one. Not before this one has a result of its own: a run that
    /// does not begin says nothing that would be worth another's recording.
    ///
    /// # Errors
    /// [`Exit::Output`]: it cannot be removed.
    pub(in crate::commands) fn empty(&self) -> Result<(), CliError> {
        empty(&self.dir).map_err(|error| failed(&self.dir, &error))
    }
}

/// Refuses a recording that does not fit on the disk, before anything moves; `bytes` it has about.
///
/// # Errors
/// [`Exit::Output`].
pub(in crate::commands) fn has_space(dir: &Path, bytes: f64) -> Result<(), CliError> {
    // The folder may not be there yet; its nearest parent is on the same disk.
    let there = dir.ancestors().find(|path| path.is_dir());
    let here = Path::new(".");
    let there = there.filter(|path| !path.as_os_str().is_empty());
    let Some(free) = free_bytes(there.unwrap_or(here)) else {
        return Ok(());
    };
    if bytes + RESERVE_BYTES as f64 <= free as f64 {
        return Ok(());
    }
    let mb = |bytes: f64| bytes / 1e6;
    let what = format!(
        "the recording needs about {:.0} MB beside {:.0} MB that stay free, and {:.0} MB are free; nothing moved",
        mb(bytes),
        mb(RESERVE_BYTES as f64),
        mb(free as f64)
    );
    Err(failed(dir, &what))
}

/// What to say of a recording that ended before its job.
pub(in crate::commands) fn disk_full(dir: &Path) -> CliError {
    let what = format!(
        "{}: the disk is nearly full, so the machine was stopped along its path; the results up to there are kept; free some space, or choose another folder with --out",
        dir.display()
    );
    CliError::new(Exit::Output, what)
}

/// What to say of a recording that could not be written.
pub(in crate::commands) fn broken(dir: &Path, error: &dyn std::fmt::Display) -> CliError {
    let what = format!(
        "{}: {}: {error}; the job was stopped for it, and the recording is kept up to its last whole block",
        dir.display(),
        haptimill_report::RECORDING_FILE
    );
    CliError::new(Exit::Output, what)
}

impl Drop for Folder {
    fn drop(&mut self) {
        if self.made {
            // Refused by the system when there are results in it.
            let _ = std::fs::remove_dir(&self.dir);
        }
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
    let recording = dir.join(haptimill_report::RECORDING_FILE);
    let new = !recording.exists();
    File::options().append(true).create(true).open(&recording)?;
    if new {
        std::fs::remove_file(recording)?;
    }
    Ok(())
}

fn empty(dir: &Path) -> std::io::Result<()> {
    for name in [
        haptimill_report::RECORDING_FILE,
        haptimill_report::MCAP_FILE,
        haptimill_report::TRACE_FILE,
        haptimill_report::SUMMARY_FILE,
        haptimill_report::REPORT_FILE,
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
