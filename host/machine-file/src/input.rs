//! Reading of whole files, with a bound on size and time.

use std::fmt;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;
use std::sync::mpsc::sync_channel;
use std::time::Duration;

/// Largest machine file, stock file or script, bytes.
pub const SETTINGS_BYTES: u64 = 1 << 20;

/// Largest part program, bytes.
pub const PROGRAM_BYTES: u64 = 64 << 20;

/// Largest table of poses or joint positions, bytes.
pub const TABLE_BYTES: u64 = 256 << 20;

/// Longest time until a pipe or a device ends.
const PIPE: Duration = Duration::from_secs(10);

/// Reason why a file was not read, and the remedy.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReadError {
    /// The reason.
    pub what: String,
    /// The remedy.
    pub remedy: &'static str,
}

impl fmt::Display for ReadError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}; {}", self.what, self.remedy)
    }
}

impl From<io::Error> for ReadError {
    fn from(error: io::Error) -> Self {
        Self {
            what: format!("cannot be read: {error}"),
            remedy: "check the path",
        }
    }
}

/// The remedy for a file that cannot be read: a relative path into the folder `examples` or
/// `machines` is that of a copy of the repository, which an installed command has not.
#[must_use]
pub fn remedy_of(path: &Path, error: &io::Error) -> &'static str {
    let is_missing = error.kind() == io::ErrorKind::NotFound && path.is_relative();
    let folder = path.parent().and_then(Path::file_name);
    match folder.and_then(|folder| folder.to_str()) {
        Some("examples") if is_missing => {
            "check the path; `haptimill examples --out .` writes the examples"
        }
        Some("machines") if is_missing => {
            "check the path; `haptimill machine init` writes a machine file"
        }
        _ => "check the path",
    }
}

/// Reads a file to its end.
///
/// # Errors
///
/// Returns an error if the file cannot be opened or read, is larger than `max` bytes, or is a pipe
/// that does not end.
pub fn read(path: &Path, max: u64) -> Result<Vec<u8>, ReadError> {
    let kind = path.metadata().map_err(|error| ReadError {
        remedy: remedy_of(path, &error),
        ..ReadError::from(error)
    })?;
    if kind.is_file() && kind.len() > max {
        return Err(too_large(max));
    }
    if kind.is_file() || kind.is_dir() {
        return read_bounded(File::open(path)?, max);
    }
    // Opening or reading a pipe may block for ever; the thread ends with the process.
    let path = path.to_path_buf();
    let (sender, receiver) = sync_channel(1);
    std::thread::spawn(move || {
        let read = File::open(path).map_err(ReadError::from);
        let _ = sender.send(read.and_then(|file| read_bounded(file, max)));
    });
    receiver.recv_timeout(PIPE).unwrap_or_else(|_| {
        Err(ReadError {
            what: format!(
                "cannot be read: it is a pipe or a device that did not end within {} s",
                PIPE.as_secs()
            ),
            remedy: "give a regular file",
        })
    })
}

/// Reads a source to its end.
///
/// # Errors
/// As [`read`].
pub fn read_bounded(source: impl Read, max: u64) -> Result<Vec<u8>, ReadError> {
    let mut bytes = Vec::new();
    source.take(max + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > max {
        return Err(too_large(max));
    }
    Ok(bytes)
}

fn too_large(max: u64) -> ReadError {
    ReadError {
        what: format!("cannot be read: it is larger than {} MiB", max >> 20),
        remedy: "check that it is the right file",
    }
}
