//! DXF drawings: every entity kind, the listings of the thesis, and bad files.

mod common;

use common::{dxf, sections};
use haptimill_engrave::drawing::{Drawing, Problem};
use haptimill_engrave::geometry::{Path, Point, distance};
use haptimill_engrave::read::{ReadOptions, read};

fn draw(text: &str) -> Drawing {
    let drawing = read(text.as_bytes(), &ReadOptions::default()).unwrap();
    assert_eq!(drawing.problems, []);
    drawing
}

/// The mistake of a drawing that cannot be read, or the first of its entities.
fn mistake(text: impl AsRef<[u8]>) -> Problem {
    match read(text.as_ref(), &ReadOptions::default()) {
        Err(problem) => problem,
        Ok(drawing) => drawing.problems.into_iter().next().expect("a problem"),
    }
}

fn near(a: Point, b: Point) -> bool {
    distance(a, b) < 1e-4
}

fn ends(path: &Path) -> (Point, Point) {
    (path.start().unwrap(), path.end().unwrap())
}

/// Listing of figure 3.11 of the thesis: line, arc about (37.5, 27.5), line.
#[test]
fn polyline_of_figure_3_11() {
    let open = "0 LWPOLYLINE
        5 24
        8 0
        90 4
        70 0
        43 0.0
        10 10.0
        20 10.0
        10 40.0
        20 20.0
        42 1.0
        10 35.0
        20 35.0
        10 10.0
        20 10.0";
    let drawing = draw(&dxf(open));
    let path = &drawing.paths[0];
    let segments: Vec<_> = path
        .segments()
        .map(|one| (one.from, one.to, one.bulge))
        .collect();
    let listed = [
        ([10.0, 10.0], [40.0, 20.0], 0.0),
        ([40.0, 20.0], [35.0, 35.0], 1.0),
        ([35.0, 35.0], [10.0, 10.0], 0.0),
    ];
    assert_eq!(segments, listed);
    let arc = path.segment(1).arc().unwrap();
    assert!(near(arc.centre, [37.5, 27.5]) && arc.sweep > 0.0);
    assert!((arc.radius - 7.905_694).abs() < 1e-6);
    assert_eq!(drawing.entity(path).handle.as_deref(), Some("24"));
    // The closed flag adds a segment from the last vertex to the first one. Of this listing it has
    // no length and draws nothing.
    let closed = draw(&dxf(&open.replace("70 0", "70 1")));
    assert!(closed.paths[0].closed);
    let segments: Vec<_> = closed.paths[0].segments().collect();
    let around: Vec<_> = segments
        .iter()
        .map(|one| (one.from, one.to, one.bulge))
        .collect();
    assert_eq!(around, listed);
    let other = open.replace("20 10.0\n        10 40.0", "20 12.0\n        10 40.0");
    let closed = draw(&dxf(&other.replace("70 0", "70 1")));
    assert_eq!(closed.paths[0].segment_count(), 4);
    let last = closed.paths[0].segment(3);
    assert_eq!((last.from, last.to), ([10.0, 10.0], [10.0, 12.0]));
}

/// Figure 2(a) of the paper in the thesis's appendix C: a line and an arc of 0 to 220 degrees.
#[test]
fn line_and_arc() {
    let text = "0 LINE
        8 0
        10 0.0
        20 0.0
        11 40.0
        21 40.0
        0 ARC
        8 0
        10 20.0
        20 30.0
        40 10.0
        50 0.0
        51 220.0";
    let drawing = draw(&dxf(text));
    assert_eq!(ends(&drawing.paths[0]), ([0.0, 0.0], [40.0, 40.0]));
    let (start, end) = ends(&drawing.paths[1]);
    assert!(
        near(start, [30.0, 30.0]) && near(end, [12.3396, 23.5721]),
        "{end:?}"
    );
    assert!((drawing.paths[1].length() - 38.3972).abs() < 1e-4);
    assert_eq!(drawing.paths[1].segment_count(), 1);
}

/// Only the section ENTITIES is drawn; look-alikes elsewhere are not.
#[test]
fn other_sections_draw_nothing() {
    let line = "0 LINE\n8 0\n10 1\n20 2\n11 3\n21 4";
    let alone = draw(&dxf(line));
    let others = draw(&sections(&[
        ("HEADER", "9 $INSUNITS\n70 4"),
        (
            "TABLES",
            "0 TABLE\n2 LAYER\n0 LAYER\n2 0\n70 0\n62 7\n0 ENDTAB",
        ),
        (
            "BLOCKS",
            &format!("0 BLOCK\n2 B\n10 0\n20 0\n{line}\n0 ENDBLK"),
        ),
        ("ENTITIES", line),
        ("OBJECTS", "0 DICTIONARY\n5 C"),
    ]));
    assert_eq!(alone.paths, others.paths);
}

