//! Refusals of the planner with their messages; feeds that the machine lowers; dwells and actions.

use crate::h4::{H4, HOME, settings};
use haptimill_gcode::{Interpreter, Options, Tool, read};
use haptimill_planner::{Outputs, Plan, Settings, check};
use haptimill_protocol::message::Action;

fn plan(text: &str) -> Result<Plan, String> {
    let program = read(
        "part.ngc",
        text.as_bytes(),
        &Options::of_letters("XYZBA", HOME),
    )
    .map_err(|refused| refused.to_string())?;
    Plan::new(&program, &settings(), &H4).map_err(|refused| refused.to_string())
}

/// The tip may move at 60 mm/s along each axis, on the diagonal at 84.85 mm/s.
#[test]
fn the_rates_of_the_pose_lower_the_feed() {
    for (feed, slowed) in [(99_999.0, 1), (6000.0, 1), (4500.0, 0)] {
        let plan = plan(&format!("G0 X0 Y0\nG1 X30 Y30 F{feed}\n")).expect("lowered");
        assert_eq!(plan.figures.slowed, slowed, "F{feed}");
        for window in plan.setpoints.windows(2) {
            let (from, to) = (&window[0], &window[1]);
            let seconds = f64::from(to.periods) * plan.period_s;
            for axis in 0..2 {
                let moved = f64::from(to.pose[axis] - from.pose[axis]) / 1_048_576.0;
                assert!(moved.abs() / seconds <= 60.0 + 1e-3, "F{feed}: {moved}");
            }
        }
    }
}

/// A joint that is too slow for the feed, or for a rapid move, lowers it to its rate.
#[test]
fn a_slow_joint_lowers_the_feed() {
    let mut settings = settings();
    settings.joints[2].rate = 5.0;
    for (text, slowed) in [("G1 X30 F600", 1), ("G1 X30 F240", 0), ("G0 X30", 0)] {
        let program = read(
            "part.ngc",
            text.as_bytes(),
            &Options::of_letters("XYZBA", HOME),
        )
        .expect("read");
        let figures = Plan::new(&program, &settings, &H4)
            .expect("limited")
            .figures;
        let peak = figures.peak_joint_rates[2];
        let max = if text.contains("F240") { 4.0 } else { 5.0 };
        assert!(peak <= max + 1e-9 && peak > max - 0.1, "{peak} in {text}");
        assert_eq!(figures.slowed, slowed, "{text}");
    }
}

/// Only the part of a move near the end of a rod's reach is slow; with an exact stop it stops only
/// at its end.
#[test]
fn the_feed_falls_near_a_singularity_only() {
    for mode in ["G64", "G61"] {
        let text = format!("{mode} G0 X0 Y0 Z60\nG1 Y-60 Z-20 F3000\n");
        let program = read(
            "part.ngc",
            text.as_bytes(),
            &Options::of_letters("XYZBA", HOME),
        )
        .expect("read");
        let Ok(plan) = Plan::new(&program, &settings(), &H4) else {
            panic!("{:?}", Plan::new(&program, &settings(), &H4).map(|_| ()));
        };
        assert_eq!(plan.figures.blocks, 2);
        let stops = plan
            .setpoints
            .iter()
            .filter(|it| it.rates.iter().all(|&rate| rate == 0));
        assert_eq!(stops.count(), 2, "{mode}");
    }
}

/// Checks a program with a tool of 12.5 mm in the table.
fn checked(text: &str) -> String {
    let mut options = Options::of_letters("XYZBA", HOME);
    let mut tool = Tool::default();
    tool.offset[2] = 12.5;
    options.tools.insert(3, tool);
    options.tools_file = "mill.tools.toml".to_string();
    let mut interpreter = Interpreter::new(std::io::Cursor::new(text), &options);
    let done = check("t", &mut interpreter, HOME, &settings(), &H4, |_| {});
    done.map_or_else(|refused| refused.to_string(), |_| String::new())
}

#[test]
fn a_check_names_the_offsets_in_force_and_the_file_of_the_tools() {
    let offsets = "G10 L2 P2 X-20 R90\nG55 G43 H3\nG92.1\n";
    let refused = checked(&format!("{offsets}G1 Y250 F600\n"));
    assert!(refused.starts_with("t:4:4: "), "{refused}");
    let expected = "(offsets in force: G55 X-20.000 turned by 90 deg, tool offset Z12.500); ";
    assert!(refused.contains(expected), "{refused}");
    // Machine coordinates have no offset.
    let refused = checked(&format!("{offsets}G53 G0 X250\n"));
    assert!(refused.contains("soft limits"), "{refused}");
    assert!(!refused.contains("in force"), "{refused}");
    assert_eq!(
        checked("T4 M6\n"),
        "t:1:1: tool 4 is not in mill.tools.toml; add it, or write the number of another tool"
    );
}

