//! Output of the interpreter: moves between positions with their feeds, through cutter
//! compensation.

use super::canonical::{Feed, Move, Step};
use super::compensation::Compensation;
use super::frame::Frame;
use super::path::{Arc, Coordinates, Path, WordKind};
use super::problem::Place;
use super::tool_axis::ToolLength;
use super::tool_table::PerLetter;
use std::collections::VecDeque;

/// Feed of a move before its length is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum MoveFeed {
    Rapid,
    /// mm/min, and deg/min if only rotary axes move.
    PerMinute(f64, f64),
    /// Moves per minute (G93).
    Inverse(f64),
}

/// A move between positions of the machine.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Leg {
    pub place: Place,
    pub to: PerLetter,
    /// Arc with the indices of X, Y, Z.
    pub arc: Option<Arc>,
    pub move_feed: MoveFeed,
    /// The overrides have no effect.
    pub fixed: bool,
    pub exact_stop: bool,
    pub tolerance: Option<f64>,
    pub joining: Option<f64>,
}

/// Queue of the steps that are made but not yet taken.
pub(crate) struct Output {
    /// Index of each pose coordinate's letter.
    pub letters: Vec<usize>,
    kinds: Vec<WordKind>,
    /// Position after the last move of the queue.
    at: PerLetter,
    /// Offsets and rotation of the program in the machine.
    pub frame: Frame,
    /// Tool whose length is no offset, by the coordinates of a pose.
    pub tool: ToolLength,
    pub steps: VecDeque<Step>,
    pub compensation: Compensation,
}

impl Output {
    pub(crate) fn new(letters: Vec<usize>, kinds: Vec<WordKind>, at: PerLetter) -> Self {
        Self {
            letters,
            kinds,
            at,
            frame: Frame::default(),
            tool: ToolLength::default(),
            steps: VecDeque::new(),
            compensation: Compensation::default(),
        }
    }

    /// Returns the position of the last move, with cutter compensation.
    pub(crate) fn at(&self) -> &PerLetter {
        &self.at
    }

    /// Sets the position, after a probe move that ended before its programmed end.
    pub(crate) fn place_at(&mut self, at: PerLetter) {
        self.at = at;
    }

    /// Returns the index of the pose coordinate of a letter.
    pub(crate) fn coordinate(&self, axis: usize) -> Option<usize> {
        self.letters.iter().position(|letter| *letter == axis)
    }

    fn coordinates(&self, at: &PerLetter) -> Coordinates {
        let mut values = Coordinates::default();
        for (value, letter) in values.iter_mut().zip(&self.letters) {
            *value = at[*letter];
        }
        values
    }

    /// Adds a move that is not compensated.
    pub(crate) fn leg(&mut self, leg: &Leg) {
        let step = self.build(leg);
        if let Some(step) = step {
            self.steps.push_back(Step::Move(step));
        }
    }

    /// Returns the path of a leg; `None` if nothing moves.
    pub(crate) fn path(&self, from: &PerLetter, leg: &Leg) -> Option<Path> {
        let (from, to) = (self.coordinates(from), self.coordinates(&leg.to));
        let Some(arc) = leg.arc else {
            return Path::line(&self.kinds, from, to);
        };
        let [first, second] = arc.plane;
        let plane = [self.coordinate(first)?, self.coordinate(second)?];
        Path::arc(&self.kinds, from, to, Arc { plane, ..arc })
    }

    /// Goes to the end of a leg; `None` if it is no move.
    pub(crate) fn build(&mut self, leg: &Leg) -> Option<Move> {
        let path = self.path(&self.at, leg);
        // A leg that ends at its start is no move, but the position becomes exactly the
        // programmed one.
        self.at = leg.to;
        let path = path?;
        let feed = match leg.move_feed {
            MoveFeed::Rapid => Feed::Rapid,
            MoveFeed::PerMinute(tip, turn) => {
                Feed::PerMinute(if path.tip_length() > 0.0 { tip } else { turn })
            }
            MoveFeed::Inverse(rate) => Feed::PerMinute(rate * path.length),
        };
        Some(Move {
            place: leg.place,
            path,
            tool: self.tool,
            programmed: self.coordinates(&self.frame.in_program(&leg.to)),
            feed,
            fixed: leg.fixed && leg.move_feed != MoveFeed::Rapid,
            exact_stop: leg.exact_stop,
            tolerance: leg.tolerance,
            joining: leg.joining,
        })
    }
}
