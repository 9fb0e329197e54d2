//! Orders of single commands for edge tracing: file order and four greedy conditions.
//!
//! Source: C. Mitravakin, *Tool path analysis for engraving machine*, KMITL, 2002, section 4.2.1.
//! Commands are never reversed. A command that starts where the last one ended follows without a
//! lift; only without one is a new path chosen.

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

/// The order of a condition. Ties go to the command that comes first in the file. Takes time in
/// proportion to the square of the number of commands.
#[must_use]
pub fn order(commands: &[Ends], condition: Condition, reference: Point) -> Ordered {
    let nearest = |left: &[usize], to: Point| {
        let mut best: Option<(f64, usize)> = None;
        for (place, &index) in left.iter().enumerate() {
            let off = distance(commands[index].start, to);
            if best.is_none_or(|(least, _)| off < least) {
                best = Some((off, place));
            }
        }
        best.map_or(0, |(_, place)| place)
    };
    let mut order: Vec<usize> = (0..commands.len()).collect();
    if condition != Condition::File && !commands.is_empty() {
        let mut left = std::mem::take(&mut order);
        let first = match condition {
            Condition::NearestReference | Condition::NearestLift => nearest(&left, reference),
            _ => 0,
        };
        let mut end = commands[left[first]].end;
        order.push(left.remove(first));
        while !left.is_empty() {
            let follows = left
                .iter()
                .position(|&index| distance(commands[index].start, end) <= CONTINUOUS);
            let place = follows.unwrap_or_else(|| match condition {
                Condition::FirstReference | Condition::NearestReference => {
                    nearest(&left, reference)
                }
                _ => nearest(&left, end),
            });
            end = commands[left[place]].end;
            order.push(left.remove(place));
        }
    }
    let (air_mm, lifts) = air(commands, &order, reference);
    Ordered {
        condition,
        order,
        air_mm,
        lifts,
    }
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
