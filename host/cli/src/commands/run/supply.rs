//! What a run takes its setpoints from.

use super::args::RunArgs;
use super::stream::StreamEnd;
use crate::commands::program::{Pauses, Planned};
use haptimill_client::client::Setpoints;
use haptimill_client::session::TimeTable;
use haptimill_machine_file::MachineFile;
use haptimill_planner::SharedTrack;
use haptimill_protocol::setpoint::Setpoint;

/// The setpoints of a run, with the programmed motion.
pub(super) struct Supply {
    pub(super) setpoints: Setpoints,
    pub(super) shown: Shown,
    /// The end of a streamed program.
    pub(super) end: Option<StreamEnd>,
}

/// What the operator sees of a run.
pub(super) struct Shown {
    pub(super) track: SharedTrack,
    pub(super) pauses: Pauses,
    /// Times of a program that was planned before.
    pub(super) times: Option<Times>,
}

/// Times of a planned program.
pub(super) struct Times {
    /// Duration as programmed, seconds.
    pub(super) programmed_s: f64,
    /// Duration at the overrides of the arguments, seconds.
    pub(super) duration_s: f64,
    /// The setpoints, for the time that is left; none in the simulator, which has no pace.
    setpoints: Vec<Setpoint>,
}

impl Times {
    /// The time that is left at overrides of feed and of rapid moves, percent.
    pub(super) fn left(&self, machine: &MachineFile, [feed, rapid]: [u8; 2]) -> Option<TimeTable> {
        let is_known = !self.setpoints.is_empty();
        is_known.then(|| TimeTable::new(machine, &self.setpoints, feed, rapid))
    }
}

impl Supply {
    pub(super) fn of(planned: Planned, args: &RunArgs, machine: &MachineFile) -> Self {
        let Planned {
            mut plan, pauses, ..
        } = planned;
        let duration_s = args.duration_s(machine, &plan);
        let setpoints = std::mem::take(&mut plan.setpoints);
        let times = Times {
            programmed_s: plan.figures.duration_s,
            duration_s,
            setpoints: if args.port.is_simulated() {
                Vec::new()
            } else {
                setpoints.clone()
            },
        };
        Self {
            setpoints: setpoints.into(),
            shown: Shown {
                pauses,
                track: plan.into(),
                times: Some(times),
            },
            end: None,
        }
    }
}
