//! The part program and the page of a job: what they show is the planned tool path.

use crate::common::dxf;
use haptimill_engrave::drawing::{Drawing, LayerChoice};
use haptimill_engrave::gcode::{Rates, program};
use haptimill_engrave::geometry::Segment;
use haptimill_engrave::job::{Job, Operation, Options, Side, plan};
use haptimill_engrave::preview::{Speeds, html, plan as picture};
use haptimill_engrave::read::{ReadOptions, read};
use haptimill_engrave::toolpath::{Cut, PathStep, Tabs, Toolpath};
use proptest::prelude::*;
use std::f64::consts::TAU;

const LIFT: f64 = 1.5;

fn layer(name: &str) -> Drawing {
    let plate = include_bytes!("../../../examples/plate.dxf");
    let mut drawing = read(plate, &ReadOptions::default()).unwrap();
    let choice = LayerChoice {
        only: vec![name.into()],
        without: Vec::new(),
    };
    drawing.select_layers(&choice).unwrap();
    drawing
}

/// Jobs of every operation, with tabs, ramps and several depths.
fn jobs() -> Vec<(Drawing, Options, Job)> {
    let plain = Options {
        depth_mm: 0.6,
        step_mm: 0.3,
        ..Options::default()
    };
    let pocket = Options {
        operation: Operation::Pocket,
        ..plain
    };
    let tabs = Tabs {
        count: 3,
        width_mm: 2.0,
        height_mm: 0.2,
    };
    let outline = Options {
        side: Side::Outside,
        tabs: Some(tabs),
        lead_mm: Some(1.0),
        ..plain
    };
    let ramped = Options {
        ramp_deg: Some(5.0),
        ..plain
    };
    let drill = Options {
        operation: Operation::Drill,
        ..plain
    };
    let all = [
        ("PICTURE", pocket),
        ("PICTURE", plain),
        ("FRAME", outline),
        ("FRAME", ramped),
        ("HOLES", drill),
    ];
    let planned = all.into_iter().map(|(name, options)| {
        let drawing = layer(name);
        let job = plan(&drawing, &options).unwrap();
        (drawing, options, job)
    });
    planned.collect()
}

fn text(job: &Job, speed: f64) -> String {
    let rates = Rates {
        feed: 300.0,
        plunge: 60.0,
        speed,
        lift_mm: LIFT,
    };
    program(&job.toolpath, rates, [0.0; 2], &[])
}

/// Read by itself, word by word: rapid moves across are at the lift height, and cuts across are at
/// most at the surface and at least at the depth. The air of the program is the stated one.
#[test]
fn the_tool_is_up_in_every_air_move_and_down_in_every_cut() {
    for (_, options, job) in jobs() {
        let (mut at, mut air, mut across) = ([f64::NAN, f64::NAN, f64::NAN], 0.0, 0);
        for line in text(&job, 0.0).lines() {
            let mut words = line.split(' ');
            let word = words.next().unwrap_or_default();
            if !matches!(word, "G0" | "G1" | "G2" | "G3") {
                continue;
            }
            let (mut to, mut is_across) = (at, false);
            for word in words {
                let value: f64 = word[1..].parse().unwrap();
                is_across |= matches!(&word[..1], "X" | "Y");
                match &word[..1] {
                    "X" => to[0] = value,
                    "Y" => to[1] = value,
                    "Z" => to[2] = value,
                    "I" | "J" | "F" => {}
                    other => panic!("{other} in {line}"),
                }
            }
            if is_across && word == "G0" {
                assert_eq!((at[2], to[2]), (LIFT, LIFT), "{line}");
                if at[0].is_finite() {
                    air += (to[0] - at[0]).hypot(to[1] - at[1]);
                }
            } else if is_across {
                let cuts = |z: f64| (-options.depth_mm..=0.0).contains(&z);
                assert!(cuts(at[2]) && cuts(to[2]), "{line} from {at:?}");
                across += 1;
            }
            at = to;
        }
        assert!(options.operation == Operation::Drill || across > 0);
        assert_eq!((at[0], at[1], at[2]), (0.0, 0.0, LIFT));
        let stated = job.toolpath.lengths([0.0; 2]);
        assert!((air - stated.air_mm).abs() < 0.001 * stated.lifts as f64);
    }
}

