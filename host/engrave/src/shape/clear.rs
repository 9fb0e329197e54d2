//! Paths of the tool that clear a region.

use super::Region;
use crate::geometry::{Path, Point, Segment, Vertex, distance};
use crate::order::rows::{Line, zigzag};
use crate::order::{Effort, order_paths};
use serde::Serialize;

/// How a region is cleared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Clearing {
    /// Contours at equal distances from the boundary.
    Contour,
    /// Rows in alternating directions, linked at their ends, and the contour.
    Zigzag,
    /// Rows in one direction, and the contour. The floor is smoother than after a zig-zag, because
    /// the tool always cuts on the same side.
    OneWay,
}

/// A cut without a lift.
#[derive(Debug, Clone, PartialEq)]
pub struct Strand {
    /// Segments that join.
    pub segments: Vec<Segment>,
    /// Whether it ends where it begins.
    pub closed: bool,
    /// Entity of the drawing that its contour is from.
    pub entity: usize,
    /// Number of gaps that it cuts through instead of lifting.
    pub links: usize,
}

impl Strand {
    /// A strand along a path.
    #[must_use]
    pub fn of(path: &Path) -> Self {
        Self {
            segments: path.segments().collect(),
            closed: path.closed,
            entity: path.entity,
            links: 0,
        }
    }

    /// First point.
    #[must_use]
    pub fn start(&self) -> Point {
        self.segments.first().map_or([0.0; 2], |one| one.from)
    }

    /// Last point.
    #[must_use]
    pub fn end(&self) -> Point {
        self.segments.last().map_or([0.0; 2], |one| one.to)
    }
}

/// What decides about the clearing.
#[derive(Debug, Clone, Copy)]
pub struct ClearOptions {
    /// How.
    pub clearing: Clearing,
    /// Diameter of the tool, mm. Gaps shorter than it are cut through.
    pub tool_mm: f64,
    /// Material left at the walls, mm.
    pub allowance_mm: f64,
    /// Distance of rows or contours, mm.
    pub spacing_mm: f64,
    /// Angle of the rows, degrees.
    pub angle_deg: f64,
    /// Whether contours run with the material that stays on the left of the tool: conventional
    /// milling.
    pub conventional: bool,
}

/// Rings before it from which a ring is tried, if the one around it does not give it.
const TRIES: usize = 4;

/// Clearance by which a link may leave the region of the tool's centre, mm.
const LINK_MARGIN: f64 = 0.002;

/// Paths of the tool's centre that clear a region, in their order from `reference`. Adds the
/// entities whose contours may be wrong to `doubtful`.
#[must_use]
pub fn clear(
    region: &Region,
    options: &ClearOptions,
    reference: Point,
    doubtful: &mut Vec<usize>,
) -> Vec<Strand> {
    let radius = options.tool_mm / 2.0 + options.allowance_mm;
    let inside = region.inset(radius);
    let guard = region.inset(radius - LINK_MARGIN);
    doubtful.extend([&inside, &guard].into_iter().flat_map(Region::doubtful));
    let allowed = |a: Point, b: Point| !guard.is_left_between(a, b);
    let contours = |region: &Region| -> Vec<Path> {
        let loops = region.loops().into_iter();
        if options.conventional {
            loops.map(|one| one.reversed()).collect()
        } else {
            loops.collect()
        }
    };
    match options.clearing {
        Clearing::Contour => {
            // Rings a radius apart would leave the point in the middle of the last one.
            let spacing = options.spacing_mm.min(0.495 * options.tool_mm);
            let mut levels = Vec::new();
            let mut rings: Vec<Region> = Vec::new();
            let mut ring = inside;
            while !ring.is_empty() {
                levels.push(contours(&ring));
                // An inset of an inset is that of the sum. From the first contour the time of each
                // ring would grow with its distance, because the offsets of more and more segments
                // cross each other.
                rings.push(ring);
                let from = |back: usize| {
                    let distance = spacing * back as f64;
                    let outer = rings.get(rings.len().checked_sub(back)?)?;
                    let next = outer.inset(distance);
                    next.doubtful().is_empty().then_some(next)
                };
                let next = (1..=rings.len().min(TRIES)).find_map(from);
                ring = next.unwrap_or_else(|| region.inset(radius + spacing * rings.len() as f64));
                doubtful.extend(ring.doubtful());
            }
            let strands = spirals(levels, options.tool_mm, &allowed);
            in_short_order(strands, reference)
        }
        Clearing::Zigzag | Clearing::OneWay => {
            let turn = kurbo::Affine::rotate(-options.angle_deg.to_radians());
            let contours = contours(&inside);
            let turned = if options.angle_deg == 0.0 {
                None
            } else {
                Some(region.turned(turn).inset(radius))
            };
            doubtful.extend(turned.iter().flat_map(Region::doubtful));
            let rows = turned.as_ref().unwrap_or(&inside).rows(options.spacing_mm);
            let start = crate::curves::map_point(turn, reference);
            let rows = arrange(&rows, options.clearing, start);
            let back = turn.inverse();
            let place = |at: Point| {
                if options.angle_deg == 0.0 {
                    at
                } else {
                    crate::curves::map_point(back, at)
                }
            };
            let entity = contours.first().map_or(0, |one| one.entity);
            let strands: Vec<Strand> = rows
                .into_iter()
                .map(|[from, to]| Strand {
                    segments: vec![Segment {
                        from: place(from),
                        to: place(to),
                        bulge: 0.0,
                    }],
                    closed: false,
                    entity,
                    links: 0,
                })
                .collect();
            let last = strands.last().map_or(reference, Strand::end);
            let mut all = strands;
            all.extend(contours_from(contours, last));
            match options.clearing {
                Clearing::OneWay => all,
                _ => {
                    let (sin, cos) = options.angle_deg.to_radians().sin_cos();
                    link(all, options.tool_mm, [cos, sin], &allowed)
                }
            }
        }
    }
}

