//! Mistakes in machine files: every message with its line.

use super::{STEP, broken, problems};
use crate::*;

#[test]
fn every_problem_names_its_line() {
    let l1_head = "[[joint]]\nname = \"l1\"";
    let mistakes = [
        (
            "name = \"h4\"",
            "name = \"a name that is longer than it may be\"",
        ),
        ("name = \"h4\"", "name = \"\""),
        ("name = \"h4\"", "name = 4"),
        ("period_us = 200", "period_us = 20"),
        ("period_us = 200", "period_us = 200.5"),
        ("period_us = 200", ""),
        ("period_us = 200", "period_us = 200\nperiod_us = 100"),
        ("period_us = 200", "period_us = "),
        ("[kinematics]", "[kinematik]"),
        ("[homing]", "[homing"),
        ("model = \"h4\"", "model = \"spider\""),
        ("a = 400.0", "a = 140.0"),
        ("a = 400.0", "a = nan"),
        ("a = 400.0", "a = -inf"),
        ("a = 400.0", "a = \"400\""),
        ("c = 100.0 ", "c = 0 "),
        ("r = 480.0", "r = 240.0"),
        ("d = 100.0", "d = 600.0"),
        ("tl = 150.0", "tool = 150.0"),
        ("x_off = 780.0", "x_off = 1990.0"),
        ("branch = \"below\"", "branch = \"under\""),
        ("low_mm = -200.0", "low_mm = 200.0"),
        ("low_mm = -200.0", "low_mm = -20000.0"),
        ("low_mm = -200.0", "low_deg = -200.0"),
        ("low_deg = -40.0", "low_deg = -50.0"),
        ("name = \"y\"", "name = \"x\""),
        ("name = \"y\"", "name = \"why\""),
        (
            "name = \"theta\"  # tilt of the tool about y\nkind = \"rotary\"",
            "name = \"theta\"\nkind = \"linear\"",
        ),
        (
            l1_head,
            "[[joint]]\nname = \"l0\"\nkind = \"linear\"\n[[joint]]\nname = \"l1\"",
        ),
        (l1_head, "[[join]]\nname = \"l1\""),
        ("rate_mm_s = 100.0", "rate_mm_s = 0.0"),
        ("rate_mm_s = 100.0", "rate_mm_s = 1e400"),
        ("counts_per_turn = 8000", "counts_per_turn = 8000.25"),
        (
            "counts_per_turn = 8000",
            "counts_per_turn = 99999999999999999999",
        ),
        ("counts_per_turn = 8000", "counts_per_turn = true"),
        ("direction = 1\n", "direction = 0.5\n"),
        ("backlash_mm = 0.0258", "backlash_mm = -0.0258"),
        ("backlash_mm = 0.0258", "backlash = 0.0258"),
        ("backlash_mm = 0.0258", "backlash_table_mm = 0.0258"),
        ("backlash_mm = 0.0258", "backlash_table_mm = [0.0258]"),
        ("backlash_mm = 0.0258", "backlash_table_mm = [0.01, -0.01]"),
        ("backlash_mm = 0.0258", "backlash_table_mm = [0.0, 5.0]"),
        (
            "backlash_mm = 0.0258",
            "backlash_mm = 0.0258\nbacklash_table_mm = [0.01, 0.02]",
        ),
        ("encoder_stuck_mm = 0.2 ", "encoder_stuck_mm = 0.001 "),
        ("preset_mm = 1135.0", "preset_mm = 1400.0"),
        ("index_mm = 1136.2", "index_mm = 1142.2"),
        ("search_mm = 4.5", "search_mm = 9.5"),
        ("kind = \"torque\"", "kind = \"hydraulic\""),
        ("limit_n = 750.0", "limit_n = 900.0"),
        ("limit_n = 750.0", "limit_n = 100.0"),
        ("full_scale_n = 800.0", "full_scale_n = 0"),
        ("form = \"model\"", "form = \"pid\""),
        ("kp = 40000.0", "kp = 4000000.0"),
        ("kd = 400.0\nki = 1000000.0", "kd = 40.0\nki = 2000000.0"),
        ("kd = 400.0", "kd = 9000.0"),
        ("inertia_kg = 40.0", "inertia_kg = 40.0\nmass_kg = 40.0"),
        ("ramp_ms = 80", "ramp_ms = 200"),
        ("time_ms = 300\nramp_ms = 80", "time_ms = 120\nramp_ms = 58"),
        ("missed_periods = 3", "missed_periods = 51"),
        ("heartbeat_ms = 500", "heartbeat_ms = 0x1FFFFF"),
        ("[planner]", "[planner]\ncolour = 1979-05-27"),
        ("kind = \"linear\"", "kind = [\"linear\"]"),
        ("h = 600.0", "h = 800.0"),
        ("branch = \"below\"", "branch = \"above\""),
        ("w = 50.0", "w = -200.0"),
        ("substep_us = 20", "substep_us = 30"),
        ("substep_us = 20", "substep_us = 20\nwind = 3"),
        ("motor_share = 0.5", "motor_share = 0.0"),
        ("mode_hz = 80.0", "mode_hz = \"80\""),
        ("index = 1136.2 }", "index = 11360.2 }"),
        (
            "[[plant.joint]]\nname = \"l1\"",
            "[[plant.joint]]\nname = \"slide\"",
        ),
        ("material = { tangential = 88.0", "material = { tang = 88.0"),
        (
            "material = { tangential = 88.0, radial = 22.6, axial = 0.93, tangential_edge = 0.298, \
             radial_edge = 1.49, axial_edge = 0.0 }",
            "material = \"wood\"",
        ),
        (", tangential_edge = 0.298", ""),
        ("force_scale = 1.0", "force_scale = -1.0"),
        ("relief_mm = 0.15", "releif_mm = 0.15"),
        ("time_constant_s = 0.001", "time_constant_s = 2"),
        ("high_pass_s = 1000.0", "high_pass_s = 0.0"),
        (
            "[plant.structure]",
            "[plant.workpiece]\ntop_mm = 1e9\n[plant.structure]",
        ),
        ("[planner]", "[[planner]]"),
        ("under_control = []", "under_control = [\"x\", \"alpha\"]"),
        ("under_control = []", "under_control = [\"z\", \"z\", 3]"),
        ("under_control = []", "under_control = \"x\""),
        ("slowest_rpm = 4000", "slowest_rpm = 100"),
        ("drive_lag_ms = 5.0", "drive_lag_ms = -1"),
        ("[force.sensor]", "[force.sensors]"),
        ("converter_v = 10.0", "converter_v = 1e9"),
        ("converter_v = 10.0", "converter_v = 100.0\nvolts = 3"),
        ("saturation_part = 0.95", "saturation_part = 95"),
        ("stuck_ms = 100.0", "stuck_ms = \"never\""),
        ("tare_ms = 200.0", "tare_ms = 1e-3"),
        ("limit_n = 80.0", "limit_n = 0"),
        ("newtons_per_volt = 10.0", "newtons_per_volt = 1000.0"),
        ("sign = -1 ", "sign = 0 "),
        ("setpoint_n = 5.0", "setpoint_n = 0.0"),
        ("setpoint_n = 5.0", "setpoint_n = -5.0"),
        ("setpoint_n = 5.0", "setpoint_n = 90.0"),
        ("setpoint_n = 5.0", "setpoint_n = inf"),
        ("mass_n_s2_per_mm = 1.0", "mass_n_s2_per_mm = 0.001"),
        ("damping_n_s_per_mm = 5.0", "damping_n_s_per_mm = 0.2"),
        ("limit_mm = 10.0", "limit_mm = 0.0"),
        ("rate_mm_s = 20.0", "rate_mm_s = 0.0"),
        (
            "enable_condition = \"against_motion\"",
            "enable_condition = \"open\"",
        ),
        (
            "[[force.axis]]\nname = \"x\"",
            "[[force.axis]]\nname = \"w\"",
        ),
        ("[[force.axis]]\nname = \"x\"", "[[force.ax]]\nname = \"x\""),
    ];
    let reported: Vec<String> = mistakes.iter().map(|(f, t)| broken(f, t)).collect();
    for text in &reported {
        assert!(!text.contains("no problem"), "{text}");
    }
    // A new model changes its own files only.
    let models = haptimill_kinematics::DESCRIPTORS.iter();
    let models: Vec<String> = models.map(|model| format!("{:?}", model.code)).collect();
    let reported = reported.join("\n");
    let reported = reported.replace(&models.join(" or "), "MODELS");
    insta::assert_snapshot!("mistakes", reported);
}

