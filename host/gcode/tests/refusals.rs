//! Refusals: words that no code of their block uses, one error for one mistake, and remedies.

use haptimill_gcode::{Dialog, Options, Step, Tool, read};

fn options() -> Options {
    crate::options("XYZA")
}

fn with_tools() -> Options {
    let mut options = options();
    let mut tool = Tool::default();
    tool.offset[2] = 10.0;
    tool.diameter = 6.0;
    options.tools.insert(1, tool);
    options
}

fn refused(text: &[u8], options: &Options) -> String {
    let shown = String::from_utf8_lossy(text);
    read("t.ngc", text, options)
        .err()
        .unwrap_or_else(|| panic!("accepted: {shown}"))
        .to_string()
}

/// Checks that a program has one error, at a place, with a text in problem and remedy.
fn one_error(text: &str, at: &str, what: &str, remedy: &str) {
    let found = refused(text.as_bytes(), &with_tools());
    assert_eq!(found.lines().count(), 1, "{text:?}\n{found}");
    let (problem, help) = found.split_once("; ").unwrap_or((&found, ""));
    assert!(
        problem.starts_with(&format!("t.ngc:{at}: ")),
        "{text:?}\n{found}"
    );
    assert!(problem.contains(what), "{text:?}\n{found}");
    assert!(help.contains(remedy), "{text:?}\n{found}");
}

/// Ends of the moves in X, Y, Z, rounded to 0.1 um.
fn ends(text: &str) -> Vec<[f64; 3]> {
    let program = read("t.ngc", text.as_bytes(), &with_tools())
        .unwrap_or_else(|refused| panic!("{text}\n{refused}"));
    let moves = program.steps.iter().filter_map(|step| match step {
        Step::Move(step) => Some([0, 1, 2].map(|k| (step.path.to[k] * 1e4).round() / 1e4 + 0.0)),
        _ => None,
    });
    moves.collect()
}

/// Two codes that both use the axis words: one of them would be lost.
#[test]
fn a_motion_word_is_not_lost() {
    for code in ["G92", "G52", "G10 L2 P1", "G28", "G30", "G43.1", "G43.2"] {
        let name = code.split(' ').next().unwrap_or_default();
        one_error(
            &format!("F100\n{code} G1 X5\n"),
            &format!("2:{}", code.len() + 2),
            &format!("G1 and {name} in one block: both use the axis words"),
            "write the move in another block",
        );
    }
    one_error("G92 G0 X5\n", "1:5", "G0 and G92", "another block");
    // A rapid move is what G28 and G30 are; G80 is no move.
    assert_eq!(ends("G0 Z5\nG0 G28 G91 Z0\n")[1..], [[0., 0., 0.]]);
    assert_eq!(
        ends("G0 Z5\nG0 G30 G91 Z1\n")[1..],
        ends("G0 Z5\nG30 G91 Z1\n")[1..]
    );
    assert_eq!(ends("G0 Z5\nG80 G28 Z6\n").len(), 3);
    assert_eq!(ends("F9 G1 G28.1 X5\nG1 G92.2 X6\n").len(), 2);
    // The words of G43.2 without H are added to the offset.
    assert_eq!(ends("G43 H1\nG43.2 Z5\nG0 Z1\n"), [[0., 0., 16.]]);
}

