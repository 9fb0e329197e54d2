//! Plan: the whole trajectory of a program.

use super::figures::Figures;
use super::limits::{MachineModel, Settings};
use super::planner::{Keep, Planner};
use super::setpoints::quantise_pose;
use super::track::{SharedTrack, Track};
use super::trajectory::{Cursor, Trajectory};
use haptimill_gcode::{Coordinates, Place, Problems, Program, Refused};
use haptimill_protocol::message::AxisValues;
use haptimill_protocol::setpoint::Setpoint;

/// A checked trajectory.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Start pose, axis units.
    pub start: AxisValues,
    /// Setpoints; the last one is at standstill.
    pub setpoints: Vec<Setpoint>,
    /// Control period, seconds.
    pub period_s: f64,
    /// Figures of the plan.
    pub figures: Figures,
    places: Vec<Place>,
    messages: Vec<(u32, String)>,
    trajectory: Trajectory,
}

impl Plan {
    /// Plans a program.
    ///
    /// # Errors
    ///
    /// Returns every problem with the place of its block: reach, stroke, singularity, soft limits,
    /// feed.
    pub fn new(
        program: &Program,
        settings: &Settings,
        model: &impl MachineModel,
    ) -> Result<Plan, Refused> {
        let mut planner = Planner::keeping(program.start, settings.clone(), model, Keep::All);
        let mut problems = Problems::default();
        problems.note(planner.check_start());
        for step in &program.steps {
            problems.note(planner.step(step));
        }
        problems.note(planner.finish(program.lines));
        problems.take(&program.file, &program.called)?;
        let mut waiting = planner.take_messages();
        let mut messages = Vec::new();
        let (mut setpoints, mut places) = (Vec::new(), Vec::new());
        for (number, planned) in (0..).zip(planner.made()) {
            waiting.take_before(planned.messages, |text| messages.push((number, text)));
            setpoints.push(planned.setpoint);
            places.push(planned.place);
        }
        let last = setpoints.len().saturating_sub(1) as u32;
        waiting.take_before(u32::MAX, |text| messages.push((last, text)));
        Ok(Plan {
            start: quantise_pose(&program.start, settings),
            setpoints,
            period_s: f64::from(settings.period_us) * 1e-6,
            figures: planner.figures(),
            places,
            messages,
            trajectory: planner.into_trajectory(),
        })
    }

    /// Returns the programmed pose at a time, on the exact lines and arcs, mm and degrees. For
    /// calls in sequence; see [`Cursor`].
    pub fn programmed(&self, cursor: &mut Cursor, time_s: f64) -> Coordinates {
        self.trajectory.programmed(cursor, time_s)
    }

    /// Returns pose and rates of the trajectory, with its corners rounded: mm, degrees, and per
    /// second.
    pub fn intended(&self, cursor: &mut Cursor, time_s: f64) -> (Coordinates, Coordinates) {
        self.trajectory.intended(cursor, time_s)
    }

    /// Returns the place in the program of the motion towards a setpoint; the last one for a number
    /// beyond the end.
    pub fn place_of(&self, setpoint: usize) -> Place {
        self.places
            .get(setpoint)
            .or(self.places.last())
            .copied()
            .unwrap_or_default()
    }

    /// Returns the programmed poses and places alone.
    pub(crate) fn into_track(self) -> Track {
        let mut track = Track::of_whole(self.trajectory, self.period_s);
        for place in self.places {
            track.add_place(place);
        }
        track.messages = self.messages.into();
        track
    }

    /// Messages of the program, each with the setpoint towards which the machine moves when it is
    /// due: (MSG,), (PRINT,), (DEBUG,). A pause shows its comment itself.
    pub fn messages(&self) -> &[(u32, String)] {
        &self.messages
    }

    /// Returns the line of the program of the motion towards a setpoint.
    pub fn line_of(&self, setpoint: usize) -> u32 {
        self.place_of(setpoint).line
    }
}

impl From<Plan> for SharedTrack {
    fn from(plan: Plan) -> Self {
        Self::of(plan.into_track())
    }
}
