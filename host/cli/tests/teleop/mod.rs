//! Teleoperation: scripted and live, over delayed, lost and stalled links, with a haptic arm, a
//! joystick and missing devices.

use crate::scene;
#[cfg(unix)]
use crate::terminal;
mod failures;
mod live;

use haptimill_machine_file::MachineFile;
use haptimill_trace::{Record, Recording};
use scene::{TestFolder, haptimill, number};
use serde_json::Value;
use std::path::Path;

/// Axis units per millimetre.
const MM: f64 = (1 << 20) as f64;

/// Moves by 40 mm in about 4 s with the enabling switch pressed.
const AWAY: &str = "
[[button]]
at_s = 0.3
held = true
[[stroke]]
at_s = 0.5
to_mm = [-40.0, 5.0, 3.0]
pace_mm_s = 12.0
ramp_s = 0.3
";

/// Runs a scripted session in the simulator.
fn run_script(folder: &TestFolder, out: &str, script: &str, more: &[&str]) -> Value {
    run_script_to_code(0, folder, out, script, more)
}

/// Runs a scripted session that ends with this exit code.
fn run_script_to_code(
    code: i32,
    folder: &TestFolder,
    out: &str,
    script: &str,
    more: &[&str],
) -> Value {
    let master = format!("script:{}", folder.file("script.toml", script));
    let out = folder.path(out);
    let session = ["teleop", "--master", &master, "--out", &out, "--json"];
    haptimill(&[&session, more].concat())
        .expect_code(code)
        .json()
}

fn read_records(path: &str) -> Vec<Record> {
    let recording = Recording::open(Path::new(path)).unwrap();
    assert!(recording.is_whole());
    recording.iter().unwrap().map(Result::unwrap).collect()
}

/// Maximum acceleration, mm/s^2, and maximum rate, mm/s.
fn largest_rate_and_acceleration(read_records: &[Record], axis: usize) -> (f64, f64) {
    let period_s = 2e-4;
    let at = |record: &Record| f64::from(record.commanded[axis]) / MM;
    let rates: Vec<f64> = read_records
        .windows(2)
        .map(|two| (at(&two[1]) - at(&two[0])) / period_s)
        .collect();
    // Over ten periods, so that the rounding of positions to 2^-20 mm is negligible.
    let change = rates
        .windows(11)
        .map(|rates| ((rates[10] - rates[0]) / (10.0 * period_s)).abs());
    let fastest = rates.iter().fold(0.0, |max: f64, rate| max.max(rate.abs()));
    (change.fold(0.0, f64::max), fastest)
}

/// Checks that no command exceeds the rate or acceleration of its axis.
#[track_caller]
fn expect_within_limits(read_records: &[Record]) {
    let machine = MachineFile::built_in().unwrap();
    for (axis, limits) in machine.pose.iter().enumerate().take(3) {
        let (change, fastest) = largest_rate_and_acceleration(read_records, axis);
        // 5 mm/s^2 for rounding over ten periods.
        assert!(
            change <= limits.acceleration + 5.0,
            "{}: {change} mm/s^2",
            limits.name
        );
        assert!(fastest <= limits.rate, "{}: {fastest} mm/s", limits.name);
    }
}

/// Checks that the fed-back force changes by at most 0.05 N per period: at contact, at the enabling
/// switch, at commands, and when the link is lost and restored.
fn expect_no_force_step(master: &[Record]) {
    let step = master
        .windows(2)
        .flat_map(|pair| (0..3).map(|axis| pair[1].haptic.force[axis] - pair[0].haptic.force[axis]))
        .map(i32::abs)
        .max()
        .unwrap();
    // The force reached at least 0.5 N.
    let max = master.iter().flat_map(|record| record.haptic.force);
    assert!(max.map(i32::abs).max().unwrap() > 1 << 15);
    assert!(
        step <= 65_536 / 20 + 1,
        "{} N in a period",
        f64::from(step) / 65_536.0
    );
}

