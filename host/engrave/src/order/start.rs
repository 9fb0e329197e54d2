//! A tour to start from: the shortest gaps first, as long as they form no cycle.

use super::neighbours::Grid;
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
    join_shortest(&mut fragments, &mut gaps);
    while fragments.count > 1 {
        let free: Vec<u32> = (0..ends.len() as u32)
            .filter(|&end| fragments.joined[end as usize].is_none())
            .collect();
        let points: Vec<Point> = free.iter().map(|&end| ends[end as usize]).collect();
        let sets: Vec<u32> = free.iter().map(|&end| fragments.set(end / 2)).collect();
        let grid = Grid::new(&points);
        let mut found = Vec::new();
        gaps.clear();
        for (index, &end) in free.iter().enumerate() {
            let other_set = |other: usize| sets[other] != sets[index];
            grid.nearest(points[index], WIDTH, &other_set, &mut found);
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
