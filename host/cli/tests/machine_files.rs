//! `haptimill machine`: files of earlier formats, fragments.

use std::path::{Path, PathBuf};
use std::process::Command;

const OLD: &str = include_str!("../../machine-file/tests/data/format-1/h4.toml");

/// A folder of a test, removed at its end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let name = format!("haptimill-{name}-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    /// Runs the command in the folder; returns exit code, standard output and error.
    fn run(&self, arguments: &[&str]) -> (i32, String, String) {
        let ran = Command::new(env!("CARGO_BIN_EXE_haptimill"))
            .args(arguments)
            .current_dir(&self.0)
            .output()
            .unwrap();
        let text = |bytes| String::from_utf8(bytes).unwrap();
        (
            ran.status.code().unwrap(),
            text(ran.stdout),
            text(ran.stderr),
        )
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.0.join(name), text).unwrap();
    }

    fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.0.join(name)).unwrap()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

#[test]
fn an_old_file_is_refused_with_the_command_that_migrates_it() {
    let folder = Folder::new("migrate");
    folder.write("old.toml", OLD);
    let program = root().join("examples/e11-circle.ngc");
    let remedy = "run `haptimill machine migrate old.toml`";
    for command in [
        &["machine", "check", "old.toml"][..],
        &[
            "run",
            program.to_str().unwrap(),
            "--machine",
            "old.toml",
            "--check",
        ],
        &["home", "--machine", "old.toml"],
        &["kin", "ik", "--machine", "old.toml"],
    ] {
        let (code, _, err) = folder.run(command);
        assert_eq!(code, 3, "{command:?}: {err}");
        assert!(err.contains(remedy), "{command:?}: {err}");
    }

    let (code, out, err) = folder.run(&["machine", "migrate", "old.toml"]);
    assert_eq!(code, 0, "{err}");
    assert!(out.contains("plant.arm became plant.geometry.h4"), "{out}");
    assert!(out.contains("written, no problem"), "{out}");
    assert_eq!(folder.read("old.toml.bak"), OLD);
    let (code, _, err) = folder.run(&["machine", "check", "old.toml"]);
    assert_eq!(code, 0, "{err}");

    // A file of this format is left alone.
    let text = folder.read("old.toml");
    let (code, out, _) = folder.run(&["machine", "migrate", "old.toml"]);
    assert_eq!(code, 0);
    assert!(out.contains("nothing to change"), "{out}");
    assert_eq!(folder.read("old.toml"), text);
}

#[test]
fn migrate_overwrites_neither_a_backup_nor_another_file() {
    let folder = Folder::new("backup");
    folder.write("old.toml", OLD);
    folder.write("old.toml.bak", "mine");
    let (code, _, err) = folder.run(&["machine", "migrate", "old.toml"]);
    assert_eq!(code, 2);
    assert!(err.contains("old.toml.bak: the file exists"), "{err}");
    let (code, _, err) = folder.run(&["machine", "migrate", "old.toml", "-o", "old.toml.bak"]);
    assert_eq!(code, 2, "{err}");
    assert_eq!(folder.read("old.toml.bak"), "mine");
    assert_eq!(folder.read("old.toml"), OLD);

    let (code, _, err) = folder.run(&["machine", "migrate", "old.toml", "-o", "new.toml"]);
    assert_eq!(code, 0, "{err}");
    assert_eq!(folder.read("old.toml"), OLD);
    let (code, _, err) = folder.run(&["machine", "check", "new.toml"]);
    assert_eq!(code, 0, "{err}");
    let (code, _, err) = folder.run(&["machine", "migrate", "none.toml"]);
    assert_eq!(code, 3, "{err}");
}

#[test]
fn a_fragment_is_named_as_one() {
    let file = root().join("machines/follow.toml");
    let (code, _, err) = Folder::new("fragment").run(&["machine", "check", file.to_str().unwrap()]);
    assert_eq!(code, 3);
    assert!(
        err.contains("is a fragment of a machine file: it has [follow] only"),
        "{err}"
    );
    assert!(err.contains("1 problem\n"), "{err}");
}
