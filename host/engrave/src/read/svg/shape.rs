//! Shapes and path data of SVG as paths.

use crate::curves::{TOLERANCE, fit_cubic, fit_ellipse, map_path, map_point};
use crate::geometry::{Path, Point, Segment};
use kurbo::{Affine, Arc, CubicBez, QuadBez, SvgArc, Vec2};
use svgtypes::{PathParser, PathSegment};

/// Builds paths from path data under a map to the drawing plane.
pub struct Builder {
    map: Affine,
    start: Point,
    at: Point,
    /// Last control point, for the smooth curves, with whether it is that of a cubic.
    control: Option<(Point, bool)>,
    segments: Vec<Segment>,
    /// A line ended where it began.
    is_dot: bool,
    /// Number of dots: paths of such lines only, which are not in `paths`.
    pub dots: usize,
    pub paths: Vec<Path>,
}

impl Builder {
    pub fn new(map: Affine) -> Self {
        Self {
            map,
            start: [0.0; 2],
            at: [0.0; 2],
            control: None,
            segments: Vec::new(),
            is_dot: false,
            dots: 0,
            paths: Vec::new(),
        }
    }

    fn image(&self, at: Point) -> kurbo::Point {
        self.map * kurbo::Point::new(at[0], at[1])
    }

    pub fn move_to(&mut self, at: Point) {
        self.finish(false);
        self.start = at;
        self.at = at;
    }

    pub fn line_to(&mut self, to: Point) {
        if to != self.at {
            let (from, end) = (map_point(self.map, self.at), map_point(self.map, to));
            self.segments.push(Segment {
                from,
                to: end,
                bulge: 0.0,
            });
            self.at = to;
        } else {
            self.is_dot = true;
        }
    }

    fn cubic_to(&mut self, b: Point, c: Point, d: Point) {
        let [a, b, c, end] = [self.at, b, c, d].map(|at| self.image(at));
        fit_cubic(CubicBez::new(a, b, c, end), TOLERANCE, &mut self.segments);
        self.at = d;
    }

    fn quadratic_to(&mut self, b: Point, c: Point) {
        let [a, b, end] = [self.at, b, c].map(|at| self.image(at));
        fit_cubic(
            QuadBez::new(a, b, end).raise(),
            TOLERANCE,
            &mut self.segments,
        );
        self.at = c;
    }

    pub fn arc_to(&mut self, radii: [f64; 2], degrees: f64, large: bool, sweep: bool, to: Point) {
        let point = |at: Point| kurbo::Point::new(at[0], at[1]);
        let arc = Arc::from_svg_arc(&SvgArc {
            from: point(self.at),
            to: point(to),
            radii: Vec2::new(radii[0].abs(), radii[1].abs()),
            x_rotation: degrees.to_radians(),
            large_arc: large,
            sweep,
        });
        let Some(arc) = arc else {
            self.line_to(to);
            return;
        };
        let circle = self.map
            * Affine::translate(arc.center.to_vec2())
            * Affine::rotate(arc.x_rotation)
            * Affine::scale_non_uniform(arc.radii.x, arc.radii.y);
        let (from, end) = (arc.start_angle, arc.start_angle + arc.sweep_angle);
        let [a, b, c, d, ..] = circle.as_coeffs();
        let size = a.hypot(b);
        let sign = a * d - b * c;
        let round =
            (a * c + b * d).abs() < 1e-9 * size * size && (size - c.hypot(d)).abs() < 1e-9 * size;
        if round {
            // The image of the arc is an arc: two halves, so that no bulge is above 1.
            let at = |angle: f64| map_point(circle, [angle.cos(), angle.sin()]);
            let middle = f64::midpoint(from, end);
            let bulge = (arc.sweep_angle / 8.0).tan() * sign.signum();
            let last = map_point(self.map, to);
            let first = map_point(self.map, self.at);
            self.segments.push(Segment {
                from: first,
                to: at(middle),
                bulge,
            });
            self.segments.push(Segment {
                from: at(middle),
                to: last,
                bulge,
            });
        } else {
            fit_ellipse(
                circle,
                [0.0; 2],
                1.0,
                [from, end],
                TOLERANCE,
                &mut self.segments,
            );
        }
        self.at = to;
    }

    /// Ends the present subpath.
    pub fn finish(&mut self, close: bool) {
        let is_dot = std::mem::take(&mut self.is_dot);
        if close {
            self.line_to(self.start);
            self.is_dot = false;
        }
        let segments = std::mem::take(&mut self.segments);
        self.at = self.start;
        self.control = None;
        if segments.is_empty() {
            self.dots += usize::from(is_dot);
            return;
        }
        let mut path = Path::from_segments(&segments, 0);
        let meets = path.vertices.len() > 2
            && path.vertices[0].at == path.vertices[path.vertices.len() - 1].at;
        if meets || close && path.vertices.len() > 2 {
            path.vertices.pop();
            path.closed = true;
        }
        self.paths.push(path);
    }

    /// Appends path data.
    pub fn data(&mut self, data: &str) -> Result<(), svgtypes::Error> {
        for segment in PathParser::from(data) {
            self.path_segment(segment?);
        }
        self.finish(false);
        Ok(())
    }

