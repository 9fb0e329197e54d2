//! Interface of a machine under test, and the random numbers of the tests.

use haptimill_kinematics::descriptor::AxisKind;
use haptimill_kinematics::{Joints, MAX_AXES, Machine, Pose, PoseError};
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

/// Unit of a margin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// Millimetres.
    Millimetre,
    /// Radians.
    Radian,
}

impl Unit {
    /// Distance from a bound within which rounding may decide whether a pose is refused: 0.1 um, or
    /// 0.25 urad, which is 0.1 um at a lever of 400 mm.
    #[must_use]
    pub const fn tolerance(self) -> f64 {
        match self {
            Self::Millimetre => 1e-4,
            Self::Radian => 2.5e-7,
        }
    }
}

/// Distance of a pose inside a condition of a valid answer; negative is outside.
#[derive(Debug, Clone, Copy)]
pub struct Margin {
    /// The distance.
    pub distance: f64,
    /// Its unit.
    pub unit: Unit,
    /// Whether an error names this condition.
    pub names: fn(&PoseError) -> bool,
}

impl Margin {
    /// A margin in millimetres.
    #[must_use]
    pub const fn mm(distance: f64, names: fn(&PoseError) -> bool) -> Self {
        Self {
            distance,
            unit: Unit::Millimetre,
            names,
        }
    }

    /// A margin in radians.
    #[must_use]
    pub const fn rad(distance: f64, names: fn(&PoseError) -> bool) -> Self {
        Self {
            distance,
            unit: Unit::Radian,
            names,
        }
    }

    /// The distance as a multiple of [`Unit::tolerance`].
    #[must_use]
    pub fn share(&self) -> f64 {
        self.distance / self.unit.tolerance()
    }
}

/// Margins of a pose, one for each condition of a valid answer. A geometry without bounds has none.
pub struct Margins(pub Vec<Margin, 12>);

impl Margins {
    /// Returns the smallest margin, as a multiple of [`Unit::tolerance`]: below -1 a condition is
    /// violated, above 1 all of them hold.
    pub fn smallest(&self) -> f64 {
        self.0.iter().map(Margin::share).fold(f64::MAX, f64::min)
    }

    /// Returns whether an error is justified: the condition that it names is violated, within
    /// [`Unit::tolerance`].
    pub fn deserve(&self, error: &PoseError) -> bool {
        self.0
            .iter()
            .any(|margin| margin.share() <= 1.0 && (margin.names)(error))
    }
}

/// A machine under test, with reference values in f64 from the closure of its loops.
pub trait Subject {
    /// Its kinematics in the firmware.
    type Machine: Machine;

    /// Whether the geometry refuses poses within the range of the coordinates. A geometry without
    /// bounds must answer every pose of [`Subject::random_pose`], and has no margins.
    const HAS_BOUNDS: bool = true;

    /// Its kinematics in the firmware.
    fn machine(&self) -> &Self::Machine;

    /// Size of a raw unit of each pose coordinate, in millimetres or radians; 0 behind the last.
    fn pose_units(&self) -> Reals {
        units(Self::Machine::DESCRIPTOR.pose.iter().map(|axis| axis.kind))
    }

    /// Size of a raw unit of each joint, in millimetres or radians; 0 behind the last.
    fn joint_units(&self) -> Reals {
        units(
            Self::Machine::DESCRIPTOR
                .joints
                .iter()
                .map(|axis| axis.kind),
        )
    }

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

/// Millimetres of a raw unit of a linear coordinate.
pub const MM: f64 = 1.0 / 1_048_576.0;

/// Radians of a raw unit of a rotary coordinate.
pub const RADIAN: f64 = core::f64::consts::TAU / 4_294_967_296.0;

/// Sizes of the raw units of axes.
fn units(kinds: impl Iterator<Item = AxisKind>) -> Reals {
    let mut units = [0.0; MAX_AXES];
    for (unit, kind) in units.iter_mut().zip(kinds) {
        *unit = match kind {
            AxisKind::Linear => MM,
            AxisKind::Rotary => RADIAN,
            AxisKind::MultiTurn => RADIAN * 1024.0,
        };
    }
    units
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