#[test]
fn readme_command_cuts_feeds_back_force_and_is_bit_identical() {
    let folder = TestFolder::new();
    let session = |out: &str| {
        let out = folder.path(out);
        let command = "teleop --master sim --stock examples/block.toml --spindle 5000 --json --out";
        let words: Vec<&str> = command.split(' ').chain([out.as_str()]).collect();
        haptimill(&words).expect_code(0).json()
    };
    let (one, other) = (session("one"), session("other"));
    assert_eq!(one, other);
    assert_eq!(one, folder.summary("one"));
    for file in ["recording.hmr", "master.hmr", "teleop.csv", "trace.csv"] {
        let read = |out: &str| std::fs::read(folder.path(&format!("{out}/{file}"))).unwrap();
        assert!(read("one") == read("other"), "{file}");
    }
    // The recordings of both controllers replay equal.
    for file in ["recording.hmr", "master.hmr"] {
        let said = haptimill(&["replay", &folder.path(&format!("one/{file}")), "--json"])
            .expect_code(0)
            .json();
        assert!(
            said["equal"] == true && number(&said, "records") > 40_000.0,
            "{said}"
        );
    }
    let session = &one["session"];
    assert_eq!(session["ended"], "done");
    assert_eq!(session["holds"].as_array().unwrap().len(), 0);
    assert_eq!(session["position_kept"], true);
    // The tool cut, and the force was fed back within the limits of the law; the oscillation damper
    // adds to it.
    let feedback = session["largest_feedback_n"][2].as_f64().unwrap();
    let force = session["largest_force_n"][2].as_f64().unwrap();
    assert!(force > 2.0 && feedback > 0.4, "{force} N, {feedback} N");
    let latency = &session["latency"];
    assert!(number(latency, "count") > 100.0);
    assert!(
        (0.2..5.0).contains(&number(latency, "median_ms")) && number(latency, "largest_ms") < 12.0,
        "{latency}"
    );
    println!("no delay: {latency}");
    // The arm's recording has the reported values of the master.
    let trace = folder.path("one/master.hmr");
    let columns = "time_s,?_master_mm,master_enabling_switch,?_master_force_n,\
                   ?_master_feedback_n,?_master_fixture_n";
    let ran = haptimill(&[
        "trace",
        "csv",
        &trace,
        "--columns",
        columns,
        "--every",
        "50",
    ]);
    let rows: Vec<Vec<f64>> = ran
        .expect_code(0)
        .out
        .lines()
        .skip(1)
        .map(|line| {
            line.split(',')
                .map(|value| value.parse().unwrap())
                .collect()
        })
        .collect();
    let max = |column: usize| {
        rows.iter()
            .fold(0.0, |max: f64, row| max.max(row[column].abs()))
    };
    assert!(rows.iter().any(|row| row[4] == 1.0) && rows.iter().any(|row| row[4] == 0.0));
    assert!((599.0..600.5).contains(&rows[0][3]), "{:?}", rows[0]);
    assert!(
        max(7) > 0.4 && max(10) > 0.2 && max(10) <= 1.2001,
        "{} {}",
        max(7),
        max(10)
    );
    assert_eq!(max(13), 0.0);
    let info = haptimill(&["trace", "info", &trace]).expect_code(0);
    assert!(info.out.contains("x_master_feedback_n"), "{}", info.out);
    // The axes of the handle are unit vectors at right angles, in the recording and in the table.
    let columns = "?_master_axis_x,?_master_axis_z";
    let ran = haptimill(&[
        "trace",
        "csv",
        &trace,
        "--columns",
        columns,
        "--every",
        "500",
    ]);
    let axes = ran.expect_code(0).out;
    let table = folder.read("one/teleop.csv");
    let rows = axes.lines().skip(1).map(str::to_string);
    let ends = table.lines().skip(1).map(|row| {
        let cells: Vec<&str> = row.split(',').collect();
        cells[cells.len() - 6..].join(",")
    });
    let mut checked = 0;
    for row in rows.chain(ends.step_by(100)) {
        let axes: Vec<f64> = row.split(',').map(|value| value.parse().unwrap()).collect();
        let dot = |a: usize, b: usize| (0..3).map(|k| axes[a + k] * axes[b + k]).sum::<f64>();
        assert!(
            (dot(0, 0) - 1.0).abs() < 1e-3 && (dot(3, 3) - 1.0).abs() < 1e-3,
            "{row}"
        );
        assert!(dot(0, 3).abs() < 1e-3, "{row}");
        checked += 1;
    }
    assert!(checked > 50, "{checked}");
    // What was cut: the ball end mill left a groove as deep as its tip was in the block.
    let (removed, cut_depth) = (number(&one, "removed_mm3"), number(&one, "cut_depth_mm"));
    assert!(removed > 1.0, "{removed} mm^3");
    assert_eq!(one["spindle_rpm"], 5000);
    let page = folder.read("one/report.html");
    for part in [
        "<h2>Cut surface</h2>",
        "<b>5000 rev/min</b>",
        &format!("<b>{removed:.1} mm^3</b>"),
        "Orientation of the handle",
        "Force of the master on the operator",
        "error, mm",
    ] {
        assert!(page.contains(part), "{part}");
    }
    assert!(page.matches("<svg").count() >= 7 && !page.contains("NaN"));

    let made = read_records(&folder.path("one/recording.hmr"));
    expect_within_limits(&made);
    expect_no_force_step(&read_records(&folder.path("one/master.hmr")));
    let lowest = made.iter().map(|record| record.tool[2]).min().unwrap();
    let depth = 21.232 - f64::from(lowest) / MM;
    assert!((0.7..1.6).contains(&depth), "{depth} mm deep");
    // The top of the block of the example is at the tip's height of the home pose.
    assert!(
        (cut_depth - depth).abs() < 0.05,
        "{cut_depth} mm, the tip was {depth} mm deep"
    );
}

