//! Kinematics of a configured machine: its geometry and the strokes of its joints.
//!
//! The controller and the host use this module. A [`BoundedKinematics`] returns only joints within
//! their strokes; a geometry alone has no strokes.
//!
//! Soft limits of the pose are not checked here. Callers must check them in the motion.

use super::machines::{AnyMachine, Model};
use super::{
    Accelerations, BoxBounds, Jacobian, JointMotion, Joints, Kinematics, Pose, PoseError, Rates,
};
use crate::descriptor::Descriptor;
use haptimill_math::{Angle, Coordinate, Length, Rate};
use haptimill_protocol::message::MAX_AXES;

/// Stroke and maximum rate of a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct JointLimits {
    /// Lower end of the stroke.
    pub low: Coordinate,
    /// Upper end of the stroke.
    pub high: Coordinate,
    /// Maximum rate, axis units per second.
    pub rate: Rate,
}

/// A geometry with the strokes and maximum rates of its joints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct BoundedKinematics {
    machine: AnyMachine,
    /// Lower and upper end of each joint's stroke.
    strokes: [(Coordinate, Coordinate); MAX_AXES],
    /// Lower ends and lengths of the strokes; a joint that the geometry lacks has no limits.
    lows: [Coordinate; MAX_AXES],
    widths: [u32; MAX_AXES],
    /// Maximum rates of the joints, and 2^48 / maximum; a maximum of at most 2^16 axis units per
    /// second counts as 2^16 + 1 in the latter.
    rates: Rates,
    inverse_rates: [u32; MAX_AXES],
}

impl BoundedKinematics {
    /// The geometry of `model` with the limits of each joint, in the model's order.
    ///
    /// A joint without limits must be at 0.
    #[must_use]
    pub fn new(model: &Model, limits: impl IntoIterator<Item = JointLimits>) -> Self {
        let machine = AnyMachine::new(model);
        let mut strokes = [(Coordinate::ZERO, Coordinate::ZERO); MAX_AXES];
        let mut rates = Rates::default();
        for (index, joint) in limits.into_iter().take(MAX_AXES).enumerate() {
            strokes[index] = (joint.low, joint.high);
            rates[index] = joint.rate;
        }
        let axes = machine.descriptor().axes();
        let widths = core::array::from_fn(|index| match strokes[index] {
            _ if index >= axes => u32::MAX,
            (low, high) if low <= high => high.0.wrapping_sub(low.0) as u32,
            _ => 0,
        });
        Self {
            machine,
            rates,
            inverse_rates: rates
                .map(|rate| ((1_u64 << 48) / rate.0.max((1 << 16) + 1) as u64) as u32),
            strokes,
            lows: strokes.map(|(low, _)| low),
            widths,
        }
    }

