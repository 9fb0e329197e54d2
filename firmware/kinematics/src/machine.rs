//! Functions of a machine that general code uses beyond its [`Kinematics`].

use crate::descriptor::Descriptor;
use crate::{Kinematics, Pose, PoseError};
use haptimill_math::{Angle, Length};
use haptimill_protocol::message::MAX_AXES;

/// A machine: its kinematics, its lengths, and the functions that general code uses.
pub trait Machine: Kinematics + Copy {
    /// Lengths of the machine, as the configuration holds them.
    type Geometry;

    /// Coordinates and joints.
    const DESCRIPTOR: Descriptor;

    /// The machine with these lengths. An unsound geometry is accepted; it refuses every pose.
    fn new(geometry: &Self::Geometry) -> Self;

    /// Whether the lengths are within the range of the arithmetic and make a machine.
    fn is_sound(geometry: &Self::Geometry) -> bool;

    /// Signed distance from the nearest singularity, positive on the configured branch. `None` on a
    /// machine without singularities.
    fn singularity_distance(&self, pose: &Pose) -> Option<Result<Length, PoseError>> {
        let _ = pose;
        None
    }

    /// Angles by which a pose turns the force sensor, with the workpiece on it, against gravity:
    /// the tilt of the table about x, then the turn of the sensor on it about the table's normal.
    /// Zero on a machine whose sensor stays level.
    #[inline]
    fn sensor_rotation(&self, pose: &Pose) -> [Angle; 2] {
        let _ = pose;
        [Angle::ZERO; 2]
    }

    /// Whether a joint may move alone, through its whole stroke and whatever the others do, to
    /// search its home switch.
    #[must_use]
    fn joints_move_alone() -> bool {
        true
    }

    /// Pose coordinate that moves while a joint searches its reference. Joints with the same
    /// coordinate are searched together.
    fn search_coordinate(joint: usize) -> usize {
        joint
    }

    /// Pose rates, axis units per second, with which a joint searches its reference: `rate` along
    /// its [`Machine::search_coordinate`], and what has to move along.
    fn search_rates(&self, joint: usize, pose: &Pose, rate: i64) -> [i64; MAX_AXES] {
        let _ = pose;
        let mut rates = [0; MAX_AXES];
        rates[Self::search_coordinate(joint)] = rate;
        rates
    }
}
