//! Drawings and options that are refused.

use super::{Folder, plate};
use std::process::Command;

/// A drawing above the limit of 512 MiB is refused by its size, with less memory than the limit. A
/// large one below it that is no drawing is refused after it is read. Both files are sparse.
#[test]
fn large_drawings_are_refused_or_read_to_their_end() {
    let folder = Folder::new("large");
    for (name, bytes, memory_kib, why) in [
        ("huge.dxf", 600_u64 << 30, 300_000, "larger than 512 MiB"),
        ("zeros.dxf", 300 << 20, 800_000, "is not a group code"),
    ] {
        let file = std::fs::File::create(folder.0.join(name)).unwrap();
        file.set_len(bytes).unwrap();
        let ran = Command::new("sh")
            .args(["-c", "ulimit -v $0; exec \"$1\" engrave \"$2\" -o out.ngc"])
            .arg(memory_kib.to_string())
            .args([env!("CARGO_BIN_EXE_haptimill"), name])
            .current_dir(&folder.0)
            .output()
            .unwrap();
        let text = String::from_utf8(ran.stderr).unwrap();
        assert_eq!(ran.status.code(), Some(3), "{name}: {text}");
        assert!(text.contains(name) && text.contains(why), "{name}: {text}");
        assert!(text.len() < 400, "{name}: {text}");
    }
    assert!(!folder.0.join("out.ngc").exists());
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
    // In metres the pocket is not planned: it would take hours.
    let metres = [
        "--unit",
        "1000",
        "--operation",
        "pocket",
        "--layer",
        "PICTURE",
    ];
    let (code, result) = folder.run(&[&[&*plate, "-o", "out.ngc"], &metres[..]].concat());
    assert_eq!(code, 4, "{result:#}");
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

/// Levels that the travel of z does not have, and negative numbers, are refused with the option,
/// and nothing is written.
#[test]
fn wrong_depths_and_heights_are_refused() {
    let folder = Folder::new("levels");
    for (option, code, text) in [
        (
            ["--depth", "6"],
            4,
            "--depth 6: Z-6 is outside of the travel",
        ),
        (
            ["--lift", "30"],
            4,
            "--lift 30: Z30 is outside of the travel",
        ),
        (["--depth", "-1"], 2, "depth"),
        (["--tool", "-1"], 2, "tool"),
        (["--lift", "-1"], 2, "--lift -1: it must be above 0"),
        (["--scale", "-1"], 2, "--scale -1: it must be above 0"),
        (["--unit", "-1"], 2, "write mm, cm, m, inch"),
        (["--tabs", "-1"], 2, "--tabs"),
        (["--lead", "-1"], 2, "--lead -1: it must be above 0"),
        (["--feed", "-1e300"], 2, "--feed -1e300: it must be above 0"),
    ] {
        let ran = Command::new(env!("CARGO_BIN_EXE_haptimill"))
            .args(["engrave", &plate(), "--skip-text", "-o", "part.ngc"])
            .args(option)
            .current_dir(&folder.0)
            .output()
            .unwrap();
        let err = String::from_utf8(ran.stderr).unwrap();
        assert_eq!(ran.status.code(), Some(code), "{option:?}: {err}");
        assert!(err.contains(text), "{option:?}: {err}");
        assert!(!err.contains("unexpected argument"), "{err}");
        assert!(!folder.0.join("part.ngc").exists(), "{option:?}");
    }
}

/// An option that the job would ignore is refused by name; tabs that do not fit are a notice.
#[test]
fn options_that_do_nothing_are_refused() {
    let folder = Folder::new("ignored");
    let plate = plate();
    let drill = ["--operation", "drill", "--layer", "HOLES"];
    let pocket = ["--operation", "pocket", "--layer", "PICTURE"];
    let cases: [(&[&str], &[&str], &str); 12] = [
        (
            &[],
            &["--clear", "zigzag"],
            "--clear is for --operation pocket",
        ),
        (
            &[],
            &["--overlap", "0.4"],
            "--overlap is for --operation pocket",
        ),
        (
            &[],
            &["--angle", "45"],
            "--angle needs --operation pocket and --clear",
        ),
        (
            &pocket,
            &["--angle", "45"],
            "--angle needs --operation pocket and --clear",
        ),
        (
            &[],
            &["--finish", "0.2"],
            "--finish needs --operation pocket, or --side",
        ),
        (
            &[],
            &["--conventional"],
            "--conventional needs --operation pocket, or --side",
        ),
        (
            &drill,
            &["--ramp", "5"],
            "--ramp is for --operation outline or pocket",
        ),
        (
            &drill,
            &["--finish", "0.2"],
            "--finish needs --operation pocket, or --side",
        ),
        (
            &[],
            &["--tab-width", "3"],
            "--tab-width and --tab-height need --tabs",
        ),
        (
            &pocket,
            &["--tabs", "4"],
            "--tabs is for --operation outline",
        ),
        (
            &[],
            &["--tabs", "4", "--order", "greedy"],
            "--tabs needs --order short",
        ),
        (
            &[],
            &["--tabs", "4", "--order", "file"],
            "--tabs needs --order short",
        ),
    ];
    for (job, ignored, expected) in cases {
        let command = [&[plate.as_str()][..], job, ignored].concat();
        let (code, result) = folder.run(&command);
        assert_eq!(code, 2, "{command:?}: {result}");
        let text = result.to_string();
        assert!(text.contains(expected), "{command:?}: {text}");
    }
    for (option, value) in [("--tab-width", "0"), ("--tab-height", "-1")] {
        let command = [&plate, "--skip-text", "--tabs", "4", option, value];
        let (code, result) = folder.run(&command);
        assert_eq!(code, 2, "{command:?}: {result}");
        let expected = format!("{option} {value}: it must be above 0");
        assert!(
            result.to_string().contains(&expected),
            "{command:?}: {result}"
        );
    }
    assert!(!folder.0.join("plate.ngc").exists());
    let frame = [&plate, "--layer", "FRAME", "--side", "outside", "--tabs"];
    let notices = |count| {
        let (code, result) = folder.run(&[&frame[..], &[count]].concat());
        assert_eq!(code, 0, "{result}");
        result["notices"].to_string()
    };
    assert!(!notices("4").contains("tabs"), "{}", notices("4"));
    let many = notices("400");
    assert!(
        many.contains("cut through without tabs: 400 tabs"),
        "{many}"
    );
    assert!(many.contains("use fewer or narrower tabs"), "{many}");
}

/// An output that is an input, or the other output, is refused before anything is written.
#[test]
fn inputs_are_not_overwritten() {
    let folder = Folder::new("overwrite");
    let text = std::fs::read_to_string(plate()).unwrap();
    let machine = super::root().join("machines/engraver.toml");
    let machine = std::fs::read_to_string(machine).unwrap();
    let files = [("k.dxf", &text), ("same.ngc", &text), ("e.toml", &machine)];
    for (name, text) in files {
        folder.write(name, text);
    }
    let cases: [(&[&str], &str); 7] = [
        (
            &["k.dxf", "-o", "k.dxf"],
            "the drawing would be overwritten",
        ),
        (
            &["k.dxf", "-o", "./k.dxf"],
            "the drawing would be overwritten",
        ),
        (&["same.ngc"], "the drawing would be overwritten"),
        (
            &["k.dxf", "--preview", "k.dxf"],
            "another file with --preview",
        ),
        (
            &["k.dxf", "--machine", "e.toml", "-o", "e.toml"],
            "the machine file would be overwritten",
        ),
        (&["k.dxf", "-o", "x", "--preview", "x"], "are the same file"),
        (
            &["k.dxf", "-o", "x", "--preview", "./x"],
            "are the same file",
        ),
    ];
    for (arguments, expected) in cases {
        let command = [arguments, &["--skip-text"]].concat();
        let (code, result) = folder.run(&command);
        assert_eq!(code, 2, "{command:?}: {result}");
        assert!(
            result.to_string().contains(expected),
            "{command:?}: {result}"
        );
        for (name, text) in files {
            assert_eq!(&std::fs::read_to_string(folder.0.join(name)).unwrap(), text);
        }
    }
    let written = std::fs::read_dir(&folder.0).unwrap().count();
    assert_eq!(written, files.len());
}
