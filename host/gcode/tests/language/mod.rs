//! The language: codes against the motion that they mean, and mistakes against their messages.

mod motion;

use haptimill_gcode::{Feed, Move, Options, Step, Tool, read};

fn options() -> Options {
    crate::options("XYZA")
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
        include_str!("../programs/freecad.ngc"),
        include_str!("../programs/fusion.ngc"),
        include_str!("../programs/linuxcnc.ngc"),
    ] {
        let program = read("t.ngc", text.as_bytes(), &options())
            .unwrap_or_else(|refused| panic!("{refused}"));
        assert!(program.steps.len() > 10);
    }
}
