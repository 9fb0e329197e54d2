//! The straight line in joint space along which a joint is measured.
//!
//! A joint of a linkage moves alone only over a short distance. So the line may also be that of a
//! pose coordinate, which moves several joints: all of these are measured together.

use haptimill_client::{Error, ErrorKind};
use haptimill_firmware::config::AxisKind;
use haptimill_kinematics::{BoundedKinematics, Joints, Kinematics, Pose};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::scale::per_unit;
use haptimill_math::Coordinate;
use haptimill_protocol::message::{AxisValues, RATE_SHIFT};
use haptimill_protocol::setpoint::Setpoint;

/// Largest number of joints.
const JOINTS: usize = 6;

/// Step along the line while its ends are sought, mm or degrees of the joint.
const STEP: f64 = 0.5;

/// Distance from soft limits and strokes that no motion enters, mm or degrees.
const MARGIN: f64 = 2.0;

/// A line through the home pose, with the motion of its joint as its coordinate: 0 is home.
#[derive(Debug, Clone)]
pub struct Line {
    /// Joints that are measured on this line.
    pub joints: Vec<usize>,
    /// Motion of every joint for one unit of the first measured one.
    pub direction: [f64; JOINTS],
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
    /// Maximum rate along the line that joints and pose coordinates allow.
    pub rate: f64,
    /// Maximum acceleration.
    pub acceleration: f64,
    home: [f64; JOINTS],
}

impl Line {
    /// Length on which sines are measured: 1 mm or degree off both ends.
    #[must_use]
    pub fn room(&self) -> f64 {
        self.high - self.low - 2.0
    }
}

/// Geometry of a machine in millimetres and degrees.
pub struct Geometry<'a> {
    machine: &'a MachineFile,
    kinematics: BoundedKinematics,
}

impl<'a> Geometry<'a> {
    /// The geometry of a machine file.
    #[must_use]
    pub fn new(machine: &'a MachineFile) -> Self {
        Self {
            machine,
            kinematics: machine.config.kinematics(),
        }
    }

    fn joint_kind(&self, joint: usize) -> AxisKind {
        self.machine.joints[joint].kind
    }

    /// Joint positions at the home pose.
    fn home(&self) -> [f64; JOINTS] {
        let mut home = [0.0; JOINTS];
        for (joint, slot) in home.iter_mut().enumerate().take(self.machine.joints.len()) {
            let preset = self.machine.config.joints[joint].preset.0;
            *slot = f64::from(preset) / per_unit(self.joint_kind(joint));
        }
        home
    }

    /// Pose in axis units at joint positions; `None` outside the machine's reach.
    fn pose(&self, joints: &[f64; JOINTS]) -> Option<Pose> {
        let mut units = Joints::default();
        for (slot, (joint, value)) in units
            .0
            .iter_mut()
            .zip(self.machine.joints.iter().zip(joints))
        {
            *slot = Coordinate((value * per_unit(joint.kind)).round() as i64 as i32);
        }
        self.kinematics.forward(&units).ok()
    }

    /// Pose in millimetres and degrees.
    fn pose_values(&self, joints: &[f64; JOINTS]) -> Option<[f64; JOINTS]> {
        let pose = self.pose(joints)?;
        let mut values = [0.0; JOINTS];
        for (slot, (axis, value)) in values.iter_mut().zip(self.machine.pose.iter().zip(pose.0)) {
            *slot = f64::from(value.0) / per_unit(axis.kind);
        }
        Some(values)
    }

    /// Whether joints and pose are inside their limits, with the margin.
    fn is_inside(&self, joints: &[f64; JOINTS]) -> bool {
        let inside = |low: f64, high: f64, value: f64| {
            (low + MARGIN.min((high - low) / 8.0)..=high - MARGIN.min((high - low) / 8.0))
                .contains(&value)
        };
        let strokes = self.machine.joints.iter().zip(joints);
        if !strokes
            .into_iter()
            .all(|(axis, value)| axis.low.is_infinite() || inside(axis.low, axis.high, *value))
        {
            return false;
        }
        self.pose_values(joints).is_some_and(|pose| {
            let axes = self.machine.pose.iter().zip(pose);
            axes.into_iter()
                .all(|(axis, value)| axis.low.is_infinite() || inside(axis.low, axis.high, value))
        })
    }

    /// The line along a direction, if it is at least 10 steps long.
    fn line(&self, joint: usize, direction: [f64; JOINTS], longest: f64) -> Option<Line> {
        let home = self.home();
        let at = |s: f64| -> [f64; JOINTS] {
            std::array::from_fn(|joint| home[joint] + s * direction[joint])
        };
        if !self.is_inside(&home) {
            return None;
        }
        let (mut low, mut high) = (0.0, 0.0);
        let (mut down, mut up) = (true, true);
        while high - low < longest && (down || up) {
            up = up && self.is_inside(&at(high + STEP));
            high += if up { STEP } else { 0.0 };
            down = down && self.is_inside(&at(low - STEP));
            low -= if down { STEP } else { 0.0 };
        }
        if high - low < 10.0 * STEP {
            return None;
        }
        // Slopes of the pose, and with them the limits of rate and acceleration.
        let (mut rate, mut acceleration) = (f64::INFINITY, f64::INFINITY);
        let mut limit = |axis_rate: f64, axis_acceleration: f64, slope: f64| {
            if slope.abs() > 1e-6 {
                rate = f64::min(rate, axis_rate / slope.abs());
                acceleration = f64::min(acceleration, axis_acceleration / slope.abs());
            }
        };
        for (axis, slope) in self.machine.joints.iter().zip(direction) {
            limit(axis.rate, axis.acceleration, slope);
        }
        for s in [low + STEP, 0.0, high - STEP] {
            let (before, after) = (
                self.pose_values(&at(s - STEP))?,
                self.pose_values(&at(s + STEP))?,
            );
            for (index, axis) in self.machine.pose.iter().enumerate() {
                let slope = (after[index] - before[index]) / (2.0 * STEP);
                limit(axis.rate, axis.acceleration, slope);
            }
        }
        Some(Line {
            joints: vec![joint],
            direction,
            low,
            high,
            rate,
            acceleration,
            home,
        })
    }

