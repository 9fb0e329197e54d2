//! A hand leads the machine from afar: scripted and live, over links that are late, cut and stalled, from an arm, a stick and nothing at all.

mod live;
#[path = "../scene/mod.rs"]
mod scene;
#[cfg(unix)]
#[path = "../terminal/mod.rs"]
mod terminal;

use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::State;
use haptimill_trace::{Record, Recording};
use scene::{Folder, haptimill, number};
use serde_json::Value;
use std::path::Path;

/// Axis units in a millimetre.
const MM: f64 = (1 << 20) as f64;

/// Away by 40 mm in some 4 s, holding the button.
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

/// A scripted session in the simulator.
fn scripted(folder: &Folder, out: &str, script: &str, more: &[&str]) -> Value {
    ending(0, folder, out, script, more)
}

/// The same with this exit code.
fn ending(code: i32, folder: &Folder, out: &str, script: &str, more: &[&str]) -> Value {
    let hand = format!("script:{}", folder.file("script.toml", script));
    let out = folder.path(out);
    let session = ["teleop", "--hand", &hand, "--out", &out, "--json"];
    haptimill(&[&session, more].concat())
        .ended_with(code)
        .json()
}

fn records(path: &str) -> Vec<Record> {
    let recording = Recording::open(Path::new(path)).unwrap();
    assert!(recording.is_whole());
    recording.iter().unwrap().map(Result::unwrap).collect()
}

/// Largest change of the rate between two periods, as an acceleration in mm/s^2, and the largest rate, mm/s.
fn motion(records: &[Record], axis: usize) -> (f64, f64) {
    let period_s = 2e-4;
    let at = |record: &Record| f64::from(record.commanded[axis]) / MM;
    let rates: Vec<f64> = records
        .windows(2)
        .map(|two| (at(&two[1]) - at(&two[0])) / period_s)
        .collect();
    // Over ten periods, so that the rounding of a place to 2^-20 mm does not count.
    let change = rates
        .windows(11)
        .map(|rates| ((rates[10] - rates[0]) / (10.0 * period_s)).abs());
    let fastest = rates
        .iter()
        .fold(0.0, |most: f64, rate| most.max(rate.abs()));
    (change.fold(0.0, f64::max), fastest)
}

/// Nothing was ever told to be faster than its axis may be, and nothing jumped.
#[track_caller]
fn within_limits(records: &[Record]) {
    let machine = MachineFile::built_in().unwrap();
    for (axis, limits) in machine.pose.iter().enumerate().take(3) {
        let (change, fastest) = motion(records, axis);
        // 5 mm/s^2 for the rounding of the ten periods.
        assert!(
            change <= limits.acceleration + 5.0,
            "{}: {change} mm/s^2",
            limits.name
        );
        assert!(fastest <= limits.rate, "{}: {fastest} mm/s", limits.name);
    }
}

/// No change of force at the hand is larger than 0.05 N in a period: not by a cut, a switch, an order, or a link that comes and goes.
fn without_a_bump(hand: &[Record]) {
    let step = hand
        .windows(2)
        .flat_map(|pair| (0..3).map(|axis| pair[1].hand.force[axis] - pair[0].hand.force[axis]))
        .map(i32::abs)
        .max()
        .unwrap();
    // Half a newton was there to change.
    let most = hand.iter().flat_map(|record| record.hand.force);
    assert!(most.map(i32::abs).max().unwrap() > 1 << 15);
    assert!(
        step <= 65_536 / 20 + 1,
        "{} N in a period",
        f64::from(step) / 65_536.0
    );
}

