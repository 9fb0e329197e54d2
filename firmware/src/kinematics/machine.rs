//! The machine of a configuration: its geometry together with the strokes of its joints.
//!
//! This is what the controller and the host ask. A [`Machine`] answers only for joints within their strokes; the geometry alone (for
//! instance [`H4`]) does not know them.
//!
//! Misuse: soft limits of the pose are not checked here, they belong to the motion.

use super::h4::{BasePose, H4};
use super::{Accelerations, Jacobian, JointMotion, Joints, Kinematics, Pose, PoseError, Rates};
use crate::config::{Config, Model};
use crate::units::{Angle, Coordinate, Length};
use haptimill_protocol::message::MAX_AXES;

/// A geometry and its strokes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Machine {
    geometry: Geometry,
    /// Lower and upper end of each joint's stroke.
    strokes: [(Coordinate, Coordinate); MAX_AXES],
    /// Their lower ends and lengths; a joint that the geometry lacks may be anywhere.
    lows: [Coordinate; MAX_AXES],
    widths: [u32; MAX_AXES],
    /// Maximum rates of the joints, and 2^48 / them; a maximum below 2^16 axis units per second counts as that.
    rates: Rates,
    inverse_rates: [u32; MAX_AXES],
}

/// The geometries that this firmware knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Geometry {
    H4(H4),
    None,
}

impl Machine {
    /// The machine of a configuration.
    ///
    /// A joint that the configuration lacks has no stroke at all: it may only be at 0.
    #[must_use]
    pub fn new(config: &Config) -> Self {
        let geometry = match &config.model {
            Model::H4(lengths) => Geometry::H4(H4::new(lengths)),
            Model::None => Geometry::None,
        };
        let mut strokes = [(Coordinate::ZERO, Coordinate::ZERO); MAX_AXES];
        for (stroke, joint) in strokes.iter_mut().zip(&config.joints) {
            *stroke = (joint.low, joint.high);
        }
        let axes = match &geometry {
            Geometry::H4(arm) => arm.axes(),
            Geometry::None => 0,
        };
        let widths = core::array::from_fn(|index| match strokes[index] {
            _ if index >= axes => u32::MAX,
            (low, high) if low <= high => high.0.wrapping_sub(low.0) as u32,
            _ => 0,
        });
        let mut rates = Rates::default();
        for (rate, joint) in rates.iter_mut().zip(&config.joints) {
            *rate = joint.rate;
        }
        Self {
            geometry,
            rates,
            inverse_rates: rates
                .map(|rate| ((1_u64 << 48) / rate.0.max((1 << 16) + 1) as u64) as u32),
            strokes,
            lows: strokes.map(|(low, _)| low),
            widths,
        }
    }

    /// The tool in the frame of the machine's base, without table and work offsets.
    ///
    /// # Errors
    /// As [`Kinematics::forward`].
    pub fn base_pose(&self, joints: &Joints) -> Result<BasePose, PoseError> {
        self.check_strokes(joints)?;
        match &self.geometry {
            Geometry::H4(arm) => arm.base_pose(joints),
            Geometry::None => Err(PoseError::Unreachable),
        }
    }

    /// [`Kinematics::inverse_motion`], written where it shall be. After an error what stands there is of no use.
    ///
    /// # Errors
    /// As [`Kinematics::inverse_motion`].
    #[inline(never)]
    pub fn place(
        &self,
        pose: &Pose,
        rates: &Rates,
        accelerations: &Accelerations,
        motion: &mut JointMotion,
    ) -> Result<(), PoseError> {
        match &self.geometry {
            Geometry::H4(arm) => arm.place_motion(pose, rates, accelerations, motion)?,
            Geometry::None => *motion = JointMotion::default(),
        }
        self.check_strokes(&motion.joints)
    }

    /// Signed distance from the parallel singularity, positive on the configured branch.
    ///
    /// # Errors
    /// [`PoseError::Tilt`], [`PoseError::Unreachable`].
    pub fn singularity_distance(&self, pose: &Pose) -> Result<Length, PoseError> {
        match &self.geometry {
            Geometry::H4(arm) => arm.singularity_distance(pose),
            Geometry::None => Err(PoseError::Unreachable),
        }
    }