#[test]
fn each_word_belongs_to_a_code() {
    for (text, at, what, remedy) in [
        (
            "G10 L2 P1 X1 I5",
            "1:14",
            "I5 in the block of G10",
            "remove it",
        ),
        (
            "G10 L20 P1 X1 J5",
            "1:15",
            "J5 in the block of G10",
            "remove it",
        ),
        (
            "G10 L1 P1",
            "1:1",
            "G10 L1 without a value",
            "write axis words",
        ),
        ("G10 L1 P1 R-3", "1:11", "a radius of -3 mm", "G42"),
        (
            "F9 G81 X1 Z-5 R2 P1",
            "1:18",
            "P1 has no meaning in G81",
            "G82",
        ),
        (
            "F9 G81 X1 Z-5 R2 Q1",
            "1:18",
            "Q1 has no meaning in G81",
            "G83",
        ),
        (
            "F9 G85 X1 Z-5 R2 P1",
            "1:18",
            "P1 has no meaning in G85",
            "G89",
        ),
        (
            "F9 G85 X1 Z-5 R2 Q1",
            "1:18",
            "Q1 has no meaning in G85",
            "G83",
        ),
        (
            "F9 G83 X1 Z-5 R2 Q1 P1",
            "1:21",
            "P1 has no meaning in G83",
            "G82",
        ),
        (
            "F9 G81 X1 Z-5 R2\nR3\nX2",
            "2:1",
            "R3 without a hole",
            "axis word",
        ),
        (
            "F9 G83 X1 Z-5 R2 Q1\nQ2\nX2",
            "2:1",
            "Q2 without a hole",
            "axis word",
        ),
        (
            "F9 G81 X1 Z-5 R2\nL2\nX2",
            "2:1",
            "L2 without a hole",
            "axis word",
        ),
        (
            "F9 G2 X2 I1\nP2\nX4 I1",
            "2:1",
            "P2 belongs to no word",
            "remove it",
        ),
        (
            "G0 Z1\nG43.2 H1 Z5",
            "2:10",
            "Z5 with G43.2 and H",
            "another block",
        ),
        ("F9 G5 X1 Y1 I1 P1 Q1", "1:13", "I1 without J", "write both"),
        ("F9 G5 X1 Y1 I1 J1 P1", "1:19", "P1 without Q", "write both"),
        ("G0 X1\nG53", "2:1", "G53 without a move", "G53 G0"),
        ("G53 G28 Z0", "1:1", "G53 without a move", "G53 G0"),
        ("M19 R500", "1:5", "R500 is not an angle of", "0 to 360"),
        ("M19 R-5", "1:5", "R-5 is not an angle", "0 to 360"),
        ("M19 R5 P3", "1:8", "P3 is not a direction", "0, 1 or 2"),
        ("M19 R5 Q0", "1:8", "Q0 is not a time limit", "above 0"),
        (
            "M61 Q500",
            "1:5",
            "tool 500 is not in the tool table",
            "add it",
        ),
        ("G2 G28 X5 I1", "1:1", "G2 and G28", "another block"),
    ] {
        one_error(text, at, what, remedy);
    }
    // Words that mean nothing on a mill are noticed, as rs274 accepts them.
    for text in ["G10 L2 P1 X1 Q3", "G10 L1 P1 Z1 I3 J3 Q3"] {
        let program = read("t.ngc", text.as_bytes(), &with_tools()).expect("a notice");
        assert_eq!(program.notices.len(), 1, "{text}");
        assert!(program.notices[0].what.contains("G10"), "{text}");
    }
    for text in [
        "G10 L2 P1",
        "G10 L1 P1 R3",
        "G43.1",
        "M19 R360 P1 Q2.5",
        "G4 P1",
        "F9 G82 X1 Z-5 R2 P1\nG4 P2\nX2 L2\nX3 R3 P2",
        "F9 G83 X1 Z-5 R2 Q1 L2\nX4",
        "S9 M3 F9 G84 X1 Z-5 R2 P1\nX4",
        "F9 G2 I1 P2\nI1\nJ1 P3",
        "G0 G53 X1\nG53 X2\nG53 G0",
        "M61 Q1\nM61 Q0",
        "F9 G5 X1 Y1 I1 J1 P1 Q1\nX2 P1 Q0",
        "F9 G5.1 X1 Y1 I1",
    ] {
        ends(text);
    }
    // Without a table any tool is accepted.
    read("t.ngc", b"M61 Q500".as_slice(), &options()).expect("no table");
}

