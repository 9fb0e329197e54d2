//! Neighbours of the ends of pieces, among which the local search looks for moves.

use super::neighbours::Neighbours;
use crate::geometry::Point;

/// Which ends of other pieces are neighbours of an end.
#[derive(Debug, Clone, Copy)]
pub struct Nearness {
    /// This many nearest ones.
    pub nearest: usize,
    /// At least this many nearest ones in each quadrant: the nearest ones of an end in a cluster
    /// are all in its cluster.
    pub per_quadrant: usize,
}

impl Nearness {
    /// Most neighbours of an end.
    pub const fn width(self) -> usize {
        self.nearest + 4 * self.per_quadrant
    }

    /// The neighbours of every end, nearest first, [`Nearness::width`] for each; `u32::MAX` where
    /// there are fewer.
    pub fn of(self, ends: &[Point]) -> Vec<u32> {
        let (tree, width) = (Neighbours::new(ends), self.width());
        let mut near = vec![u32::MAX; ends.len() * width];
        let (mut found, mut more) = (Vec::new(), Vec::new());
        for &(at, end) in tree.points() {
            let end = end as usize;
            let is_other = |other: usize| other / 2 != end / 2;
            tree.nearest(at, self.nearest, &is_other, &mut found);
            for quadrant in [[false, false], [false, true], [true, false], [true, true]] {
                if self.per_quadrant == 0 {
                    break;
                }
                let quadrant = Some(quadrant);
                tree.nearest_in(quadrant, at, self.per_quadrant, &is_other, &mut more);
                more.retain(|one| !found[..self.nearest.min(found.len())].contains(one));
                found.append(&mut more);
            }
            found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            for (slot, &(_, other)) in near[end * width..].iter_mut().zip(&found) {
                *slot = other;
            }
        }
        near
    }
}
