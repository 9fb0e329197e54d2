//! Forward and inverse kinematics, one module per machine.
//!
//! A *pose* holds the coordinates of a part program, *joints* are what the drives move. Both are
//! arrays of axis coordinates, of which a machine uses the first [`Kinematics::axes`]. Every
//! function returns a correct result or a [`PoseError`], never a wrong number.

#![no_std]
// The crate uses integers only; the statics of the haptic arm are the exception.
#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

mod bounded;
pub mod h4;
pub mod haptic_arm;

pub use bounded::{BoundedKinematics, JointLimits, Model};

use haptimill_math::{Acceleration, Coordinate, Rate};
pub use haptimill_protocol::message::{MAX_AXES, PoseError};

/// Pose of the tool in the workpiece frame, in the machine's order of pose coordinates (H-4: x_w,
/// y_w, z_w, theta, alpha).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Pose(pub [Coordinate; MAX_AXES]);

/// Positions of the joints, in the machine's order (H-4: l_1, l_2, l_3, l_4, alpha).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Joints(pub [Coordinate; MAX_AXES]);

/// Rates of pose coordinates or of joints.
pub type Rates = [Rate; MAX_AXES];

/// Accelerations of pose coordinates or of joints.
pub type Accelerations = [Acceleration; MAX_AXES];

/// Positions, rates and accelerations of the joints.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct JointMotion {
    /// Positions.
    pub joints: Joints,
    /// Rates, from the chain rule instead of differences.
    pub rates: Rates,
    /// Accelerations, from the chain rule, with the term of the changing Jacobian.
    pub accelerations: Accelerations,
}

/// The Jacobian d(joint)/d(pose): row = joint, column = pose coordinate, Q32 per ratio of axis
/// units.
///
/// An entry between a linear joint and a rotary pose coordinate is in 2^-20 mm per 2^-32 turn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Jacobian(pub [[i64; MAX_AXES]; MAX_AXES]);

/// Kinematics of a machine.
///
/// A new machine needs one module with this trait, one configuration struct and one row in the
/// conformance suite.
pub trait Kinematics {
    /// Number of pose coordinates, which is also the number of joints.
    fn axes(&self) -> usize;

    /// Joints of a pose.
    ///
    /// # Errors
    /// A [`PoseError`] if the machine cannot reach the pose.
    fn inverse(&self, pose: &Pose) -> Result<Joints, PoseError>;

    /// Joints of a moving pose, with their rates and accelerations.
    ///
    /// # Errors
    /// As [`Kinematics::inverse`].
    fn inverse_motion(
        &self,
        pose: &Pose,
        rates: &Rates,
        accelerations: &Accelerations,
    ) -> Result<JointMotion, PoseError>;

    /// Pose of the joints, certified to be on the configured assembly branch.
    ///
    /// # Errors
    /// A [`PoseError`] if the joints have no certified pose.
    fn forward(&self, joints: &Joints) -> Result<Pose, PoseError>;

    /// Largest fraction of its maximum rate that any joint reaches at a pose, for pose rates of at
    /// most these magnitudes in any direction. The result is in 2^-16, one value per entry of
    /// `rates` (at most two), and 0 if the maximum rates are unknown.
    ///
    /// # Errors
    /// As [`Kinematics::inverse`], if the machine cannot take all poses of the box.
    fn load(&self, low: &Pose, high: &Pose, rates: &[Rates]) -> Result<[u32; 2], PoseError> {
        let _ = rates;
        for corner in 0..1_u32 << MAX_AXES {
            let mut pose = *low;
            for (axis, place) in pose.0.iter_mut().enumerate() {
                if corner & (1 << axis) != 0 {
                    *place = high.0[axis];
                }
            }
            self.inverse(&pose)?;
        }
        Ok([0; 2])
    }

    /// Jacobian at a pose.
    ///
    /// # Errors
    /// As [`Kinematics::inverse`].
    fn jacobian(&self, pose: &Pose) -> Result<Jacobian, PoseError>;
}
