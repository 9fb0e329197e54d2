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
