//! A region: what closed paths enclose, with the islands in them.

use super::crossing::{crosses, crossings_at};
use crate::drawing::{Drawing, Problem};
use crate::geometry::{Path, Point, Segment, Vertex};
use cavalier_contours::polyline::{
    PlineOrientation, PlineSource, PlineSourceMut, PlineVertex, Polyline,
};
use cavalier_contours::shape_algorithms::{IndexedPolyline, Shape, ShapeOffsetOptions};

/// Vertices nearer than this are one, mm.
const SAME: f64 = 1e-5;

/// Crossings of offsets nearer than this are one, mm: the values that are tried. With the first one
/// no short segment is lost; none of them is right for all contours of thousands of segments.
const MEETS: [f64; 6] = [1e-8, 1e-5, 1e-6, 1e-7, 1e-9, 1e-10];

/// Material between outer boundaries and islands. Boundaries run counter-clockwise, islands
/// clockwise, so the material is on the left.
pub struct Region {
    shape: Shape<f64>,
}

/// The library's polyline of a path. Its arcs reach half a turn, so longer ones are halved.
fn polyline(path: &Path) -> Polyline<f64> {
    let mut out = Polyline::new_closed();
    for segment in path.segments() {
        let halves = if segment.bulge.abs() > 1.0 {
            let (first, second) = segment.split(0.5);
            vec![first, second]
        } else {
            vec![segment]
        };
        for half in halves {
            out.add_vertex(PlineVertex::new(half.from[0], half.from[1], half.bulge));
        }
    }
    out.set_userdata_values([path.entity as u64]);
    out.remove_repeat_pos(SAME).unwrap_or(out)
}

fn path_of(polyline: &Polyline<f64>) -> Path {
    let vertices = polyline
        .iter_vertexes()
        .map(|v| Vertex {
            at: [v.x, v.y],
            bulge: v.bulge,
        })
        .collect();
    let entity = polyline.get_userdata_values().next().unwrap_or(0) as usize;
    Path {
        vertices,
        closed: true,
        entity,
    }
}

impl Region {
    /// The region of the closed paths of a drawing: a path inside of an odd number of others is an
    /// island.
    ///
    /// # Errors
    /// Open paths, paths that cross themselves, paths that cross or cover each other.
    pub fn of(drawing: &Drawing, paths: &[Path]) -> Result<Self, Vec<Problem>> {
        let mut problems = Vec::new();
        let mut loops = Vec::new();
        for path in paths {
            let entity = drawing.entity(path);
            if !path.closed {
                let ends = path.start().zip(path.end());
                let gap = ends.map_or(0.0, |(a, b)| crate::geometry::distance(a, b));
                problems.push(Problem::of(
                    entity,
                    format!("its contour is open, with {gap:.4} mm between its ends"),
                    "close it, or join ends that are farther apart with --join MM",
                ));
                continue;
            }
            let mut polyline = polyline(path);
            if polyline.vertex_count() < 2 {
                continue;
            }
            if polyline.scan_for_self_intersect() {
                problems.push(Problem::of(
                    entity,
                    "its contour crosses or touches itself",
                    "separate it into simple contours",
                ));
                continue;
            }
            if polyline.orientation() != PlineOrientation::CounterClockwise {
                polyline.invert_direction_mut();
            }
            loops.push(polyline);
        }
        find_crossings(drawing, &loops, &mut problems);
        if !problems.is_empty() {
            // They are often the cause of the others.
            let mut all = duplicates(drawing);
            all.append(&mut problems);
            return Err(all);
        }
        Ok(Self::nested(loops))
    }

    /// Turns the loops inside of an odd number of others around.
    fn nested(mut loops: Vec<Polyline<f64>>) -> Self {
        let bounds: Vec<_> = loops.iter().map(PlineSource::extents).collect();
        let inner: Vec<bool> = (0..loops.len())
            .map(|index| {
                let at = loops[index].at(0).pos();
                let around = (0..loops.len()).filter(|&other| {
                    let inside_box = bounds[other].is_some_and(|one| {
                        at.x > one.min_x && at.x < one.max_x && at.y > one.min_y && at.y < one.max_y
                    });
                    other != index && inside_box && loops[other].winding_number(at) != 0
                });
                around.count() % 2 == 1
            })
            .collect();
        for (one, inner) in loops.iter_mut().zip(inner) {
            if inner {
                one.invert_direction_mut();
            }
        }
        Self {
            shape: Shape::from_plines(loops),
        }
    }

