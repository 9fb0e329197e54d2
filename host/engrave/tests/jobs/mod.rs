//! Jobs: the planned path cuts what the drawing asks for, and nothing else.

use crate::common;
mod contours;
mod leads;
mod orders;
mod refusals;
mod surfaces;
mod walls;

use common::dxf;
use haptimill_engrave::drawing::Drawing;
use haptimill_engrave::gcode::{Rates, program};
use haptimill_engrave::geometry::{Path, Point};
use haptimill_engrave::job::{
    Job, Operation, Options, Ordering, Side, check_area, check_pocket, plan,
};
use haptimill_engrave::plate::{Plate, PlateReport};
use haptimill_engrave::preview::{area, cut};
use haptimill_engrave::read::{ReadOptions, read};
use haptimill_engrave::shape::Clearing;
use haptimill_engrave::thesis::{FIGURE_4_10, TOOL, closed, outlines};
use haptimill_engrave::times::{Speeds, Times};
use haptimill_engrave::toolpath::{Cut, Lengths, PathStep, Tabs};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

const PLATE: &str = include_str!("../../../../examples/plate.dxf");

fn drawing(text: &str) -> Drawing {
    let drawing = read(text.as_bytes(), &ReadOptions::default()).unwrap();
    assert_eq!(drawing.problems, []);
    drawing
}

fn layer(name: &str) -> Drawing {
    let mut drawing = drawing(PLATE);
    let choice = haptimill_engrave::drawing::LayerChoice {
        only: vec![name.into()],
        without: Vec::new(),
    };
    drawing.select_layers(&choice).unwrap();
    drawing
}

fn surface(drawing: &Drawing, job: &Job, options: &Options) -> PlateReport {
    let mut plate = Plate::new(area(drawing, options), options.tool_mm / 20.0);
    cut(&mut plate, job, options.tool_mm);
    plate.compare(drawing, options, &job.tabs)
}

/// Plans a job, and checks that its surface has no uncut and no over-cut area.
fn check(drawing: &Drawing, options: &Options) -> (Job, PlateReport) {
    let job = plan(drawing, options).unwrap();
    let report = surface(drawing, &job, options);
    // The grid places the fillet of an inside corner within a cell: some single cells.
    assert!(
        report.uncut_mm2 < 4.0 * report.cell_mm * report.cell_mm,
        "{report:?}"
    );
    assert!(report.over_cut_mm2 < 1e-9, "{report:?}");
    assert!(
        (report.max_depth_mm - options.depth_mm).abs() < 1e-6,
        "{report:?}"
    );
    (job, report)
}

/// Squares as closed polylines: x, y, side.
fn squares(all: &[[f64; 3]]) -> String {
    all.iter()
        .enumerate()
        .map(|(k, [x, y, s])| {
            format!(
                "0 LWPOLYLINE\n5 {:X}\n8 Cut\n90 4\n70 1\n10 {x}\n20 {y}\n10 {}\n20 {y}\n10 {}\n20 {}\n10 {x}\n20 {}\n",
                k + 100, x + s, x + s, y + s, y + s
            )
        })
        .collect()
}

#[test]
fn pockets_with_islands_are_cleared_in_every_way() {
    let picture = layer("PICTURE");
    for clearing in [Clearing::Contour, Clearing::Zigzag, Clearing::OneWay] {
        for (angle_deg, finish_mm) in [(0.0, 0.0), (30.0, 0.2)] {
            let options = Options {
                operation: Operation::Pocket,
                clearing,
                angle_deg,
                finish_mm,
                depth_mm: 0.5,
                ..Options::default()
            };
            let (job, report) = check(&picture, &options);
            // Inside corners are out of reach of a round tool.
            assert!(
                report.unreachable_mm2 > 0.1 && report.unreachable_mm2 < 8.0,
                "{report:?}"
            );
            if clearing == Clearing::OneWay {
                assert_eq!(job.links, 0);
            } else {
                assert!(job.links > 5, "{clearing:?} {}", job.links);
            }
        }
    }
}

#[test]
fn nesting_is_found_by_itself() {
    // A frame, an island in it, and a pocket in the island.
    let text = dxf(&squares(&[
        [0.0, 0.0, 30.0],
        [5.0, 5.0, 20.0],
        [10.0, 10.0, 10.0],
    ]));
    let options = Options {
        operation: Operation::Pocket,
        tool_mm: 1.0,
        depth_mm: 0.5,
        ..Options::default()
    };
    let (_, report) = check(&drawing(&text), &options);
    let asked = 900.0 - 400.0 + 100.0;
    assert!((report.asked_mm2 - asked).abs() < 10.0, "{report:?}");
}

