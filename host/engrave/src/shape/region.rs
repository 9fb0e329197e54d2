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

/// Largest error of an offset that passes its check, mm.
const EXACT: f64 = 1e-3;

/// Whether a region can be the inset of another by a distance.
type Check<'c> = &'c dyn Fn(&Region, &Region, f64) -> bool;

/// Material between outer boundaries and islands. Boundaries run counter-clockwise, islands
/// clockwise, so the material is on the left.
pub struct Region {
    shape: Shape<f64>,
    /// Entities at which it may be wrong, because every way to compute it failed its check.
    doubtful: Vec<usize>,
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

/// Points along a path, at most `step` apart, mm.
fn along(path: &Path, step: f64) -> impl Iterator<Item = Point> {
    path.segments().flat_map(move |segment| {
        let count = (segment.length() / step).ceil().clamp(1.0, 4096.0);
        (0..count as usize).map(move |k| segment.point(k as f64 / count))
    })
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
        super::meeting::find(drawing, &loops, &mut problems);
        if !problems.is_empty() {
            // They are often the cause of the others.
            let mut all = super::duplicates::find(drawing, SAME);
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
        Self::from_loops(loops)
    }

    fn from_loops(loops: impl IntoIterator<Item = Polyline<f64>>) -> Self {
        Self {
            shape: Shape::from_plines(loops),
            doubtful: Vec::new(),
        }
    }

    /// Entities at which the region may be wrong, see [`Self::inset`].
    #[must_use]
    pub fn doubtful(&self) -> &[usize] {
        &self.doubtful
    }

    /// The region made smaller by a distance all around, mm; larger if it is negative. Outside
    /// corners of a larger region are round. Islands and gaps that vanish are left out. Where every
    /// way to compute it fails its check, it is [`Self::doubtful`].
    #[must_use]
    pub fn inset(&self, distance: f64) -> Self {
        if distance == 0.0 {
            return Self::from_loops(self.polylines().cloned());
        }
        self.inset_checked(distance, &Self::is_inset_of)
    }

    /// The inset by the first way whose result passes a check.
    fn inset_checked(&self, distance: f64, check: Check) -> Self {
        let first = self.inset_with(distance, MEETS[0]);
        if check(&first, self, distance) {
            return first;
        }
        if let Some(other) = self.inset_again(distance, check) {
            return other;
        }
        // The parts of a region become smaller apart from each other.
        let parts = self.parts();
        if distance > 0.0 && parts.len() > 1 {
            let parts = parts.iter().map(|part| part.inset_checked(distance, check));
            let parts: Vec<Self> = parts.collect();
            let all = Self::from_loops(parts.iter().flat_map(Self::polylines).cloned());
            let doubtful = parts.into_iter().flat_map(|part| part.doubtful).collect();
            return Self { doubtful, ..all };
        }
        let doubtful = self.suspects(&first, distance);
        Self { doubtful, ..first }
    }

    /// Each boundary with the islands in it.
    fn parts(&self) -> Vec<Self> {
        let of_boundary = |one: &IndexedPolyline<f64>| vec![one.polyline.clone()];
        let mut parts: Vec<_> = self.shape.ccw_plines.iter().map(of_boundary).collect();
        for island in &self.shape.cw_plines {
            let at = island.polyline.at(0);
            if let Some(part) = self.part_of([at.x, at.y]) {
                parts[part].push(island.polyline.clone());
            }
        }
        parts.into_iter().map(Self::from_loops).collect()
    }

    /// Entities whose loops in a wrong inset are not beside this region, or else the one of the
    /// contour with the most segments, as which the library's mistakes are known.
    fn suspects(&self, wrong: &Self, distance: f64) -> Vec<usize> {
        let loops = wrong.loops().into_iter();
        let far =
            loops.filter(|path| !self.is_beside(path, distance.abs() + EXACT, distance.abs()));
        let mut suspects: Vec<usize> = far.map(|path| path.entity).collect();
        if suspects.is_empty() {
            let largest = self.polylines().max_by_key(|one| one.vertex_count());
            suspects.extend(largest.map(|one| path_of(one).entity));
        }
        suspects.sort_unstable();
        suspects.dedup();
        suspects
    }

    /// The inset in another way than [`Self::inset`] tries first, if its result passes the check:
    /// with other limits, or in steps, which become longer as the outline becomes smoother.
    fn inset_again(&self, distance: f64, check: Check) -> Option<Self> {
        /// Part of a step that failed that is tried next.
        const SHORTER: f64 = 0.37;
        /// Shortest step, as a part of the distance.
        const SHORTEST: f64 = 0.005;
        const TRIES: usize = 40;
        let right = |from: &Self, distance: f64| {
            let all = MEETS.into_iter();
            let mut all = all.map(|meets| from.inset_with(distance, meets));
            all.find(|one| check(one, from, distance))
        };
        let (mut last, mut left, mut step): (Option<Self>, f64, f64) = (None, 1.0, 1.0);
        for _ in 0..TRIES {
            let part = step.min(left);
            if let Some(next) = right(last.as_ref().unwrap_or(self), part * distance) {
                last = Some(next);
                left -= part;
                step = 2.0 * part;
            } else {
                step = SHORTER * part;
            }
            if left <= 0.0 || step < SHORTEST {
                break;
            }
        }
        last.filter(|last| left <= 0.0 && check(last, self, distance))
    }

    /// The inset with crossings that are one if they are nearer than `meets`, mm.
    fn inset_with(&self, distance: f64, meets: f64) -> Self {
        let options = ShapeOffsetOptions {
            pos_equal_eps: meets,
            ..ShapeOffsetOptions::default()
        };
        Self {
            shape: self.shape.parallel_offset(distance, &options),
            doubtful: Vec::new(),
        }
        .without_slivers(distance)
    }

    /// The result of an offset without the thin loops that the library leaves beside the right
    /// ones.
    fn without_slivers(self, distance: f64) -> Self {
        let width = |one: &Polyline<f64>| one.area().abs() / one.path_length();
        let is_thin = |one: &Polyline<f64>| width(one) < EXACT;
        // Islands grow to at least twice the distance, as boundaries do where the region grows.
        let is_grown = |one: &Polyline<f64>| {
            (one.orientation() == PlineOrientation::Clockwise) == (distance > 0.0)
        };
        let is_wrong = |one: &Polyline<f64>| is_grown(one) && width(one) < distance.abs() / 4.0;
        if !self.polylines().any(|one| is_thin(one) || is_wrong(one)) {
            return self;
        }
        let all = || self.polylines().filter(|one| !is_wrong(one));
        let thick = Self::from_loops(all().filter(|one| !is_thin(one)).cloned());
        // A thin loop beside no other is the way through a slot of the width of the tool.
        let is_way = |one: &Polyline<f64>| !thick.is_beside(&path_of(one), EXACT, EXACT);
        Self::from_loops(all().filter(|one| !is_thin(one) || is_way(one)).cloned())
    }

    /// Whether this can be the inset of `outer` by a distance, mm; a region around it if that is
    /// negative. The library loses parts of some contours of very many segments, or closes them by
    /// a wrong straight line.
    #[must_use]
    pub fn is_inset_of(&self, outer: &Self, distance: f64) -> bool {
        // The area changes with the length of the boundaries. They become shorter, except around
        // islands: by a full turn each. Where the region grows, the rest of the plane becomes
        // smaller, and the boundaries are around islands of that.
        let (lost, islands, found) = if distance > 0.0 {
            let lost = outer.area() - self.area();
            (lost, &outer.shape.cw_plines, &self.shape.cw_plines)
        } else {
            let lost = self.area() - outer.area();
            (lost, &outer.shape.ccw_plines, &self.shape.ccw_plines)
        };
        // Islands merge or vanish; none becomes two.
        if found.len() > islands.len() {
            return false;
        }
        let distance = distance.abs();
        let turns = std::f64::consts::PI * distance * distance * islands.len() as f64;
        let max = outer.length() * distance + turns;
        let min = self.length() * distance - turns;
        let slack = EXACT * (outer.length() + distance);
        if lost > max + slack || lost < min - slack {
            return false;
        }
        // No nearer: the tool would cut what stays.
        let is_right = |at| {
            let off = outer.distance_within(at, distance + EXACT);
            off.is_some_and(|off| off >= distance - EXACT)
        };
        let mut loops = self.polylines().map(path_of);
        loops.all(|path| along(&path, distance).all(is_right))
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
        Self::from_loops(self.loops().iter().map(image))
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
        let mut min = f64::INFINITY;
        self.visit_segments([low, high], &mut |segment| {
            let near = segment.point(segment.nearest(at));
            min = min.min(crate::geometry::distance(near, at));
        });
        (min <= limit).then_some(min)
    }

    /// Whether the boundaries are within a distance of all of a path, looked at every `step`, mm.
    #[must_use]
    pub fn is_beside(&self, path: &Path, limit: f64, step: f64) -> bool {
        along(path, step).all(|at| self.distance_within(at, limit).is_some())
    }

    /// The point of a loop of this region that a tool leaves farthest away, where its centre runs
    /// within `reached`, and how much material is between, mm. `None` where that is nowhere more
    /// than at a corner of about 60 degrees, half a diameter, unless the loop is known to be
    /// `split`.
    #[must_use]
    pub fn min_reached(
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

#[cfg(test)]
mod tests {
    use super::*;

    fn square(entity: usize, at: f64, side: f64) -> Polyline<f64> {
        let corners = [
            [at, at],
            [at + side, at],
            [at + side, at + side],
            [at, at + side],
        ];
        polyline(&Path::polygon(&corners, entity))
    }

    /// Where no way passes its check, the region says at which entities; other parts are right.
    #[test]
    fn an_inset_that_fails_every_check_is_doubtful() {
        let region = Region::from_loops([square(3, 0.0, 10.0), square(4, 20.0, 10.0)]);
        assert_eq!(region.inset(1.0).doubtful(), [] as [usize; 0]);
        let is_wrong = |one: &Region| one.loops().iter().any(|path| path.entity == 4);
        let check = |one: &Region, outer: &Region, distance: f64| {
            !is_wrong(one) && one.is_inset_of(outer, distance)
        };
        let inset = region.inset_checked(1.0, &check);
        assert_eq!(inset.doubtful(), [4]);
        assert_eq!(inset.loops().len(), 2);
        // A region that grows has no separate parts.
        let never = |_: &Region, _: &Region, _: f64| false;
        assert_eq!(region.inset_checked(-1.0, &never).doubtful().len(), 1);
    }

    /// The check finds a contour at a wrong distance, a lost one, and one on the wrong side.
    #[test]
    fn a_wrong_offset_fails_its_check() {
        let region = Region::from_loops([square(0, 0.0, 10.0), square(1, 20.0, 10.0)]);
        for distance in [1.0, -1.0] {
            let right = region.inset(distance);
            assert!(right.is_inset_of(&region, distance));
            assert!(!region.inset(0.9 * distance).is_inset_of(&region, distance));
            assert!(!region.inset(-distance).is_inset_of(&region, distance));
            let first = right.polylines().take(1).cloned();
            assert!(!Region::from_loops(first).is_inset_of(&region, distance));
        }
    }
}
