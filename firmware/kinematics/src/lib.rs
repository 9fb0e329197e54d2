//! Forward and inverse kinematics, one module per machine.
//!
//! A *pose* holds the coordinates of a part program, *joints* are what the drives move. Both are
//! arrays of positions in axis units, of which a machine uses the first [`Kinematics::axes`]. Every
//! function returns a correct result or a [`PoseError`], never a wrong number.

#![no_std]
// The crate uses integers only; the statics of the haptic arm are the exception.
#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

mod bounded;
pub mod descriptor;
pub mod haptic_arm;
mod machine;
pub mod machines;
mod planar;

pub use bounded::{BoundedKinematics, JointLimits};
pub use machine::Machine;
pub use machines::*;

use haptimill_math::{Acceleration, Coordinate, Rate};
pub use haptimill_protocol::message::{MAX_AXES, PoseError};

/// Pose of the tool in the workpiece frame, in the order of the descriptor's pose coordinates.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Pose(pub [Coordinate; MAX_AXES]);

/// Positions of the joints, in the order of the descriptor's joints.
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

/// Bounds of the joints and of their rates over a box of poses.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct BoxBounds {
    /// The least and the greatest joints of the poses of the box.
    pub joints: [Joints; 2],
    /// Upper bounds of the magnitudes of the joint rates, axis units per second, for each of at
    /// most two entries of pose rates.
    pub rates: [[u32; MAX_AXES]; 2],
}

/// Kinematics of a machine.
///
/// A new machine is a module with this trait and [`Machine`], its row in the list of [`machines`],
/// and a subject with its row in the conformance suite.
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

    /// Pose of the joints, verified to be on the configured assembly branch.
    ///
    /// # Errors
    /// A [`PoseError`] if the joints have no verified pose.
    fn forward(&self, joints: &Joints) -> Result<Pose, PoseError>;

    /// [`Kinematics::inverse_motion`], written to `motion`. After an error the content of `motion`
    /// is invalid.
    ///
    /// # Errors
    /// As [`Kinematics::inverse`].
    #[inline]
    fn solve(
        &self,
        pose: &Pose,
        rates: &Rates,
        accelerations: &Accelerations,
        motion: &mut JointMotion,
    ) -> Result<(), PoseError> {
        *motion = self.inverse_motion(pose, rates, accelerations)?;
        Ok(())
    }

    /// Bounds of the joints, and of their rates for pose rates of at most these magnitudes in any
    /// direction, over a box of poses.
    ///
    /// # Errors
    /// As [`Kinematics::inverse`], if the machine cannot take all poses of the box.
    fn box_bounds(&self, low: &Pose, high: &Pose, rates: &[Rates]) -> Result<BoxBounds, PoseError>;

    /// Largest fraction of its maximum rate that any joint reaches at a pose of a box, for pose
    /// rates of at most these magnitudes in any direction. The result is in 2^-16, one value per
    /// entry of `rates` (at most two), and 0 if the maximum rates are unknown.
    ///
    /// # Errors
    /// As [`Kinematics::box_bounds`].
    fn rate_utilisation(
        &self,
        low: &Pose,
        high: &Pose,
        rates: &[Rates],
    ) -> Result<[u32; 2], PoseError> {
        self.box_bounds(low, high, rates).map(|_| [0; 2])
    }

    /// Jacobian at a pose.
    ///
    /// # Errors
    /// As [`Kinematics::inverse`].
    fn jacobian(&self, pose: &Pose) -> Result<Jacobian, PoseError>;
}