    /// The angle by which a pose turns the table, and what it carries, out of the level.
    #[must_use]
    #[inline]
    pub const fn table(&self, pose: &Pose) -> Angle {
        match &self.geometry {
            Geometry::H4(_) => pose.0[4].angle(),
            Geometry::None => Angle::ZERO,
        }
    }

    /// Maximum rates of the joints.
    #[must_use]
    pub const fn rates(&self) -> &Rates {
        &self.rates
    }

    /// The strokes, lower and upper end of each joint.
    #[must_use]
    pub const fn strokes(&self) -> &[(Coordinate, Coordinate); MAX_AXES] {
        &self.strokes
    }

    /// The first joint outside its stroke is an error.
    #[inline]
    fn check_strokes(&self, joints: &Joints) -> Result<(), PoseError> {
        // Whoever is below wraps around to far above.
        let [a, b, c, d, e, f] = &joints.0;
        let [low_a, low_b, low_c, low_d, low_e, low_f] = &self.lows;
        let [width_a, width_b, width_c, width_d, width_e, width_f] = &self.widths;
        if a.wrapping_sub(*low_a).0 as u32 <= *width_a
            && b.wrapping_sub(*low_b).0 as u32 <= *width_b
            && c.wrapping_sub(*low_c).0 as u32 <= *width_c
            && d.wrapping_sub(*low_d).0 as u32 <= *width_d
            && e.wrapping_sub(*low_e).0 as u32 <= *width_e
            && f.wrapping_sub(*low_f).0 as u32 <= *width_f
        {
            Ok(())
        } else {
            Err(self.out_of_stroke(joints))
        }
    }

    /// The first joint outside its stroke.
    #[cold]
    #[inline(never)]
    fn out_of_stroke(&self, joints: &Joints) -> PoseError {
        let ends = joints.0.iter().zip(&self.strokes).take(self.axes());
        let mut found = PoseError::Unreachable;
        for (axis, (joint, (low, high))) in ends.enumerate().rev() {
            let by = if joint > high {
                joint.saturating_sub(*high)
            } else if joint < low {
                joint.saturating_sub(*low)
            } else {
                continue;
            };
            found = PoseError::OutOfStroke {
                axis: axis as u8,
                by: by.0,
            };
        }
        found
    }
}

impl Kinematics for Machine {
    fn axes(&self) -> usize {
        match &self.geometry {
            Geometry::H4(arm) => arm.axes(),
            Geometry::None => 0,
        }
    }

    fn inverse(&self, pose: &Pose) -> Result<Joints, PoseError> {
        let joints = match &self.geometry {
            Geometry::H4(arm) => arm.inverse(pose)?,
            Geometry::None => Joints::default(),
        };
        self.check_strokes(&joints)?;
        Ok(joints)
    }

    #[inline(never)]
    fn load(&self, pose: &Pose, rates: &[Rates]) -> Result<[u32; 2], PoseError> {
        let Geometry::H4(arm) = &self.geometry else {
            return self.inverse(pose).map(|_| [0; 2]);
        };
        let (joints, bounds) = arm.rate_bounds(pose, rates)?;
        self.check_strokes(&joints)?;
        let mut loads = [0; 2];
        for (load, (rates, [front, rear])) in loads.iter_mut().zip(rates.iter().zip(bounds)) {
            let of_joints = [front, front, rear, rear, rates[4].0.unsigned_abs()];
            for (bound, inverse) in of_joints.iter().zip(&self.inverse_rates) {
                let part = (u64::from(*bound) * u64::from(*inverse)) >> 32;
                *load = part.max(u64::from(*load)) as u32;
            }
        }
        Ok(loads)
    }

    fn inverse_motion(
        &self,
        pose: &Pose,
        rates: &Rates,
        accelerations: &Accelerations,
    ) -> Result<JointMotion, PoseError> {
        let mut motion = JointMotion::default();
        self.place(pose, rates, accelerations, &mut motion)?;
        Ok(motion)
    }

    #[inline(never)]
    fn forward(&self, joints: &Joints) -> Result<Pose, PoseError> {
        self.check_strokes(joints)?;
        match &self.geometry {
            Geometry::H4(arm) => arm.forward(joints),
            Geometry::None => Ok(Pose::default()),
        }
    }

    fn jacobian(&self, pose: &Pose) -> Result<Jacobian, PoseError> {
        match &self.geometry {
            Geometry::H4(arm) => arm.jacobian(pose),
            Geometry::None => Err(PoseError::Unreachable),
        }
    }
}
