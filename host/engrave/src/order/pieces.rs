//! Pieces: paths to order, where they are placed, and the air between them.

use crate::geometry::{Path, Point, distance};

/// A path in the order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placed {
    /// Index of the path.
    pub path: usize,
    /// Whether an open path runs from its last point to its first.
    pub reversed: bool,
    /// Where a closed path starts: segment and fraction of it.
    pub start: (usize, f64),
}

/// Paths to order.
#[derive(Clone, Copy)]
pub struct Pieces<'p> {
    pub paths: &'p [Path],
    /// Whether the tool comes back to the end of an open path where it goes down: an even number of
    /// passes to and fro.
    pub returning: bool,
}

impl Pieces<'_> {
    /// Whether the tool comes up where it goes down, so that only the place is to be chosen.
    pub fn has_one_place(&self, path: usize) -> bool {
        self.returning || self.paths[path].closed
    }
}

/// Ends of a path as it is placed.
pub fn ends(pieces: Pieces<'_>, placed: &Placed) -> [Point; 2] {
    let path = &pieces.paths[placed.path];
    if path.closed {
        let at = match placed.start {
            (segment, 0.0) => path.vertices[segment].at,
            (segment, part) => path.segment(segment).point(part),
        };
        return [at, at];
    }
    let (Some(first), Some(last)) = (path.start(), path.end()) else {
        return [[0.0; 2]; 2];
    };
    match (pieces.returning, placed.reversed) {
        (false, false) => [first, last],
        (false, true) => [last, first],
        (true, false) => [first; 2],
        (true, true) => [last; 2],
    }
}

/// Air distance of an order from `reference` and back, mm.
pub fn air(pieces: Pieces<'_>, order: &[Placed], reference: Point) -> f64 {
    let (mut at, mut total) = (reference, 0.0);
    for placed in order {
        let [from, to] = ends(pieces, placed);
        total += distance(at, from);
        at = to;
    }
    total + distance(at, reference)
}
