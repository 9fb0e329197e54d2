//! `haptimill pulses` on lines that are drawn from a job's recording, correct and with a fault.

use crate::scene;
use haptimill_firmware::io::DriveCommand;
use haptimill_trace::Recording;
use std::fmt::Write as _;
use std::path::Path;

use scene::{TestFolder, haptimill};

/// Ticks of the step clock per us in `mill3.toml`.
const TICKS_PER_US: i64 = 84;
/// Ticks of a control period of 200 us.
const PERIOD: i64 = 200 * TICKS_PER_US;
/// Ticks of a pulse of 2.5 us.
const WIDTH: i64 = 210;

/// Lines of all joints as VCD in ps, by the formula of the segment.
fn vcd(recording: &Recording, names: &[&str]) -> (String, usize) {
    let mut changes: Vec<(i64, usize, bool)> = Vec::new();
    let mut levels = vec![false; names.len()];
    let periods: Vec<_> = recording
        .read_periods()
        .unwrap()
        .map(Result::unwrap)
        .collect();
    let mut count = 0;
    for pair in periods.windows(2) {
        let start = pair[1].inputs.period as i64 * PERIOD;
        for (axis, level) in levels.iter_mut().enumerate() {
            let DriveCommand::Steps(segment) = pair[0].outputs.joints[axis] else {
                continue;
            };
            if segment.count == 0 {
                continue;
            }
            let up = segment.count > 0;
            if up != *level {
                *level = up;
                changes.push((start, 2 * axis + 1, up));
            }
            for k in 0..i64::from(segment.count).abs() {
                let at = start
                    + i64::from(segment.delay)
                    + k * i64::from(segment.interval)
                    + i64::from(segment.ramp) * k * (k - 1) / 2;
                changes.push((at, 2 * axis, true));
                changes.push((at + WIDTH, 2 * axis, false));
                count += 2;
            }
        }
    }
    changes.sort_by_key(|(at, _, _)| *at);
    let mut text = String::from("$timescale 1 ps $end\n$scope module board $end\n");
    for (axis, name) in names.iter().enumerate() {
        let code = |line: usize| char::from(b'!' + (2 * axis + line) as u8);
        let _ = writeln!(text, "$var wire 1 {} {name}_step $end", code(0));
        let _ = writeln!(text, "$var wire 1 {} {name}_dir $end", code(1));
    }
    text.push_str("$upscope $end\n$enddefinitions $end\n#0\n");
    for line in 0..2 * names.len() {
        let _ = writeln!(text, "0{}", char::from(b'!' + line as u8));
    }
    for (at, line, level) in changes {
        let ps = (i128::from(at) * 1_000_000 / i128::from(TICKS_PER_US)) as i64;
        let code = char::from(b'!' + line as u8);
        let _ = writeln!(text, "#{ps}\n{}{code}", u8::from(level));
    }
    (text, count)
}

fn pulses(capture: &str, more: &[&str]) -> scene::RunResult {
    haptimill(&[&["pulses", capture], more].concat())
}

#[test]
fn lines_of_a_job_are_checked_against_its_recording() {
    let folder = TestFolder::new();
    let program = folder.file("short.ngc", "G21 G90 F600\nG1 X4 Y-3\nG1 X0 Y0\nM2\n");
    let machine = scene::root().join("machines/mill3.toml");
    let out = folder.path("job");
    let job = haptimill(&[
        "run",
        &program,
        "--machine",
        machine.to_str().unwrap(),
        "--out",
        &out,
    ]);
    assert!(job.code == 0, "{job:?}");
    let trace = format!("{out}/recording.hmr");
    let recording = Recording::open(Path::new(&trace)).unwrap();
    let (text, edges) = vcd(&recording, &["x", "y", "z"]);
    assert!(edges > 10_000, "{edges}");
    let capture = folder.file("good.vcd", &text);
    let recorded = ["--recording", &trace];

    let svg = folder.path("pulses.svg");
    let more = [
        "--width-ticks",
        "210",
        "--width-us",
        "2.5",
        "--json",
        "--svg",
        &svg,
    ];
    let good = pulses(&capture, &[&recorded[..], &more].concat());
    assert!(good.code == 0, "{good:?}");
    let report = good.json();
    assert_eq!(report["faults"], 0);
    assert_eq!(report["edges_compared"], edges);
    assert!(std::fs::read_to_string(&svg).unwrap().contains("z_step"));

    // One edge a nanosecond early.
    let line = text
        .lines()
        .rev()
        .find(|line| line.starts_with('#'))
        .unwrap();
    let early: i64 = line[1..].parse::<i64>().unwrap() - 1000;
    let bad = folder.file("bad.vcd", text.replace(line, &format!("#{early}")));
    let found = pulses(&bad, &[&recorded[..], &["--width-ticks", "210"]].concat());
    assert_eq!(found.code, 8, "{found:?}");
    let said = found.out;
    assert!(
        said.contains("an edge is not at its commanded time, by -0.999 ns"),
        "{said}"
    );

    // Without a recording the data sheet is left, and the report says so.
    let plain = pulses(&capture, &["--width-us", "2.6"]);
    assert_eq!(plain.code, 8);
    let said = plain.out;
    assert!(said.contains("a pulse is too short (2500.0 ns)"), "{said}");
    assert!(
        said.contains("Not compared with a limit: pause, set-up, hold"),
        "{said}"
    );
}

#[test]
fn captures_that_cannot_be_checked_are_refused() {
    let folder = TestFolder::new();
    let header = "$timescale 1 ns $end\n$var wire 1 ! clock $end\n$enddefinitions $end\n#0\n0!\n";
    let file = folder.file("other.vcd", header);
    for (arguments, part) in [
        (&[][..], "has no lines named NAME_step and NAME_dir"),
        (
            &["--joint", "x=a,b"],
            "no line is named 'a'; there are clock",
        ),
        (
            &["--enable", "e", "--joint", "x=clock,clock"],
            "no line is named 'e'",
        ),
        (
            &["--recording", "nothing.hmr"],
            "nothing.hmr: cannot be read",
        ),
    ] {
        let found = pulses(&file, arguments);
        assert_eq!(found.code, 3, "{found:?}");
        let said = found.err;
        assert!(said.contains(part), "{said}");
    }
    let found = pulses(&folder.path("none.vcd"), &[]);
    assert_eq!(found.code, 3);
    assert_eq!(pulses(&file, &["--joint", "x"]).code, 2);
}
