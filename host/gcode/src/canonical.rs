//! Canonical motion: the steps that an interpreter yields.

use super::path::{Coordinates, Path};
use super::problem::Place;
use super::tool_axis::ToolLength;

/// Feed of a move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Feed {
    /// As fast as the limits of the machine allow (G0).
    Rapid,
    /// Feed in mm/min of the tip, or deg/min if only rotary axes move (see
    /// [`Measure`](super::Measure)). G93 and G95 are converted.
    PerMinute(f64),
}

/// A move.
#[derive(Debug, Clone, PartialEq)]
pub struct Move {
    /// Place of its first axis word.
    pub place: Place,
    /// Path of the tip, in machine coordinates.
    pub path: Path,
    /// Tool whose length is no part of `path`; it makes the pose of the machine from that of the
    /// tip.
    pub tool: ToolLength,
    /// End in the coordinates of the program, in the machine's order.
    pub programmed: Coordinates,
    /// Feed.
    pub feed: Feed,
    /// Whether the overrides have no effect (tapping, M49, M50 P0).
    pub fixed: bool,
    /// Whether to stop at the end (G61, G61.1, cycles).
    pub exact_stop: bool,
    /// Largest distance of a blended corner from the programmed one, mm (G64 P); `None` is the
    /// machine's.
    pub tolerance: Option<f64>,
    /// Largest distance of a joined path from the blocks that are joined to it, mm (G64 Q); 0 joins
    /// none, `None` is half of the tolerance, of which the corners then have the other half.
    pub joining: Option<f64>,
}

/// Which edge of the probe ends a probe move.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProbeKind {
    /// G38.2, G38.3: until the probe touches.
    Towards,
    /// G38.4, G38.5: until the probe leaves.
    Away,
}

/// A number of an output.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum OutputValue {
    /// M62 to M65: on or off.
    Digital(bool),
    /// M67, M68: a value.
    Analogue(f64),
}

/// Edge or level of an input that M66 waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WaitFor {
    /// L0: do not wait.
    Nothing,
    /// L1: rising edge.
    Rise,
    /// L2: falling edge.
    Fall,
    /// L3: high.
    High,
    /// L4: low.
    Low,
}

/// Step of a program.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// Move.
    Move(Move),
    /// Dwell.
    Dwell {
        /// Place of the G4, or of the cycle.
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
    /// Coolant command, on a machine that has coolant.
    Coolant {
        /// Place of the M word.
        place: Place,
        /// Coolant 2, mist (M7).
        mist: bool,
        /// Coolant 1, flood (M8).
        flood: bool,
    },
    /// Tool change: the operator, or a changer, fits the tool.
    ToolChange {
        /// Place of the M6.
        place: Place,
        /// Number of the tool; 0 is none.
        tool: u32,
    },
    /// Output command.
    Output {
        /// Place of the M word.
        place: Place,
        /// Number of the output.
        number: u16,
        /// Its value.
        value: OutputValue,
        /// Whether it takes effect with the start of the next move (M62, M63, M67).
        with_motion: bool,
    },
    /// Wait for an input (M66).
    Wait {
        /// Place of the M66.
        place: Place,
        /// Number of the input.
        number: u16,
        /// Whether the input is an analogue one (E).
        analogue: bool,
        /// What to wait for.
        until: WaitFor,
        /// Longest wait, seconds.
        seconds: f64,
    },
    /// Probe move: a straight move that ends where the probe changes.
    Probe {
        /// The move to the programmed end.
        step: Move,
        /// The edge that ends it.
        kind: ProbeKind,
        /// Whether it is an error if the probe does not change (G38.2, G38.4).
        must_change: bool,
    },
    /// Message for the operator: (MSG,) (PRINT,) (DEBUG,), and the comment of a pause.
    Message {
        /// Place of the comment.
        place: Place,
        /// Its text, with the values of its parameters.
        text: String,
    },
}

impl Step {
    /// Returns the place of the step in the program.
    pub fn place(&self) -> Place {
        match self {
            Step::Move(step) | Step::Probe { step, .. } => step.place,
            Step::Dwell { place, .. }
            | Step::Spindle { place, .. }
            | Step::Pause { place }
            | Step::Coolant { place, .. }
            | Step::ToolChange { place, .. }
            | Step::Output { place, .. }
            | Step::Wait { place, .. }
            | Step::Message { place, .. } => *place,
        }
    }
}