/// Length of the cuts of a program, mm, read as a control reads it: an arc whose end is at the
/// angle of its start is a whole circle.
fn length_of_cuts(text: &str) -> f64 {
    let (mut at, mut length) = ([0.0_f64; 2], 0.0);
    for line in text.lines() {
        let mut words = line.split(' ');
        let word = words.next().unwrap_or_default();
        if !matches!(word, "G0" | "G1" | "G2" | "G3") {
            continue;
        }
        let (mut to, mut centre) = (at, at);
        for word in words {
            let value: f64 = word[1..].parse().unwrap();
            match &word[..1] {
                "X" => to[0] = value,
                "Y" => to[1] = value,
                "I" => centre[0] += value,
                "J" => centre[1] += value,
                _ => {}
            }
        }
        let angle = |point: [f64; 2]| (point[1] - centre[1]).atan2(point[0] - centre[0]);
        let turned = match word {
            "G2" => angle(at) - angle(to),
            _ => angle(to) - angle(at),
        };
        let turned = match turned.rem_euclid(TAU) {
            // Controls take a smaller difference for none.
            turned if turned < 1e-7 => TAU,
            turned => turned,
        };
        length += match word {
            "G0" => 0.0,
            "G1" => (to[0] - at[0]).hypot(to[1] - at[1]),
            _ => turned * (at[0] - centre[0]).hypot(at[1] - centre[1]),
        };
        at = to;
    }
    length
}

/// The program of cuts along segments.
fn written(segments: &[Segment]) -> String {
    let start = segments[0].from;
    let steps = segments
        .iter()
        .map(|segment| PathStep::Along(*segment, -0.1));
    let cut = Cut {
        start,
        z: -0.1,
        steps: steps.collect(),
        entity: 0,
    };
    let rates = Rates {
        feed: 300.0,
        plunge: 60.0,
        speed: 0.0,
        lift_mm: LIFT,
    };
    program(&Toolpath { cuts: vec![cut] }, rates, [0.0; 2], &[])
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 2000,
        rng_seed: proptest::test_runner::RngSeed::Fixed(1),
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    /// The written cut is as long as the planned one: arcs of any length, up to whole circles.
    #[test]
    fn arcs_keep_their_length(
        arcs in prop::collection::vec(
            (-2.0..2.0f64, 0.0..TAU, -5.0..0.798f64, any::<bool>()),
            1..40,
        ),
    ) {
        let mut at = [10.0, 10.0];
        let (mut segments, mut length) = (Vec::new(), 0.0);
        for (radius, start, sweep, left) in arcs {
            let (radius, sweep) = (10f64.powf(radius), 10f64.powf(sweep));
            let turned = if left { sweep } else { -sweep };
            let (sin, cos) = start.sin_cos();
            let centre = [at[0] - radius * cos, at[1] - radius * sin];
            let (sin, cos) = (start + turned).sin_cos();
            let to = [centre[0] + radius * cos, centre[1] + radius * sin];
            segments.push(Segment { from: at, to, bulge: (turned / 4.0).tan() });
            length += radius * sweep;
            at = to;
        }
        // Rounding moves each end by up to 0.1 um.
        let max = 2e-4 * segments.len() as f64 + 1e-3 * length;
        let text = written(&segments);
        let off = length_of_cuts(&text) - length;
        prop_assert!(off.abs() <= max, "{off} mm\n{text}");
    }

    /// A short arc whose end rounds away from its start towards its centre is no whole circle.
    #[test]
    fn a_short_arc_does_not_become_a_circle(
        length in -9.0..-4.3f64,
        radius in -2.0..2.0f64,
        left in any::<bool>(),
        quarter in 0..4_i32,
        off in -9.0..-1.0f64,
        up in any::<bool>(),
        edge in prop_oneof![Just([0.5, 0.0]), Just([0.0, 0.5]), Just([0.5, 0.5])],
    ) {
        let (length, radius) = (10f64.powf(length), 10f64.powf(radius));
        let off = if up { 10f64.powf(off) } else { -10f64.powf(off) };
        let (sin, cos) = (f64::from(quarter) * TAU / 4.0 + off).sin_cos();
        // The middle of the arc is where a coordinate rounds up or down.
        let middle = edge.map(|part| 5.0 + part * 1e-4);
        let place = |part: f64| [middle[0] + part * length * cos, middle[1] + part * length * sin];
        let bulge = (0.25 * length / radius).min(0.3);
        let bulge = if left { bulge } else { -bulge };
        let segment = Segment { from: place(-0.5), to: place(0.5), bulge };
        let text = written(&[segment]);
        let cut = length_of_cuts(&text);
        prop_assert!(cut <= 2.0 * length + 3e-4, "{cut} mm for {length}\n{text}");
    }
}

#[test]
fn a_pen_has_no_spindle() {
    for (_, _, job) in jobs() {
        let spindle = |text: &str| {
            let words = text.split_whitespace();
            words.filter(|word| matches!(*word, "M3" | "M5")).count()
        };
        assert_eq!(spindle(&text(&job, 0.0)), 0);
        assert_eq!(spindle(&text(&job, 8000.0)), 2);
    }
}

