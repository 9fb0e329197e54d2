//! Interpreter of part programs in the language of RS274/NGC: from the text of a file to moves,
//! dwells and commands, each with its place in the file.
//!
//! - [`Interpreter`] is an iterator over the [`Step`]s of a program, one block at a time, in memory
//!   that does not depend on the length of the program.
//! - [`read`] collects the steps of a whole program, or all its problems.
//!
//! The stages are: lines (source), the words of a line with their expressions (block,
//! expression), one block in the order of RS274/NGC (executor and its parts), and the order of
//! blocks (flow, interpreter). docs/gcode.md lists every code.
//!
//! Moves are in machine coordinates: millimetres, and degrees for rotary axes. Work offsets, tool
//! lengths and cutter compensation are applied; cycles, splines and feeds per revolution are
//! resolved.
//!
//! Everything that is not understood is refused with `file:line:column`, problem and remedy;
//! nothing is skipped. One block has at most one problem. All problems of a file are reported
//! together, up to [`LISTED_PROBLEMS`]; those that follow from an earlier one are left out.
//!
//! The radii at both ends of an arc may differ by [`RADIUS_TOLERANCE_MM`], or by a thousandth of
//! the radius up to 100 times that. The radius then changes linearly along the arc, and both ends
//! are as programmed. A larger difference is refused.
//!
//! The interpreter does not check the workspace of the machine; the planner does.

mod arcs;
mod block;
mod canonical;
mod codes;
mod compensation;
mod cycles;
mod devices;
mod dialog;
mod executor;
mod expression;
mod flow;
mod frame;
mod interpreter;
mod loops;
mod motion;
mod offsets;
mod output;
mod path;
mod problem;
mod program;
mod saved_modes;
mod series;
mod source;
mod splines;
mod state;
mod subroutines;
mod symbols;
mod tool_axis;
mod tool_table;
mod words;

#[cfg(test)]
mod tests;

pub use canonical::{Feed, Move, OutputValue, ProbeKind, Step, WaitFor};
pub use dialog::Dialog;
pub use interpreter::Interpreter;
pub use path::{Arc, Coordinates, Measure, Path, WordKind};
pub use problem::{LISTED_PROBLEMS, Notice, Place, Problem, Problems, Refused, file_name};
pub use program::{Comment, Program, read};
pub use source::{LONGEST_LINE, ProgramBytes};
pub use tool_axis::{ToolAxis, ToolLength};
pub use tool_table::{Offsets, PerLetter, SYSTEM_NAMES, SYSTEMS, Tool, ToolTable, WorkOffset};

use std::path::PathBuf;

/// Largest difference of an arc's radii at its two ends, mm, for programs in mm. Large arcs may
/// differ by a thousandth of the radius.
pub const RADIUS_TOLERANCE_MM: f64 = 0.0283;

/// The same for programs in inches, mm.
pub const RADIUS_TOLERANCE_INCH_MM: f64 = 0.0718;

/// Longest dwell, seconds.
pub const LONGEST_DWELL_S: f64 = 3600.0;

/// Millimetres per inch.
const INCH_MM: f64 = 25.4;

/// Pose coordinate with its program letter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProgramAxis {
    /// The letter, one of X Y Z A B C U V W, in upper case.
    pub letter: char,
    /// Millimetres or degrees.
    pub kind: WordKind,
    /// The coordinate wraps around: an absolute word is an angle below a turn, and its sign the
    /// direction in which the machine turns there.
    pub wraps: bool,
}

/// Axes, start and options of a program.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// The pose coordinates, in the machine's order, at most six.
    pub axes: Vec<ProgramAxis>,
    /// Start of the program: mm, degrees.
    pub start: Coordinates,
    /// Whether M1 pauses.
    pub optional_stop: bool,
    /// Whether blocks that begin with a slash are left out.
    pub block_delete: bool,
    /// Whether lengths without a decimal point count the least increment, 0.001 mm or 0.0001 inch.
    pub no_decimal: bool,
    /// Whether words that change nothing on this machine are refused.
    pub strict: bool,
    /// Whether the machine has coolant.
    pub coolant: bool,
    /// Whether the machine has inputs and outputs for M62 to M68.
    pub outputs: bool,
    /// Coordinates that turn the tool in the workpiece: the length of a tool is then no offset
    /// along Z of the workpiece.
    pub tool_axis: ToolAxis,
    /// The tool in the spindle at the start; 0 is none, or unknown.
    pub tool: u32,
    /// The tool table.
    pub tools: ToolTable,
    /// Name of the file of the tool table in messages; empty if there is none.
    pub tools_file: String,
    /// Work offsets and reference positions.
    pub offsets: Offsets,
    /// Folders of called files.
    pub folders: Vec<PathBuf>,
}

impl Options {
    /// Returns the options of a machine whose coordinates have these letters, in this order; A, B
    /// and C are rotary. M1 pauses.
    pub fn of_letters(letters: &str, start: Coordinates) -> Options {
        let axis = |letter| ProgramAxis {
            letter,
            kind: match letter {
                'A' | 'B' | 'C' => WordKind::Rotary,
                _ => WordKind::Linear,
            },
            wraps: false,
        };
        Options {
            axes: letters.chars().map(axis).collect(),
            start,
            optional_stop: true,
            ..Options::default()
        }
    }

    /// Returns the kinds of the pose coordinates.
    pub fn kinds(&self) -> Vec<WordKind> {
        self.axes.iter().map(|axis| axis.kind).collect()
    }
}
