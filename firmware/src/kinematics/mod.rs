//! From poses to joints and back, one file a machine.
//!
//! A *pose* is what a part program speaks of, a *joint* is what a drive moves; both are arrays of axis coordinates of which a machine uses
//! the first [`Kinematics::axes`]. Every function gives a right answer or a [`PoseError`], never a number that is wrong.

pub mod h4;
mod h4_forward;
mod h4_motion;
mod h4_statics;
pub mod haptic;
pub mod haptic_statics;
pub mod machine;

pub use h4_statics::ToolForce;

use crate::units::{Acceleration, Coordinate, Rate};
pub use haptimill_protocol::message::{MAX_AXES, PoseError};

/// A pose of the tool in the work, in the machine's order of pose coordinates (H-4: x_w, y_w, z_w, theta, alpha).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Pose(pub [Coordinate; MAX_AXES]);

/// Positions of the joints, in the machine's order (H-4: l_1, l_2, l_3, l_4, alpha).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Joints(pub [Coordinate; MAX_AXES]);

/// Rates of pose coordinates or of joints.
pub type Rates = [Rate; MAX_AXES];

/// Accelerations of pose coordinates or of joints.
pub type Accelerations = [Acceleration; MAX_AXES];

/// Where the joints are to be, how fast, and with what acceleration.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct JointMotion {
    /// Positions.
    pub joints: Joints,
    /// Rates, from the chain rule, never from differences.
    pub rates: Rates,
    /// Accelerations, likewise, with the term of the changing Jacobian.
    pub accelerations: Accelerations,
}

/// The Jacobian d(joint)/d(pose): row = joint, column = pose coordinate, Q32 per ratio of axis units.
///
/// An entry between a linear joint and a rotary pose coordinate is in 2^-20 mm per 2^-32 turn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Jacobian(pub [[i64; MAX_AXES]; MAX_AXES]);

/// The geometry of a machine.
///
/// Adding a machine is one file with this trait, one configuration struct, one row in the conformance suite.
pub trait Kinematics {
    /// How many pose coordinates, and joints, there are.
    fn axes(&self) -> usize;

    /// The joints of a pose.
    fn inverse(&self, pose: &Pose) -> Result<Joints, PoseError>;

    /// The joints of a pose with their rates and accelerations, for a pose that moves.
    fn inverse_motion(
        &self,
        pose: &Pose,
        rates: &Rates,
        accelerations: &Accelerations,
    ) -> Result<JointMotion, PoseError>;

    /// The pose of the joints, on the assembly branch of the configuration, certified.
    fn forward(&self, joints: &Joints) -> Result<Pose, PoseError>;

    /// The largest part of its maximum rate that any joint reaches at a pose, for pose rates of at most these magnitudes in any direction; in 2^-16, one
    /// for each of `rates` (at most two). 0 where the maximum rates are not known.
    ///
    /// # Errors
    /// As [`Kinematics::inverse`].
    fn load(&self, pose: &Pose, rates: &[Rates]) -> Result<[u32; 2], PoseError> {
        let _ = rates;
        self.inverse(pose).map(|_| [0; 2])
    }

    /// The Jacobian at a pose.
    fn jacobian(&self, pose: &Pose) -> Result<Jacobian, PoseError>;
}
