//! Motion of the codes: cycles, offsets, compensation, splines, feeds, probing.

use super::*;
use haptimill_gcode::Interpreter;
use std::io::Cursor;

#[test]
fn cycles_make_the_motion_of_rs274() {
    // Printed by LinuxCNC's rs274 for the same programs.
    assert_eq!(
        ends("F100\nG0 Z5\nG99 G81 X1 Y1 Z-3 R2\nG98 X2\nX3"),
        [
            ('T', [0., 0., 5.]),
            ('T', [1., 1., 5.]),
            ('T', [1., 1., 2.]),
            ('F', [1., 1., -3.]),
            ('T', [1., 1., 2.]),
            ('T', [2., 1., 2.]),
            ('F', [2., 1., -3.]),
            ('T', [2., 1., 5.]),
            ('T', [3., 1., 5.]),
            ('T', [3., 1., 2.]),
            ('F', [3., 1., -3.]),
            ('T', [3., 1., 5.]),
        ]
    );
    assert_eq!(
        ends("F100\nG73 X1 Y1 Z-3 R2 Q2"),
        [
            ('T', [0., 0., 2.]),
            ('T', [1., 1., 2.]),
            ('F', [1., 1., 0.]),
            ('T', [1., 1., 0.254]),
            ('F', [1., 1., -2.]),
            ('T', [1., 1., -1.746]),
            ('F', [1., 1., -3.]),
            ('T', [1., 1., 2.]),
        ]
    );
    assert_eq!(
        ends("F100\nG91 G81 X1 Y1 Z-3 R2 L3"),
        [
            ('T', [0., 0., 2.]),
            ('T', [1., 1., 2.]),
            ('F', [1., 1., -1.]),
            ('T', [1., 1., 2.]),
            ('T', [2., 2., 2.]),
            ('F', [2., 2., -1.]),
            ('T', [2., 2., 2.]),
            ('T', [3., 3., 2.]),
            ('F', [3., 3., -1.]),
            ('T', [3., 3., 2.]),
        ]
    );
}

#[test]
fn tapping_reverses_the_spindle() {
    let speeds: Vec<i16> = steps_with("F100 S500 M3\nG84 X1 Y1 Z-3 R2", &options())
        .iter()
        .filter_map(|step| match step {
            Step::Spindle { rpm, .. } => Some(*rpm),
            _ => None,
        })
        .collect();
    assert_eq!(speeds, [500, -500, 500]);
    let stopped = refusal("F100 S500 M4\nG84 X1 Z-3 R2");
    assert!(stopped.contains("does not turn clockwise"), "{stopped}");
}

/// M49 and M50 P0 switch the overrides off for moves at feed; tapping has none.
#[test]
fn overrides_are_off_where_the_program_says_so() {
    let fixed = |text: &str| -> String {
        let steps = steps_with(text, &options());
        let moves = steps.iter().filter_map(|step| match step {
            Step::Move(step) => Some(if step.fixed { 'f' } else { '-' }),
            _ => None,
        });
        moves.collect()
    };
    let moves = "G1 X1\nG2 X3 I1\nG0 X4\n";
    let off_and_on = |off, on| format!("F100\n{moves}{off}\n{moves}{on}\n{moves}");
    for (off, on) in [("M49", "M48"), ("M50 P0", "M50 P1"), ("M50 P0", "M50")] {
        assert_eq!(fixed(&off_and_on(off, on)), "---ff----", "{off} {on}");
    }
    assert_eq!(fixed(&off_and_on("M51 P0", "M53 P0")), "---------");
    // Rapid to the place and to R, down, up; the same in every hole.
    assert_eq!(fixed("F100 S500 M3\nG84 X1 Y1 Z-3 R2"), "--ff");
    assert_eq!(fixed("F100 S500 M4\nG74 X1 Y1 Z-3 R2 L2"), "--ffff");
    assert_eq!(fixed("F100 S500 M3\nG81 X1 Y1 Z-3 R2"), "----");
}

