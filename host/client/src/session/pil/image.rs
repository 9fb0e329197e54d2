//! Images of the boards, built from the source tree.

use crate::port::Board;
use crate::{Error, ErrorKind};
use haptimill_machine_file::MachineFile;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, PoisonError};

/// Builds the image of a board in the source tree, and returns its path.
///
/// The variable `HAPTIMILL_IMAGE` names an existing image instead.
///
/// # Errors
/// There are no sources and no image, or the build failed.
pub fn image(board: Board) -> Result<PathBuf, Error> {
    match std::env::var_os("HAPTIMILL_IMAGE") {
        Some(image) => Ok(PathBuf::from(image)),
        None => build(board, None),
    }
}

/// As [`image`], for a machine: a haptic arm or a mapping of a master needs an image with haptics.
///
/// # Errors
/// There are no sources and no image, or the build failed.
pub fn image_for(board: Board, machine: &MachineFile) -> Result<PathBuf, Error> {
    let needs_haptics = machine.config.haptic.is_some() || machine.config.follow.is_some();
    if needs_haptics && std::env::var_os("HAPTIMILL_IMAGE").is_none() {
        build(board, Some("haptics"))
    } else {
        image(board)
    }
}

/// Builds another image of a board, such as the self-test.
///
/// # Errors
/// There are no sources, or the build failed.
pub fn other_image(board: Board, name: &str) -> Result<PathBuf, Error> {
    build(board, Some(name))
}

/// Builds every image once per process.
fn build(board: Board, other: Option<&str>) -> Result<PathBuf, Error> {
    static BUILT: Mutex<BTreeMap<(&str, String), PathBuf>> = Mutex::new(BTreeMap::new());
    let mut built = BUILT.lock().unwrap_or_else(PoisonError::into_inner);
    let name = (board.name(), other.unwrap_or_default().to_string());
    if let Some(image) = built.get(&name) {
        return Ok(image.clone());
    }
    let image = build_image(board, other)?;
    built.insert(name, image.clone());
    Ok(image)
}

fn build_image(board: Board, other: Option<&str>) -> Result<PathBuf, Error> {
    let folder = board.folder();
    let here = std::env::current_dir().unwrap_or_default();
    let root = here
        .ancestors()
        .chain(Path::new(env!("CARGO_MANIFEST_DIR")).ancestors())
        .find(|root| root.join(folder).join("Cargo.toml").is_file());
    let Some(root) = root else {
        let what = format!(
            "the sources of the board ({folder}) are missing; \
             run this in the source tree, or name an image in HAPTIMILL_IMAGE"
        );
        return Err(Error::new(ErrorKind::BadInput, what));
    };
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let built = Command::new(cargo)
        .args(["xtask", "board", board.name(), "--image"])
        .args(other)
        .current_dir(root)
        .stdin(Stdio::null())
        .stderr(Stdio::inherit())
        .output();
    match built {
        Ok(output) if output.status.success() => Ok(PathBuf::from(
            String::from_utf8_lossy(&output.stdout)
                .trim_end()
                .to_string(),
        )),
        Ok(output) => Err(Error::new(
            ErrorKind::BadInput,
            format!(
                "the image of {board} cannot be built ({}); `cargo xtask board {}` shows the errors",
                output.status,
                board.name()
            ),
        )),
        Err(error) => Err(Error::new(
            ErrorKind::BadInput,
            format!("cargo cannot be started: {error}"),
        )),
    }
}
