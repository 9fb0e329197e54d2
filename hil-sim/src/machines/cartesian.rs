//! Machines without a linkage: a tool on three slides, and joints that carry nothing.
//!
//! Units: mm and degrees; the tool points down along z.

use super::Geometry;
use super::carriage_errors::{CarriageErrors, ErrorModel};
use crate::check::Check;
use crate::joint::JointKind;
use crate::joint::mechanics::JointArray;
use crate::process::ToolPose;
use haptimill_protocol::message::MAX_AXES;
use serde::{Deserialize, Serialize};

/// Section `[plant.geometry.cartesian]`: errors of the slides' directions. At 0 the slides are
/// square to each other.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CartesianConfig {
    /// Squareness error of y to x: displacement of the tool in x per mm of y, +-0.1.
    pub squareness_xy: f64,
    /// Squareness error of z to x: displacement of the tool in x per mm of z, +-0.1.
    pub squareness_xz: f64,
    /// Squareness error of z to y: displacement of the tool in y per mm of z, +-0.1.
    pub squareness_yz: f64,
    /// Geometric errors of the slides: the text of an error file, see docs/volumetric.md. Empty for
    /// none.
    pub errors: String,
    /// Model that turns them into the error of the tool.
    pub error_model: ErrorModel,
}

/// A tool on three slides.
#[derive(Debug, Clone)]
pub struct Cartesian {
    config: CartesianConfig,
    errors: Option<CarriageErrors>,
}

impl Geometry for Cartesian {
    type Config = CartesianConfig;

    fn check(config: &CartesianConfig, kinds: &[JointKind], check: &mut Check) {
        if kinds != [JointKind::Linear; 3] {
            check.refuse(
                "geometry: cartesian".into(),
                "needs three linear joints: x, y and z".into(),
            );
        }
        for (name, value) in [
            ("squareness_xy", config.squareness_xy),
            ("squareness_xz", config.squareness_xz),
            ("squareness_yz", config.squareness_yz),
        ] {
            check.within(format!("geometry: cartesian: {name}"), value, -0.1, 0.1);
        }
        if let Err(problem) = CarriageErrors::parse(&config.errors, config.error_model) {
            check.refuse("geometry: cartesian: errors".into(), problem);
        }
    }

    fn carriage_errors(config: &CartesianConfig) -> Result<Option<(&str, CarriageErrors)>, String> {
        let errors = CarriageErrors::parse(&config.errors, config.error_model)?;
        Ok(errors.map(|errors| (config.errors.as_str(), errors)))
    }

    fn new(config: &CartesianConfig, _: &JointArray) -> Result<Self, String> {
        Ok(Self {
            config: config.clone(),
            errors: CarriageErrors::parse(&config.errors, config.error_model)?,
        })
    }

    fn follow(&mut self, joints: &JointArray, pose: &mut JointArray) -> bool {
        let CartesianConfig {
            squareness_xy,
            squareness_xz,
            squareness_yz,
            ..
        } = self.config;
        let [x, y, z, ..] = *joints;
        *pose = [0.0; MAX_AXES];
        pose[0] = x + squareness_xy * y + squareness_xz * z;
        pose[1] = y + squareness_yz * z;
        pose[2] = z;
        if let Some(errors) = &mut self.errors {
            let error = errors.follow([x, y, z]);
            pose.iter_mut()
                .zip(error)
                .for_each(|(place, by)| *place += by);
        }
        true
    }

    fn tool_pose(&self, pose: &JointArray) -> ToolPose {
        ToolPose::upright([pose[0], pose[1], pose[2]])
    }

    /// The transposed Jacobian of [`Geometry::follow`], by virtual work.
    fn joint_loads(
        &self,
        _: &JointArray,
        _: &JointArray,
        [x, y, z]: [f64; 3],
        _: f64,
    ) -> Option<JointArray> {
        let config = &self.config;
        let mut loads = [0.0; MAX_AXES];
        loads[0] = x;
        loads[1] = y + config.squareness_xy * x;
        loads[2] = z + config.squareness_xz * x + config.squareness_yz * y;
        Some(loads)
    }
}

/// Section `[plant.geometry.joints]`; it has no keys.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BareJointsConfig {}

/// Joints that carry nothing, for tests of drives: the first three are x, y and z of a tool where
/// they are linear.
#[derive(Debug, Clone)]
pub struct BareJoints {}

impl Geometry for BareJoints {
    type Config = BareJointsConfig;

    fn check(_: &BareJointsConfig, _: &[JointKind], _: &mut Check) {}

    fn has_tool(kinds: &[JointKind]) -> bool {
        kinds.starts_with(&[JointKind::Linear; 3])
    }

    fn new(_: &BareJointsConfig, _: &JointArray) -> Result<Self, String> {
        Ok(Self {})
    }

    fn follow(&mut self, joints: &JointArray, pose: &mut JointArray) -> bool {
        *pose = *joints;
        true
    }

    fn tool_pose(&self, pose: &JointArray) -> ToolPose {
        ToolPose::upright([pose[0], pose[1], pose[2]])
    }

    fn joint_loads(
        &self,
        _: &JointArray,
        _: &JointArray,
        force: [f64; 3],
        _: f64,
    ) -> Option<JointArray> {
        let mut loads = [0.0; MAX_AXES];
        loads[..3].copy_from_slice(&force);
        Some(loads)
    }
}
