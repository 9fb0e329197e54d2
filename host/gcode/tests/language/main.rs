//! The language: codes against the motion that they mean, and mistakes against their messages.

use haptimill_gcode::{Feed, Interpreter, Move, Options, Step, Tool, read};
use std::io::Cursor;

fn options() -> Options {
    Options {
        coolant: true,
        outputs: true,
        ..Options::of_letters("XYZA", Default::default())
    }
}

fn steps_with(text: &str, options: &Options) -> Vec<Step> {
    match read("t.ngc", text.as_bytes(), options) {
        Ok(program) => program.steps,
        Err(refused) => panic!("{text}\n{refused}"),
    }
}

fn moves(text: &str) -> Vec<Move> {
    steps_with(text, &options())
        .into_iter()
        .filter_map(|step| match step {
            Step::Move(step) | Step::Probe { step, .. } => Some(step),
            _ => None,
        })
        .collect()
}

/// Returns the ends of the moves in X, Y, Z with a mark for rapids, rounded to 0.1 um.
fn ends(text: &str) -> Vec<(char, [f64; 3])> {
    moves(text)
        .iter()
        .map(|step| {
            let mark = match (step.feed, step.path.arc) {
                (Feed::Rapid, _) => 'T',
                (_, Some(_)) => 'A',
                _ => 'F',
            };
            let to = [0, 1, 2].map(|k| (step.path.to[k] * 1e4).round() / 1e4 + 0.0);
            (mark, to)
        })
        .collect()
}

fn messages(text: &str) -> Vec<String> {
    steps_with(text, &options())
        .into_iter()
        .filter_map(|step| match step {
            Step::Message { text, .. } => Some(text),
            _ => None,
        })
        .collect()
}

fn refusal(text: &str) -> String {
    read("t.ngc", text.as_bytes(), &options())
        .err()
        .unwrap_or_else(|| panic!("accepted: {text}"))
        .to_string()
}

#[test]
fn expressions_have_the_values_of_rs274() {
    // The values were printed by LinuxCNC's rs274.
    for (expression, value) in [
        ("[1 EQ 1.00005]", "1"),
        ("[2**3**2]", "64"),
        ("[-7 MOD 3]", "2"),
        ("[1+2*3 GT 6 AND 1]", "1"),
        ("[-2**2]", "4"),
        ("ROUND[-2.5]", "-3"),
        ("ATAN[1]/[-1]", "135"),
        ("[FIX[-2.5]+FUP[2.1]]", "0"),
        ("SQRT[16]", "4"),
        ("FIX[SIN[30]*10]", "5"),
        ("[1 XOR 1]", "0"),
        ("-[2 - 5]", "3"),
        ("EXISTS[#<nothing>]", "0"),
    ] {
        let program = format!("#1={expression}\n(PRINT,#1)\n");
        assert_eq!(messages(&program), [value], "{expression}");
    }
}

#[test]
fn assignments_take_effect_after_their_block() {
    assert_eq!(
        messages("#3=6\n#3=7 #4=#3\n(PRINT,a #3 #4 #[3] ##3)"),
        ["a 7 6 7 0"]
    );
    assert_eq!(messages("#<a b>=2\n(DEBUG,#<AB> #<no>)"), ["2 ######"]);
    assert_eq!(messages("(MSG, look)"), ["look"]);
    assert_eq!(messages("M0 (turn the part)"), ["turn the part"]);
}

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

/// One mistake in the order of blocks is one error: its other end, and what the file then lacks,
/// follow from it.
#[test]
fn a_mistake_of_an_o_word_is_one_error() {
    for (text, at, what) in [
        (
            "O1 repeat [1e9]\n#1=1\nO1 endrepeat\nM30\n",
            "1:13",
            "exponents are not supported",
        ),
        (
            "O1 while [1/0]\n#1=1\nO1 endwhile\nM30\n",
            "1:12",
            "division by zero",
        ),
        (
            "O1 if [1/0]\n#1=1\nO1 else\n#1=2\nO1 endif\nM30\n",
            "1:9",
            "division by zero",
        ),
        (
            "O1 if [0]\nO1 elseif [1/0]\nO1 endif\nM30\n",
            "2:13",
            "division by zero",
        ),
        (
            "O1 do\n#1=1\nO1 while [1/0]\nM30\n",
            "3:12",
            "division by zero",
        ),
        (
            "O1 whle [1]\n#1=1\nO1 endwhile\nM30\n",
            "1:4",
            "whle is no keyword",
        ),
        (
            "O1 if [1]\n#1=1\nO2 endif\nM30\n",
            "3:1",
            "O2 ends nothing that is open",
        ),
        (
            "O1 do\n#1=1\nO1 while [1]\nM30\n",
            "3:1",
            "more than 1000000 times",
        ),
        (
            "O1 sub\nO1 call\nO1 call\nO1 endsub\nO1 call\nM30\n",
            "2:1",
            "deeper than 50",
        ),
    ] {
        let refused = refusal(text);
        assert!(
            refused.starts_with(&format!("t.ngc:{at}: ")),
            "{text}\n{refused}"
        );
        assert!(refused.contains(what), "{text}\n{refused}");
        assert_eq!(refused.lines().count(), 1, "{text}\n{refused}");
    }
    // Mistakes of other blocks are reported beside it.
    let two = refusal("O1 repeat [1e9]\nG1 X1 F0\nO1 endrepeat\nG0 Y[1/0]\nM30\n");
    assert_eq!(two.lines().count(), 3, "{two}");
}