#[test]
fn problems_of_step_drives_are_named() {
    let mistakes = [
        ("steps_per_turn = 3200", "steps_per_turn = 0"),
        ("ticks_per_us = 84 ", "ticks_per_us = 840000 "),
        ("pulse_us = 2.5", "pulse_us = 900.0"),
        ("pulse_us = 2.5", "pulse_us = 250.0"),
        ("lost_mm = 0.05", "lost_mm = 0.001"),
        ("lost_mm = 0.05", "limit_n = 750.0"),
    ];
    let reported: Vec<String> = mistakes
        .iter()
        .map(|(from, to)| {
            format!(
                "## {from} -> {to}\n{}",
                problems(&STEP.replacen(from, to, 1))
            )
        })
        .collect();
    insta::assert_snapshot!("step_mistakes", reported.join("\n"));
}

/// The controller limits the filter to 50 ms, the file to 60 ms.
#[test]
fn problems_of_the_controller_name_joints_as_joints() {
    let (before, after) = BUILT_IN.split_once("name = \"l2\"").unwrap();
    let after = after
        .replacen("kp = 40000.0", "kp = 100.0", 1)
        .replacen("kd = 400.0\nki = 1000000.0", "kd = 10.0\nki = 1.0", 1)
        .replacen("rate_filter_ms = 1.5", "rate_filter_ms = 55.0", 1);
    let text = format!("{before}name = \"l2\"{after}");
    assert_eq!(
        problems(&text),
        "broken.toml:134:1: joint[2]: the controller would refuse this: \
         filter of the position loop of l2; \
         see docs/machine-files.md for the limits of the controller\n"
    );
}