#[test]
fn circle_starts_at_0_degrees_and_runs_counter_clockwise() {
    let drawing = draw(&dxf("0 CIRCLE\n8 0\n10 5\n20 6\n40 2"));
    let path = &drawing.paths[0];
    assert!(path.closed);
    assert_eq!(path.start(), Some([7.0, 6.0]));
    assert!(path.vertices.iter().all(|vertex| vertex.bulge == 1.0));
    assert_eq!(drawing.circle_centre(path), Some([5.0, 6.0]));
}

#[test]
fn units_scale_the_drawing_and_missing_ones_are_noted() {
    let line = "0 LINE\n8 0\n10 0\n20 0\n11 1\n21 0";
    let inches = sections(&[("HEADER", "9 $INSUNITS\n70 1"), ("ENTITIES", line)]);
    assert_eq!(draw(&inches).paths[0].length(), 25.4);
    let none = draw(&dxf(line));
    assert_eq!(none.paths[0].length(), 1.0);
    assert!(none.notices[0].contains("no unit") && none.notices[0].contains("--unit"));
    let stated = ReadOptions {
        unit_mm: Some(10.0),
        ..ReadOptions::default()
    };
    assert_eq!(
        read(inches.as_bytes(), &stated).unwrap().paths[0].length(),
        10.0
    );
    let odd = sections(&[("HEADER", "9 $INSUNITS\n70 77"), ("ENTITIES", line)]);
    assert!(mistake(odd).message.contains("77"));
}

#[test]
fn blocks_are_placed_scaled_and_turned() {
    let blocks = "0 BLOCK
        2 Part
        10 1
        20 0
        0 LINE
        5 A1
        8 0
        10 1
        20 0
        11 3
        21 0
        0 CIRCLE
        8 Holes
        10 1
        20 0
        40 1
        0 ENDBLK
        0 BLOCK
        2 OUTER
        10 0
        20 0
        0 INSERT
        2 PART
        10 0
        20 0
        0 ENDBLK";
    let insert = "0 INSERT
        5 B7
        8 Top
        2 OUTER
        10 10
        20 20
        41 2
        42 2
        50 90
        70 2
        44 5";
    let drawing = draw(&sections(&[("BLOCKS", blocks), ("ENTITIES", insert)]));
    assert_eq!(drawing.paths.len(), 4);
    let (start, end) = ends(&drawing.paths[0]);
    assert!(
        near(start, [10.0, 20.0]) && near(end, [10.0, 24.0]),
        "{start:?} {end:?}"
    );
    let (start, _) = ends(&drawing.paths[2]);
    assert!(near(start, [10.0, 25.0]), "{start:?}");
    // Layer 0 of a block is the layer of its reference; the circle stays an arc.
    assert_eq!(drawing.entity(&drawing.paths[0]).layer, "Top");
    assert_eq!(drawing.entity(&drawing.paths[1]).layer, "Holes");
    assert_eq!(drawing.paths[1].vertices.len(), 2);
    assert!(
        drawing
            .entity(&drawing.paths[0])
            .kind
            .contains("INSERT OUTER handle B7")
    );
    // A block with different scales makes ellipses of arcs.
    let wide = insert.replace("42 2", "42 1");
    let drawing = draw(&sections(&[("BLOCKS", blocks), ("ENTITIES", &wide)]));
    assert!(drawing.paths[1].vertices.len() > 4);
}

#[test]
fn blocks_that_contain_themselves_end() {
    let blocks = "0 BLOCK\n2 A\n10 0\n20 0\n0 INSERT\n5 9\n2 A\n10 0\n20 0\n0 ENDBLK";
    let text = sections(&[
        ("BLOCKS", blocks),
        ("ENTITIES", "0 INSERT\n5 1F\n8 L\n2 A\n10 0\n20 0"),
    ]);
    let problem = mistake(text);
    assert!(
        problem.message.contains("itself") || problem.message.contains("no block"),
        "{problem}"
    );
    let problem = mistake(dxf("0 INSERT\n5 1F\n8 L\n2 MISSING\n10 0\n20 0"));
    assert!(
        problem.message.contains("handle 1F on layer L") && problem.message.contains("MISSING")
    );
}

