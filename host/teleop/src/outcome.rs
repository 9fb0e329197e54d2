//! What came of a session, and its moments.

use super::LatencyFigures;
use haptimill_protocol::haptic::COMPONENTS;
use haptimill_protocol::message::State;
use serde::Serialize;
use std::fmt::Write as _;

/// One moment of a session. Places in mm, forces in N.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Row {
    /// Seconds since the hand may lead.
    pub time_s: f64,
    /// State of the machine's controller.
    pub state: State,
    /// The newest word of the hand; the tip from its home.
    pub hand: [f64; COMPONENTS],
    /// Its button is held.
    pub engaged: bool,
    /// How old it is, ms.
    pub age_ms: f64,
    /// Where the tool is wanted.
    pub commanded: [f64; COMPONENTS],
    /// Where it is measured.
    pub tool: [f64; COMPONENTS],
    /// Force on the tool: the peak of the last revolution.
    pub force: [f64; COMPONENTS],
    /// What the hand is made to feel.
    pub felt: [f64; COMPONENTS],
    /// What the law alone makes of the force.
    pub reflected: [f64; COMPONENTS],
}

impl Row {
    /// Names of the columns of [`Row::line`].
    pub const HEAD: &str = "time_s,state,hand_x_mm,hand_y_mm,hand_z_mm,engaged,age_ms,wanted_x_mm,wanted_y_mm,wanted_z_mm,\
        tool_x_mm,tool_y_mm,tool_z_mm,force_x_n,force_y_n,force_z_n,felt_x_n,felt_y_n,felt_z_n,reflected_x_n,reflected_y_n,reflected_z_n\n";

    /// As a line of a table (CSV).
    #[must_use]
    pub fn line(&self) -> String {
        let mut text = format!("{:.4},{:?}", self.time_s, self.state);
        // Writing to a string cannot fail; adding 0 makes a 0 of -0.
        let mut put = |values: &[f64; COMPONENTS]| {
            for value in values {
                let _ = write!(text, ",{:.4}", value + 0.0);
            }
        };
        put(&self.hand);
        let _ = write!(text, ",{},{:.1}", u8::from(self.engaged), self.age_ms);
        let mut put = |values: &[f64; COMPONENTS]| {
            for value in values {
                let _ = write!(text, ",{:.4}", value + 0.0);
            }
        };
        put(&self.commanded);
        put(&self.tool);
        put(&self.force);
        put(&self.felt);
        put(&self.reflected);
        text.push('\n');
        text
    }
}

/// The machine slowed down and waited.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Stop {
    /// Seconds since the hand may lead.
    pub at_s: f64,
    /// Why, in words.
    pub why: String,
    /// When it was told to go on, s; none when it was not.
    pub resumed_s: Option<f64>,
}

/// How a session ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Ended {
    /// As it was to: its time was over, or the operator ended it.
    Done,
    /// The operator stopped it, or Ctrl-C.
    Stopped,
    /// The machine latched a fault, or its emergency stop.
    Fault,
    /// The hand could lead no more, or the machine held for want of it and was not told to go on.
    #[serde(rename = "hand_lost")]
    MasterLost,
    /// The arm of the hand is off by a fault.
    HapticFault,
}

/// What came of a session.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Outcome {
    /// How it ended.
    pub ended: Ended,
    /// Why it did not end as it was to, with what to do about it; none where it did, or where nothing more is to be said.
    pub because: Option<String>,
    /// How long the hand might lead, s.
    pub duration_s: f64,
    /// Words of the hand that were sent on.
    pub words: u64,
    /// Times that the machine held.
    pub holds: Vec<Stop>,
    /// Orders that were not carried out, and why.
    pub refused: Vec<String>,
    /// Faults, each as a sentence.
    pub faults: Vec<String>,
    /// Other things that happened, each once, as sentences.
    pub notes: Vec<String>,
    /// Largest magnitude of the force on the tool along x, y, z, N.
    pub largest_force_n: [f64; COMPONENTS],
    /// The same of what the hand was made to feel.
    pub largest_felt_n: [f64; COMPONENTS],
    /// From the force sensed at the tool to the force at the hand.
    pub latency: Option<LatencyFigures>,
    /// Whether that is exact, to the period: with both controllers in the simulator.
    pub latency_is_exact: bool,
    /// Time from here to the machine's controller and back, ms.
    pub machine_round_trip_ms: f64,
    /// The same of the hand's.
    pub hand_round_trip_ms: f64,
    /// State of the machine's controller at the end.
    pub final_state: String,
    /// The position is known to be right.
    pub position_kept: bool,
}
