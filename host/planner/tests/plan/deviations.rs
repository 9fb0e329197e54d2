//! Distance of the planned motion from the program, against the program's own geometry.

use crate::h4::{H4, HOME, settings};
use crate::properties::{check_limits, check_steps, plan};
use crate::spans::{Span, spans};
use haptimill_gcode::{Coordinates, Options, read};
use haptimill_planner::Plan;
use proptest::prelude::*;

/// Places of a span, its ends included, mm.
fn places(span: &Span) -> impl Iterator<Item = [f64; 3]> + '_ {
    (0..=16).map(|part| [0, 1, 2].map(|k| span.axes[k].at(f64::from(part) / 16.0)))
}

/// Distance of a point from a line between two points.
fn distance(point: [f64; 3], from: [f64; 3], to: [f64; 3]) -> f64 {
    let along = [0, 1, 2].map(|k| to[k] - from[k]);
    let squared: f64 = along.iter().map(|part| part * part).sum();
    let done: f64 = (0..3).map(|k| (point[k] - from[k]) * along[k]).sum();
    let share = if squared > 0.0 {
        (done / squared).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (0..3)
        .map(|k| (point[k] - from[k] - share * along[k]).powi(2))
        .sum::<f64>()
        .sqrt()
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, cases: 96, ..ProptestConfig::default() })]

    /// The setpoints of an arc or a helix stay within 1 um of it, also at the limits of the
    /// machine. The exact stops keep the corners out.
    #[test]
    fn arcs_are_within_a_micrometre(
        plane in 0usize..3,
        radius in prop_oneof![0.3..3.0f64, 3.0..40.0f64],
        from in 0.0..std::f64::consts::TAU,
        sweep in 0.2..6.2f64,
        left in any::<bool>(),
        rise in prop_oneof![Just(0.0), -8.0..8.0f64],
        feed in 60.0..6000.0f64,
    ) {
        let (word, [first, second, third]) =
            [("G17", [0, 1, 2]), ("G18", [2, 0, 1]), ("G19", [1, 2, 0])][plane];
        let letter = |axis: usize| ["X", "Y", "Z"][axis];
        let offset = |axis: usize| ["I", "J", "K"][axis];
        let mut centre = [0.0; 3];
        centre[2] = 40.0;
        let turn = if left { sweep } else { -sweep };
        let at = |angle: f64, up: f64| {
            let mut place = centre;
            place[first] += radius * angle.cos();
            place[second] += radius * angle.sin();
            place[third] += up;
            place
        };
        let (start, end) = (at(from, 0.0), at(from + turn, rise));
        let text = format!(
            "{word} G61\nG0 X{:.7} Y{:.7} Z{:.7}\nG{} F{feed:.2} X{:.7} Y{:.7} Z{:.7} {}{:.7} {}{:.7}\n",
            start[0], start[1], start[2],
            if left { 3 } else { 2 },
            end[0], end[1], end[2],
            offset(first), centre[first] - start[first],
            offset(second), centre[second] - start[second],
        );
        let (_, plan) = plan(&text, &settings());
        let mut samples = 0;
        for (index, span) in spans(&plan).iter().enumerate() {
            if plan.line_of(index) != 3 {
                continue;
            }
            for place in places(span) {
                let [x, y] = [place[first] - centre[first], place[second] - centre[second]];
                let off = x.hypot(y) - radius;
                prop_assert!(off.abs() <= 1e-3, "{off} mm off the radius\n{text}");
                // The angle that is done, in the direction of the arc.
                let done = (y.atan2(x) - from) * turn.signum();
                let done = done.rem_euclid(std::f64::consts::TAU);
                let done = if done > sweep + 0.04 { 0.0 } else { done };
                let up = place[third] - centre[third] - rise * done / sweep;
                prop_assert!(up.abs() <= 1e-3, "{up} mm off the helix in {}\n{text}", letter(third));
                samples += 1;
            }
        }
        prop_assert!(samples > 50, "{samples}\n{text}");
    }

    /// The setpoints stay within P and Q of G64 of the programmed lines, without Q within P, and
    /// pass every programmed point within them.
    #[test]
    fn p_of_g64_bounds_the_distance_from_the_program(
        steps in prop::collection::vec((0.02..12.0f64, -2.0..2.0f64, -1.0..1.0f64), 2..24),
        feed in 120.0..3000.0f64,
        p in prop_oneof![Just(0.001), Just(0.01), Just(0.05), Just(0.3)],
        q in prop_oneof![Just(None), Just(Some(0.0)), Just(Some(0.002)), Just(Some(0.02))],
        is_gentle in any::<bool>(),
    ) {
        let mut points = vec![[0.0, 0.0, 30.0]];
        let mut heading = 0.0f64;
        for (length, turn, rise) in steps {
            // Short blocks of a curve, which Q joins.
            let (length, turn) = if is_gentle { (0.02 * length, 0.1 * turn) } else { (length, turn) };
            heading += turn;
            let last = points[points.len() - 1];
            let mut next = [
                last[0] + length * heading.cos(),
                last[1] + length * heading.sin(),
                30.0 + rise * length.min(3.0),
            ];
            if next[0].abs() > 35.0 || next[1].abs() > 35.0 {
                heading += std::f64::consts::PI;
                next = [0.5 * last[0], 0.5 * last[1], 30.0];
            }
            points.push(next.map(|part| (part * 1e4).round() / 1e4));
        }
        let word = q.map_or(String::new(), |q| format!("Q{q}"));
        let head = format!("G0 X0 Y0 Z30\nG64 P{p} {word}\nG1 F{feed:.1}\n");
        let text = points[1..].iter().fold(head, |text, at| {
            text + &format!("X{:.4} Y{:.4} Z{:.4}\n", at[0], at[1], at[2])
        });
        let (_, made) = plan(&text, &settings());
        // The cubics are within 0.2 um of the planned motion in each coordinate.
        let max = p + q.unwrap_or(0.0) + 4e-4;
        let mut nearest = vec![f64::INFINITY; points.len()];
        for (index, span) in spans(&made).iter().enumerate() {
            if made.line_of(index) < 4 {
                continue;
            }
            for place in places(span) {
                let off = points
                    .windows(2)
                    .map(|ends| distance(place, ends[0], ends[1]))
                    .fold(f64::INFINITY, f64::min);
                prop_assert!(off <= max, "{off} mm from the program\n{text}");
            }
            let ends: Vec<_> = places(span).collect();
            for (nearest, point) in nearest.iter_mut().zip(&points) {
                for part in ends.windows(2) {
                    *nearest = nearest.min(distance(*point, part[0], part[1]));
                }
            }
        }
        for (point, nearest) in points.iter().zip(nearest) {
            prop_assert!(nearest <= max, "{point:?} is passed in {nearest} mm\n{text}");
        }
    }

    /// Short blocks that turn the tool: the tip is within P and Q of the program, where the rotary
    /// coordinates are within their tolerance.
    #[test]
    fn the_tool_turns_with_the_program(
        steps in prop::collection::vec((0.02..0.4f64, -0.1..0.1f64, -1.0..1.0f64, -1.0..1.0f64), 10..120),
        feed in 300.0..3000.0f64,
        p in prop_oneof![Just(0.002), Just(0.01), Just(0.05)],
        q in prop_oneof![Just(None), Just(Some(0.0)), Just(Some(0.005))],
        bend in 0.0..0.3f64,
    ) {
        let mut points: Vec<Coordinates> = vec![[0.0, 0.0, 30.0, 0.0, 0.0, 0.0]];
        let (mut heading, mut slopes) = (0.0f64, [0.5, -0.5]);
        for (length, turn, first, second) in steps {
            heading += turn + 0.02;
            for (slope, change) in slopes.iter_mut().zip([first, second]) {
                *slope = (*slope + bend * change * length).clamp(-2.0, 2.0);
            }
            let [x, y, z, b, a, _] = points[points.len() - 1];
            let next = [
                x + length * heading.cos(),
                y + length * heading.sin(),
                z + 0.2 * length,
                b + slopes[0] * length,
                a + slopes[1] * length,
                0.0,
            ];
            points.push(next.map(|part| (part * 1e5).round() / 1e5));
        }
        let word = q.map_or(String::new(), |q| format!("Q{q}"));
        let head = format!("G0 X0 Y0 Z30\nG64 P{p} {word}\nG1 F{feed:.1}\n");
        let text = points[1..].iter().fold(head, |text, [x, y, z, b, a, _]| {
            text + &format!("X{x:.5} Y{y:.5} Z{z:.5} B{b:.5} A{a:.5}\n")
        });
        let (_, made) = plan(&text, &settings());
        check_limits(&made, &settings(), &text);
        check_steps(&made, &settings(), &text);
        let mut next = 0;
        for (index, span) in spans(&made).iter().enumerate() {
            if made.line_of(index) < 4 {
                continue;
            }
            for at in poses(span) {
                let is_near = |line: &usize| {
                    let off = off_turning_line(&at, &points[*line], &points[*line + 1]);
                    off <= p + q.unwrap_or(0.0) + 4e-4
                };
                let near = (next..points.len() - 1).find(is_near);
                prop_assert!(near.is_some(), "{at:?} is off the program after line {next}\n{text}");
                next = near.unwrap_or(next);
            }
        }
        prop_assert!(next + 2 >= points.len(), "ends at {next}\n{text}");
    }
}

