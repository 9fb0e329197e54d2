//! `haptimill engrave`: from a drawing to the cut plate, lost steps, and bad drawings.

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

/// One command goes from the drawing to the plate; its surface is what the drawing asks for.
#[test]
fn the_cut_plate_is_the_drawing() {
    let folder = Folder::new("plate");
    let plate = plate();
    let (code, result) = folder.run(&[
        &plate,
        "--operation",
        "pocket",
        "--layer",
        "PICTURE",
        "--tool",
        "1",
        "--depth",
        "0.5",
        "--feed",
        "900",
        "-o",
        "plate.ngc",
        "--preview",
        "plate.html",
        "--run",
    ]);
    assert_eq!(code, 0, "{result:#}");
    let surface = &result["surface"];
    let number = |name: &str| surface[name].as_f64().unwrap();
    assert!(number("asked_mm2") > 200.0, "{surface:#}");
    // 0.1 mm2 is a hundredth of the least pocket.
    assert!(
        number("uncut_mm2") < 0.1 && number("over_cut_mm2") < 0.1,
        "{surface:#}"
    );
    // Z has 0.001 mm a step; friction holds it a step or two off.
    assert!((number("mean_depth_mm") - 0.5).abs() < 0.004, "{surface:#}");
    assert!(
        (number("greatest_depth_mm") - 0.5).abs() < 0.006,
        "{surface:#}"
    );
    for name in [
        "plate.ngc",
        "plate.html",
        "plate.out/report.html",
        "plate.out/recording.hmr",
    ] {
        assert!(folder.0.join(name).exists(), "{name}");
    }
}

/// A machine that accelerates its motors beyond their torque loses steps, and the command says so.
#[test]
fn lost_steps_are_found() {
    let folder = Folder::new("lost");
    let machine = std::fs::read_to_string(root().join("machines/engraver.toml")).unwrap();
    let machine = machine
        .replace("acceleration_mm_s2 = 200.0", "acceleration_mm_s2 = 1500.0")
        .replace("acceleration_mm_s2 = 500.0", "acceleration_mm_s2 = 1600.0")
        .replace("jerk_mm_s3 = 4000.0", "jerk_mm_s3 = 900000.0")
        .replace("\nrate_mm_s = 20.0", "\nrate_mm_s = 60.0")
        .replace("\nrate_mm_s = 25.0", "\nrate_mm_s = 65.0");
    folder.write("fast.toml", &machine);
    let plate = plate();
    let (code, result) = folder.run(&[
        &plate,
        "--operation",
        "drill",
        "--layer",
        "HOLES",
        "--depth",
        "1",
        "--machine",
        "fast.toml",
        "-o",
        "holes.ngc",
        "--run",
    ]);
    assert_eq!(code, 6, "{result:#}");
    let off = result["off_mm"].as_array().unwrap();
    assert!(
        off.iter().any(|off| off.as_f64().unwrap().abs() > 0.05),
        "{result:#}"
    );
}

/// A drawing outside of the plate, and a damaged one: refused with line, entity and remedy, and no
/// program is written.
#[test]
fn bad_drawings_are_refused_before_anything_is_written() {
    let folder = Folder::new("bad");
    let plate = plate();
    let (code, result) = folder.run(&[&plate, "--at", "80,0", "-o", "out.ngc"]);
    assert_eq!(code, 4, "{result:#}");
    let problem = &result["problems"][0];
    assert!(
        problem["message"]
            .as_str()
            .unwrap()
            .contains("LWPOLYLINE handle 22 on layer FRAME")
    );
    assert!(problem["remedy"].as_str().unwrap().contains("--origin"));
    let text = std::fs::read_to_string(&plate).unwrap();
    folder.write("cut.dxf", &text[..text.len() / 2]);
    let (code, result) = folder.run(&["cut.dxf", "-o", "out.ngc"]);
    assert_eq!(code, 3, "{result:#}");
    assert!(
        result["error"].as_str().unwrap().contains("truncated"),
        "{result:#}"
    );
    assert!(result["problems"][0]["line"].as_u64().unwrap() > 0);
    folder.write(
        "text.svg",
        "<svg xmlns='http://www.w3.org/2000/svg' width='9mm' height='9mm'>\n<text>AB</text></svg>",
    );
    let (code, result) = folder.run(&["text.svg", "-o", "out.ngc"]);
    assert_eq!(code, 3, "{result:#}");
    assert!(
        result["error"].as_str().unwrap().contains("'AB' is text"),
        "{result:#}"
    );
    assert!(!folder.0.join("out.ngc").exists());
}
