//! The test piece A160 of ISO 10791-7: a square of 160 mm, a diamond and a circle on it, a centre
//! hole and four stepped holes at the corners.
//!
//! Work coordinates have their origin at the centre of the top face. A [`ProbePoint`] is a point of
//! a surface with the place of the tool centre that cuts it. What moves the tool centre moves the
//! surface point with it, which is exact for a machine whose errors change little over the radius
//! of the tool.

use crate::Vector;
use crate::errors::even_nodes;
use crate::gdt::{self, Line, Undetermined};
use core::f64::consts::{PI, TAU};

/// Half of the side of the square, mm.
pub const HALF_SIDE: f64 = 80.0;

/// Radius of the circle, and distance of the sides of the diamond from the centre, mm.
pub const CIRCLE_RADIUS: f64 = 54.0;

/// Turn of the diamond, degrees.
pub const DIAMOND_DEG: f64 = 30.0;

/// Radius of the centre hole, mm.
pub const CENTRE_HOLE_RADIUS: f64 = 15.0;

/// Distance of the corner holes from the centre in x and in y, mm.
pub const CORNER_HOLE: f64 = 52.0;

/// Radius of the end mill for the contours and the centre hole (T3), mm.
pub const CONTOUR_TOOL: f64 = 10.0;

/// Radius of the end mill for the corner holes (T4), mm.
pub const HOLE_TOOL: f64 = 8.0;

/// Height of the part, mm.
pub const HEIGHT: f64 = 50.0;

/// Tolerance of the straightness of a side of the square, mm, as in the thesis; taken for the
/// diamond, too.
pub const STRAIGHTNESS: f64 = 0.010;

/// A point of a nominal surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProbePoint {
    /// Nominal point, mm.
    pub surface: Vector,
    /// Outward normal: out of the material, against the approach of a probe.
    pub normal: Vector,
    /// Radius of the tool that cuts it, mm.
    pub tool: f64,
}

impl ProbePoint {
    /// Place of the tool centre that cuts the nominal point.
    #[must_use]
    pub fn tool_centre(&self) -> Vector {
        self.surface + self.normal * self.tool
    }

    /// The point that a tool centre at this place has cut.
    #[must_use]
    pub fn cut_by(&self, centre: Vector) -> Vector {
        centre - self.normal * self.tool
    }
}

/// Sides of the square, in the order of the features.
pub const SIDES: [char; 4] = ['B', 'R', 'T', 'L'];

/// A value for each point of the part, ordered by features.
#[derive(Debug, Clone, PartialEq)]
pub struct Features<T> {
    /// Sides of the square: B (-y, the datum), R (+x), T (+y), L (-x).
    pub sides: [Vec<T>; 4],
    /// Sides of the diamond, counter-clockwise from the one that faces down and right.
    pub diamond: [Vec<T>; 4],
    /// The circle.
    pub circle: Vec<T>,
    /// The centre hole, datum C.
    pub centre_hole: Vec<T>,
    /// Upper (28 mm) and lower (26 mm) bore of each corner hole.
    pub corner_holes: [[Vec<T>; 2]; 4],
}

/// Signs of the coordinates of the corner holes.
pub const CORNERS: [[f64; 2]; 4] = [[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]];

impl<T> Features<T> {
    /// Applies a function to every point, in a fixed order.
    pub fn map<U>(&self, mut change: impl FnMut(&T) -> U) -> Features<U> {
        let mut all = |points: &Vec<T>| points.iter().map(&mut change).collect::<Vec<U>>();
        let [b, r, t, l] = &self.sides;
        let sides = [all(b), all(r), all(t), all(l)];
        let [one, two, three, four] = &self.diamond;
        let diamond = [all(one), all(two), all(three), all(four)];
        let circle = all(&self.circle);
        let centre_hole = all(&self.centre_hole);
        let [a, b, c, d] = &self.corner_holes;
        let mut hole = |bores: &[Vec<T>; 2]| [all(&bores[0]), all(&bores[1])];
        Features {
            sides,
            diamond,
            circle,
            centre_hole,
            corner_holes: [hole(a), hole(b), hole(c), hole(d)],
        }
    }
}

