//! A short order of paths: open paths in either direction, closed paths from any of their points.

use super::entry::settle_starts;
use super::exact;
use super::local::Search;
use super::nearness::Nearness;
use super::pieces::{Pieces, Placed, air, ends};
use super::random::Random;
use super::start::{greedy, length, nearest_first};
use crate::geometry::{Path, Point};
use serde::Serialize;

/// How much is computed for a shorter tour.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Effort {
    /// Kicks for each path.
    pub kicks_per_path: usize,
    /// Largest number of kicks.
    pub max_kicks: usize,
}

impl Default for Effort {
    fn default() -> Self {
        Self {
            kicks_per_path: 25,
            max_kicks: 30_000,
        }
    }
}

/// An order of paths.
#[derive(Debug, Clone, PartialEq)]
pub struct Tour {
    /// The paths in their order.
    pub order: Vec<Placed>,
    /// Air distance from the reference and back to it, mm.
    pub air_mm: f64,
    /// Whether no other order is shorter, by exhaustive search. With closed paths, which may start
    /// at any of their points, no order is proven.
    pub proven: bool,
}

impl Tour {
    /// The paths as they are cut.
    #[must_use]
    pub fn apply(&self, paths: &[Path]) -> Vec<Path> {
        self.order
            .iter()
            .map(|placed| {
                let path = &paths[placed.path];
                match (path.closed, placed.reversed) {
                    (true, _) => path.rotated(placed.start.0, placed.start.1),
                    (false, true) => path.reversed(),
                    (false, false) => path.clone(),
                }
            })
            .collect()
    }
}

/// Orders paths. Paths without a vertex are left out.
#[must_use]
pub fn order_paths(paths: &[Path], reference: Point, effort: Effort) -> Tour {
    order_passes(paths, 1, reference, effort)
}

/// Orders paths that are cut in a number of passes. An open path goes to and fro: after an even
/// number of passes the tool is where it began.
#[must_use]
pub fn order_passes(paths: &[Path], passes: usize, reference: Point, effort: Effort) -> Tour {
    let pieces = Pieces {
        paths,
        returning: passes.is_multiple_of(2),
    };
    let used: Vec<usize> = (0..paths.len())
        .filter(|&k| !paths[k].vertices.is_empty())
        .collect();
    let (mut order, proven) = match shortest(pieces, &used, reference) {
        Some(order) => {
            let open = |&path: &usize| !paths[path].closed;
            (order, used.iter().all(open))
        }
        None => (search(pieces, &used, reference, effort), false),
    };
    settle_starts(pieces, &mut order, reference);
    let air_mm = air(pieces, &order, reference);
    Tour {
        order,
        air_mm,
        proven,
    }
}

/// The shortest order of a few paths; closed ones start at their vertices.
fn shortest(pieces: Pieces<'_>, used: &[usize], reference: Point) -> Option<Vec<Placed>> {
    let paths = pieces.paths;
    if used.len() > exact::PIECES {
        return None;
    }
    let options = |&index: &usize| -> Vec<[Point; 2]> {
        let path = &paths[index];
        if path.closed {
            path.vertices.iter().map(|vertex| [vertex.at; 2]).collect()
        } else {
            let placed = |reversed| Placed {
                path: index,
                reversed,
                start: (0, 0.0),
            };
            vec![ends(pieces, &placed(false)), ends(pieces, &placed(true))]
        }
    };
    let choices: Vec<_> = used.iter().map(options).collect();
    let order = exact::shortest(&choices, reference)?;
    let placed = |(piece, option): (usize, usize)| {
        let path = used[piece];
        let closed = paths[path].closed;
        Placed {
            path,
            reversed: !closed && option == 1,
            start: if closed { (option, 0.0) } else { (0, 0.0) },
        }
    };
    Some(order.into_iter().map(placed).collect())
}

/// Neighbours in other clusters, too.
const ALL_AROUND: Nearness = Nearness {
    nearest: 6,
    per_quadrant: 2,
};

/// The nearest ends. In a larger drawing more of them take too much time.
const NEAREST: Nearness = Nearness {
    nearest: 8,
    per_quadrant: 0,
};

