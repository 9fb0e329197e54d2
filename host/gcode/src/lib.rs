//! The part-program reader: from the text of a file to moves, dwells and switches, each with its place in the file.
//!
//! Coordinates are those of the work: millimetres, and degrees for the rotary words. What a program can say:
//!
//! | words | meaning |
//! | --- | --- |
//! | G0, G1 | straight move: rapid, at feed |
//! | G2, G3 | arc, clockwise and counter-clockwise seen from the positive end of the plane's normal; helix with the third axis |
//! | I J K | centre, from the start of the arc (incremental); without an end point a full circle |
//! | R | radius; negative for the arc of more than half a turn |
//! | G4 P | dwell, seconds |
//! | G17, G18, G19 | plane X Y, Z X, Y Z |
//! | G20 or G70, G21 or G71 | inch, millimetre; millimetre to begin with. Rotary words are degrees in both |
//! | G40, G49, G80 | compensation, tool length, cycle off: they never are on; G80 also ends the modal G0 to G3 |
//! | G61, G64 | exact stop at block ends; corners blended within the planner's tolerance (to begin with) |
//! | G90, G91 | absolute (to begin with), incremental |
//! | G94 F | feed per minute: mm (inch) of the tool tip in the work; degrees of the fastest rotary axis where the tip rests |
//! | M0, M1 | pause; M1 only with [`Options::optional_stop`] |
//! | M2, M30 | end; the spindle stops |
//! | M3 S, M5 | spindle on (clockwise) at S rev/min, off. M4 is refused: a setpoint's action has no word for the other sense |
//! | N, O, %, ( ), ; | block number, program number (alone in the first block), tape marks, comments |
//!
//! Each motion word has one of a group in a block; a letter stands once. The order within a block is: modes, F, S, spindle, dwell or
//! motion, then pause or end. Everything else is refused with `file:line:column`, what is wrong, and what to do; nothing is skipped.
//! All problems of a file are reported together (up to [`LISTED_PROBLEMS`]).
//!
//! An arc may end up to [`RADIUS_TOLERANCE_MM`] nearer to or farther from its centre than it starts; it then goes evenly from one radius to the
//! other, so that both ends are as programmed. More is refused.
//!
//! Misuse: the reader knows nothing of the machine's reach; only a [`haptimill_planner::Plan`] has been checked.

mod block;
mod geometry;
mod lexer;
mod path;
mod problem;
mod reader;

#[cfg(test)]
mod tests;

pub use lexer::Comment;
pub use path::{Arc, AxisKind, Coordinates, Measure, Path};
pub use problem::{LISTED_PROBLEMS, Place, Problem, Refused};
pub use reader::read;

/// The largest difference of an arc's radius at its two ends, mm.
pub const RADIUS_TOLERANCE_MM: f64 = 0.005;

/// The longest dwell, seconds.
pub const LONGEST_DWELL_S: f64 = 3600.0;

/// A pose coordinate and the letter by which programs call it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProgramAxis {
    /// The letter, one of X Y Z A B C U V W, in upper case.
    pub letter: char,
    /// Millimetres or degrees.
    pub kind: AxisKind,
}

/// What a program is read for.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// The pose coordinates, in the machine's order, at most six.
    pub axes: Vec<ProgramAxis>,
    /// Where the program starts: mm, degrees.
    pub start: Coordinates,
    /// M1 pauses.
    pub optional_stop: bool,
}

impl Options {
    /// The H-4 arm with its table: X, Y, Z, B (tool tilt theta), A (table alpha).
    pub fn h4(start: Coordinates) -> Options {
        let axis = |letter, kind| ProgramAxis { letter, kind };
        Options {
            axes: vec![
                axis('X', AxisKind::Linear),
                axis('Y', AxisKind::Linear),
                axis('Z', AxisKind::Linear),
                axis('B', AxisKind::Rotary),
                axis('A', AxisKind::Rotary),
            ],
            start,
            optional_stop: true,
        }
    }

    /// Kinds of the pose coordinates.
    pub fn kinds(&self) -> Vec<AxisKind> {
        self.axes.iter().map(|axis| axis.kind).collect()
    }
}

/// How fast a move goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Feed {
    /// As fast as the machine can (G0).
    Rapid,
    /// At this speed: mm/min of the tip, or deg/min where only rotary axes move (see [`Measure`]).
    PerMinute(f64),
}

/// A move.
#[derive(Debug, Clone, PartialEq)]
pub struct Move {
    /// The first of its axis words.
    pub place: Place,
    /// The way.
    pub path: Path,
    /// The speed.
    pub feed: Feed,
    /// Come to rest at the end (G61).
    pub exact_stop: bool,
}

/// What a program does, step by step.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// Moves.
    Move(Move),
    /// Waits.
    Dwell {
        /// The G4.
        place: Place,
        /// Seconds, positive.
        seconds: f64,
    },
    /// Sets the spindle.
    Spindle {
        /// The M word, or the S word that changes a running spindle.
        place: Place,
        /// Rev/min: clockwise above 0 (M3), counter-clockwise below (M4), 0 is off.
        rpm: i16,
    },
    /// Waits for the operator.
    Pause {
        /// The M word.
        place: Place,
    },
}

/// A program that was understood.
#[derive(Debug, Clone, PartialEq)]
pub struct Program {
    /// Name of the file, for messages.
    pub file: String,
    /// Where it starts.
    pub start: Coordinates,
    /// What it does.
    pub steps: Vec<Step>,
    /// Its comments, in order.
    pub comments: Vec<Comment>,
    /// Lines in the file.
    pub lines: u32,
}