#[test]
fn offsets_shift_and_turn() {
    // Positions of the machine; rs274 prints the same in program coordinates.
    assert_eq!(
        ends("G10 L2 P1 X1 Y2 Z3\nG0 X1 Y1 Z1\nG53 G0 X0\nG55 X0 Y0"),
        [
            ('T', [2., 3., 4.]),
            ('T', [0., 3., 4.]),
            ('T', [0., 0., 4.])
        ]
    );
    let turned = ends("G10 L2 P1 X1 Y1 R90\nG0 X2 Y0\nG91 X1\nG90 Y1");
    assert_eq!(
        turned,
        [
            ('T', [1., 3., 0.]),
            ('T', [1., 4., 0.]),
            ('T', [0., 4., 0.])
        ]
    );
    assert_eq!(
        ends("G0 X5 Y5 Z5\nG92 X1\nG0 X2\nG92.1\nG0 X1\nG10 L20 P1 X0\nG0 X2"),
        [
            ('T', [5., 5., 5.]),
            ('T', [6., 5., 5.]),
            ('T', [1., 5., 5.]),
            ('T', [3., 5., 5.]),
        ]
    );
    assert_eq!(
        ends("G0 X5 Y5 Z5\nG28 Z6\nG28\nG0 X3\nG28.1\nG0 X8 Y1\nG28 X1"),
        [
            ('T', [5., 5., 5.]),
            ('T', [5., 5., 6.]),
            ('T', [5., 5., 0.]),
            ('T', [0., 0., 0.]),
            ('T', [3., 0., 0.]),
            ('T', [8., 1., 0.]),
            ('T', [1., 1., 0.]),
            ('T', [3., 1., 0.]),
        ]
    );
}

#[test]
fn tool_lengths_come_from_the_table() {
    let mut options = options();
    let tool = Tool {
        offset: [0., 0., 12., 0., 0., 0., 0., 0., 0.],
        diameter: 6.,
    };
    options.tools.insert(1, tool);
    let z = |text: &str| {
        let steps = steps_with(text, &options);
        steps.iter().rev().find_map(|step| match step {
            Step::Move(step) => Some(step.path.to[2]),
            _ => None,
        })
    };
    assert_eq!(z("T1 M6\nG43\nG0 Z1"), Some(13.));
    assert_eq!(z("G43 H1\nG0 Z1\nG49\nZ2"), Some(2.));
    assert_eq!(z("G43.1 Z3\nG0 Z1"), Some(4.));
    let missing = read("t.ngc", b"T2 M6", &options).unwrap_err().to_string();
    assert!(missing.contains("tool 2 is not in the tool table"));
}

/// The end of a move in the coordinates of its program: with origin, rotation, G92 and tool length.
#[test]
fn a_move_has_its_end_as_programmed() {
    let text = "G10 L2 P1 X100 Y-50 Z7 R30\nG54\nG43.1 Z12\nG0 X1 Y2 Z3\nG92 X0\nG1 X4 F100\n";
    for (step, [x, y, z]) in moves(text).iter().zip([[1., 2., 3.], [4., 2., 3.]]) {
        for (found, expected) in step.programmed.iter().zip([x, y, z]) {
            assert!((found - expected).abs() < 1e-9, "{:?}", step.programmed);
        }
    }
}

#[test]
fn compensation_with_a_diameter_of_zero_is_said() {
    let text = b"F100\nG0 X-5\nG41.1 D0\nG1 X0\nY10\nG40\nG0 X-5\n";
    let program = read("t.ngc", text, &options()).expect("a program");
    let notice = &program.notices[0];
    assert_eq!((notice.place.line, notice.place.column), (3, 1));
    assert!(
        notice.what.contains("G41.1: the diameter of the tool is 0"),
        "{notice:?}"
    );
}

#[test]
fn compensation_goes_around_outside_and_cuts_inside_corners() {
    // A square of 10 mm, clockwise, the cutter of radius 1 outside on the left.
    let outside = ends("F100\nG0 X-5 Y-5\nG41.1 D2\nG1 X0 Y0\nY10\nX10\nY0\nX0\nG40\nG0 X-5 Y-5\n");
    assert!(outside.contains(&('F', [-1., 10., 0.])), "{outside:?}");
    assert!(outside.contains(&('A', [0., 11., 0.])));
    assert!(outside.contains(&('F', [10., 11., 0.])));
    assert_eq!(outside.last(), Some(&('T', [-5., -5., 0.])));
    let inside = ends("F100\nG0 X5 Y-5\nG42.1 D2\nG1 X0 Y0\nY10\nX10\nY0\nX1\nG40\nG0 X5 Y5\n");
    assert!(inside.contains(&('F', [1., 9., 0.])), "{inside:?}");
    assert!(inside.contains(&('F', [9., 9., 0.])));
    let narrow = refusal("F100\nG42.1 D8\nG1 X10 Y0\nY10\nX12\nY0\n");
    assert!(
        narrow.contains("cannot reach this inside corner"),
        "{narrow}"
    );
    let short = refusal("F100\nG41.1 D8\nG1 X3\n");
    assert!(short.contains("not longer than the radius"), "{short}");
}

