//! The folder of part programs: which names are served, and uploads.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

/// Length of a part program at most, bytes.
pub const LONGEST: usize = 8 << 20;

/// Names in a list at most.
const MAX_LISTED: usize = 1000;

/// Length of a name at most, bytes.
const LONGEST_NAME: usize = 100;

/// Endings of the names of part programs, in lower case.
pub const ENDINGS: [&str; 6] = ["ngc", "nc", "gcode", "tap", "cnc", "txt"];

/// Checks the name of a part program: a file of the folder itself, and no hidden one.
///
/// # Errors
/// What is wrong with it.
pub fn check_name(name: &str) -> Result<(), String> {
    let allowed = |letter: char| letter.is_alphanumeric() || " ._-+()".contains(letter);
    let ending = Path::new(name)
        .extension()
        .and_then(|ending| ending.to_str());
    let what = if name.is_empty() || name.len() > LONGEST_NAME {
        format!("has not 1 to {LONGEST_NAME} bytes")
    } else if name.starts_with(['.', ' ']) || name.contains("..") || !name.chars().all(allowed) {
        "is no file name of letters, digits and ' ._-+()'".to_string()
    } else if !ending.is_some_and(|ending| ENDINGS.contains(&&*ending.to_lowercase())) {
        format!("ends with none of .{}", ENDINGS.join(", ."))
    } else {
        return Ok(());
    };
    Err(format!("program {name:?} {what}"))
}

/// The path of a part program that exists.
///
/// # Errors
/// The name is refused, or there is no such file.
pub fn find(folder: &Path, name: &str) -> Result<PathBuf, String> {
    check_name(name)?;
    let path = folder.join(name);
    if path.is_file() {
        return Ok(path);
    }
    Err(format!("{}: there is no such file", path.display()))
}

/// Names of the part programs, sorted.
#[must_use]
pub fn list(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
    let mut names: Vec<String> = names.filter(|name| find(folder, name).is_ok()).collect();
    names.sort();
    names.truncate(MAX_LISTED);
    names
}

/// Stores a part program whole, or not at all.
///
/// # Errors
/// The name is refused, the text is too long, the file exists and is not to be replaced, or the
/// folder cannot be written to.
pub fn store(folder: &Path, name: &str, text: &str, replace: bool) -> Result<(), String> {
    check_name(name)?;
    if text.len() > LONGEST {
        return Err(format!(
            "program {name:?} has {} bytes, more than {LONGEST}; split it",
            text.len()
        ));
    }
    let path = folder.join(name);
    if !replace && path.symlink_metadata().is_ok() {
        return Err(format!("{name} exists"));
    }
    let failed = |error: io::Error| format!("{}: {error}", path.display());
    let (mut file, part) = create_part(folder).map_err(failed)?;
    let written = file
        .write_all(text.as_bytes())
        .and_then(|()| fs::rename(&part, &path));
    if written.is_err() {
        let _ = fs::remove_file(&part);
    }
    written.map_err(failed)
}

/// A new hidden file of the folder.
fn create_part(folder: &Path) -> io::Result<(File, PathBuf)> {
    let mut number = 0;
    loop {
        let part = folder.join(format!(".upload-{}-{number}", std::process::id()));
        match OpenOptions::new().write(true).create_new(true).open(&part) {
            Ok(file) => return Ok((file, part)),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists && number < 100 => {
                number += 1;
            }
            Err(error) => return Err(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_stays_in_its_folder() {
        for good in ["part.ngc", "Teil 2 (neu).NC", "a-b_c+d.gcode", "Nuß.tap"] {
            assert_eq!(check_name(good), Ok(()), "{good}");
        }
        let long = format!("{}.ngc", "a".repeat(LONGEST_NAME));
        let bad = [
            "",
            "..",
            "../part.ngc",
            "a/b.ngc",
            "a\\b.ngc",
            "/etc/part.ngc",
            ".part.ngc",
            "part",
            "part.sh",
            "a..ngc",
            "a\0.ngc",
            "a\n.ngc",
            "C:part.ngc",
            &long,
        ];
        for bad in bad {
            assert!(check_name(bad).is_err(), "{bad:?}");
        }
    }
}
