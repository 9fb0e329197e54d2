//! Properties of plans of random programs.

use crate::h4::{H4, HOME, settings};
use crate::spans::{Cubic, Span, spans, unit};
use haptimill_gcode::{Coordinates, Options, Program, Step, read};
use haptimill_planner::{Cursor, MachineModel, Plan, Settings};
use proptest::prelude::*;

pub fn program(text: &str) -> Program {
    match read(
        "test.ngc",
        text.as_bytes(),
        &Options::of_letters("XYZBA", HOME),
    ) {
        Ok(program) => program,
        Err(refused) => panic!("{refused}\n{text}"),
    }
}

pub fn plan(text: &str, settings: &Settings) -> (Program, Plan) {
    let program = program(text);
    match Plan::new(&program, settings, &H4) {
        Ok(plan) => (program, plan),
        Err(refused) => panic!("{refused}\n{text}"),
    }
}

/// A polyline with moves of all lengths and directions, some of them short, some nearly collinear.
pub fn polyline() -> impl Strategy<Value = String> {
    let step = (
        prop_oneof![0.001..0.05f64, 0.05..1.0f64, 1.0..25.0f64],
        0.0..std::f64::consts::TAU,
        -1.0..1.0f64,
        prop::bool::weighted(0.3),
        -1.0..1.0f64,
        -1.0..1.0f64,
    );
    (prop::collection::vec(step, 1..30), 30.0..1500.0f64, 0u8..3).prop_map(|(steps, feed, kind)| {
        let mut text = format!("G0 X0 Y0 Z25 ; down\nG1 F{feed:.1}\n");
        let (mut x, mut y, mut direction) = (0.0f64, 0.0f64, 0.0f64);
        let (mut b, mut a) = (0.0f64, 0.0f64);
        for (length, turn, z, tilts, db, da) in steps {
            direction += if kind == 0 { turn } else { 0.05 * (turn - 3.0) };
            let next = (x + length * direction.cos(), y + length * direction.sin());
            if next.0.abs() > 40.0 || next.1.abs() > 40.0 {
                direction += std::f64::consts::PI;
                continue;
            }
            (x, y) = next;
            text += &format!("X{x:.4} Y{y:.4} Z{:.4}", 25.0 + z * length.min(5.0));
            if tilts || kind == 2 {
                // A feed that the rotary axes cannot follow is refused, which other tests check.
                b = (b + 0.5 * db * length.min(10.0)).clamp(-10.0, 10.0);
                a = (a + 0.5 * da * length.min(10.0)).clamp(-10.0, 10.0);
                text += &format!(" B{b:.4} A{a:.4}");
            }
            text += "\n";
        }
        text
    })
}

/// Lines and tangent or cornering arcs.
pub fn contour() -> impl Strategy<Value = String> {
    let piece = (0u8..4, 0.5..12.0f64, 5.0..340.0f64, any::<bool>());
    (prop::collection::vec(piece, 1..12), 60.0..1200.0f64, 0u8..3).prop_map(
        |(pieces, feed, plane)| {
            let (word, first, second, i, j) = [
                ("G17", 'X', 'Y', 'I', 'J'),
                ("G18", 'Z', 'X', 'K', 'I'),
                ("G19", 'Y', 'Z', 'J', 'K'),
            ][usize::from(plane)];
            let mut text = format!("{word} G0 X0 Y0 Z30\nF{feed:.1}\n");
            let (mut x, mut y) = if plane == 0 {
                (0.0f64, 0.0f64)
            } else if plane == 1 {
                (30.0, 0.0)
            } else {
                (0.0, 30.0)
            };
            let middle = (x, y);
            let mut heading = 0.3f64;
            for (kind, size, degrees, left) in pieces {
                let off = ((x - middle.0).powi(2) + (y - middle.1).powi(2)).sqrt();
                if kind == 0 || off > 20.0 {
                    if off > 20.0 {
                        heading = (middle.1 - y).atan2(middle.0 - x);
                    }
                    x += size * heading.cos();
                    y += size * heading.sin();
                    text += &format!("G1 {first}{x:.6} {second}{y:.6}\n");
                    continue;
                }
                if kind == 3 {
                    heading += 0.7;
                }
                let side = if left { 1.0 } else { -1.0 };
                let radius = 0.3 * size;
                let (cx, cy) = (
                    x - side * radius * heading.sin(),
                    y + side * radius * heading.cos(),
                );
                let turn = side * degrees.to_radians();
                let (dx, dy) = (x - cx, y - cy);
                x = cx + dx * turn.cos() - dy * turn.sin();
                y = cy + dx * turn.sin() + dy * turn.cos();
                heading += turn;
                text += &format!(
                    "G{} {first}{x:.6} {second}{y:.6} {i}{:.6} {j}{:.6}\n",
                    if left { 3 } else { 2 },
                    -dx,
                    -dy
                );
            }
            text
        },
    )
}