/// A thinned recording of a session has one of so many control periods, in both files, and a
/// session without a stock has no cut.
#[test]
fn a_part_of_a_session_is_recorded() {
    let folder = TestFolder::new();
    let more = ["--for", "2", "--record"];
    let all = run_script(&folder, "all", AWAY, &[&more[..], &["all"]].concat());
    let thin = run_script(&folder, "thin", AWAY, &[&more[..], &["every=50"]].concat());
    let (all_periods, thin_periods) = (number(&all, "periods"), number(&thin, "periods"));
    assert!(
        (all_periods / thin_periods - 50.0).abs() < 1.0,
        "{thin_periods} of {all_periods}"
    );
    assert_eq!(all["session"], thin["session"]);
    assert_eq!(
        (&all["recorded"], &all["removed_mm3"]),
        (&Value::Null, &Value::Null)
    );
    assert!(thin["recorded"].is_string());
    for file in ["recording.hmr", "master.hmr"] {
        let size = |out: &str| {
            let path = folder.path(&format!("{out}/{file}"));
            std::fs::metadata(path).unwrap().len()
        };
        assert!(
            30 * size("thin") < size("all"),
            "{file}: {} of {}",
            size("thin"),
            size("all")
        );
    }
    let refused = haptimill(&["teleop", "--master", "sim", "--record", "every=1"]).expect_code(2);
    assert!(refused.err.contains("last=TIME"), "{}", refused.err);
    assert!(folder.read("thin/report.html").contains("error, mm"));
}

#[test]
fn tool_follows_the_scale_and_link_delay_is_measured() {
    let folder = TestFolder::new();
    for (scale, delay) in [("0.5", "0"), ("1.0", "10"), ("2.0", "25")] {
        let said = run_script(
            &folder,
            "out",
            AWAY,
            &["--scale", scale, "--delay", delay, "--for", "6"],
        );
        assert_eq!(said["session"]["holds"].as_array().unwrap().len(), 0);
        let table = folder.read("out/teleop.csv");
        let row = |line: &str| -> Vec<f64> {
            line.split(',')
                .map(|value| value.parse().unwrap_or(f64::NAN))
                .collect()
        };
        let rows: Vec<Vec<f64>> = table.lines().skip(1).map(row).collect();
        let moved: Vec<&Vec<f64>> = rows.iter().filter(|row| row[5] == 1.0).collect();
        // Means of the last second: the master oscillates a little, and the tool follows 20 to 40
        // ms later.
        let (first, last) = (moved[0], &moved[moved.len() - 200..]);
        let way =
            |column: usize| last.iter().map(|row| row[column]).sum::<f64>() / 200.0 - first[column];
        let scale: f64 = scale.parse().unwrap();
        for axis in 0..3 {
            let (master, tool) = (way(2 + axis), way(7 + axis));
            assert!(
                (tool - scale * master).abs() < 0.15 * scale,
                "{axis}: {tool} of {master}"
            );
        }
        assert!(way(2) < -30.0);
        let trip = number(&said["session"], "master_round_trip_ms");
        let delay: f64 = delay.parse().unwrap();
        assert!(
            (2.0 * delay..2.0 * delay + 3.0).contains(&trip),
            "{trip} ms"
        );
        expect_within_limits(&read_records(&folder.path("out/recording.hmr")));
    }
}

