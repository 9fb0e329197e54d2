//! Machine files: check, templates, work offsets beside them, the simulated machine.

use super::{haptimill, transcript};
use crate::scene;

#[test]
fn work_offsets_are_kept_beside_the_machine_file() {
    let folder = std::env::temp_dir().join(format!("haptimill-offset-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let machine = folder.join("mill.toml");
    let machine = machine.to_str().unwrap();
    std::fs::write(machine, include_str!("../../../../machines/h4.toml")).unwrap();
    let set = |values: &[&str]| {
        let mut arguments = vec!["offset", "set"];
        arguments.extend(values);
        arguments.extend(["--machine", machine]);
        haptimill(&arguments, "")
    };
    let ran = set(&["g54", "x=10", "z=21.232"]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    let ran = set(&["g55", "c=1"]);
    assert_eq!(ran.code, 2);
    assert!(
        ran.err
            .contains("there is no coordinate 'c'; this machine has x, y, z, b, a"),
        "{}",
        ran.err
    );
    let ran = haptimill(&["offset", "show", "--machine", machine], "");
    assert!(ran.out.contains("G54   x=10 y=0 z=21.232"), "{}", ran.out);

    // The program is in the coordinates of G54; G53 is in those of the machine.
    let program = folder.join("part.ngc");
    std::fs::write(&program, "G54 G0 X0 Z0\nM8\nG53 G0 X0\nM2\n").unwrap();
    let program = program.to_str().unwrap();
    let check = |more: &[&str]| {
        let mut arguments = vec!["run", program, "--check", "--machine", machine];
        arguments.extend(more);
        haptimill(&arguments, "")
    };
    let ran = check(&[]);
    assert_eq!(ran.code, 0, "{}", ran.err);
    assert!(
        ran.out.contains("2 blocks") && ran.out.contains("20.0 mm"),
        "{}",
        ran.out
    );
    assert!(
        ran.out
            .contains("part.ngc:2:1: notice: this machine has no coolant"),
        "{}",
        ran.out
    );
    let ran = check(&["--strict"]);
    assert_eq!(ran.code, 3);
    assert!(
        ran.err
            .contains("part.ngc:2:1: this machine has no coolant"),
        "{}",
        ran.err
    );

    std::fs::write(folder.join("mill.offsets.toml"), "[g54]\nx = \"1\"\n").unwrap();
    let ran = check(&[]);
    assert_eq!(ran.code, 3);
    assert!(
        ran.err
            .contains("mill.offsets.toml: [g54] x is not a number"),
        "{}",
        ran.err
    );
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn every_template_passes_machine_check_and_is_not_overwritten() {
    let folder = std::env::temp_dir().join(format!("haptimill-init-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    for template in [
        "mill3",
        "mill3-servo",
        "mill4",
        "router3",
        "trunnion5",
        "h4",
        "h4-step",
        "haptic-arm",
        "bench",
    ] {
        let path = folder.join(format!("{template}.toml"));
        let file = path.to_str().unwrap();
        let init = [
            "machine",
            "init",
            "mill-7",
            "--template",
            template,
            "--out",
            file,
        ];
        let ran = haptimill(&init, "");
        assert_eq!(ran.code, 0, "{template}: {}", ran.err);
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains("\nname = \"mill-7\"\n"), "{template}");
        let ran = haptimill(&["machine", "check", file], "");
        assert_eq!(ran.code, 0, "{template}: {}", ran.err);
        assert!(ran.out.contains("mill-7"), "{template}: {}", ran.out);
        let ran = haptimill(&init, "");
        assert_eq!(ran.code, 2, "{template}");
        assert!(ran.err.contains("not overwritten"), "{}", ran.err);
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text, "{template}");
    }
    for name in ["", "two words", "a/b", &"n".repeat(200)] {
        let path = folder.join("none.toml");
        let ran = haptimill(
            &["machine", "init", name, "--out", path.to_str().unwrap()],
            "",
        );
        assert_eq!(ran.code, 2, "{name:?}: {}", ran.err);
        assert!(!path.exists(), "{name:?}");
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn machine_check_lists_problems() {
    let mut text = transcript(&["machine", "check", "machines/h4.toml"], "");
    text += &transcript(&["machine", "check", "machines/h4-step.toml", "--json"], "");
    text += &transcript(&["machine", "check", "machines/there-is-none.toml"], "");
    text += &transcript(&["kin", "ik", "--machine", "Cargo.toml"], "");
    insta::assert_snapshot!("machine_check", text);
}

/// A simulated machine with rods half a millimetre longer is used, with a warning; one with rods
/// 40 mm longer is refused by every command.
#[test]
fn a_simulated_machine_that_differs_is_reported() {
    let folder = scene::TestFolder::new();
    let with_rods = |length: &str| {
        let text = haptimill_machine_file::BUILT_IN;
        let (controller, plant) = text.split_once("[plant]").unwrap();
        let plant = plant.replacen("r = 480.0", &format!("r = {length}"), 1);
        folder.file("rods.toml", format!("{controller}[plant]{plant}"))
    };
    let file = with_rods("480.5");
    for arguments in [
        &["machine", "check", &file][..],
        &["machine", "check", &file, "--json"],
    ] {
        let ran = haptimill(arguments, "");
        assert_eq!(ran.code, 0, "{}", ran.err);
        assert!(
            ran.err.contains("warning: the simulated machine: "),
            "{}",
            ran.err
        );
        assert!(ran.err.contains("theta = "), "{}", ran.err);
    }
    let file = with_rods("520.0");
    for arguments in [
        &["machine", "check", &file][..],
        &[
            "run",
            "examples/e11-circle.ngc",
            "--check",
            "--machine",
            &file,
        ],
    ] {
        let ran = haptimill(arguments, "");
        assert_eq!(ran.code, 3, "{}", ran.err);
        assert!(
            ran.err.contains("the simulated machine is another one"),
            "{}",
            ran.err
        );
    }
}