/// See [`NEAREST`].
const FEW: Nearness = Nearness {
    nearest: 6,
    per_quadrant: 0,
};

/// The shortest result of the local searches with different neighbours.
fn search(pieces: Pieces<'_>, used: &[usize], reference: Point, effort: Effort) -> Vec<Placed> {
    let trials: &[Nearness] = match used.len() {
        0..=1_000 => &[ALL_AROUND, NEAREST],
        1_001..=10_000 => &[ALL_AROUND],
        10_001..=20_000 => &[NEAREST],
        _ => &[FEW],
    };
    let orders = trials.iter().map(|nearness| {
        let order = search_among(*nearness, pieces, used, reference, effort);
        (air(pieces, &order, reference), order)
    });
    let shortest = orders.min_by(|a, b| a.0.total_cmp(&b.0));
    shortest.map_or_else(Vec::new, |(_, order)| order)
}

/// Local search from a greedy start; piece 0 is the reference.
fn search_among(
    nearness: Nearness,
    pieces: Pieces<'_>,
    used: &[usize],
    reference: Point,
    effort: Effort,
) -> Vec<Placed> {
    let mut order: Vec<Placed> = used
        .iter()
        .map(|&path| Placed {
            path,
            reversed: false,
            start: (0, 0.0),
        })
        .collect();
    let is_placed = used.iter().any(|&path| pieces.has_one_place(path));
    let rounds = if is_placed { 3 } else { 1 };
    let kicks = (effort.kicks_per_path * used.len()).min(effort.max_kicks) / rounds;
    let width = nearness.width();
    let mut random = Random(1);
    for round in 0..rounds {
        let mut points = points_of(pieces, &order, reference);
        let mut near = nearness.of(&points);
        if round == 0 {
            let one = greedy(&points, &near, width);
            let other = nearest_first(&points);
            let tour = if length(&points, &other) < length(&points, &one) {
                from_reference(other)
            } else {
                from_reference(one)
            };
            order = along(pieces, &order, &tour);
            points = points_of(pieces, &order, reference);
            near = renumbered(&near, width, &tour);
        }
        let mut search = Search::new(&points, near, width);
        search.improve();
        for _ in 0..kicks {
            search.kick(&mut random);
        }
        order = along(pieces, &order, &search.tour());
        settle_starts(pieces, &mut order, reference);
    }
    order
}

/// Ends of the reference and of the pieces.
fn points_of(pieces: Pieces<'_>, order: &[Placed], reference: Point) -> Vec<Point> {
    let mut points = vec![reference; 2];
    points.extend(order.iter().flat_map(|placed| ends(pieces, placed)));
    points
}

/// A tour that begins with the reference, piece 0.
fn from_reference(mut tour: Vec<(u32, bool)>) -> Vec<(u32, bool)> {
    let first = tour.iter().position(|&(piece, _)| piece == 0);
    tour.rotate_left(first.unwrap_or(0));
    tour
}

/// The paths in the order of a tour that begins with the reference.
fn along(pieces: Pieces<'_>, order: &[Placed], tour: &[(u32, bool)]) -> Vec<Placed> {
    let place = |&(piece, flipped): &(u32, bool)| {
        let placed = order[piece as usize - 1];
        Placed {
            reversed: placed.reversed != (flipped && !pieces.returning),
            ..placed
        }
    };
    tour[1..].iter().map(place).collect()
}

/// Neighbours of ends after the pieces are numbered along a tour: neighbours in the tour are close
/// in memory then.
fn renumbered(near: &[u32], width: usize, tour: &[(u32, bool)]) -> Vec<u32> {
    let mut to = vec![0; 2 * tour.len()];
    for (piece, &(old, flipped)) in (0..).zip(tour) {
        for end in 0..2_u32 {
            to[(2 * old + (end ^ u32::from(flipped))) as usize] = 2 * piece + end;
        }
    }
    let mut out = vec![u32::MAX; near.len()];
    for (old, row) in near.chunks_exact(width).enumerate() {
        let first = to[old] as usize * width;
        for (slot, &other) in out[first..first + width].iter_mut().zip(row) {
            if other != u32::MAX {
                *slot = to[other as usize];
            }
        }
    }
    out
}

#[cfg(test)]
mod tests;
