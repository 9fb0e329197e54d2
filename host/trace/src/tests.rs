//! Tests of recordings.

mod format;
mod recorder;
mod values;

use super::*;
use haptimill_machine_file::MachineFile;
use std::path::PathBuf;

/// Temporary file; dropping it removes the file.
pub struct TemporaryFile(pub(crate) PathBuf);

impl TemporaryFile {
    pub(crate) fn new(name: &str) -> Self {
        let name = format!("haptimill-{}-{name}", std::process::id());
        Self(std::env::temp_dir().join(name))
    }
}

impl Drop for TemporaryFile {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

pub(crate) fn header() -> Header {
    Header::of(&MachineFile::built_in().unwrap(), "circle.ngc").unwrap()
}
