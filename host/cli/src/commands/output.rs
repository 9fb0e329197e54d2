//! Output of a command: standard output and files.

use super::{CliError, Exit};
use std::ffi::OsString;
use std::fmt;
use std::fs::{self, File};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// The first error of a write to standard output.
static STDOUT_ERROR: Mutex<Option<io::Error>> = Mutex::new(None);

/// Writes to standard output. An error is reported at the end of the command, see [`take_error`].
pub(super) fn to_stdout(write: impl FnOnce(&mut dyn Write) -> io::Result<()>) {
    let mut out = io::stdout().lock();
    if let Err(error) = write(&mut out).and_then(|()| out.flush()) {
        keep_error(error);
    }
}

/// Keeps the first error of standard output. A closed pipe (`| head`) is no error.
pub(super) fn keep_error(error: io::Error) {
    if error.kind() != ErrorKind::BrokenPipe {
        let mut first = STDOUT_ERROR.lock().unwrap_or_else(PoisonError::into_inner);
        first.get_or_insert(error);
    }
}

/// Prints a line on standard output, for `print_line!`.
pub(super) fn print_line(line: fmt::Arguments<'_>) {
    // One write, so that a reader never gets half a line.
    let line = format!("{line}\n");
    to_stdout(|out| out.write_all(line.as_bytes()));
}

/// The error of standard output, if there was one.
pub(super) fn take_error() -> Option<CliError> {
    let error = STDOUT_ERROR
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .take();
    error.map(|error| write_error(Path::new("standard output"), error))
}

/// The error of a file that cannot be written.
pub(super) fn write_error(path: &Path, error: impl fmt::Display) -> CliError {
    CliError::new(Exit::Output, format!("{}: {error}", path.display()))
}

/// Writes a file. An earlier file of that name stays until the new one is complete.
///
/// # Errors
/// The error of `write`, or an I/O error that `failed` converts.
pub(super) fn write_file<E>(
    path: &Path,
    failed: impl Fn(io::Error) -> E,
    write: impl FnOnce(&mut BufWriter<File>) -> Result<(), E>,
) -> Result<(), E> {
    let to_file = |file: File| {
        let mut out = BufWriter::new(file);
        write(&mut out)?;
        out.flush().map_err(&failed)
    };
    let Some((target, temporary, file)) = temporary_file(path) else {
        return to_file(File::create(path).map_err(&failed)?);
    };
    let result = to_file(file).and_then(|()| fs::rename(&temporary, target).map_err(&failed));
    if result.is_err() {
        // The first error is the one to report.
        let _ = fs::remove_file(&temporary);
    }
    result
}

/// Writes a file as [`write_file`] does.
///
/// # Errors
/// [`Exit::Output`]: it cannot be written; an earlier file is unchanged.
pub(super) fn save(path: &Path, content: impl AsRef<[u8]>) -> Result<(), CliError> {
    let failed = |error| write_error(path, error);
    write_file(path, failed, |out| {
        out.write_all(content.as_ref()).map_err(failed)
    })
}

/// Checks that [`save`] can write a file, before anything moves; an earlier file stays as it is.
///
/// # Errors
/// [`Exit::Output`].
pub(super) fn check_writable(path: &Path) -> Result<(), CliError> {
    let failed = |error| write_error(path, error);
    if let Some((_, temporary, _)) = temporary_file(path) {
        return fs::remove_file(temporary).map_err(failed);
    }
    match path.metadata() {
        // Opening a pipe would wait for its reader.
        Ok(existing) if !existing.is_file() && !existing.is_dir() => Ok(()),
        Ok(_) => File::options()
            .append(true)
            .open(path)
            .map(drop)
            .map_err(failed),
        // The system names the reason why the folder takes no file.
        Err(_) => File::create_new(path)
            .and_then(|_| fs::remove_file(path))
            .map_err(failed),
    }
}

/// The target of a path, and a new temporary file in the same folder that can replace it. None for
/// a device, or where no file can be created.
fn temporary_file(path: &Path) -> Option<(PathBuf, PathBuf, File)> {
    let target = match path.symlink_metadata() {
        Ok(_) => path.canonicalize().ok()?,
        Err(_) => path.to_path_buf(),
    };
    let existing = target.metadata().ok();
    if existing
        .as_ref()
        .is_some_and(|existing| !existing.is_file())
    {
        return None;
    }
    let mut name = OsString::from(target.file_name()?);
    name.push(format!(".{}.part", std::process::id()));
    let temporary = target.with_file_name(name);
    let file = File::create_new(&temporary).ok()?;
    if let Some(existing) = existing {
        // A file system without permissions reports an error here, which is harmless.
        let _ = file.set_permissions(existing.permissions());
    }
    Some((target, temporary, file))
}

/// Refuses to overwrite the input of the command, which messages call `what`.
///
/// # Errors
/// [`Exit::Usage`] when both paths are the same file.
pub(super) fn refuse_overwrite(input: &Path, output: &Path, what: &str) -> Result<(), CliError> {
    if !is_same_file(input, output) {
        return Ok(());
    }
    let what = format!(
        "{}: the {what} would be overwritten; name another file with --out",
        output.display()
    );
    Err(CliError::new(Exit::Usage, what))
}

/// Whether two paths are the same file.
#[cfg(unix)]
fn is_same_file(one: &Path, other: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    // A terminal may be input and output.
    let file = |path: &Path| path.metadata().ok().filter(fs::Metadata::is_file);
    let number = |path| file(path).map(|file| (file.dev(), file.ino()));
    number(one).is_some_and(|one| number(other) == Some(one))
}

/// Whether two paths are the same file.
#[cfg(not(unix))]
fn is_same_file(one: &Path, other: &Path) -> bool {
    let real = |path: &Path| path.canonicalize().ok();
    real(one).is_some_and(|one| real(other) == Some(one))
}