/// Checks rates, accelerations and jerks of the cubics against the limits plus the rounding to
/// units.
pub fn check_limits(plan: &Plan, settings: &Settings, text: &str) {
    for (index, span) in spans(plan).iter().enumerate() {
        for (k, (cubic, axis)) in span.axes.iter().zip(&settings.pose).enumerate() {
            let t = cubic.t;
            // Half a unit at each end: of the pose, and of the rate (256 units).
            let (step, rate) = (unit(k), 128.0 * unit(k));
            let acceleration = 6.0 * step / (t * t) + 6.0 * rate / t;
            let jerk = 12.0 * step / (t * t * t) + 12.0 * rate / (t * t);
            let [a, b] = cubic.acceleration();
            let place = plan.place_of(index);
            assert!(
                cubic.peak_rate() <= axis.rate + rate + step / t,
                "rate {} in {place:?}\n{text}",
                cubic.peak_rate()
            );
            let largest = a.abs().max(b.abs());
            assert!(
                largest <= axis.acceleration + acceleration,
                "acceleration {largest} of {k} over {t} s in {place:?}\n{text}"
            );
            let found = cubic.jerk().abs();
            assert!(
                found <= axis.jerk + jerk,
                "jerk {found} of {k} over {t} s at {} in {place:?}\n{text}",
                span.start
            );
        }
    }
}

/// Checks that the mean accelerations of neighbouring spans differ by no more than the jerk limit
/// allows in the time between their middles: a step of acceleration between two spans is no jerk of
/// either.
pub fn check_steps(plan: &Plan, settings: &Settings, text: &str) {
    for pair in spans(plan).windows(2) {
        for (k, axis) in settings.pose.iter().enumerate() {
            let [before, after] = [&pair[0].axes[k], &pair[1].axes[k]];
            let mean = |cubic: &Cubic| (cubic.v[1] - cubic.v[0]) / cubic.t;
            let rate = 256.0 * unit(k);
            let rounding = rate / before.t + rate / after.t;
            let max = axis.jerk * 0.5 * (before.t + after.t) + rounding;
            let step = (mean(after) - mean(before)).abs();
            assert!(
                step <= max,
                "acceleration of {k} steps by {step}, {max} allowed, at {}\n{text}",
                pair[1].start
            );
        }
    }
}

/// Checks that the cubics are the planned motion within 0.2 um plus rounding, and stay within the
/// tolerance of the programmed path.
fn check_motion(plan: &Plan, settings: &Settings, text: &str) {
    let (mut cursor, mut programmed) = (Cursor::default(), Cursor::default());
    for span in spans(plan) {
        for i in 0..=8 {
            let u = f64::from(i) / 8.0;
            let time = span.start + u * span.axes[0].t;
            let (pose, _) = plan.intended(&mut cursor, time);
            let mut done = [0.0; 6];
            for (k, cubic) in span.axes.iter().enumerate() {
                done[k] = cubic.at(u);
                let rounding = unit(k) * (0.5 + 128.0 * 0.25 * cubic.t);
                assert!(
                    (done[k] - pose[k]).abs() <= 2e-4 + rounding,
                    "coordinate {k} at {time}: {} for {}\n{text}",
                    done[k],
                    pose[k]
                );
            }
            let exact = plan.programmed(&mut programmed, time);
            let off: f64 = (0..3)
                .map(|k| (exact[k] - done[k]).powi(2))
                .sum::<f64>()
                .sqrt();
            assert!(
                off <= settings.tolerance_mm + 5e-4,
                "{off} mm from the program at {time}\n{text}"
            );
            assert!(
                (3..5).all(|k| (exact[k] - done[k]).abs() <= settings.tolerance_deg + 5e-4),
                "angles at {time}\n{text}"
            );
        }
    }
}