/// A stroke or soft limit beyond the controller's range is refused at its key, with what to do
/// about a longer joint.
#[test]
fn a_stroke_that_is_too_long_is_refused_with_its_bound_and_remedy() {
    const MILL: &str = include_str!("../../../../machines/mill4.toml");
    let joint = |name: &str| MILL.find(&format!("[[joint]]\nname = \"{name}\"")).unwrap();
    let refused = |section: usize, key: &str, value: &str| {
        let start = section + MILL[section..].find(key).unwrap();
        let end = start + MILL[start..].find('\n').unwrap();
        let text = format!("{}{key} = {value}{}", &MILL[..start], &MILL[end..]);
        let line = MILL[..start].matches('\n').count() + 1;
        let column = key.len() + 4;
        (problems(&text), format!("broken.toml:{line}:{column}: "))
    };
    let middle = "put the zero of the joint into the middle of its stroke";
    for (index, key, value, bound, remedy) in [
        (1, "low_mm", "-1900.1", "-1900 to 1900 mm", middle),
        (2, "high_mm", "2047", "-1900 to 1900 mm", middle),
        (4, "high_deg", "170001", "-170000 to 170000 deg", middle),
    ] {
        let section = joint(["x", "y", "z", "a"][index - 1]);
        let (text, place) = refused(section, key, value);
        let expected =
            format!("{place}joint[{index}].{key}: {value} is out of range, allowed is {bound}; ");
        assert!(text.contains(&expected), "{text}");
        assert!(text.contains(remedy), "{text}");
    }
    let pose = MILL.find("[[pose]]").unwrap();
    let (text, place) = refused(pose, "high_mm", "1950");
    assert!(
        text.contains(&format!("{place}pose[1].high_mm: 1950 is out of range")),
        "{text}"
    );
    let text = broken("low_deg = -45.0", "low_deg = -170.0");
    assert!(
        text.contains(
            "joint[5].low_deg: -170.0 is out of range, allowed is -166.99 to 166.99 deg; "
        ) && text.contains("`wrap = true`"),
        "{text}"
    );
    // The bounds themselves are possible.
    let widest = BUILT_IN.replacen("low_deg = -45.0", "low_deg = -166.99", 1);
    let widest = widest.replacen("low = -47.0", "low = -169.0", 1);
    assert_eq!(problems(&widest), "no problem\n");
}

