//! Nearest points by a k-d tree.
//!
//! The tree halves the points whatever their places are: dense clusters, a single far point and
//! many equal points cost no more than scattered ones.

use crate::geometry::Point;

/// Points of a leaf.
const LEAF: usize = 6;

/// A split of the points of a node into two halves.
#[derive(Clone, Copy)]
struct Split {
    axis: usize,
    at: f64,
    /// Points of the node that are not removed.
    left: u32,
}

/// A k-d tree of points.
pub struct Neighbours {
    /// The points in the order of the leaves, with their indices.
    points: Vec<(Point, u32)>,
    /// Splits; the halves of node k are the nodes 2 k + 1 and 2 k + 2.
    splits: Vec<Split>,
    /// Low and high corner of the points of each split. Only searches in a quadrant read them.
    boxes: Vec<[Point; 2]>,
    /// Place of each point in `points`.
    places: Vec<u32>,
}

/// A quadrant about a point: whether it is on the side of larger x, and of larger y. The axes
/// belong to the sides of smaller values.
pub type Quadrant = [bool; 2];

/// Whether a point is in a quadrant about another.
pub fn is_in(quadrant: Quadrant, about: Point, at: Point) -> bool {
    (0..2).all(|axis| (at[axis] > about[axis]) == quadrant[axis])
}

/// A query and what it found so far.
struct Query<'q> {
    at: Point,
    count: usize,
    /// Only points in this quadrant about `at`.
    quadrant: Option<Quadrant>,
    allowed: &'q dyn Fn(usize) -> bool,
    /// Squares of distances, nearest first.
    out: &'q mut Vec<(f64, u32)>,
}

impl Neighbours {
    /// Sorts points.
    pub fn new(points: &[Point]) -> Self {
        let indexed = points.iter().copied().zip(0..).collect();
        let mut tree = Self {
            points: indexed,
            splits: Vec::new(),
            boxes: Vec::new(),
            places: vec![0; points.len()],
        };
        tree.split(0, 0, points.len());
        for (place, &(_, index)) in tree.points.iter().enumerate() {
            tree.places[index as usize] = place as u32;
        }
        tree
    }

    fn split(&mut self, node: usize, from: usize, to: usize) {
        if to - from <= LEAF {
            return;
        }
        let part = &mut self.points[from..to];
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        for (at, _) in &*part {
            for axis in 0..2 {
                low[axis] = low[axis].min(at[axis]);
                high[axis] = high[axis].max(at[axis]);
            }
        }
        let axis = usize::from(high[1] - low[1] > high[0] - low[0]);
        let half = part.len() / 2;
        let (_, middle, _) = part.select_nth_unstable_by(half, |a, b| {
            a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1))
        });
        let at = middle.0[axis];
        let left = (to - from) as u32;
        let split = Split { axis, at, left };
        if self.splits.len() <= node {
            self.splits.resize(node + 1, split);
            self.boxes.resize(node + 1, [low, high]);
        }
        self.splits[node] = split;
        self.boxes[node] = [low, high];
        self.split(2 * node + 1, from, from + half);
        self.split(2 * node + 2, from + half, to);
    }

    /// The points with their indices, near ones behind each other.
    pub fn points(&self) -> &[(Point, u32)] {
        &self.points
    }

    /// Takes a point out of the search, once; the caller's `allowed` must refuse it from then on.
    pub fn remove(&mut self, index: usize) {
        let place = self.places[index] as usize;
        let (mut node, mut from, mut to) = (0, 0, self.points.len());
        while to - from > LEAF {
            self.splits[node].left -= 1;
            let half = from + (to - from) / 2;
            if place < half {
                (node, to) = (2 * node + 1, half);
            } else {
                (node, from) = (2 * node + 2, half);
            }
        }
    }

    /// Replaces `out` by the `count` points nearest to `at` that `allowed` accepts, nearest first,
    /// with their distances; fewer if there are not that many.
    pub fn nearest(
        &self,
        at: Point,
        count: usize,
        allowed: &dyn Fn(usize) -> bool,
        out: &mut Vec<(f64, u32)>,
    ) {
        self.nearest_in(None, at, count, allowed, out);
    }

    /// The same among the points in a quadrant about `at`, if there is one. `allowed` alone would
    /// do, but the search would then visit all points where the quadrant is empty.
    pub fn nearest_in(
        &self,
        quadrant: Option<Quadrant>,
        at: Point,
        count: usize,
        allowed: &dyn Fn(usize) -> bool,
        out: &mut Vec<(f64, u32)>,
    ) {
        out.clear();
        let mut query = Query {
            at,
            count,
            quadrant,
            allowed,
            out,
        };
        self.visit(&mut query, 0, 0, self.points.len(), [0.0; 2]);
        for (square, _) in out {
            *square = square.sqrt();
        }
    }

    /// Visits a node; `off` is the distance of its half-planes from the point of the query.
    fn visit(&self, query: &mut Query, node: usize, from: usize, to: usize, off: Point) {
        if to - from <= LEAF {
            for &(at, index) in &self.points[from..to] {
                query.offer(at, index);
            }
            return;
        }
        let Split { axis, at, left } = self.splits[node];
        if left == 0 || query.excludes(&self.boxes[node]) {
            return;
        }
        let half = from + (to - from) / 2;
        let beyond = query.at[axis] - at;
        let (near, far) = ((2 * node + 1, from, half), (2 * node + 2, half, to));
        let (near, far) = if beyond < 0.0 {
            (near, far)
        } else {
            (far, near)
        };
        self.visit(query, near.0, near.1, near.2, off);
        let mut away = off;
        away[axis] = beyond;
        if query.reaches(away[0] * away[0] + away[1] * away[1]) {
            self.visit(query, far.0, far.1, far.2, away);
        }
    }
}

