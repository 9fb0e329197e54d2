//! `haptimill identify` on machines with step motors, with a dial gauge and with index pulses, and
//! `haptimill tune`.

use crate::scene;
use haptimill_machine_file::MachineFile;
use serde_json::json;

use scene::{TestFolder, haptimill};

fn machine_text(name: &str) -> String {
    std::fs::read_to_string(scene::root().join("machines").join(name)).unwrap()
}

/// mill3 with quick homing; the motor of x is weak.
fn weak_mill() -> String {
    let text = machine_text("mill3.toml")
        .replace("touch_rate_mm_s = 1.0 ", "touch_rate_mm_s = 4.0 ")
        .replace("back_off_mm = 3.0 ", "back_off_mm = 1.0 ")
        .replace("home_order = 2 ", "home_order = 1 ");
    // Home poses near the switches; the weak motor is that of x.
    ["preset_mm = ", "preset = "]
        .iter()
        .fold(text, |text, key| {
            let near = |text: String, place: &str| {
                text.replacen(&format!("\n{key}0.0"), &format!("\n{key}{place}"), 1)
            };
            near(near(text, "-90.0"), "-50.0")
        })
        .replacen("pull_out = 1200.0", "pull_out = 150.0", 1)
}

/// The plant cannot turn faster than (150 - 40) N / 2 N s/mm = 55 mm/s. The acceleration at the end
/// of the ramp takes up to 12 N of it, which are 6 mm/s.
#[test]
fn limits_of_a_weak_motor_are_shown_and_written() {
    let folder = TestFolder::new();
    let text = weak_mill();
    let file = folder.file("mine.toml", &text);
    let out = folder.path("out");
    let identify = [
        "identify",
        "--machine",
        &file,
        "--yes",
        "--joint",
        "x",
        "--out",
        &out,
    ];
    let ran = haptimill(&[&identify[..], &["--json"]].concat()).expect_code(0);
    let shown = ran.json();
    let x = &shown["step_joints"][0];
    assert_eq!(x["name"], "x");
    let kept = x["rate"]["without_loss"].as_f64().unwrap();
    let lost = x["rate"]["with_loss"].as_f64().unwrap();
    assert!(kept < 55.0 && lost > 49.0 && lost / kept < 1.03, "{x}");
    // 70 % of 71.4 mm/s and 1,429 mm/s^2 would be the values of the file.
    let rate = x["proposed_rate"].as_f64().unwrap();
    assert!((0.69..0.71).contains(&(rate / kept)), "{x}");
    let max = x["acceleration"]["no_loss_up_to"].as_f64().unwrap();
    assert!((1428.5..1428.6).contains(&max), "{x}");
    assert_eq!(x["proposed_acceleration"], json!(null));
    let others = [json!("--joint names others"), json!("--joint names others")];
    let reasons = shown["not_measured"].as_array().unwrap();
    let reasons: Vec<_> = reasons.iter().map(|it| it["reason"].clone()).collect();
    assert_eq!(reasons, others);

    // The machine file has the rate, with its date, and the comments it had.
    let written = std::fs::read_to_string(&file).unwrap();
    let machine = MachineFile::parse(&file, &written).unwrap();
    assert_eq!(machine.joints[0].rate, rate);
    assert_eq!(machine.pose[0].rate, rate);
    assert_eq!(machine.joints[0].acceleration, 1000.0);
    assert_eq!(machine.joints[1].rate, 50.0);
    assert_eq!(written.matches("# identified 20").count(), 2, "{written}");
    for line in text.lines().filter(|line| line.starts_with('#')) {
        assert!(written.contains(line), "{line}");
    }
    let before = shown["before"].as_str().unwrap();
    assert_eq!(std::fs::read_to_string(before).unwrap(), text);
    let page = std::fs::read_to_string(folder.path("out/identify.html")).unwrap();
    for part in [
        "Joint x",
        "Tests for lost steps",
        "Not measured",
        "y: --joint",
    ] {
        assert!(page.contains(part), "{part}");
    }
    let data = std::fs::read_to_string(folder.path("out/identified.toml")).unwrap();
    assert!(data.contains("[[step_joint]]\nname = \"x\"\n"), "{data}");
}

/// No motion of the test reaches the pull-out of the shipped motor: the file stays.
#[test]
fn without_loss_there_is_a_bound_and_no_number() {
    let folder = TestFolder::new();
    let text = weak_mill();
    let file = folder.file("mine.toml", &text);
    let out = folder.path("out");
    let identify = [
        "identify",
        "--machine",
        &file,
        "--yes",
        "--joint",
        "y",
        "--out",
        &out,
    ];
    let ran = haptimill(&identify).expect_code(0);
    let line = "y: rate at 300 mm/s^2: no loss up to 71.4 mm/s; acceleration at 50.0 mm/s: no loss \
                up to 1428.6 mm/s^2; nothing to propose\n";
    assert!(ran.out.contains(line), "{}", ran.out);
    assert!(
        ran.out
            .contains("at 1.8 to 71.4 mm/s and 300 to 1429 mm/s^2 until")
    );
    assert!(
        ran.out.contains("the machine file is not changed"),
        "{}",
        ran.out
    );
    assert_eq!(std::fs::read_to_string(&file).unwrap(), text);
}

