//! The preview of a program of known geometry.

use haptimill_gcode::{Coordinates, Interpreter, Options, ProgramAxis, ToolAxis, WordKind};
use haptimill_planner::{JointLimits, MachineModel, Planner, PoseLimits, PoseProblem, Settings};
use haptimill_preview::{Joint, Preview};
use haptimill_viewer::Shape;
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
        kind: WordKind::Linear,
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
        kind: WordKind::Linear,
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

/// The path is that of the tip, and so is the feed, also where a longer tool turns.
#[test]
fn a_longer_tool_is_drawn_at_its_tip() {
    let mut settings = settings();
    settings.pose.push(PoseLimits {
        letter: 'A',
        kind: WordKind::Rotary,
        ..settings.pose[0].clone()
    });
    let axis = |letter, kind| ProgramAxis {
        letter,
        kind,
        wraps: false,
    };
    let mut axes = ['X', 'Y', 'Z']
        .map(|letter| axis(letter, WordKind::Linear))
        .to_vec();
    axes.push(axis('A', WordKind::Rotary));
    let options = Options {
        axes,
        tool_axis: ToolAxis {
            tip: [0, 1, 2],
            rotation: Some(3),
            ..ToolAxis::default()
        },
        ..Options::default()
    };
    let text = "G61 G43.1 Z30\nG0 Z10\nG1 X20 A30 F500\nM30\n";
    let mut planner = Planner::new(options.start, settings.clone(), Mill);
    let tip = [Some(0), Some(1), Some(2)];
    let mut preview = Preview::new(options.start, settings, tip, Mill, Vec::new());
    for step in Interpreter::new(Cursor::new(text.as_bytes()), &options) {
        planner.step(&step.expect("readable")).expect("possible");
    }
    planner.finish(4).expect("possible");
    planner.made().for_each(|planned| preview.add(&planned));
    let scene = preview.scene();
    let cut = scene.layers.iter().find(|layer| layer.name == "at feed");
    let cut = cut.expect("a layer");
    let Shape::Lines { points, .. } = &cut.shape else {
        panic!("{cut:?}");
    };
    assert!(points.len() >= 4, "{points:?}");
    for [_, y, z] in points {
        assert!(y.abs() < 1e-3 && (z - 10.0).abs() < 1e-3, "{y} {z}");
    }
    let feeds = cut.values.as_ref().expect("feeds");
    let max = feeds
        .values
        .iter()
        .fold(0.0_f32, |max, feed| max.max(*feed));
    assert!((400.0..500.5).contains(&max), "{max}");
}