/// The points that a coordinate measuring machine takes: 15 on each side of the square.
#[must_use]
pub fn probe_points() -> Features<ProbePoint> {
    let side = |angle: f64, offset: f64, half: f64, count, height| {
        let (normal, along) = directions(angle);
        let places = even_nodes((-half, half), count).into_iter();
        let point = places.map(|place| ProbePoint {
            surface: normal * offset + along * place + Vector::new(0.0, 0.0, height),
            normal,
            tool: CONTOUR_TOOL,
        });
        point.collect::<Vec<_>>()
    };
    let square = |turn: usize| side(quarter(turn), HALF_SIDE, 70.0, 15, -30.0);
    let diamond = |turn: usize| {
        let angle = quarter(turn) + DIAMOND_DEG * PI / 180.0;
        side(angle, CIRCLE_RADIUS, 50.0, 11, -18.0)
    };
    let corner = |[x, y]: [f64; 2]| {
        let centre = [x * CORNER_HOLE, y * CORNER_HOLE];
        [
            hole(centre, 14.0, (-17.0, -1.0), HOLE_TOOL),
            hole(centre, 13.0, (-24.0, -19.0), HOLE_TOOL),
        ]
    };
    Features {
        sides: [square(0), square(1), square(2), square(3)],
        diamond: [diamond(0), diamond(1), diamond(2), diamond(3)],
        circle: ring([0.0, 0.0], CIRCLE_RADIUS, -6.0, 72, 1.0, CONTOUR_TOOL),
        centre_hole: hole([0.0, 0.0], CENTRE_HOLE_RADIUS, (-40.0, -5.0), CONTOUR_TOOL),
        corner_holes: CORNERS.map(corner),
    }
}

/// Angle of a normal that starts at -y and turns counter-clockwise by quarters.
fn quarter(turn: usize) -> f64 {
    turn as f64 * PI / 2.0
}

/// Normal and direction of a side that is turned by an angle from the one that faces -y.
fn directions(angle: f64) -> (Vector, Vector) {
    let (sine, cosine) = (libm::sin(angle), libm::cos(angle));
    (
        Vector::new(sine, -cosine, 0.0),
        Vector::new(cosine, sine, 0.0),
    )
}

/// Points of a circle; `outward` is 1 for a boss and -1 for a hole.
fn ring(
    centre: [f64; 2],
    radius: f64,
    height: f64,
    count: u32,
    outward: f64,
    tool: f64,
) -> Vec<ProbePoint> {
    let point = |step: u32| {
        let angle = TAU * f64::from(step) / f64::from(count);
        let radial = Vector::new(libm::cos(angle), libm::sin(angle), 0.0);
        ProbePoint {
            surface: Vector::new(centre[0], centre[1], height) + radial * radius,
            normal: radial * outward,
            tool,
        }
    };
    (0..count).map(point).collect()
}

fn hole(centre: [f64; 2], radius: f64, heights: (f64, f64), tool: f64) -> Vec<ProbePoint> {
    let heights = even_nodes(heights, 5).into_iter();
    heights
        .flat_map(|height| ring(centre, radius, height, 24, -1.0, tool))
        .collect()
}

/// A characteristic of the part.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Its name.
    pub name: String,
    /// Its value, mm.
    pub value: f64,
    /// Its minimum-zone value, mm, where the zone has one.
    pub zone: Option<f64>,
    /// Its tolerance, mm. Only the straightness of the square is in the thesis; the others are
    /// proposals that have not been compared with the standard.
    pub tolerance: Option<f64>,
}

impl Row {
    /// Whether the value is within its tolerance; true without one.
    #[must_use]
    pub fn passes(&self) -> bool {
        self.tolerance
            .is_none_or(|tolerance| self.value <= tolerance)
    }
}