#[test]
fn splines_are_within_their_tolerance() {
    let path = moves("F100\nG5 X10 Y0 I3 J8 P-3 Q-8\n");
    assert!(path.len() > 4);
    let end = path.last().expect("moves").path.to;
    assert!((end[0] - 10.).abs() < 1e-9 && end[1].abs() < 1e-9);
    // The middle of the cubic is at its parameter 1/2.
    let middle = [5.0, 0.0];
    let places = path.iter().flat_map(|step| {
        let parts = (0..=1000).map(|part| step.path.length * f64::from(part) / 1000.);
        parts.map(|length| step.path.at(length))
    });
    let nearest = places
        .map(|at| (at[0] - middle[0]).hypot(at[1] - middle[1]))
        .fold(f64::INFINITY, f64::min);
    assert!(nearest < 0.0006, "{nearest}");
    // Tangents are continuous.
    for pair in path.windows(2) {
        let (one, two) = (&pair[0].path, &pair[1].path);
        let (a, b) = (one.tangent(one.length), two.tangent(0.));
        assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 1e-4, "{a:?} {b:?}");
    }
    // A NURBS with a weight that makes it a quarter of a circle.
    let quarter = moves("F100\nG0 X10\nG5.2 P1 L3\nX10 Y10 P0.707106781\nX0 Y10 P1\nG5.3");
    for step in &quarter[1..] {
        for part in 0..=4 {
            let at = step.path.at(step.path.length * f64::from(part) / 4.);
            assert!((at[0].hypot(at[1]) - 10.).abs() < 0.0006, "{at:?}");
        }
    }
}

/// P and Q of G64 are lengths in the unit of the program; a G64 without them has none.
#[test]
fn words_of_path_control() {
    let of = |text: &str| {
        let path = moves(&format!("{text}\nG1 X1 F100\n"));
        (path[0].tolerance, path[0].joining, path[0].exact_stop)
    };
    assert_eq!(of("G64 P0.01 Q0.02"), (Some(0.01), Some(0.02), false));
    assert_eq!(of("G64 Q0.02"), (None, Some(0.02), false));
    assert_eq!(of("G20 G64 P1 Q2"), (Some(25.4), Some(50.8), false));
    assert_eq!(of("G64 P0.01 Q0.02\nG64"), (None, None, false));
    assert_eq!(of("G64 P0.01 Q0.02\nG61"), (None, None, true));
    let refused = refusal("G64 P0.01 Q-0.02\n");
    assert!(refused.starts_with("t.ngc:1:11: "), "{refused}");
}

/// G5.1 is the parabola of its end points and its control point: the arcs are within 0.5 um of it,
/// over its whole length.
#[test]
fn a_quadratic_spline_is_the_parabola() {
    for (start, control, end) in [
        ([0.0, 0.0], [2.0, 4.0], [4.0, 0.0]),
        ([-3.0, 1.0], [5.0, 6.5], [9.0, -2.0]),
        ([1.0, 1.0], [1.5, 9.0], [30.0, 4.0]),
    ] {
        let [x, y]: [f64; 2] = start;
        let path = moves(&format!(
            "F100\nG0 X{x} Y{y}\nG5.1 X{} Y{} I{} J{}\n",
            end[0],
            end[1],
            control[0] - x,
            control[1] - y
        ));
        let arcs: Vec<_> = path
            .iter()
            .filter(|step| step.feed != Feed::Rapid)
            .collect();
        assert!(arcs.len() > 1 && arcs[0].path.from[..2] == start[..]);
        let curve = |t: f64| {
            [0, 1].map(|k: usize| {
                (1.0 - t).powi(2) * start[k] + 2.0 * t * (1.0 - t) * control[k] + t * t * end[k]
            })
        };
        let gap = |at: [f64; 2], t: f64| {
            let on = curve(t);
            (at[0] - on[0]).hypot(at[1] - on[1])
        };
        // The arcs pass the parabola in order, from its start to its end.
        let mut done = 0.0;
        for step in arcs {
            for part in 0..=16 {
                let at = step.path.at(step.path.length * f64::from(part) / 16.0);
                let at = [at[0], at[1]];
                let steps = (0..=400).map(|k| done + f64::from(k) * 0.0005);
                let near = steps.min_by(|a, b| gap(at, *a).total_cmp(&gap(at, *b)));
                let (mut low, mut high) = (near.unwrap_or(0.0) - 5e-4, near.unwrap_or(0.0) + 5e-4);
                for _ in 0..60 {
                    let third = (high - low) / 3.0;
                    if gap(at, low + third) < gap(at, high - third) {
                        high -= third;
                    } else {
                        low += third;
                    }
                }
                let off = gap(at, low);
                assert!(off < 0.00051, "{off} mm off the parabola at {at:?}");
                done = low;
            }
        }
        assert!((done - 1.0).abs() < 1e-6, "the arcs end at {done}");
    }
    assert!(refusal("F100\nG5.1 X4 Y0").contains("G5.1 without I and J"));
}

