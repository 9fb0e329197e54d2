//! The shortest order of a few pieces, by dynamic programming over all of their subsets.

use super::edges::CONTINUOUS;
use crate::geometry::{Point, distance};

/// Largest number of pieces.
pub const PIECES: usize = 12;

/// Largest number of steps of the computation.
const STEPS: usize = 8_000_000;

/// What a lift counts, mm: of equally short tours the one with the fewest lifts is the shortest.
const LIFT: f64 = 1e-6;

/// Length of a gap, mm.
fn gap(a: Point, b: Point) -> f64 {
    let off = distance(a, b);
    if off > CONTINUOUS { off + LIFT } else { off }
}

/// The shortest tour from `reference` through one option of every piece and back. An option is
/// where the tool goes down and where it comes up. Returns piece and option in their order; `None`
/// where there are too many.
pub fn shortest(pieces: &[Vec<[Point; 2]>], reference: Point) -> Option<Vec<(usize, usize)>> {
    if pieces.len() > PIECES {
        return None;
    }
    let options: Vec<(usize, usize, [Point; 2])> = pieces
        .iter()
        .enumerate()
        .flat_map(|(piece, options)| {
            options
                .iter()
                .enumerate()
                .map(move |(option, &ends)| (piece, option, ends))
        })
        .collect();
    let (width, all) = (options.len(), 1_usize << pieces.len());
    if all
        .checked_mul(width * width)
        .is_none_or(|steps| steps > STEPS)
    {
        return None;
    }
    // Least length to have cut a set of pieces, ending with an option of one of them.
    let mut min = vec![f64::INFINITY; all * width];
    let mut before = vec![u32::MAX; all * width];
    for (last, &(piece, _, ends)) in options.iter().enumerate() {
        min[(1 << piece) * width + last] = gap(reference, ends[0]);
    }
    for set in 1..all {
        for (last, &(piece, _, ends)) in options.iter().enumerate() {
            let length = min[set * width + last];
            if set & (1 << piece) == 0 || !length.is_finite() {
                continue;
            }
            for (next, &(other, _, to)) in options.iter().enumerate() {
                if set & (1 << other) != 0 {
                    continue;
                }
                let slot = (set | 1 << other) * width + next;
                let total = length + gap(ends[1], to[0]);
                if total < min[slot] {
                    min[slot] = total;
                    before[slot] = last as u32;
                }
            }
        }
    }
    let mut set = all - 1;
    let home = |last: usize| min[set * width + last] + distance(options[last].2[1], reference);
    let mut last = (0..width).min_by(|&a, &b| home(a).total_cmp(&home(b)))?;
    let mut order = Vec::with_capacity(pieces.len());
    loop {
        let (piece, option, _) = options[last];
        order.push((piece, option));
        let previous = before[set * width + last];
        set &= !(1 << piece);
        if previous == u32::MAX {
            break;
        }
        last = previous as usize;
    }
    order.reverse();
    Some(order)
}
