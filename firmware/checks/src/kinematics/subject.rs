//! Interface of a machine under test, and the random numbers of the tests.

use haptimill_kinematics::{Joints, Kinematics, MAX_AXES, Pose, PoseError};
use haptimill_math::Coordinate;
use heapless::Vec;

/// Millimetres or radians, one for each axis.
pub type Reals = [f64; MAX_AXES];

/// A reproducible sequence (splitmix64).
pub struct Sequence(pub u64);

impl Sequence {
    /// The next 64 bits.
    #[allow(
        clippy::should_implement_trait,
        reason = "it never ends, so it is no iterator's"
    )]
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Returns a number from 0 to 1.
    pub fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / 9_007_199_254_740_992.0
    }

    /// Returns a number from `low` to `high`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Returns a number of either sign whose magnitude is spaced logarithmically from 10^low to
    /// 10^high.
    pub fn logarithmic(&mut self, low: f64, high: f64) -> f64 {
        let size = libm::exp10(self.between(low, high));
        if self.next() & 1 == 0 { size } else { -size }
    }

    /// Returns an integer below `count`.
    pub fn below(&mut self, count: u64) -> u64 {
        self.next() % count
    }
}

/// Distance inside a condition, in millimetres, and whether an error names this condition.
pub type Margin = (f64, fn(&PoseError) -> bool);

/// Distances of a pose inside each condition of a valid answer; negative is outside.
///
/// Each entry names the errors that its violation may give.
pub struct Margins(pub Vec<Margin, 12>);

impl Margins {
    /// Returns the smallest distance.
    pub fn least(&self) -> f64 {
        self.0
            .iter()
            .map(|margin| margin.0)
            .fold(f64::MAX, f64::min)
    }

    /// Returns whether an error is justified: the condition that it names is violated, within
    /// `tolerance`.
    pub fn deserve(&self, error: &PoseError, tolerance: f64) -> bool {
        self.0
            .iter()
            .any(|(margin, names)| *margin <= tolerance && names(error))
    }
}

/// A machine under test, with reference values in f64 from the closure of its loops.
pub trait Subject {
    /// Its kinematics in the firmware.
    type Machine: Kinematics;

    /// Whether the geometry refuses poses within the range of the coordinates.
    const HAS_BOUNDS: bool = true;

    /// Its kinematics in the firmware.
    fn machine(&self) -> &Self::Machine;

    /// Size of a raw unit of each pose coordinate, in millimetres or radians.
    fn pose_units(&self) -> Reals;

    /// Size of a raw unit of each joint.
    fn joint_units(&self) -> Reals;

    /// Returns a pose in the workspace or somewhat outside.
    fn random_pose(&self, sequence: &mut Sequence) -> Reals;

    /// Returns a pose whose distance from one of the bounds is spaced logarithmically, on either
    /// side.
    fn pose_near_a_bound(&self, sequence: &mut Sequence) -> Reals;

    /// Returns any joint positions, also ones without a pose.
    fn random_joints(&self, sequence: &mut Sequence) -> Joints;

    /// Returns the distances of a pose inside the conditions of a valid answer.
    fn margins(&self, pose: &Reals) -> Margins;

    /// The same for a measured pose, whose bounds may lie a little farther out than those of a
    /// commanded one.
    fn measured_margins(&self, pose: &Reals) -> Margins {
        self.margins(pose)
    }

    /// Returns the joint positions that close the loops at a pose; `None` if there are none.
    fn close(&self, pose: &Reals) -> Option<Reals>;

    /// Returns the pose near `guess` at which the joint positions close the loops, by Newton's
    /// method on the closure; `None` if it does not converge.
    fn solve(&self, joints: &Reals, guess: &Reals) -> Option<Reals>;
}

/// Converts raw coordinates to millimetres and radians.
pub fn real(raw: &[Coordinate; MAX_AXES], units: &Reals) -> Reals {
    core::array::from_fn(|axis| raw[axis].0 as f64 * units[axis])
}

/// Converts millimetres and radians to raw coordinates, limited to their range.
pub fn raw(values: &Reals, units: &Reals) -> [Coordinate; MAX_AXES] {
    core::array::from_fn(|axis| {
        let value = if units[axis] == 0.0 {
            0.0
        } else {
            values[axis] / units[axis]
        };
        Coordinate(libm::round(value) as i32)
    })
}

/// Returns the pose of the values.
pub fn raw_pose<S: Subject>(subject: &S, values: &Reals) -> Pose {
    Pose(raw(values, &subject.pose_units()))
}
