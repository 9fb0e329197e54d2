//! Moves and touches of which a probing cycle is made.

use super::args::CycleArgs;
use crate::commands::jog::coordinate_index;
use crate::commands::probing::probe_along;
use crate::commands::{CliError, Exit};
use haptimill_client::session::{NoObserver, PortLine, Session, plan_straight_move};
use haptimill_firmware::config::AxisKind;
use haptimill_gcode::Coordinates;
use haptimill_kinematics::descriptor::Role;
use haptimill_machine_file::MachineFile;

/// The host's number of the moves of a cycle.
const MOVE_JOB: u32 = 3;

/// A session that probes.
pub(super) struct Prober<'a> {
    pub(super) session: Session<PortLine>,
    pub(super) machine: MachineFile,
    pub(super) input: u8,
    pub(super) shared: &'a CycleArgs,
}

impl Prober<'_> {
    /// The commanded pose, mm and degrees.
    pub(super) fn here(&mut self) -> Result<Coordinates, CliError> {
        let status = self.session.status()?;
        Ok(self.session.model().to_engineering_units(&status.commanded))
    }

    /// Moves along a straight line.
    pub(super) fn go(&mut self, to: Coordinates) -> Result<(), CliError> {
        let from = self.session.status()?.commanded;
        let model = self.session.model();
        let to = model.to_axis_units(&to);
        if from == to {
            return Ok(());
        }
        let feed = Some(self.shared.search_feed);
        let plan = plan_straight_move(&self.machine, model, &from, &to, feed)?;
        let end = self
            .session
            .run_job(MOVE_JOB, from, plan.setpoints, &mut NoObserver)?;
        Ok(self.session.check_completed(&end)?)
    }

    /// One touch along an axis; `None` without a contact.
    fn approach(&mut self, axis: usize, distance: f64, feed: f64) -> Result<Option<f64>, CliError> {
        let from = self.session.status()?.commanded;
        let model = self.session.model();
        let mut to = model.to_engineering_units(&from);
        to[axis] += distance;
        let to = model.to_axis_units(&to);
        let plan = plan_straight_move(&self.machine, model, &from, &to, Some(feed))?;
        let contact = probe_along(&mut self.session, plan, self.input, false)?;
        let model = self.session.model();
        Ok(contact.map(|contact| model.to_engineering_units(&contact.pose)[axis]))
    }

    /// Touches twice along an axis, the second time slowly, and returns to the start.
    pub(super) fn touch(&mut self, axis: usize, distance: f64) -> Result<f64, CliError> {
        let start = self.here()?;
        let name = self.machine.io.inputs[usize::from(self.input)].clone();
        let missing = |what: &str| {
            let what = format!("{what} without a contact of {name}");
            CliError::new(Exit::Command, what)
        };
        let Some(first) = self.approach(axis, distance, self.shared.search_feed)? else {
            self.go(start)?;
            let axis = &self.machine.pose[axis].name;
            return Err(missing(&format!("the probe moved {axis} by {distance} mm")));
        };
        let sign = distance.signum();
        let back_off = self.shared.back_off;
        let mut back = start;
        // Not beyond the start, where the way is known to be free.
        back[axis] = if (first - sign * back_off - start[axis]) * sign > 0.0 {
            first - sign * back_off
        } else {
            start[axis]
        };
        self.go(back)?;
        let way = (first - back[axis]) + sign * back_off;
        let second = self.approach(axis, way, self.shared.feed)?;
        self.go(start)?;
        second.ok_or_else(|| missing("the second touch ended"))
    }

    /// Touches both walls along an axis and moves to the middle.
    pub(super) fn walls(
        &mut self,
        axis: usize,
        mut touch: impl FnMut(&mut Self, f64) -> Result<f64, CliError>,
    ) -> Result<(f64, f64), CliError> {
        let (low, high) = (touch(self, -1.0)?, touch(self, 1.0)?);
        let mut middle = self.here()?;
        middle[axis] = f64::midpoint(low, high);
        self.go(middle)?;
        Ok((f64::midpoint(low, high), (high - low).abs()))
    }

    /// From above: out along an axis, down, touches on the way back, up and back.
    pub(super) fn touch_beside(
        &mut self,
        [axis, z]: [usize; 2],
        out: f64,
        depth: f64,
    ) -> Result<f64, CliError> {
        let above = self.here()?;
        let mut beside = above;
        beside[axis] += out;
        self.go(beside)?;
        let mut low = beside;
        low[z] -= depth;
        self.go(low)?;
        let found = self.touch(axis, -out);
        // Up before anything else, also without a contact.
        self.go(beside)?;
        self.go(above)?;
        found
    }

    /// Index of a linear coordinate by name or letter.
    pub(super) fn linear_coordinate(&self, name: &str) -> Result<usize, CliError> {
        let axis = coordinate_index(&self.machine, name)?;
        if self.machine.pose[axis].kind == AxisKind::Linear {
            return Ok(axis);
        }
        let what = format!("{name} is a rotary coordinate; probe along a linear one");
        Err(CliError::new(Exit::Usage, what))
    }

    /// Index of the coordinate that moves the tool along x, y or z.
    pub(super) fn tool_axis(&self, role: Role) -> Result<usize, CliError> {
        let descriptor = self.machine.config.model.descriptor();
        descriptor.coordinate(role).ok_or_else(|| {
            let what = format!(
                "{}: no coordinate moves the tool along {}; probe along single coordinates with `edge`",
                self.machine.file,
                match role {
                    Role::ToolX => "x",
                    Role::ToolY => "y",
                    _ => "z",
                }
            );
            CliError::new(Exit::BadInput, what)
        })
    }
}
