//! Points, paths of lines and arcs, and the curves that become such paths.
//!
//! A path is a list of vertices. A vertex has the bulge of the segment that follows it: the tangent
//! of a quarter of the included angle, positive counter-clockwise, 0 for a line. Arcs stay arcs
//! from the drawing to the part program.

/// A point of the drawing plane, mm.
pub type Point = [f64; 2];

/// Distance of two points, mm.
#[must_use]
pub fn distance(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// A vertex of a path and the segment that follows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vertex {
    /// Position, mm.
    pub at: Point,
    /// Bulge of the segment to the next vertex.
    pub bulge: f64,
}

/// An arc by its centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arc {
    /// Centre, mm.
    pub centre: Point,
    /// Radius, mm.
    pub radius: f64,
    /// Angle of the start from +x, radians.
    pub start: f64,
    /// Included angle, radians; positive counter-clockwise.
    pub sweep: f64,
}

impl Arc {
    /// Point at a fraction of the sweep.
    #[must_use]
    pub fn point(&self, part: f64) -> Point {
        let angle = self.start + self.sweep * part;
        [
            self.centre[0] + self.radius * angle.cos(),
            self.centre[1] + self.radius * angle.sin(),
        ]
    }
}

/// A segment: from one point to another on a line or an arc.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// Start, mm.
    pub from: Point,
    /// End, mm.
    pub to: Point,
    /// Bulge, 0 for a line.
    pub bulge: f64,
}

impl Segment {
    /// Arc of the segment; `None` for a line.
    ///
    /// The centre is that of `k = (1 - B^2) / 4B` beside the middle of the chord, which has no
    /// division by a coordinate difference and no choice of a root.
    #[must_use]
    pub fn arc(&self) -> Option<Arc> {
        if self.bulge == 0.0 {
            return None;
        }
        let (s, e, b) = (self.from, self.to, self.bulge);
        let k = (1.0 - b * b) / (4.0 * b);
        let centre = [
            f64::midpoint(s[0], e[0]) - k * (e[1] - s[1]),
            f64::midpoint(s[1], e[1]) + k * (e[0] - s[0]),
        ];
        Some(Arc {
            centre,
            radius: distance(s, e) * (1.0 + b * b) / (4.0 * b.abs()),
            start: (s[1] - centre[1]).atan2(s[0] - centre[0]),
            sweep: 4.0 * b.atan(),
        })
    }

    /// Length, mm.
    #[must_use]
    pub fn length(&self) -> f64 {
        match self.arc() {
            None => distance(self.from, self.to),
            Some(arc) => arc.radius * arc.sweep.abs(),
        }
    }

    /// Point at a fraction of the length.
    #[must_use]
    pub fn point(&self, part: f64) -> Point {
        match self.arc() {
            None => [
                self.from[0] + (self.to[0] - self.from[0]) * part,
                self.from[1] + (self.to[1] - self.from[1]) * part,
            ],
            Some(arc) => arc.point(part),
        }
    }

    /// Direction of motion at a fraction of the length, a unit vector.
    #[must_use]
    pub fn direction(&self, part: f64) -> Point {
        match self.arc() {
            None => {
                let length = distance(self.from, self.to).max(f64::MIN_POSITIVE);
                [
                    (self.to[0] - self.from[0]) / length,
                    (self.to[1] - self.from[1]) / length,
                ]
            }
            Some(arc) => {
                let angle = arc.start + arc.sweep * part;
                let sign = arc.sweep.signum();
                [-angle.sin() * sign, angle.cos() * sign]
            }
        }
    }

    /// Fraction of the length of the point nearest to `at`.
    #[must_use]
    pub fn nearest(&self, at: Point) -> f64 {
        match self.arc() {
            None => {
                let v = [self.to[0] - self.from[0], self.to[1] - self.from[1]];
                let w = [at[0] - self.from[0], at[1] - self.from[1]];
                let square = v[0] * v[0] + v[1] * v[1];
                if square == 0.0 {
                    return 0.0;
                }
                ((w[0] * v[0] + w[1] * v[1]) / square).clamp(0.0, 1.0)
            }
            Some(arc) => {
                let angle = (at[1] - arc.centre[1]).atan2(at[0] - arc.centre[0]);
                let turn = std::f64::consts::TAU;
                let along = ((angle - arc.start) * arc.sweep.signum()).rem_euclid(turn);
                let part = along / arc.sweep.abs();
                if part <= 1.0 {
                    part
                } else if distance(at, self.from) <= distance(at, self.to) {
                    0.0
                } else {
                    1.0
                }
            }
        }
    }

