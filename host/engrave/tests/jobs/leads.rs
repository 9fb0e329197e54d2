//! Leads beside tabs, and finishing passes where there was no pass before them.

use super::contours::{has_lead, places, ring, widths};
use super::*;
use haptimill_engrave::geometry::distance;

const TOOL_MM: f64 = 2.0;

fn tabs(count: usize, width_mm: f64) -> Option<Tabs> {
    Some(Tabs {
        count,
        width_mm,
        height_mm: 1.0,
    })
}

fn rectangle([x, y]: Point, [width, height]: [f64; 2]) -> [Point; 4] {
    [
        [x, y],
        [x + width, y],
        [x + width, y + height],
        [x, y + height],
    ]
}

/// Polylines around these corners.
fn parts(all: &[[Point; 4]]) -> Drawing {
    let text: String = all.iter().map(|corners| outline(corners)).collect();
    drawing(&dxf(&text))
}

/// Checks the number and width of the tabs at the tool's centre and beside it.
fn check_tabs(part: &Drawing, corners: &[[Point; 4]], options: &Options) -> Job {
    let job = plan(part, options).unwrap();
    let mut plate = Plate::new(area(part, options), 0.05);
    cut(&mut plate, &job, options.tool_mm);
    let tabs = options.tabs.unwrap();
    let top = tabs.height_mm - options.depth_mm;
    for one in corners {
        for off in [0.4, 1.0, 1.6] {
            let found = widths(&plate, &ring(one, off), top);
            let state = format!("{off}: {found:?} {options:?}");
            assert_eq!(found.len(), tabs.count, "{state}");
            let is_wide = |width: &f64| *width > tabs.width_mm - 0.15;
            assert!(found.iter().all(is_wide), "{state}");
        }
    }
    job
}

/// Leads leave the tabs of their contour, however large they are.
#[test]
fn a_lead_cuts_no_tab() {
    let corners = [rectangle([0.0, 0.0], [40.0, 20.0])];
    let part = parts(&corners);
    for (count, width_mm) in [(1, 3.0), (3, 3.0), (5, 2.0)] {
        for lead_mm in [1.0, 5.0, 8.0] {
            for conventional in [false, true] {
                for (finish_mm, step_mm) in [(0.0, 3.0), (0.0, 1.0), (0.3, 3.0)] {
                    let options = Options {
                        side: Side::Outside,
                        conventional,
                        tool_mm: TOOL_MM,
                        depth_mm: 3.0,
                        step_mm,
                        finish_mm,
                        lead_mm: Some(lead_mm),
                        tabs: tabs(count, width_mm),
                        ..Options::default()
                    };
                    let job = check_tabs(&part, &corners, &options);
                    // There is a start with room for it.
                    if count < 5 {
                        assert!(job.toolpath.cuts.iter().all(has_lead), "{options:?}");
                    }
                }
            }
        }
    }
}

/// Leads leave the tabs of the contours beside theirs.
#[test]
fn a_lead_cuts_no_tab_of_another_contour() {
    let corners = [
        rectangle([0.0, 0.0], [24.0, 20.0]),
        rectangle([33.0, 1.0], [20.0, 24.0]),
        rectangle([2.0, 31.0], [30.0, 12.0]),
    ];
    let part = parts(&corners);
    for count in [1, 2, 3] {
        for lead_mm in [3.0, 5.0, 6.5] {
            for conventional in [false, true] {
                let options = Options {
                    side: Side::Outside,
                    conventional,
                    tool_mm: TOOL_MM,
                    depth_mm: 3.0,
                    step_mm: 3.0,
                    lead_mm: Some(lead_mm),
                    tabs: tabs(count, 3.0),
                    ..Options::default()
                };
                check_tabs(&part, &corners, &options);
            }
        }
    }
}

/// No lead is deeper than a pass, in cuts of several passes and in a finishing pass, also where it
/// reaches beyond what the passes before it have cut.
#[test]
fn a_lead_is_no_deeper_than_a_pass() {
    let part = parts(&[rectangle([0.0, 0.0], [30.0, 20.0])]);
    for lead_mm in [1.0, 3.0, 5.0] {
        for finish_mm in [0.0, 0.3] {
            for (count, ramp_deg) in [(0, None), (2, None), (0, Some(5.0))] {
                let options = Options {
                    side: Side::Outside,
                    tool_mm: TOOL_MM,
                    depth_mm: 3.0,
                    step_mm: 1.0,
                    finish_mm,
                    lead_mm: Some(lead_mm),
                    ramp_deg,
                    tabs: tabs(count, 3.0),
                    ..Options::default()
                };
                let job = plan(&part, &options).unwrap();
                assert!(job.toolpath.cuts.iter().all(has_lead), "{options:?}");
                let deepest = deepest_bite(&part, &job, &options);
                assert!(deepest < options.step_mm + 1e-3, "{deepest} {options:?}");
            }
        }
    }
}

