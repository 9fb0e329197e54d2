//! Lines and arcs that are drawn more than once.

use crate::drawing::{Drawing, Problem};
use crate::geometry::{Point, Segment, distance};
use std::collections::HashMap;

/// Segments by the square of a grid that their middle is in.
struct Drawn {
    same: f64,
    squares: HashMap<[i64; 2], Vec<(Segment, usize)>>,
}

impl Drawn {
    fn square(&self, at: Point) -> [i64; 2] {
        // The squares beside the farthest one have numbers, too.
        const FARTHEST: f64 = 1e18;
        at.map(|value| (value / self.same).floor().clamp(-FARTHEST, FARTHEST) as i64)
    }

    /// Entity of an earlier segment at the same place, in either direction. It may be in a square
    /// beside that of its middle: a border of the grid is between points that are as near as any.
    fn entity(&self, segment: &Segment) -> Option<usize> {
        let middle = segment.point(0.5);
        let near = |a, b| distance(a, b) <= self.same;
        let is_same = |one: &Segment| {
            near(one.point(0.5), middle)
                && (near(one.from, segment.from) && near(one.to, segment.to)
                    || near(one.from, segment.to) && near(one.to, segment.from))
        };
        let [column, row] = self.square(middle);
        (column - 1..=column + 1)
            .flat_map(|x| (row - 1..=row + 1).map(move |y| [x, y]))
            .filter_map(|square| self.squares.get(&square))
            .flatten()
            .find_map(|(one, entity)| is_same(one).then_some(*entity))
    }
}

/// Names the entities of which each line and arc is drawn before, with ends and middles that are at
/// most `same` apart, mm.
pub(super) fn find(drawing: &Drawing, same: f64) -> Vec<Problem> {
    let mut drawn = Drawn {
        same,
        squares: HashMap::new(),
    };
    let mut out = Vec::new();
    for path in &drawing.paths {
        let before = path.segments().map(|one| drawn.entity(&one));
        let before: Vec<Option<usize>> = before.collect();
        let all: Option<Vec<usize>> = before.iter().copied().collect();
        let entity = all.and_then(|all| all.first().copied());
        if let Some(entity) = entity.filter(|&entity| entity != path.entity) {
            out.push(Problem::of(
                drawing.entity(path),
                format!("it is a duplicate of {}", drawing.entities[entity]),
                "delete it in the drawing program",
            ));
        }
        // Of segments at one place the first is kept: thousands of them cost no more.
        for (one, _) in path.segments().zip(before).filter(|one| one.1.is_none()) {
            let square = drawn.square(one.point(0.5));
            let here = drawn.squares.entry(square).or_default();
            here.push((one, path.entity));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::Entity;
    use crate::geometry::Path;

    /// Lines that are nearer than the limit are duplicates wherever the squares of the grid end,
    /// and in either direction. Lines that are farther apart are none.
    #[test]
    fn duplicates_are_found_across_the_borders_of_the_grid() {
        let same = 1e-5;
        for k in 0..400 {
            // Places of all kinds within a square.
            let at = 10.0 + f64::from(k) * 0.0137 * same;
            for (off, is_found) in [(0.7 * same, true), (-0.7 * same, true), (1.5 * same, false)] {
                let mut drawing = Drawing::default();
                for (index, shift) in [0.0, off].into_iter().enumerate() {
                    let entity = drawing.add_entity(Entity::default());
                    let (from, to) = ([at + shift, at], [at + shift + 3.0, 2.0 * at]);
                    let one = Segment {
                        from: if index == 0 { from } else { to },
                        to: if index == 0 { to } else { from },
                        bulge: 0.0,
                    };
                    drawing.paths.push(Path::from_segments(&[one], entity));
                }
                assert_eq!(
                    find(&drawing, same).len(),
                    usize::from(is_found),
                    "{k} {off}"
                );
            }
        }
    }
}