    /// The region made smaller by a distance all around, mm; larger if it is negative. Outside
    /// corners of a larger region are round. Islands and gaps that vanish are left out.
    #[must_use]
    pub fn inset(&self, distance: f64) -> Self {
        if distance == 0.0 {
            return Self {
                shape: self.shape.clone(),
            };
        }
        let first = self.inset_with(distance, MEETS[0]);
        if distance < 0.0 || first.is_inset_of(self, distance) {
            return first;
        }
        self.inset_again(distance).unwrap_or(first)
    }

    /// The inset in another way than [`Self::inset`] tries first, if it can be the right one.
    fn inset_again(&self, distance: f64) -> Option<Self> {
        /// Parts of the distance that are the first of two steps.
        const PARTS: [f64; 6] = [0.37, 0.71, 0.11, 0.53, 0.89, 0.03];
        let right = |from: &Self, distance: f64| {
            let all = MEETS.into_iter();
            let mut all = all.map(|meets| from.inset_with(distance, meets));
            all.find(|one| one.is_inset_of(from, distance))
        };
        right(self, distance).or_else(|| {
            PARTS.into_iter().find_map(|part| {
                let first = right(self, part * distance)?;
                right(&first, (1.0 - part) * distance)
            })
        })
    }

    /// The inset with crossings that are one if they are nearer than `meets`, mm.
    fn inset_with(&self, distance: f64, meets: f64) -> Self {
        let options = ShapeOffsetOptions {
            pos_equal_eps: meets,
            ..ShapeOffsetOptions::default()
        };
        Self {
            shape: self.shape.parallel_offset(distance, &options),
        }
    }

    /// Whether this can be the inset of `outer` by a distance, mm. The library loses parts of some
    /// contours of very many segments, or closes them by a wrong straight line.
    #[must_use]
    pub fn is_inset_of(&self, outer: &Self, distance: f64) -> bool {
        const EXACT: f64 = 1e-3;
        // The area changes with the length of the boundaries. They become shorter, except around
        // islands: by a full turn each.
        let lost = outer.area() - self.area();
        let turns = std::f64::consts::PI * distance * distance * outer.shape.cw_plines.len() as f64;
        let most = outer.length() * distance + turns;
        let least = self.length() * distance - turns;
        let slack = EXACT * (outer.length() + distance);
        if lost > most + slack || lost < least - slack {
            return false;
        }
        let mut loops = self.polylines().map(path_of);
        loops.all(|path| outer.is_beside(&path, distance + EXACT, distance))
    }

    /// Length of all boundaries, mm.
    fn length(&self) -> f64 {
        self.polylines().map(PlineSource::path_length).sum()
    }

    /// Area, mm2.
    fn area(&self) -> f64 {
        self.polylines().map(PlineSource::area).sum()
    }

    /// The region under a map that keeps circles and is no mirror.
    #[must_use]
    pub fn turned(&self, map: kurbo::Affine) -> Self {
        let tolerance = crate::curves::TOLERANCE;
        let image = |path: &Path| polyline(&crate::curves::map_path(map, path, tolerance));
        Self {
            shape: Shape::from_plines(self.loops().iter().map(image)),
        }
    }