/// No label covers another: their boxes are as wide as the digits of common fonts.
fn check_labels(labels: &[roxmltree::Node]) {
    let corners = |label: &roxmltree::Node| {
        let number = |name| -> f64 { label.attribute(name).unwrap().parse().unwrap() };
        let (x, y, size) = (number("x"), number("y"), number("font-size"));
        let width = 0.63 * size * label.text().unwrap().len() as f64;
        [[x, y - 0.75 * size], [x + width, y + 0.2 * size]]
    };
    let boxes: Vec<[[f64; 2]; 2]> = labels.iter().map(corners).collect();
    for (index, [low, high]) in boxes.iter().enumerate() {
        for (other, [l, h]) in boxes[..index].iter().enumerate() {
            let covers = (0..2).all(|axis| low[axis] < h[axis] && l[axis] < high[axis]);
            let texts = [index, other].map(|one| labels[one].text().unwrap());
            assert!(!covers, "{texts:?}: {low:?} {high:?} {l:?} {h:?}");
        }
    }
}

/// Labels of starts that are close to each other, in rows, in heaps, and in a narrow plan.
#[test]
fn labels_of_close_starts_do_not_cover_each_other() {
    let dots = |place: &dyn Fn(usize) -> [f64; 2]| {
        let line = |k| {
            let [x, y] = place(k);
            format!(
                "0 LINE\n8 0\n10 {x:.4}\n20 {y:.4}\n11 {:.4}\n21 {y:.4}\n",
                x + 0.1
            )
        };
        dxf(&(0..290).map(line).collect::<String>())
    };
    let heap = |k: usize| {
        let (angle, off) = (k as f64 * 2.4, (k as f64).sqrt() * 0.6);
        [20.0 + off * angle.cos(), 20.0 + off * angle.sin()]
    };
    for text in [
        dots(&|k| [10.0 + (k % 30) as f64 * 2.0, 10.0 + (k / 30) as f64 * 2.0]),
        dots(&|k| [10.0 + k as f64 * 0.3, 10.0]),
        dots(&heap),
    ] {
        let drawing = read(text.as_bytes(), &ReadOptions::default()).unwrap();
        let options = Options::default();
        let job = plan(&drawing, &options).unwrap();
        let svg = picture(&drawing, &job, &options);
        let svg = roxmltree::Document::parse(&svg).unwrap();
        let is_label = |node: &roxmltree::Node| node.tag_name().name() == "text";
        let labels: Vec<_> = svg.descendants().filter(is_label).collect();
        assert!(labels.len() > 50, "{}", labels.len());
        check_labels(&labels);
    }
}

/// The plan has a number and a path for each start, and an air move to each and back.
#[test]
fn the_page_numbers_the_starts_and_shows_every_move() {
    for (drawing, options, job) in jobs() {
        let svg = picture(&drawing, &job, &options);
        let svg = roxmltree::Document::parse(&svg).unwrap();
        let labels: Vec<_> = svg
            .descendants()
            .filter(|node| node.has_tag_name(("http://www.w3.org/2000/svg", "text")))
            .collect();
        let count = job.toolpath.cuts.len();
        // Each number once: alone, or in a range or a list of starts at one place.
        let parts = labels
            .iter()
            .flat_map(|label| label.text().unwrap().trim_end_matches(',').split(", "));
        let mut numbers: Vec<usize> = parts
            .flat_map(|part| {
                let (first, last) = part.split_once('-').unwrap_or((part, part));
                first.parse::<usize>().unwrap()..=last.parse().unwrap()
            })
            .collect();
        numbers.sort_unstable();
        assert_eq!(numbers, (1..=count).collect::<Vec<_>>());
        check_labels(&labels);
        let paths = svg
            .descendants()
            .filter(|node| node.attribute("d").is_some());
        let data: Vec<&str> = paths.filter_map(|node| node.attribute("d")).collect();
        // The arrow head, each cut at the tool's width and as a line, the air moves.
        assert_eq!(data.len(), 1 + 2 * count + count + 1);
        // The cuts at the real width of the tool are below the thin lines, which are below the air.
        let widths: Vec<f64> = svg
            .descendants()
            .filter_map(|node| node.attribute("stroke-width")?.parse().ok())
            .collect();
        assert_eq!(widths[0], options.tool_mm);
        assert!(widths[1..].iter().all(|width| *width < 1.0), "{widths:?}");
        let dots = svg.descendants().filter(|node| node.has_attribute("cx"));
        for (dot, cut) in dots.zip(&job.toolpath.cuts) {
            let number = |name| dot.attribute(name).unwrap().parse::<f64>().unwrap();
            let off = (number("cx") - cut.start[0]).hypot(number("cy") + cut.start[1]);
            assert!(off < 0.001, "{off}");
        }
        let speeds = Speeds {
            feed: 5.0,
            plunge: 1.0,
            rapid: 20.0,
            rise: 4.0,
            lift_mm: LIFT,
        };
        let rows = [
            ("file order".to_string(), 200.0, 9, 80.0),
            ("chosen".to_string(), 100.0, 9, 60.0),
        ];
        let page = html("Plate & <name>", &drawing, &job, &options, speeds, &rows);
        assert!(page.contains("Plate &amp; &lt;name&gt;"));
        // The form of the thesis's table 5.1: 100 (1 - 60 / 80) = 25 %.
        assert!(page.contains("<td>chosen<td>100.000<td>9<td>60.0<td>25.0 %"));
    }
}
