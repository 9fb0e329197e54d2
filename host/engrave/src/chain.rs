//! Joins paths whose ends meet into chains.

use crate::geometry::{Path, Point, Vertex, distance};
use std::collections::HashMap;

/// Ends of open paths by the square of a grid that they are in.
struct Ends {
    cell: f64,
    /// The last of the file first, so that the earliest ones are at the end of a list.
    squares: HashMap<[i64; 2], Vec<(usize, bool)>>,
}

impl Ends {
    fn square(&self, at: Point) -> [i64; 2] {
        // The squares beside the farthest one have numbers, too.
        const FARTHEST: f64 = 1e18;
        at.map(|value| (value / self.cell).floor().clamp(-FARTHEST, FARTHEST) as i64)
    }

    /// The earliest path with a free end within the tolerance; `true` if that is its last point.
    fn meeting(
        &mut self,
        at: Point,
        tolerance: f64,
        paths: &[Option<Path>],
    ) -> Option<(usize, bool)> {
        let [column, row] = self.square(at);
        let mut best: Option<(usize, bool)> = None;
        for x in column - 1..=column + 1 {
            for y in row - 1..=row + 1 {
                let Some(ends) = self.squares.get_mut(&[x, y]) else {
                    continue;
                };
                let mut taken = 0;
                let mut scanned = 0;
                for &(index, last) in ends.iter().rev() {
                    scanned += 1;
                    let Some(path) = &paths[index] else {
                        taken += 1;
                        continue;
                    };
                    let end = if last { path.end() } else { path.start() };
                    if end.is_some_and(|end| distance(end, at) <= tolerance) {
                        // The ends of a square are visited in the order of the paths, the start of
                        // a path before its end: directions are kept if possible.
                        if best.is_none_or(|best| (index, last) < best) {
                            best = Some((index, last));
                        }
                        break;
                    }
                }
                // Ends of many paths may be in one square: those of joined paths go. Only the
                // visited ones are moved, so that this costs no more than the visit.
                if 2 * taken > scanned {
                    let visited = ends.split_off(ends.len() - scanned);
                    let left = visited.into_iter();
                    ends.extend(left.filter(|&(index, _)| paths[index].is_some()));
                }
            }
        }
        best
    }
}

/// Joins paths whose ends meet within `tolerance`, mm. The order of the results is that of the
/// first path of each.
#[must_use]
pub fn chain(paths: Vec<Path>, tolerance: f64) -> Vec<Path> {
    let mut ends = Ends {
        cell: tolerance.max(1e-9) * 2.0,
        squares: HashMap::new(),
    };
    for (index, path) in paths.iter().enumerate().rev() {
        if path.closed {
            continue;
        }
        for (at, last) in [(path.end(), true), (path.start(), false)] {
            if let Some(at) = at {
                let square = ends.square(at);
                ends.squares.entry(square).or_default().push((index, last));
            }
        }
    }
    let mut left: Vec<Option<Path>> = paths.into_iter().map(Some).collect();
    let mut chains = Vec::new();
    for index in 0..left.len() {
        let Some(mut chain) = left[index].take() else {
            continue;
        };
        if !chain.closed {
            grow(&mut chain, &mut ends, tolerance, &mut left);
            // The other way from its start.
            if !close(&mut chain, tolerance) {
                let mut back = chain.reversed();
                if grow(&mut back, &mut ends, tolerance, &mut left) {
                    close(&mut back, tolerance);
                    chain = back.reversed();
                }
            }
        }
        chains.push(chain);
    }
    chains
}

/// Appends paths at the end as long as one meets it. Returns whether there was one.
fn grow(chain: &mut Path, ends: &mut Ends, tolerance: f64, left: &mut [Option<Path>]) -> bool {
    let mut grown = false;
    while let Some(at) = chain.end() {
        // A closed chain is complete, even where further paths begin at its start.
        if chain.segment_count() > 1
            && chain
                .start()
                .is_some_and(|start| distance(start, at) <= tolerance)
        {
            break;
        }
        let Some((index, last)) = ends.meeting(at, tolerance, left) else {
            break;
        };
        let Some(next) = left[index].take() else {
            break;
        };
        let next = if last { next.reversed() } else { next };
        append(chain, &next);
        grown = true;
    }
    grown
}

fn append(chain: &mut Path, next: &Path) {
    if let (Some(joint), Some(first)) = (chain.vertices.last_mut(), next.vertices.first()) {
        joint.bulge = first.bulge;
        chain.vertices.extend_from_slice(&next.vertices[1..]);
    }
}

/// Closes a chain whose ends meet.
fn close(chain: &mut Path, tolerance: f64) -> bool {
    let (Some(start), Some(end)) = (chain.start(), chain.end()) else {
        return false;
    };
    let meets = chain.segment_count() > 1 && distance(start, end) <= tolerance;
    // Two segments on the same line enclose nothing.
    let encloses = chain.segment_count() > 2
        || chain
            .vertices
            .iter()
            .any(|vertex: &Vertex| vertex.bulge != 0.0);
    if meets && encloses {
        chain.vertices.pop();
        chain.closed = true;
    }
    meets && encloses
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Segment;

    fn line(from: Point, to: Point, entity: usize) -> Path {
        Path::from_segments(
            &[Segment {
                from,
                to,
                bulge: 0.0,
            }],
            entity,
        )
    }

    #[test]
    fn lines_in_any_direction_become_a_closed_chain() {
        let paths = vec![
            line([0.0, 0.0], [1.0, 0.0], 0),
            line([0.0, 0.0], [0.0, 1.0], 1),
            line([5.0, 5.0], [6.0, 5.0], 2),
            line([1.0, 1.0], [0.0, 1.0], 3),
            line([1.0, 1.0], [1.0, 0.0], 4),
        ];
        let chains = chain(paths, 0.001);
        assert_eq!(chains.len(), 2);
        assert!(chains[0].closed && !chains[1].closed);
        assert_eq!(chains[0].vertices.len(), 4);
        assert!((chains[0].length() - 4.0).abs() < 1e-12);
    }

    #[test]
    fn a_chain_grows_at_both_ends() {
        let paths = vec![
            line([1.0, 0.0], [2.0, 0.0], 0),
            line([2.0, 0.0], [3.0, 0.0], 1),
            line([1.0, 0.0], [0.0, 0.0], 2),
        ];
        let chains = chain(paths, 0.001);
        assert_eq!(chains.len(), 1);
        assert_eq!(chains[0].start(), Some([0.0, 0.0]));
        assert_eq!(chains[0].end(), Some([3.0, 0.0]));
    }
}