/// A joint that is not measured has a reason.
#[test]
fn joints_that_are_not_measured_are_named() {
    let folder = TestFolder::new();
    let out = folder.path("out");
    let run = |machine: &str, joint: &[&str]| {
        let file = folder.file(machine, machine_text(machine));
        haptimill(
            &[
                &["identify", "--machine", &file, "--yes", "--out", &out],
                joint,
            ]
            .concat(),
        )
    };
    let encoder = "its step drive has an encoder, which shows lost steps in operation";
    let ran = run("h4-step.toml", &["--joint", "l1", "--joint", "l4"]).expect_code(3);
    for joint in ["l1", "l4"] {
        let line = format!("joint {joint}: {encoder}\n");
        assert!(ran.err.contains(&line), "{ran:?}");
    }
    let ran = run("router3.toml", &["--joint", "y2"]).expect_code(3);
    assert!(ran.err.contains("y2: it is a motor of a gantry"), "{ran:?}");
    let ran = run("router3.toml", &["--joint", "y2", "--lost-motion"]).expect_code(3);
    let line = "joint y2: it is the second motor of a gantry; measure the first one\n";
    assert!(
        ran.err.contains(line) && !ran.err.contains("y2: joint"),
        "{ran:?}"
    );
    let ran = run("mill3.toml", &["--joint", "w"]).expect_code(2);
    assert!(
        ran.err.contains("--joint w: the joints are x, y, z"),
        "{ran:?}"
    );
    // The table of the H-4 arm is measured, and its slides are named.
    let ran = run("h4-step.toml", &["--json", "--travel", "30"]).expect_code(0);
    let shown = ran.json();
    assert_eq!(shown["joints"][0]["name"], "alpha");
    let expected = ["l1", "l2", "l3", "l4"].map(|name| json!({ "name": name, "reason": encoder }));
    assert_eq!(shown["not_measured"], json!(expected));
    assert!(
        ran.err
            .contains(&format!("not measured: joint l2: {encoder}"))
    );
}

/// The gauge of the simulated machine sees the slide of the plant: backlash of 0.010 mm, and the
/// wind-up of 0.0158 mm by its friction in both directions.
#[test]
fn lost_motion_is_written_as_backlash() {
    let folder = TestFolder::new();
    let out = folder.path("out");
    let text = machine_text("h4.toml").replace("backlash_mm = 0.0258", "backlash_mm = 0.010");
    let file = folder.file("mine.toml", &text);
    let identify = [
        "identify",
        "--lost-motion",
        "--machine",
        &file,
        "--yes",
        "--joint",
        "l2",
        "--out",
        &out,
    ];
    let shown = haptimill(&[&identify[..], &["--json"]].concat()).expect_code(0);
    let shown = shown.json();
    let found = shown["lost_motions"][0]["lost_motion"].as_f64().unwrap();
    assert!((found - 0.0258).abs() < 0.001_29, "{shown}");
    let written = std::fs::read_to_string(&file).unwrap();
    assert_eq!(written.matches("# identified 20").count(), 1, "{written}");
    assert_eq!(written.matches("backlash_mm = 0.010").count(), 3);

    // Readings of a gauge by hand: 0.02 mm beyond the backlash of the file.
    let readings = ["--reading", "-0.01", "--reading", "0.01"].repeat(5);
    let one = [&identify[..], &readings[..2]].concat();
    let ran = haptimill(&one).expect_code(2);
    assert!(ran.err.contains("1 readings, and 10 are needed"), "{ran:?}");
    let file = folder.file("mine.toml", &text);
    let ran = haptimill(&[&identify[..], &readings].concat()).expect_code(0);
    let line = ran
        .out
        .lines()
        .find(|line| line.starts_with("l2: lost motion "));
    let value = line.and_then(|line| line.split(' ').nth(3)?.parse::<f64>().ok());
    // The motor may rest one count of 1.25 um off.
    assert!(
        value.is_some_and(|value| (value - 0.03).abs() < 0.001_3),
        "{ran:?}"
    );
    assert_ne!(std::fs::read_to_string(&file).unwrap(), text);
}

