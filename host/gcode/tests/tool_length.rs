//! Tool lengths on a machine whose workpiece turns under the tool.

use haptimill_gcode::{Coordinates, Options, ProgramAxis, Step, Tool, ToolAxis, WordKind, read};

/// X, Y, Z and A, which turns the workpiece about X; tools 1 and 2 are 12 and 20 mm longer than
/// that of the machine file.
fn options() -> Options {
    let axis = |letter| ProgramAxis {
        letter,
        kind: match letter {
            'A' => WordKind::Rotary,
            _ => WordKind::Linear,
        },
        wraps: false,
    };
    let mut options = Options {
        axes: ['X', 'Y', 'Z', 'A'].map(axis).to_vec(),
        tool_axis: ToolAxis {
            tip: [0, 1, 2],
            rotation: Some(3),
            ..ToolAxis::default()
        },
        ..Options::default()
    };
    for (number, z) in [(1, 12.), (2, 20.)] {
        let mut tool = Tool::default();
        tool.offset[2] = z;
        options.tools.insert(number, tool);
    }
    options
}

fn steps(text: &str, options: &Options) -> Vec<Step> {
    match read("t.ngc", text.as_bytes(), options) {
        Ok(program) => program.steps,
        Err(refused) => panic!("{text}\n{refused}"),
    }
}

/// Ends of the moves of a machine that turns its workpiece about X (letter A): of the tip, and of
/// the machine, rounded to 0.1 um.
fn ends(text: &str) -> Vec<[[f64; 4]; 2]> {
    let options = options();
    let rounded = |at: &Coordinates| [0, 1, 2, 3].map(|k| (at[k] * 1e4).round() / 1e4 + 0.0);
    let mut at = options.start;
    let ends = steps(text, &options).into_iter();
    ends.filter_map(|step| match step {
        Step::Move(step) | Step::Probe { step, .. } => Some(step),
        _ => None,
    })
    .map(|step| {
        // The machine does not move where another tool begins.
        let from = step.tool.machine_pose(&step.path.from);
        assert!(
            (0..4).all(|k| (from[k] - at[k]).abs() < 1e-9),
            "{from:?} {at:?}"
        );
        at = step.tool.machine_pose(&step.path.to);
        [rounded(&step.path.to), rounded(&at)]
    })
    .collect()
}

/// With A90 the spindle is on the side of +Y: the length is there, and not along Z.
#[test]
fn a_tool_length_turns_with_the_tool() {
    assert_eq!(
        ends("G43 H1\nG0 Z1\nG0 A90\nG0 Y5\nG49\nG0 Y6"),
        [
            [[0., 0., 1., 0.], [0., 0., 13., 0.]],
            [[0., 0., 1., 90.], [0., 12., 1., 90.]],
            [[0., 5., 1., 90.], [0., 17., 1., 90.]],
            [[0., 6., 1., 90.], [0., 6., 1., 90.]],
        ]
    );
    // A work offset is one of the tip; another length begins where the machine stands.
    assert_eq!(
        ends("G10 L2 P1 Y100\nG43 H1\nG0 A90 Y1\nG43 H2\nG91 G0 X1"),
        [
            [[0., 101., -12., 90.], [0., 113., -12., 90.]],
            [[1., 93., -12., 90.], [1., 113., -12., 90.]],
        ]
    );
    // An incremental length, and a state that is restored.
    assert_eq!(
        ends("G0 A90\nG43.1 Z5\nM70\nG49\nM72\nG0 X1")[1],
        [[1., -5., 0., 90.], [1., 0., 0., 90.]]
    );
}

/// G53, G28 and G30 are positions of the machine, which knows the tool of its file.
#[test]
fn machine_coordinates_are_those_of_the_machine_with_any_tool() {
    assert_eq!(
        ends("G43 H1\nG0 A90 Y3\nG53 G0 Y0 Z0\nG28.1\nG0 X7 A0\nG28\nG0 A0\nG28 Z1"),
        [
            [[0., 3., -12., 90.], [0., 15., -12., 90.]],
            [[0., -12., 0., 90.], [0., 0., 0., 90.]],
            [[7., -12., 0., 0.], [7., -12., 12., 0.]],
            [[0., -12., 0., 90.], [0., 0., 0., 90.]],
            [[0., -12., 0., 0.], [0., -12., 12., 0.]],
            [[0., -12., 1., 0.], [0., -12., 13., 0.]],
            [[0., -12., -12., 0.], [0., -12., 0., 0.]],
        ]
    );
    let lengths = "G43 H1\nG0 A90\n(PRINT,#5403 #5421 #5422 #<_abs_y> #<_y>)\nG0 X1";
    let texts = steps(lengths, &options());
    let text = texts.iter().find_map(|step| match step {
        Step::Message { text, .. } => Some(text.as_str()),
        _ => None,
    });
    assert_eq!(text, Some("12 0 -12 12 0"));
}

/// The length that G10 L10 measures is along the tool.
#[test]
fn a_turned_tool_is_measured_along_z_only() {
    assert_eq!(
        ends("G0 Z30\nG43 H2\nG10 L10 P1 Z2\nG43 H1\nG0 X1")[1],
        [[1., 0., 2., 0.], [1., 0., 30., 0.]]
    );
    let mut options = options();
    let refusal = |options: &Options, text: &[u8]| {
        let refused = read("t.ngc", text, options);
        refused.map(|_| ()).unwrap_err().to_string()
    };
    let turned = refusal(&options, b"G0 A10\nG10 L10 P1 Z2");
    assert!(turned.contains("t.ngc:2:1"), "{turned}");
    assert!(turned.contains("does not stand along Z"), "{turned}");
    let tool = Tool {
        offset: [1., 0., 12., 0., 0., 0., 0., 0., 0.],
        ..Tool::default()
    };
    options.tools.insert(1, tool);
    let sideways = refusal(&options, b"G43 H1");
    assert!(sideways.contains("no other offset"), "{sideways}");
}