/// All rows of a pocket are done before those of the next one; the contours of rows follow, one
/// pocket after the other, from the last one on.
#[test]
fn one_pocket_is_cleared_after_the_other() {
    let text = dxf(&squares(&[
        [0.0, 0.0, 10.0],
        [20.0, 0.0, 10.0],
        [40.0, 0.0, 10.0],
    ]));
    for clearing in [Clearing::Contour, Clearing::Zigzag, Clearing::OneWay] {
        let options = Options {
            operation: Operation::Pocket,
            clearing,
            tool_mm: 1.0,
            depth_mm: 0.5,
            ..Options::default()
        };
        let job = plan(&drawing(&text), &options).unwrap();
        let ends = job.toolpath.cuts.iter().map(|cut| cut.end());
        let mut pockets: Vec<usize> = ends.map(|at| (at[0] / 20.0) as usize).collect();
        assert!(pockets.len() >= 3, "{clearing:?}");
        pockets.dedup();
        let (rows, contours) = pockets.split_at(3);
        let distinct = |some: &[usize]| {
            let mut sorted = some.to_vec();
            sorted.sort_unstable();
            sorted.dedup();
            sorted.len() == some.len()
        };
        assert!(distinct(rows), "{clearing:?} {pockets:?}");
        assert!(distinct(&pockets[2..]), "{clearing:?} {pockets:?}");
        assert_eq!(contours.is_empty(), clearing == Clearing::Contour);
    }
}

#[test]
fn contours_are_passed_on_either_side_with_leads_ramps_tabs_and_depths() {
    let text = dxf(&squares(&[[0.0, 0.0, 30.0], [5.0, 5.0, 20.0]]));
    let drawing = drawing(&text);
    for side in [Side::Outside, Side::Inside] {
        for conventional in [false, true] {
            let options = Options {
                side,
                conventional,
                tool_mm: 2.0,
                depth_mm: 3.0,
                step_mm: 1.0,
                lead_mm: Some(1.0),
                ramp_deg: Some(5.0),
                ..Options::default()
            };
            let (job, _) = check(&drawing, &options);
            assert_eq!(job.toolpath.cuts.len(), 2);
            let options = Options {
                finish_mm: 0.3,
                ramp_deg: None,
                ..options
            };
            let (job, _) = check(&drawing, &options);
            assert_eq!(job.toolpath.cuts.len(), 4);
            // A lead is an arc of a quarter turn.
            let PathStep::Along(first, _) = job.toolpath.cuts[0].steps[0] else {
                panic!()
            };
            assert!((first.bulge.abs() - std::f64::consts::FRAC_PI_8.tan()).abs() < 1e-12);
        }
    }
    // Inner contours come first.
    let options = Options {
        side: Side::Outside,
        tool_mm: 2.0,
        ..Options::default()
    };
    let job = plan(&drawing, &options).unwrap();
    let handles: Vec<_> = job
        .toolpath
        .cuts
        .iter()
        .map(|cut| drawing.entities[cut.entity].handle.clone().unwrap())
        .collect();
    assert_eq!(handles, ["65", "64"]);
    // Tabs stay between part and plate.
    let tabs = Tabs {
        count: 4,
        width_mm: 2.0,
        height_mm: 0.5,
    };
    let options = Options {
        tabs: Some(tabs),
        depth_mm: 3.0,
        step_mm: 1.0,
        ..options
    };
    let job = plan(&drawing, &options).unwrap();
    let lifts = job
        .toolpath
        .cuts
        .iter()
        .flat_map(|cut| &cut.steps)
        .filter(|step| matches!(step, PathStep::Vertical(z) if (z + 2.5).abs() < 1e-9))
        .count();
    assert_eq!(lifts, 2 * 4);
}

