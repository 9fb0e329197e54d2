//! `haptimill flash stm32` with scripts in place of `probe-rs` and `dfu-util`, and a served
//! simulator in place of the board.

use crate::scene;
use scene::{SimServer, TestFolder, haptimill, root};
use std::process::{Command, Stdio};

const PROBE: &str =
    "The following debug probes were found:\n[0]: STLink V3 -- 0483:374f:1 (ST-LINK)\n";
const DFU: &str = "Found DFU: [0483:df11] ver=2200, devnum=5, alt=0, name=\"@Internal Flash\"\n";

/// A folder with programs that see these devices, and an image.
fn folder(lists: &[(&str, &str)]) -> TestFolder {
    let folder = TestFolder::new();
    let script = root().join("host/client/src/flash/program/fake.sh");
    for (name, list) in lists {
        std::os::unix::fs::symlink(&script, folder.path(name)).unwrap();
        folder.file(&format!("{name}.list"), list);
    }
    folder.file("own.elf", elf());
    folder
}

const VECTORS: [u32; 3] = [0x1001_0000, 0x0800_0009, 0xBE00_BE00];

fn bytes(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

/// An ELF file of one segment: a vector table, then code.
fn elf() -> Vec<u8> {
    let mut file = vec![0x7F, b'E', b'L', b'F', 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    // Type 2 and machine 40, version, entry, headers of segments at 52, no sections.
    let header = [40 << 16 | 2, 1, 0x0800_0009, 52, 0, 0, 32 << 16 | 52, 1, 0];
    let start = 0x0800_0000;
    file.extend(bytes(&header));
    file.extend(bytes(&[1, 84, start, start, 12, 12, 5, 4]));
    file.extend(bytes(&VECTORS));
    file
}

/// Runs `haptimill flash stm32` with the programs of a folder only.
fn flash(folder: &TestFolder, arguments: &[&str]) -> (Option<i32>, String, String) {
    let done = Command::new(env!("CARGO_BIN_EXE_haptimill"))
        .args(["flash", "stm32", "--image", &folder.path("own.elf")])
        .args(arguments)
        .current_dir(root())
        .env("PATH", folder.path(""))
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (done.status.code(), text(&done.stdout), text(&done.stderr))
}

#[test]
fn probe_rs_writes_the_image_and_the_board_answers() {
    let folder = folder(&[("probe-rs", PROBE), ("dfu-util", DFU)]);
    let served = SimServer::on_tcp(&["--unconfigured"]);
    let (code, out, err) = flash(&folder, &["--port", &served.port]);
    assert_eq!(code, Some(0), "{err}");
    assert!(out.contains("the chip was reset"), "{out}");
    assert!(out.contains("the board answers at tcp:"), "{out}");
    // What the program prints is for the user, and no result.
    assert!(err.contains("probe-rs writes"), "{err}");
    let image = folder.path("own.elf");
    let download = format!("probe-rs\ndownload\n--chip\nSTM32F407VG\n--verify\n{image}\n\n");
    assert_eq!(
        folder.read("arguments"),
        format!("probe-rs\nlist\n\n{download}probe-rs\nreset\n--chip\nSTM32F407VG\n\n")
    );
    assert_eq!(
        std::fs::read(folder.path("probe-rs.written")).unwrap(),
        elf()
    );
}

#[test]
fn dfu_util_writes_the_segments_and_the_next_step_is_named() {
    let folder = folder(&[("probe-rs", PROBE), ("dfu-util", DFU)]);
    let (code, out, err) = flash(&folder, &["--with", "dfu-util"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(out.contains("set BOOT0 low"), "{out}");
    assert!(out.contains("its answer was not checked"), "{out}");
    assert!(
        out.contains("`haptimill status --port PORT --baud 1000000`"),
        "{out}"
    );
    let written = std::fs::read(folder.path("dfu-util.written")).unwrap();
    assert_eq!(written, bytes(&VECTORS));
    let (code, out, err) = flash(&folder, &["--with", "dfu-util", "--json"]);
    assert_eq!(code, Some(0), "{err}");
    let done: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!(done["program"], "dfu-util");
    assert!(done["drive"].is_null() && done["port"].is_null(), "{out}");
}

/// Each missing step in words, with the exit code of its kind; nothing is written.
#[test]
fn each_missing_step_is_named() {
    let refused = |folder: &TestFolder, arguments: &[&str], code: i32, what: &str| {
        let (ended, _, err) = flash(folder, &[&["--wait", "0.3"], arguments].concat());
        assert_eq!(ended, Some(code), "{err}");
        assert!(err.contains(what), "{what}: {err}");
    };
    let none = folder(&[]);
    refused(
        &none,
        &[],
        5,
        "probe-rs is not on the search path (PATH): install it; or: dfu-util",
    );
    let idle = folder(&[
        ("probe-rs", "No debug probes were found.\n"),
        ("dfu-util", ""),
    ]);
    refused(
        &idle,
        &[],
        5,
        "probe-rs sees no debug probe: connect the ST-LINK",
    );
    refused(
        &idle,
        &["--with", "dfu-util"],
        5,
        "set BOOT0 high, and reset the board",
    );
    refused(
        &idle,
        &["--with", "openocd"],
        2,
        "programs that write an image: probe-rs, dfu-util",
    );
    refused(
        &idle,
        &["--drive", "/"],
        2,
        "--drive: the board has no drive",
    );
    let bench = root().join("machines/bench.toml");
    let bench = bench.to_str().unwrap();
    refused(
        &idle,
        &["--machine", bench],
        3,
        "joint x: ticks_per_us = 75",
    );
    let fails = folder(&[("probe-rs", PROBE)]);
    fails.file("probe-rsdownload.code", "1");
    refused(
        &fails,
        &[],
        9,
        "ended with exit code 1; read what it printed",
    );
    let damaged = folder(&[("probe-rs", PROBE)]);
    damaged.file("own.elf", &elf()[..90]);
    refused(
        &damaged,
        &[],
        3,
        "is truncated: segment 0; make it with `cargo xtask board stm32`",
    );
    assert!(!std::path::Path::new(&damaged.path("arguments")).exists());
    let of_pico = haptimill(&["flash", "--with", "probe-rs"]).expect_code(2);
    assert!(
        of_pico.err.contains("--with: the board needs no program"),
        "{of_pico:?}"
    );
}