/// Greatest height of material in the middle of the tool, above its face, before it is cut, mm.
fn deepest_bite(drawing: &Drawing, job: &Job, options: &Options) -> f64 {
    let mut plate = Plate::new(area(drawing, options), options.tool_mm / 20.0);
    let (low, cell) = (plate.at(0, 0), plate.at(1, 0)[0] - plate.at(0, 0)[0]);
    let mut deepest = 0.0_f64;
    for cut in &job.toolpath.cuts {
        let alone = Job {
            toolpath: haptimill_engrave::toolpath::Toolpath {
                cuts: vec![cut.clone()],
            },
            ..Job::default()
        };
        let mut last = (cut.start, cut.z);
        for (at, z) in std::iter::once(last).chain(places(&alone)) {
            // Closely enough for the grid.
            if distance(at, last.0) < 0.04 && (z - last.1).abs() < 0.01 && at != cut.start {
                continue;
            }
            let place = |axis: usize| ((at[axis] - low[axis]) / cell).round() as usize;
            let here = plate.heights()[place(1) * plate.size()[0] + place(0)];
            deepest = deepest.max(f64::from(here) - z);
            let ([x, y], [from_x, from_y]) = (at, last.0);
            plate.sweep(options.tool_mm / 2.0, [from_x, from_y, last.1], [x, y, z]);
            last = (at, z);
        }
    }
    deepest
}

/// Where no pass was before the last one, that has as many passes; elsewhere it is one.
#[test]
fn a_finishing_pass_takes_no_more_than_a_step() {
    let hole = drawing(&dxf("0 CIRCLE\n5 A1\n8 Cut\n10 20\n20 20\n40 1.2"));
    let slot = parts(&[rectangle([0.0, 0.0], [12.0, 1.3])]);
    let near = parts(&[
        rectangle([0.0, 0.0], [8.0, 8.0]),
        rectangle([11.2, 0.0], [8.0, 8.0]),
    ]);
    let outlines = |side, finish_mm| Options {
        side,
        finish_mm,
        tool_mm: TOOL_MM,
        depth_mm: 3.0,
        step_mm: 0.5,
        ..Options::default()
    };
    let pocketed = |clearing| Options {
        clearing,
        finish_mm: 0.5,
        depth_mm: 3.0,
        step_mm: 0.5,
        ..pocket()
    };
    let cases = [
        (&hole, outlines(Side::Inside, 0.3)),
        (&slot, pocketed(Clearing::Contour)),
        (&slot, pocketed(Clearing::Zigzag)),
        (&near, outlines(Side::Outside, 0.8)),
        (&near, outlines(Side::Outside, 0.3)),
    ];
    for (drawn, options) in cases {
        for ramp_deg in [None, Some(5.0)] {
            let options = Options {
                ramp_deg,
                ..options.clone()
            };
            let (job, _) = check(drawn, &options);
            let bite = deepest_bite(drawn, &job, &options);
            assert!(bite < options.step_mm + 1e-3, "{bite} {options:?}");
        }
    }
    let square = parts(&[rectangle([0.0, 0.0], [8.0, 8.0])]);
    for side in [Side::Outside, Side::Inside] {
        let job = plan(&square, &outlines(side, 0.3)).unwrap();
        let lengths: Vec<f64> = job.toolpath.cuts.iter().map(Cut::length).collect();
        assert!(
            lengths.len() == 2 && lengths[1] < lengths[0] / 4.0,
            "{lengths:?}"
        );
    }
}

/// A job says where it leaves tabs.
#[test]
fn the_tabs_of_a_job_are_where_it_leaves_them() {
    let corners = [
        rectangle([0.0, 0.0], [40.0, 20.0]),
        rectangle([50.0, 5.0], [15.0, 20.0]),
    ];
    let part = parts(&corners);
    for side in [Side::On, Side::Outside, Side::Inside] {
        for conventional in [false, true] {
            let options = Options {
                side,
                conventional,
                tool_mm: TOOL_MM,
                depth_mm: 3.0,
                reference: [70.0, 30.0],
                tabs: tabs(3, 2.0),
                ..Options::default()
            };
            let job = plan(&part, &options).unwrap();
            let report = surface(&part, &job, &options);
            assert!(!report.differs(), "{report:?}");
            assert_eq!(job.tabs.len(), 2 * 3);
            for tab in &job.tabs {
                let over = places(&job)
                    .into_iter()
                    .filter(|(at, _)| distance(*at, tab.at) < 1.0);
                let depths: Vec<f64> = over.map(|(_, z)| z).collect();
                assert!(!depths.is_empty() && depths.iter().all(|z| *z > -2.0 - 1e-9));
            }
        }
    }
}

/// Many contours with leads and tabs; the time is shown by `--nocapture`.
#[test]
fn thousands_of_contours_have_leads_and_tabs() {
    const COUNT: usize = 5_000;
    let all: Vec<[f64; 3]> = (0..COUNT)
        .map(|k| [(k % 71) as f64 * 15.0, (k / 71) as f64 * 15.0, 10.0])
        .collect();
    let drawn = drawing(&dxf(&squares(&all)));
    let options = Options {
        side: Side::Outside,
        lead_mm: Some(0.5),
        tabs: tabs(2, 1.0),
        depth_mm: 2.0,
        ..Options::default()
    };
    let begin = std::time::Instant::now();
    let job = plan(&drawn, &options).unwrap();
    println!("{COUNT} contours: {:.2} s", begin.elapsed().as_secs_f64());
    assert_eq!(job.toolpath.cuts.len(), COUNT);
    assert_eq!(job.tabs.len(), 2 * COUNT);
    assert!(job.toolpath.cuts.iter().all(has_lead));
}