/// Rings from the innermost outwards, each joined to the ring around it at the nearest point. Where
/// several rings are inside of one, the first of them goes on.
fn spirals(
    levels: Vec<Vec<Path>>,
    limit: f64,
    allowed: &dyn Fn(Point, Point) -> bool,
) -> Vec<Strand> {
    let mut done = Vec::new();
    let mut growing: Vec<Strand> = Vec::new();
    for rings in levels.into_iter().rev() {
        let mut next: Vec<Option<Strand>> = rings.iter().map(|_| None).collect();
        let boxes: Vec<_> = rings.iter().map(Path::bounds).collect();
        for mut strand in growing {
            let end = strand.end();
            // A ring whose box is beyond the limit is, too.
            let is_near = |index: &usize| {
                boxes[*index].is_some_and(|[low, high]| {
                    (0..2).all(|k| end[k] > low[k] - limit && end[k] < high[k] + limit)
                })
            };
            let near = (0..rings.len())
                .filter(is_near)
                .map(|index| (index, nearest_point(&rings[index], end)));
            let best = near.min_by(|a, b| a.1.0.total_cmp(&b.1.0));
            match best {
                Some((index, (off, segment, part))) if next[index].is_none() && off < limit => {
                    let ring = rings[index].rotated(segment, part);
                    let to = ring.start().unwrap_or(end);
                    if !allowed(end, to) {
                        done.push(strand);
                        continue;
                    }
                    strand.segments.push(Segment {
                        from: end,
                        to,
                        bulge: 0.0,
                    });
                    strand.segments.extend(ring.segments());
                    strand.links += 1;
                    strand.closed = false;
                    next[index] = Some(strand);
                }
                _ => done.push(strand),
            }
        }
        growing = rings
            .iter()
            .zip(next)
            .map(|(ring, strand)| strand.unwrap_or_else(|| Strand::of(ring)))
            .collect();
    }
    done.extend(growing);
    done
}

/// The point of a path nearest to a point: its distance, segment, and fraction of the segment.
fn nearest_point(path: &Path, at: Point) -> (f64, usize, f64) {
    let mut best = (f64::INFINITY, 0, 0.0);
    for (index, segment) in path.segments().enumerate() {
        let part = segment.nearest(at);
        let off = distance(segment.point(part), at);
        if off < best.0 {
            best = (off, index, part);
        }
    }
    // A start beside a vertex would make a segment without length.
    if best.2 > 1.0 - 1e-6 {
        best = (best.0, (best.1 + 1) % path.segment_count().max(1), 0.0);
    } else if best.2 < 1e-6 {
        best.2 = 0.0;
    }
    best
}

