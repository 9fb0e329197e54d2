//! One mistake in a machine file is one problem: what is not known because of it is not reported.

use haptimill_machine_file::MachineFile;

const MILL: &str = include_str!("../../../machines/mill3.toml");
const TRUNNION: &str = include_str!("../../../machines/trunnion5.toml");
const SCARA: &str = include_str!("../../../machines/scara.toml");
const ROUTER: &str = include_str!("../../../machines/router3.toml");

/// The problems of a file in which a text is replaced once.
#[track_caller]
fn problems(text: &str, from: &str, to: &str) -> Vec<String> {
    assert!(text.contains(from), "{from}");
    let text = text.replacen(from, to, 1);
    let problems = MachineFile::parse("machine.toml", &text).expect_err("a mistake");
    let problems = problems.0.iter();
    problems
        .map(|problem| format!("{}: {}", problem.key, problem.what))
        .collect()
}

#[test]
fn a_missing_way_to_home_needs_no_section_and_forbids_none() {
    let found = problems(MILL, "home = \"switch\"\n", "");
    assert_eq!(found, ["joint[1].home: is missing"]);
    let found = problems(MILL, "home = \"switch\"\n", "home = \"swich\"\n");
    assert!(
        found.len() == 1 && found[0].starts_with("joint[1].home: "),
        "{found:?}"
    );
}

#[test]
fn a_missing_home_switch_asks_for_no_search_of_an_index() {
    let start = MILL.find("[joint.switch]").expect("a switch");
    let end = MILL[start..].find("\n\n").expect("a next section");
    let found = problems(MILL, &MILL[start..start + end], "");
    assert_eq!(found, ["joint[1].switch: is missing"]);
}

#[test]
fn a_missing_drive_asks_for_no_key_of_another_drive() {
    let start = MILL.find("[joint.drive]").expect("a drive");
    let end = MILL[start..].find("\n\n").expect("a next section");
    let found = problems(MILL, &MILL[start..start + end], "");
    assert_eq!(found, ["joint[1].drive: is missing"]);
}

/// The keys of the section are then in the section before it.
#[test]
fn a_missing_header_of_a_section_is_one_problem() {
    let found = problems(MILL, "[joint.drive]\n", "");
    assert_eq!(found, ["joint[1].drive: is missing"]);
    assert_eq!(problems(MILL, "[planner]\n", ""), ["planner: is missing"]);
    let text = MILL.replacen("[joint.drive]\n", "", 1);
    let refused = MachineFile::parse("machine.toml", &text).expect_err("a mistake");
    assert_eq!(
        refused.0[0].remedy,
        "add a section [joint.drive] below its [[joint]]"
    );
}

#[test]
fn a_misspelt_key_is_not_missing() {
    let found = problems(MILL, "rate_mm_s = ", "rate_mms = ");
    assert_eq!(found, ["pose[1].rate_mms: is not a known key"]);
}

#[test]
fn a_wrap_on_one_side_asks_for_no_limits() {
    let what = "a coordinate that wraps around is a joint of the same name that does so too";
    let at = TRUNNION.rfind("wrap = true").expect("a joint");
    let (pose, joint) = TRUNNION.split_at(at);
    let without = |text: &str| text.replacen("wrap = true", "", 1);
    for text in [without(pose) + joint, pose.to_string() + &without(joint)] {
        let problems = MachineFile::parse("machine.toml", &text).expect_err("a mistake");
        let found: Vec<_> = problems.0.iter().map(|it| (&*it.key, &*it.what)).collect();
        assert_eq!(found, [("pose[5].wrap", what)]);
    }
}

#[test]
fn a_missing_header_names_the_duplicate_key() {
    let text = MILL.replacen("[joint.switch]\n", "", 1);
    let problems = MachineFile::parse("machine.toml", &text).expect_err("a mistake");
    let (what, remedy) = (&problems.0[0].what, &problems.0[0].remedy);
    assert!(what.ends_with("is a duplicate key"), "{what}");
    assert!(remedy.contains("header"), "{remedy}");
}

#[test]
fn a_joint_of_the_model_is_no_second_motor() {
    let joint = "name = \"z\"\nkind = \"linear\"\nlow_mm = -55.0\n";
    let found = problems(MILL, joint, &format!("{joint}gantry_of = \"q\"\n"));
    assert_eq!(
        found,
        ["joint[3].gantry_of: is for second motors, and this is a joint of the model"]
    );
}

#[test]
fn an_unknown_first_motor_is_not_compared_with_the_plant() {
    let found = problems(ROUTER, "gantry_of = \"y\"", "gantry_of = \"q\"");
    assert_eq!(
        found,
        ["joint[4].gantry_of: \"q\" is no joint of the model"]
    );
}

#[test]
fn a_second_motor_without_its_first_is_told_by_its_racking() {
    let start = ROUTER.find("gantry_of = ").expect("a second motor");
    let line = ROUTER[start..].lines().next().expect("a line");
    let found = problems(ROUTER, line, "");
    assert_eq!(found, ["joint[4].gantry_of: is missing"]);
}

#[test]
fn a_drive_of_no_kind_asks_for_no_key_of_another_kind() {
    let found = problems(MILL, "kind = \"step\"", "kind = \"stepper\"");
    assert_eq!(found, ["joint[1].drive.kind: \"stepper\" is not known"]);
    let found = problems(MILL, "kind = \"step\"\n", "");
    assert_eq!(found, ["joint[1].drive.kind: is missing"]);
}

#[test]
fn a_misspelt_section_of_a_joint_asks_for_no_homing() {
    let found = problems(MILL, "[joint.switch]", "[joint.swich]");
    assert_eq!(found, ["joint[1].swich: is not a known key"]);
}

