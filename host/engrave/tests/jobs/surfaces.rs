//! Surfaces against drawings: what the grid does not resolve is no difference, what is wrong is.

use super::*;

/// A square of 20 mm with a channel of 10 mm from its right side.
fn with_channel(width: f64) -> Drawing {
    let (low, high) = (10.0 - width / 2.0, 10.0 + width / 2.0);
    drawing(&dxf(&outline(&[
        [0.0, 0.0],
        [20.0, 0.0],
        [20.0, low],
        [30.0, low],
        [30.0, high],
        [20.0, high],
        [20.0, 20.0],
        [0.0, 20.0],
    ])))
}

fn both() -> [Options; 2] {
    let options = Options {
        tool_mm: 2.0,
        depth_mm: 1.0,
        ..pocket()
    };
    let inside = Options {
        operation: Operation::Outline,
        side: Side::Inside,
        ..options.clone()
    };
    [options, inside]
}

fn compared(drawing: &Drawing, job: &Job, options: &Options, cell: f64) -> PlateReport {
    let mut plate = Plate::new(area(drawing, options), cell);
    cut(&mut plate, job, options.tool_mm);
    plate.compare(drawing, options, &job.tabs)
}

/// A channel just narrower than the tool is out of reach. One just wider is cut.
#[test]
fn a_channel_of_about_the_width_of_the_tool_is_no_difference() {
    for width in [1.9, 1.94, 1.96, 1.98, 1.999, 2.001, 2.02, 2.1, 2.3] {
        let drawing = with_channel(width);
        for options in both() {
            let job = plan(&drawing, &options).unwrap();
            for cell in [0.05, 0.1] {
                let report = compared(&drawing, &job, &options, cell);
                assert!(!report.differs(), "{width} {cell} {report:?}");
            }
        }
    }
}

/// A wider channel that is not cut is a difference.
#[test]
fn an_uncut_channel_is_a_difference() {
    let square = drawing(&dxf(&squares(&[[0.0, 0.0, 20.0]])));
    for options in both() {
        let job = plan(&square, &options).unwrap();
        let report = compared(&square, &job, &options, 0.1);
        assert!(!report.differs(), "{report:?}");
        // A quarter of a cell wider than the tool, and wider ones.
        let widths = [
            (2.0125, 0.05),
            (2.025, 0.1),
            (2.05, 0.05),
            (2.1, 0.1),
            (2.15, 0.1),
        ];
        let wider = [(2.3, 0.05), (2.6, 0.05), (2.6, 0.1)];
        for (width, cell) in widths.into_iter().chain(wider) {
            let report = compared(&with_channel(width), &job, &options, cell);
            assert!(
                report.differs() && report.uncut_mm2 > 5.0,
                "{width} {cell} {report:?}"
            );
        }
    }
}

/// Tabs are no reason to take a shallow cut for a full one elsewhere.
#[test]
fn a_shallow_cut_between_tabs_is_a_difference() {
    let square = drawing(&dxf(&squares(&[[0.0, 0.0, 20.0]])));
    for side in [Side::On, Side::Outside] {
        let options = Options {
            side,
            tool_mm: 2.0,
            depth_mm: 3.0,
            tabs: Some(Tabs {
                count: 2,
                width_mm: 3.0,
                height_mm: 2.8,
            }),
            ..Options::default()
        };
        let job = plan(&square, &options).unwrap();
        let report = compared(&square, &job, &options, 0.1);
        assert!(!report.differs() && report.min_depth_mm < 0.3, "{report:?}");
        let shallow = Options {
            depth_mm: 1.0,
            tabs: None,
            ..options.clone()
        };
        let mut shallow = plan(&square, &shallow).unwrap();
        shallow.tabs.clone_from(&job.tabs);
        let report = compared(&square, &shallow, &options, 0.1);
        assert!(report.differs() && report.uncut_mm2 > 50.0, "{report:?}");
    }
}