#[test]
fn one_line_outside_the_workspace_is_reported() {
    let mut text = String::from("F600\n");
    for line in 0..2000 {
        let x = if line == 1498 {
            300.0
        } else {
            f64::from(line % 7)
        };
        text += &format!("G1 X{x} Z22\n");
    }
    let refused = plan(&text).unwrap_err();
    assert!(
        refused.contains(
            "part.ngc:1500:4: X300.0000 is outside the soft limits of X (-150 to 150 mm)"
        ),
        "{refused}"
    );
    // Outside the workspace, within the soft limits. The middle of a move is checked, too.
    let refused = plan("G0 Y140 A-40 Z140").unwrap_err();
    assert!(
        refused.starts_with("part.ngc:1:4: the machine cannot reach"),
        "{refused}"
    );
}

/// The blocks behind a wrong word repeat its coordinate, and are no mistakes of their own.
#[test]
fn one_wrong_word_is_one_problem() {
    let behind = "G1 X1\nX2\nG2 X4 I1\nG1 Y5\n";
    let refused = plan(&format!("F600\nG1 Z900\n{behind}")).unwrap_err();
    assert!(refused.starts_with("part.ngc:2:4: Z900"), "{refused}");
    assert_eq!(refused.lines().count(), 1, "{refused}");
    // Another coordinate, and a mistake behind the way back, are reported.
    let refused = plan(&format!("F600\nG1 Z900\n{behind}X400\nX0 Z22\nZ901\nX1\n")).unwrap_err();
    let places: Vec<&str> = refused.lines().map(|line| &line[..11]).collect();
    assert_eq!(
        places,
        ["part.ngc:2:", "part.ngc:7:", "part.ngc:9:"],
        "{refused}"
    );
    // Beyond the reach, within the soft limits.
    let refused = plan("G0 Y140 A-40 Z140\nG1 Y139 F600\nY138\nG0 Y0 A0 Z22\n").unwrap_err();
    assert_eq!(refused.lines().count(), 1, "{refused}");
}

/// A limit is named with the word of the program and the position of the machine.
#[test]
fn a_limit_under_an_offset_names_the_word() {
    let refused = plan("G10 L2 P1 X100\nG54\nG1 X250 F600\n").unwrap_err();
    let expected = "part.ngc:3:4: X250.0000 with the offsets in force is X350.0000 of the machine, \
                    outside the soft limits of X (-150 to 150 mm)";
    assert!(refused.starts_with(expected), "{refused}");
    assert!(
        refused.ends_with("change X by -200.0000 mm, or the work offset or tool length"),
        "{refused}"
    );
}

#[test]
fn program_of_excessive_duration_is_refused() {
    let refused = plan("G1 X30 F0.0001").unwrap_err();
    assert!(
        refused.starts_with("part.ngc:1:4: at its feeds the program takes more than 100 hours"),
        "{refused}"
    );
}

#[test]
fn several_problems_are_reported_together() {
    let refused = plan("F600\nG1 X400\nX0\nY400\nY0\n").unwrap_err();
    let lines: Vec<&str> = refused.lines().collect();
    assert!(
        lines.iter().any(|line| line.starts_with("part.ngc:2:4:")),
        "{refused}"
    );
    assert!(
        lines.iter().any(|line| line.starts_with("part.ngc:4:1:")),
        "{refused}"
    );
}

/// Whether an action is one of the program, and not the override mode of a move.
fn is_command(action: &Action) -> bool {
    !matches!(action, Action::None | Action::OverrideMode(_))
}

#[test]
fn dwells_and_actions_are_at_standstill_and_in_order() {
    let plan = plan("S5000 M3\nG4 P30\nG1 X5 F240\nM0\nG1 X0\nM30\n").expect("planned");
    let actions: Vec<Action> = plan
        .setpoints
        .iter()
        .map(|setpoint| setpoint.action)
        .filter(is_command)
        .collect();
    assert_eq!(
        actions,
        [Action::Spindle(5000), Action::Pause, Action::Spindle(0)]
    );
    for setpoint in plan
        .setpoints
        .iter()
        .filter(|setpoint| is_command(&setpoint.action))
    {
        assert!(setpoint.rates.iter().all(|&rate| rate == 0));
    }
    let dwell: u64 = (0..plan.setpoints.len())
        .filter(|&k| plan.line_of(k) == 2)
        .map(|k| u64::from(plan.setpoints[k].periods))
        .sum();
    assert_eq!(dwell, 150_000, "30 s in periods of 200 us");
    // Within five seconds of travel to X5 the pose of the pause is X5.
    let pause = plan
        .setpoints
        .iter()
        .find(|setpoint| setpoint.action == Action::Pause)
        .expect("there");
    assert_eq!(pause.pose[0], 5 << 20);
}

