//! Orders of single commands for edge tracing: file order and four greedy conditions.
//!
//! Source: C. Mitravakin, *Tool path analysis for engraving machine*, KMITL, 2002, section 4.2.1.
//! Commands are never reversed. A command that starts where the last one ended follows without a
//! lift; only without one is a new path chosen.

use super::starts::Starts;
use crate::geometry::{Point, distance};
use serde::Serialize;

/// Largest gap that counts as continuous: half a step of the thesis's machine, mm.
pub const CONTINUOUS: f64 = 0.0025;

/// Start and end of a command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ends {
    /// Start, mm.
    pub start: Point,
    /// End, mm.
    pub end: Point,
}

/// How the order is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Condition {
    /// The order of the file.
    File,
    /// Begin with the first command; new paths begin nearest to the reference.
    FirstReference,
    /// Begin with the first command; new paths begin nearest to the lift point.
    FirstLift,
    /// Begin nearest to the reference; new paths begin nearest to the reference.
    NearestReference,
    /// Begin nearest to the reference; new paths begin nearest to the lift point.
    NearestLift,
}

impl Condition {
    /// All, in the order of the thesis.
    pub const ALL: [Self; 5] = [
        Self::File,
        Self::FirstReference,
        Self::FirstLift,
        Self::NearestReference,
        Self::NearestLift,
    ];

    /// Name for reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::File => "file order",
            Self::FirstReference => "first command, nearest to the reference",
            Self::FirstLift => "first command, nearest to the lift point",
            Self::NearestReference => "nearest command, nearest to the reference",
            Self::NearestLift => "nearest command, nearest to the lift point",
        }
    }
}

/// An order with its air distance.
#[derive(Debug, Clone, PartialEq)]
pub struct Ordered {
    /// The condition it is from.
    pub condition: Condition,
    /// Indices of the commands.
    pub order: Vec<usize>,
    /// Total air distance from the reference and back to it, mm.
    pub air_mm: f64,
    /// Number of moves with the tool lifted before a command.
    pub lifts: usize,
}

/// Air distance of an order from `reference` and back, mm (equations 4.3 and 4.4), and its lifts.
#[must_use]
pub fn air(commands: &[Ends], order: &[usize], reference: Point) -> (f64, usize) {
    let (mut at, mut total, mut lifts) = (reference, 0.0, 0);
    for &index in order {
        let gap = distance(at, commands[index].start);
        if gap > CONTINUOUS {
            total += gap;
            lifts += 1;
        }
        at = commands[index].end;
    }
    (total + distance(at, reference), lifts)
}

/// The order of a condition. Ties go to the command that comes first in the file.
#[must_use]
pub fn order(commands: &[Ends], condition: Condition, reference: Point) -> Ordered {
    let order = if condition == Condition::File {
        (0..commands.len()).collect()
    } else {
        greedy(commands, condition, reference)
    };
    let (air_mm, lifts) = air(commands, &order, reference);
    Ordered {
        condition,
        order,
        air_mm,
        lifts,
    }
}

fn greedy(commands: &[Ends], condition: Condition, reference: Point) -> Vec<usize> {
    let mut starts = Starts::new(commands.iter().map(|one| one.start));
    let mut order = Vec::with_capacity(commands.len());
    let first = match condition {
        Condition::NearestReference | Condition::NearestLift => starts.nearest(reference),
        _ => starts.first(),
    };
    // The starts do not move away from the reference: one sorting replaces all searches.
    let mut by_reference = match condition {
        Condition::FirstReference | Condition::NearestReference => {
            let off = |(index, one): (u32, &Ends)| (distance(one.start, reference), index);
            let mut all: Vec<(f64, u32)> = (0..).zip(commands).map(off).collect();
            all.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            Some(all.into_iter().map(|(_, index)| index as usize))
        }
        _ => None,
    };
    let mut next = first;
    while let Some(index) = next {
        order.push(index);
        starts.remove(index);
        let end = commands[index].end;
        next = starts.first_within(end, CONTINUOUS).or_else(|| {
            by_reference.as_mut().map_or_else(
                || starts.nearest(end),
                |all| all.find(|&index| starts.is_left(index)),
            )
        });
    }
    order
}

/// The shortest of the file order and the four conditions; of equal ones the first.
#[must_use]
pub fn analyse(commands: &[Ends], reference: Point) -> Ordered {
    let all = Condition::ALL.map(|condition| order(commands, condition, reference));
    let mut all = all.into_iter();
    let first = all
        .next()
        .unwrap_or_else(|| order(commands, Condition::File, reference));
    all.fold(first, |best, next| {
        if next.air_mm < best.air_mm {
            next
        } else {
            best
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    /// The greedy order as section 4.2.1 words it: all commands that are left are looked through.
    fn by_full_search(commands: &[Ends], condition: Condition, reference: Point) -> Vec<usize> {
        let nearest = |left: &[usize], to: Point| {
            let off = |place: &usize| distance(commands[left[*place]].start, to);
            let mut best = 0;
            for place in 1..left.len() {
                if off(&place) < off(&best) {
                    best = place;
                }
            }
            best
        };
        let mut left: Vec<usize> = (0..commands.len()).collect();
        let first = match condition {
            Condition::NearestReference | Condition::NearestLift => nearest(&left, reference),
            _ => 0,
        };
        let mut order = vec![left.remove(first)];
        while !left.is_empty() {
            let end = commands[order[order.len() - 1]].end;
            let follows = |&index: &usize| distance(commands[index].start, end) <= CONTINUOUS;
            let to = match condition {
                Condition::FirstReference | Condition::NearestReference => reference,
                _ => end,
            };
            let place = left.iter().position(follows);
            order.push(left.remove(place.unwrap_or_else(|| nearest(&left, to))));
        }
        order
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            rng_seed: RngSeed::Fixed(1),
            failure_persistence: None,
            ..ProptestConfig::default()
        })]

        /// On a coarse grid many commands join, begin in one place or are equally near; some gaps
        /// are the largest that counts as continuous.
        #[test]
        fn the_order_is_that_of_a_full_search(
            points in prop::collection::vec(prop::array::uniform4(0.0..40.0), 1..120),
            cell in prop::sample::select(vec![0.0, 1.0, 5.0, 20.0, 0.0025]),
            reference in prop::array::uniform2(-5.0..5.0), round in any::<bool>(),
        ) {
            let place = |value: f64| -> f64 { if cell == 0.0 { value } else {
                (value / 40.0 * (8.0_f64 * cell).min(40.0) / cell).round() * cell
            } };
            let commands: Vec<Ends> = points.iter().map(|one| {
                let [x, y, u, v] = one.map(place);
                Ends { start: [x, y], end: [u, v] }
            }).collect();
            let reference = if round { reference.map(place) } else { reference };
            for condition in &Condition::ALL[1..] {
                let found = order(&commands, *condition, reference).order;
                prop_assert_eq!(found, by_full_search(&commands, *condition, reference));
            }
        }
    }

    /// 60,000 commands that begin in few places, or all in one: seconds, not hours.
    #[test]
    fn many_commands_in_one_place_are_ordered() {
        for places in [1, 3] {
            let commands: Vec<Ends> = (0..60_000_u32)
                .map(|k| Ends {
                    start: [f64::from(k % places), 1.0],
                    end: [f64::from(k), 9.0],
                })
                .collect();
            let found = order(&commands, Condition::NearestLift, [0.0; 2]).order;
            assert_eq!(found[..2], [0, if places == 1 { 1 } else { 3 }]);
            assert_eq!(found.len(), commands.len());
        }
    }
}
