//! Codes of spindle, coolant, tools, inputs, saved modes and local offsets, against the steps that
//! they mean.

use haptimill_gcode::{Feed, Options, OutputValue, Step, Tool, WaitFor, read};

fn options() -> Options {
    crate::options("XYZ")
}

/// Returns the steps of a program as text, without their places.
fn steps_with(text: &str, options: &Options) -> Vec<String> {
    let program = match read("t.ngc", text.as_bytes(), options) {
        Ok(program) => program,
        Err(refused) => panic!("{text}\n{refused}"),
    };
    program.steps.iter().map(shown).collect()
}

fn steps(text: &str) -> Vec<String> {
    steps_with(text, &options())
}

fn shown(step: &Step) -> String {
    match step {
        Step::Move(step) => {
            let [x, y, z] = [0, 1, 2].map(|k| (step.path.to[k] * 1e4).round() / 1e4 + 0.0);
            match step.feed {
                Feed::Rapid => format!("rapid {x} {y} {z}"),
                Feed::PerMinute(feed) => format!("feed {feed} {x} {y} {z}"),
            }
        }
        Step::Spindle { rpm, .. } => format!("spindle {rpm}"),
        Step::Coolant { mist, flood, .. } => format!("mist {mist} flood {flood}"),
        Step::ToolChange { tool, .. } => format!("tool {tool}"),
        Step::Pause { .. } => "pause".into(),
        Step::Dwell { seconds, .. } => format!("dwell {seconds}"),
        Step::Message { text, .. } => text.clone(),
        Step::Output {
            number,
            value: OutputValue::Digital(on),
            with_motion,
            ..
        } => format!("output {number} {on} {with_motion}"),
        Step::Output {
            number,
            value: OutputValue::Analogue(value),
            with_motion,
            ..
        } => format!("analogue {number} {value} {with_motion}"),
        Step::Wait {
            number,
            analogue,
            until,
            seconds,
            ..
        } => {
            let until = match until {
                WaitFor::Nothing => "nothing",
                WaitFor::Rise => "rise",
                WaitFor::Fall => "fall",
                WaitFor::High => "high",
                WaitFor::Low => "low",
            };
            format!("wait {number} {analogue} {until} {seconds}")
        }
        Step::Probe { .. } => "probe".into(),
    }
}

fn refusal(text: &str) -> String {
    read("t.ngc", text.as_bytes(), &options())
        .err()
        .unwrap_or_else(|| panic!("accepted: {text}"))
        .to_string()
}

#[test]
fn spindle_and_coolant_in_one_word() {
    assert_eq!(
        steps("S1000 M13\nM14\nM5 M9\nM2"),
        [
            "spindle 1000",
            "mist false flood true",
            "spindle -1000",
            "mist false flood true",
            "spindle 0",
            "mist false flood false",
        ]
    );
    // As with LinuxCNC the spindle then stands, and a notice says so.
    let program = read("t.ngc", b"M13\nS800\n", &options()).expect("a notice");
    let shown: Vec<String> = program.steps.iter().map(shown).collect();
    assert_eq!(shown, ["spindle 0", "mist false flood true", "spindle 800"]);
    assert!(
        program.notices[0].what.contains("without a speed"),
        "{:?}",
        program.notices
    );
    let strict = Options {
        strict: true,
        ..options()
    };
    let refused = read("t.ngc", b"M3", &strict).expect_err("no speed");
    assert!(
        refused.to_string().contains("t.ngc:1:1: the spindle"),
        "{refused}"
    );
}

#[test]
fn oriented_stop_is_a_stop_with_a_notice() {
    let program = read("t.ngc", b"S900 M3\nM19 R90\n", &options()).expect("the program is valid");
    let shown: Vec<String> = program.steps.iter().map(shown).collect();
    assert_eq!(shown, ["spindle 900", "spindle 0"]);
    assert_eq!(program.notices.len(), 1);
}

#[test]
fn surface_speed_follows_the_radius() {
    // n = v / (pi d): 100 m/min at a radius of 10 mm and of 20 mm.
    let of = |radius: f64| (100_000.0 / (std::f64::consts::TAU * radius)).round();
    assert_eq!(
        steps("G0 X10\nG96 S100 D5000 M3\nG1 X20 F100\nG97 S800\n"),
        [
            "rapid 10 0 0".to_owned(),
            format!("spindle {}", of(10.0)),
            "feed 100 20 0 0".to_owned(),
            format!("spindle {}", of(20.0)),
            "spindle 800".to_owned(),
        ]
    );
    // D bounds the speed near the axis.
    assert!(steps("G0 X0.1\nG96 S100 D5000 M3").contains(&"spindle 5000".to_owned()));
    assert!(refusal("G96 D100").contains("without a surface speed"));
}

