//! Help, exit codes, ports, and the page of a preview.

use super::haptimill;

#[test]
fn help_names_every_command() {
    let ran = haptimill(&["--help"], "");
    assert_eq!(ran.code, 0);
    for part in [
        "Examples:",
        "Exit codes:",
        "sim serve",
        "machine init",
        "machine check",
        "machine keys",
        "machine migrate",
        "kin ik",
        "--port",
    ] {
        assert!(ran.out.contains(part), "no {part} in\n{}", ran.out);
    }
    let first = ran.out.lines().next().unwrap_or_default();
    assert!(!first.contains("H-4"), "{first}");
    for command in [
        "run", "jog", "home", "console", "teleop", "status", "enable", "disable", "stop", "reset",
        "scenario", "force", "sim", "machine", "ports", "flash", "trace", "replay", "kin",
        "offset", "preview",
    ] {
        let ran = haptimill(&[command, "--help"], "");
        assert_eq!(ran.code, 0, "{command}");
        assert!(ran.out.contains("Usage: haptimill"), "{}", ran.out);
    }
}

#[test]
fn a_preview_is_one_page_with_the_extremes_of_the_joints() {
    let folder = std::env::temp_dir().join(format!("haptimill-preview-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let page = folder.join("pocket.html");
    let page = page.to_str().unwrap();
    let ran = haptimill(&["preview", "examples/e9-pocket.ngc", "--out", page], "");
    assert_eq!((ran.code, ran.out.trim()), (0, page), "{}", ran.err);
    let text = std::fs::read_to_string(page).unwrap();
    for part in [
        "at feed",
        "rapid moves",
        "feed, mm/min",
        "l1",
        "nearest to an end",
    ] {
        assert!(text.contains(part), "{part}");
    }
    // A program that the machine cannot run has no page.
    let program = folder.join("far.ngc");
    std::fs::write(&program, "G0 X9999\n").unwrap();
    let page = folder.join("far.html");
    let arguments = [
        "preview",
        program.to_str().unwrap(),
        "--out",
        page.to_str().unwrap(),
    ];
    let ran = haptimill(&arguments, "");
    assert_eq!(ran.code, 4, "{}", ran.err);
    assert!(ran.err.contains("far.ngc:1:4: X9999"), "{}", ran.err);
    assert!(!page.exists());
}

#[test]
fn invalid_command_lines_end_with_2() {
    for arguments in [
        &["fly"][..],
        &["run"],
        &["run", "a.ngc", "--port", "tcp:nowhere"],
        &["run", "a.ngc", "--override", "0"],
        &["home"],
        &["jog", "x5", "--port", "p"],
        &["jog", "x=nan", "--port", "p"],
        &["jog", "x=5", "--for", "-1", "--port", "p"],
        &["status", "--port", "p", "--baud", "3"],
        &["sim", "serve", "--listen", "udp:1"],
        // Names of earlier versions.
        &["run", "a.ngc", "--work", "b.toml"],
        &["run", "a.ngc", "--go-on"],
        &["run", "a.ngc", "--force", "x", "--fd", "5"],
        &["teleop", "--hand", "sim"],
        &["sim", "serve", "--person", "a.toml"],
        &["machine", "init"],
        &["machine", "init", "m", "--template", "none"],
    ] {
        let ran = haptimill(arguments, "");
        assert_eq!(ran.code, 2, "{arguments:?}\n{}", ran.err);
        assert!(ran.err.contains("error:"), "{}", ran.err);
    }
}

#[test]
fn ports_list_the_simulator() {
    let ran = haptimill(&["ports", "--json"], "");
    assert_eq!(ran.code, 0, "{}", ran.err);
    let list: Vec<serde_json::Value> = serde_json::from_str(&ran.out).unwrap();
    assert!(list.iter().any(|row| row["port"] == "sim"));
    assert!(haptimill(&["ports"], "").out.contains("sim serve"));
}
