//! What a run takes its setpoints from.

use super::args::RunArgs;
use super::stream::StreamEnd;
use crate::commands::CliError;
use crate::commands::program::{Pauses, Planned};
use haptimill_client::client::Setpoints;
use haptimill_client::session::{RunTime, TimeProfile, TimeTable};
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
    /// For the time that is left; none in the simulator, which does not run in real time.
    profile: Option<TimeProfile>,
}

impl Times {
    /// The time that is left at overrides of feed and of rapid moves, percent.
    pub(super) fn left(&self, machine: &MachineFile, [feed, rapid]: [u8; 2]) -> Option<TimeTable> {
        let profile = self.profile.as_ref()?;
        Some(profile.table(machine, feed, rapid))
    }

    /// Times of a checked program, of which `for_each` gives every setpoint if they are needed.
    ///
    /// # Errors
    /// That of `for_each`.
    pub(super) fn of(
        args: &RunArgs,
        machine: &MachineFile,
        programmed_s: f64,
        for_each: impl FnOnce(&mut dyn FnMut(&Setpoint)) -> Result<(), CliError>,
    ) -> Result<Self, CliError> {
        let mut times = Self {
            programmed_s,
            duration_s: programmed_s,
            profile: (!args.port.is_simulated()).then(TimeProfile::default),
        };
        let mut time = RunTime::new(machine, args.feed_override, args.rapid_override);
        if times.profile.is_none() && args.is_at_full_speed() {
            return Ok(times);
        }
        for_each(&mut |setpoint| {
            time.add(setpoint);
            if let Some(profile) = &mut times.profile {
                profile.add(setpoint);
            }
        })?;
        if !args.is_at_full_speed() {
            times.duration_s = time.seconds();
        }
        Ok(times)
    }
}

impl Supply {
    pub(super) fn of(planned: Planned, args: &RunArgs, machine: &MachineFile) -> Self {
        let Planned {
            mut plan, pauses, ..
        } = planned;
        let setpoints = std::mem::take(&mut plan.setpoints);
        let times = Times::of(args, machine, plan.figures.duration_s, |take| {
            setpoints.iter().for_each(take);
            Ok(())
        });
        Self {
            setpoints: setpoints.into(),
            shown: Shown {
                pauses,
                track: plan.into(),
                times: times.ok(),
            },
            end: None,
        }
    }
}
