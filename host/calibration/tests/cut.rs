//! The test piece: its program as a path without a machine, and the cut surface.

use haptimill_calibration::cut::{Cmm, PROGRAM, surface};
use haptimill_calibration::observed::Sample;
use haptimill_calibration::scenario::machine;
use haptimill_client::session;
use haptimill_gcode::{Feed, Step};
use haptimill_machine_file::model::{Model, program_options};
use haptimill_volumetric::part::{
    CENTRE_HOLE_RADIUS, CIRCLE_RADIUS, CONTOUR_TOOL, CORNER_HOLE, CORNERS, DIAMOND_DEG, HALF_SIDE,
    probe_points,
};

/// Moves of a program: the points of its path, and whether it is a rapid move. Arcs are chords with
/// a sagitta of 0.05 um.
fn moves(text: &str) -> Vec<(bool, Vec<[f64; 3]>)> {
    let file = machine().unwrap();
    let model = Model::new(&file);
    let home = session::find_home_pose(&file, &model).unwrap();
    let options = program_options(&file, model.to_engineering_units(&home));
    let program = haptimill_gcode::read("a160.ngc", text.as_bytes(), &options).unwrap();
    let steps = program.steps.iter().filter_map(|step| match step {
        Step::Move(step) => Some(step),
        _ => None,
    });
    steps
        .map(|step| {
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
            (matches!(step.feed, Feed::Rapid), points)
        })
        .collect()
}

/// Samples of a machine without errors, or with the tool off by `off` in y.
fn samples(text: &str, off: f64) -> Vec<Sample> {
    let points = moves(text).into_iter().flat_map(|(_, points)| points);
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
    for (_, points) in &all {
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
    for (rapid, points) in &all {
        let (first, last) = (points[0], points[points.len() - 1]);
        let across = (last[0] - first[0]).hypot(last[1] - first[1]);
        assert!(
            !rapid || across < 1e-9 || first[2].min(last[2]) > 0.0,
            "{first:?} {last:?}"
        );
    }
}