/// One mistake is one error: what follows from it is not reported.
#[test]
fn a_mistake_of_a_series_is_one_error() {
    for (text, at, what) in [
        (
            "F9 G83 X5 Z-5 R2\nX10\nG83 X15\nX20\n",
            "1:8",
            "G83 without Q",
        ),
        ("F9 G81 X5 Z5 R2\nX10\nX15\n", "1:8", "below its bottom"),
        ("F9 G82 X5 Z-5 R2\nX10\n", "1:8", "without P"),
        ("G93 G81 X5 Z-5 R2 F9\nX10\n", "1:9", "inverse time"),
        (
            "G10 L2 P1 R30\nF9 G18 G81 X1 Z5 Y-5 R3\nX2\nX3\n",
            "2:12",
            "outside the plane of G17 in a turned",
        ),
        (
            "G10 L2 P1 R30\nF9 G18 G2 X10 I5\nX20 I5\nG1 X25\nG2 X30 I2.5\n",
            "2:8",
            "outside the plane of G17 in a turned",
        ),
        (
            // The next corner can be reached.
            "F9 G0 X-20\nG41.1 D10 G1 X0 Y0\nX20\nX22 Y2\nX22 Y40\nX-40\nG40 X-60 Y90\n",
            "5:1",
            "cannot reach this inside corner",
        ),
        (
            // An arc that is too narrow for the cutter, and corners that are not.
            "F9 G0 X-20\nG41.1 D10 G1 X0 Y0\nX20\nG3 X26 Y6 J6 I0\nG1 Y40\nX-40\nG40 X-60\n",
            "",
            "",
        ),
        (
            "F9 G0 X-20\nG41.1 D10 G1 X0 Y0\nX20\nG3 X23 Y3 J3\nG1 Y40\nX-40\nG40 X-60\n",
            "4:4",
            "the radius of the arc is not larger",
        ),
        (
            "F9 G41.1 D10 G1 X2\nX4\nX8\nY-30\nG40 X-50\n",
            "1:17",
            "not longer than",
        ),
        (
            "F9 G41.1 D10 G2 X2 I1\nG1 X4\nX8\n",
            "1:17",
            "not longer than",
        ),
        (
            "F9 G5.2 X1 Y1 P1\nG1 X5\nX6\nG5.3\n",
            "2:1",
            "before the end of the NURBS",
        ),
        (
            "F9 G5 X5 Y5 P1 Q1\nX10 Y5 P1 Q1\n",
            "1:7",
            "the first G5 without I and J",
        ),
        (
            "F9 G18 G5 X5 Y5 I1 J1 P1 Q1\nX10 Y5 P1 Q1\n",
            "1:11",
            "outside the plane X Y",
        ),
        (
            "(a comment\nover three\nlines)\nG0 X1\n",
            "1:1",
            "comment is not closed",
        ),
        (
            "(a comment\n\nT1 M6\nits end)\nG0 X1\n",
            "1:1",
            "comment is not closed",
        ),
        (
            "T150 M6\nG43 H150\nG41 D150\nG0 Z5\n",
            "1:1",
            "tool 150 is not in the tool table",
        ),
        (
            "M61 Q150\nG0 G43 H150 Z5\n",
            "1:5",
            "tool 150 is not in the tool table",
        ),
        // The same block, in two rounds.
        (
            "O1 repeat [5]\nG2 X5 I1\nO1 endrepeat\n",
            "2:1",
            "from its centre",
        ),
    ] {
        if what.is_empty() {
            ends(text);
        } else {
            one_error(text, at, what, "");
        }
    }
}

/// What does not follow from a mistake is reported beside it.
#[test]
fn other_mistakes_are_reported_beside_it() {
    for (text, errors) in [
        // Another cycle begins another series.
        ("F9 G83 X5 Z-5 R2\nX10\nG81 X1 Z5 R1\nX2\n", 2),
        // Each tool that is missing.
        ("T150 M6\nG43 H151\n", 2),
        // The words beside an unclosed comment, and a comment far from it.
        ("G0 X1 (open\nG0 X2\nG0 Q4\n(two) ) G0 X1\n", 3),
        ("(open\nwords\n(closed)\nG77\nG0 X1 )\n", 3),
    ] {
        let found = refused(text.as_bytes(), &with_tools());
        assert_eq!(found.lines().count(), errors, "{text}\n{found}");
    }
}

#[test]
fn each_corner_that_cannot_be_reached_is_named() {
    let text = "F9 G0 X-20\nG41.1 D10 G1 X0 Y0\nX20\nX22 Y2\nX22 Y40\nX20 Y42\nX-40\nG40 X-60\n";
    one_error(
        text,
        "5:1",
        "inside corner without cutting into the contour (also in line 6)",
        "",
    );
}

