//! Images of a release: one folder with the files that users copy onto boards, and their checksums.

use crate::board::{BOARDS, Variant};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Folder of the images.
const FOLDER: &str = "target/images";

/// Builds the images of all boards that one can flash, and writes their checksums. Returns the
/// files.
///
/// # Errors
/// The sources are not those of a commit, an image cannot be built or is wrong, or a file cannot be
/// written.
pub fn images(root: &Path) -> Result<Vec<PathBuf>, String> {
    let commit = commit(root)?;
    let folder = root.join(FOLDER);
    let problem = |error| format!("{}: {error}", folder.display());
    if folder.exists() {
        fs::remove_dir_all(&folder).map_err(problem)?;
    }
    fs::create_dir_all(&folder).map_err(problem)?;
    let mut names = Vec::new();
    for board in BOARDS.iter().filter(|board| board.has_uf2) {
        let options = board.options.iter().map(|option| Variant {
            option: Some(option),
            log: false,
            period_us: None,
        });
        let periods = board.periods.iter().map(|period| Variant {
            option: None,
            log: false,
            period_us: Some(period),
        });
        for variant in options.chain(periods).chain([Variant::default()]) {
            let image = board.build_variant(root, true, &variant)?;
            board.measure(&image)?;
            let uf2 = board.uf2(&image)?;
            let name = format!("haptimill-{}{}-{commit}.uf2", board.name, variant.suffix());
            let target = folder.join(&name);
            fs::copy(&uf2, &target).map_err(|error| format!("{}: {error}", target.display()))?;
            names.push(name);
        }
    }
    let sums = output(Command::new("sha256sum").current_dir(&folder).args(&names))?;
    let file = folder.join("SHA256SUMS");
    fs::write(&file, sums).map_err(|error| format!("{}: {error}", file.display()))?;
    names.push("SHA256SUMS".to_string());
    Ok(names.iter().map(|name| folder.join(name)).collect())
}

/// Short name of the commit of the sources, which must have no other changes.
fn commit(root: &Path) -> Result<String, String> {
    let changes = output(
        Command::new("git")
            .current_dir(root)
            .args(["status", "--porcelain"]),
    )?;
    if let Some(first) = changes.lines().next() {
        return Err(format!(
            "the sources differ from the commit ({}): commit the changes first",
            first.trim()
        ));
    }
    let name =
        output(
            Command::new("git")
                .current_dir(root)
                .args(["rev-parse", "--short=12", "HEAD"]),
        )?;
    Ok(name.trim().to_string())
}

/// Standard output of a command that must succeed.
fn output(command: &mut Command) -> Result<String, String> {
    let name = command.get_program().to_string_lossy().into_owned();
    let output = command
        .output()
        .map_err(|error| format!("{name} cannot be started: {error}"))?;
    if !output.status.success() {
        let what = String::from_utf8_lossy(&output.stderr);
        return Err(format!("{name} failed: {}", what.trim()));
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}