    /// The two parts of the segment before and after a fraction of its length.
    #[must_use]
    pub fn split(&self, part: f64) -> (Self, Self) {
        let middle = self.point(part);
        let bulge = |part: f64| match self.bulge {
            0.0 => 0.0,
            bulge => (bulge.atan() * part).tan(),
        };
        (
            Self {
                from: self.from,
                to: middle,
                bulge: bulge(part),
            },
            Self {
                from: middle,
                to: self.to,
                bulge: bulge(1.0 - part),
            },
        )
    }

    /// The segment from its end to its start.
    #[must_use]
    pub const fn reversed(&self) -> Self {
        Self {
            from: self.to,
            to: self.from,
            bulge: -self.bulge,
        }
    }

    /// Box around the segment: low and high corner.
    #[must_use]
    pub fn bounds(&self) -> [Point; 2] {
        let mut low = [self.from[0].min(self.to[0]), self.from[1].min(self.to[1])];
        let mut high = [self.from[0].max(self.to[0]), self.from[1].max(self.to[1])];
        if let Some(arc) = self.arc() {
            for quarter in 0..4_u8 {
                let angle = f64::from(quarter) * std::f64::consts::FRAC_PI_2;
                let turn = std::f64::consts::TAU;
                let along = if arc.sweep > 0.0 {
                    (angle - arc.start).rem_euclid(turn)
                } else {
                    (arc.start - angle).rem_euclid(turn)
                };
                if along < arc.sweep.abs() {
                    let at = [
                        arc.centre[0] + arc.radius * angle.cos(),
                        arc.centre[1] + arc.radius * angle.sin(),
                    ];
                    for axis in 0..2 {
                        low[axis] = low[axis].min(at[axis]);
                        high[axis] = high[axis].max(at[axis]);
                    }
                }
            }
        }
        [low, high]
    }
}

/// A path of lines and arcs.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Path {
    /// Vertices in order. The bulge of the last one counts only in a closed path.
    pub vertices: Vec<Vertex>,
    /// Whether a segment leads from the last vertex back to the first.
    pub closed: bool,
    /// Index of the entity in the drawing that the path is from.
    pub entity: usize,
}

impl Path {
    /// An open path along segments that join.
    #[must_use]
    pub fn from_segments(segments: &[Segment], entity: usize) -> Self {
        let mut vertices: Vec<Vertex> = segments
            .iter()
            .map(|segment| Vertex {
                at: segment.from,
                bulge: segment.bulge,
            })
            .collect();
        if let Some(last) = segments.last() {
            vertices.push(Vertex {
                at: last.to,
                bulge: 0.0,
            });
        }
        Self {
            vertices,
            closed: false,
            entity,
        }
    }

    /// A closed path through points.
    #[must_use]
    pub fn polygon(points: &[Point], entity: usize) -> Self {
        let vertices = points.iter().map(|&at| Vertex { at, bulge: 0.0 }).collect();
        Self {
            vertices,
            closed: true,
            entity,
        }
    }

    /// A circle that starts at 0 degrees and runs counter-clockwise.
    #[must_use]
    pub fn circle(centre: Point, radius: f64, entity: usize) -> Self {
        let vertex = |x: f64| Vertex {
            at: [x, centre[1]],
            bulge: 1.0,
        };
        let vertices = vec![vertex(centre[0] + radius), vertex(centre[0] - radius)];
        Self {
            vertices,
            closed: true,
            entity,
        }
    }

    /// Number of segments.
    #[must_use]
    pub const fn segment_count(&self) -> usize {
        match (self.closed, self.vertices.len()) {
            (_, 0 | 1) => 0,
            (true, count) => count,
            (false, count) => count - 1,
        }
    }

    /// Segment by its index.
    #[must_use]
    pub fn segment(&self, index: usize) -> Segment {
        let from = self.vertices[index];
        let to = self.vertices[(index + 1) % self.vertices.len()];
        Segment {
            from: from.at,
            to: to.at,
            bulge: from.bulge,
        }
    }

