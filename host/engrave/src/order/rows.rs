//! Order of hatch rows and contours of a pocket.
//!
//! Source: C. Mitravakin, *Tool path analysis for engraving machine*, KMITL, 2002, section 4.2.2.

use crate::geometry::{Point, distance};

/// A straight cut from its first to its second point.
pub type Line = [Point; 2];

/// Rows whose y agree within this count as one level, mm.
const LEVEL: f64 = 1e-6;

/// Largest gap that is no move, mm.
const SAME: f64 = 1e-6;

/// Lengths and counts of a job.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Totals {
    /// Length of the cuts with the links, mm.
    pub cut_mm: f64,
    /// Length of the moves with the tool lifted, from and to the reference included, mm.
    pub air_mm: f64,
    /// Number of times that the tool goes down.
    pub lifts: usize,
    /// Number of gaps that are cut through instead of lifted over.
    pub links: usize,
}

/// Order of the rows of one closed shape, in zig-zag.
///
/// The first row is the lowest; of several, that nearest to the reference. The next row is on the
/// next level with the end nearest to the last end, reversed if that is its second point. After the
/// topmost level the rows that are left follow downwards, then upwards again.
#[must_use]
pub fn zigzag(rows: &[Line], reference: Point) -> Vec<Line> {
    let mut levels: Vec<(f64, Vec<Line>)> = Vec::new();
    let mut sorted = rows.to_vec();
    sorted.sort_by(|a, b| a[0][1].total_cmp(&b[0][1]));
    for row in sorted {
        match levels.last_mut() {
            Some((y, level)) if row[0][1] - *y <= LEVEL => level.push(row),
            _ => levels.push((row[0][1], vec![row])),
        }
    }
    let mut order = Vec::with_capacity(rows.len());
    let (mut end, mut present, mut up) = (reference, None::<usize>, true);
    while order.len() < rows.len() {
        let open = |index: &usize| !levels[*index].1.is_empty();
        let next = match (present, up) {
            (None, _) => (0..levels.len()).find(open),
            (Some(at), true) => (at + 1..levels.len()).find(open),
            (Some(at), false) => (0..at).rev().find(open),
        };
        let Some(next) = next else {
            up = !up;
            // Rows may be left on the level of the turn itself.
            let other = match (present, up) {
                (Some(at), true) => (at + 1..levels.len()).find(open),
                (Some(at), false) => (0..at).rev().find(open),
                (None, _) => None,
            };
            if other.is_none()
                && let Some(at) = present
            {
                end = take_nearest(&mut levels[at].1, end, &mut order);
            }
            continue;
        };
        end = take_nearest(&mut levels[next].1, end, &mut order);
        present = Some(next);
    }
    order
}

/// Moves the row with the nearest end to the order, with that end first. Returns its other end.
fn take_nearest(level: &mut Vec<Line>, end: Point, order: &mut Vec<Line>) -> Point {
    let off = |row: &Line| distance(row[0], end).min(distance(row[1], end));
    let mut best = 0;
    for index in 1..level.len() {
        if off(&level[index]) < off(&level[best]) {
            best = index;
        }
    }
    let mut row = level.remove(best);
    if distance(row[1], end) < distance(row[0], end) {
        row.swap(0, 1);
    }
    order.push(row);
    row[1]
}

/// Order of closed contours: the edge whose start is nearest to the last point, then around its
/// loop, then the nearest of the loops that are left.
#[must_use]
pub fn contours(loops: &[Vec<Line>], mut last: Point) -> Vec<Line> {
    let mut left: Vec<&Vec<Line>> = loops.iter().filter(|one| !one.is_empty()).collect();
    let mut order = Vec::new();
    while !left.is_empty() {
        let mut best = (f64::INFINITY, 0, 0);
        for (index, edges) in left.iter().enumerate() {
            for (edge, line) in edges.iter().enumerate() {
                let off = distance(line[0], last);
                if off < best.0 {
                    best = (off, index, edge);
                }
            }
        }
        let edges = left.remove(best.1);
        order.extend(edges[best.2..].iter().chain(&edges[..best.2]));
        last = order.last().map_or(last, |line: &Line| line[1]);
    }
    order
}

/// Lengths and counts of a sequence of cuts from the reference and back to it. With a `limit` (mm)
/// a gap shorter than that is cut through if `allowed` says that the link stays in the pocket.
#[must_use]
pub fn totals(
    sequence: &[Line],
    reference: Point,
    limit: Option<f64>,
    allowed: &dyn Fn(Point, Point) -> bool,
) -> Totals {
    let mut totals = Totals::default();
    let mut at = reference;
    for (index, line) in sequence.iter().enumerate() {
        let gap = distance(at, line[0]);
        if index == 0 {
            totals.air_mm += gap;
            totals.lifts += 1;
        } else if gap > SAME {
            if limit.is_some_and(|limit| gap < limit) && allowed(at, line[0]) {
                totals.cut_mm += gap;
                totals.links += 1;
            } else {
                totals.air_mm += gap;
                totals.lifts += 1;
            }
        }
        totals.cut_mm += distance(line[0], line[1]);
        at = line[1];
    }
    totals.air_mm += distance(at, reference);
    totals
}
