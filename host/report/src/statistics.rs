//! Statistics of a job: errors, length and duration.
//!
//! The job is the records with a programmed pose. The tool error is the distance of the tool from
//! the programmed point *at the same time*, start and stop included; the contour error is its
//! distance from the nearest point of the path. On an axis under force control the point is moved
//! by the compliant displacement: a tool that is displaced as intended has no error.

use super::contour::{Contour, Point, distance};
use super::tip::Tip;
use haptimill_firmware::config::AxisKind;
use haptimill_trace::{Record, Recording, flag};
use serde::Serialize;

/// Root mean square and maximum of an error, with time and line of the maximum.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Spread {
    /// Number of samples.
    pub count: u64,
    sum_of_squares: f64,
    /// Largest magnitude.
    pub max: f64,
    /// Time of the largest, s from the start of the recording.
    pub max_time_s: f64,
    /// Program line of the largest; 0 when there is none.
    pub max_line: u32,
}

impl Spread {
    /// Adds a magnitude.
    pub fn add(&mut self, value: f64, time_s: f64, line: u32) {
        self.count += 1;
        self.sum_of_squares += value * value;
        if value > self.max || self.count == 1 {
            (self.max, self.max_time_s, self.max_line) = (value, time_s, line);
        }
    }

    /// Root mean square; 0 without samples.
    pub fn rms(&self) -> f64 {
        match self.count {
            0 => 0.0,
            count => (self.sum_of_squares / count as f64).sqrt(),
        }
    }
}

/// Range of the values seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extent {
    /// Smallest value.
    pub low: f64,
    /// Largest value.
    pub high: f64,
}

impl Default for Extent {
    fn default() -> Self {
        Self {
            low: f64::INFINITY,
            high: f64::NEG_INFINITY,
        }
    }
}

impl Extent {
    /// Adds a value.
    pub fn add(&mut self, value: f64) {
        self.low = self.low.min(value);
        self.high = self.high.max(value);
    }

    /// Largest minus smallest value; 0 without values.
    pub fn span(&self) -> f64 {
        (self.high - self.low).max(0.0)
    }
}

/// Following error of the joints of a kind.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Following {
    /// The error, mm or degrees.
    pub error: Spread,
    /// Joint of the largest; `None` without a joint of the kind.
    pub joint: Option<usize>,
}

impl Following {
    /// Adds the error of a joint.
    fn add(&mut self, joint: usize, error: f64, time_s: f64, line: u32) {
        if error > self.error.max || self.joint.is_none() {
            self.joint = Some(joint);
        }
        self.error.add(error, time_s, line);
    }
}

/// Statistics of a recording.
pub struct Statistics {
    period_s: f64,
    tip: Tip,
    pose_units: Vec<f64>,
    joint_units: Vec<f64>,
    rotary_pose: Vec<bool>,
    joint_kinds: Vec<AxisKind>,
    /// Control period of the first record.
    pub(crate) first_period: Option<u64>,
    /// Number of records.
    pub(crate) records: u64,
    before: Option<Point>,
    contour: Contour,
    contour_places: std::collections::VecDeque<(f64, u32)>,
    /// Records of the job.
    pub job_records: u64,
    /// Start of the first and end of the last record of the job, s from the start of the recording.
    pub job: Option<(f64, f64)>,
    /// Length of the programmed path, mm.
    pub path_length_mm: f64,
    /// Tool against programmed tip at the same time, mm.
    pub tool_error: Spread,
    /// Tool against the nearest point of the programmed path, mm.
    pub contour_error: Spread,
    /// Rotary coordinates of the tool against the programmed ones, degrees.
    pub angle_error: Spread,
    /// Following error of the linear joints, mm.
    pub following_linear: Following,
    /// Following error of the rotary joints, degrees.
    pub following_rotary: Following,
    /// Range of the programmed pose.
    pub programmed: [Extent; 6],
    /// Range of the tool during the job.
    pub tool: [Extent; 6],
    /// The position of the tool is ground truth in every record that has one.
    pub tool_is_true: bool,
    /// Magnitude of the force on the tool, N: of the simulated tool, else of the sensor.
    pub force: Spread,
    /// Compliant displacement of the tool, mm.
    pub displacement: Spread,
    /// Greatest magnitude of the spindle speed, rev/min.
    pub spindle_rpm: u16,
    /// Records of the job with volumetric compensation in full effect; `None` where the machine has
    /// no error tables.
    pub compensated_records: Option<u64>,
    has_sensor: bool,
}

/// The force on the tool, N: of the simulated tool, else the peak of the sensor.
pub(crate) fn force_n(record: &Record, is_true: bool) -> [f64; 3] {
    let force = if is_true {
        &record.true_force
    } else {
        &record.force.high
    };
    std::array::from_fn(|axis| f64::from(force[axis]) / f64::from(1 << 16))
}

/// The compliant displacement, mm.
pub(crate) fn displacement_mm(record: &Record) -> [f64; 3] {
    record
        .force
        .displacement
        .map(|value| f64::from(value) / f64::from(1 << 20))
}

/// The point where the tool should be: the programmed one, with the compliant displacement.
pub(crate) fn reference(programmed: Point, record: &Record) -> Point {
    let displacement = displacement_mm(record);
    std::array::from_fn(|axis| programmed[axis] + displacement[axis])
}

