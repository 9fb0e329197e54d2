//! `haptimill engrave`: from a drawing to the cut plate, lost steps, and bad drawings.

mod machine;
mod program;
mod refusals;

use std::path::{Path, PathBuf};
use std::process::Command;

/// A folder of a test, removed at its end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let name = format!("haptimill-engrave-{name}-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    /// Runs the command in the folder; returns exit code and the JSON on standard output.
    fn run(&self, arguments: &[&str]) -> (i32, serde_json::Value) {
        let ran = Command::new(env!("CARGO_BIN_EXE_haptimill"))
            .arg("engrave")
            .args(arguments)
            .arg("--json")
            .current_dir(&self.0)
            .output()
            .unwrap();
        let text = String::from_utf8(ran.stdout).unwrap();
        let json = serde_json::from_str(&text).unwrap_or_else(|error| panic!("{error}: {text}"));
        (ran.status.code().unwrap(), json)
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.0.join(name), text).unwrap();
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

fn plate() -> String {
    root().join("examples/plate.dxf").display().to_string()
}