    /// Segments in order.
    pub fn segments(&self) -> impl DoubleEndedIterator<Item = Segment> + '_ {
        (0..self.segment_count()).map(|index| self.segment(index))
    }

    /// Length, mm.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.segments().map(|segment| segment.length()).sum()
    }

    /// First point; `None` without vertices.
    #[must_use]
    pub fn start(&self) -> Option<Point> {
        self.vertices.first().map(|vertex| vertex.at)
    }

    /// Last point: the first one in a closed path.
    #[must_use]
    pub fn end(&self) -> Option<Point> {
        if self.closed {
            self.start()
        } else {
            self.vertices.last().map(|vertex| vertex.at)
        }
    }

    /// The path from its end to its start. A closed path keeps its first vertex.
    #[must_use]
    pub fn reversed(&self) -> Self {
        let segments: Vec<_> = self.segments().rev().map(|one| one.reversed()).collect();
        let mut path = Self::from_segments(&segments, self.entity);
        if self.closed {
            path.vertices.pop();
            path.closed = true;
        }
        path
    }

    /// A closed path that starts at a fraction of one of its segments.
    #[must_use]
    pub fn rotated(&self, segment: usize, part: f64) -> Self {
        let mut path = self.clone();
        let mut first = segment;
        if part > 0.0 {
            let (before, after) = self.segment(segment).split(part);
            path.vertices[segment].bulge = before.bulge;
            first = segment + 1;
            path.vertices.insert(
                first,
                Vertex {
                    at: after.from,
                    bulge: after.bulge,
                },
            );
        }
        let count = path.vertices.len();
        path.vertices.rotate_left(first % count);
        path
    }

    /// Box around the path: low and high corner; `None` without vertices.
    #[must_use]
    pub fn bounds(&self) -> Option<[Point; 2]> {
        let first = self.start()?;
        let boxes = self.segments().map(|segment| segment.bounds());
        Some(boxes.fold([first, first], |[low, high], [l, h]| {
            [
                [low[0].min(l[0]), low[1].min(l[1])],
                [high[0].max(h[0]), high[1].max(h[1])],
            ]
        }))
    }

    /// Points along the path: its vertices, and points on its arcs no farther than `tolerance` (mm)
    /// from the chords between them. The first point of a closed path comes again at the end.
    #[must_use]
    pub fn points(&self, tolerance: f64) -> Vec<Point> {
        let mut points: Vec<Point> = self.start().into_iter().collect();
        for segment in self.segments() {
            if let Some(arc) = segment.arc() {
                let count = chords(&arc, tolerance);
                for k in 1..count {
                    points.push(arc.point(k as f64 / count as f64));
                }
            }
            points.push(segment.to);
        }
        points
    }
}

/// Number of chords that keep within `tolerance` (mm) of an arc.
#[must_use]
pub fn chords(arc: &Arc, tolerance: f64) -> usize {
    let ratio = (1.0 - tolerance / arc.radius).clamp(-1.0, 1.0);
    let step = (2.0 * ratio.acos()).max(1e-4);
    ((arc.sweep.abs() / step).ceil() as usize).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    proptest! {
        #![proptest_config(ProptestConfig {
            rng_seed: RngSeed::Fixed(1),
            failure_persistence: None,
            ..ProptestConfig::default()
        })]

        /// The centre of a bulge turns the start onto the end by 4 atan B.
        #[test]
        fn the_sweep_about_the_centre_leads_to_the_end(
            s in prop::array::uniform2(-50.0..50.0), e in prop::array::uniform2(-50.0..50.0),
            b in prop_oneof![0.05..4.0, -4.0..-0.05],
        ) {
            prop_assume!(distance(s, e) > 0.01);
            let segment = Segment { from: s, to: e, bulge: b };
            let arc = segment.arc().unwrap();
            prop_assert!(distance(arc.point(1.0), e) < 1e-9);
            prop_assert!(distance(arc.point(0.0), s) < 1e-9);
            let (first, second) = segment.split(0.3);
            prop_assert!((first.length() + second.length() - segment.length()).abs() < 1e-9);
            let [low, high] = segment.bounds();
            for k in 0..=100 {
                let at = segment.point(f64::from(k) / 100.0);
                for axis in 0..2 {
                    prop_assert!(at[axis] > low[axis] - 1e-9 && at[axis] < high[axis] + 1e-9);
                }
            }
        }
    }

    #[test]
    fn the_polyline_arc_of_the_thesis_has_its_centre() {
        let arc = Segment {
            from: [40.0, 20.0],
            to: [35.0, 35.0],
            bulge: 1.0,
        }
        .arc()
        .unwrap();
        assert!(distance(arc.centre, [37.5, 27.5]) < 1e-12);
        assert!((arc.radius - 7.905_694_150).abs() < 1e-8);
    }

    #[test]
    fn a_closed_path_may_start_inside_an_arc() {
        let circle = Path::circle([1.0, 2.0], 3.0, 0);
        let turned = circle.rotated(1, 0.25);
        assert_eq!(turned.vertices.len(), 3);
        assert!((turned.length() - circle.length()).abs() < 1e-12);
        assert!(distance(turned.start().unwrap(), circle.segment(1).point(0.25)) < 1e-12);
        assert!((turned.reversed().length() - circle.length()).abs() < 1e-12);
    }
}
