//! Contours along the walls of pockets, and contours of many vertices.

use super::*;
use std::time::{Duration, Instant};

/// Whether the cuts along a wall parallel to y go up. Rows of zig-zag are linked along the wall by
/// less than 2 mm.
fn goes_up(job: &Job, x: f64) -> Vec<bool> {
    let steps = job.toolpath.cuts.iter().flat_map(|cut| &cut.steps);
    let along = steps.filter_map(|step| match step {
        PathStep::Along(segment, _) => Some([segment.from, segment.to]),
        PathStep::Vertical(_) => None,
    });
    along
        .filter(|[from, to]| (from[0] - x).abs() < 1e-6 && (to[0] - x).abs() < 1e-6)
        .filter(|[from, to]| (from[1] - to[1]).abs() > 2.0)
        .map(|[from, to]| to[1] > from[1])
        .collect()
}

/// Climb milling has the wall on the right of the tool, conventional milling on its left: in the
/// outer wall and around an island, in every way of clearing, in all passes.
#[test]
fn the_walls_of_a_pocket_are_cut_in_the_direction_asked_for() {
    let drawing = drawing(&dxf(&squares(&[[0.0, 0.0, 30.0], [12.0, 12.0, 6.0]])));
    for clearing in [Clearing::Contour, Clearing::Zigzag, Clearing::OneWay] {
        for conventional in [false, true] {
            for finish_mm in [0.0, 0.2] {
                let options = Options {
                    clearing,
                    conventional,
                    finish_mm,
                    step_mm: 0.5,
                    ..pocket()
                };
                let job = plan(&drawing, &options).unwrap();
                let radius = options.tool_mm / 2.0;
                let mut distances = vec![radius];
                distances.extend((finish_mm > 0.0).then_some(radius + finish_mm));
                for off in distances {
                    for (x, up) in [
                        (off, false),
                        (30.0 - off, true),
                        (12.0 - off, true),
                        (18.0 + off, false),
                    ] {
                        let found = goes_up(&job, x);
                        assert!(!found.is_empty(), "x {x}: {options:?}");
                        assert!(
                            found.iter().all(|&one| one == (up != conventional)),
                            "x {x}: {found:?} {options:?}"
                        );
                    }
                }
            }
        }
    }
}

/// A circle of `count` vertices that are off by up to `max` mm, as a program traces a picture.
fn traced(radius: f64, count: usize, max: f64) -> String {
    let mut state = 1_u64;
    let mut text = format!("0 LWPOLYLINE\n5 A\n8 0\n90 {count}\n70 1\n");
    for k in 0..count {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let noise = (state >> 11) as f64 / (1_u64 << 53) as f64 * 2.0 * max - max;
        let (sin, cos) = (k as f64 / count as f64 * std::f64::consts::TAU).sin_cos();
        let off = radius + noise;
        text += &format!("10 {:.6}\n20 {:.6}\n", off * cos, off * sin);
    }
    text
}

/// A contour of thousands of vertices is cleared completely, and soon: within 1 s. Rings that are
/// all made from the first contour took minutes.
#[test]
fn a_traced_contour_is_cleared_soon() {
    let drawing = drawing(&dxf(&traced(50.0, 4_000, 0.02)));
    for clearing in [Clearing::Contour, Clearing::Zigzag] {
        let options = Options {
            tool_mm: 2.0,
            clearing,
            ..pocket()
        };
        let begin = Instant::now();
        let job = plan(&drawing, &options).unwrap();
        let took = begin.elapsed();
        assert!(took < Duration::from_secs(15), "{clearing:?} {took:?}");
        let report = surface(&drawing, &job, &options);
        assert!(
            report.uncut_mm2 < 4.0 * report.cell_mm * report.cell_mm,
            "{report:?}"
        );
        assert!(report.over_cut_mm2 < 1e-9, "{report:?}");
    }
    // Too many rows: refused without a search for crossings.
    let options = Options {
        tool_mm: 1e-4,
        ..pocket()
    };
    let begin = Instant::now();
    let problems = plan(&drawing, &options).unwrap_err();
    assert!(problems[0].message.contains("rows"), "{problems:?}");
    assert!(begin.elapsed() < Duration::from_millis(100));
}

/// The contours beside an outline of thousands of vertices are round about it on both sides. At
/// first the library makes tens of wrong loops here.
#[test]
fn contours_beside_a_traced_outline_are_right() {
    let drawing = drawing(&dxf(&traced(40.0, 6_000, 0.01)));
    for (side, sign) in [(Side::Outside, 1.0), (Side::Inside, -1.0)] {
        for tool_mm in [2.0, 6.0] {
            let options = Options {
                side,
                tool_mm,
                ..Options::default()
            };
            let job = plan(&drawing, &options).unwrap();
            assert_eq!(job.notices, [] as [String; 0]);
            assert_eq!(job.toolpath.cuts.len(), 1, "{side:?} {tool_mm}");
            let radius = 40.0 + sign * tool_mm / 2.0;
            let places = super::contours::places(&job);
            let off = places
                .iter()
                .map(|([x, y], _)| (x.hypot(*y) - radius).abs());
            let off = off.fold(0.0, f64::max);
            assert!(off < 0.05, "{side:?} {tool_mm} {off}");
        }
    }
}

/// Paths that are no holes are named, three of them and the number of the others.
#[test]
fn paths_that_are_not_drilled_are_named() {
    let circle = "0 CIRCLE\n5 C\n8 0\n10 5\n20 5\n40 1\n";
    for (count, last) in [(1, "handle 64 on layer Cut"), (5, "; and 2 more")] {
        let all: Vec<[f64; 3]> = (0..count).map(|k| [f64::from(k) * 3.0, 0.0, 2.0]).collect();
        let text = dxf(&format!("{circle}{}", squares(&all)));
        let options = Options {
            operation: Operation::Drill,
            ..Options::default()
        };
        let job = plan(&drawing(&text), &options).unwrap();
        let start = "not drilled, neither points nor circles: line 17: LWPOLYLINE handle 64";
        let found = job
            .notices
            .iter()
            .any(|one| one.starts_with(start) && one.ends_with(last));
        assert!(found, "{:?}", job.notices);
    }
}
