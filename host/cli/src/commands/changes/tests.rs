//! Tests of starts in the middle of a program and of dry runs.

use super::*;

const TEXT: &str = "G21 G90\nS500 M3\nG0 Z5\nG0 X10\nG1 Z-1 F100\nX20\nG2 Y10 J5\nM30\n";

fn program() -> (Program, Options) {
    let options = Options::of_letters("XYZBA", [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
    let program = haptimill_gcode::read("p.ngc", TEXT.as_bytes(), &options);
    (program.expect("a program"), options)
}

fn ends(program: &Program) -> Vec<(u32, Coordinates)> {
    let moves = program.steps.iter().filter_map(|step| match step {
        Step::Move(step) => Some((step.place.line, step.path.to)),
        _ => None,
    });
    moves.collect()
}

#[test]
fn a_start_in_the_middle_approaches_from_above() {
    let (mut program, options) = program();
    let whole = ends(&program);
    let change = ChangeArgs {
        from_line: Some(6),
        ..ChangeArgs::default()
    };
    let text = change
        .apply(&mut program, &options, 5.0)
        .expect("an approach");
    let text = text.expect("a description");
    assert!(text.contains("X10.000 Y0.000 Z-1.000"), "{text}");
    assert!(text.contains("up to Z5.000"), "{text}");
    assert!(text.contains("spindle 500 rev/min"), "{text}");
    let ends = ends(&program);
    let z = [ends[0].1, ends[1].1, ends[2].1].map(|end| (end[0], end[2]));
    assert_eq!(z, [(0.0, 5.0), (10.0, 5.0), (10.0, -1.0)]);
    // From there on the program is the same.
    assert_eq!(ends[3..], whole[3..]);
    let spindle = |step: &Step| matches!(step, Step::Spindle { rpm: 500, .. });
    assert_eq!(program.steps.iter().filter(|step| spindle(step)).count(), 1);
    // The path has no gap.
    let mut at = program.start;
    for step in &program.steps {
        if let Step::Move(step) = step {
            assert_eq!(step.path.from, at);
            at = step.path.to;
        }
    }
}

/// A line that calls a subroutine begins with the motion of the subroutine: one that the
/// program defines before, one behind its end, and a call in a loop.
#[test]
fn a_start_at_a_call_keeps_the_motion_of_the_subroutine() {
    let moves = "G1 X1 F100\nX2\n";
    let before = format!("G21 G90\nO1 sub\n{moves}O1 endsub\nG1 Y1 F100\nO1 call\nY2\nM30\n");
    let behind = format!("G21 G90\nG1 Y1 F100\n\n\n\n\nM98 P7\nY2\nM30\nO7\n{moves}M99\n");
    let looped =
        format!("G21 G90\nO1 sub\n{moves}O1 endsub\nO2 repeat [2]\nO1 call\nO2 endrepeat\nM30\n");
    for (text, count) in [(before, 3), (behind, 3), (looped, 4)] {
        let options = Options::of_letters("XYZ", [0.0; 6]);
        let read = haptimill_gcode::read("part", text.as_bytes(), &options);
        let mut program = read.unwrap_or_else(|refused| panic!("{text}\n{refused}"));
        let whole = ends(&program);
        let line = program.main_lines[whole.len() - count];
        let change = ChangeArgs {
            from_line: Some(line),
            ..ChangeArgs::default()
        };
        change.apply(&mut program, &options, 5.0).expect("changed");
        let ends = ends(&program);
        assert_eq!(
            ends[ends.len() - count..],
            whole[whole.len() - count..],
            "{text}"
        );
        assert_eq!(
            text.lines().nth(line as usize - 1).map(|it| &it[..2]),
            Some(if text.contains("M98") { "M9" } else { "O1" }),
            "{text}"
        );
    }
}

/// A line of a subroutine that stands before the main program: its call is named, too.
#[test]
fn a_start_in_a_subroutine_before_the_main_program_names_its_call() {
    let text = "G21 G90\nO100 sub\nG0 X2\nX3\nO100 endsub\nG0 X1\nO100 call\nX5\nM30\n";
    let options = Options::of_letters("XYZ", [0.0; 6]);
    for (line, found) in [(3, Some(3)), (4, Some(4)), (5, None), (6, None), (7, None)] {
        let read = haptimill_gcode::read("part", text.as_bytes(), &options);
        let mut program = read.unwrap_or_else(|refused| panic!("{refused}"));
        let change = ChangeArgs {
            from_line: Some(line),
            ..ChangeArgs::default()
        };
        let ended = change.apply(&mut program, &options, 5.0);
        match (found, ended) {
            (None, ended) => assert!(ended.is_ok(), "{line}"),
            (Some(at), Ok(_)) => panic!("{line} begins elsewhere than in line {at}"),
            (Some(at), Err(error)) => {
                let part = format!("line {at}, in a subroutine; begin with its call");
                assert!(error.message.contains(&part), "{}", error.message);
                assert!(error.message.contains("--from-line 7"), "{}", error.message);
            }
        }
    }
}

/// A line of a subroutine behind its last call: the call is named.
#[test]
fn a_start_in_a_subroutine_names_its_call() {
    let text = "G21 G90\nG0 X1\nM98 P7\nM30\nO7\nG0 X2\nX3\nM99\n";
    let options = Options::of_letters("XYZ", [0.0; 6]);
    for (line, part) in [
        (
            4,
            "line 6, in a subroutine; begin with its call: --from-line 3",
        ),
        (
            7,
            "line 7, in a subroutine; begin with its call: --from-line 3",
        ),
        (9, "part: nothing is to be done from line 9 on"),
    ] {
        let read = haptimill_gcode::read("part", text.as_bytes(), &options);
        let mut program = read.unwrap_or_else(|refused| panic!("{refused}"));
        let change = ChangeArgs {
            from_line: Some(line),
            ..ChangeArgs::default()
        };
        let refused = change.apply(&mut program, &options, 5.0);
        let refused = refused.expect_err("no block").to_string();
        assert!(refused.contains(part), "{refused}");
    }
}

/// The approach of a dry run says and does nothing with spindle, coolant and outputs.
#[test]
fn a_dry_start_in_the_middle_leaves_the_spindle_off() {
    let (mut program, options) = program();
    let change = ChangeArgs {
        from_line: Some(6),
        dry: true,
        ..ChangeArgs::default()
    };
    let text = change.apply(&mut program, &options, 5.0).expect("changed");
    let text = text.expect("a description");
    assert!(text.contains("spindle off"), "{text}");
    let waits = |step: &Step| matches!(step, Step::Dwell { .. } | Step::Spindle { .. });
    assert!(!program.steps.iter().any(waits), "{text}");
}

/// Coolant and outputs that the lines before switched are on before the way down.
#[test]
fn a_start_in_the_middle_restores_coolant_and_outputs() {
    let text = "G21 G90\nM7\nM8\nM64 P1\nM62 P2\nM65 P2\nM68 E3 Q0.5\nG1 X1 F100\nX2\nM30\n";
    let mut options = Options::of_letters("XYZ", [0.0; 6]);
    options.coolant = true;
    options.outputs = true;
    let program = haptimill_gcode::read("p.ngc", text.as_bytes(), &options);
    let mut program = program.expect("a program");
    let change = ChangeArgs {
        from_line: Some(9),
        ..ChangeArgs::default()
    };
    let said = change.apply(&mut program, &options, 5.0).expect("sound");
    let said = said.expect("a description");
    let expected = "mist and flood on, output 1 on, output 2 off, output 3 at 0.5, then down";
    assert!(said.contains(expected), "{said}");
    let mut switched = Vec::new();
    for step in program
        .steps
        .iter()
        .take_while(|step| !matches!(step, Step::Move(step) if step.path.to[0] == 2.0))
    {
        match step {
            Step::Coolant { mist, flood, .. } => assert!(*mist && *flood),
            Step::Output { number, value, .. } => switched.push((*number, *value)),
            _ => continue,
        }
    }
    let expected = [
        (1, OutputValue::Digital(true)),
        (2, OutputValue::Digital(false)),
        (3, OutputValue::Analogue(0.5)),
    ];
    assert_eq!(switched, expected);
}

#[test]
fn a_line_beyond_the_end_is_refused() {
    let (mut program, options) = program();
    let change = ChangeArgs {
        from_line: Some(900),
        ..ChangeArgs::default()
    };
    let refused = change
        .apply(&mut program, &options, 5.0)
        .expect_err("refused");
    assert!(refused.message.contains("is in line 8"), "{refused}");
}

#[test]
fn a_dry_run_is_the_same_path_higher_without_spindle() {
    let (mut program, options) = program();
    let whole = ends(&program);
    let change = ChangeArgs {
        dry: true,
        lift: Some(7.5),
        ..ChangeArgs::default()
    };
    change.apply(&mut program, &options, 5.0).expect("changed");
    let ends = ends(&program);
    assert_eq!(ends[0].1[2], 8.5);
    assert_eq!(ends.len(), whole.len() + 1);
    for (dry, wet) in ends[1..].iter().zip(&whole) {
        assert_eq!(dry.1[2], wet.1[2] + 7.5);
        assert_eq!(dry.1[..2], wet.1[..2]);
    }
    let spindle = |step: &Step| matches!(step, Step::Spindle { .. });
    assert!(!program.steps.iter().any(spindle));
}

/// The tip of a longer tool passes over what the program passed over, however the tool stands.
#[test]
fn an_approach_with_a_longer_tool_keeps_its_tip_above() {
    let mut options = Options::of_letters("XYZA", [-50.0, 0.0, 60.0, 0.0, 0.0, 0.0]);
    options.tool_axis = haptimill_gcode::ToolAxis {
        tip: [0, 1, 2],
        rotation: Some(3),
        ..Default::default()
    };
    let text = "G90 G43.1 Z50\nG0 A60\nG0 Z25\nG0 X40\nG1 Z22 F300\nX50\nM30\n";
    let program = haptimill_gcode::read("p.ngc", text.as_bytes(), &options);
    let mut program = program.expect("a program");
    let change = ChangeArgs {
        from_line: Some(6),
        ..ChangeArgs::default()
    };
    change
        .apply(&mut program, &options, 5.0)
        .expect("an approach");
    let mut machine = options.start;
    let mut min = f64::INFINITY;
    for step in &program.steps {
        let Step::Move(step) = step else { continue };
        assert_eq!(step.tool.machine_pose(&step.path.from), machine);
        machine = step.tool.machine_pose(&step.path.to);
        if step.tool.length == 0.0 && step.path.from[0] != step.path.to[0] {
            // Over the part. The tool in the spindle is that of the program.
            for part in 0..=20 {
                let at = step.path.at(step.path.length * f64::from(part) / 20.0);
                min = min.min(at[2] - 50.0 * at[3].to_radians().cos());
            }
        }
    }
    assert!((25.0 - 1e-9..60.0).contains(&min), "{min}");
}

#[test]
fn single_block_pauses_between_blocks() {
    let (mut program, options) = program();
    let blocks: std::collections::BTreeSet<u32> =
        program.steps.iter().map(|step| step.place().line).collect();
    let change = ChangeArgs {
        single: true,
        ..ChangeArgs::default()
    };
    change.apply(&mut program, &options, 5.0).expect("changed");
    let pauses = |step: &&Step| matches!(step, Step::Pause { .. });
    let pauses = program.steps.iter().filter(pauses).count();
    assert_eq!(pauses, blocks.len() - 1);
}