/// Orders strands by their first points; they keep their direction.
fn in_short_order(strands: Vec<Strand>, reference: Point) -> Vec<Strand> {
    let point = |strand: &Strand| Path {
        vertices: vec![Vertex {
            at: strand.start(),
            bulge: 0.0,
        }],
        closed: false,
        entity: strand.entity,
    };
    let points: Vec<Path> = strands.iter().map(point).collect();
    let order = order_paths(&points, reference, Effort::default()).order;
    let mut left: Vec<Option<Strand>> = strands.into_iter().map(Some).collect();
    order
        .iter()
        .filter_map(|placed| left[placed.path].take())
        .collect()
}

/// Order of the rows, part after part. In zig-zag the part with the lowest row nearest to the start
/// is first. One-way parts are in the order of their topmost rows, each from the top.
fn arrange(rows: &[(Line, usize)], clearing: Clearing, start: Point) -> Vec<Line> {
    let mut parts: Vec<(usize, Vec<Line>)> = Vec::new();
    for (line, part) in rows {
        match parts.iter_mut().find(|(index, _)| index == part) {
            Some((_, lines)) => lines.push(*line),
            None => parts.push((*part, vec![*line])),
        }
    }
    if clearing == Clearing::OneWay {
        return parts.into_iter().flat_map(|(_, lines)| lines).collect();
    }
    let lowest = |lines: &[Line]| {
        let first = zigzag(lines, start).first().copied();
        first.map_or(0.0, |line| distance(line[0], start))
    };
    let mut first: Vec<f64> = parts.iter().map(|(_, lines)| lowest(lines)).collect();
    // The nearest part first, the others in the order of their topmost rows.
    if let Some(nearest) = (0..parts.len()).min_by(|&a, &b| first[a].total_cmp(&first[b])) {
        let part = parts.remove(nearest);
        parts.insert(0, part);
        first.clear();
    }
    let mut at = start;
    let mut order = Vec::with_capacity(rows.len());
    for (_, lines) in &parts {
        order.extend(zigzag(lines, at));
        at = order.last().map_or(at, |line: &Line| line[1]);
    }
    order
}

/// Closed contours, each from its vertex nearest to the end of the one before.
fn contours_from(mut contours: Vec<Path>, mut at: Point) -> Vec<Strand> {
    let mut out = Vec::new();
    while !contours.is_empty() {
        let mut best = (f64::INFINITY, 0, 0);
        for (index, path) in contours.iter().enumerate() {
            for (vertex, one) in path.vertices.iter().enumerate() {
                let off = distance(one.at, at);
                if off < best.0 {
                    best = (off, index, vertex);
                }
            }
        }
        let path = contours.swap_remove(best.1).rotated(best.2, 0.0);
        at = path.start().unwrap_or(at);
        out.push(Strand::of(&path));
    }
    out
}

/// Cuts through gaps that are shorter than `limit` and stay inside: straight, or else along a row
/// and across to the next one. That leads around a round corner between their ends. `along` is the
/// direction of the rows.
fn link(
    strands: Vec<Strand>,
    limit: f64,
    along: Point,
    allowed: &dyn Fn(Point, Point) -> bool,
) -> Vec<Strand> {
    let way = |from: Point, to: Point| -> Option<Vec<Point>> {
        if distance(from, to) >= limit {
            return None;
        }
        if allowed(from, to) {
            return Some(vec![to]);
        }
        let gap = [to[0] - from[0], to[1] - from[1]];
        let part = gap[0] * along[0] + gap[1] * along[1];
        let [u, v] = [along[0] * part, along[1] * part];
        let corners = [[from[0] + u, from[1] + v], [to[0] - u, to[1] - v]];
        let fits = |corner: &Point| {
            distance(from, *corner) + distance(*corner, to) < limit
                && allowed(from, *corner)
                && allowed(*corner, to)
        };
        corners
            .into_iter()
            .find(fits)
            .map(|corner| vec![corner, to])
    };
    let mut out: Vec<Strand> = Vec::new();
    for strand in strands {
        let found = out.last().and_then(|last| way(last.end(), strand.start()));
        match (out.last_mut(), found) {
            (Some(last), Some(points)) => {
                let mut from = last.end();
                last.links += usize::from(from != strand.start());
                for to in points {
                    if from != to {
                        last.segments.push(Segment {
                            from,
                            to,
                            bulge: 0.0,
                        });
                    }
                    from = to;
                }
                last.segments.extend(strand.segments);
                last.links += strand.links;
                last.closed = false;
            }
            _ => out.push(strand),
        }
    }
    out
}
