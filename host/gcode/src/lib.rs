//! Reader of part programs: from the text of a file to moves, dwells and spindle commands, each
//! with its place in the file.
//!
//! Coordinates are workpiece coordinates: millimetres, and degrees for rotary words. Supported
//! words:
//!
//! | words | meaning |
//! | --- | --- |
//! | G0, G1 | straight move: rapid, at feed |
//! | G2, G3 | arc, clockwise and counter-clockwise seen from the positive end of the plane's normal; helix with the third axis |
//! | I J K | centre, from the start of the arc (incremental); a full circle without an end point |
//! | R | radius; negative for an arc of more than half a turn |
//! | G4 P | dwell, seconds |
//! | G17, G18, G19 | plane X Y, Z X, Y Z |
//! | G20 or G70, G21 or G71 | inch, millimetre (default). Rotary words are degrees in both |
//! | G40, G49, G80 | compensation, tool length, cycle off: they are never on; G80 also ends the modal G0 to G3 |
//! | G61, G64 | exact stop at block ends; corners blended within the planner's tolerance (default) |
//! | G90, G91 | absolute (default), incremental |
//! | G94 F | feed per minute: mm (inch) of the tool tip in the workpiece; degrees of the fastest rotary axis if only rotary axes move |
//! | M0, M1 | pause; M1 only with [`Options::optional_stop`] |
//! | M2, M30 | end; the spindle stops |
//! | M3 S, M4 S, M5 | spindle clockwise, counter-clockwise at S rev/min, off |
//! | N, O, %, ( ), ; | block number, program number (alone in the first block), tape marks, comments |
//!
//! A block has at most one word of each modal group and each letter once, G and M excepted. The
//! order within a block is: modes, F, S, spindle, dwell or motion, then pause or end. Everything
//! else is refused with `file:line:column`, problem and remedy; nothing is skipped. All problems of
//! a file are reported together (up to [`LISTED_PROBLEMS`]).
//!
//! The radii at both ends of an arc may differ by up to [`RADIUS_TOLERANCE_MM`]. The radius then
//! changes linearly along the arc, and both ends are as programmed. A larger difference is refused.
//!
//! The reader does not check the workspace of the machine; the planner does.

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

/// Largest difference of an arc's radii at its two ends, mm.
pub const RADIUS_TOLERANCE_MM: f64 = 0.005;

/// Longest dwell, seconds.
pub const LONGEST_DWELL_S: f64 = 3600.0;

/// Pose coordinate with its program letter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProgramAxis {
    /// The letter, one of X Y Z A B C U V W, in upper case.
    pub letter: char,
    /// Millimetres or degrees.
    pub kind: AxisKind,
}

/// Axes, start and options of a program.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// The pose coordinates, in the machine's order, at most six.
    pub axes: Vec<ProgramAxis>,
    /// Start of the program: mm, degrees.
    pub start: Coordinates,
    /// Whether M1 pauses.
    pub optional_stop: bool,
}

impl Options {
    /// Returns the axes of the H-4 arm with its table: X, Y, Z, B (tool tilt theta), A (table
    /// alpha).
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

    /// Returns the kinds of the pose coordinates.
    pub fn kinds(&self) -> Vec<AxisKind> {
        self.axes.iter().map(|axis| axis.kind).collect()
    }
}

/// Feed of a move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Feed {
    /// As fast as the limits of the machine allow (G0).
    Rapid,
    /// Feed in mm/min of the tip, or deg/min if only rotary axes move (see [`Measure`]).
    PerMinute(f64),
}

/// A move.
#[derive(Debug, Clone, PartialEq)]
pub struct Move {
    /// Place of its first axis word.
    pub place: Place,
    /// Path.
    pub path: Path,
    /// Feed.
    pub feed: Feed,
    /// Whether to stop at the end (G61).
    pub exact_stop: bool,
}

/// Step of a program.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// Move.
    Move(Move),
    /// Dwell.
    Dwell {
        /// Place of the G4.
        place: Place,
        /// Seconds, positive.
        seconds: f64,
    },
    /// Spindle command.
    Spindle {
        /// Place of the M word, or of the S word that changes a running spindle.
        place: Place,
        /// Rev/min: clockwise above 0 (M3), counter-clockwise below (M4), 0 is off.
        rpm: i16,
    },
    /// Pause until the operator resumes.
    Pause {
        /// Place of the M word.
        place: Place,
    },
}

/// A program without problems.
#[derive(Debug, Clone, PartialEq)]
pub struct Program {
    /// Name of the file, for messages.
    pub file: String,
    /// Start.
    pub start: Coordinates,
    /// Steps, in order.
    pub steps: Vec<Step>,
    /// Comments, in order.
    pub comments: Vec<Comment>,
    /// Number of lines of the file.
    pub lines: u32,
}
