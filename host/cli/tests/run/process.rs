//! Force, compliance and cut in the results of a run.

use super::{TestFolder, haptimill, job, number};
use haptimill_trace::{Recording, flag};

fn magnitude(values: [i32; 3]) -> f64 {
    let square: f64 = values.iter().map(|value| f64::from(*value).powi(2)).sum();
    square.sqrt()
}

/// A slot in a block: the volume is that of its geometry, the force that of the recording.
#[test]
fn a_cut_reports_force_volume_and_surface() {
    let folder = TestFolder::new();
    let summary = job(
        &folder,
        "out",
        "e7-slot.ngc",
        &["--stock", "examples/block.toml"],
    );
    assert_eq!(summary["error_reference"], "programmed path");
    let recording = Recording::open(folder.path("out/recording.hmr").as_ref()).unwrap();
    let records = recording.iter().unwrap().map(Result::unwrap);
    let job = records.filter(|record| record.has(flag::PROGRAMMED));
    let forces: Vec<f64> = job
        .map(|record| magnitude(record.true_force) / 65536.0)
        .collect();
    let max = forces.iter().copied().fold(0.0, f64::max);
    assert!(max > 1.0, "nothing was cut");
    assert!(
        (number(&summary, "force_max_n") - max).abs() < 1e-9,
        "{summary:#}"
    );
    let mean_square = forces.iter().map(|force| force * force).sum::<f64>() / forces.len() as f64;
    let error = number(&summary, "force_rms_n") - mean_square.sqrt();
    assert!(error.abs() < 1e-9 * max, "{summary:#}");
    // A ball of 4 mm radius, 2 mm deep, along 30 mm: segment of the circle, and half a cap at each
    // end. The tool is within 0.015 mm of its path.
    let (radius, depth, length): (f64, f64, f64) = (4.0, 2.0, 30.0);
    let angle = 2.0 * ((radius - depth) / radius).acos();
    let segment = radius.powi(2) / 2.0 * (angle - angle.sin());
    let caps = std::f64::consts::PI * depth.powi(2) * (3.0 * radius - depth) / 3.0;
    let volume = segment * length + caps;
    let removed = number(&summary, "removed_mm3");
    assert!(
        (removed / volume - 1.0).abs() < 0.02,
        "{removed} of {volume}"
    );
    assert!(
        (number(&summary, "cut_depth_mm") - depth).abs() < 0.03,
        "{summary:#}"
    );
    assert_eq!(summary["spindle_rpm"], 5000);
    let page = folder.read("out/report.html");
    let row = |name: &str, value: String| format!("<tr><td>{name}</td><td>{value}</td></tr>");
    let rms = number(&summary, "force_rms_n");
    let cut_depth = number(&summary, "cut_depth_mm");
    for part in [
        "Force on the simulated tool".to_string(),
        "Cut surface".to_string(),
        "data:image/png;base64".to_string(),
        format!("<b>{max:.2} N</b><span>force, largest</span>"),
        row(
            "Force on the tool, rms / largest",
            format!("{rms:.3} / {max:.3} N"),
        ),
        row("Spindle speed, largest", "5000 rev/min".to_string()),
        row("Volume removed", format!("{removed:.1} mm^3")),
        row("Depth of the cut, largest", format!("{cut_depth:.3} mm")),
        "programmed</text>".to_string(),
    ] {
        assert!(page.contains(&part), "{part}");
    }
    assert!(!page.contains("compliant"), "nothing was displaced");
}

/// The force displaces the tool by millimetres, as intended: that is no error of the tool.
#[test]
fn a_displaced_tool_has_no_error() {
    let folder = TestFolder::new();
    let given = [
        "--stock",
        "examples/incline.toml",
        "--force",
        "x",
        "--force-setpoint",
        "5",
    ];
    let summary = job(&folder, "out", "e5-incline-2.ngc", &given);
    let displacement = number(&summary, "displacement_max_mm");
    assert!(displacement > 0.5, "{summary:#}");
    assert!(number(&summary, "tool_error_rms_mm") < 0.02, "{summary:#}");
    assert_eq!(summary["error_reference"], "compliant path");
    let page = folder.read("out/report.html");
    for part in [
        "Compliant displacement: ".to_string(),
        format!("<td>Compliant displacement, largest</td><td>{displacement:.5} mm</td>"),
        "<td>Tool error against the compliant path at the same time, rms / largest</td>"
            .to_string(),
        "compliant path</text>".to_string(),
        "True position of the tool against the compliant path".to_string(),
    ] {
        assert!(page.contains(&part), "{part}");
    }
    let run = [
        "run",
        "examples/e5-incline-2.ngc",
        "--out",
        &folder.path("reported"),
    ];
    let reported = haptimill(&[&run[..], &given].concat()).expect_code(0).out;
    assert!(
        reported.contains("\ntool error against the compliant path: 0.0"),
        "{reported}"
    );
    assert!(reported.contains("\nspindle: "), "{reported}");
}

/// Without a stock and a force nothing about them is said.
#[test]
fn a_run_without_force_says_nothing_about_it() {
    let folder = TestFolder::new();
    let program = folder.file("move.ngc", "G0 X-1\nM30\n");
    let out = folder.path("out");
    let ran = haptimill(&["run", &program, "--out", &out]).expect_code(0);
    assert!(
        !ran.out.contains("force") && !ran.out.contains("cut:"),
        "{}",
        ran.out
    );
}

/// A program without motion homes the machine, says so, and ends well.
#[test]
fn an_empty_program_says_that_it_only_homes() {
    let folder = TestFolder::new();
    let program = folder.file("empty.ngc", "M30\n");
    let ran = haptimill(&["run", &program, "--check"]).expect_code(0);
    assert!(ran.out.contains("no motion; a run homes"), "{}", ran.out);
    let out = folder.path("out");
    let ran = haptimill(&["run", &program, "--out", &out]).expect_code(0);
    assert!(
        ran.out.contains("no motion; the machine is homed"),
        "{}",
        ran.out
    );
}