/// Coolant and outputs are at standstill, between the moves, with M62 as with M64.
#[test]
fn outputs_are_actions_in_order() {
    let options = Options {
        coolant: true,
        outputs: true,
        ..Options::of_letters("XYZBA", HOME)
    };
    let settings = Settings {
        outputs: Outputs {
            flood: Some(0),
            mist: Some(3),
            digital: vec![true; 5],
            ..Outputs::default()
        },
        ..settings()
    };
    let text = "M8\nG1 X5 F240\nM62 P2\nX6\nM65 P4\nM9\nX0\nM2\n";
    let program = read("part.ngc", text.as_bytes(), &options).expect("read");
    let plan = Plan::new(&program, &settings, &H4).expect("planned");
    let set = plan.setpoints.iter().filter(|it| is_command(&it.action));
    let found: Vec<_> = set
        .map(|it| {
            assert!(it.rates.iter().all(|&rate| rate == 0));
            let Action::Output { output, on } = it.action else {
                panic!("{:?}", it.action);
            };
            (output, on, it.pose[0] >> 20)
        })
        .collect();
    let expected = [
        (0, true, 0),
        (3, false, 0),
        (2, true, 5),
        (4, false, 6),
        (0, false, 6),
        (3, false, 6),
    ];
    assert_eq!(found[..6], expected);
    assert!(
        found[6..].iter().all(|(_, on, at)| !on && *at == 0),
        "{found:?}"
    );
}

#[test]
fn empty_program_is_one_setpoint_at_standstill() {
    let plan = plan("( nothing )").expect("planned");
    assert_eq!(plan.setpoints.len(), 1);
    assert_eq!(plan.setpoints[0].pose, plan.start);
    assert!(plan.setpoints[0].rates.iter().all(|&rate| rate == 0));
}

#[test]
fn test_model_matches_reference_values() {
    use haptimill_planner::MachineModel;
    // docs/control.md 7.2, REF-G.
    for (pose, slides) in [
        (
            [0.0, 0.0, 21.232, 0.0, 0.0, 0.0],
            [1135.000004, 484.999996, 1135.000004, 484.999996],
        ),
        (
            [10.0, -5.0, 40.0, 10.0, 0.0, 0.0],
            [1215.541455, 546.012270, 1192.435266, 499.659187],
        ),
        (
            [-20.0, 12.0, 60.0, -12.0, 20.0, 0.0],
            [1065.760027, 368.701790, 1126.184311, 391.442182],
        ),
    ] {
        let joints = H4.joints(&pose).expect("in reach");
        for k in 0..4 {
            assert!((joints[k] - slides[k]).abs() < 2e-6, "{joints:?}");
        }
        // Its rates are the derivatives of its joints.
        for axis in 0..5 {
            let (mut low, mut high, mut rates) = (pose, pose, [0.0; 6]);
            (low[axis], high[axis], rates[axis]) = (pose[axis] - 1e-4, pose[axis] + 1e-4, 1.0);
            let (low, high) = (
                H4.joints(&low).expect("near"),
                H4.joints(&high).expect("near"),
            );
            let exact = H4.joint_rates(&pose, &rates);
            for k in 0..5 {
                assert!(((high[k] - low[k]) / 2e-4 - exact[k]).abs() < 1e-6);
            }
        }
    }
}

#[test]
fn the_spindle_has_its_limits() {
    let settings = Settings {
        spindle_rpm: [500, 6000],
        ..settings()
    };
    let plan_at = |text: &str, spindle_percent: u8| {
        let options = Options::of_letters("XYZBA", HOME);
        let program = read("t.ngc", text.as_bytes(), &options).expect("read");
        let settings = Settings {
            spindle_percent,
            ..settings.clone()
        };
        Plan::new(&program, &settings, &H4).map_err(|refused| refused.to_string())
    };
    let fast = plan_at("G0 X1\nM3 S6001\n", 100).expect_err("refused");
    assert!(fast.starts_with("t.ngc:2:4: S6001: the spindle of the machine turns at 500 to 6000"));
    assert!(fast.contains("[spindle] of the machine file"), "{fast}");
    let slow = plan_at("M4 S499\n", 100).expect_err("refused");
    assert!(slow.starts_with("t.ngc:1:4: S499:"), "{slow}");
    let later = plan_at("M3 S600\nG0 X1\nS7000\n", 100).expect_err("refused");
    assert!(later.starts_with("t.ngc:3:1: S7000:"), "{later}");
    let scaled = plan_at("M3 S5000\n", 130).expect_err("refused");
    assert!(
        scaled.contains("S5000 at a spindle override of 130 % is 6500 rev/min"),
        "{scaled}"
    );
    // Without a speed the spindle stands, and M5 is no speed.
    let plan = plan_at("M3\nS500\nG0 X1\nM4 S6000\nM5\n", 100).expect("planned");
    assert_eq!(plan.figures.spindle_rpm, Some([500, 6000]));
    assert_eq!(
        plan_at("G0 X1\n", 100)
            .expect("planned")
            .figures
            .spindle_rpm,
        None
    );
}