/// The number of coordinates is that of the model: the message names the models with as many.
#[test]
fn another_number_of_coordinates_is_refused_with_the_models_that_have_it() {
    const MILL: &str = include_str!("../../../../machines/mill3.toml");
    let with = |names: &[&str]| {
        let mut text = MILL.to_string();
        for name in names {
            text.push_str(&format!(
                "\n[[pose]]\nname = \"{name}\"\nkind = \"linear\"\nlow_mm = -1.0\nhigh_mm = 1.0\n\
                 rate_mm_s = 1.0\nacceleration_mm_s2 = 10.0\njerk_mm_s3 = 1000.0\n"
            ));
        }
        problems(&text)
    };
    for (names, count, models) in [
        (&["u"][..], 4, ", or choose a model with 4: \"four_axis\"\n"),
        (
            &["u", "v"],
            5,
            ", or choose a model with 5: \"h4\", \"trunnion\", \"facet\"\n",
        ),
        (
            &["u", "v", "w"],
            6,
            ", or choose a model with 6: \"six_axis\"\n",
        ),
        (
            &["u", "v", "w", "a"],
            7,
            "; a machine has at most 6 coordinates\n",
        ),
    ] {
        let text = with(names);
        let expected = format!(
            "pose: has {count} sections, the model has 3; write one for each of x, y, z{models}"
        );
        assert!(text.contains(&expected), "{text}");
    }
    let last = MILL.rfind("[[pose]]").expect("a section");
    let joints = MILL.find("[[joint]]").expect("a section");
    let text = problems(&format!("{}{}", &MILL[..last], &MILL[joints..]));
    let expected = "; no model has 2 coordinates, docs/adding-a-machine.md says how to add one\n";
    assert!(text.contains(expected), "{text}");
}

/// The range of the key is that of all models; this one has a narrower bound.
#[test]
fn a_singularity_margin_beyond_the_bound_of_the_model_is_refused() {
    let text = broken(
        "singularity_margin_mm = 5.0",
        "singularity_margin_mm = 101.0",
    );
    assert!(
        text.contains(
            "kinematics.model: needs a singularity margin of 1 to 100 mm, and it is 101; \
             lower singularity_margin_mm in [supervision]\n"
        ),
        "{text}"
    );
}

#[test]
fn problems_are_listed_in_the_order_of_lines() {
    let text = BUILT_IN
        .replacen("period_us = 200", "period_us = 2", 1)
        .replacen("r = 480.0", "r = -480.0", 1)
        .replacen("heartbeat_ms = 500", "hartbeat_ms = 500", 1)
        .replacen("gear_ratio = 90.0\n", "", 1);
    let Err(Problems(problems, 0)) = MachineFile::parse("broken.toml", &text) else {
        panic!("it is valid")
    };
    let keys: Vec<&str> = problems.iter().map(|p| p.key.as_str()).collect();
    assert_eq!(
        keys,
        [
            "period_us",
            "kinematics.r",
            "joint[5].gear_ratio",
            "supervision.hartbeat_ms"
        ]
    );
    assert!(problems.is_sorted_by_key(|p| p.line));
}

#[test]
fn empty_file_lists_the_missing_keys() {
    insta::assert_snapshot!("empty", problems(""));
}

#[test]
fn every_required_key_is_reported_if_missing() {
    let optional = [
        "backlash_mm",
        "backlash_deg",
        "direction",
        "rate_filter_ms",
        "friction_adaptation_ms",
        "viscous_n_per_mm_s",
        "viscous_n_m_per_deg_s",
        "coulomb_n",
        "coulomb_n_m",
        "under_control",
        "sign",
    ];
    // The simulator reads the plant.
    let own = BUILT_IN.lines().position(|line| line == "[plant]").unwrap();
    for (number, line) in BUILT_IN.lines().enumerate().take(own) {
        let Some((key, _)) = line.split_once(" =") else {
            continue;
        };
        // Without its format the file is one of format 1; the adaptation needs the integrator.
        if key.starts_with('#') || key == "format" || key == "ki" {
            continue;
        }
        let text: Vec<&str> = BUILT_IN
            .lines()
            .enumerate()
            .filter(|(n, _)| *n != number)
            .map(|(_, line)| line)
            .collect();
        let reported = problems(&text.join("\n"));
        if optional.contains(&key) {
            assert_eq!(reported, "no problem\n", "without line {}", number + 1);
        } else {
            let path = format!("{key}: is missing");
            assert!(
                reported.contains(&path),
                "without line {}: {reported}",
                number + 1
            );
        }
    }
}

/// A master adds millimetres to the first three coordinates and degrees to the next two. Other
/// machines are refused, with a sentence, before anything moves.
#[test]
fn a_master_needs_its_roles() {
    let trunnion = include_str!("../../../../machines/trunnion5.toml");
    let machine = MachineFile::parse("trunnion5.toml", trunnion).expect("valid");
    let refused = machine.with_follow().expect_err("no roles").to_string();
    assert!(
        refused.contains("follow: a master moves x, y and z"),
        "{refused}"
    );
    assert!(
        refused.contains("\"trunnion\" have other roles"),
        "{refused}"
    );
}
