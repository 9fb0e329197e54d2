//! Configuration of the simulated machine: the `[plant]` section of a machine file.
//!
//! A linear joint uses mm, N, kg and s; a rotary joint uses degrees, N m, kg m^2 and s.
//! [`JointConfig::kind`] selects one of them. *Axis unit* means mm or degrees; *effort* means N or
//! N m.
//!
//! The controller does not read this section. It may differ from the controller's own configuration
//! on purpose: a longer rod, more friction, another index position.

use crate::check::{Check, PlantError};
use crate::contact::{InputLine, TouchConfig, check as check_inputs};
use crate::haptics::HapticConfig;
use crate::joint::JointConfig;
use crate::joint::gantry::check as check_gantries;
use crate::machines::GeometryConfig;
use crate::operator::OperatorConfig;
use crate::process::ProcessConfig;
use crate::process::sensor::SensorConfig;
use crate::process::structure::StructureConfig;
use crate::process::{CutterConfig, CuttingConfig, SpindleConfig, WorkpieceConfig};
use haptimill_protocol::message::MAX_AXES;
use serde::{Deserialize, Serialize};

/// The simulated machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlantConfig {
    /// Seed of all random numbers: start offsets, noise, link errors.
    pub seed: u64,
    /// Integration step, 5 to 50 us. The control period must be a whole multiple of it.
    #[serde(default = "default_substep_us")]
    pub substep_us: u16,
    /// Geometry that the joints move; only a haptic arm alone has none.
    #[serde(default)]
    pub geometry: Option<GeometryConfig>,
    /// Spindle.
    #[serde(default)]
    pub spindle: Option<SpindleConfig>,
    /// Cutter in the spindle; it cuts only when a workpiece is clamped.
    #[serde(default)]
    pub cutter: Option<CutterConfig>,
    /// Workpiece that is clamped from the start, also during homing. [`crate::plant::Plant::clamp`]
    /// clamps one later.
    #[serde(default)]
    pub workpiece: Option<WorkpieceConfig>,
    /// Elastic structure between the joints and the tool; without it the machine is rigid.
    #[serde(default)]
    pub structure: Option<StructureConfig>,
    /// Force sensor under the workpiece.
    #[serde(default)]
    pub sensor: Option<SensorConfig>,
    /// Haptic arm.
    #[serde(default)]
    pub haptic: Option<HapticConfig>,
    /// Operator model at the haptic arm; it holds the handle from the start.
    #[serde(default)]
    pub operator: Option<OperatorConfig>,
    /// Digital inputs.
    #[serde(default)]
    pub input: Vec<InputLine>,
    /// Block that the probe touches.
    #[serde(default)]
    pub probe: Option<TouchConfig>,
    /// Block that is the tool setter.
    #[serde(default)]
    pub tool_setter: Option<TouchConfig>,
    /// Codes of the analog inputs, constant.
    #[serde(default)]
    pub analog_inputs: [i16; 4],
    /// Joints in the machine's order: 1 to 6, or none for a
    /// haptic arm alone.
    #[serde(default)]
    pub joint: Vec<JointConfig>,
}

const fn default_substep_us() -> u16 {
    20
}

impl PlantConfig {
    /// Checks the whole configuration.
    ///
    /// # Errors
    ///
    /// Returns all problems.
    pub fn check(&self, period_us: u16) -> Result<(), Vec<PlantError>> {
        let mut check = Check::default();
        check.within("substep_us".into(), f64::from(self.substep_us), 5.0, 50.0);
        if self.substep_us == 0 || period_us == 0 || !period_us.is_multiple_of(self.substep_us) {
            check.refuse(
                "substep_us".into(),
                format!(
                    "the control period of {period_us} us is not a multiple of it; choose a divisor"
                ),
            );
        }
        let alone = self.joint.is_empty() && self.haptic.is_some() && self.geometry.is_none();
        if (self.joint.is_empty() && !alone) || self.joint.len() > MAX_AXES {
            check.refuse(
                "joint".into(),
                format!("has {} sections; write 1 to {MAX_AXES}", self.joint.len()),
            );
        }
        match &self.geometry {
            Some(geometry) => {
                let joints = self.joint.iter();
                let joints = joints.filter(|joint| joint.gantry_of.is_none());
                let kinds: Vec<_> = joints.map(|joint| joint.kind).collect();
                geometry.check(&kinds, &mut check);
            }
            None if alone => {}
            None => check.refuse(
                "geometry".into(),
                "is missing; write [plant.geometry.MODEL] for the model of [kinematics]".into(),
            ),
        }
        let cutter = self.cutter.clone().unwrap_or_default();
        for problem in self
            .process()
            .and_then(|process| process.check().err())
            .into_iter()
            .flatten()
            .chain(
                self.workpiece
                    .is_none()
                    .then(|| cutter.problems())
                    .into_iter()
                    .flatten(),
            )
        {
            check.refuse(problem.field, problem.problem);
        }
        let haptic = self.haptic.as_ref().and_then(|haptic| haptic.check().err());
        let operator = self
            .operator
            .as_ref()
            .and_then(|operator| operator.check().err());
        for problem in haptic.into_iter().chain(operator).flatten() {
            check.refuse(problem.field, problem.problem);
        }
        if self.operator.is_some() && self.haptic.is_none() {
            check.refuse(
                "operator".into(),
                "needs a haptic arm; add a section [plant.haptic]".into(),
            );
        }
        let touches = [
            ("probe", self.probe.as_ref()),
            ("tool_setter", self.tool_setter.as_ref()),
        ];
        check_inputs(&self.input, touches, &mut check);
        for (index, joint) in self.joint.iter().enumerate() {
            joint.check(
                &format!("joint {index} ({})", joint.name),
                f64::from(self.substep_us),
                &mut check,
            );
        }
        check_gantries(&self.joint, f64::from(self.substep_us), &mut check);
        check.done()
    }

    /// Process at the tool, if the configuration names a part of it.
    #[must_use]
    pub fn process(&self) -> Option<ProcessConfig> {
        let named = self.spindle.is_some()
            || self.cutter.is_some()
            || self.workpiece.is_some()
            || self.structure.is_some()
            || self.sensor.is_some();
        named.then(|| ProcessConfig {
            spindle: self.spindle.clone().unwrap_or_default(),
            cutting: self.workpiece.clone().map(|work| self.cutting(work)),
            wall: None,
            structure: self.structure.clone(),
            sensor: self.sensor.clone(),
        })
    }

    /// Cutter and workpiece of the machine.
    #[must_use]
    pub fn cutting(&self, workpiece: WorkpieceConfig) -> CuttingConfig {
        CuttingConfig {
            cutter: self.cutter.clone().unwrap_or_default(),
            workpiece,
        }
    }
}
