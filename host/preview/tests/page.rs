//! The preview of a program of known geometry.

use haptimill_gcode::{AxisKind, Coordinates, Interpreter, Options, ProgramAxis};
use haptimill_planner::{JointLimits, MachineModel, Planner, PoseLimits, PoseProblem, Settings};
use haptimill_preview::{Joint, Preview};
use std::io::Cursor;

/// A mill whose slide y runs against its coordinate.
struct Mill;

impl MachineModel for Mill {
    fn joints(&self, pose: &Coordinates) -> Result<[f64; 6], PoseProblem> {
        Ok([pose[0], -pose[1], pose[2], 0.0, 0.0, 0.0])
    }

    fn joint_rates(&self, _: &Coordinates, rates: &Coordinates) -> [f64; 6] {
        [rates[0], -rates[1], rates[2], 0.0, 0.0, 0.0]
    }
}

fn settings() -> Settings {
    let pose = ['X', 'Y', 'Z'].map(|letter| PoseLimits {
        units: 1_048_576.0,
        letter,
        kind: AxisKind::Linear,
        low: -100.0,
        high: 100.0,
        rate: 60.0,
        acceleration: 200.0,
        jerk: 5000.0,
    });
    let joints = ["x", "y", "z"].map(|name| JointLimits {
        name: name.into(),
        unit: "mm",
        rate: 60.0,
        acceleration: 1500.0,
        jerk: 37_500.0,
    });
    Settings::new(pose.to_vec(), joints.to_vec(), 200)
}

fn preview(text: &str) -> (Preview<Mill>, String) {
    let axes = ['X', 'Y', 'Z'].map(|letter| ProgramAxis {
        letter,
        kind: AxisKind::Linear,
        wraps: false,
    });
    let options = Options {
        axes: axes.to_vec(),
        ..Options::default()
    };
    let joints = ["x", "y", "z"].map(|name| Joint {
        name: name.into(),
        unit: "mm",
        low: -100.0,
        high: 100.0,
    });
    let mut planner = Planner::new(options.start, settings(), Mill);
    let tip = [Some(0), Some(1), Some(2)];
    let mut preview = Preview::new(options.start, settings(), tip, Mill, joints.to_vec());
    for step in Interpreter::new(Cursor::new(text.as_bytes()), &options) {
        let step = step.expect("readable");
        planner.step(&step).expect("possible");
        planner.made().for_each(|planned| preview.add(&planned));
        preview.add_step(&step);
    }
    planner.finish(9).expect("possible");
    planner.made().for_each(|planned| preview.add(&planned));
    let page = preview.page("a <b>.ngc", "mill", &planner.figures());
    (preview, page)
}

#[test]
fn joints_have_their_extremes_with_their_lines() {
    let (preview, _) = preview("G61 G0 X20 Z5\nG1 X19 Y30 F600\nG2 X19 Y30 I-9\nG0 X-5\n");
    let extents: Vec<_> = preview.extents().iter().flatten().collect();
    let near = |(at, line): (f64, u32), to: f64, of: u32| {
        assert!(
            (at - to).abs() < 0.01 && line == of,
            "{at} in {line}, {to} in {of}"
        );
    };
    near(extents[0].low, -5.0, 4);
    near(extents[0].high, 20.0, 1);
    // The slide runs against Y: the circle goes up to Y39.
    near(extents[1].low, -39.0, 3);
    near(extents[2].high, 5.0, 1);
}

#[test]
fn the_page_is_whole_and_offline() {
    let (_, page) = preview("G0 X20\nM3 S900\nG1 Y30 F600\nM0 (turn)\nG0 Z5\n");
    for part in [
        "<title>a &lt;b>.ngc</title>",
        "\"name\":\"at feed\"",
        "\"name\":\"rapid moves\"",
        "feed, mm/min",
        "spindle 900 rev/min",
        "pause",
        "stroke",
    ] {
        assert!(page.contains(part), "{part}");
    }
    // The only address is the name of the SVG language.
    let addresses = page.matches("http").count();
    assert_eq!(
        addresses,
        page.matches("http://www.w3.org/2000/svg").count()
    );
}
