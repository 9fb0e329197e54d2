//! What a command writes: its result on standard output, and files.

use super::{CliError, Exit};
use std::ffi::OsString;
use std::fmt;
use std::fs::{self, File};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// The first write on standard output that failed.
static FAILED: Mutex<Option<io::Error>> = Mutex::new(None);

/// Writes on standard output; a failure is kept for the end of the command, see [`failed`].
pub(super) fn standard(write: impl FnOnce(&mut dyn Write) -> io::Result<()>) {
    let mut out = io::stdout().lock();
    if let Err(error) = write(&mut out).and_then(|()| out.flush()) {
        lost(error);
    }
}

/// Keeps why standard output was not written; a reader that has gone (`| head`) has what it wanted.
pub(super) fn lost(error: io::Error) {
    if error.kind() != ErrorKind::BrokenPipe {
        let mut failed = FAILED.lock().unwrap_or_else(PoisonError::into_inner);
        failed.get_or_insert(error);
    }
}

/// A line on standard output, of `tell!`.
pub(super) fn tell(line: fmt::Arguments<'_>) {
    // In one piece: half a line is of no use.
    let line = format!("{line}\n");
    standard(|out| out.write_all(line.as_bytes()));
}

/// What to say at the end when standard output was not written.
pub(super) fn failed() -> Option<CliError> {
    let failed = FAILED.lock().unwrap_or_else(PoisonError::into_inner).take();
    failed.map(|error| unwritten(Path::new("standard output"), error))
}

/// A file was not written.
pub(super) fn unwritten(path: &Path, error: impl fmt::Display) -> CliError {
    CliError::new(Exit::Output, format!("{}: {error}", path.display()))
}

/// Writes a file. What was there before stays until all is written.
///
/// # Errors
/// That of `write`, or of the disk as `failed` has it.
pub(super) fn file<E>(
    path: &Path,
    failed: impl Fn(io::Error) -> E,
    write: impl FnOnce(&mut BufWriter<File>) -> Result<(), E>,
) -> Result<(), E> {
    let to_file = |file: File| {
        let mut out = BufWriter::new(file);
        write(&mut out)?;
        out.flush().map_err(&failed)
    };
    let Some((target, beside, file)) = beside(path) else {
        return to_file(File::create(path).map_err(&failed)?);
    };
    let done = to_file(file).and_then(|()| fs::rename(&beside, target).map_err(&failed));
    if done.is_err() {
        // There is nothing more to be done about it, and something worse to be told.
        let _ = fs::remove_file(&beside);
    }
    done
}

/// The file that a path leads to, and a new one beside it that can take its place; none for a device, or where no file can be made.
fn beside(path: &Path) -> Option<(PathBuf, PathBuf, File)> {
    let target = match path.symlink_metadata() {
        Ok(_) => path.canonicalize().ok()?,
        Err(_) => path.to_path_buf(),
    };
    let before = target.metadata().ok();
    if before.as_ref().is_some_and(|before| !before.is_file()) {
        return None;
    }
    let mut name = OsString::from(target.file_name()?);
    name.push(format!(".{}.part", std::process::id()));
    let beside = target.with_file_name(name);
    let file = File::create_new(&beside).ok()?;
    if let Some(before) = before {
        // A file system without permissions has none to keep.
        let _ = file.set_permissions(before.permissions());
    }
    Some((target, beside, file))
}

/// Refuses to write over what is read; `what` it is.
///
/// # Errors
/// [`Exit::Usage`] when both are the same file, whatever they are called.
pub(super) fn not_over(input: &Path, output: &Path, what: &str) -> Result<(), CliError> {
    if !same(input, output) {
        return Ok(());
    }
    let what = format!(
        "{}: the {what} would be overwritten; name another file with --out",
        output.display()
    );
    Err(CliError::new(Exit::Usage, what))
}

/// Whether two paths lead to one file.
#[cfg(unix)]
fn same(one: &Path, other: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    // A terminal may be both.
    let file = |path: &Path| path.metadata().ok().filter(fs::Metadata::is_file);
    let number = |path| file(path).map(|file| (file.dev(), file.ino()));
    number(one).is_some_and(|one| number(other) == Some(one))
}

/// Whether two paths lead to one file.
#[cfg(not(unix))]
fn same(one: &Path, other: &Path) -> bool {
    let real = |path: &Path| path.canonicalize().ok();
    real(one).is_some_and(|one| real(other) == Some(one))
}