/// Smallest distance of a span to a point.
fn nearest(span: &Span, point: &Coordinates) -> f64 {
    let off = |u: f64| {
        (0..3)
            .map(|k| (span.axes[k].at(u) - point[k]).powi(2))
            .sum::<f64>()
            .sqrt()
    };
    let best = (0..=20)
        .map(|i| f64::from(i) / 20.0)
        .min_by(|a, b| off(*a).total_cmp(&off(*b)))
        .unwrap_or(0.0);
    let (mut low, mut high) = ((best - 0.05).max(0.0), (best + 0.05).min(1.0));
    for _ in 0..40 {
        let third = (high - low) / 3.0;
        if off(low + third) < off(high - third) {
            high -= third
        } else {
            low += third
        }
    }
    off(0.5 * (low + high))
}

/// Checks that the motion passes every programmed end point in order within the tolerance, and ends
/// at standstill at the last one.
fn check_ends(program: &Program, plan: &Plan, settings: &Settings, text: &str) {
    let spans = spans(plan);
    let mut from = 0;
    let mut length = 0.0;
    for step in &program.steps {
        let Step::Move(step) = step else { continue };
        length += step.path.tip_length();
        let passed = |span: &Span| nearest(span, &step.path.to) <= settings.tolerance_mm + 1e-3;
        let Some(further) = spans[from..].iter().position(passed) else {
            panic!("the end of line {} is not passed\n{text}", step.place.line);
        };
        from += further;
    }
    assert!((plan.figures.path_length_mm - length).abs() < 1e-9 * length.max(1.0));
    let last = plan.setpoints.last().expect("a setpoint");
    assert!(
        last.rates.iter().all(|&rate| rate == 0),
        "the motion does not end at standstill"
    );
    if let Some(Step::Move(step)) = program
        .steps
        .iter()
        .rev()
        .find(|step| matches!(step, Step::Move(_)))
    {
        for k in 0..5 {
            assert!(
                (f64::from(last.pose[k]) * unit(k) - step.path.to[k]).abs() <= 0.51 * unit(k),
                "the last setpoint is not the programmed end"
            );
        }
    }
}

fn check_spans(plan: &Plan, settings: &Settings) {
    let mut line = 0;
    for (index, setpoint) in plan.setpoints.iter().enumerate() {
        assert!(setpoint.periods >= 1);
        let moves = setpoint.rates.iter().any(|&rate| rate != 0);
        if moves {
            assert!(f64::from(setpoint.periods) * plan.period_s <= settings.longest_span_s + 1e-9);
        }
        assert!(
            plan.line_of(index) >= line,
            "setpoint {index} goes back in the program"
        );
        line = plan.line_of(index);
    }
}

fn check(text: &str, settings: &Settings) {
    let (program, plan) = plan(text, settings);
    check_limits(&plan, settings, text);
    check_steps(&plan, settings, text);
    check_motion(&plan, settings, text);
    check_ends(&program, &plan, settings, text);
    check_spans(&plan, settings);
    let again = Plan::new(&program, settings, &H4).expect("planned before");
    assert_eq!(
        plan.setpoints, again.setpoints,
        "the plan is not deterministic"
    );
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, cases: 96, ..ProptestConfig::default() })]

    #[test]
    fn polylines_have_all_properties(text in polyline()) {
        check(&text, &settings());
    }

    #[test]
    fn exact_stops_have_all_properties(text in polyline()) {
        let settings = Settings { tolerance_mm: 0.0, tolerance_deg: 0.0, ..settings() };
        check(&text, &settings);
    }

    #[test]
    fn contours_have_all_properties(text in contour()) {
        check(&text, &settings());
    }

    /// The planned rates, differentiated numerically, keep the jerk limits of tip and joints,
    /// where a line meets an arc as well.
    #[test]
    fn contours_keep_the_jerk_limits_everywhere(text in contour()) {
        let settings = settings();
        let (_, plan) = plan(&text, &settings);
        let mut cursor = Cursor::default();
        let h = 5e-4;
        let mut t = h;
        while t < plan.figures.duration_s - h {
            let motion = [t - h, t, t + h].map(|t| plan.intended(&mut cursor, t));
            let second = |values: [f64; 3]| {
                (values[2] - 2.0 * values[1] + values[0]).abs() / (h * h)
            };
            for (k, axis) in settings.pose.iter().enumerate() {
                let jerk = second([0, 1, 2].map(|n| motion[n].1[k]));
                prop_assert!(jerk <= axis.jerk * 1.01, "{} {jerk} at {t}\n{text}", axis.letter);
            }
            let rates = motion.map(|(pose, rates)| H4.joint_rates(&pose, &rates));
            for (k, joint) in settings.joints.iter().enumerate() {
                let jerk = second([0, 1, 2].map(|n| rates[n][k]));
                prop_assert!(jerk <= joint.jerk * 1.01, "{} {jerk} at {t}\n{text}", joint.name);
            }
            t += h;
        }
    }

    /// The joint positions, differentiated numerically, keep their limits.
    #[test]
    fn joints_keep_their_limits(text in polyline()) {
        let settings = settings();
        let (_, plan) = plan(&text, &settings);
        let mut cursor = Cursor::default();
        let h = 1e-3;
        let mut t = h;
        while t < plan.figures.duration_s {
            let l: Vec<[f64; 6]> = [t - h, t, t + h].iter().map(|&t| H4.joints(&plan.intended(&mut cursor, t).0).expect("checked")).collect();
            for (k, joint) in settings.joints.iter().enumerate() {
                let rate = (l[2][k] - l[0][k]).abs() / (2.0 * h);
                let acceleration = (l[2][k] - 2.0 * l[1][k] + l[0][k]).abs() / (h * h);
                prop_assert!(rate <= joint.rate * 1.001, "{} {rate} at {t}\n{text}", joint.name);
                prop_assert!(acceleration <= joint.acceleration * 1.01, "{} {acceleration} at {t}\n{text}", joint.name);
            }
            let l: Vec<[f64; 6]> = [-1.5, -0.5, 0.5, 1.5].iter().map(|&n| H4.joints(&plan.intended(&mut cursor, (t + n * h).max(0.0)).0).expect("checked")).collect();
            for (k, joint) in settings.joints.iter().enumerate() {
                let jerk = (l[3][k] - 3.0 * l[2][k] + 3.0 * l[1][k] - l[0][k]).abs() / (h * h * h);
                prop_assert!(jerk <= joint.jerk * 1.02, "{} jerk {jerk} at {t}\n{text}", joint.name);
            }
            t += 7.3 * h;
        }
    }
}

