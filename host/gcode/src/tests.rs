//! Tests of the reader: words against their geometry, and the messages of refused words.

use super::*;
use proptest::prelude::*;

fn options() -> Options {
    Options::of_letters("XYZBA", [0.0; 6])
}

fn moves(text: &str) -> Vec<Move> {
    let program =
        read("t.ngc", text.as_bytes(), &options()).unwrap_or_else(|refused| panic!("{refused}"));
    program
        .steps
        .into_iter()
        .filter_map(|step| match step {
            Step::Move(step) => Some(step),
            _ => None,
        })
        .collect()
}

fn refusal(text: &str) -> String {
    match read("t.ngc", text.as_bytes(), &options()) {
        Err(refused) => refused.to_string(),
        Ok(program) => panic!("accepted: {:?}", program.steps),
    }
}

#[test]
fn blocks_are_read() {
    // Leading zeros, blanks between letter and number, several G words in a block.
    let moves = moves("%\nO0001\nN01 G90 G17\nN15 G01 X2.0 Y1.5 F7.5\nG1 X 42.522 y-.5\n%\n");
    assert_eq!(moves.len(), 2);
    assert_eq!(moves[0].path.to, [2.0, 1.5, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(moves[0].feed, Feed::PerMinute(7.5));
    assert_eq!((moves[0].place.line, moves[0].place.column), (4, 9));
    assert_eq!(moves[1].path.to, [42.522, -0.5, 0.0, 0.0, 0.0, 0.0]);
}

#[test]
fn units_and_distances() {
    let inch = moves("G20 G1 X1 A10 F2\nG91 X1\nG21 F50 X1\nG70 G0 Y-1\nG71 Y1\n");
    let ends: Vec<[f64; 3]> = inch
        .iter()
        .map(|step| [step.path.to[0], step.path.to[1], step.path.to[4]])
        .collect();
    let expected = [
        [25.4, 0.0, 10.0],
        [50.8, 0.0, 10.0],
        [51.8, 0.0, 10.0],
        [51.8, -25.4, 10.0],
        [51.8, -24.4, 10.0],
    ];
    for (end, expected) in ends.iter().zip(expected) {
        for (a, b) in end.iter().zip(expected) {
            assert!((a - b).abs() < 1e-12, "{ends:?}");
        }
    }
    assert_eq!(inch[0].feed, Feed::PerMinute(50.8));
    assert_eq!(inch[2].feed, Feed::PerMinute(50.0));
    assert_eq!(inch[3].feed, Feed::Rapid);
    // A feed in degrees per minute is not scaled.
    assert_eq!(moves("G20 G1 B5 F90")[0].feed, Feed::PerMinute(90.0));
    assert_eq!(moves("G20 G1 B5 A8 F90")[0].path.length, 8.0);
}

#[test]
fn comments_are_kept_with_their_places() {
    let program = read(
        "t.ngc",
        "(\u{e9}t\u{e9}) G0 X1 (two) ; three\n".as_bytes(),
        &options(),
    )
    .expect("read");
    let found: Vec<(u32, &str)> = program
        .comments
        .iter()
        .map(|c| (c.place.column, c.text.as_str()))
        .collect();
    assert_eq!(found, [(1, "\u{e9}t\u{e9}"), (13, "two"), (19, "three")]);
}

#[test]
fn spindle_dwell_pause_and_end() {
    let program = read(
        "t.ngc",
        b"S3000\nM3\nS4000\nG4 P0.5\nM0\nM1\nM5\nM4\nM30\n%\n",
        &options(),
    )
    .expect("read");
    let kinds: Vec<String> = program
        .steps
        .iter()
        .map(|step| match step {
            Step::Spindle { rpm, place } => format!("{}:S{rpm}", place.line),
            Step::Dwell { seconds, place } => format!("{}:P{seconds}", place.line),
            Step::Pause { place } => format!("{}:M0", place.line),
            other => format!("{other:?}"),
        })
        .collect();
    assert_eq!(
        kinds,
        [
            "2:S3000", "3:S4000", "4:P0.5", "5:M0", "6:M0", "7:S0", "8:S-4000", "9:S0"
        ]
    );
    let without = Options {
        optional_stop: false,
        ..options()
    };
    assert!(
        read("t.ngc", b"M1", &without)
            .expect("read")
            .steps
            .is_empty()
    );
}

#[test]
fn arcs_in_three_planes_turn_the_right_way() {
    // A quarter turn counter-clockwise, seen from the plane's normal, from the first axis to the
    // second.
    for (text, middle) in [
        (
            "G17 G0 X10\nG3 X0 Y10 I-10 F100",
            [7.0710678, 7.0710678, 0.0],
        ),
        (
            "G18 G0 Z10\nG3 Z0 X10 K-10 F100",
            [7.0710678, 0.0, 7.0710678],
        ),
        (
            "G19 G0 Y10\nG3 Y0 Z10 J-10 F100",
            [0.0, 7.0710678, 7.0710678],
        ),
    ] {
        let path = &moves(text)[1].path;
        let point = path.at(0.5 * path.length);
        for k in 0..3 {
            assert!((point[k] - middle[k]).abs() < 1e-6, "{text}: {point:?}");
        }
        // Clockwise it is three quarters of a turn.
        let clockwise = &moves(&text.replace("G3", "G2"))[1].path;
        assert!((clockwise.length - 3.0 * path.length).abs() < 1e-9);
    }
}

#[test]
fn full_circles_and_helices() {
    let circle = &moves("G2 I-15 F240")[0].path;
    assert!((circle.length - 30.0 * std::f64::consts::PI).abs() < 1e-9);
    // Clockwise: the path starts towards -Y.
    assert!(circle.tangent(0.0)[1] < -0.999);
    let helix = &moves("G3 X0 Y0 Z4 I3 F240")[0].path;
    assert!((helix.length - (6.0 * std::f64::consts::PI).hypot(4.0)).abs() < 1e-9);
    let half = helix.at(0.5 * helix.length);
    assert!((half[0] - 6.0).abs() < 1e-9 && half[1].abs() < 1e-9 && (half[2] - 2.0).abs() < 1e-9);
}

#[test]
fn refusals_name_place_and_remedy() {
    for (text, start) in [
        (
            "G1 X1 Q3 F100",
            "t.ngc:1:7: Q3 belongs to no word of its block; it belongs to cycles",
        ),
        (
            "\nG33 Z-1 K1",
            "t.ngc:2:1: G33 is not supported; threading follows the spindle's encoder",
        ),
        (
            "G7",
            "t.ngc:1:1: G7 is not supported; diameter and radius modes belong to lathes",
        ),
        ("M117 hello", "t.ngc:1:1: M117 is not supported"),
        (
            "G68 X0 Y0 R30",
            "t.ngc:1:1: G68 is not supported; write G10 L2 P R",
        ),
        (
            "G31 Z-5 F50",
            "t.ngc:1:1: G31 is not supported; write G38.2",
        ),
        (
            "G65 P100",
            "t.ngc:1:1: G65 is not supported; macros are called as O<name> call",
        ),
        (
            "G0 @5 X1",
            "t.ngc:1:7: X1 together with polar coordinates; write",
        ),
        ("G0 X1 @5", "t.ngc:1:7: @5 together with X or Y; write"),
        (
            "G0 @5 @6",
            "t.ngc:1:7: '@' occurs twice in one block; keep one",
        ),
        ("G0 @", "t.ngc:1:4: '@' has no number; write the distance"),
        (
            "G18 G0 @5",
            "t.ngc:1:8: polar coordinates outside the plane of G17",
        ),
        (
            "G53 G0 @5",
            "t.ngc:1:8: polar coordinates with G53; write X and Y",
        ),
        (
            "G91 G0 ^5",
            "t.ngc:1:8: incremental polar coordinates at the origin",
        ),
        (
            "G28 @5",
            "t.ngc:1:5: polar coordinates without a motion; write X and Y",
        ),
        ("G80 @5", "t.ngc:1:5: @5 without a motion; write"),
        (
            "G71.1 P1",
            "t.ngc:1:1: G71.1 is not supported; turning cycles belong to lathes",
        ),
        (
            "G72 P1",
            "t.ngc:1:1: G72 is not supported; turning cycles belong to lathes",
        ),
        ("G1.5 X1", "t.ngc:1:1: G1.5 is not supported"),
        (
            "G1 G2 X1 F1",
            "t.ngc:1:4: G2 and G1 in one block: both are of modal group motion; keep",
        ),
        (
            "G90 G91",
            "t.ngc:1:5: G91 and G90 in one block: both are of modal group distance",
        ),
        ("M3 M5 S100", "t.ngc:1:4: M5 and M3 in one block"),
        ("G0 X1 X2", "t.ngc:1:7: the letter X occurs twice"),
        (
            "X1",
            "t.ngc:1:1: X1 without a motion; write G0, G1, G2 or G3",
        ),
        ("G0 X1\nG80\nX2", "t.ngc:3:1: X2 without a motion"),
        ("G1 X1", "t.ngc:1:4: a move at feed without a feed; write F"),
        ("G1 X1 F0", "t.ngc:1:7: feed F0 is not above zero"),
        ("G1 X1 F-3", "t.ngc:1:7: feed F-3 is not above zero"),
        (
            "G20 G1 X1",
            "t.ngc:1:8: a move at feed without a feed; write F with the feed in inch/min",
        ),
        ("G0 X", "t.ngc:1:4: the letter X has no number"),
        ("G0 X1.2.3", "t.ngc:1:8: a number without a letter"),
        ("G0 X--1", "t.ngc:1:4: the letter X has no number"),
        ("G0 X1e3", "t.ngc:1:6: e3: exponents are not supported"),
        (
            "G0 X99999999",
            "t.ngc:1:4: the number of X99999999 is too large",
        ),
        ("G0 X[1+]", "t.ngc:1:8: a value is missing"),
        ("G0 X[1+2", "t.ngc:1:5: the bracket [ is not closed"),
        (
            "G0 X[1/0]",
            "t.ngc:1:7: a division by zero; check the divisor",
        ),
        (
            "G0 X#<a>",
            "t.ngc:1:5: the parameter #<a> has no value; assign",
        ),
        ("#1", "t.ngc:1:1: the parameter #1 is not used"),
        ("#0=3", "t.ngc:1:1: #0 is not a parameter"),
        ("#5420=3", "t.ngc:1:1: #5420 is read only"),
        ("G0 X1 (open", "t.ngc:1:7: the comment is not closed"),
        (
            "G0 X1 (a (b) c)",
            "t.ngc:1:7: a comment is opened inside a comment",
        ),
        (
            "G0 X1 )",
            "t.ngc:1:7: a comment is closed that was not opened",
        ),
        ("G0 C1", "t.ngc:1:4: this machine has no axis C"),
        ("T1.5 M6", "t.ngc:1:1: T1.5 is not a tool"),
        ("S70000", "t.ngc:1:1: S70000 is not a spindle speed"),
        ("G4", "t.ngc:1:1: G4 without its time; write P"),
        ("G4 P-1", "t.ngc:1:4: P-1 is not a dwell time"),
        ("G4 P1 X2", "t.ngc:1:7: an axis word in the block of G4"),
        ("G4 X2", "t.ngc:1:1: G4 without its time"),
        ("P1", "t.ngc:1:1: P1 belongs to no word of its block"),
        ("G1 I3 X1 F100", "t.ngc:1:4: I3 without an arc"),
        (
            "G2 X1 F100",
            "t.ngc:1:1: an arc with neither centre nor radius; write its centre from the start (I, J), or R",
        ),
        ("G2 F100", "t.ngc:1:1: an arc without end point and centre"),
        (
            "G2 X1 I1 R1 F100",
            "t.ngc:1:10: an arc with both a radius and a centre",
        ),
        ("G2 X1 K1 F100", "t.ngc:1:7: K1 is not in the plane of G17"),
        (
            "G2 R5 F100",
            "t.ngc:1:4: an arc by radius that ends where it starts",
        ),
        (
            "G2 X11 R5 F100",
            "t.ngc:1:8: the ends of the arc are 11.000000 mm apart, more than twice the radius 5.000000 mm",
        ),
        (
            "G2 X10 Y0.1 I5 F100",
            "t.ngc:1:1: the arc's end is 5.001000 mm",
        ),
        (
            "G2 X10.1 I5 F100",
            "t.ngc:1:1: the arc's end is 5.100000 mm from its centre and its start 5.000000 mm: 0.100000 mm apart",
        ),
        ("G0 N5 X1", "t.ngc:1:4: a block number inside a block"),
        (
            "G0 X1\nO2",
            "t.ngc:2:1: program number O2 is not alone in its block, before the first move",
        ),
        (
            "G0 X\u{fc}1",
            "t.ngc:1:5: the character U+00FC is not part of a word",
        ),
        (
            "\u{fc}",
            "t.ngc:1:1: the character U+00FC is not part of a word",
        ),
    ] {
        if text == "G2 X10 Y0.1 I5 F100" {
            // 5.001 against 5.000 is within the tolerance of 0.0283 mm.
            assert_eq!(moves(text).len(), 1);
            continue;
        }
        let refused = refusal(text);
        assert!(
            refused.starts_with(start),
            "{text:?}:\n{refused}\nnot\n{start}"
        );
        assert!(
            refused.lines().all(|line| line.contains("; ")),
            "no remedy: {refused}"
        );
    }
}

#[test]
fn all_problems_are_reported_in_order() {
    let refused = read("t.ngc", b"G0 X1 Q1\nG33\nG1 X2\nG1 X3\n?", &options()).unwrap_err();
    let places: Vec<(u32, u32)> = refused
        .problems
        .iter()
        .map(|p| (p.place.line, p.place.column))
        .collect();
    // A missing feed is reported once.
    assert_eq!(places, [(1, 7), (2, 1), (3, 4), (5, 1)]);
    let many: String = (0..80).map(|number| format!("Q{number}\n")).collect();
    let refused = read("t.ngc", many.as_bytes(), &options()).unwrap_err();
    assert_eq!(
        (refused.problems.len(), refused.more),
        (LISTED_PROBLEMS, 30)
    );
    assert!(refused.to_string().ends_with("t.ngc: 30 more problems"));
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]
    /// An arc by centre equals the same arc by radius. Its points are on the circle, its ends are
    /// exact, and its tangent is the derivative.
    #[test]
    fn arcs_are_circles(
        x in -50.0..50.0f64, y in -50.0..50.0f64, radius in 0.5..80.0f64,
        start in 0.0..std::f64::consts::TAU, sweep in 0.05..6.2f64, clockwise: bool,
    ) {
        let direction = if clockwise { -1.0 } else { 1.0 };
        let point = |angle: f64| (x + radius * angle.cos(), y + radius * angle.sin());
        let ((x0, y0), (x1, y1)) = (point(start), point(start + direction * sweep));
        let word = if clockwise { "G2" } else { "G3" };
        let centre = moves(&format!("G0 X{x0:.12} Y{y0:.12}\n{word} X{x1:.12} Y{y1:.12} I{:.12} J{:.12} F100", x - x0, y - y0));
        let sign = if sweep > std::f64::consts::PI { "-" } else { "" };
        let by_radius = moves(&format!("G0 X{x0:.12} Y{y0:.12}\n{word} X{x1:.12} Y{y1:.12} R{sign}{radius:.12} F100"));
        let path = &centre[1].path;
        prop_assert!((path.length - radius * sweep).abs() < 1e-8 * path.length.max(1.0));
        for i in 0..=16 {
            let s = path.length * f64::from(i) / 16.0;
            let here = path.at(s);
            prop_assert!(((here[0] - x).hypot(here[1] - y) - radius).abs() < 1e-9);
            // Near a half circle the centre by radius is ill-conditioned: a length error e moves it
            // by sqrt(e).
            let there = by_radius[1].path.at(by_radius[1].path.length * f64::from(i) / 16.0);
            prop_assert!((here[0] - there[0]).hypot(here[1] - there[1]) < 1e-4);
            let h = 1e-6;
            if s > h && s < path.length - h {
                let (low, high, tangent) = (path.at(s - h), path.at(s + h), path.tangent(s));
                let (before, after, bend) = (path.tangent(s - h), path.tangent(s + h), path.curvature(s));
                for k in 0..3 {
                    prop_assert!(((high[k] - low[k]) / (2.0 * h) - tangent[k]).abs() < 1e-6);
                    prop_assert!(((after[k] - before[k]) / (2.0 * h) - bend[k]).abs() < 1e-6);
                }
            }
        }
        let last = path.at(path.length);
        prop_assert!((last[0] - x1).abs() < 1e-11 && (last[1] - y1).abs() < 1e-11);
    }

    /// Any text in the alphabet of part programs is read or refused, twice with the same result.
    #[test]
    fn any_words_are_read_or_refused(text in "([GMXYZABIJKRFSPN%();/ .0-9+-]{0,40}\n){0,20}") {
        let first = read("t.ngc", text.as_bytes(), &options());
        prop_assert_eq!(&first, &read("t.ngc", text.as_bytes(), &options()));
        if let Err(refused) = first {
            prop_assert!(!refused.problems.is_empty());
            for problem in &refused.problems {
                prop_assert!(problem.place.line >= 1 && problem.place.column >= 1 && !problem.remedy.is_empty());
            }
        }
    }
}

/// Ends of C, a coordinate that wraps around, of a program that starts at `start` degrees.
fn turned(start: f64, text: &str) -> Vec<f64> {
    let mut options = options();
    options.axes.push(crate::ProgramAxis {
        letter: 'C',
        kind: WordKind::Rotary,
        wraps: true,
    });
    options.start[5] = start;
    let program = read("t.ngc", text.as_bytes(), &options).expect("a program");
    let ends = program.steps.iter().filter_map(|step| match step {
        Step::Move(step) => Some(step.path.to[5]),
        _ => None,
    });
    ends.collect()
}

#[test]
fn an_absolute_angle_that_wraps_around_is_reached_in_the_direction_of_its_sign() {
    assert_eq!(turned(0.0, "G0 C90\nC-45\nC45\nC-359"), [90.0, 45.0, -1.0]);
    assert_eq!(turned(170.0, "G0 C10\nC-350"), [370.0, 350.0]);
    assert_eq!(turned(-170.0, "G0 C0\nC-0.0\nC-0.5"), [0.0, -359.5]);
    // Relative words turn as far as they say.
    assert_eq!(
        turned(0.0, "G91 G0 C720.5\nG90 C0\nG91 C-1000"),
        [720.5, 1080.0, 80.0]
    );
    // A rounding makes no turn.
    assert_eq!(turned(90.000_000_1, "G0 C90").len(), 1);
    let ends = turned(90.000_000_1, "G0 C90\nC-90");
    assert!(ends.iter().all(|end| (end - 90.0).abs() < 1e-6), "{ends:?}");
}

#[test]
fn an_absolute_angle_of_a_turn_or_more_is_refused_where_the_coordinate_wraps() {
    let mut options = options();
    options.axes[4].wraps = true;
    let refused = read("t.ngc", b"G0 A-360", &options).expect_err("refused");
    let text = refused.to_string();
    assert!(text.contains("A-360 is a turn or more"), "{text}");
}