#[test]
fn other_curves_become_arcs() {
    let text = "0 ELLIPSE
        8 0
        10 0
        20 0
        11 20
        21 0
        40 0.5
        41 0
        42 6.283185307
        0 SPLINE
        8 0
        70 8
        71 3
        40 0
        40 0
        40 0
        40 0
        40 1
        40 1
        40 1
        40 1
        10 0
        20 0
        10 0
        20 10
        10 10
        20 10
        10 10
        20 0
        0 POLYLINE
        8 0
        66 1
        70 1
        0 VERTEX
        8 0
        10 0
        20 0
        42 1
        0 VERTEX
        8 0
        10 2
        20 0
        42 1
        0 SEQEND
        0 SOLID
        8 0
        10 0
        20 0
        11 1
        21 0
        12 0
        22 1
        13 1
        23 1";
    let drawing = draw(&dxf(text));
    assert_eq!(drawing.paths.len(), 4);
    // Circumference of the ellipse with half axes 20 and 10: 96.8845 mm.
    assert!((drawing.paths[0].length() - 96.8845).abs() < 0.01);
    assert!(drawing.paths[0].closed);
    // Length of this cubic: 20 mm (its hodograph is a parabola with a double root).
    assert!(
        (drawing.paths[1].length() - 20.0).abs() < 0.01,
        "{}",
        drawing.paths[1].length()
    );
    assert!((drawing.paths[2].length() - std::f64::consts::TAU).abs() < 1e-9);
    assert!((drawing.paths[3].length() - 4.0).abs() < 1e-12);
}

/// A view from below (extrusion 0, 0, -1) mirrors x.
#[test]
fn entities_seen_from_below_are_mirrored() {
    let drawing = draw(&dxf(
        "0 ARC\n8 0\n10 5\n20 0\n40 1\n50 0\n51 90\n210 0\n220 0\n230 -1",
    ));
    let (start, end) = ends(&drawing.paths[0]);
    assert!(
        near(start, [-6.0, 0.0]) && near(end, [-5.0, 1.0]),
        "{start:?} {end:?}"
    );
    let tilted = dxf("0 CIRCLE\n5 7\n8 0\n10 0\n20 0\n40 1\n210 1\n220 0\n230 0");
    assert!(mistake(tilted).message.contains("handle 7"));
}

/// Whatever is not cut is named with its line, handle and layer.
#[test]
fn what_is_left_out_is_reported() {
    let text = sections(&[
        (
            "TABLES",
            "0 TABLE\n2 LAYER\n0 LAYER\n2 Off\n70 0\n62 -7\n0 ENDTAB",
        ),
        (
            "ENTITIES",
            "0 LINE\n8 Off\n10 0\n20 0\n11 1\n21 1
            0 HATCH\n5 2A\n8 Fill\n10 0\n20 0
            0 DIMENSION\n5 2B\n8 Notes
            0 LINE\n8 0\n67 1\n10 0\n20 0\n11 1\n21 1
            0 LINE\n5 2C\n8 0\n10 3\n20 3\n11 3\n21 3
            0 LINE\n8 0\n10 0\n20 0\n30 5\n11 1\n21 1\n31 5",
        ),
    ]);
    let drawing = draw(&text);
    assert_eq!(drawing.paths.len(), 1);
    let notices = drawing.notices.join("\n");
    for part in [
        "HATCH handle 2A on layer Fill",
        "DIMENSION handle 2B on layer Notes",
        "off or frozen",
        "paper space",
        "no length: line",
        "handle 2C",
        "Z other than 0",
    ] {
        assert!(notices.contains(part), "{part} in {notices}");
    }
}

