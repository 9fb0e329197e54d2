//! Migration of machine files of format 1. `data/format-1` has the files of `machines/` of
//! 2026-11-21, before format 2, with the gains of today.

use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::process::Coefficients;
use haptimill_machine_file::migrate::migrate;
use haptimill_machine_file::{FORMAT, MachineFile};

/// Old machine files, and the present ones that describe the same machines.
const MACHINES: [(&str, &str); 3] = [
    (
        include_str!("data/format-1/h4.toml"),
        include_str!("../../../machines/h4.toml"),
    ),
    (
        include_str!("data/format-1/h4-step.toml"),
        include_str!("../../../machines/h4-step.toml"),
    ),
    (
        include_str!("data/format-1/haptic-master.toml"),
        include_str!("../../../machines/haptic-master.toml"),
    ),
];

/// Old fragments, and the present ones.
const FRAGMENTS: [(&str, &str); 2] = [
    (
        include_str!("data/format-1/haptic-arm.toml"),
        include_str!("../../../machines/haptic-arm.toml"),
    ),
    (
        include_str!("data/format-1/follow.toml"),
        include_str!("../../../machines/follow.toml"),
    ),
];

fn parse(text: &str) -> MachineFile {
    MachineFile::parse("machine.toml", text).unwrap_or_else(|problems| panic!("\n{problems}"))
}

/// The simulated machine of a present file with the cutting forces that files of format 1 have:
/// those of `machines/h4.toml` were fitted anew since (docs/control.md 5.2).
fn with_former_forces(machine: &MachineFile) -> PlantConfig {
    let mut plant: PlantConfig = machine.plant().unwrap();
    if let Some(cutter) = &mut plant.cutter {
        cutter.helix_deg = 30.0;
        cutter.coefficients = Coefficients::P1;
        cutter.edge_onset_mm = 0.006;
    }
    plant
}

/// Comments of a text, in order.
fn comments(text: &str) -> Vec<&str> {
    let comments = text.lines().filter_map(|line| line.split_once('#'));
    comments.map(|(_, comment)| comment.trim()).collect()
}

#[test]
fn old_files_migrate_to_the_configuration_of_today() {
    for (old, new) in MACHINES {
        let migrated = migrate("old.toml", old).unwrap_or_else(|problems| panic!("\n{problems}"));
        assert_eq!(migrated.from, 1);
        let (old_machine, new_machine) = (parse(&migrated.text), parse(new));
        let (_, crc) = old_machine.encoded().unwrap();
        assert_eq!(crc, new_machine.encoded().unwrap().1);
        assert_eq!(old_machine.config, new_machine.config);
        // A master has no planner.
        if !old_machine.is_master() {
            let mut planner = new_machine.planner.clone();
            if planner.corner_tolerance_mm == 0.003 {
                // `machines/h4.toml` had a larger tolerance; migration keeps that of a file.
                planner.corner_tolerance_mm = 0.005;
            }
            assert_eq!(old_machine.planner, planner);
        }
        let plant: PlantConfig = old_machine.plant().unwrap();
        assert_eq!(plant, with_former_forces(&new_machine));
    }
}

/// Files of both formats had another name of the role of a machine.
#[test]
fn the_old_role_of_a_machine_is_renamed() {
    let old = "role = \"slave\"  # it follows\n";
    for text in [MACHINES[0].0, MACHINES[0].1] {
        let (head, rest) = text.split_once("\nname =").expect("a name");
        let migrated = migrate("old.toml", &format!("{head}\n{old}name ={rest}"));
        let migrated = migrated.unwrap_or_else(|problems| panic!("\n{problems}"));
        assert!(migrated.text.contains("role = \"machine\"  # it follows\n"));
        let change = "role: \"slave\" became \"machine\"";
        assert!(migrated.changes.iter().any(|it| it == change));
        assert_eq!(parse(&migrated.text).config, parse(MACHINES[0].1).config);
    }
}

/// Files of both formats had another name of the force setpoint.
#[test]
fn the_old_force_setpoint_is_renamed() {
    let today = include_str!("../../../machines/h4.toml");
    let old = today.replace("\nsetpoint_n = ", "\ndesired_n = ");
    assert_ne!(old, today);
    let migrated = migrate("old.toml", &old).unwrap_or_else(|problems| panic!("\n{problems}"));
    assert_eq!(migrated.text, today);
    assert_eq!(
        migrated.changes,
        ["force.axis.desired_n became force.axis.setpoint_n"]
    );
}

/// Two keys of the spindle had other names, one of them another unit. A file that has them is
/// refused with one problem for each, which names the command that rewrites it.
#[test]
fn the_old_times_of_the_spindle_are_renamed() {
    let today = include_str!("../../../machines/mill3-servo.toml");
    let old = today
        .replace("\nrun_up_s = 1.5 ", "\nspindle_up_ms = 1500 ")
        .replace("\ntime_constant_s = 0.3 ", "\nrun_up_s = 0.3 ");
    let problems = MachineFile::parse("old.toml", &old).expect_err("old names");
    let remedies: Vec<&str> = problems.0.iter().map(|it| it.remedy.as_str()).collect();
    assert_eq!(
        remedies,
        [
            "run `haptimill machine migrate old.toml`: the key is `run_up_s` now",
            "run `haptimill machine migrate old.toml`: the key is `time_constant_s` now"
        ],
        "{problems}"
    );
    let migrated = migrate("old.toml", &old).unwrap_or_else(|problems| panic!("\n{problems}"));
    assert_eq!(migrated.text, today);
    assert_eq!(
        migrated.changes,
        [
            "plant.spindle.run_up_s became plant.spindle.time_constant_s",
            "input.spindle_up_ms became input.run_up_s, in seconds"
        ]
    );
}

