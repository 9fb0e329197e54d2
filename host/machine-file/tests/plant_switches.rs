//! A simulated machine whose switches or step clock are not those of the controller is refused.

use haptimill_machine_file::MachineFile;

const MILL: &str = include_str!("../../../machines/mill3.toml");

/// The problem of the mill with a text replaced once, in the part of the controller or in that of
/// the simulated machine.
#[track_caller]
fn problem(in_plant: bool, from: &str, to: &str) -> String {
    let (controller, plant) = MILL.split_once("[plant]").expect("a plant");
    let part = if in_plant { plant } else { controller };
    assert!(part.contains(from), "{from}");
    let changed = part.replacen(from, to, 1);
    let text = match in_plant {
        true => format!("{controller}[plant]{changed}"),
        false => format!("{changed}[plant]{plant}"),
    };
    let problems = MachineFile::parse("machine.toml", &text).expect_err("another machine");
    assert_eq!(problems.0.len(), 1, "{problems}");
    let problem = &problems.0[0];
    assert!(problem.line > 1, "{problem}");
    format!("{}: {}", problem.key, problem.what)
}

#[test]
fn a_switch_that_is_missing_or_turned_round_is_found() {
    let home = "home = { at = -150.0, active = \"below\", hysteresis = 0.2, bounce_ms = 2.0 }\n";
    assert_eq!(
        problem(true, home, ""),
        "plant.joint[1].home: is missing; the controller searches it at -150 mm"
    );
    assert_eq!(
        problem(true, "active = \"below\"", "active = \"above\""),
        "plant.joint[1].home: the switch is active on the side from which the controller comes"
    );
    assert_eq!(
        problem(
            false,
            "[joint.switch]\n",
            "[joint.switch]\ninput = \"limit_low\"\n"
        ),
        "plant.joint[1].limit_low: is missing; the controller searches it at -150 mm"
    );
}

#[test]
fn a_line_of_the_other_level_is_found() {
    let found = problem(
        false,
        "home = \"switch\"\n",
        "home = \"switch\"\nhome_active = \"low\"\n",
    );
    assert_eq!(
        found,
        "plant.joint[1].active_low: the line of home is high while it is active, the controller \
         expects low"
    );
}

#[test]
fn another_step_clock_is_found() {
    let found = problem(true, "ticks_per_us = 84", "ticks_per_us = 75");
    assert_eq!(
        found,
        "plant.joint[1].drive.steps.ticks_per_us: ticks_per_us = 75 is not the step clock of the \
         controller, 84"
    );
}

/// A motor or an encoder that is turned round in one of both parts.
#[test]
fn another_direction_is_found() {
    assert_eq!(
        problem(false, "direction = 1\n", "direction = -1\n"),
        "plant.joint[1].drive.steps: a positive step is up in the simulated joint, and down by the \
         `direction` of [[joint]]"
    );
    // A joint has the direction of its encoder first, then that of its drive.
    let servo = include_str!("../../../machines/mill3-servo.toml");
    for (section, what) in [
        ("\n[joint.drive]\n", "a positive effort is up"),
        ("\n[[joint]]\n", "a positive count is up"),
    ] {
        let (before, after) = servo.split_once(section).expect("the section");
        let turned = after.replacen("direction = 1\n", "direction = -1\n", 1);
        let text = format!("{before}{section}{turned}");
        let problems = MachineFile::parse("machine.toml", &text).expect_err("another machine");
        assert_eq!(problems.0.len(), 1, "{problems}");
        assert!(problems.0[0].what.contains(what), "{problems}");
    }
}

/// Pulses that the simulated drive does not see, and a motor that its friction holds.
#[test]
fn a_drive_that_cannot_move_its_joint_is_found() {
    for (from, to, what) in [
        (
            "min_high_ns = 1000.0",
            "min_high_ns = 4000.0",
            "min_high_ns: the simulated drive needs 4000 ns, the controller has 2500 ns",
        ),
        (
            "setup_ns = 5000.0",
            "setup_ns = 50000.0",
            "setup_ns: the simulated drive needs 50000 ns",
        ),
        (
            "pull_out = 1200.0",
            "pull_out = 30.0",
            "pull_out: the simulated motor has 30 at most, and the friction is 40: it never moves",
        ),
    ] {
        let found = problem(true, from, to);
        assert!(found.contains(what), "{found}");
    }
}
