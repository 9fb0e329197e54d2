//! Lost, stalled and delayed links, failures of the arm, and the exit codes of a session.

use super::{
    AWAY, MM, expect_no_force_step, expect_within_limits, read_records, run_script,
    run_script_to_code,
};
use crate::scene::{self, TestFolder, haptimill, number};
use haptimill_protocol::message::State;
use haptimill_trace::Record;
use serde_json::Value;
use std::path::Path;

#[test]
fn lost_link_holds_the_machine_until_resume() {
    let folder = TestFolder::new();
    let commands = "
[[command]]
at_s = 3.0
what = \"resume\"
[[command]]
at_s = 5.2
what = \"resume\"
";
    let script = format!("end_s = 7.0\n{AWAY}{commands}");
    let cut = ["--master-fault", "link-cut at=2s for=2s"];
    let said = run_script(&folder, "out", &script, &cut);
    let session = &said["session"];
    let holds = session["holds"].as_array().unwrap();
    assert_eq!(holds.len(), 1, "{session:#}");
    let (held, resumed) = (number(&holds[0], "at_s"), number(&holds[0], "resumed_s"));
    // 50 ms without samples, one report interval, and the arm's clock starts shortly before the
    // session.
    assert!((1.95..2.10).contains(&held), "{held}");
    assert!((5.2..5.25).contains(&resumed), "{resumed}");
    let why = holds[0]["why"].as_str().unwrap();
    assert!(why.contains("50 ms") && why.contains("holds"), "{why}");
    // Resume was refused while no samples arrived.
    let refused = session["refused"].as_array().unwrap();
    assert_eq!(refused.len(), 1);
    assert!(
        refused[0]
            .as_str()
            .unwrap()
            .starts_with("not resumed: master: ")
    );
    assert_eq!(session["ended"], "done");

    let made = read_records(&folder.path("out/recording.hmr"));
    expect_within_limits(&made);
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
    // The tool moved, decelerated within its acceleration (12 mm/s, 200 mm/s^2: 60 ms), and then
    // stood exactly still, although the master moved on and returned.
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
    // Afterwards the tool follows the master again, from the present poses of both.
    assert_eq!(made[last + 1].state, State::Run);
    haptimill(&["replay", &folder.path("out/recording.hmr")]).expect_code(0);
    haptimill(&["replay", &folder.path("out/master.hmr")]).expect_code(0);
}

#[test]
fn interrupted_cut_resumes_without_a_force_step() {
    let folder = TestFolder::new();
    let script = std::fs::read_to_string(scene::root().join("examples/teleop.toml")).unwrap();
    let commands = "
[[command]]
at_s = 5.0
what = \"gp=0.8\"
[[command]]
at_s = 5.5
what = \"hold\"
[[command]]
at_s = 5.8
what = \"resume\"
[[command]]
at_s = 8.0
what = \"resume\"
";
    let said = run_script(
        &folder,
        "out",
        &format!("{script}{commands}"),
        &[
            "--stock",
            "examples/block.toml",
            "--spindle",
            "5000",
            "--master-fault",
            "link-cut at=6.5s for=1s",
        ],
    );
    assert_eq!(said["session"]["holds"].as_array().unwrap().len(), 2);
    expect_within_limits(&read_records(&folder.path("out/recording.hmr")));
    expect_no_force_step(&read_records(&folder.path("out/master.hmr")));
}