#[test]
fn old_fragments_migrate_to_those_of_today() {
    let machine = include_str!("../../../machines/h4.toml");
    for (old, new) in FRAGMENTS {
        let migrated = migrate("old.toml", old).unwrap_or_else(|problems| panic!("\n{problems}"));
        let (old_machine, new_machine) = (
            parse(&format!("{machine}\n{}", migrated.text)),
            parse(&format!("{machine}\n{new}")),
        );
        assert_eq!(old_machine.config, new_machine.config);
        let plant: PlantConfig = old_machine.plant().unwrap();
        assert_eq!(plant, new_machine.plant().unwrap());
    }
}

#[test]
fn comments_and_order_stay() {
    let fragments = FRAGMENTS.map(|(old, _)| old);
    for old in MACHINES.map(|(old, _)| old).into_iter().chain(fragments) {
        let migrated = migrate("old.toml", old).unwrap();
        assert_eq!(comments(&migrated.text), comments(old));
        // Only renamed lines and the format differ.
        let old_lines: Vec<_> = old.lines().collect();
        let lines: Vec<_> = migrated
            .text
            .lines()
            .filter(|line| !line.starts_with("format = "))
            .collect();
        // The other lines stay in their order; lines go only with a section that is removed. A
        // changed line is the head of a section, or keeps its value and comment.
        let mut rest = old_lines.iter();
        for line in &lines {
            let mut ahead = rest.clone();
            if ahead.any(|old| old == line) {
                rest = ahead;
                continue;
            }
            let value = |line: &str| line.split_once('=').map(|(_, value)| value.to_string());
            let is_renamed = old_lines.iter().any(|old| value(old) == value(line));
            assert!(line.starts_with('[') || is_renamed, "{line}");
        }
        let removes = migrated
            .changes
            .iter()
            .any(|change| change.contains("removed"));
        assert_eq!(lines.len() < old_lines.len(), removes);
    }
}

#[test]
fn the_format_is_the_first_key() {
    let migrated = migrate("old.toml", MACHINES[0].0).unwrap();
    let first = migrated
        .text
        .lines()
        .find(|line| !line.is_empty() && !line.starts_with('#'));
    assert_eq!(first, Some(format!("format = {FORMAT}").as_str()));
}

#[test]
fn files_of_this_format_stay_as_they_are() {
    let news = MACHINES.map(|(_, new)| new);
    for new in news.into_iter().chain(FRAGMENTS.map(|(_, new)| new)) {
        let migrated = migrate("new.toml", new).unwrap();
        assert_eq!(migrated.text, new);
        assert!(migrated.changes.is_empty(), "{:?}", migrated.changes);
    }
}

#[test]
fn a_plant_without_a_geometry_gets_the_one_of_the_controller() {
    let old = MACHINES[0].0;
    let (head, rest) = old.split_once("[plant.arm]").unwrap();
    let (_, tail) = rest.split_once("branch = \"below\"\n").unwrap();
    let migrated = migrate("old.toml", &format!("{head}{tail}")).unwrap();
    let plant: PlantConfig = parse(&migrated.text).plant().unwrap();
    assert_eq!(plant, with_former_forces(&parse(MACHINES[0].1)));
    let is_added = |change: &String| change.contains("plant.geometry.h4 was added");
    assert!(migrated.changes.iter().any(is_added));

    // A Cartesian machine of format 1 had none.
    let new = include_str!("../../../machines/mill3-servo.toml");
    let (head, rest) = new.split_once("[plant.geometry.cartesian]").unwrap();
    let (_, tail) = rest.split_once("squareness_yz = 0.0\n").unwrap();
    let old = format!("{head}{tail}").replace(&format!("format = {FORMAT}\n"), "");
    let migrated = migrate("old.toml", &old).unwrap();
    assert_eq!(parse(&migrated.text).config, parse(new).config);
    let plant: PlantConfig = parse(&migrated.text).plant().unwrap();
    assert_eq!(plant, parse(new).plant().unwrap());
}

#[test]
fn other_formats_and_texts_are_refused_with_the_remedy() {
    let newer = MACHINES[0].1.replace("format = 2", "format = 3");
    for (text, message) in [
        (
            newer.as_str(),
            "format: 3 is newer than this program, which reads format 2; use a newer haptimill",
        ),
        (
            "format = \"two\"",
            "format: is not the number of a format; write `format = 2`",
        ),
        (
            "format = 0",
            "format: is not the number of a format; write `format = 2`",
        ),
        (
            "[package]\nversion = 1",
            "is not a machine file: it has none of its keys and sections; write one with \
             `haptimill machine init NAME`",
        ),
        ("", "is not a machine file"),
        ("[homing", "old.toml:1:"),
    ] {
        for problems in [
            migrate("old.toml", text).unwrap_err(),
            MachineFile::parse("old.toml", text).unwrap_err(),
        ] {
            assert_eq!(problems.count(), 1, "{problems}");
            assert!(problems.to_string().contains(message), "{problems}");
        }
    }
}

#[test]
fn a_reader_names_the_command_for_an_old_file_and_a_fragment() {
    let old = MachineFile::parse("old.toml", MACHINES[0].0).unwrap_err();
    assert_eq!(
        old.to_string(),
        "old.toml:1:1: format: the file has format 1, this program reads format 2; run `haptimill \
         machine migrate old.toml`"
    );
    let fragment = MachineFile::parse("follow.toml", FRAGMENTS[1].1).unwrap_err();
    assert_eq!(
        fragment.to_string(),
        "follow.toml:1:1: is a fragment of a machine file: it has [follow] only; append it to a \
         machine file"
    );
}