    /// Coordinates and joints of the machine.
    #[must_use]
    pub const fn descriptor(&self) -> &'static Descriptor {
        self.machine.descriptor()
    }

    /// Signed distance from the nearest singularity, positive on the configured branch. `None` on a
    /// machine without singularities.
    ///
    /// # Errors
    /// [`PoseError::Geometry`], [`PoseError::Unreachable`].
    pub fn singularity_distance(&self, pose: &Pose) -> Option<Result<Length, PoseError>> {
        self.machine.singularity_distance(pose)
    }

    /// Angles by which a pose turns the force sensor against gravity: tilt about x, then turn about
    /// the table's normal.
    #[must_use]
    #[inline]
    pub fn sensor_rotation(&self, pose: &Pose) -> [Angle; 2] {
        self.machine.sensor_rotation(pose)
    }

    /// Pose coordinate that moves while a joint searches its reference.
    #[must_use]
    pub fn search_coordinate(&self, joint: usize) -> usize {
        self.machine.search_coordinate(joint).min(MAX_AXES - 1)
    }

    /// Pose rates, axis units per second, with which a joint searches its reference.
    #[must_use]
    pub fn search_rates(&self, joint: usize, pose: &Pose, rate: i64) -> [i64; MAX_AXES] {
        self.machine.search_rates(joint, pose, rate)
    }

    /// Maximum rates of the joints.
    #[must_use]
    pub const fn rates(&self) -> &Rates {
        &self.rates
    }

    /// Strokes: lower and upper end of each joint.
    #[must_use]
    pub const fn strokes(&self) -> &[(Coordinate, Coordinate); MAX_AXES] {
        &self.strokes
    }

    /// Checks the strokes; the first joint outside its stroke is the error.
    #[inline]
    fn check_strokes(&self, joints: &Joints) -> Result<(), PoseError> {
        // A joint below its stroke wraps around to a large positive number.
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

    /// Checks that no joint passes the half turn, where its stroke ends: an arc with both ends in
    /// the stroke does not go round the other way.
    #[inline]
    fn check_arcs(&self, [low, high]: &[Joints; 2]) -> Result<(), PoseError> {
        for axis in 0..MAX_AXES {
            let place = |joints: &Joints| joints.0[axis].wrapping_sub(self.lows[axis]).0 as u32;
            if self.widths[axis] != u32::MAX && place(low) > place(high) {
                return Err(PoseError::Unreachable);
            }
        }
        Ok(())
    }

    /// Error for the first joint outside its stroke.
    #[cold]
    #[inline(never)]
    fn out_of_stroke(&self, joints: &Joints) -> PoseError {
        let ends = joints.0.iter().zip(&self.strokes).take(self.axes());
        let mut found = PoseError::Unreachable;
        for (index, (joint, (low, high))) in ends.enumerate().rev() {
            let by = if joint > high {
                joint.saturating_sub(*high)
            } else if joint < low {
                joint.saturating_sub(*low)
            } else {
                continue;
            };
            found = PoseError::OutOfStroke {
                joint: index as u8,
                by: by.0,
            };
        }
        found
    }
}

impl Kinematics for BoundedKinematics {
    fn axes(&self) -> usize {
        self.descriptor().axes()
    }

    fn inverse(&self, pose: &Pose) -> Result<Joints, PoseError> {
        let joints = self.machine.inverse(pose)?;
        self.check_strokes(&joints)?;
        Ok(joints)
    }

    fn inverse_motion(
        &self,
        pose: &Pose,
        rates: &Rates,
        accelerations: &Accelerations,
    ) -> Result<JointMotion, PoseError> {
        let mut motion = JointMotion::default();
        self.solve(pose, rates, accelerations, &mut motion)?;
        Ok(motion)
    }

    #[inline(never)]
    fn solve(
        &self,
        pose: &Pose,
        rates: &Rates,
        accelerations: &Accelerations,
        motion: &mut JointMotion,
    ) -> Result<(), PoseError> {
        self.machine.solve(pose, rates, accelerations, motion)?;
        self.check_strokes(&motion.joints)
    }

    #[inline(never)]
    fn forward(&self, joints: &Joints) -> Result<Pose, PoseError> {
        self.check_strokes(joints)?;
        self.machine.forward(joints)
    }

    fn jacobian(&self, pose: &Pose) -> Result<Jacobian, PoseError> {
        self.machine.jacobian(pose)
    }

    fn box_bounds(&self, low: &Pose, high: &Pose, rates: &[Rates]) -> Result<BoxBounds, PoseError> {
        let bounds = self.machine.box_bounds(low, high, rates)?;
        for joints in &bounds.joints {
            self.check_strokes(joints)?;
        }
        self.check_arcs(&bounds.joints)?;
        Ok(bounds)
    }

    #[inline(never)]
    fn rate_utilisation(
        &self,
        low: &Pose,
        high: &Pose,
        rates: &[Rates],
    ) -> Result<[u32; 2], PoseError> {
        let bounds = self.box_bounds(low, high, rates)?;
        let mut utilisations = [0; 2];
        for (utilisation, bounds) in utilisations.iter_mut().zip(&bounds.rates) {
            for (bound, inverse) in bounds.iter().zip(&self.inverse_rates) {
                let part = (u64::from(*bound) * u64::from(*inverse)) >> 32;
                *utilisation = (part as u32).max(*utilisation);
            }
        }
        Ok(utilisations)
    }
}