    fn path_segment(&mut self, segment: PathSegment) {
        let at = self.at;
        let place = move |absolute: bool, x: f64, y: f64| {
            if absolute {
                [x, y]
            } else {
                [at[0] + x, at[1] + y]
            }
        };
        // The mirror image of the last control point.
        let mirrored = |cubic: bool| match self.control {
            Some((control, of)) if of == cubic => {
                [2.0 * at[0] - control[0], 2.0 * at[1] - control[1]]
            }
            _ => at,
        };
        let mut control = None;
        match segment {
            PathSegment::MoveTo { abs, x, y } => self.move_to(place(abs, x, y)),
            PathSegment::LineTo { abs, x, y } => self.line_to(place(abs, x, y)),
            PathSegment::HorizontalLineTo { abs, x } => {
                self.line_to([if abs { x } else { at[0] + x }, at[1]]);
            }
            PathSegment::VerticalLineTo { abs, y } => {
                self.line_to([at[0], if abs { y } else { at[1] + y }]);
            }
            PathSegment::CurveTo {
                abs,
                x1,
                y1,
                x2,
                y2,
                x,
                y,
            } => {
                let (b, c) = (place(abs, x1, y1), place(abs, x2, y2));
                self.cubic_to(b, c, place(abs, x, y));
                control = Some((c, true));
            }
            PathSegment::SmoothCurveTo { abs, x2, y2, x, y } => {
                let (b, c) = (mirrored(true), place(abs, x2, y2));
                self.cubic_to(b, c, place(abs, x, y));
                control = Some((c, true));
            }
            PathSegment::Quadratic { abs, x1, y1, x, y } => {
                let b = place(abs, x1, y1);
                self.quadratic_to(b, place(abs, x, y));
                control = Some((b, false));
            }
            PathSegment::SmoothQuadratic { abs, x, y } => {
                let b = mirrored(false);
                self.quadratic_to(b, place(abs, x, y));
                control = Some((b, false));
            }
            PathSegment::EllipticalArc {
                abs,
                rx,
                ry,
                x_axis_rotation,
                large_arc,
                sweep,
                x,
                y,
            } => {
                let to = place(abs, x, y);
                self.arc_to([rx, ry], x_axis_rotation, large_arc, sweep, to);
            }
            PathSegment::ClosePath { .. } => self.finish(true),
        }
        self.control = control;
    }
}

/// A rectangle with round corners.
pub fn rectangle(builder: &mut Builder, [x, y]: Point, [w, h]: [f64; 2], radii: [f64; 2]) {
    let [rx, ry] = [
        radii[0].min(w / 2.0).max(0.0),
        radii[1].min(h / 2.0).max(0.0),
    ];
    if rx == 0.0 || ry == 0.0 {
        builder.move_to([x, y]);
        for at in [[x + w, y], [x + w, y + h], [x, y + h]] {
            builder.line_to(at);
        }
        builder.finish(true);
        return;
    }
    builder.move_to([x + rx, y]);
    let corners = [
        ([x + w - rx, y], [x + w, y + ry]),
        ([x + w, y + h - ry], [x + w - rx, y + h]),
        ([x + rx, y + h], [x, y + h - ry]),
        ([x, y + ry], [x + rx, y]),
    ];
    for (line, arc) in corners {
        builder.line_to(line);
        builder.arc_to([rx, ry], 0.0, false, true, arc);
    }
    builder.finish(true);
}

/// A circle or ellipse that starts at 0 degrees and runs counter-clockwise in the drawing plane.
pub fn ellipse(map: Affine, centre: Point, rx: f64, ry: f64) -> Path {
    if (rx - ry).abs() <= 1e-12 * rx {
        let mut path = map_path(map, &Path::circle(centre, rx, 0), TOLERANCE);
        if path.vertices.iter().all(|vertex| vertex.bulge < 0.0) {
            path = path.reversed();
        }
        return path;
    }
    let map = map * Affine::translate((centre[0], centre[1])) * Affine::scale_non_uniform(rx, ry);
    let mut segments = Vec::new();
    fit_ellipse(
        map,
        [0.0; 2],
        1.0,
        [0.0, -std::f64::consts::TAU],
        TOLERANCE,
        &mut segments,
    );
    let mut path = Path::from_segments(&segments, 0);
    if path.vertices.len() > 2 {
        path.vertices.pop();
        path.closed = true;
    }
    path
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paths(data: &str) -> Vec<Path> {
        let mut builder = Builder::new(Affine::IDENTITY);
        builder.data(data).unwrap();
        builder.paths
    }

    #[test]
    fn round_arcs_stay_arcs() {
        let paths = paths("M 10 0 A 10 10 0 0 1 0 10 L 0 0 Z m 20,0 h 5 v 5");
        assert_eq!(paths.len(), 2);
        assert!(paths[0].closed && !paths[1].closed);
        let length = 5.0 * std::f64::consts::PI + 20.0;
        assert!((paths[0].length() - length).abs() < 1e-9);
        // After Z the present point is the start of the subpath.
        assert_eq!(paths[1].start(), Some([30.0, 0.0]));
    }

    #[test]
    fn smooth_curves_mirror_the_control_point() {
        let smooth = paths("M0 0 C 0 5 5 5 5 0 S 10 -5 10 0");
        let plain = paths("M0 0 C 0 5 5 5 5 0 C 5 -5 10 -5 10 0");
        assert_eq!(smooth, plain);
        let smooth = paths("M0 0 Q 2 5 4 0 T 8 0");
        let plain = paths("M0 0 Q 2 5 4 0 Q 6 -5 8 0");
        assert_eq!(smooth, plain);
    }
}
