//! What the machine can do: limits of pose coordinates and joints, and the caller's model of its geometry.

use haptimill_gcode::{AxisKind, Coordinates};
use std::fmt;

/// Limits of a pose coordinate: mm, mm/s, mm/s^2, mm/s^3, or the same in degrees.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseLimits {
    /// The letter by which programs call it.
    pub letter: char,
    /// Millimetres or degrees.
    pub kind: AxisKind,
    /// Lower soft limit.
    pub low: f64,
    /// Upper soft limit.
    pub high: f64,
    /// Largest rate.
    pub rate: f64,
    /// Largest acceleration.
    pub acceleration: f64,
    /// Largest jerk.
    pub jerk: f64,
}

/// Limits of a joint, in its unit: mm/s and mm/s^2, or degrees.
#[derive(Debug, Clone, PartialEq)]
pub struct JointLimits {
    /// What messages call it ("slide 3").
    pub name: String,
    /// Its unit in messages ("mm" or "deg").
    pub unit: &'static str,
    /// Largest rate.
    pub rate: f64,
    /// Largest acceleration.
    pub acceleration: f64,
}

/// Everything the planner has to know beside the geometry.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Limits of the pose coordinates, in the machine's order, at most six.
    pub pose: Vec<PoseLimits>,
    /// Limits of the joints, in the machine's order, at most six.
    pub joints: Vec<JointLimits>,
    /// Length of the control period, microseconds.
    pub period_us: u16,
    /// How far a blended corner may pass the programmed one, mm; 0 stops at every corner.
    pub tolerance_mm: f64,
    /// The same for the rotary coordinates, degrees.
    pub tolerance_deg: f64,
    /// The step of centripetal acceleration where curvature changes (line into arc), as a part of the acceleration limit. There the
    /// acceleration jumps: a tangent is no smoother than that, and the limit of jerk does not hold in that instant.
    pub curvature_step: f64,
    /// The longest span between setpoints while anything moves, seconds.
    pub longest_span_s: f64,
    /// The shortest span between setpoints, seconds, except before a rest. A span of T turns half a unit of rounding into a jerk of
    /// 6 units / T^3: at 5 ms 46 mm/s^3, 1 % of the default.
    pub shortest_span_s: f64,
}

impl Settings {
    /// Settings with default dynamics: 200 mm/s^2 and 5000 mm/s^3 at the tip, 100 deg/s^2 and 2500 deg/s^3, corners within 0.005 mm.
    pub fn new(pose: Vec<PoseLimits>, joints: Vec<JointLimits>, period_us: u16) -> Settings {
        Settings {
            pose,
            joints,
            period_us,
            tolerance_mm: 0.005,
            tolerance_deg: 0.005,
            curvature_step: 0.2,
            longest_span_s: 0.25,
            shortest_span_s: 0.005,
        }
    }

    /// Kinds of the pose coordinates.
    pub fn kinds(&self) -> Vec<AxisKind> {
        self.pose.iter().map(|axis| axis.kind).collect()
    }
}

/// Why a pose cannot be taken, in words for the operator ("slide 2 would be 3.2 mm beyond its stroke").
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PoseProblem(pub String);

impl fmt::Display for PoseProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// The geometry of the machine, as the planner asks for it. Poses are in mm and degrees; so are joints.
pub trait MachineModel {
    /// The joints of a pose.
    ///
    /// # Errors
    /// The pose cannot be reached, leaves a stroke, or is too near a singularity.
    fn joints(&self, pose: &Coordinates) -> Result<[f64; 6], PoseProblem>;

    /// The rates of the joints when the pose moves at `rates`; linear in `rates`. Only asked where [`MachineModel::joints`] has an answer.
    fn joint_rates(&self, pose: &Coordinates, rates: &Coordinates) -> [f64; 6];
}
