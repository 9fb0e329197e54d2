//! Problems of the second motor of a gantry, each with its key.

use haptimill_machine_file::MachineFile;

const ROUTER: &str = include_str!("../../../machines/router3.toml");

/// The router with a part of the joint y2, or of its simulated joint, replaced.
fn with(from: &str, to: &str, of_plant: bool) -> String {
    let section = if of_plant {
        "[[plant.joint]]"
    } else {
        "[[joint]]"
    };
    let start = ROUTER
        .find(&format!("{section}\nname = \"y2\""))
        .expect("y2");
    let (before, after) = ROUTER.split_at(start);
    assert!(after.contains(from), "{from}");
    format!("{before}{}", after.replacen(from, to, 1))
}

fn problems(text: &str) -> Vec<String> {
    let problems = MachineFile::parse("router3.toml", text).err();
    let problems = problems.map(|problems| problems.0).unwrap_or_default();
    let text = problems
        .iter()
        .map(|it| format!("{}: {}; {}", it.key, it.what, it.remedy));
    text.collect()
}

#[test]
fn each_problem_has_its_key_and_its_remedy() {
    for (from, to, key, what) in [
        (
            "gantry_of = \"y\"",
            "gantry_of = \"w\"",
            "joint[4].gantry_of",
            "write one of x, y, z",
        ),
        (
            "gantry_of = \"y\"",
            "",
            "joint[4].gantry_of",
            "is missing; name a joint of the model",
        ),
        (
            "gantry_of = \"y\"",
            "gantry_of = \"z\"",
            "joint[4].preset_mm",
            "is not that of \"z\"",
        ),
        ("racking_mm = 4.0", "", "joint[4].racking_mm", "is missing"),
        (
            "racking_mm = 4.0",
            "racking_mm = -1.0",
            "joint[4].racking_mm",
            "-1",
        ),
        (
            "name = \"y2\"",
            "name = \"y\"",
            "joint[4].name",
            "duplicate",
        ),
        (
            "low_mm = -105.0",
            "low_mm = -101.0",
            "joint[4].low_mm",
            "do not contain the stroke",
        ),
        (
            "\nrate_mm_s = 50.0",
            "\nrate_mm_s = 40.0",
            "joint[4].rate_mm_s",
            "below that of \"y\"",
        ),
        (
            "home_order = 2",
            "home_order = 1",
            "joint[4].switch",
            "home_order is not that of \"y\"",
        ),
        (
            "back_off_mm = 3.0",
            "back_off_mm = 2.0",
            "joint[4].switch",
            "back_off_mm is not",
        ),
        (
            "preset_mm = 0.0",
            "preset_mm = 1.0",
            "joint[4].preset_mm",
            "is not that of \"y\"",
        ),
    ] {
        let found = problems(&with(from, to, false));
        let fits = found
            .iter()
            .any(|it| it.starts_with(&format!("{key}:")) && it.contains(what));
        assert!(fits, "{from} -> {to}: {found:?}");
    }
    for (from, to, key, what) in [
        (
            "gantry_of = \"y\"",
            "",
            "plant.joint[4]",
            "second motor of \"y\"",
        ),
        (
            "gantry_of = \"y\"",
            "gantry_of = \"z\"",
            "plant.joint[4].gantry_of",
            "of \"y\"",
        ),
        (
            "preset = 0.0",
            "preset = 1.0",
            "plant.joint[4].preset",
            "is not 0",
        ),
        (
            "racked = 1.5",
            "start_spread = 1.0",
            "plant.joint[4].start_spread",
            "racked",
        ),
    ] {
        let found = problems(&with(from, to, true));
        let fits = found
            .iter()
            .any(|it| it.starts_with(key) && it.contains(what));
        assert!(fits, "{from} -> {to}: {found:?}");
    }
    assert_eq!(problems(ROUTER), Vec::<String>::new());
}

/// A key of a second motor on a joint of the model is refused.
#[test]
fn only_second_motors_rack() {
    let text = ROUTER.replacen(
        "name = \"x\"\nkind = \"linear\"\nlow_mm = -155.0",
        "name = \"x\"\nkind = \"linear\"\nracking_mm = 1.0\nlow_mm = -155.0",
        1,
    );
    let found = problems(&text);
    assert!(
        found
            .iter()
            .any(|it| it.starts_with("joint[1].racking_mm:")),
        "{found:?}"
    );
}