/// Climb cutting keeps the material on the right of the tool, conventional on the left.
#[test]
fn the_direction_is_that_of_the_cut() {
    let drawing = drawing(&dxf(&squares(&[[0.0, 0.0, 30.0], [5.0, 5.0, 20.0]])));
    let area = |path: &Path| {
        let points = path.points(0.001);
        points
            .windows(2)
            .map(|two| two[0][0] * two[1][1] - two[1][0] * two[0][1])
            .sum::<f64>()
    };
    for (side, conventional, outer_counter_clockwise) in [
        (Side::Outside, false, false),
        (Side::Outside, true, true),
        (Side::Inside, false, true),
        (Side::Inside, true, false),
    ] {
        let options = Options {
            side,
            conventional,
            tool_mm: 1.0,
            ..Options::default()
        };
        let job = plan(&drawing, &options).unwrap();
        let turns: Vec<bool> = job
            .toolpath
            .cuts
            .iter()
            .map(|cut| {
                let segments: Vec<_> = cut
                    .steps
                    .iter()
                    .filter_map(|step| match step {
                        PathStep::Along(segment, _) => Some(*segment),
                        PathStep::Vertical(_) => None,
                    })
                    .collect();
                area(&Path::from_segments(&segments, 0)) > 0.0
            })
            .collect();
        assert_eq!(
            turns,
            [!outer_counter_clockwise, outer_counter_clockwise],
            "{side:?}"
        );
    }
}

#[test]
fn arcs_stay_arcs_to_the_program() {
    let frame = layer("FRAME");
    for side in [Side::On, Side::Outside] {
        let options = Options {
            side,
            tool_mm: 2.0,
            ..Options::default()
        };
        let job = plan(&frame, &options).unwrap();
        let rates = Rates {
            feed: 300.0,
            plunge: 60.0,
            speed: 1e4,
            lift_mm: 1.0,
        };
        let text = program(&job.toolpath, rates, [0.0; 2], &[]);
        let arcs = text
            .lines()
            .filter(|line| line.starts_with("G2 ") || line.starts_with("G3 "));
        // Four corners; on the path one more where the start splits an arc, if it does.
        assert!((4..=5).contains(&arcs.count()), "{text}");
        let lines = text
            .lines()
            .filter(|line| line.starts_with("G1 X") || line.starts_with("G1 Y"));
        assert!((4..=5).contains(&lines.count()), "{text}");
    }
}

#[test]
fn the_same_drawing_gives_the_same_program() {
    let text = || {
        let job = plan(&drawing(PLATE), &Options::default()).unwrap();
        let rates = Rates {
            feed: 300.0,
            plunge: 60.0,
            speed: 0.0,
            lift_mm: 1.0,
        };
        program(&job.toolpath, rates, [0.0; 2], &[])
    };
    assert_eq!(text(), text());
}

fn pocket() -> Options {
    Options {
        operation: Operation::Pocket,
        ..Options::default()
    }
}

/// A closed polyline.
fn outline(corners: &[Point]) -> String {
    let points: String = corners
        .iter()
        .map(|[x, y]| format!("10 {x}\n20 {y}\n"))
        .collect();
    format!(
        "0 LWPOLYLINE\n5 77\n8 Cut\n90 {}\n70 1\n{points}",
        corners.len()
    )
}

/// The pockets of the thesis as jobs: rows, links, lifts and lengths of `--clear zigzag`. The
/// square has the numbers of the rules exactly. The offset around the island and at the inner
/// corners of the letter is round, that of the rules is pointed: their lengths differ by that.
#[test]
fn the_pockets_of_the_thesis_are_cleared_by_its_rules() {
    let [square, island, letter] = outlines();
    let options = |clearing| Options {
        clearing,
        tool_mm: TOOL,
        depth_mm: 0.5,
        ..pocket()
    };
    // Rows, links, lifts, cut, air, and how far the lengths may be from them.
    let cases = [
        (square, 42, 42, 1, 897.35, 46.371, 0.0006),
        (island, 135, 134, 3, 2902.3, 74.059, 1.0),
        (letter, 141, 137, 5, 996.15, 136.187, 1.0),
    ];
    for (polygons, rows, links, lifts, cut, air, within) in cases {
        let drawing = closed(&polygons);
        let job = plan(&drawing, &options(Clearing::Zigzag)).unwrap();
        let lengths = job.toolpath.lengths([0.0; 2]);
        // Rows, but not contours, nor links along a row.
        let level = |cut: &Cut| {
            let lines = cut.steps.iter().filter(|step| {
                matches!(step, PathStep::Along(one, _) if one.bulge == 0.0
                    && one.length() > TOOL
                    && off_paths(&drawing, one.point(0.5)) > TOOL / 2.0 + 1e-6
                    && one.from[1] == one.to[1]
                    && ((one.from[1] / 0.45).round() * 0.45 - one.from[1]).abs() < 1e-9)
            });
            lines.count()
        };
        let found: usize = job.toolpath.cuts.iter().map(level).sum();
        assert_eq!((found, job.links, lengths.lifts), (rows, links, lifts));
        assert!((lengths.cut_mm - cut).abs() < within, "{lengths:?}");
        assert!((lengths.air_mm - air).abs() < within, "{lengths:?}");
        // Without the analysis: rows from left to right, from the top.
        let plain = plan(&drawing, &options(Clearing::OneWay)).unwrap();
        let straight = &plain.toolpath.cuts[..rows];
        assert!(straight.iter().all(|cut| cut.end()[0] > cut.start[0]));
        let lower = |pair: &[Cut]| pair[1].start[1] <= pair[0].start[1];
        assert!(straight.windows(2).all(lower));
    }
}