#[test]
fn stalled_link_holds_the_machine_and_late_samples_are_ignored() {
    let folder = TestFolder::new();
    // Samples arrive again after 0.4 s, all at once and late; there is no resume.
    let stall = [
        "--master-fault",
        "link-delay ms=400 at=2s for=1s",
        "--for",
        "6",
    ];
    let said = run_script_to_code(5, &folder, "out", AWAY, &stall);
    assert_eq!(said["session"]["ended"], "master_lost");
    let because = said["session"]["because"].as_str().unwrap();
    assert!(because.contains("was not resumed"), "{because}");
    let holds = said["session"]["holds"].as_array().unwrap();
    assert_eq!(holds.len(), 1, "{said:#}");
    assert_eq!(holds[0]["resumed_s"], Value::Null);
    let made = read_records(&folder.path("out/recording.hmr"));
    expect_within_limits(&made);
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
fn failed_arm_is_disengaged_until_reset() {
    let folder = TestFolder::new();
    let command = "\n[[command]]\nat_s = 3.0\nwhat = \"reset-master\"\n";
    let trip = ["--master-fault", "haptic-amplifiers-tripped at=2s for=0.5s"];
    let said = run_script(
        &folder,
        "out",
        &format!("end_s = 5.0\n{AWAY}{command}"),
        &trip,
    );
    let notes = said["session"]["notes"].as_array().unwrap();
    assert!(
        notes
            .iter()
            .any(|note| note.as_str().unwrap().starts_with("the arm: ")),
        "{said:#}"
    );
    let made = read_records(&folder.path("out/recording.hmr"));
    expect_within_limits(&made);
    let at = |time_s: f64| &made[(time_s / 2e-4) as usize];
    let x = |time_s: f64| f64::from(at(time_s).commanded[0]) / MM;
    // The tool follows, stands while the arm is off although the master moves, and follows again
    // from there.
    assert!(
        x(1.9) < -10.0 && at(2.3).commanded == at(2.95).commanded,
        "{} {} {}",
        x(1.9),
        x(2.3),
        x(2.95)
    );
    assert!(x(4.0) < x(2.95) - 5.0, "{} {}", x(4.0), x(2.95));
    // The motors of the arm had no torque in between.
    let master = read_records(&folder.path("out/master.hmr"));
    let off = master
        .iter()
        .filter(|record| (11_000..14_000).contains(&record.period));
    assert!(
        off.clone().count() > 2000 && off.into_iter().all(|record| record.haptic.force == [0; 3])
    );
}

#[test]
fn exit_code_is_the_end_of_the_session() {
    let folder = TestFolder::new();
    // During homing, on the way to the home pose, and during teleoperation.
    for at in ["1s", "5s", "12s"] {
        let fault = format!("emergency-stop at={at}");
        let out = folder.path("out");
        let stopped = [
            "teleop", "--master", "sim", "--out", &out, "--fault", &fault,
        ];
        let ran = haptimill(&stopped).expect_code(6);
        assert!(
            ran.err.contains("release it, then `haptimill reset`"),
            "{at}: {}",
            ran.err
        );
    }
    let trip = [
        "--master-fault",
        "haptic-amplifiers-tripped at=2s for=0.5s",
        "--for",
        "4",
    ];
    let said = run_script_to_code(6, &folder, "out", AWAY, &trip);
    assert_eq!(said["session"]["ended"], "haptic_fault");
    let because = said["session"]["because"].as_str().unwrap();
    assert!(because.contains("`reset-master`"), "{because}");
    let cut = ["--master-fault", "link-cut at=2s", "--for", "5"];
    let said = run_script_to_code(5, &folder, "out", AWAY, &cut);
    assert_eq!(said["session"]["ended"], "master_lost");
}

#[test]
fn excessive_master_delay_is_refused_or_reported() {
    let folder = TestFolder::new();
    let out = folder.path("none");
    let late = ["teleop", "--master", "sim", "--out", &out, "--delay"];
    for (more, remedy) in [
        (&["60"][..], "give --stale 140, or a shorter --delay"),
        (&["120", "--stale", "100"], "give --stale 260,"),
        (&["1000", "--stale", "1000"], "give a shorter --delay"),
    ] {
        let ran = haptimill(&[&late, more].concat()).expect_code(2);
        assert!(
            ran.err.contains("--stale") && ran.err.contains(remedy),
            "{}",
            ran.err
        );
        assert!(!Path::new(&out).exists());
    }
    // A link with an injected delay.
    let slow = ["--master-fault", "link-delay ms=60 at=0s"];
    let said = run_script(&folder, "out", AWAY, &slow);
    let notes = said["session"]["notes"].as_array().unwrap();
    let reported = |note: &&Value| note.as_str().unwrap().contains("were too late");
    let note = notes.iter().find(reported).unwrap().as_str().unwrap();
    assert!(
        note.contains("the tool was not moved") && note.contains("--stale"),
        "{note}"
    );
}
