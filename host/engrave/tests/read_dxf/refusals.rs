//! Files that are refused, with the line and the entity.

use super::{draw, mistake};
use crate::common::{dxf, sections};
use haptimill_engrave::drawing::Drawing;
use haptimill_engrave::read::{ReadOptions, read};

#[test]
fn text_without_a_font_is_refused_by_name() {
    let text =
        dxf("0 MTEXT\n5 22\n8 Words\n10 40\n20 40\n40 30\n41 5\n71 1\n72 5\n1 \\fTechnic|b0;KMITL");
    let problem = mistake(&text);
    assert!(
        problem
            .message
            .contains("MTEXT handle 22 on layer Words: 'KMITL'"),
        "{problem}"
    );
    assert!(problem.remedy.contains("--font"));
    let skip = ReadOptions {
        skip_text: true,
        ..ReadOptions::default()
    };
    let drawing = read(text.as_bytes(), &skip).unwrap();
    assert!(
        drawing
            .notices
            .iter()
            .any(|notice| notice.contains("'KMITL'"))
    );
}

#[test]
fn truncated_files_say_where_they_end() {
    let whole = dxf("0 LINE\n8 0\n10 0\n20 0\n11 1\n21 0");
    for cut in [whole.len() - 12, whole.len() / 2, 30] {
        let problem = mistake(&whole[..cut]);
        assert!(problem.message.contains("ends"), "{cut}: {problem}");
        assert!(problem.line > 0);
    }
    // No EOF, but all sections are complete: read, and said.
    let drawing = draw(whole.trim_end_matches("0\nEOF\n"));
    assert_eq!(drawing.paths.len(), 1);
    assert!(
        drawing
            .notices
            .iter()
            .any(|notice| notice.contains("no EOF"))
    );
}

#[test]
fn files_of_other_kinds_are_named() {
    assert!(
        mistake(b"AutoCAD Binary DXF\r\n\x1a\0rest")
            .message
            .contains("binary DXF")
    );
    assert!(mistake(b"AC1032").message.contains("DWG"));
    assert!(mistake(b"\x1f\x8b\x08").message.contains("compressed"));
    assert!(mistake(b"  \n ").message.contains("empty"));
    assert!(
        mistake(b"hello\nworld\n")
            .message
            .contains("'hello' is not a group code")
    );
    assert!(mistake(b"<html></html>").message.contains("html"));
}

#[test]
fn wrong_group_codes_name_their_line() {
    let text = dxf("0 LINE\n5 3F\n8 0\n10 0\n20 0\n11 1\n21 0").replace("11\n1\n", "11\n1\n\n");
    let problem = mistake(&text);
    // A line too many: line 17 is empty where a group code is due. Lines 1 to 4 begin the section,
    // the group code of the LINE is in line 5.
    let expected = "line 17: '' is not a group code of a DXF file, in LINE handle 3F of line 5";
    assert_eq!(problem.message, expected);
    assert_eq!(problem.line, 17);
    assert!(problem.remedy.contains("damaged"), "{problem}");
    // A word instead of a code, and a code that no DXF has.
    for (code, wrong) in [("40", "x40"), ("40", "4000"), ("40", "-6")] {
        let circle = dxf("0 CIRCLE\n5 A1\n8 0\n10 0\n20 0\n40 2");
        let problem = mistake(circle.replace(&format!("\n{code}\n"), &format!("\n{wrong}\n")));
        assert_eq!(problem.line, 15, "{problem}");
        let expected = format!(
            "line 15: '{wrong}' is not a group code of a DXF file, in CIRCLE handle A1 of line 5"
        );
        assert_eq!(problem.message, expected);
    }
}

