//! `haptimill machine migrate`: rewrites a machine file of an earlier format.

use crate::commands::output::{write_error, write_file};
use crate::commands::{CliError, Exit};
use clap::Args;
use haptimill_machine_file::migrate::{Migrated, migrate};
use haptimill_machine_file::{FORMAT, MachineFile, read_text};
use std::fs::File;
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};

const LONG: &str = "\
Rewrite a machine file of an earlier format.

Renames keys and sections, adds those that became necessary, and writes the format as the first key. \
Comments and the order of the keys stay. Each change is listed. Without --out FILE is replaced, after \
a copy of it was written to FILE.bak. A file that needs no change is left alone.";

/// Arguments of `haptimill machine migrate`.
#[derive(Debug, Clone, Args)]
#[command(about = "Rewrite a machine file of an earlier format", long_about = LONG)]
pub struct MigrateArgs {
    /// The machine file
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// File to write [default: FILE, with a backup FILE.bak]
    #[arg(short, long, value_name = "OUT")]
    pub out: Option<PathBuf>,
}

/// Rewrites a machine file.
///
/// # Errors
/// [`Exit::BadInput`]: it is not a machine file that this program knows. [`Exit::Usage`]: the file
/// to write exists. [`Exit::Output`]: it cannot be written.
pub(super) fn run(args: MigrateArgs) -> Result<(), CliError> {
    let name = args.file.display().to_string();
    let text = read_text(&args.file)?;
    let migrated = migrate(&name, &text)?;
    if migrated.changes.is_empty() && args.out.is_none() {
        print_line!("{name}: nothing to change, it has format {FORMAT}");
        return Ok(());
    }
    let written = match &args.out {
        Some(out) => {
            write_new(out, &migrated.text)?;
            out
        }
        None => {
            let mut backup = args.file.clone().into_os_string();
            backup.push(".bak");
            let backup = PathBuf::from(backup);
            write_new(&backup, &text)?;
            print_line!("{}: the file before", backup.display());
            write_file(
                &args.file,
                |error| write_error(&args.file, error),
                |out| {
                    let written = out.write_all(migrated.text.as_bytes());
                    written.map_err(|error| write_error(&args.file, error))
                },
            )?;
            &args.file
        }
    };
    report(written, &migrated);
    Ok(())
}

/// Lists the changes, and whether the file has other problems.
fn report(written: &Path, migrated: &Migrated) {
    let name = written.display();
    for change in &migrated.changes {
        print_line!("{name}: {change}");
    }
    match MachineFile::parse(&name.to_string(), &migrated.text) {
        Ok(_) => print_line!("{name}: written, no problem"),
        Err(_) => print_line!("{name}: written; run `haptimill machine check {name}`"),
    }
}

/// Writes a file that does not exist yet.
///
/// # Errors
/// [`Exit::Usage`]: it exists. [`Exit::Output`]: it cannot be written.
pub(super) fn write_new(path: &Path, text: &str) -> Result<(), CliError> {
    let failed = |error| {
        CliError::new(
            Exit::Output,
            format!("{}: {error}; name another file with --out", path.display()),
        )
    };
    let mut file = File::create_new(path).map_err(|error| match error.kind() {
        ErrorKind::AlreadyExists => CliError::new(
            Exit::Usage,
            format!(
                "{}: the file exists and is not overwritten; name another file with --out",
                path.display()
            ),
        ),
        _ => failed(error),
    })?;
    file.write_all(text.as_bytes()).map_err(|error| {
        // A partial file would block the next attempt.
        let _ = std::fs::remove_file(path);
        failed(error)
    })
}