#[test]
fn feeds_per_turn_and_inverse_time() {
    let path = moves("S1500 M3 G95 G1 X10 F0.2\nG93 X30 F2\n");
    assert_eq!(path[0].feed, Feed::PerMinute(300.));
    assert_eq!(path[1].feed, Feed::PerMinute(40.));
    let missing = refusal("G93 G1 X1 F2\nX2");
    assert!(
        missing.starts_with("t.ngc:2:1: a move with inverse time"),
        "{missing}"
    );
    // A change of the unit keeps the feed.
    let path = moves("G21 G1 X1 F254\nG20 X1\nX2 F10");
    assert_eq!(path[1].feed, Feed::PerMinute(254.));
    assert_eq!(path[2].feed, Feed::PerMinute(254.));
}

#[test]
fn probe_results_come_from_the_machine() {
    let mut interpreter = Interpreter::new(
        Cursor::new("G38.2 Z-10 F100\n(PRINT,#5063 #5070)\nG91 G0 Z1\n"),
        &options(),
    );
    assert!(matches!(interpreter.next(), Some(Ok(Step::Probe { .. }))));
    interpreter.report_probe(&[0., 0., -4.5, 0., 0., 0.], true);
    match interpreter.next() {
        Some(Ok(Step::Message { text, .. })) => assert_eq!(text, "-4.5 1"),
        other => panic!("{other:?}"),
    }
    match interpreter.next() {
        Some(Ok(Step::Move(step))) => {
            assert_eq!(step.path.from[2], -4.5);
            assert_eq!(step.path.to[2], -3.5);
        }
        other => panic!("{other:?}"),
    }
}

/// Distance and angle in place of X and Y; the positions were printed by LinuxCNC's rs274.
#[test]
fn polar_coordinates_have_the_ends_of_rs274() {
    let near = |text: &str, expected: &[(char, [f64; 3])]| {
        let ends = ends(text);
        let kinds = |ends: &[(char, [f64; 3])]| ends.iter().map(|end| end.0).collect::<String>();
        assert_eq!(kinds(&ends), kinds(expected), "{text}");
        for (end, expected) in ends.iter().zip(expected) {
            for axis in 0..3 {
                assert!(
                    (end.1[axis] - expected.1[axis]).abs() < 6e-5,
                    "{end:?} {expected:?}"
                );
            }
        }
    };
    let t = |x: f64, y: f64, z: f64| ('T', [x, y, z]);
    let f = |x: f64, y: f64, z: f64| ('F', [x, y, z]);
    near(
        "G21 F100\nG0 @10 ^30 Z1\nG1 ^60\nG1 @5\nG91 @1 ^10\nG90 G10 L2 P1 X3 Y4\nG0 @10 ^0",
        &[
            t(8.6603, 5.0, 1.0),
            f(5.0, 8.6603, 1.0),
            f(2.5, 4.3301, 1.0),
            f(2.0521, 5.6382, 1.0),
            t(13.0, 4.0, 1.0),
        ],
    );
    // A negative distance is one in the other direction.
    near(
        "F100\nG0 @-5 ^10\nG1 ^20",
        &[t(-4.9240, -0.8682, 0.0), f(4.6985, 1.7101, 0.0)],
    );
    near("G20 F100\nG0 @1 ^90", &[t(0.0, 25.4, 0.0)]);
    // Each hole of a series turns on, and moves outwards, from the last one.
    near(
        "F100\nG0 X10\nG91 G81 @1 ^30 R1 Z-1 L3",
        &[
            t(10.0, 0.0, 0.0),
            t(10.0, 0.0, 1.0),
            t(9.5263, 5.5, 1.0),
            f(9.5263, 5.5, 0.0),
            t(9.5263, 5.5, 1.0),
            t(6.0, 10.3923, 1.0),
            f(6.0, 10.3923, 0.0),
            t(6.0, 10.3923, 1.0),
            t(0.0, 13.0, 1.0),
            f(0.0, 13.0, 0.0),
            t(0.0, 13.0, 1.0),
        ],
    );
    // In a turned coordinate system; the block number is that of a long program.
    let turned = "G10 L2 P1 R30\nG0 @10 ^0\nN12345678 G91 ^30";
    near(turned, &[t(8.6603, 5.0, 0.0), t(5.0, 8.6603, 0.0)]);
}

/// With inverse time, compensation changes no feed: it is that of the programmed path, also around
/// a corner. The motion and the feeds are those of `rs274`.
#[test]
fn inverse_time_with_compensation_has_the_feed_of_the_program() {
    let path = moves(
        "G21 F100\nG0 X0 Y0\nG41.1 D4\nG93 G1 X20 Y0 F10\nX20 Y-20 F10\nX0 Y-20 F10\n\
         G40 G94 G1 X-20 F100\nM2\n",
    );
    let feeds: Vec<_> = path.iter().map(|step| step.feed).collect();
    assert_eq!(feeds[..5], [Feed::PerMinute(200.); 5], "{feeds:?}");
    assert_eq!(
        path.iter().filter(|step| step.path.arc.is_some()).count(),
        2
    );
}
