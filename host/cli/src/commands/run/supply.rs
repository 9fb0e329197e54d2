//! What a run takes its setpoints from.

use super::args::RunArgs;
use super::stream::StreamEnd;
use crate::commands::program::{Pauses, Planned};
use haptimill_client::client::Setpoints;
use haptimill_machine_file::MachineFile;
use haptimill_planner::SharedTrack;

/// The setpoints of a run, with the programmed motion.
pub(super) struct Supply {
    pub(super) setpoints: Setpoints,
    pub(super) track: SharedTrack,
    pub(super) pauses: Pauses,
    /// Duration of the whole program, seconds, as programmed and at the overrides, if it was
    /// planned before.
    pub(super) duration_s: Option<[f64; 2]>,
    /// The end of a streamed program.
    pub(super) end: Option<StreamEnd>,
}

impl Supply {
    pub(super) fn of(planned: Planned, args: &RunArgs, machine: &MachineFile) -> Self {
        let Planned { plan, pauses, .. } = planned;
        Self {
            duration_s: Some([plan.figures.duration_s, args.duration_s(machine, &plan)]),
            setpoints: plan.setpoints.clone().into(),
            pauses,
            track: plan.into(),
            end: None,
        }
    }
}
