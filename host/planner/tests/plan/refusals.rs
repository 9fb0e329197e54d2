//! Refusals of the planner with their messages; dwells and actions.

use crate::h4::{H4, HOME, settings};
use haptimill_gcode::{Options, read};
use haptimill_planner::Plan;
use haptimill_protocol::message::Action;

fn plan(text: &str) -> Result<Plan, String> {
    let program = read("part.ngc", text.as_bytes(), &Options::h4(HOME))
        .map_err(|refused| refused.to_string())?;
    Plan::new(&program, &settings(), &H4).map_err(|refused| refused.to_string())
}

#[test]
fn excessive_feed_is_refused_with_the_largest_allowed() {
    // Tilting in place moves the slides 350 mm per radian.
    let text = |feed: f64| format!("G1 B0 F100\nG1 X1 B20 F{feed}\n");
    let refused = plan(&text(600.0)).unwrap_err();
    assert!(
        refused.starts_with("part.ngc:2:4: a feed of 600 mm/min needs"),
        "{refused}"
    );
    let (_, largest) = refused
        .split_once("the largest feed for this block is ")
        .expect("the largest feed");
    let largest: f64 = largest
        .split_once(' ')
        .expect("a unit")
        .0
        .parse()
        .expect("a number");
    assert!(plan(&text(largest)).is_ok(), "{largest} passes");
    assert!(
        plan(&text(largest + 0.2)).is_err(),
        "more than {largest} does not"
    );
}

#[test]
fn overloaded_joint_is_named_with_its_rate() {
    let mut settings = settings();
    settings.joints[2].rate = 5.0;
    let program = read("part.ngc", b"G1 X30 F600", &Options::h4(HOME)).expect("read");
    let refused = Plan::new(&program, &settings, &H4).unwrap_err().to_string();
    assert!(
        refused.contains("needs 10.000 mm/s of slide 3")
            && refused.contains("its limit is 5.000 mm/s"),
        "{refused}"
    );
    assert!(refused.ends_with("is 300 mm/min"), "{refused}");
    // A rapid move is planned at a lower speed instead.
    let program = read("part.ngc", b"G0 X30", &Options::h4(HOME)).expect("read");
    let plan = Plan::new(&program, &settings, &H4).expect("limited");
    assert!(
        plan.figures.peak_joint_rates[2] <= 5.0 + 1e-9 && plan.figures.peak_joint_rates[2] > 4.9
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

#[test]
fn dwells_and_actions_are_at_standstill_and_in_order() {
    let plan = plan("S5000 M3\nG4 P30\nG1 X5 F240\nM0\nG1 X0\nM30\n").expect("planned");
    let actions: Vec<Action> = plan
        .setpoints
        .iter()
        .map(|setpoint| setpoint.action)
        .filter(|&action| action != Action::None)
        .collect();
    assert_eq!(
        actions,
        [Action::Spindle(5000), Action::Pause, Action::Spindle(0)]
    );
    for setpoint in plan
        .setpoints
        .iter()
        .filter(|setpoint| setpoint.action != Action::None)
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