#[test]
fn a_tool_is_named_without_a_change() {
    let mut options = options();
    let mut tool = Tool::default();
    tool.offset[2] = 12.5;
    options.tools.insert(7, tool);
    assert_eq!(
        steps_with("M61 Q7\nG43\nG0 Z0\n(PRINT,#5400)\nT7 M6\n", &options),
        ["rapid 0 0 12.5", "7"]
    );
    assert!(refusal("M61").contains("without its tool"));
}

#[test]
fn waits_for_inputs() {
    assert_eq!(
        steps("M66 P3 L3 Q2.5\nM66 P1 L1 Q1\nM66 P1 L2 Q1\nM66 P1 L4 Q1\nM66 E2 L0\nM66 P0\n"),
        [
            "wait 3 false high 2.5",
            "wait 1 false rise 1",
            "wait 1 false fall 1",
            "wait 1 false low 1",
            "wait 2 true nothing 0",
            "wait 0 false nothing 0",
        ]
    );
    for (text, part) in [
        ("M66 P1 L3", "without a time limit"),
        ("M66 E1 L1 Q1", "has no edge"),
        ("M66 P1 L9 Q1", "is not a kind of wait"),
        ("M66 L3 Q1", "without its number"),
        ("M66 P1.5", "is not an input"),
    ] {
        assert!(refusal(text).contains(part), "{text}: {}", refusal(text));
    }
}

#[test]
fn outputs_with_and_without_motion() {
    assert_eq!(
        steps("M62 P1\nM63 P1\nM64 P2\nM65 P2\nM67 E1 Q0.5\nM68 E1 Q2\n"),
        [
            "output 1 true true",
            "output 1 false true",
            "output 2 true false",
            "output 2 false false",
            "analogue 1 0.5 true",
            "analogue 1 2 false",
        ]
    );
}

#[test]
fn saved_modes_come_back() {
    // M70 saves distance mode, unit and feed, M72 restores them.
    assert_eq!(
        steps("G21 G90 F100\nG1 X1\nM70\nG91 G20 F10\nX1\nM72\nX2\n"),
        ["feed 100 1 0 0", "feed 254 26.4 0 0", "feed 100 2 0 0"]
    );
    // The motion word stays; M72 may be repeated.
    assert_eq!(
        steps("F100\nG1 X1\nM70\nG0 X2 \nM72\nX3\nG91\nM72\nX4\n"),
        [
            "feed 100 1 0 0",
            "rapid 2 0 0",
            "rapid 3 0 0",
            "rapid 4 0 0"
        ]
    );
    // Each subroutine saves for itself.
    assert_eq!(
        steps("O1 sub\nM70\nG91\nO1 endsub\nM70\nG90\nO1 call\nG0 X1\nX1\nM72\nX1\n"),
        ["rapid 1 0 0", "rapid 2 0 0", "rapid 1 0 0"]
    );
    // M71 drops what M70 saved.
    assert!(refusal("M70\nM71\nM72").contains("without a saved state"));
    // M73 in a subroutine restores at its end.
    assert_eq!(
        steps("O1 sub\nM73\nG91\nG1 X1 F50\nO1 endsub\nG90 G0 X5\nO1 call\nG0 X2\nM2\n"),
        ["rapid 5 0 0", "feed 50 6 0 0", "rapid 2 0 0"]
    );
}

/// Plane and unit of a block come behind its M70 to M73, as in the order of RS274/NGC.
#[test]
fn saved_modes_are_those_before_the_block() {
    let call = "O1 sub\nM73 G21 G91\nG1 X5 F100\nO1 endsub\nG20\nO1 call\nG90 G0 X2\nM2\n";
    assert_eq!(steps(call), ["feed 100 5 0 0", "rapid 50.8 0 0"]);
    let arc = |saving: &str| steps(&format!("F100\n{saving}\nG2 X10 I5\n"));
    assert_eq!(arc("M70 G18\nM72"), arc(""));
    let turned = |saving: &str| steps(&format!("F100\n{saving}\nG2 X10 Z0 I5\n"));
    assert_eq!(turned("M70\nM72 G18"), turned("G18"));
}

