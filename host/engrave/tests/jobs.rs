//! Jobs: the planned path cuts what the drawing asks for, and nothing else.

mod common;

use common::dxf;
use haptimill_engrave::drawing::Drawing;
use haptimill_engrave::gcode::{Rates, program};
use haptimill_engrave::geometry::Path;
use haptimill_engrave::job::{Job, Operation, Options, Ordering, Side, check_area, plan};
use haptimill_engrave::plate::{Plate, PlateReport};
use haptimill_engrave::preview::{area, cut};
use haptimill_engrave::read::{ReadOptions, read};
use haptimill_engrave::shape::Clearing;
use haptimill_engrave::toolpath::{Step, Tabs};

const PLATE: &str = include_str!("../../../examples/plate.dxf");

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
    plate.compare(drawing, options)
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
        (report.greatest_depth_mm - options.depth_mm).abs() < 1e-6,
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
            let Step::Along(first, _) = job.toolpath.cuts[0].steps[0] else {
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
        .filter(|step| matches!(step, Step::Vertical(z) if (z + 2.5).abs() < 1e-9))
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
                        Step::Along(segment, _) => Some(*segment),
                        Step::Vertical(_) => None,
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
fn holes_are_drilled_in_a_short_order() {
    let holes = layer("HOLES");
    let options = Options {
        operation: Operation::Drill,
        depth_mm: 3.0,
        step_mm: 1.0,
        tool_mm: 1.0,
        ..Options::default()
    };
    let (job, _) = check(&holes, &options);
    assert!(job.proven);
    assert_eq!(job.toolpath.cuts.len(), 4);
    assert!(job.candidates[1].air_mm <= job.candidates[0].air_mm);
    // Each pass ends at the surface and begins there again.
    assert_eq!(job.toolpath.cuts[0].steps.len(), 4);
}

#[test]
fn every_order_cuts_the_same_and_the_chosen_one_is_the_shortest() {
    let drawing = drawing(PLATE);
    let mut totals = Vec::new();
    for ordering in [Ordering::File, Ordering::Greedy, Ordering::Short] {
        let options = Options {
            ordering,
            ..Options::default()
        };
        let (job, _) = check(&drawing, &options);
        totals.push(job.toolpath.lengths([0.0; 2]));
    }
    assert!((totals[0].cut_mm - totals[2].cut_mm).abs() < 1e-6);
    assert!((totals[0].cut_mm - totals[1].cut_mm).abs() < 1e-6);
    assert!(totals[1].air_mm <= totals[0].air_mm + 1e-9);
    assert!(totals[2].air_mm < totals[1].air_mm);
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

fn problem(text: &str, options: &Options) -> String {
    let problems = plan(&drawing(text), options).map(|_| ()).unwrap_err();
    assert!(problems.iter().all(|problem| !problem.remedy.is_empty()));
    problems
        .iter()
        .map(ToString::to_string)
        .collect::<Vec<_>>()
        .join("\n")
}

fn pocket() -> Options {
    Options {
        operation: Operation::Pocket,
        ..Options::default()
    }
}

#[test]
fn what_is_no_pocket_is_refused_with_its_entity() {
    let open = dxf("0 LWPOLYLINE\n5 3F\n8 Cut\n90 3\n70 0\n10 0\n20 0\n10 9\n20 0\n10 9\n20 9");
    let message = problem(&open, &pocket());
    assert!(
        message.contains("handle 3F on layer Cut") && message.contains("open"),
        "{message}"
    );
    let bow = dxf(
        "0 LWPOLYLINE\n5 3F\n8 Cut\n90 4\n70 1\n10 0\n20 0\n10 9\n20 9\n10 9\n20 0\n10 0\n20 9",
    );
    assert!(problem(&bow, &pocket()).contains("crosses or touches itself"));
    let crossing = dxf(&squares(&[[0.0, 0.0, 10.0], [5.0, 5.0, 10.0]]));
    let message = problem(&crossing, &pocket());
    assert!(
        message.contains("handle 64") && message.contains("handle 65"),
        "{message}"
    );
    let twice = dxf(&squares(&[[0.0, 0.0, 10.0], [0.0, 0.0, 10.0]]));
    assert!(problem(&twice, &pocket()).contains("meets"));
    let narrow = dxf(&squares(&[[0.0, 0.0, 0.8]]));
    let message = problem(&narrow, &pocket());
    assert!(
        message.contains("handle 64") && message.contains("does not fit"),
        "{message}"
    );
}

#[test]
fn a_slot_that_is_too_narrow_beside_another_contour_is_noted() {
    let text = dxf(&squares(&[[0.0, 0.0, 10.0], [20.0, 0.0, 0.8]]));
    let job = plan(&drawing(&text), &pocket()).unwrap();
    assert!(
        job.notices
            .iter()
            .any(|notice| notice.contains("handle 65")),
        "{:?}",
        job.notices
    );
}

#[test]
fn a_job_outside_of_the_area_is_refused_with_its_entity() {
    let text = dxf(&squares(&[[0.0, 0.0, 10.0], [105.0, 0.0, 10.0]]));
    let drawing = drawing(&text);
    let job = plan(&drawing, &Options::default()).unwrap();
    let problems =
        check_area(&job, &drawing, [[0.0, 0.0], [110.0, 250.0]], "the plate").unwrap_err();
    assert_eq!(problems.len(), 1);
    assert!(
        problems[0].message.contains("handle 65 on layer Cut"),
        "{}",
        problems[0]
    );
    assert!(problems[0].remedy.contains("--at"));
}

#[test]
fn numbers_that_make_no_job_are_refused() {
    for options in [
        Options {
            tool_mm: 0.0,
            ..Options::default()
        },
        Options {
            tool_mm: f64::NAN,
            ..Options::default()
        },
        Options {
            depth_mm: -1.0,
            ..Options::default()
        },
        Options {
            step_mm: 0.0,
            ..Options::default()
        },
        Options {
            ramp_deg: Some(0.0),
            ..Options::default()
        },
        Options {
            overlap: 0.9,
            ..pocket()
        },
        Options {
            tabs: Some(Tabs {
                count: 2,
                width_mm: 1.0,
                height_mm: 1.0,
            }),
            ..Options::default()
        },
    ] {
        assert!(options.check().is_err(), "{options:?}");
    }
}