    /// Whether nothing is left.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.shape.ccw_plines.is_empty()
    }

    fn polylines(&self) -> impl Iterator<Item = &Polyline<f64>> {
        let all = self.shape.ccw_plines.iter().chain(&self.shape.cw_plines);
        all.map(|one| &one.polyline)
    }

    /// Boundaries, then islands. The material is on their left.
    #[must_use]
    pub fn loops(&self) -> Vec<Path> {
        self.polylines().map(path_of).collect()
    }

    /// Number of boundaries by the entity that they are from, islands not counted.
    #[must_use]
    pub fn boundaries(&self) -> std::collections::HashMap<usize, usize> {
        let mut counts = std::collections::HashMap::new();
        for one in &self.shape.ccw_plines {
            let entity = one.polyline.get_userdata_values().next().unwrap_or(0);
            *counts.entry(entity as usize).or_insert(0) += 1;
        }
        counts
    }

    /// Whether a point is inside.
    #[must_use]
    pub fn contains(&self, at: Point) -> bool {
        // Lines whose boxes are elsewhere do not wind around the point.
        let around = self.shape.plines_index.query(at[0], at[1], at[0], at[1]);
        let at = cavalier_contours::core::math::Vector2::new(at[0], at[1]);
        let turns = around
            .into_iter()
            .map(|which| self.line(which).polyline.winding_number(at));
        turns.sum::<i32>() != 0
    }

    /// A boundary or island by its number in the index.
    fn line(&self, which: usize) -> &IndexedPolyline<f64> {
        match which.checked_sub(self.shape.ccw_plines.len()) {
            None => &self.shape.ccw_plines[which],
            Some(island) => &self.shape.cw_plines[island],
        }
    }

    /// Index of the innermost boundary around a point.
    #[must_use]
    pub fn part_of(&self, at: Point) -> Option<usize> {
        let boundaries = &self.shape.ccw_plines;
        let mut parts = self.shape.plines_index.query(at[0], at[1], at[0], at[1]);
        parts.retain(|&index| index < boundaries.len());
        parts.sort_unstable();
        let at = cavalier_contours::core::math::Vector2::new(at[0], at[1]);
        let line = |index: usize| &boundaries[index].polyline;
        let around = parts
            .into_iter()
            .filter(|&index| line(index).winding_number(at) != 0);
        around.min_by(|&a, &b| line(a).area().total_cmp(&line(b).area()))
    }

    /// Whether the straight way between two points inside leaves the region.
    #[must_use]
    pub fn is_left_between(&self, a: Point, b: Point) -> bool {
        let low = [a[0].min(b[0]), a[1].min(b[1])];
        let high = [a[0].max(b[0]), a[1].max(b[1])];
        let mut crossed = false;
        self.visit_segments([low, high], &mut |segment| {
            crossed |= crosses(a, b, &segment);
        });
        crossed
    }

    /// Visits the segments of all loops whose boxes meet a box.
    fn visit_segments(&self, [low, high]: [Point; 2], visit: &mut dyn FnMut(Segment)) {
        let mut lines = |which: usize| {
            let one = self.line(which);
            let mut segments = |index: usize| {
                let line = &one.polyline;
                let (p, q) = (line.at(index), line.at(line.next_wrapping_index(index)));
                visit(Segment {
                    from: [p.x, p.y],
                    to: [q.x, q.y],
                    bulge: p.bulge,
                });
            };
            one.spatial_index
                .visit_query(low[0], low[1], high[0], high[1], &mut segments);
        };
        self.shape
            .plines_index
            .visit_query(low[0], low[1], high[0], high[1], &mut lines);
    }

    /// Distance of a point from the boundaries, if it is at most `limit`, mm.
    #[must_use]
    pub fn distance_within(&self, at: Point, limit: f64) -> Option<f64> {
        let (low, high) = (at.map(|one| one - limit), at.map(|one| one + limit));
        let mut least = f64::INFINITY;
        self.visit_segments([low, high], &mut |segment| {
            let near = segment.point(segment.nearest(at));
            least = least.min(crate::geometry::distance(near, at));
        });
        (least <= limit).then_some(least)
    }

    /// Whether the boundaries are within a distance of all of a path, looked at every `step`, mm.
    #[must_use]
    pub fn is_beside(&self, path: &Path, limit: f64, step: f64) -> bool {
        let mut points = path.segments().flat_map(|segment| {
            let count = (segment.length() / step).ceil().clamp(1.0, 4096.0);
            (0..count as usize).map(move |k| segment.point(k as f64 / count))
        });
        points.all(|at| self.distance_within(at, limit).is_some())
    }

    /// The point of a loop of this region that a tool leaves farthest away, where its centre runs
    /// within `reached`, and how much material is between, mm. `None` where that is nowhere more
    /// than at a corner of about 60 degrees, half a diameter, unless the loop is known to be
    /// `split`.
    #[must_use]
    pub fn least_reached(
        &self,
        path: &Path,
        reached: &Self,
        tool_mm: f64,
        split: bool,
    ) -> Option<(Point, f64)> {
        // Beyond this distance the tool counts as far away; the search goes no farther.
        const FAR: f64 = 16.0;
        let radius = tool_mm / 2.0;
        let mut worst = (path.start()?, 0.0);
        for segment in path.segments() {
            // At least two points in a neck of a quarter of the diameter.
            let count = (segment.length() / (radius / 4.0))
                .ceil()
                .clamp(1.0, 4096.0);
            for k in 0..count as usize {
                let at = segment.point(k as f64 / count);
                let off = reached
                    .distance_within(at, 2.1 * radius)
                    .or_else(|| reached.distance_within(at, FAR * radius))
                    .unwrap_or(FAR * radius);
                if off > worst.1 {
                    worst = (at, off);
                }
            }
        }
        let is_far = worst.1 > 2.1 * radius || split && worst.1 > 1.001 * radius;
        is_far.then_some((worst.0, worst.1 - radius))
    }

    /// Horizontal rows through the region at all multiples of `spacing` (mm), from the top, each
    /// from left to right, with the index of its part.
    #[must_use]
    pub fn rows(&self, spacing: f64) -> Vec<([Point; 2], usize)> {
        let loops = self.loops();
        let segments: Vec<Segment> = loops.iter().flat_map(Path::segments).collect();
        // Segments by the rows that they reach.
        let row = |y: f64| (y / spacing).floor() as i64;
        let boxes: Vec<[Point; 2]> = segments.iter().map(Segment::bounds).collect();
        let low = boxes.iter().map(|one| row(one[0][1])).min().unwrap_or(0);
        let high = boxes
            .iter()
            .map(|one| row(one[1][1]) + 1)
            .max()
            .unwrap_or(-1);
        let count = usize::try_from(high - low + 1).unwrap_or(0);
        let mut reached: Vec<Vec<usize>> = vec![Vec::new(); count];
        for (index, one) in boxes.iter().enumerate() {
            for k in row(one[0][1])..=row(one[1][1]) + 1 {
                reached[(k - low) as usize].push(index);
            }
        }
        let mut rows = Vec::new();
        let mut xs = Vec::new();
        for k in (low..=high).rev() {
            let y = k as f64 * spacing;
            xs.clear();
            for &index in &reached[(k - low) as usize] {
                crossings_at(&segments[index], y, &mut xs);
            }
            xs.sort_by(f64::total_cmp);
            for pair in xs.chunks_exact(2) {
                if pair[1] - pair[0] > SAME {
                    let middle = [f64::midpoint(pair[0], pair[1]), y];
                    let part = self.part_of(middle).unwrap_or(0);
                    rows.push(([[pair[0], y], [pair[1], y]], part));
                }
            }
        }
        rows
    }
}

