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