#[test]
fn characters_that_no_word_has_are_named_with_their_remedy() {
    for (text, at, what, remedy) in [
        ("G0 X1,5\n", "1:6", "a comma", "with a point: X1.5"),
        ("G0 X-12,25 Y3\n", "1:8", "a comma", "with a point: X-12.25"),
        ("G0 X1, Y2\n", "1:6", "a comma", "with a point: X10.5"),
        ("G0 X\u{2212}1\n", "1:5", "U+2212", "write - in its place"),
        (
            "G0 X1 \u{2013} Y2\n",
            "1:7",
            "U+2013",
            "write - in its place",
        ),
        ("G0 X\u{a0}1\n", "1:5", "U+00A0", "write a blank"),
        ("G0 X\u{0}1\n", "1:5", "byte 0x00", "remove it"),
        ("G0 \u{e4} X1\n", "1:4", "U+00E4", "plain ASCII"),
    ] {
        let refused = refusal(text);
        assert!(
            refused.starts_with(&format!("t.ngc:{at}: ")),
            "{text}\n{refused}"
        );
        assert!(
            refused.contains(what) && refused.contains(remedy),
            "{text}\n{refused}"
        );
        assert_eq!(refused.lines().count(), 1, "{refused}");
    }
    let bytes = read("t.ngc", b"G0 X\xff1\n", &options())
        .unwrap_err()
        .to_string();
    assert!(bytes.starts_with("t.ngc:1:5: byte 0xFF"), "{bytes}");
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
fn loops_conditions_and_subroutines() {
    assert_eq!(
        messages("#1=0\nO1 while [#1 LT 3]\n(PRINT,#1)\n#1=[#1+1]\nO1 endwhile"),
        ["0", "1", "2"]
    );
    assert_eq!(
        messages("#1=0\nO1 do\n(PRINT,#1)\n#1=[#1+1]\nO1 while [#1 LT 2]\n(MSG,end)"),
        ["0", "1", "end"]
    );
    assert_eq!(
        messages(
            "#1=0\nO1 while [1]\n#1=[#1+1]\nO2 if [#1 EQ 2]\nO1 continue\nO2 endif\n\
             O3 if [#1 GT 3]\nO1 break\nO3 endif\n(PRINT,#1)\nO1 endwhile\n(MSG,out)"
        ),
        ["1", "3", "out"]
    );
    assert_eq!(
        messages("O1 repeat [2]\nO2 repeat [2]\n(MSG,a)\nO2 endrepeat\nO1 endrepeat").len(),
        4
    );
    for (value, branch) in [(1, "one"), (2, "two"), (3, "more")] {
        let text = format!(
            "#1={value}\nO1 if [#1 EQ 1]\n(MSG,one)\nO1 elseif [#1 EQ 2]\n(MSG,two)\n\
             O1 else\n(MSG,more)\nO1 endif"
        );
        assert_eq!(messages(&text), [branch]);
    }
    assert_eq!(
        messages(
            "O<add> sub\n#<s>=[#1+#2]\nO<add> endsub [#<s>]\n#1=9\nO<add> call [2] [3]\n\
             (PRINT,#<_value> #1)"
        ),
        ["5 9"]
    );
    // Called before its definition, behind the end, as CAM systems for Fanuc write it.
    assert_eq!(
        messages("M98 P1000 L2\nM30\nO1000\n(MSG,sub)\nM99"),
        ["sub", "sub"]
    );
}

#[test]
fn loops_and_calls_without_end_are_refused() {
    let refused = refusal("O1 while [1]\nO1 endwhile");
    assert!(refused.contains("more than 1000000 times"), "{refused}");
    let refused = refusal("O1 sub\nO1 call\nO1 endsub\nO1 call");
    assert!(refused.contains("nested deeper than 50"), "{refused}");
    for (text, start) in [
        (
            "O1 if [1]\nG0 X1",
            "t.ngc:2:1: the file ends without the endif of O1 in line 1",
        ),
        (
            "O1 if [0]\nG0 X1",
            "t.ngc:2:1: the file ends without the endif of O1 in line 1",
        ),
        ("O1 endwhile", "t.ngc:1:1: O1 ends nothing that is open"),
        ("O1 call", "t.ngc:1:1: the subroutine O1 does not exist"),
        ("O1 walk", "t.ngc:1:4: walk is no keyword"),
        ("O1 if", "t.ngc:1:1: O1 needs one expression"),
        (
            "O1 sub\nG0 X1",
            "t.ngc:2:1: the file ends without the endsub of O1",
        ),
        ("M99", "t.ngc:1:1: M99 in the main program"),
        ("O1 break", "t.ngc:1:1: O1 is not the label of a loop"),
    ] {
        let refused = refusal(text);
        assert!(refused.starts_with(start), "{text:?}\n{refused}\n{start}");
    }
}

#[test]
fn files_are_called_by_name() {
    let folder = std::env::temp_dir().join(format!("haptimill-gcode-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    std::fs::write(
        folder.join("part.ngc"),
        "O<part> sub\nG0 X#1\nO<part> endsub\n",
    )
    .expect("file");
    std::fs::write(folder.join("wrong.ngc"), "O<wrong> sub\n\nG1 X1\n").expect("file");
    let options = Options {
        folders: vec![folder.clone()],
        ..options()
    };
    let program = read("t.ngc", b"O<part> call [4]\nO<part> call [5]\n", &options).expect("read");
    assert_eq!(program.steps.len(), 2);
    assert_eq!(program.steps[1].place().file, 1);
    let refused = read("t.ngc", b"O<wrong> call\n", &options)
        .unwrap_err()
        .to_string();
    assert!(
        refused.contains("wrong.ngc:3:4: a move at feed"),
        "{refused}"
    );
    std::fs::remove_dir_all(&folder).expect("removed");
}

#[test]
fn a_mistake_is_reported_once() {
    for text in [
        "M117 hello world",
        "G1 X1 F1OO Y2",
        "G0 Q1\nX1\nX2",
        "G1 X1 F\nX2\nX3",
        "G2 X5 I9 F100\nG1 X6",
        "F10 G81 X1 Y1 Z-1\nX2\nX3",
        "#<a>=[1/0]\nG0 X#<a>",
        "G0 X1 \u{0}\u{0}\u{1}",
        "O1 repeat [10]\nG0 X#<a>\nO1 endrepeat",
        "#1=0\nO1 while [#1 LT 5]\nG2 X5 I9 F100\n#1=[#1+1]\nO1 endwhile",
    ] {
        let refused = refusal(text);
        assert_eq!(refused.lines().count(), 1, "{text:?}\n{refused}");
    }
}

#[test]
fn any_line_ends_and_bytes() {
    for text in [
        "G0 X1\rG0 X2\r",
        "G0 X1\r\nG0 X2\r\n",
        "\u{feff}G0 X1\nG0 X2",
        "%\nG0 X1\nG0 X2\n%\nG0 X3 what",
        "(ภาษาไทย)\nG0 X1 ; ไทย\nG0 X2",
    ] {
        assert_eq!(moves(text).len(), 2, "{text:?}");
    }
    let nul = refusal("G0 X1\n\0\n");
    assert!(nul.starts_with("t.ngc:2:1: byte 0x00"), "{nul}");
    let long = format!("G0 X1\n({})\nG0 X2", "a".repeat(100_000));
    let long = refusal(&long);
    assert!(
        long.starts_with("t.ngc:2:1: a line of more than 65536 bytes"),
        "{long}"
    );
    let deep = format!("#1={}1{}", "[".repeat(5000), "]".repeat(5000));
    assert!(refusal(&deep).contains("nested deeper"));
    let signs = format!("G0 X{}1", "-#".repeat(5000));
    assert!(!refusal(&signs).is_empty());
}

#[test]
fn words_that_change_nothing_are_noticed_once_or_refused() {
    let plain = Options {
        coolant: false,
        ..options()
    };
    let program = read("t.ngc", b"M8\nM9\nM53\nM8\nT1 M6\nG43 H1", &plain).expect("read");
    assert_eq!(program.notices.len(), 3);
    assert_eq!(program.notices[0].place.line, 1);
    let strict = Options {
        strict: true,
        ..plain
    };
    let refused = read("t.ngc", b"G40\nM8", &strict).unwrap_err().to_string();
    assert!(
        refused.starts_with("t.ngc:2:1: this machine has no coolant"),
        "{refused}"
    );
}

#[test]
fn options_of_the_language() {
    let delete = Options {
        block_delete: true,
        ..options()
    };
    assert_eq!(steps_with("/G0 X1\nG0 X2", &delete).len(), 1);
    assert_eq!(moves("/G0 X1\n/ N5 G0 X2").len(), 2);
    let dialect = Options {
        no_decimal: true,
        ..options()
    };
    let ends: Vec<[f64; 2]> = steps_with("G0 X 425220 Y -78936\nX 42522\nG20 X1", &dialect)
        .iter()
        .filter_map(|step| match step {
            Step::Move(step) => Some([step.path.to[0], step.path.to[1]]),
            _ => None,
        })
        .collect();
    assert_eq!(ends[0], [425.22, -78.936]);
    assert!((ends[1][0] - 42.522).abs() < 1e-12);
    assert!((ends[2][0] - 0.00254).abs() < 1e-12);
    let mixed = read("t.ngc", b"G0 X1.5", &dialect).unwrap_err().to_string();
    assert!(mixed.contains("decimal point"));
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

/// Differences that a corpus of programs found; the motion was printed by LinuxCNC's rs274.
#[test]
fn words_of_real_programs_have_the_motion_of_rs274() {
    let t = |x: f64, y: f64, z: f64| ('T', [x, y, z]);
    let f = |x: f64, y: f64, z: f64| ('F', [x, y, z]);
    // G80 with another motion word in one block.
    assert_eq!(ends("G80 G0 X1\nG0 G80 X2"), [t(1., 0., 0.), t(2., 0., 0.)]);
    // A comment between the arguments of a call, and a blank within a word.
    assert_eq!(
        ends("O1 sub\nG0 X#1 Y#2\nO1 end sub\nO1 call [3] (and) [4] (done)\nM2"),
        [t(3., 4., 0.)]
    );
    // R of a cycle with G91 counts from the level before the series, for each of its holes.
    assert_eq!(
        ends("F100 G0 Z5\nG91 G99 G81 X1 Z-4 R-1\nX1"),
        [
            t(0., 0., 5.),
            t(1., 0., 5.),
            t(1., 0., 4.),
            f(1., 0., 0.),
            t(1., 0., 4.),
            t(2., 0., 4.),
            f(2., 0., 0.),
            t(2., 0., 4.),
        ]
    );
    // G28 with an axis word, in a coordinate system that is turned by 90 degrees: X is the axis of
    // the program, which is Y of the machine.
    assert_eq!(
        ends("G10 L2 P1 R90\nG0 X5 Y7\nG28 X6"),
        [t(-7., 5., 0.), t(-7., 6., 0.), t(-7., 0., 0.)]
    );
    // M99 repeats the main program.
    assert_eq!(
        ends("#1=[#1+1]\nO9 if [#1 GT 2]\nM30\nO9 endif\nO1 (title)\nG0 X#1\nM99"),
        [t(1., 0., 0.), t(2., 0., 0.)]
    );
    // Blocks behind the end are not run, and noticed.
    let program = read("t.ngc", b"G0 X1\nM2\nG0 X2\nG7777\n", &options()).expect("a notice");
    assert_eq!((program.steps.len(), program.notices.len()), (1, 1));
    assert!(program.notices[0].what.contains("ends in line 2"));
    // Radii that differ by less than a thousandth.
    assert_eq!(ends("G21 F9\nG2 X2000 I999.5").len(), 1);
    let refused = refusal("G21 F9\nG2 X2000 I998.5");
    assert!(refused.contains("3.000000 mm apart"), "{refused}");
    // A feed as fast as the machine can.
    assert_eq!(ends("G1 X1 F100000000.0").len(), 1);
    // A turning cycle is refused by its name; G71 alone is the unit.
    let refused = refusal("G71 Q100 X50 D2");
    assert!(
        refused.contains("G71 with Q is a turning cycle"),
        "{refused}"
    );
}

#[test]
fn files_of_cam_systems_run_unedited() {
    for text in [
        include_str!("programs/freecad.ngc"),
        include_str!("programs/fusion.ngc"),
        include_str!("programs/linuxcnc.ngc"),
    ] {
        let program = read("t.ngc", text.as_bytes(), &options())
            .unwrap_or_else(|refused| panic!("{refused}"));
        assert!(program.steps.len() > 10);
    }
}
