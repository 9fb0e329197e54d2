//! The outcome of a session, and its table.

use super::{LatencyFigures, MasterForce};
use haptimill_protocol::haptic::COMPONENTS;
use haptimill_protocol::message::State;
use serde::Serialize;
use std::fmt::Write as _;

/// One row of the table. Positions in mm, forces in N.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Row {
    /// Seconds since the start.
    pub time_s: f64,
    /// State of the machine's controller.
    pub state: State,
    /// Position of the master's tip from its home, of the newest sample.
    pub master: [f64; COMPONENTS],
    /// Directions of the x and z axes of the master's handle, in the frame of its base.
    pub axes: [[f64; COMPONENTS]; 2],
    /// The enabling switch is pressed.
    pub enabling_switch: bool,
    /// Age of the sample, ms.
    pub age_ms: f64,
    /// Commanded position of the tool.
    pub commanded: [f64; COMPONENTS],
    /// Measured position of the tool.
    pub tool: [f64; COMPONENTS],
    /// Force on the tool: the peak of the last revolution.
    pub tool_force: [f64; COMPONENTS],
    /// Forces at the master.
    pub master_force: MasterForce,
}

impl Row {
    /// Names of the columns of [`Row::to_csv`].
    pub const HEAD: &str = "time_s,state,master_x_mm,master_y_mm,master_z_mm,\
        enabling_switch,age_ms,\
        commanded_x_mm,commanded_y_mm,commanded_z_mm,tool_x_mm,tool_y_mm,tool_z_mm,\
        force_x_n,force_y_n,force_z_n,feedback_x_n,feedback_y_n,feedback_z_n,\
        feedback_law_x_n,feedback_law_y_n,feedback_law_z_n,\
        master_axis_x_x,master_axis_x_y,master_axis_x_z,\
        master_axis_z_x,master_axis_z_y,master_axis_z_z\n";

    /// The row as a line of CSV.
    #[must_use]
    pub fn to_csv(&self) -> String {
        /// Writing to a string cannot fail; adding 0 makes -0 a 0.
        fn add(text: &mut String, values: &[f64; COMPONENTS]) {
            for value in values {
                let _ = write!(text, ",{:.4}", value + 0.0);
            }
        }
        let mut text = format!("{:.4},{:?}", self.time_s, self.state);
        add(&mut text, &self.master);
        let _ = write!(
            text,
            ",{},{:.1}",
            u8::from(self.enabling_switch),
            self.age_ms
        );
        for values in [
            &self.commanded,
            &self.tool,
            &self.tool_force,
            &self.master_force.force,
            &self.master_force.feedback,
            &self.axes[0],
            &self.axes[1],
        ] {
            add(&mut text, values);
        }
        text.push('\n');
        text
    }
}

/// A feed hold of the machine.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HoldRecord {
    /// Seconds since the start.
    pub at_s: f64,
    /// The reason.
    pub why: String,
    /// When the machine resumed, s; `None` when it did not.
    pub resumed_s: Option<f64>,
}

/// How a session ended.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Ended {
    /// As intended: its duration was over, or the operator ended it.
    #[default]
    Done,
    /// The operator stopped it, or Ctrl-C.
    Stopped,
    /// The machine latched a fault, or its emergency stop.
    Fault,
    /// The master was lost, or the machine held because of that and was not resumed.
    MasterLost,
    /// A fault disabled the haptic arm.
    HapticFault,
}

/// The outcome of a session.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct TeleopOutcome {
    /// How it ended.
    pub ended: Ended,
    /// Why it did not end as intended, with the remedy; `None` where it did, or where there is
    /// nothing to add.
    pub because: Option<String>,
    /// Duration, s.
    pub duration_s: f64,
    /// Samples of the master that were sent to the machine.
    pub samples_sent: u64,
    /// Feed holds of the machine.
    pub holds: Vec<HoldRecord>,
    /// Commands that were refused, and why.
    pub refused: Vec<String>,
    /// Faults.
    pub faults: Vec<String>,
    /// Other events, each once.
    pub notes: Vec<String>,
    /// Largest magnitude of the force on the tool along x, y, z, N.
    pub largest_force_n: [f64; COMPONENTS],
    /// Largest magnitude of the force at the master, N.
    pub largest_feedback_n: [f64; COMPONENTS],
    /// Latency from the force measured at the tool to the force at the master.
    pub latency: Option<LatencyFigures>,
    /// The latency is exact to the period: both controllers are simulated.
    pub latency_is_exact: bool,
    /// Round-trip time to the machine's controller, ms.
    pub machine_round_trip_ms: f64,
    /// Round-trip time to the master's controller, ms.
    pub master_round_trip_ms: f64,
    /// State of the machine's controller at the end.
    pub final_state: String,
    /// The same in words.
    #[serde(skip)]
    pub final_state_text: String,
    /// The position is known to be right.
    pub position_kept: bool,
}
