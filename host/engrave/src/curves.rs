//! Curves (Bezier, ellipse, NURBS) to lines and arcs within a tolerance, and affine maps of paths.
//!
//! A curve becomes pairs of arcs that share their tangent (biarcs). A piece whose pair deviates by
//! more than the tolerance is halved.

use crate::geometry::{Path, Point, Segment, Vertex, distance};
use kurbo::{Affine, CubicBez, ParamCurve, ParamCurveDeriv};

/// Largest deviation of arcs from the curve that they replace, mm.
pub const TOLERANCE: f64 = 0.0025;

/// Largest number of halvings of a curve.
const DEPTH: u32 = 16;

/// Points of a curve at which the deviation is checked.
const SAMPLES: usize = 6;

/// Appends the segments of a curve. `curve` returns point and derivative at a parameter.
pub fn fit(
    curve: &dyn Fn(f64) -> (Point, Point),
    from: f64,
    to: f64,
    tolerance: f64,
    out: &mut Vec<Segment>,
) {
    halve(curve, [from, to], tolerance, DEPTH, out);
}

fn halve(
    curve: &dyn Fn(f64) -> (Point, Point),
    [from, to]: [f64; 2],
    tolerance: f64,
    depth: u32,
    out: &mut Vec<Segment>,
) {
    let (p, dp) = curve(from);
    let (q, dq) = curve(to);
    if let Some(pieces) = biarc(p, unit(dp), q, unit(dq)) {
        let near = (1..SAMPLES).all(|k| {
            let t = from + (to - from) * k as f64 / SAMPLES as f64;
            let at = curve(t).0;
            pieces
                .iter()
                .map(|piece| distance_to_segment(at, piece))
                .fold(
                    if pieces.is_empty() {
                        distance(at, p)
                    } else {
                        f64::INFINITY
                    },
                    f64::min,
                )
                <= tolerance
        });
        if near {
            out.extend(pieces.into_iter().filter(|piece| piece.from != piece.to));
            return;
        }
    }
    if depth == 0 {
        if p != q {
            out.push(Segment {
                from: p,
                to: q,
                bulge: 0.0,
            });
        }
        return;
    }
    let middle = f64::midpoint(from, to);
    halve(curve, [from, middle], tolerance, depth - 1, out);
    halve(curve, [middle, to], tolerance, depth - 1, out);
}

fn unit(v: Point) -> Option<Point> {
    let length = v[0].hypot(v[1]);
    (length > 1e-12 && length.is_finite()).then(|| [v[0] / length, v[1] / length])
}

/// Two arcs from `p` in direction `s` to `q` in direction `e` with equal tangent lengths, or one
/// line where all directions agree. `None` where no such pair turns by less than half a turn.
fn biarc(p: Point, s: Option<Point>, q: Point, e: Option<Point>) -> Option<Vec<Segment>> {
    let v = [q[0] - p[0], q[1] - p[1]];
    if v == [0.0, 0.0] {
        return Some(Vec::new());
    }
    let chord = unit(v)?;
    let (s, e) = (s.unwrap_or(chord), e.unwrap_or(chord));
    let along = dot(chord, s).min(dot(chord, e));
    if along > 1.0 - 1e-14 {
        return Some(vec![Segment {
            from: p,
            to: q,
            bulge: 0.0,
        }]);
    }
    if along < 0.1 {
        return None;
    }
    let t = [s[0] + e[0], s[1] + e[1]];
    let open = 2.0 * (1.0 - dot(s, e));
    let vt = dot(v, t);
    let d = if open < 1e-9 {
        dot(v, v) / (4.0 * dot(v, e))
    } else {
        ((vt * vt + open * dot(v, v)).sqrt() - vt) / open
    };
    let joint = [
        f64::midpoint(p[0], q[0]) + d * (s[0] - e[0]) / 2.0,
        f64::midpoint(p[1], q[1]) + d * (s[1] - e[1]) / 2.0,
    ];
    // The angle between tangent and chord is half the included angle; the bulge is the tangent of
    // half of that.
    let half = |a: Point, b: Point| cross(a, b).atan2(dot(a, b));
    let first = half(s, [joint[0] - p[0], joint[1] - p[1]]);
    let second = half([q[0] - joint[0], q[1] - joint[1]], e);
    let segment = |from, to, half: f64| {
        let bulge = (half / 2.0).tan();
        let sagitta = bulge.abs() * distance(from, to) / 2.0;
        // An arc this flat is a line.
        Segment {
            from,
            to,
            bulge: if sagitta < 1e-7 { 0.0 } else { bulge },
        }
    };
    Some(vec![segment(p, joint, first), segment(joint, q, second)])
}

fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

fn cross(a: Point, b: Point) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

/// Distance of a point to a segment, mm.
#[must_use]
pub fn distance_to_segment(at: Point, segment: &Segment) -> f64 {
    distance(at, segment.point(segment.nearest(at)))
}

/// Appends the segments of a cubic Bezier curve.
pub fn fit_cubic(cubic: CubicBez, tolerance: f64, out: &mut Vec<Segment>) {
    let derivative = cubic.deriv();
    let curve = |t: f64| {
        let (p, d) = (cubic.eval(t), derivative.eval(t).to_vec2());
        // At an end whose control point coincides with it the tangent is that of the inside.
        let d = if d.hypot2() > 1e-18 {
            d
        } else if t < 0.5 {
            cubic.eval(t + 1e-4) - p
        } else {
            p - cubic.eval(t - 1e-4)
        };
        ([p.x, p.y], [d.x, d.y])
    };
    // Two halves from the start: a symmetric S has all samples on its chord.
    fit(&curve, 0.0, 0.5, tolerance, out);
    fit(&curve, 0.5, 1.0, tolerance, out);
}

/// Scale of a map that keeps circles: `Some(negative)` for a mirror, `None` for other maps.
fn similarity(map: Affine) -> Option<f64> {
    let [a, b, c, d, ..] = map.as_coeffs();
    let size = a.hypot(b);
    let close = |x: f64, y: f64| (x - y).abs() <= 1e-9 * size;
    if close(a, d) && close(b, -c) {
        Some(size)
    } else if close(a, -d) && close(b, c) {
        Some(-size)
    } else {
        None
    }
}

/// Image of a point.
#[must_use]
pub fn map_point(map: Affine, at: Point) -> Point {
    let image = map * kurbo::Point::new(at[0], at[1]);
    [image.x, image.y]
}

/// Image of a path. Arcs stay arcs where the map keeps circles; else they become arcs of the
/// ellipse's approximation.
#[must_use]
pub fn map_path(map: Affine, path: &Path, tolerance: f64) -> Path {
    let straight = path.vertices.iter().all(|vertex| vertex.bulge == 0.0);
    if let Some(sign) = similarity(map).or(straight.then_some(1.0)) {
        let vertex = |vertex: &Vertex| Vertex {
            at: map_point(map, vertex.at),
            bulge: vertex.bulge * sign.signum(),
        };
        return Path {
            vertices: path.vertices.iter().map(vertex).collect(),
            ..*path
        };
    }
    let mut segments = Vec::new();
    for segment in path.segments() {
        match segment.arc() {
            None => segments.push(Segment {
                from: map_point(map, segment.from),
                to: map_point(map, segment.to),
                bulge: 0.0,
            }),
            Some(arc) => fit_ellipse(
                map,
                arc.centre,
                arc.radius,
                [arc.start, arc.start + arc.sweep],
                tolerance,
                &mut segments,
            ),
        }
    }
    let mut image = Path::from_segments(&segments, path.entity);
    if path.closed && image.vertices.len() > 1 {
        image.vertices.pop();
        image.closed = true;
    }
    image
}