/// Computes all characteristics of the part from measured points.
///
/// # Errors
/// A feature without enough points, by its name.
pub fn characteristics(points: &Features<Vector>) -> Result<Vec<Row>, (String, Undetermined)> {
    let mut rows = Vec::new();
    let datum = square_rows(&points.sides, &mut rows)?;
    diamond_rows(&points.diamond, &datum, &mut rows)?;
    let circle = named("circle", gdt::fit_circle(&flat(&points.circle)))?;
    let zone = named("circle", gdt::roundness_zone(&flat(&points.circle)))?;
    rows.push(row(
        "circle 108 roundness",
        circle.roundness(),
        Some(zone),
        Some(0.015),
    ));
    let diameter = 2.0 * (circle.radius - CIRCLE_RADIUS);
    rows.push(row("circle 108 diameter error", diameter, None, None));
    let centre = named("centre hole", gdt::fit_cylinder(&points.centre_hole))?;
    let zone = named("centre hole", gdt::cylindricity_zone(&points.centre_hole))?;
    let name = "centre hole cylindricity";
    rows.push(row(name, centre.cylindricity(), Some(zone), Some(0.010)));
    let tilt = gdt::axis_perpendicularity(centre.axis, HEIGHT);
    let name = "centre hole perpendicularity to A (dia, L=50)";
    rows.push(row(name, tilt, None, Some(0.010)));
    let origin = [centre.centre.x, centre.centre.y];
    let name = "concentricity circle/centre hole (dia)";
    rows.push(row(
        name,
        gdt::concentricity(circle.centre, origin),
        None,
        Some(0.025),
    ));
    for (bores, [x, y]) in points.corner_holes.iter().zip(CORNERS) {
        let nominal = [x * CORNER_HOLE, y * CORNER_HOLE];
        let name = format!("hole({:+},{:+})", nominal[0], nominal[1]);
        let [upper, lower] = bores;
        let upper = named(&name, gdt::fit_cylinder(upper))?.centre;
        let lower = named(&name, gdt::fit_cylinder(lower))?.centre;
        let place = gdt::in_datum([upper.x, upper.y], origin, &datum);
        let value = gdt::position(place, nominal);
        rows.push(row(
            &format!("{name} position dia wrt C,B"),
            value,
            None,
            Some(0.050),
        ));
        let value = gdt::concentricity([upper.x, upper.y], [lower.x, lower.y]);
        let name = format!("{name} inner/outer concentricity dia");
        rows.push(row(&name, value, None, Some(0.020)));
    }
    Ok(rows)
}

fn row(name: &str, value: f64, zone: Option<f64>, tolerance: Option<f64>) -> Row {
    Row {
        name: name.to_string(),
        value,
        zone,
        tolerance,
    }
}

fn named<T>(name: &str, result: Result<T, Undetermined>) -> Result<T, (String, Undetermined)> {
    result.map_err(|error| (name.to_string(), error))
}

fn flat(points: &[Vector]) -> Vec<[f64; 2]> {
    points.iter().map(|point| [point.x, point.y]).collect()
}

/// Points of a side as (along, across) of its nominal direction.
fn profile(points: &[Vector], angle: f64) -> Vec<[f64; 2]> {
    let (normal, along) = directions(angle);
    let places = points.iter();
    places
        .map(|point| [point.dot(&along), point.dot(&normal)])
        .collect()
}

/// Rows of the square; returns the datum line.
fn square_rows(
    sides: &[Vec<Vector>; 4],
    rows: &mut Vec<Row>,
) -> Result<Line, (String, Undetermined)> {
    for (turn, (side, name)) in sides.iter().zip(SIDES).enumerate() {
        let name = format!("square side {name} straightness LSQ");
        let points = profile(side, quarter(turn));
        let line = named(&name, gdt::fit_line(&points))?;
        let zone = gdt::straightness_zone(&points);
        rows.push(row(
            &name,
            line.straightness(),
            Some(zone),
            Some(STRAIGHTNESS),
        ));
    }
    let datum = named("side B", gdt::fit_line(&flat(&sides[0])))?;
    for (turn, name) in [(1, 'R'), (3, 'L')] {
        let value = gdt::perpendicularity(&flat(&sides[turn]), &datum);
        let name = format!("side {name} perpendicularity to B");
        rows.push(row(&name, value, None, Some(0.010)));
    }
    let value = gdt::parallelism(&flat(&sides[2]), &datum);
    rows.push(row("side T parallelism to B", value, None, Some(0.010)));
    Ok(datum)
}

fn diamond_rows(
    sides: &[Vec<Vector>; 4],
    datum: &Line,
    rows: &mut Vec<Row>,
) -> Result<(), (String, Undetermined)> {
    for (turn, side) in sides.iter().enumerate() {
        let angle = quarter(turn) + DIAMOND_DEG * PI / 180.0;
        let name = format!("diamond side {}", turn + 1);
        let points = profile(side, angle);
        let line = named(&name, gdt::fit_line(&points))?;
        let zone = gdt::straightness_zone(&points);
        let straight = format!("{name} straightness LSQ");
        rows.push(row(
            &straight,
            line.straightness(),
            Some(zone),
            Some(STRAIGHTNESS),
        ));
        let (normal, _) = directions(angle);
        let value = gdt::angularity(&flat(side), [normal.x, normal.y], datum);
        let name = format!("{name} angularity to B");
        rows.push(row(&name, value, None, Some(0.010)));
    }
    Ok(())
}