/// M72 and the end of a subroutine with M73 put cutter compensation in force again, or end it.
#[test]
fn saved_modes_have_cutter_compensation() {
    let contour = "G1 X20 Y0\nX40\nY20\nG40 X60\n";
    let plain = steps(&format!("F100\n{contour}"));
    let beside = steps(&format!("F100\nG41.1 D2\n{contour}"));
    assert_ne!(plain, beside);
    let with = |before: &str| steps(&format!("F100\n{before}{contour}"));
    assert_eq!(with("G41.1 D2\nM70\nG40\nM72\n"), beside);
    assert_eq!(with("M70\nG41.1 D2\nM72\n"), plain);
    // Side, radius and plane are those of the saved one.
    assert_eq!(with("G41.1 D2\nM70\nG40\nG41.1 D4\nM72\n"), beside);
    assert_eq!(with("G41.1 D2\nM70\nG40\nG18\nG41.1 D2\nM72\n"), beside);
    assert!(refusal("G41.1 D2\nM70\nG40\nM72 G18\n").contains("compensation"));
    assert_eq!(
        with("O1 sub\nM73\nG40\nO1 endsub\nG41.1 D2\nO1 call\n"),
        beside
    );
}

/// The rounds of a repeat, as counted with `rs274` of LinuxCNC 2.9.
#[test]
fn a_repeat_rounds_its_number() {
    for (number, rounds) in [
        ("0.5", 0),
        ("0.9", 1),
        ("1.5", 2),
        ("2.5", 2),
        ("2.999", 3),
        ("-1", 0),
    ] {
        let text = format!("G91\nO1 repeat [{number}]\nG0 X1\nO1 endrepeat\nM2\n");
        assert_eq!(steps(&text).len(), rounds, "{number}");
    }
}

/// Without decimal points only lengths count increments: no angle, time, tool or value.
#[test]
fn increments_are_lengths_only() {
    let mut options = options();
    options.no_decimal = true;
    options.tools.insert(3, Tool::default());
    let dialect = |text: &str| steps_with(text, &options);
    for (increments, plain) in [
        (
            "F100\nG5 X1000 Y1000 I0 J500 P500 Q-500\n",
            "F100\nG5 X1 Y1 I0 J0.5 P0.5 Q-0.5\n",
        ),
        ("G10 L2 P1 R90\nG0 X10000\n", "G10 L2 P1 R90\nG0 X10\n"),
        (
            "F100\nG41.1 D4000\nG1 X20000\nX40000 Y5000\n",
            "F100\nG41.1 D4\nG1 X20\nX40 Y5\n",
        ),
        ("M61 Q3\nG0 X1000\n", "M61 Q3\nG0 X1\n"),
        ("M68 E0 Q2.5\n", "M68 E0 Q2.5\n"),
        ("G64 P100 Q100\nG0 X1000\n", "G64 P0.1 Q0.1\nG0 X1\n"),
        (
            "G0 Z5000\nG82 X1000 Z-1000 R2000 P1 F100\n",
            "G0 Z5\nG82 X1 Z-1 R2 P1 F100\n",
        ),
        ("F100\nG4 P1 G2 X10000 I5000\n", "F100\nG4 P1 G2 X10 I5\n"),
        (
            "F100\nG5 X1000 Y1000 I0 J500 P0 Q-500\nM50 P1\n",
            "F100\nG5 X1 Y1 I0 J0.5 P0 Q-0.5\nM50 P1\n",
        ),
        ("#1=2.5\nG0 X#1 Y[#1*2] Z-#1\n", "G0 X2.5 Y5 Z-2.5\n"),
    ] {
        let mut with_points = options.clone();
        with_points.no_decimal = false;
        assert_eq!(
            dialect(increments),
            steps_with(plain, &with_points),
            "{increments}"
        );
    }
}

#[test]
fn a_local_offset_is_the_offset_of_g92() {
    assert_eq!(
        steps("G52 X10 Y-2\nG0 X1 Y1\nG52 X0 Y0\nG0 X1 Y1\n"),
        ["rapid 11 -1 0", "rapid 1 1 0"]
    );
}

