//! Tours to start from: the shortest gaps first, as long as they form no cycle, or always the
//! nearest piece. The second is shorter on rows and grids, the first on most other drawings.

use super::neighbours::Neighbours;
use crate::geometry::Point;

/// Nearest ends that are tried for an end of a fragment.
const WIDTH: usize = 5;

/// Fragments of the tour.
struct Fragments {
    /// The end that each end is joined to.
    joined: Vec<Option<u32>>,
    /// Parent of each piece in its set.
    parent: Vec<u32>,
    count: usize,
}

impl Fragments {
    fn set(&mut self, mut piece: u32) -> u32 {
        while self.parent[piece as usize] != piece {
            let above = self.parent[self.parent[piece as usize] as usize];
            self.parent[piece as usize] = above;
            piece = above;
        }
        piece
    }

    /// Joins two ends if both are free and of different fragments.
    fn join(&mut self, a: u32, b: u32) {
        if self.joined[a as usize].is_some() || self.joined[b as usize].is_some() {
            return;
        }
        let (one, two) = (self.set(a / 2), self.set(b / 2));
        if one != two {
            self.joined[a as usize] = Some(b);
            self.joined[b as usize] = Some(a);
            self.parent[one as usize] = two;
            self.count -= 1;
        }
    }
}

/// A tour of pieces with the ends 2k and 2k + 1: pieces and whether each is flipped.
pub fn greedy(ends: &[Point], near: &[u32], width: usize) -> Vec<(u32, bool)> {
    let count = ends.len() / 2;
    let mut fragments = Fragments {
        joined: vec![None; ends.len()],
        parent: (0..count as u32).collect(),
        count,
    };
    let off = |a: u32, b: u32| crate::geometry::distance(ends[a as usize], ends[b as usize]);
    let mut gaps: Vec<(f64, u32, u32)> = Vec::new();
    for end in 0..ends.len() as u32 {
        let from = end as usize * width;
        for &other in near[from..from + width]
            .iter()
            .take_while(|&&other| other != u32::MAX)
        {
            if end < other || !near[other as usize * width..][..width].contains(&end) {
                gaps.push((off(end, other), end, other));
            }
        }
    }
    let mut all: Vec<u32> = (0..ends.len() as u32).collect();
    join_coincident(&mut fragments, ends, &mut all);
    join_shortest(&mut fragments, &mut gaps);
    while fragments.count > 1 {
        let mut free: Vec<u32> = (0..ends.len() as u32)
            .filter(|&end| fragments.joined[end as usize].is_none())
            .collect();
        join_coincident(&mut fragments, ends, &mut free);
        free.retain(|&end| fragments.joined[end as usize].is_none());
        let points: Vec<Point> = free.iter().map(|&end| ends[end as usize]).collect();
        let sets: Vec<u32> = free.iter().map(|&end| fragments.set(end / 2)).collect();
        let tree = Neighbours::new(&points);
        let mut found = Vec::new();
        gaps.clear();
        for (index, &end) in free.iter().enumerate() {
            let other_set = |other: usize| sets[other] != sets[index];
            tree.nearest(points[index], WIDTH, &other_set, &mut found);
            gaps.extend(
                found
                    .iter()
                    .map(|&(off, other)| (off, end, free[other as usize])),
            );
        }
        join_shortest(&mut fragments, &mut gaps);
    }
    walk(&fragments.joined, count)
}

/// A tour from piece 0 that goes to the nearest piece that is left, in either direction.
pub fn nearest_first(ends: &[Point]) -> Vec<(u32, bool)> {
    let count = ends.len() / 2;
    let mut tree = Neighbours::new(ends);
    let mut is_left = vec![true; count];
    let mut tour = Vec::with_capacity(count);
    let mut found = vec![(0.0, 0)];
    while let Some(&(_, end)) = found.first() {
        let piece = end / 2;
        tour.push((piece, end % 2 == 1));
        is_left[piece as usize] = false;
        tree.remove(end as usize);
        tree.remove((end ^ 1) as usize);
        tree.nearest(
            ends[(end ^ 1) as usize],
            1,
            &|end| is_left[end / 2],
            &mut found,
        );
    }
    tour
}

/// Length of the gaps of a closed tour, mm.
pub fn length(ends: &[Point], tour: &[(u32, bool)]) -> f64 {
    let end = |(piece, flipped): (u32, bool), last: bool| {
        ends[2 * piece as usize + usize::from(flipped != last)]
    };
    let next = tour.iter().cycle().skip(1);
    tour.iter()
        .zip(next)
        .map(|(&one, &next)| crate::geometry::distance(end(one, true), end(next, false)))
        .sum()
}

/// Joins ends in the same place one after the other. Many of them have the same few nearest ends:
/// those alone would join only a few in each round. Sorts `free`.
fn join_coincident(fragments: &mut Fragments, ends: &[Point], free: &mut [u32]) {
    let at = |end: u32| ends[end as usize];
    free.sort_unstable_by(|&a, &b| {
        let [one, two] = [at(a), at(b)];
        let order = one[0].total_cmp(&two[0]).then(one[1].total_cmp(&two[1]));
        order.then(a.cmp(&b))
    });
    for pair in free.windows(2) {
        if at(pair[0]) == at(pair[1]) {
            fragments.join(pair[0], pair[1]);
        }
    }
}

fn join_shortest(fragments: &mut Fragments, gaps: &mut [(f64, u32, u32)]) {
    gaps.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    for &(_, a, b) in gaps.iter() {
        fragments.join(a, b);
    }
}

/// The pieces from one free end to the other.
fn walk(joined: &[Option<u32>], count: usize) -> Vec<(u32, bool)> {
    let first = joined.iter().position(Option::is_none).unwrap_or(0);
    let mut tour = Vec::with_capacity(count);
    let mut end = first as u32;
    for _ in 0..count {
        tour.push((end / 2, end % 2 == 1));
        match joined[(end ^ 1) as usize] {
            Some(next) => end = next,
            None => break,
        }
    }
    tour
}