#[test]
fn numbers_that_are_none_name_the_entity() {
    for (entity, part) in [
        ("0 LINE\n5 3F\n8 Cut\n10 NaN\n20 0\n11 1\n21 0", "group 10"),
        ("0 LINE\n5 3F\n8 Cut\n10 0\n20 inf\n11 1\n21 0", "group 20"),
        (
            "0 LINE\n5 3F\n8 Cut\n10 0\n20 0\n11 1e400\n21 0",
            "group 11",
        ),
        (
            "0 LINE\n5 3F\n8 Cut\n10 0\n20 0\n21 0",
            "group 11 is missing",
        ),
        (
            "0 LINE\n5 3F\n8 Cut\n10 0\n20 0\n11 1e9\n21 0",
            "farther than",
        ),
        ("0 CIRCLE\n5 3F\n8 Cut\n10 0\n20 0\n40 -1", "radius is -1"),
        (
            "0 LWPOLYLINE\n5 3F\n8 Cut\n90 2\n70 0\n10 0\n20 0\n42 1e9\n10 1\n20 0",
            "bulge 1e9",
        ),
        (
            "0 LWPOLYLINE\n5 3F\n8 Cut\n90 2\n70 0\n10 0\n20 0\n42 -1e9\n10 1\n20 0",
            "bulge -1e9",
        ),
        (
            "0 LWPOLYLINE\n5 3F\n8 Cut\n90 5\n70 0\n10 0\n20 0\n10 1\n20 0",
            "announces 5",
        ),
        (
            "0 ELLIPSE\n5 3F\n8 Cut\n10 0\n20 0\n11 1\n21 0\n40 -1",
            "the ratio -1",
        ),
        (
            "0 SPLINE\n5 3F\n8 Cut\n71 3\n11 0\n21 0\n11 1\n21 1",
            "fit points only",
        ),
        (
            "0 SPLINE\n5 3F\n8 Cut\n71 3\n40 0\n40 1\n10 0\n20 0\n10 1\n20 1\n10 2\n20 1\n10 3\n20 1",
            "has 2 knots and needs 8",
        ),
    ] {
        let problem = mistake(dxf(entity));
        assert!(problem.message.contains(part), "{part}: {problem}");
        assert!(
            problem.message.contains("handle 3F on layer Cut"),
            "{problem}"
        );
        assert!(!problem.remedy.is_empty());
    }
}

/// A message has large numbers with an exponent.
#[test]
fn large_numbers_are_short() {
    for entity in [
        "0 LINE\n8 0\n10 1e300\n20 0\n11 1\n21 1",
        "0 CIRCLE\n8 0\n10 0\n20 0\n40 1e300",
    ] {
        let problem = mistake(dxf(entity));
        assert!(problem.message.contains("1e300"), "{problem}");
        assert!(problem.message.len() < 150, "{problem}");
    }
}

/// Points far from the origin, as those of a survey, are refused by entity, also in blocks: the
/// remedy is to move the drawing. One that is moved is read to the last micrometre.
#[test]
fn a_drawing_far_from_the_origin_is_read_if_it_is_moved() {
    let at = |x: f64, y: f64| {
        sections(&[
            (
                "BLOCKS",
                "0 BLOCK\n2 B\n10 0\n20 0
                0 CIRCLE\n5 B1\n8 Cut\n10 3\n20 4\n40 2
                0 ENDBLK",
            ),
            (
                "ENTITIES",
                &format!(
                    "0 LWPOLYLINE\n5 A1\n8 Cut\n90 3\n70 1\n10 {x}\n20 {y}\n42 0.5\n10 {}\n20 {y}
                    10 {x}\n20 {}\n0 INSERT\n5 A2\n8 0\n2 B\n10 {x}\n20 {y}",
                    x + 9.0,
                    y + 7.0
                ),
            ),
        ])
    };
    let far = at(501_234.5, 5_401_234.25);
    let problems = read(far.as_bytes(), &ReadOptions::default())
        .unwrap()
        .problems;
    assert_eq!(problems.len(), 2, "{problems:?}");
    for (problem, handle) in problems.iter().zip(["A1", "B1"]) {
        assert!(
            problem.message.contains("farther than 1000000"),
            "{problem}"
        );
        assert!(
            problem.message.contains(&format!("handle {handle}")),
            "{problem}"
        );
        assert!(problem.remedy.contains("--origin lower-left"), "{problem}");
    }
    let moved = ReadOptions {
        moved: true,
        ..ReadOptions::default()
    };
    let (near, far) = (draw(&at(0.0, 0.0)), read(far.as_bytes(), &moved).unwrap());
    assert_eq!(far.problems, []);
    let vertices = |drawing: &Drawing| -> Vec<_> {
        let all = drawing.paths.iter().flat_map(|path| path.vertices.clone());
        all.collect()
    };
    let (near, far) = (vertices(&near), vertices(&far));
    assert_eq!(near.len(), far.len());
    for (a, b) in near.iter().zip(&far) {
        let off = [
            b.at[0] - 501_234.5 - a.at[0],
            b.at[1] - 5_401_234.25 - a.at[1],
        ];
        assert!(off[0].hypot(off[1]) < 1e-8, "{off:?}");
        assert!((a.bulge - b.bulge).abs() < 1e-12);
    }
    // Beyond all surveys.
    let text = dxf("0 LINE\n5 3F\n8 Cut\n10 1e11\n20 0\n11 1\n21 0");
    let problems = read(text.as_bytes(), &moved).unwrap().problems;
    assert!(
        problems[0].message.contains("farther than 1e10"),
        "{problems:?}"
    );
}