/// G10 L10 and L11: the offset of the tool becomes such that the present position has the written
/// coordinate, in the system in force or in G59.3.
#[test]
fn tool_offsets_from_the_position() {
    let mut options = options();
    options.tools.insert(1, haptimill_gcode::Tool::default());
    options.start[2] = 30.0;
    let before = "G10 L2 P1 Z5\nG10 L2 P9 Z7\nG54\n";
    let height = |text: &str| {
        let steps = steps_with(&format!("{before}{text}G43 H1\nG0 Z0\n"), &options);
        steps.last().cloned().unwrap_or_default()
    };
    // 30 is 5 of G54, 10 as written, and 15 of the tool.
    assert_eq!(height("G10 L10 P1 Z10\n"), "rapid 0 0 20");
    // 30 is 7 of G59.3, 10 as written, and 13 of the tool; the origin of G54 is 5.
    assert_eq!(height("G10 L11 P1 Z10\n"), "rapid 0 0 18");
    // G92 shifts the system in force, and not that of G59.3.
    assert_eq!(height("G92 Z20\nG10 L10 P1 Z10\n"), "rapid 0 0 20");
    let shifted = height("G92 Z20\nG10 L11 P1 Z10\n");
    assert_eq!(shifted, "rapid 0 0 23");
}

/// Boring: G86 retracts with the spindle off, G88 pauses for the operator before.
#[test]
fn boring_stops_the_spindle_at_the_bottom() {
    let bore = |code: &str| {
        let text = format!("S100 M3 G0 Z5\n{code} X1 Z-1 R2 P0.5 F100\nG80\n");
        let steps = steps(&text);
        steps[steps.len().saturating_sub(7)..].to_vec()
    };
    let down = ["rapid 1 0 2", "feed 100 1 0 -1", "dwell 0.5", "spindle 0"];
    // G99 is in force: back to R.
    let up = ["rapid 1 0 2", "spindle 100"];
    assert_eq!(bore("G86")[1..], [&down[..], &up[..]].concat());
    assert_eq!(bore("G88"), [&down[..], &["pause"], &up[..]].concat());
    let still = refusal("G0 Z5\nG86 X1 Z-1 R2 P0.5 F100\n");
    assert!(
        still.starts_with("t.ngc:2:") && still.contains("G86"),
        "{still}"
    );
}

/// Back boring: the tool goes in and out beside the axis by I and J, each time by the same.
#[test]
fn back_boring_goes_in_beside_the_axis() {
    let text = "S100 M3 G0 Z8\nG98 G87 X10 Y20 Z-3 R2 I0.5 J-0.25 K0.5 F100\nG80\n";
    let steps = steps(text);
    let bore = [
        "rapid 10 20 8",
        "rapid 10 20 2",
        "rapid 10.5 19.75 2",
        "spindle 0",
        "rapid 10.5 19.75 -3",
        "rapid 10 20 -3",
        "spindle 100",
        "feed 100 10 20 0.5",
        "feed 100 10 20 -3",
        "spindle 0",
        "rapid 10.5 19.75 -3",
        "rapid 10.5 19.75 8",
        "rapid 10 20 8",
        "spindle 100",
    ];
    assert_eq!(steps[steps.len() - bore.len()..], bore, "{steps:#?}");
}

/// The further work offsets: each has its own origin.
#[test]
fn every_work_offset_has_its_origin() {
    let codes = [
        "G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3",
    ];
    for (index, code) in codes.into_iter().enumerate() {
        let x = 10 * (index + 1);
        let text = format!("G10 L2 P{} X{x}\n{code}\nG0 X1", index + 1);
        assert_eq!(steps(&text), [format!("rapid {} 0 0", x + 1)]);
        // The others keep theirs.
        let other = codes[(index + 1) % codes.len()];
        let text = format!("G10 L2 P{} X{x}\n{other}\nG0 X1", index + 1);
        assert_eq!(steps(&text), ["rapid 1 0 0"]);
    }
}

/// G92.2 takes the offset of G92 off and keeps it, G92.3 puts it on again; G92.1 forgets it.
#[test]
fn an_offset_of_g92_is_put_aside_and_back() {
    let begin = "G0 X10\nG92 X0\n";
    assert_eq!(steps(&format!("{begin}G0 X1"))[1], "rapid 11 0 0");
    assert_eq!(steps(&format!("{begin}G92.2\nG0 X1"))[1], "rapid 1 0 0");
    let back = steps(&format!("{begin}G92.2\nG92.3\nG0 X1"));
    assert_eq!(back[1], "rapid 11 0 0");
    let forgotten = steps(&format!("{begin}G92.1\nG92.3\nG0 X1"));
    assert_eq!(forgotten[1], "rapid 1 0 0");
}

