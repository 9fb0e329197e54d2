//! The log of the emulated chip: its lines arrive, its texts take no flash, and the outputs stay
//! the same.
//!
//! Needs the feature `emulated`; see `emulated.rs`.

use crate::emulator;
use emulator::{image, results, root, run};
use haptimill::commands::Exit;
use haptimill_trace::{Recording, difference};
use std::path::Path;
use std::process::Command;

/// Returns the bytes of an image that are loaded into the chip's memory: its loadable segments.
fn loaded_bytes(image: &[u8]) -> Vec<u8> {
    let word =
        |at: usize| u32::from_le_bytes(image[at..at + 4].try_into().expect("a word")) as usize;
    let half = |at: usize| {
        usize::from(u16::from_le_bytes(
            image[at..at + 2].try_into().expect("two bytes"),
        ))
    };
    let (table, size, count) = (word(28), half(42), half(44));
    let headers = (0..count).map(|index| table + index * size);
    let load = headers.filter(|&header| word(header) == 1);
    load.flat_map(|header| image[word(header + 4)..][..word(header + 16)].to_vec())
        .collect()
}

fn contains(bytes: &[u8], text: &str) -> bool {
    bytes
        .windows(text.len())
        .any(|window| window == text.as_bytes())
}

/// Returns the lines of a log: timestamp (the control period), level, text.
fn decoded(image: &str, log: &Path) -> Result<Vec<String>, String> {
    let output = Command::new(env!("CARGO"))
        .args(["run", "--quiet", "--locked", "--manifest-path"])
        .arg(root().join("tests/log/Cargo.toml"))
        .args(["--", image])
        .arg(log)
        .output()
        .expect("cargo starts");
    let text = |bytes| String::from_utf8(bytes).expect("text");
    if output.status.success() {
        Ok(text(output.stdout).lines().map(String::from).collect())
    } else {
        Err(text(output.stderr))
    }
}

#[test]
fn the_log_reports_states_and_faults_and_changes_no_output() {
    let program = root().join("examples/e7-slot.ngc");
    let image = image("logging");
    let bytes = std::fs::read(&image).expect("built");
    let image = image.display().to_string();
    let file = results("chip.log");
    let name = file.display().to_string();
    let fault = ["--fault", "drive-tripped joint=l2 at=8s"];
    let native = run(&program, "sim", &results("log-native"), &fault).expect_err("tripped");
    let [fault, tripped] = fault;
    let more = ["--image", &image, "--log", &name, fault, tripped];
    let emulated = run(&program, "pil:mps2", &results("log-m4"), &more).expect_err("tripped");
    assert_eq!((native.exit, emulated.exit), (Exit::Fault, Exit::Fault));
    let open =
        |name: &str| Recording::open(&results(name).join("recording.hmr")).expect("recorded");
    let found = difference(&open("log-native"), &open("log-m4")).expect("readable");
    assert!(found.is_none(), "{}", found.expect("differs"));

    let lines = decoded(&image, &file).expect("of this image");
    lines.iter().for_each(|line| println!("{line}"));
    let texts: Vec<&str> = lines.iter().map(|line| line[11..].trim()).collect();
    let expected = [
        "info  a run begins, 200 us a period",
        "info  State { from: Disabled, to: Idle, homed: false }",
        "info  State { from: Idle, to: Homing, homed: false }",
        "info  State { from: Homing, to: Idle, homed: true }",
        "info  State { from: Idle, to: Run, homed: true }",
        "warn  drive of joint 1: Input",
        "error fault: Drive { joint: 1, alarm: Input }",
    ];
    let mut rest = texts.iter();
    for text in expected {
        assert!(
            rest.any(|line| *line == text),
            "{text} is missing: {texts:#?}"
        );
    }
    // The time stamps are control periods: they increase, and the fault comes 8 s after the start.
    let stamp = |line: &String| line[..10].trim().parse::<u32>().expect("a number");
    assert!(lines.is_sorted_by_key(stamp));
    let fault = lines.iter().find(|line| line.contains("fault:"));
    assert_eq!(fault.map(stamp), Some(40_000));

    // Log texts are in the file and not in the flash. A text of the product is in both.
    let flash = loaded_bytes(&bytes);
    assert!(contains(&bytes, "drive of joint") && !contains(&flash, "drive of joint"));
    assert!(contains(&flash, "the simulator has gone"));
    std::fs::write(&file, [1, 2, 3, 0]).expect("written");
    let refused = decoded(&image, &file).expect_err("of no image");
    assert!(refused.contains("not of this image"), "{refused}");
}