/// Names the entities of which each line and arc is drawn before.
fn duplicates(drawing: &Drawing) -> Vec<Problem> {
    let key = |segment: &Segment| {
        let place = |at: Point| at.map(|value| (value / SAME).round() as i64);
        let (a, b) = (place(segment.from), place(segment.to));
        [a.min(b), a.max(b), place(segment.point(0.5))]
    };
    let mut first = std::collections::HashMap::new();
    let mut out = Vec::new();
    for path in &drawing.paths {
        let keys: Vec<_> = path.segments().map(|one| key(&one)).collect();
        let before = keys.iter().map(|one| first.get(one).copied());
        let before: Option<Vec<usize>> = before.collect();
        let entity = before.and_then(|all| all.first().copied());
        if let Some(entity) = entity.filter(|&entity| entity != path.entity) {
            out.push(Problem::of(
                drawing.entity(path),
                format!("it is a duplicate of {}", drawing.entities[entity]),
                "delete it in the drawing program",
            ));
        }
        for one in keys {
            first.entry(one).or_insert(path.entity);
        }
    }
    out
}

/// Finds loops that cross or cover each other.
fn find_crossings(drawing: &Drawing, loops: &[Polyline<f64>], problems: &mut Vec<Problem>) {
    let mut order: Vec<(usize, _)> = loops
        .iter()
        .enumerate()
        .filter_map(|(k, one)| Some((k, one.extents()?)))
        .collect();
    order.sort_by(|a, b| a.1.min_x.total_cmp(&b.1.min_x));
    for (place, (index, one)) in order.iter().enumerate() {
        for (other, two) in &order[place + 1..] {
            if two.min_x > one.max_x {
                break;
            }
            if two.min_y > one.max_y || two.max_y < one.min_y {
                continue;
            }
            let meets = loops[*index].find_intersects(&loops[*other]);
            let at = meets.basic_intersects.first().map(|one| one.point);
            let at = at.or_else(|| meets.overlapping_intersects.first().map(|one| one.point1));
            if let Some(at) = at {
                let entity = |index: usize| {
                    let entity = loops[index].get_userdata_values().next().unwrap_or(0);
                    &drawing.entities[entity as usize]
                };
                let what = format!(
                    "its contour meets that of {} at {:.3}, {:.3}",
                    entity(*other),
                    at.x,
                    at.y
                );
                problems.push(Problem::of(
                    entity(*index),
                    what,
                    "unite the contours in the drawing program, or choose layers with --layer",
                ));
            }
        }
    }
}