/// The index pulse of l1 is 0.7 mm off its place in the machine file.
#[test]
fn index_pulses_are_written_with_their_slack() {
    let folder = TestFolder::new();
    let out = folder.path("out");
    let text = machine_text("h4.toml")
        .replace("index_mm = 1136.2 ", "index_mm = 1135.5 ")
        .replace("start_spread = 0.3", "start_spread = 0.0");
    let file = folder.file("mine.toml", &text);
    let identify = [
        "identify",
        "--index",
        "--machine",
        &file,
        "--yes",
        "--joint",
        "l1",
        "--out",
        &out,
    ];
    let ran = haptimill(&[&identify[..], &["--json"]].concat()).expect_code(0);
    assert!(ran.err.contains("joint l1: x -"), "{ran:?}");
    let shown = ran.json();
    let l1 = &shown["index_pulses"][0];
    let found = l1["index"].as_f64().unwrap();
    assert!((found - 1136.2).abs() < 0.001_3, "{shown}");
    for passes in ["upwards", "downwards"] {
        assert_eq!(l1[passes].as_array().unwrap().len(), 5, "{l1}");
    }
    assert_eq!(l1["slack_counts"], json!(1));
    assert_eq!(shown["changes"].as_array().unwrap().len(), 2, "{shown}");
    let written = std::fs::read_to_string(&file).unwrap();
    assert!(written.contains("index_slack_counts = 1  # identified 20"));
    assert_eq!(written.matches("; identified 20").count(), 1, "{written}");
    let page = std::fs::read_to_string(folder.path("out/index.html")).unwrap();
    for part in ["Joint l1", "Passes over the index pulse", "instrument"] {
        assert!(page.contains(part), "{part}");
    }
    let data = std::fs::read_to_string(folder.path("out/index.toml")).unwrap();
    assert!(data.contains("from_presets = true"), "{data}");
}

/// A machine without index pulses names its joints.
#[test]
fn joints_without_index_pulses_are_named() {
    let folder = TestFolder::new();
    let out = folder.path("out");
    let run = |machine: &str, options: &[&str]| {
        let file = folder.file(machine, machine_text(machine));
        let identify = [
            "identify",
            "--index",
            "--machine",
            &file,
            "--yes",
            "--out",
            &out,
        ];
        haptimill(&[&identify[..], options].concat())
    };
    let ran = run("mill3.toml", &[]).expect_code(3);
    let line = "joint y: it has no encoder with an index pulse\n";
    assert!(ran.err.contains(line), "{ran:?}");
    let ran = run("h4.toml", &["--travel", "20", "--joint", "l1"]).expect_code(3);
    assert!(ran.err.contains("joint l1: its searches move"), "{ran:?}");
}

/// The table of the shipped H-4 arm, which is the fastest to identify, and its gains.
#[test]
fn tune_shows_margins_and_steps_before_and_after() {
    let folder = TestFolder::new();
    let out = folder.path("out");
    let file = folder.file("mine.toml", machine_text("h4.toml"));
    let tune = ["tune", "--machine", &file, "--out", &out];
    let ran = haptimill(&tune).expect_code(3);
    assert!(
        ran.err.contains("run `haptimill identify` first"),
        "{ran:?}"
    );
    let identify = [
        "identify",
        "--machine",
        &file,
        "--yes",
        "--no-write",
        "--joint",
        "alpha",
        "--out",
        &out,
    ];
    haptimill(&identify).expect_code(0);
    let ran = haptimill(&tune).expect_code(0);
    println!("{}", ran.out);
    let page = std::fs::read_to_string(folder.path("out/tune.html")).unwrap();
    // The phase margin of the shipped table is 33 degrees.
    let misses = "the gains of the machine file miss: phase margin ";
    for text in [&ran.out, &page] {
        assert_eq!(text.matches(" ms: gain margin ").count(), 2, "{text}");
        assert_eq!(text.matches("), phase margin ").count(), 2, "{text}");
        assert!(text.contains(misses), "{text}");
    }
    let parts = [
        "<h2>Joint alpha</h2>",
        "before: kp ",
        "after: kp ",
        "Step of the setpoint of 1 deg",
        "Step of a load of ",
    ];
    for part in parts {
        assert_eq!(page.matches(part).count(), 1, "{part}");
    }
    // Both steps have a curve before and one after.
    assert!(page.matches("<svg").count() >= 3);
    assert!(page.matches(">before<").count() >= 3 && page.matches(">after<").count() >= 3);
    assert_eq!(
        std::fs::read_to_string(&file).unwrap(),
        machine_text("h4.toml")
    );

    // The proposed gains keep what tune requires, also when they are read from the machine file.
    haptimill(&[&tune[..], &["--write"]].concat()).expect_code(0);
    let ran = haptimill(&tune).expect_code(0);
    let keeps = "the gains of the machine file keep all requirements";
    assert!(ran.out.contains(keeps), "{}", ran.out);
    let tight = [&tune[..], &["--phase-margin", "70"]].concat();
    let ran = haptimill(&tight).expect_code(0);
    assert!(ran.out.contains(misses), "{}", ran.out);
}
