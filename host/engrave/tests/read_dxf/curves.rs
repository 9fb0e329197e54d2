//! Entities as paths: lines, arcs, polylines, other curves, their units and sides.

use super::{distance, draw, ends, mistake, near};
use crate::common::{dxf, sections};
use haptimill_engrave::read::{ReadOptions, read};

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

/// A segment that is less high than the tolerance is a line where its radius is beyond the limit. A
/// higher one with such a radius is refused, and a shorter radius stays an arc.
#[test]
fn a_nearly_straight_segment_is_a_line() {
    let segment = |x: f64, bulge: f64| {
        dxf(&format!(
            "0 LWPOLYLINE\n5 A\n8 0\n90 2\n70 0\n10 5\n20 5\n42 {bulge}\n10 {x}\n20 5"
        ))
    };
    for bulge in [3e-6, -3e-6, 1e-5] {
        assert_eq!(draw(&segment(105.0, bulge)).paths[0].vertices[0].bulge, 0.0);
    }
    let bulge = 1e-3;
    assert_eq!(
        draw(&segment(105.0, bulge)).paths[0].vertices[0].bulge,
        bulge
    );
    let problem = mistake(segment(100_005.0, 3e-6));
    assert!(problem.message.contains("radius"), "{problem}");
}

/// Arcs by chords of 0.01 mm, the number rounded up (thesis 3.1.3.2): at 5 mm/s all radii have 500
/// chords a second, and a circle with a radius of 10 mm takes 12.566 s. The ends of the chords as
/// whole steps of 0.005 mm from the origin stay within a step of the arc.
#[test]
fn arcs_have_the_chords_of_the_thesis() {
    const CHORD: f64 = 0.01;
    const STEP: f64 = 0.005;
    let arc = |from: f64, to: f64| format!("0 ARC\n8 0\n10 3\n20 4\n40 10\n50 {from}\n51 {to}");
    let bulge = "0 LWPOLYLINE\n8 0\n90 2\n70 0\n10 40\n20 20\n42 1\n10 35\n20 35";
    for (entity, count, time) in [
        ("0 CIRCLE\n8 0\n10 3\n20 4\n40 10".to_string(), 6284, 12.566),
        (arc(0.0, 90.0), 1571, 15.708 / 5.0),
        (bulge.to_string(), 2484, 4.967),
        (arc(0.0, 220.0), 3840, 7.679),
    ] {
        let drawing = draw(&dxf(&entity));
        let path = &drawing.paths[0];
        let length = path.length();
        let chords = (length / CHORD).ceil();
        assert_eq!(chords, f64::from(count), "{entity}");
        assert!((length / 5.0 - time).abs() < 1e-3, "{entity}");
        assert!((chords / (length / 5.0) - 500.0).abs() < 0.1, "{entity}");
        let arc = path.segment(0).arc().unwrap();
        // The segments of a path have the same length here.
        let each = length / path.segment_count() as f64;
        let mut before = path.start().unwrap();
        for k in 0..=count {
            let along = f64::from(k) * length / chords;
            let index = ((along / each) as usize).min(path.segment_count() - 1);
            let at = path.segment(index).point(along / each - index as f64);
            assert!(distance(before, at) <= CHORD, "{entity} {k}");
            let stepped = at.map(|one| (one / STEP).round() * STEP);
            assert!((distance(stepped, arc.centre) - arc.radius).abs() < STEP);
            before = at;
        }
    }
}
