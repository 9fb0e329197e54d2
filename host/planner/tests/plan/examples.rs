//! The programs of examples/: geometry as in their headers, limits of the machine, and bytes per
//! second on the line.

use crate::h4::{H4, HOME, settings};
use haptimill_gcode::{Options, Program, Step, read};
use haptimill_planner::{Cursor, Plan};

fn plan(name: &str) -> (Program, Plan) {
    let path = format!("{}/../../examples/{name}", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read(&path).expect("the example is there");
    let program = read(name, &text, &Options::of_letters("XYZBA", HOME))
        .unwrap_or_else(|refused| panic!("{refused}"));
    let plan = Plan::new(&program, &settings(), &H4).unwrap_or_else(|refused| panic!("{refused}"));
    (program, plan)
}

/// End of the motion of a line: the time of its last setpoint.
fn end_of(plan: &Plan, line: u32) -> f64 {
    let mut time = 0.0;
    let mut end = 0.0;
    for (index, setpoint) in plan.setpoints.iter().enumerate() {
        time += f64::from(setpoint.periods) * plan.period_s;
        if plan.line_of(index) == line {
            end = time;
        }
    }
    end
}

/// The line that starts with a text.
fn line(name: &str, text: &str) -> u32 {
    let path = format!("{}/../../examples/{name}", env!("CARGO_MANIFEST_DIR"));
    let file = std::fs::read_to_string(path).expect("the example is there");
    file.lines()
        .position(|line| line.starts_with(text))
        .expect("the line is there") as u32
        + 1
}

/// The largest number of setpoints in any second, and the mean per second.
fn setpoint_rate(plan: &Plan) -> (usize, f64) {
    let mut times = Vec::new();
    let mut time = 0.0;
    for setpoint in &plan.setpoints {
        time += f64::from(setpoint.periods) * plan.period_s;
        times.push(time);
    }
    let mut max = 0;
    let mut from = 0;
    for (index, time) in times.iter().enumerate() {
        while times[from] <= time - 1.0 {
            from += 1;
        }
        max = max.max(index + 1 - from);
    }
    (max, times.len() as f64 / time)
}

/// Duration from standstill to standstill over a length: constant speed plus the time of one ramp.
/// The planner uses 0.9 of the jerk of 5000 mm/s^3, and half of that on an arc.
fn rest_to_rest(length: f64, speed: f64, jerk: f64) -> f64 {
    length / speed + 2.0 * (speed / jerk).sqrt()
}

const ON_LINE: f64 = 0.9 * 5000.0;
const ON_ARC: f64 = 0.5 * ON_LINE;

#[test]
fn slot_has_the_expected_duration() {
    let (_, plan) = plan("e7-slot.ngc");
    let took = end_of(&plan, line("e7-slot.ngc", "X-30"))
        - end_of(&plan, line("e7-slot.ngc", "G1 Z19.232"));
    assert!(
        (took - rest_to_rest(30.0, 4.0, ON_LINE)).abs() < 0.01,
        "{took}"
    );
    assert!((plan.figures.path_length_mm - (2.0 + 30.0 + 4.0 + 30.0 + 2.0)).abs() < 1e-5);
}

#[test]
fn pocket_has_the_expected_times_and_few_setpoints() {
    let (_, plan) = plan("e9-pocket.ngc");
    let begin = end_of(&plan, line("e9-pocket.ngc", "G1 Z19.232"));
    // docs/control.md E9: 7.5, 9.5, 17, 19, 26.5 s at constant speed; each stop adds a ramp.
    let ramp = [
        rest_to_rest(30.0, 4.0, ON_LINE),
        rest_to_rest(2.0, 1.0, ON_LINE),
    ];
    let mut expected = 0.0;
    for (text, length) in [
        ("X-30 ", 0),
        ("Y-2", 1),
        ("X0 F", 0),
        ("Y-4", 1),
        ("X-30", 0),
    ] {
        expected += ramp[length];
        let at = if text == "X-30" {
            end_of(&plan, line("e9-pocket.ngc", "Y-4") + 1)
        } else {
            end_of(&plan, line("e9-pocket.ngc", text))
        };
        assert!(
            (at - begin - expected).abs() < 0.02,
            "{text} ends at {} s, not {expected}",
            at - begin
        );
    }
    let (_, mean) = setpoint_rate(&plan);
    println!(
        "pocket: {} setpoints, {mean:.2} a second",
        plan.setpoints.len()
    );
    assert!(mean < 8.0, "{mean} setpoints a second");
}

#[test]
fn circle_is_round_and_has_the_expected_duration() {
    let (program, plan) = plan("e11-circle.ngc");
    let took = end_of(&plan, line("e11-circle.ngc", "G2 I"))
        - end_of(&plan, line("e11-circle.ngc", "G1 Z19"));
    assert!(
        (took - rest_to_rest(std::f64::consts::PI * 30.0, 4.0, ON_ARC)).abs() < 0.01,
        "{took}"
    );
    // First towards -Y, then around X-15 Y0.
    let begin = end_of(&plan, line("e11-circle.ngc", "G1 Z19"));
    let mut cursor = Cursor::default();
    let (pose, rates) = plan.intended(&mut cursor, begin + 1.0);
    assert!(rates[1] < -3.0 && pose[1] < 0.0);
    let (pose, _) = plan.intended(&mut cursor, begin + 0.5 * took);
    assert!(
        (pose[0] + 30.0).abs() < 0.01 && pose[1].abs() < 0.01,
        "{pose:?}"
    );
    let arc = program.steps.iter().find_map(|step| match step {
        Step::Move(step) => step.path.arc,
        _ => None,
    });
    assert_eq!(arc.map(|arc| arc.centre), Some([-15.0, 0.0]));
}

#[test]
fn sweeps_are_plannable() {
    for (name, lengths) in [("e1-feed-sweep.ngc", 54.0), ("e2-depth-sweep.ngc", 30.0)] {
        let (_, plan) = plan(name);
        assert!(plan.figures.path_length_mm > lengths);
        assert!(plan.figures.peak_tip_mm_s <= settings().pose[0].rate);
    }
    let (_, plan) = plan("e1-feed-sweep.ngc");
    // From 2 to 6 mm/s without a stop: the speed changes in motion.
    let mut cursor = Cursor::default();
    let change = end_of(&plan, line("e1-feed-sweep.ngc", "X-6"));
    let (_, rates) = plan.intended(&mut cursor, change);
    assert!((rates[0] + 2.0).abs() < 0.1, "{rates:?}");
}

#[test]
fn dome_never_stops_and_fits_the_baud_rate() {
    let (program, plan) = plan("dome.ngc");
    let moves = program
        .steps
        .iter()
        .filter(|step| matches!(step, Step::Move(_)))
        .count();
    assert!(moves >= 2000, "{moves} blocks");
    // No stop from the second turn to the end of the spiral, and mostly at the programmed feed.
    let first = end_of(&plan, line("dome.ngc", "F480") + 40);
    let last = end_of(&plan, line("dome.ngc", "G0 Z30") - 3);
    let mut cursor = Cursor::default();
    let (mut min, mut sum, mut count) = (f64::INFINITY, 0.0, 0.0);
    let mut time = first;
    while time < last {
        let (_, rates) = plan.intended(&mut cursor, time);
        let speed = (rates[0] * rates[0] + rates[1] * rates[1] + rates[2] * rates[2]).sqrt();
        min = speed.min(min);
        sum += speed;
        count += 1.0;
        time += 0.01;
    }
    let mean = sum / count;
    let (max, average) = setpoint_rate(&plan);
    println!(
        "dome: {moves} blocks, {:.1} s, {} setpoints, {average:.1} per second, at most {max}, mean \
         speed {mean:.2}, least {min:.2} mm/s",
        plan.figures.duration_s,
        plan.setpoints.len()
    );
    assert!(min > 4.0, "decelerated to {min} mm/s");
    assert!(mean > 7.5, "{mean} mm/s on average");
    // 115,200 baud is 11,520 bytes/s. A setpoint in five axes may have 40 bytes, and a quarter of
    // the line is for other messages.
    assert!(
        max as f64 * 40.0 < 0.75 * 11_520.0,
        "{max} setpoints in a second"
    );
}