impl Statistics {
    /// Statistics of a recording without records yet.
    pub fn new(recording: &Recording) -> Self {
        let config = recording.config();
        Self {
            period_s: recording.period_s(),
            tip: Tip::new(recording),
            pose_units: recording.pose_units(),
            joint_units: recording.joint_units(),
            rotary_pose: config
                .pose
                .iter()
                .map(|axis| axis.kind.is_rotary())
                .collect(),
            joint_kinds: config.joints.iter().map(|axis| axis.kind).collect(),
            first_period: None,
            records: 0,
            before: None,
            contour: Contour::default(),
            contour_places: std::collections::VecDeque::new(),
            job_records: 0,
            job: None,
            path_length_mm: 0.0,
            tool_error: Spread::default(),
            contour_error: Spread::default(),
            angle_error: Spread::default(),
            following_linear: Following::default(),
            following_rotary: Following::default(),
            programmed: Default::default(),
            tool: Default::default(),
            tool_is_true: true,
            force: Spread::default(),
            displacement: Spread::default(),
            spindle_rpm: 0,
            compensated_records: config.volumetric.as_ref().map(|_| 0),
            has_sensor: config.force.is_some(),
        }
    }

    /// Adds the next record; returns its time in s.
    pub fn add(&mut self, record: &Record) -> f64 {
        let first = *self.first_period.get_or_insert(record.period);
        self.records += 1;
        let time = record.period.saturating_sub(first) as f64 * self.period_s;
        if !record.has(flag::PROGRAMMED) {
            self.before = None;
            return time;
        }
        self.job_records += 1;
        if let Some(compensated) = &mut self.compensated_records {
            *compensated += u64::from(record.has(flag::COMPENSATED));
        }
        let begin = self.job.map_or(time, |(begin, _)| begin);
        self.job = Some((begin, time + self.period_s));
        let programmed = self.tip.point(&record.programmed);
        self.add_force(record, time);
        if let Some(before) = self.before.replace(programmed) {
            self.path_length_mm += distance(&before, &programmed);
        }
        for ((extent, value), unit) in self
            .programmed
            .iter_mut()
            .zip(record.programmed)
            .zip(&self.pose_units)
        {
            extent.add(f64::from(value) * unit);
        }
        if record.has(flag::TOOL_TRUE | flag::TOOL_MEASURED) {
            self.tool_is_true &= record.has(flag::TOOL_TRUE);
            self.add_tool(record, reference(programmed, record), time);
        }
        for (joint, unit) in self.joint_units.iter().enumerate() {
            let error = (f64::from(record.following_error[joint]) * unit).abs();
            let following = if self.joint_kinds[joint].is_rotary() {
                &mut self.following_rotary
            } else {
                &mut self.following_linear
            };
            following.add(joint, error, time, record.line);
        }
        time
    }

    fn add_force(&mut self, record: &Record, time: f64) {
        let magnitude = |values: [f64; 3]| values.iter().map(|it| it * it).sum::<f64>().sqrt();
        let is_true = record.has(flag::TOOL_TRUE);
        let force = force_n(record, is_true);
        if is_true || self.has_sensor {
            self.force.add(magnitude(force), time, record.line);
        }
        if self.has_sensor {
            let displacement = magnitude(displacement_mm(record));
            self.displacement.add(displacement, time, record.line);
        }
        self.spindle_rpm = self.spindle_rpm.max(record.spindle_rpm.unsigned_abs());
    }

    /// Adds the tool; `programmed` is the point where it should be.
    fn add_tool(&mut self, record: &Record, programmed: Point, time: f64) {
        let tool = self.tip.point(&record.tool);
        self.tool_error
            .add(distance(&tool, &programmed), time, record.line);
        self.contour_places.push_back((time, record.line));
        if let Some(error) = self.contour.add(programmed, tool) {
            self.add_contour(error);
        }
        for (axis, unit) in self.pose_units.iter().enumerate() {
            self.tool[axis].add(f64::from(record.tool[axis]) * unit);
            if self.rotary_pose[axis] {
                // Angles and their difference wrap around.
                let error = record.tool[axis].wrapping_sub(record.programmed[axis]);
                let error = (f64::from(error) * unit).abs();
                self.angle_error.add(error, time, record.line);
            }
        }
    }

    fn add_contour(&mut self, error: f64) {
        if let Some((time, line)) = self.contour_places.pop_front() {
            self.contour_error.add(error, time, line);
        }
    }

    /// Whether volumetric compensation was in full effect; `None` where the machine has no error
    /// tables.
    pub(crate) fn compensation(&self) -> Option<String> {
        let (part, whole) = (self.compensated_records?, self.job_records);
        Some(match part {
            0 => "off".to_string(),
            part if part == whole => "on".to_string(),
            part => {
                let percent = 100.0 * part as f64 / whole as f64;
                format!("on in {percent:.1} % of the control periods")
            }
        })
    }

    /// Ends the statistics: the pending contour errors are added.
    pub fn finish(&mut self) {
        for error in std::mem::take(&mut self.contour).finish() {
            self.add_contour(error);
        }
    }
}
