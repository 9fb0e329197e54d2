//! The test piece: its program as a path without a machine, and the cut surface.

use haptimill_calibration::cut::{Cmm, PROGRAM, surface};
use haptimill_calibration::observed::Sample;
use haptimill_calibration::scenario::machine;
use haptimill_client::session;
use haptimill_gcode::{Feed, Step};
use haptimill_machine_file::model::{Model, program_options};
use haptimill_volumetric::part::{
    CENTRE_HOLE_RADIUS, CIRCLE_RADIUS, CONTOUR_TOOL, CORNER_HOLE, CORNERS, DIAMOND_DEG, HALF_SIDE,
    HOLE_TOOL, probe_points,
};

/// A move of a program with the tool that was changed last.
struct ToolMove {
    tool: u32,
    rapid: bool,
    points: Vec<[f64; 3]>,
}

/// Moves of a program: the points of its path, and whether it is a rapid move. Arcs are chords with
/// a sagitta of 0.05 um.
fn moves(text: &str) -> Vec<ToolMove> {
    let file = machine().unwrap();
    let model = Model::new(&file);
    let home = session::find_home_pose(&file, &model).unwrap();
    let options = program_options(&file, model.to_engineering_units(&home));
    let program = haptimill_gcode::read("a160.ngc", text.as_bytes(), &options).unwrap();
    let mut fitted = 0;
    let steps = program.steps.iter().filter_map(|step| match step {
        Step::Move(step) => Some((fitted, step)),
        Step::ToolChange { tool, .. } => {
            fitted = *tool;
            None
        }
        _ => None,
    });
    steps
        .map(|(tool, step)| {
            let radius = step.path.arc.as_ref().map(|arc| arc.radius[0]);
            let chord = radius.map_or(1.0, |radius| (8.0 * radius * 0.05e-3).sqrt());
            let count = (step.path.length / chord).ceil().max(1.0) as u32;
            let point = |piece: u32| {
                let [x, y, z, ..] = step
                    .path
                    .at(step.path.length * f64::from(piece) / f64::from(count));
                [x, y, z]
            };
            let points = (0..=count).map(point).collect();
            ToolMove {
                tool,
                rapid: matches!(step.feed, Feed::Rapid),
                points,
            }
        })
        .collect()
}

/// Samples of a machine without errors, or with the tool off by `off` in y.
fn samples(text: &str, off: f64) -> Vec<Sample> {
    let points = moves(text).into_iter().flat_map(|step| step.points);
    points
        .map(|[x, y, z]| Sample {
            time: 0.0,
            commanded: [x, y, z, 0.0, 0.0, 0.0],
            reported: [0.0; 6],
            tool: [x, y + off, z, 0.0, 0.0, 0.0],
            carriages: [0.0; 6],
        })
        .collect()
}

/// Rows 22 and 23: the program against the model of the part. A machine without errors leaves
/// none; the last pass counts; a feature that is not cut is named.
#[test]
fn the_program_cuts_the_part() {
    let exact = samples(PROGRAM, 0.0);
    let cut = surface(&exact).unwrap();
    for row in Cmm::ideal().measure(&cut).unwrap() {
        assert!(row.value.abs() < 0.1e-3, "{row:?}");
    }
    // A second run whose tool is 5 um off in y.
    let twice: Vec<Sample> = exact
        .iter()
        .copied()
        .chain(samples(PROGRAM, 5e-3))
        .collect();
    let again = surface(&twice).unwrap();
    let nominal = probe_points();
    for (point, cut) in nominal.sides[0].iter().zip(&again.sides[0]) {
        let off = cut - point.surface;
        assert!(
            (off.y - 5e-3).abs() < 0.1e-3 && off.x.abs() < 0.1e-3,
            "{off}"
        );
    }
    // Without the circle.
    let from = PROGRAM.find("(circle of 108 mm)").unwrap();
    let to = PROGRAM.find("(centre hole of 30 mm").unwrap();
    let without = format!("{}{}", &PROGRAM[..from], &PROGRAM[to..]);
    let refused = surface(&samples(&without, 0.0)).unwrap_err();
    let expected = "the program cuts nothing at x = 54.0, y = 0.0, z = -6.0";
    assert!(refused.message.contains(expected), "{refused}");
    assert!(refused.message.contains("add the pass"), "{refused}");
}

/// Distance of a place from a square about the origin, turned by an angle, mm; 0 inside.
fn from_square([x, y]: [f64; 2], half: f64, degrees: f64) -> f64 {
    let (sine, cosine) = degrees.to_radians().sin_cos();
    let (u, v) = (x * cosine + y * sine, y * cosine - x * sine);
    let beyond = [u.abs() - half, v.abs() - half].map(|part| part.max(0.0));
    beyond[0].hypot(beyond[1])
}