/// Poses of a span.
fn poses(span: &Span) -> impl Iterator<Item = Coordinates> {
    let parts = (0..=8).map(|part| f64::from(part) / 8.0);
    parts.map(|u| std::array::from_fn(|k| span.axes.get(k).map_or(0.0, |axis| axis.at(u))))
}

/// Distance of the tip from that part of a line where the rotary coordinates are within their
/// tolerance, mm; infinite if there is none.
fn off_turning_line(at: &Coordinates, from: &Coordinates, to: &Coordinates) -> f64 {
    let along: Coordinates = std::array::from_fn(|k| to[k] - from[k]);
    // The cubics are within 0.0004 degrees of the planned motion.
    let max = settings().tolerance_deg + 4e-4;
    let (mut low, mut high) = (0.0f64, 1.0f64);
    for k in 3..5 {
        let off = at[k] - from[k];
        if along[k] == 0.0 {
            if off.abs() > max {
                return f64::INFINITY;
            }
            continue;
        }
        let ends = [(off - max) / along[k], (off + max) / along[k]];
        low = low.max(ends[0].min(ends[1]));
        high = high.min(ends[0].max(ends[1]));
    }
    if low > high {
        return f64::INFINITY;
    }
    let squared: f64 = along[..3].iter().map(|part| part * part).sum();
    let done: f64 = (0..3).map(|k| (at[k] - from[k]) * along[k]).sum();
    let share = (done / squared).clamp(low, high);
    let off = (0..3).map(|k| (at[k] - from[k] - share * along[k]).powi(2));
    off.sum::<f64>().sqrt()
}

