//! The tool of the plant: the process at it, its pose, and the contacts of probe and tool setter.

use super::{Plant, middles};
use crate::check::PlantError;
use crate::process::{CuttingConfig, Process, ProcessConfig, ToolPose};
use crate::random::Random;
use haptimill_protocol::message::MAX_AXES;

impl Plant {
    /// Replaces the spindle and the process of the machine.
    ///
    /// # Errors
    /// All problems of the configuration, or the joints move no tool.
    pub fn fit(&mut self, config: &ProcessConfig) -> Result<(), Vec<PlantError>> {
        let joints = self.joints.iter().map(|joint| &joint.config);
        let joints = joints.filter(|joint| joint.gantry_of.is_none());
        let kinds: Vec<_> = joints.map(|joint| joint.kind).collect();
        let geometry = self.geometry.as_ref();
        if !geometry.is_some_and(|geometry| geometry.has_tool(&kinds)) {
            return Err(vec![PlantError {
                field: "process".into(),
                problem: "needs a geometry with a tool that the joints move".into(),
            }]);
        }
        self.update_ground_truth();
        self.process_load = [0.0; MAX_AXES];
        self.process = Some(Process::new(
            config,
            f64::from(self.period_us) * 1e-6,
            &self.tool_pose(),
            Random::new(self.seed, 48),
        )?);
        Ok(())
    }

    /// Clamps a workpiece on the table. The tool keeps its position, in the air or inside the
    /// material. The function acts like [`Plant::fit`], but keeps spindle and sensor.
    ///
    /// # Errors
    /// As [`Plant::fit`].
    pub fn clamp(&mut self, config: &CuttingConfig) -> Result<(), Vec<PlantError>> {
        let pose = self.tool_pose();
        match &mut self.process {
            Some(process) => process.clamp(config, &pose),
            None => self.fit(&ProcessConfig {
                cutting: Some(config.clone()),
                ..ProcessConfig::default()
            }),
        }
    }

    /// The process at the tool; `None` on a machine without one.
    pub const fn process(&self) -> Option<&Process> {
        self.process.as_ref()
    }

    /// The process at the tool, with mutable access for fault injection.
    pub const fn process_mut(&mut self) -> Option<&mut Process> {
        self.process.as_mut()
    }

    /// ADC codes of the force sensor at the start of the period; `None` on a machine without a
    /// sensor.
    pub fn force_codes(&self) -> Option<[i16; 3]> {
        Some(self.process.as_ref()?.sensor()?.codes())
    }

    /// Advances the cutting process by one period. Its force loads the joints in the next period.
    pub(super) fn apply_process(&mut self, rpm: f64) {
        if !self.truth.pose_valid {
            self.truth.force = [0.0; 3];
            self.process_load = [0.0; MAX_AXES];
            return;
        }
        let pose = self.tool_pose();
        let (Some(process), Some(geometry)) = (&mut self.process, &self.geometry) else {
            return;
        };
        let axes = [
            geometry.workpiece_axes(&self.truth.pose),
            geometry.sensor_axes(&self.truth.pose),
        ];
        if process.grinding().is_some() {
            process.set_tool_axes(geometry.tool_axes(&self.truth.pose));
        }
        let applied = process.step(&pose, &axes, rpm);
        let from_tip = process.force_point();
        let rigid = self.truth.pose;
        geometry.place_tip(applied.tip, &mut self.truth.pose);
        self.truth.force = applied.force;
        self.process_load = [0.0; MAX_AXES];
        let joints = middles(&self.gantries, &self.bodies.slide);
        if applied.force != [0.0; 3]
            && let Some(mut loads) = geometry.tool_loads(&joints, &rigid, applied.force, from_tip)
        {
            for gantry in &self.gantries {
                gantry.divide(&mut loads);
            }
            self.process_load = loads;
        }
    }

    /// Tool pose from the slides, without the deflection of the structure.
    pub(super) fn tool_pose(&self) -> ToolPose {
        self.geometry.as_ref().map_or_else(
            || ToolPose::upright([0.0; 3]),
            |geometry| geometry.tool_pose(&self.truth.pose),
        )
    }

    /// Updates the contacts of probe and tool setter. The tip includes the deflection of the
    /// structure.
    pub(super) fn follow_contacts(&mut self) {
        if self.inputs.has_touches() && self.truth.pose_valid {
            let tool = self.tool_pose();
            self.inputs.follow(&tool);
        }
    }
}