#[test]
fn a_file_of_two_bytes_per_character_is_said_once() {
    let text = "G0 X1\nG1 X2 F10\n(\u{e9})\n";
    let little: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let big: Vec<u8> = text.encode_utf16().flat_map(u16::to_be_bytes).collect();
    let marked = |mark: [u8; 2], bytes: &[u8]| [&mark[..], bytes].concat();
    for bytes in [
        marked([0xFF, 0xFE], &little),
        marked([0xFE, 0xFF], &big),
        little,
        big,
    ] {
        let found = refused(&bytes, &options());
        assert_eq!(
            found,
            "t.ngc:1:1: the file is UTF-16 text; save it as plain text (ASCII or UTF-8)"
        );
    }
}

/// A mistake in a line that was entered by hand does not hide the same mistake in the next one.
#[test]
fn each_entered_line_has_its_own_mistakes() {
    let mut dialog = Dialog::new(&with_tools());
    for line in ["G1 X5", "G1 X5", "T150 M6", "T150 M6", "X#<a>", "X#<a>"] {
        dialog.enter(line);
        assert!(dialog.next_step().is_err(), "{line}");
    }
    dialog.enter("G0 X5");
    assert!(matches!(dialog.next_step(), Ok(Some(Step::Move(_)))));
}

/// Words of other dialects: the remedy leads to the same meaning, not to a program that is accepted
/// with another one.
#[test]
fn a_remedy_keeps_the_meaning() {
    for (text, at, what, remedy) in [
        (
            "#1=3\n#2=#1*2",
            "2:6",
            "a calculation outside [ ]",
            "write [#1*2]",
        ),
        (
            "#1=#1+1",
            "1:6",
            "a calculation outside [ ]",
            "write [#1+1]",
        ),
        (
            "#1 = #1 - 1 (down)",
            "1:9",
            "a calculation outside [ ]",
            "write [#1 - 1]",
        ),
        (
            "#1=#1/2 ; half",
            "1:6",
            "a calculation outside [ ]",
            "write [#1/2]",
        ),
        (
            "#1=2**3",
            "1:5",
            "a calculation outside [ ]",
            "write [2**3]",
        ),
        (
            "#1=4 #2=#1*2 #3=1",
            "1:11",
            "a calculation outside [ ]",
            "write [#1*2]",
        ),
        (
            "#1=1\nG0 X#1+2",
            "2:7",
            "a calculation outside [ ]",
            "write [#1+2]",
        ),
        (
            "#1=1\nG0 X#1*2",
            "2:7",
            "a calculation outside [ ]",
            "write [#1*2]",
        ),
        (
            "G0 X[1+2]*2 Y1",
            "1:10",
            "a calculation outside [ ]",
            "write [[1+2]*2]",
        ),
        (
            "#1=1\n#2=ABS[#1]*2",
            "2:11",
            "a calculation outside [ ]",
            "write [ABS[#1]*2]",
        ),
        (
            "#<a b>=1\n#2=#<a b>*2",
            "2:10",
            "a calculation outside [ ]",
            "write [#<a b>*2]",
        ),
        (
            "#1=5 G0 X5*33",
            "1:11",
            "checksums are not supported",
            "X[#1*2]",
        ),
        (
            "#1=5 G0 X5 /3",
            "1:12",
            "a slash inside a block",
            "divisions in [ ]",
        ),
        ("#1=5*", "1:5", "checksums are not supported", "X[#1*2]"),
        (
            "N5 G0 X5*33",
            "1:9",
            "checksums are not supported",
            "X[#1*2]",
        ),
        (
            "G0 X5 *33",
            "1:7",
            "checksums are not supported",
            "remove the * and",
        ),
        (
            "G0 X1.2.3",
            "1:8",
            "a number without a letter",
            "write the letter",
        ),
        (
            "G54.1 P1",
            "1:1",
            "G54.1 is not supported",
            "G59.1 to G59.3",
        ),
        (
            "IF [#1 EQ 0] GOTO 10\nN10 G0 X1",
            "1:1",
            "IF of another dialect",
            "O1 if [ ]",
        ),
        (
            "IF[#1EQ0]THEN #2=1",
            "1:1",
            "IF of another dialect",
            "O1 endif",
        ),
        (
            "WHILE [#1 LT 3] DO1\n#1=[#1+1]\nEND1",
            "1:1",
            "WHILE of another dialect",
            "O1 endwhile",
        ),
        (
            "N5 goto 10\nGOTO10",
            "1:4",
            "goto of another dialect",
            "O1 if [ ]",
        ),
        (
            ":0001\nG0 X1",
            "1:1",
            "':' in front of a program number",
            "write O0001",
        ),
        ("G0 : X1", "1:4", "':' is not supported", "remove it"),
        (
            "E5",
            "1:1",
            "E5 belongs to no word of its block",
            "M66 to M68",
        ),
        (
            "G0 X1 E0.",
            "1:7",
            "E0. belongs to no word of its block",
            "M66 to M68",
        ),
        (
            "G0 X1E0",
            "1:6",
            "exponents are not supported",
            "write all digits",
        ),
    ] {
        one_error(text, at, what, remedy);
    }
    // Letters that only begin like a word of another dialect.
    one_error(
        "I F1",
        "1:1",
        "the letter I has no number",
        "write a number",
    );
    one_error(
        "Gopher",
        "1:1",
        "the letter G has no number",
        "write a number",
    );
}

