//! Instructions per control period of a run on an emulated chip.

use crate::{Error, ErrorKind};
use haptimill_firmware::profiler::STAGES;
use haptimill_hil_sim::remote::Cost;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// Instructions per count of the board's timer: 25 MHz, and 1024 ns per instruction.
pub const INSTRUCTIONS_PER_COUNT: f64 = 40.0 / 1024.0;

/// Instructions in a control period on a chip of 168 MHz with one cycle per instruction.
#[must_use]
pub const fn budget(period_us: u16) -> u32 {
    period_us as u32 * 168
}

/// Converts instructions to counts of the board's timer.
#[must_use]
pub fn counts(instructions: u32) -> u32 {
    (f64::from(instructions) / INSTRUCTIONS_PER_COUNT) as u32
}

/// Name of the file with the instructions, in the folder of a run.
pub const INSTRUCTIONS_FILE: &str = "instructions.json";

/// Instructions of a run.
#[derive(Debug, Clone, serde::Serialize)]
pub struct Instructions {
    /// Control periods in which a program ran.
    pub periods: u64,
    /// Name, mean and maximum of each stage.
    pub stages: Vec<(&'static str, f64, f64)>,
    /// Mean of a whole period.
    pub mean: f64,
    /// Maximum of a whole period in which a program ran.
    pub worst: f64,
    /// Maximum of a whole period in any state.
    pub worst_of_all: f64,
    /// Stack usage, bytes.
    pub stack_bytes: u32,
    /// Peak fill of the receive buffer, bytes.
    pub ring_peak: u32,
    /// Smallest fill of the setpoint queue after its peak while setpoints were still to come;
    /// `None` if none were.
    pub queue_low: Option<u16>,
    /// Peak fill of the setpoint queue.
    pub queue_high: u16,
    /// Control periods that were missed because an earlier one overran.
    pub missed: u64,
}

/// Names of the stages, in their order.
const STAGE_NAMES: [&str; STAGES] = [
    "receive",
    "measure",
    "supervise",
    "command",
    "interpolate",
    "comply",
    "solve",
    "servo",
    "render",
    "report",
    "interlock",
];

impl Instructions {
    /// Converts the counts of the board.
    #[must_use]
    pub fn of(cost: &Cost) -> Self {
        let periods = cost.periods.max(1) as f64;
        let worst = |counts: u32| f64::from(counts) * INSTRUCTIONS_PER_COUNT;
        let mean = |counts: u64| counts as f64 / periods * INSTRUCTIONS_PER_COUNT;
        Self {
            periods: cost.periods,
            stages: (0..STAGES)
                .map(|stage| {
                    (
                        STAGE_NAMES[stage],
                        mean(cost.sums[stage]),
                        worst(cost.worst[stage]),
                    )
                })
                .collect(),
            mean: mean(cost.sums.iter().sum()),
            worst: worst(cost.worst_period),
            worst_of_all: worst(cost.worst_of_all),
            stack_bytes: cost.stack_bytes,
            ring_peak: cost.ring_peak,
            queue_low: cost.queue_low,
            queue_high: cost.queue_high,
            missed: cost.missed,
        }
    }

    /// Converts the counts of a completed run, and writes them into its folder.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write_to(cost: &Mutex<Cost>, dir: &Path) -> Result<Self, Error> {
        let path = dir.join(INSTRUCTIONS_FILE);
        let instructions = Self::of(&cost.lock().unwrap_or_else(PoisonError::into_inner));
        let json = serde_json::to_string_pretty(&instructions)
            .map_err(|error| Error::new(ErrorKind::Internal, error))?;
        std::fs::write(&path, json).map_err(|error| {
            Error::new(ErrorKind::Output, format!("{}: {error}", path.display()))
        })?;
        Ok(instructions)
    }
}
