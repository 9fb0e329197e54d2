//! What a job refuses, and what it names as left out.

use super::*;

fn problem(text: &str, options: &Options) -> String {
    let problems = plan(&drawing(text), options).map(|_| ()).unwrap_err();
    assert!(problems.iter().all(|problem| !problem.remedy.is_empty()));
    problems
        .iter()
        .map(ToString::to_string)
        .collect::<Vec<_>>()
        .join("\n")
}

#[test]
fn what_is_no_pocket_is_refused_with_its_entity() {
    let open = dxf("0 LWPOLYLINE\n5 3F\n8 Cut\n90 3\n70 0\n10 0\n20 0\n10 9\n20 0\n10 9\n20 9");
    let message = problem(&open, &pocket());
    assert!(
        message.contains("handle 3F on layer Cut") && message.contains("open"),
        "{message}"
    );
    // Every open contour is named.
    let both = dxf(
        "0 LWPOLYLINE\n5 3F\n8 Cut\n90 3\n70 0\n10 0\n20 0\n10 9\n20 0\n10 9\n20 9
        0 LWPOLYLINE\n5 40\n8 Cut\n90 3\n70 0\n10 30\n20 0\n10 39\n20 0\n10 39\n20 9",
    );
    let message = problem(&both, &pocket());
    assert!(
        message.contains("handle 3F") && message.contains("handle 40"),
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
    // A large number is short.
    let mut huge = drawing(&dxf("0 LINE\n8 0\n10 0\n20 0\n11 1\n21 1"));
    for vertex in &mut huge.paths[0].vertices {
        vertex.at[0] *= 1e12;
    }
    let job = plan(&huge, &Options::default()).unwrap();
    let problems = check_area(&job, &huge, [[0.0; 2], [110.0, 250.0]], "the area").unwrap_err();
    assert!(problems[0].message.contains("1e12"), "{:?}", problems[0]);
    assert!(problems[0].message.len() < 200, "{:?}", problems[0]);
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

/// A drawing in metres: its pocket is 244 m wide, which nobody clears with a tool of 0.3 mm.
#[test]
fn a_pocket_outside_of_the_area_is_refused_before_it_is_planned() {
    let text = dxf(&squares(&[[0.0, 0.0, 110.2], [5.0, 5.0, 244_000.0]]));
    let area = [[0.0, 0.0], [110.0, 250.0]];
    let problems = check_pocket(&drawing(&text), 0.3, area, "the plate").unwrap_err();
    assert_eq!(problems.len(), 2);
    assert!(
        problems[1].message.contains("handle 65 on layer Cut"),
        "{}",
        problems[1]
    );
    // The tool stays half of its diameter inside the contour.
    let within = dxf(&squares(&[[-0.1, -0.1, 110.2]]));
    assert_eq!(
        check_pocket(&drawing(&within), 0.3, area, "the plate"),
        Ok(())
    );
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

/// A neck and a slot that the tool does not fit into are named; a contour without them is not.
#[test]
fn a_neck_that_is_too_narrow_for_the_tool_is_noted() {
    let neck = |width: f64| {
        let (low, high) = (5.0 - width / 2.0, 5.0 + width / 2.0);
        outline(&[
            [0.0, 0.0],
            [10.0, 0.0],
            [10.0, low],
            [13.0, low],
            [13.0, 0.0],
            [23.0, 0.0],
            [23.0, 10.0],
            [13.0, 10.0],
            [13.0, high],
            [10.0, high],
            [10.0, 10.0],
            [0.0, 10.0],
        ])
    };
    let slot = |width: f64| {
        let (low, high) = (5.0 - width / 2.0, 5.0 + width / 2.0);
        outline(&[
            [0.0, 0.0],
            [10.0, 0.0],
            [10.0, low],
            [14.0, low],
            [14.0, high],
            [10.0, high],
            [10.0, 10.0],
            [0.0, 10.0],
        ])
    };
    let short = |width: f64| {
        let (low, high) = (5.0 - width / 2.0, 5.0 + width / 2.0);
        outline(&[
            [0.0, 0.0],
            [10.0, 0.0],
            [10.0, low],
            [10.4, low],
            [10.4, 0.0],
            [20.0, 0.0],
            [20.0, 10.0],
            [10.4, 10.0],
            [10.4, high],
            [10.0, high],
            [10.0, 10.0],
            [0.0, 10.0],
        ])
    };
    let inside = Options {
        side: Side::Inside,
        ..Options::default()
    };
    for options in [pocket(), inside] {
        let notices = |text: &str| plan(&drawing(&dxf(text)), &options).unwrap().notices;
        for narrow in [neck(0.8), slot(0.8), short(0.8)] {
            let notices = notices(&narrow);
            assert_eq!(notices.len(), 1, "{notices:?}");
            assert!(
                notices[0].contains("handle 77 on layer Cut")
                    && notices[0].contains("does not reach")
                    && notices[0].contains("--tool"),
                "{notices:?}"
            );
        }
        for wide in [
            neck(1.2),
            slot(1.2),
            short(1.2),
            squares(&[[0.0, 0.0, 10.0]]),
        ] {
            assert_eq!(notices(&wide), Vec::<String>::new());
        }
    }
}

/// Points are drilled; the other operations say that they leave them out.
#[test]
fn points_are_left_out_by_name() {
    let points = "0 POINT\n5 A7\n8 Cut\n10 3\n20 4\n0 POINT\n5 A8\n8 Cut\n10 5\n20 4\n";
    let drawing = drawing(&dxf(&(squares(&[[0.0, 0.0, 10.0]]) + points)));
    for options in [Options::default(), pocket()] {
        let notices = plan(&drawing, &options).unwrap().notices;
        assert_eq!(notices.len(), 1, "{notices:?}");
        assert!(
            notices[0].contains("drill")
                && notices[0].ends_with("POINT handle A7 on layer Cut; and 1 more"),
            "{notices:?}"
        );
    }
}

/// A job of more rows or passes than memory holds is refused before it is planned.
#[test]
fn more_rows_than_memory_holds_are_refused() {
    let text = dxf(&squares(&[[0.0, 0.0, 20.0]]));
    for options in [
        Options {
            tool_mm: 1e-9,
            ..pocket()
        },
        Options {
            overlap: 1e-300,
            ..pocket()
        },
        Options {
            overlap: 1e-6,
            ..pocket()
        },
        Options {
            clearing: Clearing::Zigzag,
            tool_mm: 0.01,
            overlap: 0.1,
            step_mm: 0.001,
            ..pocket()
        },
    ] {
        let message = problem(&text, &options);
        assert!(message.contains("rows"), "{message}");
        assert!(message.len() < 250, "{message}");
    }
    // Few rows in each of many pockets.
    let many: Vec<[f64; 3]> = (0..2_000)
        .map(|k| [f64::from(k) * 15.0, 0.0, 10.0])
        .collect();
    let options = Options {
        tool_mm: 0.1,
        depth_mm: 2.0,
        ..pocket()
    };
    let message = problem(&dxf(&squares(&many)), &options);
    assert!(message.contains("rows"), "{message}");
    let options = Options {
        step_mm: 1e-9,
        ..Options::default()
    };
    assert!(problem(&text, &options).contains("passes"));
}

/// Lines and contours that are drawn twice are named as such, with both entities.
#[test]
fn duplicates_in_a_pocket_are_named() {
    let line = |handle: &str, [a, b]: [Point; 2]| {
        format!(
            "0 LINE\n5 {handle}\n8 Cut\n10 {}\n20 {}\n11 {}\n21 {}\n",
            a[0], a[1], b[0], b[1]
        )
    };
    let [a, b, c] = [[10.0, 10.0], [50.0, 10.0], [50.0, 40.0]];
    let lines = [
        ("A1", [a, b]),
        ("A2", [b, c]),
        ("A3", [c, a]),
        ("A4", [b, a]),
    ];
    let triangle: String = lines.map(|(handle, ends)| line(handle, ends)).concat();
    let twice = line("A1", [a, b]) + &line("A4", [a, b]);
    let arcs = "0 CIRCLE\n5 A1\n8 Cut\n10 5\n20 5\n40 3\n0 CIRCLE\n5 A4\n8 Cut\n10 5\n20 5\n40 3\n";
    for text in [&triangle, &twice, arcs] {
        let message = problem(&dxf(text), &pocket());
        let first = message.lines().next().unwrap();
        assert!(
            first.contains("handle A4") && first.contains("duplicate") && first.contains("A1"),
            "{message}"
        );
    }
}

/// Holes at the same place are drilled once, with a notice that names the other.
#[test]
fn a_hole_is_drilled_once() {
    let text = dxf("0 CIRCLE\n5 A1\n8 Cut\n10 5\n20 5\n40 3
        0 POINT\n5 A2\n8 Cut\n10 5\n20 5
        0 CIRCLE\n5 A3\n8 Cut\n10 5.0004\n20 5\n40 2
        0 CIRCLE\n5 A4\n8 Cut\n10 5.01\n20 5\n40 2");
    let options = Options {
        operation: Operation::Drill,
        ..Options::default()
    };
    let job = plan(&drawing(&text), &options).unwrap();
    assert_eq!(job.toolpath.cuts.len(), 2);
    let notices = job.notices.join("\n");
    assert!(
        notices.contains("duplicate") && notices.contains("1 more"),
        "{notices}"
    );
    let single = dxf("0 POINT\n5 A2\n8 Cut\n10 5\n20 5");
    let job = plan(&drawing(&single), &options).unwrap();
    assert!(job.toolpath.cuts.len() == 1 && job.notices.is_empty());
}

/// An arc that is no higher than a ten-thousandth of a millimetre is a line; small circles stay.
#[test]
fn flat_arcs_are_lines() {
    let text = |bulge: f64| {
        dxf(&format!(
            "0 LWPOLYLINE\n5 3F\n8 Cut\n90 2\n70 0\n10 10\n20 10\n42 {bulge}\n10 20\n20 10"
        ))
    };
    // The chord is 10 mm: a bulge of 2e-5 is 1e-4 mm high. In inches it is 25.4 times as high.
    for (bulge, is_line) in [(1e-9, true), (-1.9e-5, true), (2.1e-5, false)] {
        let path = &drawing(&text(bulge)).paths[0];
        assert_eq!(path.segment(0).arc().is_none(), is_line, "{bulge}");
    }
    let inches = ReadOptions {
        unit_mm: Some(25.4),
        ..ReadOptions::default()
    };
    let large = read(text(1e-5).as_bytes(), &inches).unwrap();
    assert!(large.problems.is_empty() && large.paths[0].segment(0).arc().is_some());
    assert!(drawing(&text(1e-5)).paths[0].segment(0).arc().is_none());
    let circle = dxf("0 CIRCLE\n5 A1\n8 Cut\n10 5\n20 5\n40 0.00005");
    assert!(
        drawing(&circle).paths[0]
            .segments()
            .all(|one| one.bulge == 1.0)
    );
}

/// A surface with a wrong patch is distinguished from one with single cells that the grid does not
/// resolve.
#[test]
fn a_surface_with_a_wrong_patch_is_found() {
    let text = dxf(&squares(&[[0.0, 0.0, 20.0]]));
    let pocketed = drawing(&text);
    let options = pocket();
    let job = plan(&pocketed, &options).unwrap();
    assert!(!surface(&pocketed, &job, &options).differs());
    // A strip of 0.2 mm along the middle stays, or a groove leaves the square.
    let moved = |edit: &dyn Fn(&mut Plate)| {
        let mut plate = Plate::new(area(&pocketed, &options), 0.05);
        edit(&mut plate);
        plate.compare(&pocketed, &options, &[])
    };
    let halves = moved(&|plate| {
        for k in 0..=200 {
            let x = 0.5 + f64::from(k) * 0.095;
            for [low, high] in [[0.5, 9.4], [10.6, 19.5]] {
                plate.sweep(0.5, [x, low, -1.0], [x, high, -1.0]);
            }
        }
    });
    assert!(
        halves.differs() && (3.5..5.5).contains(&halves.uncut_mm2),
        "{halves:?}"
    );
    let groove = moved(&|plate| {
        cut(plate, &job, options.tool_mm);
        plate.sweep(0.5, [19.5, 10.0, -1.0], [20.5, 10.0, -1.0]);
    });
    assert!(groove.differs() && groove.over_cut_mm2 > 0.3, "{groove:?}");
}