/// A place by the length of the way to it, about 1 mm a unit.
type Curve = fn(f64) -> [f64; 2];

/// A plan of 10,000 blocks of 0.1 mm on a curve. Coordinates have four decimals.
fn short_blocks(mode: &str, feed: f64, place: Curve) -> Plan {
    let at = |number: u32| place(f64::from(number) * 0.1);
    let [x, y] = at(0);
    let mut text = format!("G0 X{x:.4} Y{y:.4} Z25\n{mode}\nG1 F{feed}\n");
    for number in 1..=10_000 {
        let [x, y] = at(number);
        text += &format!("X{x:.4} Y{y:.4}\n");
    }
    let options = Options::of_letters("XYZBA", HOME);
    let program = read("t", text.as_bytes(), &options).expect("readable");
    Plan::new(&program, &settings(), &H4).expect("possible")
}

/// Speeds of the setpoints, but those of the first and the last blocks, mm/s.
fn speeds(plan: &Plan) -> Vec<f64> {
    let all = spans(plan);
    let moved = all.iter().enumerate();
    let moved = moved.filter(|(index, _)| (200..9_800).contains(&plan.line_of(*index)));
    moved
        .map(|(_, span)| {
            let moved = [0, 1, 2].map(|k| span.axes[k].p[1] - span.axes[k].p[0]);
            moved.iter().map(|part| part * part).sum::<f64>().sqrt() / span.axes[0].t
        })
        .collect()
}

