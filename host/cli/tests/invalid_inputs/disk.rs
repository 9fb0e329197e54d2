//! Disks that are full, and file size limits: real ones of the operating system.

use crate::scene::{self, TestFolder, haptimill};
use haptimill_trace::RESERVE_BYTES;
use std::path::Path;
use std::process::{Command, Output};

/// Runs a line of a shell in the root of the workspace; `haptimill` is the command.
fn shell(line: &str) -> Output {
    let function = "haptimill() { \"$0\" \"$@\"; }";
    Command::new("sh")
        .current_dir(scene::root())
        .arg("-c")
        .arg(format!("{function}; {line}"))
        .arg(env!("CARGO_BIN_EXE_haptimill"))
        .output()
        .unwrap()
}

/// A file size limit is a write error with a message, and does not kill the process during motion.
#[test]
fn file_size_limit_stops_a_job_with_a_message() {
    let folder = TestFolder::new();
    let turns: String = (0..10).map(|_| "G1 X20\nG1 X0\n").collect();
    let program = folder.file("long.ngc", format!("G21 G90 F600\n{turns}M30\n"));
    let table = folder.file(
        "poses.csv",
        format!(
            "x_mm,y_mm,z_mm,theta_deg,alpha_deg\n{}",
            "0,0,21,0,0\n".repeat(20_000)
        ),
    );
    let out = folder.path("out");
    let sliced = folder.path("slides.csv");
    for (blocks, command) in [
        (2000, format!("run {program} --quiet --out {out}")),
        (2000, format!("teleop --master sim --quiet --out {out}")),
        (20, format!("kin ik --in {table} --out {sliced}")),
    ] {
        let ran = shell(&format!("ulimit -f {blocks}; haptimill {command}"));
        let err = String::from_utf8_lossy(&ran.stderr);
        assert_eq!(ran.status.code(), Some(9), "{command}: {ran:?}");
        assert!(err.contains("File too large"), "{command}: {err}");
        if !command.starts_with("kin") {
            assert!(err.contains("stopped"), "{command}: {err}");
            // The recording is kept and readable.
            haptimill(&["trace", "info", &format!("{out}/recording.hmr")]).expect_code(0);
        }
    }
}

/// No file can grow: every command that replaces a file of the user leaves the earlier one.
#[test]
fn results_that_cannot_be_written_leave_the_earlier_ones() {
    let folder = TestFolder::new();
    let program = folder.file("short.ngc", "G21 G90 F600\nG1 X1\nG1 X0\nM30\n");
    let machine = folder.machine_with("");
    folder.file("own.offsets.toml", "[g54]\nx = 1.0\n");
    folder.file("own.offsets.toml.bak", "earlier backup");
    let table = folder.file(
        "poses.csv",
        "x_mm,y_mm,z_mm,theta_deg,alpha_deg\n0,0,21,0,0\n",
    );
    let out = folder.path("out");
    haptimill(&["run", &program, "--quiet", "--out", &out]).expect_code(0);
    let trace = format!("{out}/recording.hmr");
    let old = folder.file("old", "earlier result");
    let before = std::fs::read_dir(folder.path("")).unwrap().count();
    for command in [
        format!("engrave examples/plate.dxf --out {old}"),
        format!("preview {program} --out {old}"),
        format!("facet plan examples/pentagon.asc --out {old}"),
        format!("trace csv {trace} --out {old}"),
        format!("trace mcap {trace} --out {old}"),
        format!("trace plot {trace} x_tool_mm --out {old}"),
        format!("kin ik --in {table} --out {old}"),
        format!("offset set g54 x=2 --machine {machine}"),
    ] {
        let ran = shell(&format!("ulimit -f 0; haptimill {command}"));
        let err = String::from_utf8_lossy(&ran.stderr);
        assert_eq!(ran.status.code(), Some(9), "{command}: {ran:?}");
        assert!(err.contains("File too large"), "{command}: {err}");
        assert_eq!(folder.read("old"), "earlier result", "{command}");
        let offsets = folder.read("own.offsets.toml");
        assert_eq!(offsets, "[g54]\nx = 1.0\n", "{command}");
        assert_eq!(folder.read("own.offsets.toml.bak"), "earlier backup");
        let after = std::fs::read_dir(folder.path("")).unwrap().count();
        assert_eq!(after, before, "{command} leaves files");
    }
}

/// The recording of a program of 36 million seconds fits on no disk.
#[test]
fn a_recording_that_does_not_fit_is_refused_before_motion() {
    let folder = TestFolder::new();
    let dwells = "O1 repeat [10000]\nG4 P3600\nO1 endrepeat\n";
    let program = folder.file("dwells.ngc", format!("G21 G90 F600\nG1 X1\n{dwells}M30\n"));
    let out = folder.path("out");
    std::fs::create_dir(&out).unwrap();
    let old = folder.file("out/recording.hmr", "earlier result");
    let ran = haptimill(&["run", &program, "--out", &out]).expect_code(9);
    assert!(ran.err.contains("the recording needs about"), "{ran:?}");
    assert!(ran.err.contains("nothing moved"), "{ran:?}");
    assert!(ran.err.contains("--out"), "{ran:?}");
    assert_eq!(std::fs::read_to_string(old).unwrap(), "earlier result");
}

/// A disk that fills up while the machine moves: a tmpfs of a mount namespace. Where the system
/// allows no such namespace, only the unit test of `haptimill-trace` covers this.
#[cfg(target_os = "linux")]
#[test]
fn a_disk_that_fills_up_stops_the_machine() {
    let folder = TestFolder::new();
    let turns = "G1 X20\nG1 X0\n".repeat(50);
    let program = folder.file("long.ngc", format!("G21 G90 F600\n{turns}M30\n"));
    let disk = folder.path("disk");
    std::fs::create_dir(&disk).unwrap();
    // The recording of the program is larger than what is above the reserve.
    let bytes = RESERVE_BYTES + (8 << 20);
    let unshare = "unshare --user --map-root-user --mount sh -c";
    let mount = format!("mount -t tmpfs -o size={bytes} tmpfs {disk}");
    if !shell(&format!("{unshare} '{mount}'")).status.success() {
        eprintln!("no mount namespaces here; skipped");
        return;
    }
    let out = format!("{disk}/out");
    // The length of a streamed program is not known before its end.
    let run = format!("run {program} --stream --quiet --out {out}");
    let info = format!("trace info {out}/recording.hmr");
    let ran = shell(&format!(
        "{unshare} '{mount} && \"$0\" {run}; echo code $?; \"$0\" {info}' \"$0\""
    ));
    let (said, err) = (
        String::from_utf8_lossy(&ran.stdout),
        String::from_utf8_lossy(&ran.stderr),
    );
    assert!(said.contains("code 9"), "{ran:?}");
    assert!(err.contains("the disk is nearly full"), "{err}");
    assert!(err.contains("stopped along its path"), "{err}");
    // The recording is readable.
    assert!(ran.status.success(), "{ran:?}");
    assert!(
        Path::new(&disk).is_dir() && said.contains("control periods"),
        "{said}"
    );
}