/// Distance of a point from the paths of a drawing, by the points nearest to it.
fn off_paths(drawing: &Drawing, at: Point) -> f64 {
    let segments = drawing.paths.iter().flat_map(Path::segments);
    segments
        .map(|one| {
            let near = one.point(one.nearest(at));
            (near[0] - at[0]).hypot(near[1] - at[1])
        })
        .fold(f64::INFINITY, f64::min)
}

/// Contours of all kinds are the tool's radius away from the drawing, within a step of 0.005 mm,
/// and no nearer anywhere: the tool never crosses a line.
#[test]
fn contours_are_a_radius_away_from_the_drawing() {
    for name in ["PICTURE", "FRAME"] {
        let drawing = layer(name);
        for (operation, side) in [
            (Operation::Pocket, Side::On),
            (Operation::Outline, Side::Inside),
            (Operation::Outline, Side::Outside),
        ] {
            let options = Options {
                operation,
                side,
                finish_mm: 0.2,
                depth_mm: 0.5,
                ..Options::default()
            };
            let job = plan(&drawing, &options).unwrap();
            let (mut min, mut on_contour) = (f64::INFINITY, 0.0);
            for cut in &job.toolpath.cuts {
                for step in &cut.steps {
                    let PathStep::Along(one, _) = step else {
                        continue;
                    };
                    let off = |k: i32| off_paths(&drawing, one.point(f64::from(k) / 16.0));
                    let offs: Vec<f64> = (0..=16).map(off).collect();
                    min = offs.iter().copied().fold(min, f64::min);
                    if offs.iter().all(|off| (off - 0.5).abs() < 0.005) {
                        on_contour += one.length();
                    }
                }
            }
            assert!((min - 0.5).abs() < 0.005, "{name} {side:?}: {min}");
            // The finishing pass is as long as the drawing, but for its corners.
            let drawn: f64 = drawing.paths.iter().map(Path::length).sum();
            assert!(
                on_contour > 0.8 * drawn,
                "{name} {side:?}: {on_contour} {drawn}"
            );
        }
    }
}

/// A text as an outline job: the tool traces the letters, no order is longer than that of the file,
/// and the length is that of the outlines: an L of 10 mm is 400/700 as wide, its strokes 100/700.
#[test]
fn a_text_is_traced() {
    let bytes = common::font();
    let font = haptimill_engrave::read::text::Font::new(&bytes).unwrap();
    let reading = ReadOptions {
        font: Some(&font),
        ..ReadOptions::default()
    };
    let text = dxf("0 TEXT\n8 Cut\n10 10\n20 20\n40 10\n1 LLLLL");
    let drawing = read(text.as_bytes(), &reading).unwrap();
    let of = |ordering| {
        let options = Options {
            ordering,
            ..Options::default()
        };
        plan(&drawing, &options).unwrap().toolpath.lengths([0.0; 2])
    };
    let [file, greedy, short] = [Ordering::File, Ordering::Greedy, Ordering::Short].map(of);
    let around = 2.0 * (10.0 + 10.0 * 400.0 / 700.0);
    for one in [&file, &greedy, &short] {
        assert!((one.cut_mm - 5.0 * around).abs() < 1e-9, "{one:?}");
        assert_eq!(one.lifts, 5);
    }
    assert!(greedy.air_mm <= file.air_mm && short.air_mm < greedy.air_mm);
}