/// A circle of 20 mm radius, and loops whose radius changes between 20 and 30 mm.
fn curves() -> [(&'static str, Curve); 2] {
    [
        ("circle", |s| {
            let angle = s / 20.0;
            [20.0 * angle.cos(), 20.0 * angle.sin()]
        }),
        ("loops", |s| {
            let angle = s / 25.0;
            let radius = 25.0 + 5.0 * (0.7 * angle).cos();
            [radius * angle.cos(), radius * angle.sin()]
        }),
    ]
}

/// Thousands of short blocks that are not joined have the programmed feed from the first to the
/// last one, where each takes 25 ms.
#[test]
fn thousands_of_short_blocks_keep_their_feed() {
    for (name, place) in curves() {
        let speeds = speeds(&short_blocks("G64 Q0", 240.0, place));
        let min = speeds.iter().copied().fold(f64::INFINITY, f64::min);
        println!("{name}: at least {min} mm/s in {} setpoints", speeds.len());
        assert!(speeds.len() > 1000, "{name}");
        assert!(min > 0.97 * 4.0, "{name}: {min} mm/s");
    }
}

/// A larger P takes less time.
#[test]
fn p_of_g64_is_used() {
    let [fine, rough] = ["G64 P0.001", "G64 P0.3"].map(|mode| {
        let corners = "G1 F2400 X10\nY10\nX0\nY0\nX10\nY10\n";
        let (_, plan) = plan(&format!("G0 X0 Y0 Z25\n{mode}\n{corners}"), &settings());
        plan.figures.duration_s
    });
    assert!(rough < 0.9 * fine, "{rough} s, with the smaller P {fine} s");
}

/// Short blocks are joined, with Q within Q and without it within half of P, and then have a feed
/// that each of them is too short for. The motion stays within P and Q, or P, of the programmed
/// lines.
#[test]
fn joined_blocks_reach_their_feed() {
    let modes = ["G64 P0.003 Q0.002", "G64 P0.005", "G64"];
    for ((name, place), mode) in curves()
        .into_iter()
        .flat_map(|curve| modes.map(|mode| (curve, mode)))
    {
        let plan = short_blocks(mode, 1500.0, place);
        assert_eq!(plan.figures.blocks, 10_001, "{name}");
        let speeds = speeds(&plan);
        let min = speeds.iter().copied().fold(f64::INFINITY, f64::min);
        println!(
            "{name}, {mode}: at least {min} mm/s in {} setpoints",
            speeds.len()
        );
        assert!(speeds.len() > 100, "{name}");
        let mean = speeds.iter().sum::<f64>() / speeds.len() as f64;
        assert!(
            min > 0.8 * 25.0 && mean > 0.95 * 25.0,
            "{name}: {min}, {mean} mm/s"
        );
        check_limits(&plan, &settings(), name);
        check_steps(&plan, &settings(), name);
        let point = |number: usize| {
            let [x, y] = place(number as f64 * 0.1).map(|part| (part * 1e4).round() / 1e4);
            [x, y, 25.0]
        };
        // The motion follows the lines in order, from the first to the last one.
        let mut next = 0;
        for (index, span) in spans(&plan).iter().enumerate() {
            if plan.line_of(index) < 4 {
                continue;
            }
            for at in places(span) {
                let off = |line: usize| distance(at, point(line), point(line + 1));
                let near = (next..(next + 100).min(10_000)).find(|line| off(*line) <= 0.0054);
                let Some(near) = near else {
                    panic!("{name}: {at:?} is beyond P and Q of the program after line {next}");
                };
                next = near;
            }
            // The place is that of the motion towards the setpoint: here the line at its end, or
            // the one before. The first line has number 4.
            let line = plan.line_of(index) as usize - 4;
            assert!(line.abs_diff(next) <= 1, "{name}: line {line} at {next}");
        }
        assert!(next > 9_990, "{name} ends at {next}");
    }
}

/// Short blocks of five coordinates are joined: the tip is within P of the program, and the rotary
/// coordinates are within their tolerance there.
#[test]
fn joined_blocks_of_five_axes_reach_their_feed() {
    let point = |number: usize| -> Coordinates {
        let turn = number as f64 * 0.1 / 20.0;
        let [x, y] = [20.0 * turn.cos(), 18.0 * turn.sin()];
        let [z, b, a] = [
            25.0 + 5.0 * (0.8 * turn).sin(),
            8.0 * (0.5 * turn).sin(),
            6.0 * (0.3 * turn).cos(),
        ];
        [x, y, z, b, a, 0.0].map(|part| (part * 1e5).round() / 1e5)
    };
    let made = |mode: &str| {
        let mut text = String::new();
        for number in 0..=10_000 {
            let [x, y, z, b, a, _] = point(number);
            let head = if number == 0 { "G0 " } else { "" };
            text += &format!("{head}X{x:.5} Y{y:.5} Z{z:.5} B{b:.5} A{a:.5}\n");
            if number == 0 {
                text += &format!("{mode}\nG1 F1200\n");
            }
        }
        let options = Options::of_letters("XYZBA", HOME);
        let program = read("t", text.as_bytes(), &options).expect("readable");
        Plan::new(&program, &settings(), &H4).expect("possible")
    };
    let min = |plan: &Plan| speeds(plan).into_iter().fold(f64::INFINITY, f64::min);
    let apart = min(&made("G64 Q0"));
    let plan = made("G64 P0.005");
    let joined = min(&plan);
    println!("five axes: at least {joined} mm/s, {apart} mm/s with Q0");
    assert!(
        joined > 0.9 * 20.0 && apart < 6.0,
        "{joined} and {apart} mm/s"
    );
    assert_eq!(plan.figures.blocks, 10_001);
    check_limits(&plan, &settings(), "five axes");
    check_steps(&plan, &settings(), "five axes");
    let mut next = 0;
    for (index, span) in spans(&plan).iter().enumerate() {
        if plan.line_of(index) < 4 {
            continue;
        }
        for at in poses(span) {
            let is_near =
                |line: &usize| off_turning_line(&at, &point(*line), &point(*line + 1)) <= 0.0054;
            let near = (next..(next + 100).min(10_000)).find(is_near);
            let Some(near) = near else {
                panic!("{at:?} is beyond the tolerances after line {next}");
            };
            next = near;
        }
    }
    assert!(next > 9_990, "ends at {next}");
}

/// Blocks around a corner are joined no farther than Q, and a stop, another feed or a message is
/// joined to nothing.
#[test]
fn blocks_are_joined_within_q_only() {
    let time = |text: &str| {
        let (program, made) = plan(text, &settings());
        let blocks = program.steps.iter();
        let blocks = blocks.filter(|step| matches!(step, haptimill_gcode::Step::Move(_)));
        assert_eq!(made.figures.blocks, blocks.count(), "{text}");
        made.figures.duration_s
    };
    let lines = |mode: &str, word: &str| {
        let at = |k: u32| format!("X{:.4} {word}\n", f64::from(k) * 0.05);
        let head = format!("G0 X0 Y0 Z25\n{mode}\nG1 F1200\n");
        head + &(1..400).map(at).collect::<String>()
    };
    let apart = time(&lines("G64 Q0", ""));
    let joined = time(&lines("G64 Q0.001", ""));
    // 20 mm at 20 mm/s.
    assert!(apart > 4.0 && joined < 1.6, "{apart} s and {joined} s");
    let messages = time(&lines("G64 Q0.001", "(MSG, here)"));
    assert!((messages - apart).abs() < 0.05, "{messages} s");
    let stops = time(&lines("G61", ""));
    assert!(stops > apart);
    // A corner of 90 degrees in blocks of 0.05 mm stays within P and Q.
    let mut text = String::from("G0 X0 Y0 Z25\nG64 P0.002 Q0.003\nG1 F1200\n");
    for k in 1..=200 {
        let done = f64::from(k) * 0.05;
        text += &format!("X{:.4} Y{:.4}\n", done.min(5.0), (done - 5.0).max(0.0));
    }
    let (_, made) = plan(&text, &settings());
    for (index, span) in spans(&made).iter().enumerate() {
        if made.line_of(index) < 4 {
            continue;
        }
        for at in places(span) {
            let off = distance(at, [0.0, 0.0, 25.0], [5.0, 0.0, 25.0]);
            let off = off.min(distance(at, [5.0, 0.0, 25.0], [5.0, 5.0, 25.0]));
            assert!(off <= 0.0054, "{at:?} is {off} mm off");
        }
    }
    assert!(
        made.figures.duration_s < 1.5,
        "{} s",
        made.figures.duration_s
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    /// A path that touches its soft limits is accepted, and stays within what the controller
    /// allows beyond them, between its setpoints, too.
    #[test]
    fn a_frame_along_the_soft_limits_stays_within_them(
        radius in 0.5..12.0f64,
        feed in 300.0..3600.0f64,
        mode in prop_oneof![Just("G61"), Just("G64"), Just("G64 P0.05"), Just("G64 P1")],
    ) {
        let mut settings = settings();
        (settings.pose[0].low, settings.pose[0].high) = (-30.0, 30.0);
        (settings.pose[1].low, settings.pose[1].high) = (-20.0, 20.0);
        let radius = (radius * 1e3).round() / 1e3;
        let (x, y) = (30.0 - radius, 20.0 - radius);
        let text = format!(
            "{mode} F{feed:.1}\nG0 Z30\nG1 X30 Y-{y:.3}\nG1 Y{y:.3}\nG3 X{x:.3} Y20 I-{radius:.3}\n\
             G1 X-{x:.3}\nG3 X-30 Y{y:.3} J-{radius:.3}\nG1 Y-{y:.3}\nG3 X-{x:.3} Y-20 I{radius:.3}\n\
             G1 X{x:.3}\nG3 X30 Y-{y:.3} J{radius:.3}\nG3 X30 Y-{y:.3} I-{radius:.3}\nG1 Z31\n"
        );
        let (_, plan) = plan(&text, &settings);
        let limits = [30.0, 20.0].map(|limit| limit + 0.001);
        for setpoint in &plan.setpoints {
            for ((place, axis), limit) in setpoint.pose.iter().zip(&settings.pose).zip(limits) {
                let place = f64::from(*place) / axis.units;
                prop_assert!(place.abs() <= limit, "{place}\n{text}");
            }
        }
        for [x, y, _] in spans(&plan).iter().flat_map(places) {
            prop_assert!(x.abs() <= limits[0] && y.abs() <= limits[1], "{x} {y}\n{text}");
        }
    }
}