/// The same problem in other lines is one error, which names them.
#[test]
fn the_same_problem_in_other_lines_is_counted_with_the_first() {
    let found = refused(b"M105\nG0 X1\nM105\nM105\nM105\nM105\n", &options());
    let expected = "t.ngc:1:1: M105 is not supported (also in lines 3, 4, 5 and 1 more); ";
    assert!(found.starts_with(expected), "{found}");
    assert_eq!(found.lines().count(), 1, "{found}");
    let found = refused(b"G0 U1\nX2 U2\n", &options());
    assert_eq!(found.lines().count(), 1, "{found}");
    let found = refused(b"G3 X10 I5 F100\nG3 X1\nX2\nX3\n", &options());
    assert!(found.contains("(also in lines 3, 4)"), "{found}");
    // A loop counts each line once.
    let mut text = "O1 repeat [40]\n".to_string();
    for number in 0..60 {
        text += &format!("G0 X1 Q{number}\n");
    }
    let found = refused((text + "O1 endrepeat\n").as_bytes(), &options());
    assert!(found.ends_with("t.ngc: 10 more problems"), "{found}");
    one_error("G1 X10 F100 ,C2\n", "1:13", "chamfer", "move of its own");
}

#[test]
fn the_main_program_ends_before_a_subprogram_and_the_tape_at_its_mark() {
    let once = "G21\nM98 P1000\nG0 Y5\nO1000\nG0 X1\nM99\n";
    assert_eq!(ends(once), [[1., 0., 0.], [1., 5., 0.]]);
    let program = read("t.ngc", once.as_bytes(), &options()).expect("read");
    assert!(
        program.notices[0]
            .what
            .contains("before its subprogram O1000")
    );
    // One that makes no step is no title of the main program.
    assert_eq!(ends("G21\nM98 P7\nO7\nG4 P0\nM99\n"), [[0.0; 3]; 0]);
    // Without a call of its own it is no subprogram.
    let other = "M98 P2\nO1234\nG0 X2\nM30\nO2\nG0 X1\nM99\n";
    one_error(other, "2:1", "program number O1234", "M30");
    one_error(
        "G0 X1\nO1000\nG0 X2\n",
        "2:1",
        "program number O1000",
        "M30",
    );
    let behind = "%\nG21 G0 X1\nM98 P2\n%\nO2\nG0 X5\nM99\n";
    one_error(behind, "3:1", "O2 does not exist", "write it in this file");
    let before = "%\nG21 G0 X1\nM98 P2\nM30\nO2\nG0 X5\nM99\n%\n";
    assert_eq!(ends(before), [[1., 0., 0.], [5., 0., 0.]]);
}

#[test]
fn words_that_linuxcnc_accepts() {
    assert_eq!(ends("N56.78 G21 G0 X1\n"), [[1., 0., 0.]]);
    assert_eq!(
        ends("G21 G0 X[#<_value>+#<_value_returned>+1]\n"),
        [[1., 0., 0.]]
    );
}