/// Appends the image of an arc (angles in radians) under a map.
pub fn fit_ellipse(
    map: Affine,
    centre: Point,
    radius: f64,
    [from, to]: [f64; 2],
    tolerance: f64,
    out: &mut Vec<Segment>,
) {
    let [a, b, c, d, ..] = map.as_coeffs();
    let sign = (to - from).signum();
    let curve = |angle: f64| {
        let (sin, cos) = angle.sin_cos();
        let at = map_point(map, [centre[0] + radius * cos, centre[1] + radius * sin]);
        (
            at,
            [sign * (-a * sin + c * cos), sign * (-b * sin + d * cos)],
        )
    };
    // Quarters first: the tangents of a pair of arcs turn by less than half a turn.
    let count = ((to - from).abs() / std::f64::consts::FRAC_PI_2)
        .ceil()
        .max(1.0);
    for k in 0..count as usize {
        let part = |k: usize| from + (to - from) * k as f64 / count;
        fit(&curve, part(k), part(k + 1), tolerance, out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    fn points() -> impl Strategy<Value = Point> {
        prop::array::uniform2(-30.0..30.0)
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            rng_seed: RngSeed::Fixed(1),
            failure_persistence: None,
            ..ProptestConfig::default()
        })]

        /// The arcs stay within the tolerance of the curve at 200 points between the checked ones.
        #[test]
        fn arcs_follow_a_cubic(a in points(), b in points(), c in points(), d in points()) {
            let pick = |p: Point| kurbo::Point::new(p[0], p[1]);
            let cubic = CubicBez::new(pick(a), pick(b), pick(c), pick(d));
            let mut segments = Vec::new();
            fit_cubic(cubic, 0.0025, &mut segments);
            prop_assert!(distance(segments[0].from, a) < 1e-9);
            prop_assert!(distance(segments[segments.len() - 1].to, d) < 1e-9);
            for pair in segments.windows(2) {
                prop_assert!(distance(pair[0].to, pair[1].from) < 1e-9);
            }
            for k in 0..=200 {
                let at = cubic.eval(f64::from(k) / 200.0);
                let off = segments.iter().map(|one| distance_to_segment([at.x, at.y], one))
                    .fold(f64::INFINITY, f64::min);
                prop_assert!(off < 0.005, "{off} at {k}");
            }
        }
    }

    #[test]
    fn an_ellipse_is_within_the_tolerance_and_few_arcs() {
        let mut out = Vec::new();
        let map = Affine::scale_non_uniform(20.0, 10.0);
        fit_ellipse(
            map,
            [0.0, 0.0],
            1.0,
            [0.0, std::f64::consts::TAU],
            0.0025,
            &mut out,
        );
        assert!(out.len() <= 64, "{}", out.len());
        for segment in &out {
            for k in 0..=10 {
                let at = segment.point(f64::from(k) / 10.0);
                let level = (at[0] / 20.0).hypot(at[1] / 10.0);
                assert!((level - 1.0).abs() < 0.0005, "{level}");
            }
        }
    }

    #[test]
    fn a_mirror_turns_arcs_around() {
        let path = Path::circle([3.0, 0.0], 1.0, 0);
        let image = map_path(Affine::FLIP_X, &path, TOLERANCE);
        assert_eq!(image.vertices[0].at, [-4.0, 0.0]);
        assert!((image.vertices[0].bulge + 1.0).abs() < 1e-15);
        let wide = map_path(Affine::scale_non_uniform(2.0, 1.0), &path, TOLERANCE);
        assert!(wide.closed && wide.vertices.len() > 8);
    }

    /// A piece without length, as a spline with repeated control points has it, is left out at once
    /// and not halved to the end.
    #[test]
    fn a_piece_without_length_takes_no_halving() {
        let calls = std::cell::Cell::new(0);
        let point = |_: f64| {
            calls.set(calls.get() + 1);
            ([3.0, 4.0], [0.0, 0.0])
        };
        let mut out = Vec::new();
        fit(&point, 0.0, 1.0, TOLERANCE, &mut out);
        assert!(out.is_empty() && calls.get() < 20, "{}", calls.get());
        // A loop that ends where it begins is not without length.
        let round = |t: f64| {
            let (sin, cos) = (t * std::f64::consts::TAU).sin_cos();
            ([cos, sin], [-sin, cos])
        };
        fit(&round, 0.0, 1.0, TOLERANCE, &mut out);
        let length: f64 = out.iter().map(Segment::length).sum();
        assert!((length - std::f64::consts::TAU).abs() < 1e-3, "{length}");
    }
}
