//! Limits of pose coordinates and joints, and the caller's model of the geometry.

use haptimill_gcode::{Coordinates, WordKind};
use haptimill_protocol::text;
use std::fmt;

/// Limits of a pose coordinate: mm, mm/s, mm/s^2, mm/s^3, or the same in degrees.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseLimits {
    /// Program letter.
    pub letter: char,
    /// Millimetres or degrees.
    pub kind: WordKind,
    /// Axis units of the protocol per millimetre or degree.
    pub units: f64,
    /// Lower soft limit; minus infinity if the coordinate wraps around.
    pub low: f64,
    /// Upper soft limit; infinity if the coordinate wraps around.
    pub high: f64,
    /// Maximum rate.
    pub rate: f64,
    /// Maximum acceleration.
    pub acceleration: f64,
    /// Maximum jerk.
    pub jerk: f64,
}

/// Limits of a joint, in its unit: mm/s, mm/s^2 and mm/s^3, or degrees.
#[derive(Debug, Clone, PartialEq)]
pub struct JointLimits {
    /// Name in messages ("x").
    pub name: String,
    /// Its unit in messages ("mm" or "deg").
    pub unit: &'static str,
    /// Maximum rate.
    pub rate: f64,
    /// Maximum acceleration.
    pub acceleration: f64,
    /// Maximum jerk.
    pub jerk: f64,
}

/// Outputs of the machine that a program can set.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Outputs {
    /// Index of the output of M8.
    pub flood: Option<u8>,
    /// Index of the output of M7.
    pub mist: Option<u8>,
    /// Whether a program may set each digital output. P of M62 to M65 is its index.
    pub digital: Vec<bool>,
    /// Analogue outputs. E of M67 and M68 is the index.
    pub analogue: Vec<AnalogueOutput>,
}

/// An analogue output.
#[derive(Debug, Clone, PartialEq)]
pub struct AnalogueOutput {
    /// Smallest and largest code.
    pub codes: [i16; 2],
    /// Codes per unit of the value Q.
    pub per_unit: f64,
    /// The unit in messages; may be empty.
    pub unit: String,
}

/// Settings of the planner.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Limits of the pose coordinates, in the machine's order, at most six.
    pub pose: Vec<PoseLimits>,
    /// Limits of the joints, in the machine's order, at most six.
    pub joints: Vec<JointLimits>,
    /// Slowest and fastest speed of the spindle in either direction, rev/min; any by default.
    pub spindle_rpm: [i16; 2],
    /// Spindle override at which these limits hold, percent; 100 by default.
    pub spindle_percent: u8,
    /// Outputs; none by default.
    pub outputs: Outputs,
    /// Control period, microseconds.
    pub period_us: u16,
    /// Largest distance of a blended corner from the programmed one, mm; 0 stops at every corner.
    pub tolerance_mm: f64,
    /// The same for the rotary coordinates, degrees.
    pub tolerance_deg: f64,
    /// Largest change of the centripetal acceleration where the curvature changes (line into arc),
    /// as a fraction of the acceleration limit, spread over the time that the jerk limit needs.
    pub curvature_step: f64,
    /// Longest segment duration during motion, seconds.
    pub longest_span_s: f64,
    /// Shortest segment duration, seconds, except before a standstill. With a duration T, half a
    /// unit of rounding is a jerk of 6 units / T^3: at 5 ms 46 mm/s^3, 1 % of the default.
    pub shortest_span_s: f64,
    /// Time in which the controller changes the speed factor by the programmed speed, and time in
    /// which such a change builds up, seconds.
    pub braking_s: [f64; 2],
}

impl Settings {
    /// Returns settings with default dynamics: 200 mm/s^2 and 5000 mm/s^3 at the tip, 100 deg/s^2
    /// and 2500 deg/s^3, corners within 0.005 mm.
    pub fn new(pose: Vec<PoseLimits>, joints: Vec<JointLimits>, period_us: u16) -> Settings {
        Settings {
            pose,
            joints,
            spindle_rpm: [0, i16::MAX],
            spindle_percent: 100,
            outputs: Outputs::default(),
            period_us,
            tolerance_mm: 0.005,
            tolerance_deg: 0.005,
            curvature_step: 0.2,
            longest_span_s: 0.25,
            shortest_span_s: 0.005,
            braking_s: [0.22, 0.08],
        }
    }

    /// Returns the jerk of a joint with this acceleration that rises as fast as the tip's: the
    /// largest ratio of jerk to acceleration of the pose coordinates.
    pub fn joint_jerk(pose: &[PoseLimits], acceleration: f64) -> f64 {
        let ratio = |axis: &PoseLimits| axis.jerk / axis.acceleration;
        acceleration * pose.iter().map(ratio).fold(0.0, f64::max)
    }

    /// Returns the kinds of the pose coordinates.
    pub fn kinds(&self) -> Vec<WordKind> {
        self.pose.iter().map(|axis| axis.kind).collect()
    }
}

impl PoseLimits {
    /// How far a pose may be beyond a limit, mm or degrees: half of what the controller allows, so
    /// that the rounding of setpoints and the cubics between them stay within that.
    pub(crate) fn limit_tolerance(&self) -> f64 {
        let (kind, unit) = match self.kind {
            WordKind::Linear => (text::AxisKind::Linear, 1.0),
            WordKind::Rotary => (text::AxisKind::Rotary, 360.0),
        };
        let units = (1_u64 << kind.unit_bits()) as f64;
        0.5 * f64::from(kind.soft_limit_tolerance()) * unit / units
    }
}

/// Reason why a pose is refused, as a message ("x would leave its stroke by 3.2 mm").
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PoseProblem(pub String);

impl fmt::Display for PoseProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Geometry of the machine for the planner. Poses and joints are in mm and degrees.
pub trait MachineModel {
    /// Returns the joint positions of a pose.
    ///
    /// # Errors
    ///
    /// Returns an error if the pose cannot be reached, leaves a stroke, or is too near a
    /// singularity.
    fn joints(&self, pose: &Coordinates) -> Result<[f64; 6], PoseProblem>;

    /// Returns the joint rates for `rates` of the pose, in which they are linear. Callers must pass
    /// a pose for which [`MachineModel::joints`] succeeds.
    fn joint_rates(&self, pose: &Coordinates, rates: &Coordinates) -> [f64; 6];

    /// Checks a pose as [`MachineModel::joints`] does, and returns [`MachineModel::joint_rates`]
    /// there. A model may do both at once.
    ///
    /// # Errors
    ///
    /// Those of [`MachineModel::joints`].
    fn checked_joint_rates(
        &self,
        pose: &Coordinates,
        rates: &Coordinates,
    ) -> Result<[f64; 6], PoseProblem> {
        self.joints(pose)?;
        Ok(self.joint_rates(pose, rates))
    }
}

impl<T: MachineModel + ?Sized> MachineModel for &T {
    fn joints(&self, pose: &Coordinates) -> Result<[f64; 6], PoseProblem> {
        (**self).joints(pose)
    }

    fn joint_rates(&self, pose: &Coordinates, rates: &Coordinates) -> [f64; 6] {
        (**self).joint_rates(pose, rates)
    }

    fn checked_joint_rates(
        &self,
        pose: &Coordinates,
        rates: &Coordinates,
    ) -> Result<[f64; 6], PoseProblem> {
        (**self).checked_joint_rates(pose, rates)
    }
}