    /// The line on which a joint moves alone, `longest` mm or degrees long at most; `None` where it
    /// is shorter than 5 mm or degrees.
    #[must_use]
    pub fn alone(&self, joint: usize, longest: f64) -> Option<Line> {
        let mut direction = [0.0; JOINTS];
        direction[joint] = 1.0;
        self.line(joint, direction, longest)
    }

    /// The best line of a joint: of the lines that move it alone, or move it with one pose
    /// coordinate, the longest one.
    ///
    /// # Errors
    /// No line is long enough.
    pub fn line_of(&self, joint: usize, longest: f64) -> Result<Line, Error> {
        let home = self.home();
        let mut best = self.alone(joint, longest);
        for coordinate in 0..self.machine.pose.len() {
            let Some(direction) = self.along_coordinate(&home, coordinate, joint) else {
                continue;
            };
            let line = self.line(joint, direction, longest);
            let length = |line: &Option<Line>| line.as_ref().map_or(0.0, |it| it.high - it.low);
            if length(&line) > length(&best) + STEP {
                best = line;
            }
        }
        best.ok_or_else(|| {
            let name = &self.machine.joints[joint].name;
            let what = format!(
                "joint {name}: no line of {} mm or degrees through the home pose is inside the \
                 soft limits; move the presets into the work space",
                10.0 * STEP
            );
            Error::new(ErrorKind::Refused, what)
        })
    }

    /// Motion of the joints along a pose coordinate, for one unit of `joint`; `None` where it
    /// hardly moves that joint.
    fn along_coordinate(
        &self,
        home: &[f64; JOINTS],
        coordinate: usize,
        joint: usize,
    ) -> Option<[f64; JOINTS]> {
        let pose = self.pose(home)?;
        let kind = self.machine.pose[coordinate].kind;
        if kind != self.joint_kind(joint) {
            return None;
        }
        let shifted = |sign: f64| {
            let mut pose = pose;
            pose.0[coordinate].0 += (sign * STEP * per_unit(kind)) as i32;
            self.kinematics.inverse(&pose).ok()
        };
        let (before, after) = (shifted(-1.0)?, shifted(1.0)?);
        let mut direction = [0.0; JOINTS];
        for (index, slot) in direction
            .iter_mut()
            .enumerate()
            .take(self.machine.joints.len())
        {
            let change = f64::from(after.0[index].0) - f64::from(before.0[index].0);
            *slot = change / per_unit(self.joint_kind(index)) / (2.0 * STEP);
            // Motion that is only curvature and rounding counts as standstill.
            if slot.abs() < 1e-3 {
                *slot = 0.0;
            }
        }
        let own = direction[joint];
        (own.abs() > 0.3).then(|| direction.map(|slope| slope / own))
    }

    /// The setpoint at a coordinate of the line, with a rate along it.
    ///
    /// # Errors
    /// The machine cannot reach it.
    pub fn setpoint(
        &self,
        line: &Line,
        periods: u16,
        s: f64,
        rate: f64,
    ) -> Result<Setpoint, Error> {
        let at = |s: f64| -> [f64; JOINTS] {
            std::array::from_fn(|joint| line.home[joint] + s * line.direction[joint])
        };
        let poses = [s, s - STEP, s + STEP].map(|s| self.pose(&at(s)));
        let [Some(pose), Some(before), Some(after)] = poses else {
            let what = "the excitation leaves the work space; shorten --travel";
            return Err(Error::new(ErrorKind::Refused, what));
        };
        let axes = self.machine.pose.len();
        let slope = |axis: usize| {
            let change = after.0[axis].0.wrapping_sub(before.0[axis].0);
            f64::from(change) / (2.0 * STEP)
        };
        Ok(Setpoint {
            periods,
            pose: pose.0.iter().take(axes).map(|it| it.0).collect(),
            rates: (0..axes)
                .map(|axis| (slope(axis) * rate / f64::from(1_u32 << RATE_SHIFT)).round() as i32)
                .collect(),
            ..Setpoint::default()
        })
    }

    /// Pose at a coordinate of the line, axis units.
    #[must_use]
    pub fn pose_at(&self, line: &Line, s: f64) -> Option<AxisValues> {
        let at = std::array::from_fn(|joint| line.home[joint] + s * line.direction[joint]);
        let pose = self.pose(&at)?;
        let axes = self.machine.pose.len();
        Some(pose.0.iter().take(axes).map(|it| it.0).collect())
    }

    /// Range of each pose coordinate on a line, mm or degrees.
    #[must_use]
    pub fn ranges(&self, line: &Line) -> Vec<(f64, f64)> {
        let mut ranges = vec![(f64::INFINITY, f64::NEG_INFINITY); self.machine.pose.len()];
        for part in 0..=20 {
            let s = line.low + (line.high - line.low) * f64::from(part) / 20.0;
            let at = std::array::from_fn(|joint| line.home[joint] + s * line.direction[joint]);
            let Some(pose) = self.pose_values(&at) else {
                continue;
            };
            for (range, value) in ranges.iter_mut().zip(pose) {
                *range = (range.0.min(value), range.1.max(value));
            }
        }
        ranges
    }
}