/// Row 21: the tool enters the material of no side, in feed or in rapid: where it goes down, it is
/// clear of the finished part at this height, or over a drilled hole.
#[test]
fn the_program_never_plunges_into_a_side() {
    let mut plunges = 0;
    let all = moves(PROGRAM);
    for ToolMove { points, .. } in &all {
        let (first, last) = (points[0], points[points.len() - 1]);
        let [x, y, z] = last;
        if last[2] >= first[2] || z >= 0.0 {
            continue;
        }
        plunges += 1;
        let still = (x - first[0]).hypot(y - first[1]);
        assert!(still < 1e-9, "a ramp at {last:?}");
        let holes = CORNERS.map(|[x, y]| [x * CORNER_HOLE, y * CORNER_HOLE]);
        let in_hole = holes.iter().chain(&[[0.0, 0.0]]).any(|hole| {
            (x - hole[0]).hypot(y - hole[1]) < CENTRE_HOLE_RADIUS - CONTOUR_TOOL + 1e-9
        });
        let clear = [
            (-30.0, from_square([x, y], HALF_SIDE, 0.0)),
            (-18.0, from_square([x, y], CIRCLE_RADIUS, DIAMOND_DEG)),
            (-6.0, x.hypot(y) - CIRCLE_RADIUS),
        ];
        let part = clear.iter().find(|(level, _)| (z - level).abs() < 1e-9);
        let is_clear = part.is_some_and(|(_, distance)| *distance > CONTOUR_TOOL + 1.0);
        assert!(in_hole || is_clear, "{last:?}");
    }
    // Square, four sides of the diamond, circle, and the holes with their levels.
    assert!(plunges > 30, "{plunges}");
    // No rapid move below the top but straight down into a hole or up.
    for ToolMove { rapid, points, .. } in &all {
        let (first, last) = (points[0], points[points.len() - 1]);
        let across = (last[0] - first[0]).hypot(last[1] - first[1]);
        assert!(
            !rapid || across < 1e-9 || first[2].min(last[2]) > 0.0,
            "{first:?} {last:?}"
        );
    }
}

/// Radii of the tools of the program, mm: drill of 11 mm, end mills of 20 and of 16 mm.
const RADII: [(u32, f64); 3] = [(2, 5.5), (3, CONTOUR_TOOL), (4, HOLE_TOOL)];

/// How far a tool reaches into the finished part with its end face here, mm: below 0 it is clear.
/// The part has the circle down to 6 mm, the diamond to 18 mm and the square below. A hole is wider
/// above than below, so its radius at the end of the tool counts.
fn overlap([x, y, z]: [f64; 3], radius: f64) -> f64 {
    let levels = [
        (0.0, x.hypot(y) - CIRCLE_RADIUS),
        (-6.0, from_square([x, y], CIRCLE_RADIUS, DIAMOND_DEG)),
        (-18.0, from_square([x, y], HALF_SIDE, 0.0)),
    ];
    // The level with the largest section that the tool passes.
    let passed = levels.iter().filter(|(top, _)| z < *top);
    let outside = passed.map(|(_, distance)| radius - distance);
    let outside = outside.fold(f64::NEG_INFINITY, f64::max);
    let depth_of_corner_hole = match z {
        z if z >= -18.0 => 14.0,
        z if z >= -24.0 => 13.0,
        z if z >= -38.0 => HOLE_TOOL,
        _ => 5.5,
    };
    let corners = CORNERS.map(|[x, y]| ([x * CORNER_HOLE, y * CORNER_HOLE], depth_of_corner_hole));
    let holes = corners
        .into_iter()
        .chain([([0.0, 0.0], CENTRE_HOLE_RADIUS)]);
    let inside = holes.map(|([a, b], hole)| (x - a).hypot(y - b) + radius - hole);
    outside.min(inside.fold(f64::INFINITY, f64::min))
}

/// Row 22: the whole path of the program against the model of the part. No tool reaches into the
/// finished part anywhere, by more than the sagitta of an arc; every tool is used; a program that
/// gouges is found.
#[test]
fn no_tool_gouges_the_part() {
    let deepest = |text: &str| {
        let all = moves(text);
        let of_move = all.iter().flat_map(|step| {
            let radius = RADII
                .iter()
                .find(|(tool, _)| *tool == step.tool)
                .map(|(_, radius)| *radius);
            // Points of a straight move are 1 mm apart, and both ends of it are among them.
            step.points
                .iter()
                .filter(|point| point[2] < 0.0)
                .map(move |point| (overlap(*point, radius.expect("a tool")), *point))
        });
        let worst = of_move.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
        (worst, all)
    };
    let ((overlap, at), all) = deepest(PROGRAM);
    println!("deepest {overlap} mm at {at:?}");
    assert!(overlap < 0.1e-3, "{overlap} mm at {at:?}");
    for (tool, _) in RADII {
        assert!(
            all.iter()
                .any(|step| step.tool == tool && step.points[0][2] < 0.0),
            "{tool}"
        );
    }
    // In the order of the thesis: contours, drill, centre hole, corner holes.
    let mut tools: Vec<u32> = all
        .iter()
        .map(|step| step.tool)
        .filter(|tool| *tool > 0)
        .collect();
    tools.dedup();
    assert_eq!(tools, [3, 2, 3, 4]);
    for (from, to, min) in [
        // Across the finished diamond at the height of the circle, 10 mm deep.
        ("G1 Y20\nG0 Z20", "G1 Y20\nG1 Z-16\nG1 X40\nG0 Z20", 5.0),
        // A hole whose path is 20 um too wide, and a side that is 50 um too far inwards.
        ("O300 call [0] [0] [5]", "O300 call [0] [0] [5.02]", 0.019),
        ("G1 X90 Y-110", "G1 X89.95 Y-110", 0.045),
    ] {
        assert!(PROGRAM.contains(from), "{from}");
        let ((overlap, at), _) = deepest(&PROGRAM.replacen(from, to, 1));
        assert!(overlap > min, "{to}: {overlap} at {at:?}");
    }
}