#[test]
fn the_command_of_the_readme_cuts_feels_and_leaves_the_same_bits_every_time() {
    let folder = Folder::new();
    let session = |out: &str| {
        let out = folder.path(out);
        let command = "teleop --hand sim --work examples/block.toml --spindle 5000 --json --out";
        let words: Vec<&str> = command.split(' ').chain([out.as_str()]).collect();
        haptimill(&words).ended_with(0).json()
    };
    let (one, other) = (session("one"), session("other"));
    assert_eq!(one, other);
    assert_eq!(one, folder.summary("one"));
    for file in ["recording.hmr", "hand.hmr", "hand.csv", "trace.csv"] {
        let read = |out: &str| std::fs::read(folder.path(&format!("{out}/{file}"))).unwrap();
        assert!(read("one") == read("other"), "{file}");
    }
    // Both controllers, the machine's and the arm's, do the same once more.
    for file in ["recording.hmr", "hand.hmr"] {
        let said = haptimill(&["replay", &folder.path(&format!("one/{file}")), "--json"])
            .ended_with(0)
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
    // It cut, and the cut came back within the limits of the law; what swings at a free hand is damped on top.
    let felt = session["largest_felt_n"][2].as_f64().unwrap();
    let force = session["largest_force_n"][2].as_f64().unwrap();
    assert!(force > 2.0 && felt > 0.4, "{force} N, {felt} N");
    let latency = &session["latency"];
    assert!(number(latency, "count") > 100.0);
    assert!(
        (0.2..5.0).contains(&number(latency, "median_ms")) && number(latency, "largest_ms") < 12.0,
        "{latency}"
    );
    println!("no delay: {latency}");
    // What the arm's recording has of the hand is what it reported.
    let trace = folder.path("one/hand.hmr");
    let columns = "time_s,?_hand_mm,hand_held,?_hand_force_n,?_hand_reflected_n,?_hand_wall_n";
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
        .ended_with(0)
        .out
        .lines()
        .skip(1)
        .map(|line| {
            line.split(',')
                .map(|value| value.parse().unwrap())
                .collect()
        })
        .collect();
    let most = |column: usize| {
        rows.iter()
            .fold(0.0, |most: f64, row| most.max(row[column].abs()))
    };
    assert!(rows.iter().any(|row| row[4] == 1.0) && rows.iter().any(|row| row[4] == 0.0));
    assert!((599.0..600.5).contains(&rows[0][3]), "{:?}", rows[0]);
    assert!(
        most(7) > 0.4 && most(10) > 0.2 && most(10) <= 1.2001,
        "{} {}",
        most(7),
        most(10)
    );
    assert_eq!(most(13), 0.0);
    let info = haptimill(&["trace", "info", &trace]).ended_with(0);
    assert!(info.out.contains("x_hand_reflected_n"), "{}", info.out);

    let made = records(&folder.path("one/recording.hmr"));
    within_limits(&made);
    without_a_bump(&records(&folder.path("one/hand.hmr")));
    let lowest = made.iter().map(|record| record.tool[2]).min().unwrap();
    let depth = 21.232 - f64::from(lowest) / MM;
    assert!((0.7..1.6).contains(&depth), "{depth} mm deep");
}

#[test]
fn the_tool_goes_as_far_as_the_scale_says_and_a_late_link_is_measured() {
    let folder = Folder::new();
    for (scale, delay) in [("0.5", "0"), ("1.0", "10"), ("2.0", "25")] {
        let said = scripted(
            &folder,
            "out",
            AWAY,
            &["--gp", scale, "--delay", delay, "--for", "6"],
        );
        assert_eq!(said["session"]["holds"].as_array().unwrap().len(), 0);
        let table = folder.read("out/hand.csv");
        let row = |line: &str| -> Vec<f64> {
            line.split(',')
                .map(|value| value.parse().unwrap_or(f64::NAN))
                .collect()
        };
        let rows: Vec<Vec<f64>> = table.lines().skip(1).map(row).collect();
        let led: Vec<&Vec<f64>> = rows.iter().filter(|row| row[5] == 1.0).collect();
        // Means of the last second: the hand swings a little, and the tool follows 20 to 40 ms later.
        let (first, last) = (led[0], &led[led.len() - 200..]);
        let way =
            |column: usize| last.iter().map(|row| row[column]).sum::<f64>() / 200.0 - first[column];
        let scale: f64 = scale.parse().unwrap();
        for axis in 0..3 {
            let (hand, tool) = (way(2 + axis), way(7 + axis));
            assert!(
                (tool - scale * hand).abs() < 0.15 * scale,
                "{axis}: {tool} of {hand}"
            );
        }
        assert!(way(2) < -30.0);
        let trip = number(&said["session"], "hand_round_trip_ms");
        let delay: f64 = delay.parse().unwrap();
        assert!(
            (2.0 * delay..2.0 * delay + 3.0).contains(&trip),
            "{trip} ms"
        );
        within_limits(&records(&folder.path("out/recording.hmr")));
    }
}

#[test]
fn a_link_that_drops_holds_the_machine_until_it_is_told_to_go_on() {
    let folder = Folder::new();
    let orders = "
[[order]]
at_s = 3.0
what = \"resume\"
[[order]]
at_s = 5.2
what = \"resume\"
";
    let script = format!("end_s = 7.0\n{AWAY}{orders}");
    let cut = ["--hand-fault", "link-cut at=2s for=2s"];
    let said = scripted(&folder, "out", &script, &cut);
    let session = &said["session"];
    let holds = session["holds"].as_array().unwrap();
    assert_eq!(holds.len(), 1, "{session:#}");
    let (held, resumed) = (number(&holds[0], "at_s"), number(&holds[0], "resumed_s"));
    // 50 ms of silence, one report, and the arm's clock began a little before the session.
    assert!((1.95..2.10).contains(&held), "{held}");
    assert!((5.2..5.25).contains(&resumed), "{resumed}");
    let why = holds[0]["why"].as_str().unwrap();
    assert!(why.contains("50 ms") && why.contains("holds"), "{why}");
    // While nobody was heard, going on was refused.
    let refused = session["refused"].as_array().unwrap();
    assert_eq!(refused.len(), 1);
    assert!(
        refused[0]
            .as_str()
            .unwrap()
            .starts_with("not resumed: master: ")
    );
    assert_eq!(session["ended"], "done");

    let made = records(&folder.path("out/recording.hmr"));
    within_limits(&made);
    let first = made
        .iter()
        .position(|record| record.state == State::Hold)
        .unwrap();
    let last = made
        .iter()
        .rposition(|record| record.state == State::Hold)
        .unwrap();
    assert!(
        made[first..=last]
            .iter()
            .all(|record| record.state == State::Hold)
    );
    // It went, it braked within what its acceleration takes (12 mm/s, 200 mm/s^2: 60 ms), and then it stood to the last bit, though the hand went on and came back.
    let rate = |index: usize| {
        f64::from(made[index].commanded[0] - made[index - 1].commanded[0]) / MM / 2e-4
    };
    assert!(rate(first) < -5.0, "{}", rate(first));
    let stood = first + (0.15 / 2e-4) as usize;
    let still = |record: &Record| record.commanded == made[stood].commanded;
    assert!(made[stood..=last].iter().all(still));
    let braked = f64::from(made[stood].commanded[0] - made[first].commanded[0]).abs() / MM;
    assert!(braked < 1.0, "{braked} mm");
    let held_s = (last - first) as f64 * 2e-4;
    assert!((3.0..3.3).contains(&held_s), "{held_s} s");
    // Afterwards the hand leads again, from where both are.
    assert_eq!(made[last + 1].state, State::Run);
    haptimill(&["replay", &folder.path("out/recording.hmr")]).ended_with(0);
    haptimill(&["replay", &folder.path("out/hand.hmr")]).ended_with(0);
}

#[test]
fn a_cut_that_is_broken_off_and_gone_on_with_gives_the_hand_no_bump() {
    let folder = Folder::new();
    let person = std::fs::read_to_string(scene::root().join("examples/teleop.toml")).unwrap();
    let orders = "
[[order]]
at_s = 5.0
what = \"gp=0.8\"
[[order]]
at_s = 5.5
what = \"hold\"
[[order]]
at_s = 5.8
what = \"resume\"
[[order]]
at_s = 8.0
what = \"resume\"
";
    let said = scripted(
        &folder,
        "out",
        &format!("{person}{orders}"),
        &[
            "--work",
            "examples/block.toml",
            "--spindle",
            "5000",
            "--hand-fault",
            "link-cut at=6.5s for=1s",
        ],
    );
    assert_eq!(said["session"]["holds"].as_array().unwrap().len(), 2);
    within_limits(&records(&folder.path("out/recording.hmr")));
    without_a_bump(&records(&folder.path("out/hand.hmr")));
}

#[test]
fn a_link_that_stalls_holds_the_machine_and_nothing_late_sets_it_going() {
    let folder = Folder::new();
    // Words come again after 0.4 s, all at once and late; nobody says that it may go on.
    let stall = [
        "--hand-fault",
        "link-delay ms=400 at=2s for=1s",
        "--for",
        "6",
    ];
    let said = ending(5, &folder, "out", AWAY, &stall);
    assert_eq!(said["session"]["ended"], "hand_lost");
    let because = said["session"]["because"].as_str().unwrap();
    assert!(because.contains("was not resumed"), "{because}");
    let holds = said["session"]["holds"].as_array().unwrap();
    assert_eq!(holds.len(), 1, "{said:#}");
    assert_eq!(holds[0]["resumed_s"], Value::Null);
    let made = records(&folder.path("out/recording.hmr"));
    within_limits(&made);
    let first = made
        .iter()
        .position(|record| record.state == State::Hold)
        .unwrap();
    let stood = first + (0.15 / 2e-4) as usize;
    assert!(
        made[stood..]
            .iter()
            .all(|record| record.commanded == made[stood].commanded)
    );
    assert_eq!(said["session"]["final_state"], "Idle");
}

#[test]
fn an_arm_that_fails_leads_nothing_until_it_was_looked_after() {
    let folder = Folder::new();
    let order = "\n[[order]]\nat_s = 3.0\nwhat = \"reset-hand\"\n";
    let trip = ["--hand-fault", "hand-amplifiers-tripped at=2s for=0.5s"];
    let said = scripted(
        &folder,
        "out",
        &format!("end_s = 5.0\n{AWAY}{order}"),
        &trip,
    );
    let notes = said["session"]["notes"].as_array().unwrap();
    assert!(
        notes
            .iter()
            .any(|note| note.as_str().unwrap().starts_with("the arm: ")),
        "{said:#}"
    );
    let made = records(&folder.path("out/recording.hmr"));
    within_limits(&made);
    let at = |time_s: f64| &made[(time_s / 2e-4) as usize];
    let x = |time_s: f64| f64::from(at(time_s).commanded[0]) / MM;
    // It follows, stands while the arm is off although the hand goes on, and follows again from there.
    assert!(
        x(1.9) < -10.0 && at(2.3).commanded == at(2.95).commanded,
        "{} {} {}",
        x(1.9),
        x(2.3),
        x(2.95)
    );
    assert!(x(4.0) < x(2.95) - 5.0, "{} {}", x(4.0), x(2.95));
    // The motors of the arm gave nothing in between.
    let hand = records(&folder.path("out/hand.hmr"));
    let off = hand
        .iter()
        .filter(|record| (11_000..14_000).contains(&record.period));
    assert!(
        off.clone().count() > 2000 && off.into_iter().all(|record| record.hand.force == [0; 3])
    );
}

#[test]
fn how_it_ended_is_in_the_exit_code() {
    let folder = Folder::new();
    // While it looks for its references, on the way home, and while the hand leads.
    for at in ["1s", "5s", "12s"] {
        let fault = format!("emergency-stop at={at}");
        let out = folder.path("out");
        let stopped = ["teleop", "--hand", "sim", "--out", &out, "--fault", &fault];
        let ran = haptimill(&stopped).ended_with(6);
        assert!(
            ran.err.contains("release it, then `haptimill reset`"),
            "{at}: {}",
            ran.err
        );
    }
    let trip = [
        "--hand-fault",
        "hand-amplifiers-tripped at=2s for=0.5s",
        "--for",
        "4",
    ];
    let said = ending(6, &folder, "out", AWAY, &trip);
    assert_eq!(said["session"]["ended"], "haptic_fault");
    let because = said["session"]["because"].as_str().unwrap();
    assert!(because.contains("`reset-hand`"), "{because}");
    let cut = ["--hand-fault", "link-cut at=2s", "--for", "5"];
    let said = ending(5, &folder, "out", AWAY, &cut);
    assert_eq!(said["session"]["ended"], "hand_lost");
}

#[test]
fn a_hand_that_is_always_too_late_is_not_passed_over() {
    let folder = Folder::new();
    let out = folder.path("none");
    let late = ["teleop", "--hand", "sim", "--out", &out, "--delay"];
    for (more, remedy) in [
        (&["60"][..], "give --stale 140, or a shorter --delay"),
        (&["120", "--stale", "100"], "give --stale 260,"),
        (&["1000", "--stale", "1000"], "give a shorter --delay"),
    ] {
        let ran = haptimill(&[&late, more].concat()).ended_with(2);
        assert!(
            ran.err.contains("--stale") && ran.err.contains(remedy),
            "{}",
            ran.err
        );
        assert!(!Path::new(&out).exists());
    }
    // A line that is late by itself.
    let slow = ["--hand-fault", "link-delay ms=60 at=0s"];
    let said = scripted(&folder, "out", AWAY, &slow);
    let notes = said["session"]["notes"].as_array().unwrap();
    let told = |note: &&Value| note.as_str().unwrap().contains("were too late");
    let note = notes.iter().find(told).unwrap().as_str().unwrap();
    assert!(
        note.contains("the tool was not moved") && note.contains("--stale"),
        "{note}"
    );
}

#[test]
fn orders_are_carried_out_and_what_makes_no_sense_is_refused_before_anything_moves() {
    let folder = Folder::new();
    let orders = "
[[order]]
at_s = 1.5
what = \"hold\"
[[order]]
at_s = 2.5
what = \"resume\"
[[order]]
at_s = 3.0
what = \"gp=0.25\"
[[order]]
at_s = 3.5
what = \"end\"
";
    let said = scripted(&folder, "out", &format!("{AWAY}{orders}"), &[]);
    let holds = said["session"]["holds"].as_array().unwrap();
    assert_eq!(holds.len(), 1);
    assert_eq!(holds[0]["why"], "it was ordered");
    assert!((3.5..3.8).contains(&number(&said["session"], "duration_s")));
    within_limits(&records(&folder.path("out/recording.hmr")));

    let out = folder.path("none");
    let refused = |arguments: &[&str], code: i32, why: &str| {
        let ran = haptimill(&[&["teleop", "--out", &out], arguments].concat()).ended_with(code);
        assert!(ran.err.contains(why), "{arguments:?}: {}", ran.err);
        assert!(!Path::new(&out).exists(), "{arguments:?}");
    };
    let script = folder.file("gp.toml", "[[order]]\nat_s = 1.0\nwhat = \"gp=3\"\n");
    let script = format!("script:{script}");
    refused(
        &["--hand", "sim", "--gp", "2.5"],
        2,
        "G_P of 2.5 is out of its range: 0.1 to 2",
    );
    refused(
        &["--hand", &script],
        3,
        "gp.toml:3:8: order[1].what: G_P of 3 is out of its range: 0.1 to 2",
    );
    refused(
        &["--hand", "keyboard"],
        2,
        "needs a terminal on standard input",
    );
    refused(
        &["--hand", "joystick:/dev/none"],
        5,
        "/dev/none: no game controller there",
    );
    refused(
        &["--hand", "mouse3d:/dev/none"],
        5,
        "/dev/none: no 3D mouse there",
    );
    refused(
        &["--hand", "sim", "--axes", "x,w"],
        2,
        "there is no axis 'w'; this machine has x, y, z, theta, alpha",
    );
    let master = ["--machine", "machines/hand-master.toml"];
    refused(
        &[&["--hand", "sim"], &master[..]].concat(),
        3,
        "a haptic arm alone",
    );
    refused(
        &["--hand", "sim", "--hand-machine", "machines/h4.toml"],
        3,
        "write role = \"master\"",
    );
    refused(
        &["--hand", "keyboard", "--delay", "5"],
        2,
        "--delay and --hand-fault are for the simulated arm",
    );
    // A machine with an arm of its own is led by that one.
    let own = folder.machine_with(haptimill_machine_file::HAND);
    refused(&["--hand", "sim", "--machine", &own], 3, "on its own board");
    // A haptic arm runs no programs.
    let ran = haptimill(&[&["run", "examples/e7-slot.ngc", "--check"], &master[..]].concat());
    assert_eq!(ran.code, 3, "{}", ran.err);
}