#[test]
fn commands_are_executed_and_invalid_options_are_refused_before_motion() {
    let folder = TestFolder::new();
    let commands = "
[[command]]
at_s = 1.5
what = \"hold\"
[[command]]
at_s = 2.5
what = \"resume\"
[[command]]
at_s = 3.0
what = \"gp=0.25\"
[[command]]
at_s = 3.5
what = \"end\"
";
    let said = run_script(&folder, "out", &format!("{AWAY}{commands}"), &[]);
    let holds = said["session"]["holds"].as_array().unwrap();
    assert_eq!(holds.len(), 1);
    assert_eq!(holds[0]["why"], "a command asked for it");
    assert!((3.5..3.8).contains(&number(&said["session"], "duration_s")));
    expect_within_limits(&read_records(&folder.path("out/recording.hmr")));

    let out = folder.path("none");
    let refused = |arguments: &[&str], code: i32, why: &str| {
        let ran = haptimill(&[&["teleop", "--out", &out], arguments].concat()).expect_code(code);
        assert!(ran.err.contains(why), "{arguments:?}: {}", ran.err);
        assert!(!Path::new(&out).exists(), "{arguments:?}");
    };
    let script = folder.file("gp.toml", "[[command]]\nat_s = 1.0\nwhat = \"gp=3\"\n");
    let script = format!("script:{script}");
    refused(
        &["--master", "sim", "--scale", "2.5"],
        2,
        "G_P of 2.5 is out of its range: 0.1 to 2",
    );
    refused(
        &["--master", &script],
        3,
        "gp.toml:3:8: command[1].what: G_P of 3 is out of its range: 0.1 to 2",
    );
    refused(
        &["--master", "keyboard"],
        2,
        "needs a terminal on standard input",
    );
    refused(
        &["--master", "joystick:/dev/none"],
        5,
        "/dev/none: no game controller there",
    );
    refused(
        &["--master", "mouse3d:/dev/none"],
        5,
        "/dev/none: no 3D mouse there",
    );
    refused(
        &["--master", "sim", "--coordinates", "x,w"],
        2,
        "there is no coordinate 'w'; this machine has x, y, z, theta, alpha",
    );
    let master = ["--machine", "machines/haptic-master.toml"];
    refused(
        &[&["--master", "sim"], &master[..]].concat(),
        3,
        "the file describes a haptic arm",
    );
    refused(
        &["--master", "sim", "--master-machine", "machines/h4.toml"],
        3,
        "write role = \"master\"",
    );
    refused(
        &["--master", "keyboard", "--delay", "5"],
        2,
        "--delay and --master-fault are for the simulated arm",
    );
    // A machine with its own arm takes no remote master.
    let own = folder.machine_with(haptimill_machine_file::HAPTIC_ARM);
    refused(
        &["--master", "sim", "--machine", &own],
        3,
        "on its own board",
    );
    // A haptic arm runs no programs.
    let ran = haptimill(&[&["run", "examples/e7-slot.ngc", "--check"], &master[..]].concat());
    assert_eq!(ran.code, 3, "{}", ran.err);
}

/// The length of a session is not known: the growth of its recording is printed, as the file has
/// it.
#[test]
fn the_growth_of_the_recording_is_announced() {
    let folder = TestFolder::new();
    let script = folder.file("script.toml", format!("end_s = 3.0\n{AWAY}"));
    let (master, out) = (format!("script:{script}"), folder.path("out"));
    let reported = haptimill(&["teleop", "--master", &master, "--out", &out]).expect_code(0);
    let growth = reported
        .out
        .lines()
        .find_map(|line| line.strip_prefix("the recording grows by about "));
    let growth = growth.and_then(|rest| rest.strip_suffix(" MB/s"));
    let growth: f64 = growth.expect(&reported.out).parse().unwrap();
    let size = std::fs::metadata(folder.path("out/recording.hmr")).unwrap();
    let seconds = number(&folder.summary("out")["session"], "duration_s");
    let mb_s = size.len() as f64 / 1e6 / seconds;
    assert!((growth / mb_s - 1.0).abs() < 0.2, "{growth} of {mb_s} MB/s");
}