#[test]
fn wrong_names_and_numbers_of_joints_are_compared_with_nothing() {
    let joint = |text: &str| text.find("[[joint]]").expect("a joint");
    let (before, rest) = MILL.split_at(joint(MILL) + 9);
    let renamed = rest.replacen("name = \"y\"", "name = \"x\"", 1);
    let found = MachineFile::parse("machine.toml", &format!("{before}{renamed}"));
    let found = found.expect_err("a mistake");
    assert_eq!(found.0.len(), 1, "{found}");
    let without = &rest[joint(rest)..];
    let found = MachineFile::parse(
        "machine.toml",
        &format!("{}{without}", &before[..joint(MILL)]),
    );
    let found = found.expect_err("a mistake");
    assert_eq!(found.0.len(), 1, "{found}");
    let start = MILL.rfind("[[plant.joint]]").expect("a simulated joint");
    let found = MachineFile::parse("machine.toml", &MILL[..start]).expect_err("a mistake");
    assert_eq!(found.0.len(), 1, "{found}");
}

#[test]
fn exchanged_coordinates_are_not_compared_with_the_strokes() {
    let text = MILL
        .replacen("name = \"x\"", "name = \"w\"", 1)
        .replacen("name = \"y\"", "name = \"x\"", 1)
        .replacen("name = \"w\"", "name = \"y\"", 1);
    let found = MachineFile::parse("machine.toml", &text).expect_err("a mistake");
    let keys: Vec<&str> = found.0.iter().map(|it| it.key.as_str()).collect();
    assert_eq!(keys, ["pose[1].name", "pose[2].name"], "{found}");
}

#[test]
fn one_bracket_for_a_list_and_a_misspelt_key_of_the_plant_have_their_remedies() {
    let text = MILL.replacen("[[joint]]", "[joint]", 1);
    let found = MachineFile::parse("machine.toml", &text).expect_err("a mistake");
    assert!(
        found.0[0].remedy.contains("two brackets, as [[joint]]"),
        "{found}"
    );
    let (before, plant) = MILL.split_at(MILL.find("[plant.spindle]").expect("a spindle"));
    let text = format!(
        "{before}{}",
        plant.replacen("time_constant_s", "time_constnt_s", 1)
    );
    let found = MachineFile::parse("machine.toml", &text).expect_err("a mistake");
    assert_eq!(
        found.0[0].remedy, "did you mean `time_constant_s`?",
        "{found}"
    );
}

#[test]
fn a_simulated_beam_without_its_second_motor_is_one_problem() {
    let start = ROUTER.rfind("gantry_of = ").expect("a second motor");
    let (before, line) = ROUTER.split_at(start);
    let rest = &line[line.find('\n').expect("a next line")..];
    let text = format!("{before}{rest}");
    let found = MachineFile::parse("machine.toml", &text).expect_err("a mistake");
    assert_eq!(found.0.len(), 1, "{found}");
    assert_eq!(found.0[0].key, "plant.joint[4].gantry_of");
}

#[test]
fn a_simulated_geometry_of_another_model_is_told_before_its_keys() {
    let found = problems(
        MILL,
        "[plant.geometry.cartesian]",
        "[plant.geometry.corexy]",
    );
    assert_eq!(
        found,
        ["plant.geometry: is \"corexy\", the model of [kinematics] is \"cartesian\""]
    );
}

#[test]
fn a_period_that_does_not_divide_a_second_is_reported_at_its_key() {
    let found = problems(MILL, "period_us = 200", "period_us = 300");
    assert_eq!(found, ["period_us: does not divide a second, 1,000,000 us"]);
}

/// The sign of the second joint is that of the other branch.
#[test]
fn presets_on_the_other_branch_are_told_by_the_singularity_distance() {
    let found = problems(SCARA, "elbow = \"right\"", "elbow = \"left\"");
    assert_eq!(found.len(), 1, "{found:?}");
    assert!(
        found[0].starts_with("joint: at the presets of the joints the singularity distance is -"),
        "{found:?}"
    );
}

#[test]
fn an_unknown_model_asks_for_no_key_of_another_model() {
    let found = problems(MILL, "model = \"cartesian\"", "model = \"cartesien\"");
    assert_eq!(found, ["kinematics.model: \"cartesien\" is not known"]);
}

#[test]
fn a_preset_beyond_a_stop_has_no_range_of_starts() {
    let (_, plant) = MILL.split_once("[plant]").expect("a plant");
    assert!(plant.contains("preset = 50.0"));
    let at = MILL.rfind("preset = 50.0").expect("a preset");
    let text = format!(
        "{}preset = 500.0{}",
        &MILL[..at],
        &MILL[at + "preset = 50.0".len()..]
    );
    let problems = MachineFile::parse("machine.toml", &text).expect_err("a mistake");
    assert_eq!(problems.0.len(), 1, "{problems}");
    assert_eq!(problems.0[0].key, "plant.joint[3].preset");
}

#[test]
fn a_key_is_named_once_among_the_others() {
    let text = MILL.replacen(
        "home = \"switch\"\n",
        "home = \"switch\"\nlubrication = 1\n",
        1,
    );
    let problems = MachineFile::parse("machine.toml", &text).expect_err("a mistake");
    let remedy = &problems.0[0].remedy;
    let (_, keys) = remedy.split_once("other keys here are ").expect("a list");
    let mut keys: Vec<&str> = keys.split(", ").collect();
    let count = keys.len();
    keys.sort_unstable();
    keys.dedup();
    assert_eq!(keys.len(), count, "{remedy}");
}