/// Dashes, by the linetype of an entity or of its layer, and widths are not cut: the drawing is
/// read, and they are named.
#[test]
fn dashes_and_widths_are_named() {
    let text = sections(&[
        (
            "TABLES",
            "0 TABLE\n2 LTYPE\n0 LTYPE\n2 Plain\n73 0\n0 LTYPE\n2 Dashes\n73 2\n0 ENDTAB
            0 TABLE\n2 LAYER\n0 LAYER\n2 Axes\n70 0\n62 7\n6 Dashes\n0 ENDTAB",
        ),
        (
            "ENTITIES",
            "0 LINE\n5 10\n8 Axes\n10 0\n20 0\n11 1\n21 1
            0 LINE\n5 11\n8 0\n6 DASHES\n10 0\n20 0\n11 1\n21 2
            0 LINE\n5 12\n8 Axes\n6 Plain\n10 0\n20 0\n11 1\n21 3
            0 LINE\n5 13\n8 0\n10 0\n20 0\n11 1\n21 4
            0 LINE\n5 14\n8 Axes\n6 CONTINUOUS\n10 0\n20 0\n11 1\n21 5
            0 LWPOLYLINE\n5 15\n8 0\n90 2\n70 0\n43 2.5\n10 0\n20 0\n10 4\n20 0
            0 LWPOLYLINE\n5 16\n8 0\n90 2\n70 0\n43 0\n10 0\n20 0\n10 5\n20 0
            0 POLYLINE\n5 17\n8 0\n66 1\n40 1\n41 1
            0 VERTEX\n8 0\n10 0\n20 0
            0 VERTEX\n8 0\n10 6\n20 0
            0 SEQEND\n8 0",
        ),
    ]);
    let drawing = draw(&text);
    assert_eq!(drawing.paths.len(), 8);
    let handles = |what: &str| -> Vec<String> {
        let notice = drawing.notices.iter().find(|one| one.starts_with(what));
        let notice = notice.unwrap_or_else(|| panic!("{what}: {:?}", drawing.notices));
        let all = notice.split("handle ").skip(1);
        all.map(|rest| rest.chars().take(2).collect()).collect()
    };
    assert_eq!(handles("dashed lines are cut whole"), ["10", "11"]);
    assert_eq!(
        handles("wide polylines are cut along their middle"),
        ["15", "17"]
    );
}

/// A block reference with a clip (XCLIP) is refused with its handle, as it would be cut whole.
#[test]
fn clipped_blocks_are_refused() {
    let file = |state: &str| {
        let objects = format!(
            "0 DICTIONARY\n5 A1\n102 {{ACAD_REACTORS\n330 20\n102 }}\n330 20\n100 AcDbDictionary\n3 ACAD_FILTER\n360 A2
            0 DICTIONARY\n5 A2\n330 A1\n100 AcDbDictionary\n3 SPATIAL\n360 A3
            0 SPATIAL_FILTER\n5 A3\n330 A2\n100 AcDbFilter\n100 AcDbSpatialFilter\n70 2\n10 0\n20 0\n10 1\n20 1\n71 {state}"
        );
        sections(&[
            (
                "BLOCKS",
                "0 BLOCK\n2 B\n10 0\n20 0\n0 LINE\n8 0\n10 0\n20 0\n11 9\n21 0\n0 ENDBLK",
            ),
            ("ENTITIES", "0 INSERT\n5 20\n8 0\n2 B\n10 0\n20 0"),
            ("OBJECTS", &objects),
        ])
    };
    let problem = mistake(file("1"));
    assert!(
        problem
            .message
            .contains("INSERT handle 20: its clip (XCLIP)"),
        "{problem}"
    );
    assert!(problem.remedy.contains("--ignore-clips"), "{problem}");
    let ignored = ReadOptions {
        ignore_clips: true,
        ..ReadOptions::default()
    };
    let drawing = read(file("1").as_bytes(), &ignored).unwrap();
    assert!(
        drawing
            .notices
            .iter()
            .any(|one| one.contains("INSERT handle 20"))
    );
    assert_eq!(draw(&file("0")).paths.len(), 1);
}

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
            "0 ELLIPSE\n5 3F\n8 Cut\n10 0\n20 0\n11 0\n21 0\n40 1",
            "axis has no length",
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

#[test]
fn zero_length_polylines_are_left_out_by_name() {
    let drawing = draw(&dxf(
        "0 LWPOLYLINE\n5 3F\n8 Cut\n90 3\n70 1\n10 4\n20 4\n10 4\n20 4\n10 4\n20 4",
    ));
    assert!(drawing.paths.is_empty());
    assert!(
        drawing
            .notices
            .iter()
            .any(|notice| notice.contains("handle 3F on layer Cut"))
    );
}

/// CR LF, CR alone, blanks around codes, and a byte order mark.
#[test]
fn line_ends_and_blanks_do_not_matter() {
    let text = dxf("0 LINE\n8 0\n10 0\n20 0\n11 1\n21 0");
    let expected = draw(&text).paths;
    let blanks: String = text.lines().map(|line| format!("  {line} \n")).collect();
    for other in [
        text.replace('\n', "\r\n"),
        text.replace('\n', "\r"),
        blanks,
        format!("\u{feff}{text}"),
    ] {
        assert_eq!(draw(&other).paths, expected);
    }
}