#[test]
fn tool_lengths_are_added() {
    let mut options = options();
    for (number, z) in [(1, 10.0), (2, 3.0)] {
        let mut tool = Tool::default();
        tool.offset[2] = z;
        options.tools.insert(number, tool);
    }
    let text = "G43 H1\nG43.2 H2\nG0 Z1\nG49\nZ2";
    assert_eq!(steps_with(text, &options), ["rapid 0 0 14", "rapid 0 0 2"]);
}

/// G38.4 ends where the probe leaves; it is an error if it does not, unlike with G38.5.
#[test]
fn probe_moves_name_their_edge() {
    use haptimill_gcode::ProbeKind::{Away, Towards};
    for (code, edge, must) in [
        ("G38.2", Towards, true),
        ("G38.3", Towards, false),
        ("G38.4", Away, true),
        ("G38.5", Away, false),
    ] {
        let text = format!("{code} Z-5 F60");
        let program = read("t.ngc", text.as_bytes(), &options()).expect("a program");
        let [
            Step::Probe {
                kind, must_change, ..
            },
        ] = &program.steps[..]
        else {
            panic!("{:?}", program.steps);
        };
        assert_eq!((*kind, *must_change), (edge, must), "{code}");
    }
}

/// G61 and G61.1 stop at the end of each move, G64 blends.
#[test]
fn exact_stops_end_each_move() {
    for (code, stops) in [("G61", true), ("G61.1", true), ("G64", false)] {
        let text = format!("{code}\nG1 F100 X1\nX2");
        let program = read("t.ngc", text.as_bytes(), &options()).expect("a program");
        for step in &program.steps {
            let Step::Move(step) = step else {
                panic!("{step:?}")
            };
            assert_eq!(step.exact_stop, stops, "{code}");
        }
    }
}

#[test]
fn a_block_has_one_number() {
    assert_eq!(steps("N10 G0 X1\n/N20 X2"), ["rapid 1 0 0", "rapid 2 0 0"]);
    let two = refusal("N10 N20 G0 X1");
    assert!(two.contains("t.ngc:1:5: two block numbers"), "{two}");
    // M60 pauses as M0.
    assert_eq!(steps("M60"), steps("M0"));
}

/// Notices of a program with tool 1 of 30 mm and tool 2 of 42 mm.
fn notices(text: &str) -> Vec<String> {
    let mut options = options();
    for (number, length) in [(1, 30.0), (2, 42.0)] {
        let mut tool = haptimill_gcode::Tool::default();
        tool.offset[2] = length;
        options.tools.insert(number, tool);
    }
    let program = read("t.ngc", text.as_bytes(), &options).expect("a program");
    let notices = program.notices.into_iter();
    notices
        .map(|notice| format!("{}: {}", notice.place.line, notice.what))
        .collect()
}

#[test]
fn a_new_tool_that_cuts_without_its_length_is_noticed_once() {
    let forgotten = ["2: tool 1 cuts without its length: no G43 came after the tool was changed"];
    assert_eq!(notices("T1 M6\nG1 X1 F60\nX2\n"), forgotten);
    assert_eq!(notices("T1 M6\nG2 X10 Y0 I5 F60\n"), forgotten);
    assert_eq!(notices("T1 M6\nG81 X1 Z-1 R1 F60\n"), forgotten);
    assert_eq!(
        notices("T1 M6 G43\nG1 X1 F60\nT2 M6\nG0 X2\nG1 X3\n"),
        ["5: tool 2 cuts without its length: no G43 came after the tool was changed"]
    );
    for intended in [
        "T1 M6\nG43\nG1 X1 F60",
        "T1 M6\nG49\nG1 X1 F60",
        "T1 M6\nG43.1 Z12\nG1 X1 F60",
        "T1 M6\nG0 X1",
        "G1 X1 F60",
    ] {
        assert_eq!(notices(intended), [""; 0], "{intended}");
    }
}

#[test]
fn an_arc_with_a_zero_of_another_plane_is_noticed_outside_the_plane_xy() {
    let plane = ["2: J0 changes nothing: the arc is in the plane Z X of G18"];
    assert_eq!(notices("G18\nG2 X10 Y0 I5 J0 F60\n"), plane);
    let strict = Options {
        strict: true,
        ..options()
    };
    assert!(read("t.ngc", b"G18\nG2 X10 Y0 I5 J0 F60\n", &strict).is_err());
    // As FreeCAD writes every arc.
    assert_eq!(notices("G17\nG2 X10 Y0 I5 J0 K0 F60\n"), [""; 0]);
}