impl Query<'_> {
    /// Whether a box has no part in the quadrant.
    fn excludes(&self, [low, high]: &[Point; 2]) -> bool {
        self.quadrant.is_some_and(|quadrant| {
            (0..2).any(|axis| {
                if quadrant[axis] {
                    high[axis] <= self.at[axis]
                } else {
                    low[axis] > self.at[axis]
                }
            })
        })
    }

    /// Whether a point at this square of a distance can be among the nearest.
    fn reaches(&self, square: f64) -> bool {
        self.out.len() < self.count || self.out.last().is_some_and(|last| square < last.0)
    }

    fn offer(&mut self, at: Point, index: u32) {
        let (x, y) = (at[0] - self.at[0], at[1] - self.at[1]);
        let square = x * x + y * y;
        let is_there = |quadrant| is_in(quadrant, self.at, at);
        if self.reaches(square)
            && (self.allowed)(index as usize)
            && self.quadrant.is_none_or(is_there)
        {
            let place = self.out.partition_point(|&(other, _)| other <= square);
            self.out.insert(place, (square, index));
            self.out.truncate(self.count);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::distance;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    proptest! {
        #![proptest_config(ProptestConfig {
            rng_seed: RngSeed::Fixed(1),
            failure_persistence: None,
            ..ProptestConfig::default()
        })]

        /// Coordinates on a coarse grid have equal points and equal distances among them.
        #[test]
        fn the_tree_finds_what_a_full_search_finds(
            points in prop::collection::vec(prop::array::uniform2(-50.0..50.0), 1..120),
            at in prop::array::uniform2(-80.0..80.0), count in 1_usize..9, coarse in any::<bool>(),
        ) {
            let points: Vec<Point> = points.into_iter()
                .map(|at| if coarse { at.map(|value: f64| (value / 20.0).round()) } else { at })
                .collect();
            let mut tree = Neighbours::new(&points);
            for index in (1..points.len()).step_by(3) {
                tree.remove(index);
            }
            let mut found = Vec::new();
            tree.nearest(at, count, &|index| index % 3 != 1, &mut found);
            let mut all: Vec<f64> = points.iter().enumerate().filter(|(i, _)| i % 3 != 1)
                .map(|(_, &point)| distance(point, at)).collect();
            all.sort_by(f64::total_cmp);
            all.truncate(count);
            prop_assert_eq!(found.len(), all.len());
            for (one, all) in found.iter().zip(&all) {
                prop_assert!((one.0 - all).abs() < 1e-12);
                prop_assert!((distance(points[one.1 as usize], at) - all).abs() < 1e-12);
            }
            for quadrant in [[false, false], [false, true], [true, false], [true, true]] {
                let allowed = |index: usize| index % 3 != 1;
                let is_there = |index: usize| is_in(quadrant, at, points[index]);
                tree.nearest_in(Some(quadrant), at, count, &allowed, &mut found);
                let mut all = Vec::new();
                tree.nearest(at, count, &|index| allowed(index) && is_there(index), &mut all);
                let offs = |all: &[(f64, u32)]| all.iter().map(|one| one.0).collect::<Vec<_>>();
                prop_assert_eq!(offs(&found), offs(&all));
                prop_assert!(found.iter().all(|one| is_there(one.1 as usize)));
            }
        }
    }

    /// A search in quadrants that are empty does not visit all points: 40,000 points in one place
    /// and on a line, each with four searches.
    #[test]
    fn empty_quadrants_are_searched_soon() {
        for step in [0.0, 0.001] {
            let points: Vec<Point> = (0..40_000).map(|k| [5.0, f64::from(k) * step]).collect();
            let tree = Neighbours::new(&points);
            let mut found = Vec::new();
            let visits = std::cell::Cell::new(0_usize);
            for &at in &points {
                for quadrant in [[false, false], [false, true], [true, false], [true, true]] {
                    let allowed = |_| {
                        visits.set(visits.get() + 1);
                        true
                    };
                    tree.nearest_in(Some(quadrant), at, 2, &allowed, &mut found);
                    assert!(!quadrant[0] || found.is_empty());
                }
            }
            assert!(visits.get() < 50 * points.len(), "{}", visits.get());
        }
    }
}
