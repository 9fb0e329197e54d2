//! Comparison of the controller's kinematics with the geometry of the simulated machine.
//!
//! The section `[plant.geometry]` may differ from `[kinematics]` on purpose, by the errors of a
//! real machine: a length that is a little off, axes that are not square. A larger difference is
//! another machine, on which every result is wrong.

use super::MachineFile;
use super::place::unit;
use super::scale::per_unit;
use haptimill_firmware::config::AxisKind;
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::joint::mechanics::JointArray;
use haptimill_hil_sim::machines::GeometryConfig;
use haptimill_kinematics::{Joints, Kinematics, Pose, PoseError};
use haptimill_math::Coordinate;
use haptimill_protocol::message::MAX_AXES;
use std::fmt;

/// Difference, in mm or degrees, from which `haptimill machine check` prints a warning.
pub const WARNING: f64 = 0.01;

/// Difference, in mm or degrees, above which the simulated machine is another one.
pub const ERROR: f64 = 10.0;

/// Largest difference of the poses that the controller and the simulated machine compute from the
/// same joint positions.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PoseDifference {
    /// Poses that both have.
    pub compared: usize,
    /// Poses of the controller that the simulated machine cannot take.
    pub impossible: usize,
    /// Poses of the grid.
    pub grid: usize,
    /// Those that the controller cannot take.
    pub out_of_reach: usize,
    /// Those of them that are beyond the stroke of a joint, by joint.
    pub beyond_stroke: [usize; MAX_AXES],
    /// Largest distance over the linear coordinates, mm.
    pub linear_mm: f64,
    /// Largest difference of a rotary coordinate, degrees.
    pub rotary_deg: f64,
    /// Controller's pose at the larger of the two, mm and degrees: name, value, unit.
    pub at: Vec<(&'static str, f64, &'static str)>,
}

impl PoseDifference {
    /// Compares the poses at the presets and over a grid of the soft limits with `levels` values of
    /// each coordinate. Poses out of reach or with joints beyond their strokes are left out.
    ///
    /// `None` without a geometry of the simulated machine.
    #[must_use]
    pub fn new(machine: &MachineFile, plant: &PlantConfig, levels: u32) -> Option<Self> {
        let geometry = plant.geometry.as_ref()?;
        let kinematics = machine.config.kinematics();
        let mut difference = Self::default();
        // The simulated machine starts at its own presets.
        let mut joints = Joints::default();
        let mut true_joints = JointArray::default();
        for (index, (joint, simulated)) in
            machine.config.joints.iter().zip(&plant.joint).enumerate()
        {
            joints.0[index] = joint.preset;
            true_joints[index] = simulated.preset;
        }
        if let Ok(pose) = kinematics.forward(&joints) {
            difference.add(machine, geometry, &pose, &true_joints);
        }
        let axes = machine.config.pose.len() as u32;
        let levels = levels.max(2);
        let points = levels.checked_pow(axes)?;
        difference.grid = points as usize;
        for point in 0..points {
            let mut pose = Pose::default();
            let mut rest = point;
            for (slot, axis) in pose.0.iter_mut().zip(&machine.config.pose) {
                let part = f64::from(rest % levels) / f64::from(levels - 1);
                rest /= levels;
                let (low, high) = (f64::from(axis.low.0), f64::from(axis.high.0));
                *slot = Coordinate((low + part * (high - low)).round() as i32);
            }
            let joints = match kinematics.inverse(&pose) {
                Ok(joints) => joints,
                Err(error) => {
                    difference.out_of_reach += 1;
                    if let PoseError::OutOfStroke { joint, .. } = error
                        && let Some(count) = difference.beyond_stroke.get_mut(usize::from(joint))
                    {
                        *count += 1;
                    }
                    continue;
                }
            };
            let mut values = JointArray::default();
            let pairs = joints.0.iter().zip(&machine.config.joints);
            for (slot, (value, joint)) in values.iter_mut().zip(pairs) {
                *slot = f64::from(value.0) / per_unit(joint.kind);
            }
            difference.add(machine, geometry, &pose, &values);
        }
        Some(difference)
    }

    fn add(
        &mut self,
        machine: &MachineFile,
        geometry: &GeometryConfig,
        pose: &Pose,
        joints: &JointArray,
    ) {
        let Some(simulated) = geometry.pose(joints) else {
            self.impossible += 1;
            return;
        };
        self.compared += 1;
        let (mut squared, mut rotary) = (0.0, 0.0_f64);
        for ((value, axis), truth) in pose.0.iter().zip(&machine.config.pose).zip(simulated) {
            let off = truth - f64::from(value.0) / per_unit(axis.kind);
            match axis.kind {
                AxisKind::Linear => squared += off * off,
                // Angles are the same after a turn.
                AxisKind::Rotary => {
                    rotary = rotary.max(((off + 180.0).rem_euclid(360.0) - 180.0).abs());
                }
                AxisKind::MultiTurn => rotary = rotary.max(off.abs()),
            }
        }
        let linear = f64::sqrt(squared);
        if linear.max(rotary) >= self.largest() {
            let axes = machine.config.model.descriptor().pose;
            self.at = axes
                .iter()
                .zip(pose.0)
                .map(|(axis, value)| {
                    let unit = unit(axis.kind);
                    (axis.name, f64::from(value.0) / per_unit(axis.kind), unit)
                })
                .collect();
        }
        self.linear_mm = self.linear_mm.max(linear);
        self.rotary_deg = self.rotary_deg.max(rotary);
    }

    /// The larger of the two differences, mm or degrees.
    #[must_use]
    pub const fn largest(&self) -> f64 {
        self.linear_mm.max(self.rotary_deg)
    }

    /// The poses of the grid that are out of reach, and the joint whose stroke ends first for most
    /// of them; `None` if there is none.
    #[must_use]
    pub fn unreached(&self, machine: &MachineFile) -> Option<String> {
        if self.out_of_reach == 0 {
            return None;
        }
        let mut text = format!(
            "{} of {} poses of the grid of the soft limits are out of reach",
            self.out_of_reach, self.grid
        );
        let by_joint = self.beyond_stroke.iter().zip(&machine.joints);
        if let Some((count, joint)) = by_joint.max_by_key(|(count, _)| **count)
            && *count > 0
        {
            text.push_str(&format!(", {count} beyond the stroke of {}", joint.name));
        }
        Some(text)
    }

    /// Whether the difference deserves a warning.
    #[must_use]
    pub const fn is_notable(&self) -> bool {
        self.largest() > WARNING || self.impossible > 0
    }

    /// Whether the simulated machine is another one.
    #[must_use]
    pub const fn is_another_machine(&self) -> bool {
        self.largest() > ERROR || self.compared == 0
    }
}

impl fmt::Display for PoseDifference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.compared == 0 {
            return write!(
                f,
                "the simulated machine reaches none of the {} poses that were tried",
                self.impossible
            );
        }
        write!(
            f,
            "from the same joints its tool is up to {:.4} mm and {:.4} deg from where the \
             controller computes it",
            self.linear_mm, self.rotary_deg
        )?;
        for (index, (name, value, unit)) in self.at.iter().enumerate() {
            let before = if index == 0 { ", at" } else { "," };
            write!(f, "{before} {name} = {value:.1} {unit}")?;
        }
        if self.impossible > 0 {
            let total = self.compared + self.impossible;
            write!(
                f,
                "; it does not reach {} of the {total} poses that were tried",
                self.impossible
            )?;
        }
        Ok(())
    }
}