/// Rapids and cuts between poses of the whole workspace: the joint rates of the interpolated
/// setpoints. The controller refuses 1.02 of the maximum.
#[test]
fn setpoints_command_no_joint_more_than_its_maximum_rate() {
    let settings = settings();
    let mut random = 7_u64;
    let mut uniform = |low: f64, high: f64| {
        random ^= random >> 12;
        random ^= random << 25;
        random ^= random >> 27;
        let bits = random.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 11;
        low + (high - low) * bits as f64 / (1_u64 << 53) as f64
    };
    let (mut planned, mut binding, mut worst) = (0, 0, 0.0_f64);
    for _ in 0..300 {
        let mut text = String::from("G0 X0 Y0 Z25\nF600\n");
        for _ in 0..4 {
            let word = if uniform(0.0, 1.0) < 0.7 { "G0" } else { "G1" };
            text += &format!(
                "{word} X{:.3} Y{:.3} Z{:.3} B{:.3} A{:.3}\n",
                uniform(-100.0, 100.0),
                uniform(-80.0, 80.0),
                uniform(-40.0, 100.0),
                uniform(-20.0, 20.0),
                uniform(-20.0, 20.0)
            );
        }
        // Programs outside the workspace, or with an excessive feed, are refused, which other tests
        // check.
        let program = program(&text);
        let Ok(plan) = Plan::new(&program, &settings, &H4) else {
            continue;
        };
        planned += 1;
        let mut max = 0.0_f64;
        for span in spans(&plan) {
            let at = |u: f64| {
                let mut pose = [0.0; 6];
                for (place, cubic) in pose.iter_mut().zip(&span.axes) {
                    *place = cubic.at(u);
                }
                H4.joints(&pose).expect("planned")
            };
            let h = 1e-3;
            for i in 0..=16 {
                let u = f64::from(i) / 16.0;
                let (back, ahead) = (at(u - h), at(u + h));
                for (k, joint) in settings.joints.iter().enumerate() {
                    let rate = (ahead[k] - back[k]).abs() / (2.0 * h * span.axes[0].t);
                    max = max.max(rate / joint.rate);
                }
            }
        }
        binding += u32::from(max > 0.95);
        worst = worst.max(max);
        assert!(max <= 1.005, "{max} of the maximum rate\n{text}");
    }
    println!("{planned} planned, {binding} near a maximum, at most {worst} of it");
    assert!(
        planned >= 60 && binding >= 15,
        "{planned} planned, {binding} near a maximum"
    );
}
