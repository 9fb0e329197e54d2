//! Nearest points by a square grid.

use crate::geometry::{Point, distance};

/// Points in the squares of a grid.
pub struct Grid<'p> {
    points: &'p [Point],
    low: Point,
    cell: f64,
    columns: usize,
    rows: usize,
    /// First entry of each square in `entries`, and the end of the last one.
    first: Vec<u32>,
    entries: Vec<u32>,
}

impl<'p> Grid<'p> {
    /// Sorts points into squares of about two points each.
    pub fn new(points: &'p [Point]) -> Self {
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        for at in points {
            for axis in 0..2 {
                low[axis] = low[axis].min(at[axis]);
                high[axis] = high[axis].max(at[axis]);
            }
        }
        let (width, height) = if points.is_empty() {
            low = [0.0; 2];
            (0.0, 0.0)
        } else {
            (high[0] - low[0], high[1] - low[1])
        };
        let count = points.len().max(1) as f64;
        let cell = (width * height * 2.0 / count).sqrt();
        let cell = cell.max(width.max(height) * 2.0 / count).max(1e-9);
        let columns = (width / cell) as usize + 1;
        let rows = (height / cell) as usize + 1;
        let mut grid = Self {
            points,
            low,
            cell,
            columns,
            rows,
            first: vec![0; columns * rows + 1],
            entries: vec![0; points.len()],
        };
        for &at in points {
            let square = grid.square(at);
            grid.first[square + 1] += 1;
        }
        for square in 0..columns * rows {
            grid.first[square + 1] += grid.first[square];
        }
        let mut next = grid.first.clone();
        for (index, &at) in points.iter().enumerate() {
            let square = grid.square(at);
            grid.entries[next[square] as usize] = index as u32;
            next[square] += 1;
        }
        grid
    }

    fn place(&self, at: Point) -> [usize; 2] {
        let limit = [self.columns - 1, self.rows - 1];
        std::array::from_fn(|axis| {
            (((at[axis] - self.low[axis]) / self.cell).max(0.0) as usize).min(limit[axis])
        })
    }

    fn square(&self, at: Point) -> usize {
        let [column, row] = self.place(at);
        row * self.columns + column
    }

    /// Appends the `count` points nearest to `at` that `allowed` accepts, nearest first; fewer if
    /// there are not that many.
    pub fn nearest(
        &self,
        at: Point,
        count: usize,
        allowed: &dyn Fn(usize) -> bool,
        out: &mut Vec<(f64, u32)>,
    ) {
        out.clear();
        let [column, row] = self.place(at);
        let most = self.columns.max(self.rows);
        for ring in 0..=most {
            // Points of later rings are at least this far away.
            let reached = (ring as f64 - 1.0) * self.cell;
            if out.len() >= count && out[count - 1].0 <= reached {
                break;
            }
            self.ring(column, row, ring, |index| {
                if allowed(index as usize) {
                    let off = distance(self.points[index as usize], at);
                    let full = out.len() >= count;
                    if !full || off < out[count - 1].0 {
                        let place = out.partition_point(|&(other, _)| other <= off);
                        out.insert(place, (off, index));
                        out.truncate(count);
                    }
                }
            });
        }
    }

    fn ring(&self, column: usize, row: usize, ring: usize, mut visit: impl FnMut(u32)) {
        let (column, row, ring) = (column as i64, row as i64, ring as i64);
        let mut square = |x: i64, y: i64| {
            if x >= 0 && y >= 0 && x < self.columns as i64 && y < self.rows as i64 {
                let square = y as usize * self.columns + x as usize;
                let (from, to) = (self.first[square], self.first[square + 1]);
                for &index in &self.entries[from as usize..to as usize] {
                    visit(index);
                }
            }
        };
        if ring == 0 {
            square(column, row);
            return;
        }
        for x in column - ring..=column + ring {
            square(x, row - ring);
            square(x, row + ring);
        }
        for y in row - ring + 1..row + ring {
            square(column - ring, y);
            square(column + ring, y);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    proptest! {
        #![proptest_config(ProptestConfig {
            rng_seed: RngSeed::Fixed(1),
            failure_persistence: None,
            ..ProptestConfig::default()
        })]

        #[test]
        fn the_grid_finds_what_a_full_search_finds(
            points in prop::collection::vec(prop::array::uniform2(-50.0..50.0), 1..120),
            at in prop::array::uniform2(-80.0..80.0), count in 1_usize..9,
        ) {
            let grid = Grid::new(&points);
            let mut found = Vec::new();
            grid.nearest(at, count, &|index| index % 3 != 1, &mut found);
            let mut all: Vec<f64> = points.iter().enumerate().filter(|(i, _)| i % 3 != 1)
                .map(|(_, &point)| distance(point, at)).collect();
            all.sort_by(f64::total_cmp);
            all.truncate(count);
            let found: Vec<f64> = found.iter().map(|one| one.0).collect();
            prop_assert_eq!(found, all);
        }
    }
}
