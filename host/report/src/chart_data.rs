//! Data of the charts of a report, collected in one pass over a recording.

use super::Statistics;
use super::contour::{Contour, Point, distance};
use super::series::{Columns, PathPoints};
use super::statistics::{displacement_mm, force_n, reference};
use super::tip::Tip;
use haptimill_trace::{Quantity, Record, Recording, flag};
use std::collections::VecDeque;

/// Time over which speeds are averaged, s: a single encoder count does not show as a step. Where
/// records are farther apart (telemetry), speeds are taken between records.
pub const SPEED_SPAN_S: f64 = 0.005;

/// Data of the charts.
pub struct ChartData {
    period_s: f64,
    begin: f64,
    pose_units: Vec<f64>,
    joint_units: Vec<f64>,
    drive_units: Vec<f64>,
    first_period: Option<u64>,
    first_joints: Option<Vec<f64>>,
    /// Points of the path, programmed and actual.
    pub path: PathPoints,
    /// Tool against the programmed point of the same time, um.
    pub tool_error: Columns,
    /// Tool against the nearest point of the path, um.
    pub contour_error: Columns,
    contour: Contour,
    contour_times: VecDeque<f64>,
    /// The recording has every point of the path: the nearest one is that of the contour error.
    pub has_whole_path: bool,
    /// Following error of each joint, 1/1000 mm or degree.
    pub following: Vec<Columns>,
    /// Travel of each joint from the start of the job, mm or degrees.
    pub joints: Vec<Columns>,
    /// Speed of each joint.
    pub joint_speed: Vec<Columns>,
    /// Speed of the tip, programmed and actual.
    pub tip_speed: [Columns; 2],
    /// Drive command of each joint.
    pub drives: Vec<Columns>,
    /// Force on the tool along x, y, z, N; the peak of the sensor, and of the simulated tool.
    pub force: [[Columns; 2]; 3],
    /// Compliant displacement along x, y, z, mm.
    pub displacement: [Columns; 3],
    /// Spindle speed, rev/min.
    pub spindle: Columns,
    /// The tip of the tool.
    pub tip: Tip,
    /// Each pose coordinate, programmed and actual.
    pub angles: Vec<[Columns; 2]>,
    /// Time, programmed tip, tool tip and joints of the last records.
    history: VecDeque<(f64, Point, Point, Vec<f64>)>,
}

impl ChartData {
    /// Data of a recording without records yet; `statistics` are those of the whole recording.
    pub fn new(recording: &Recording, statistics: &Statistics) -> Self {
        let whole = (0.0, recording.records() as f64 * recording.period_s());
        let (begin, end) = statistics.job.unwrap_or(whole);
        let columns = || Columns::new(begin, end);
        let joints = recording.config().joints.len();
        let many = || (0..joints).map(|_| columns()).collect();
        let tip = Tip::new(recording);
        let spans = tip.spans(&statistics.programmed);
        let extent = spans.into_iter().fold(0.0, f64::max);
        let spacing = (extent / 1500.0).max(statistics.path_length_mm / 5000.0);
        let pose = &recording.config().pose;
        Self {
            period_s: recording.period_s(),
            begin,
            pose_units: recording.pose_units(),
            joint_units: recording.joint_units(),
            drive_units: recording.drive_units().iter().map(|(s, _)| *s).collect(),
            first_period: statistics.first_period,
            first_joints: None,
            tip,
            path: PathPoints::new(spacing.max(1e-4)),
            tool_error: columns(),
            contour_error: columns(),
            contour: Contour::default(),
            contour_times: VecDeque::new(),
            has_whole_path: recording.records() >= statistics.records,
            following: many(),
            joints: many(),
            joint_speed: many(),
            tip_speed: [columns(), columns()],
            drives: many(),
            force: std::array::from_fn(|_| [columns(), columns()]),
            displacement: std::array::from_fn(|_| columns()),
            spindle: columns(),
            angles: pose.iter().map(|_| [columns(), columns()]).collect(),
            history: VecDeque::new(),
        }
    }

    /// Adds the next record.
    pub fn add(&mut self, record: &Record) {
        let first = *self.first_period.get_or_insert(record.period);
        let time = record.period.saturating_sub(first) as f64 * self.period_s;
        let scaled = |values: &[i32; 6], units: &[f64]| -> Vec<f64> {
            let pairs = values.iter().zip(units);
            pairs
                .map(|(value, unit)| f64::from(*value) * unit)
                .collect()
        };
        let unwound = |quantity, axis, unit: &f64| record.unwound(quantity, axis) as f64 * unit;
        let joints: Vec<f64> = (self.joint_units.iter().enumerate())
            .map(|(axis, unit)| unwound(Quantity::Joints, axis, unit))
            .collect();
        if time + self.period_s / 2.0 < self.begin {
            return;
        }
        let start = self.first_joints.get_or_insert_with(|| joints.clone());
        for (axis, (value, begin)) in joints.iter().zip(start.iter()).enumerate() {
            self.joints[axis].add(time, value - begin);
        }
        let following = scaled(&record.following_error, &self.joint_units);
        let drive = scaled(&record.drive, &self.drive_units);
        for axis in 0..self.following.len() {
            self.following[axis].add(time, following[axis] * 1000.0);
            self.drives[axis].add(time, drive[axis]);
        }
        let (programmed, tool) = (
            reference(self.tip.point(&record.programmed), record),
            self.tip.point(&record.tool),
        );
        let (sensor, actual) = (force_n(record, false), force_n(record, true));
        let displacement = displacement_mm(record);
        for axis in 0..3 {
            self.force[axis][0].add(time, sensor[axis]);
            self.force[axis][1].add(time, actual[axis]);
            self.displacement[axis].add(time, displacement[axis]);
        }
        self.spindle.add(time, f64::from(record.spindle_rpm));
        let in_job = record.has(flag::PROGRAMMED);
        let has_tool = record.has(flag::TOOL_TRUE | flag::TOOL_MEASURED);
        if !in_job {
            self.history.clear();
            return;
        }
        for (axis, unit) in self.pose_units.iter().enumerate() {
            let [programmed, actual] = &mut self.angles[axis];
            programmed.add(time, unwound(Quantity::Programmed, axis, unit));
            if has_tool {
                actual.add(time, unwound(Quantity::Tool, axis, unit));
            }
        }
        if has_tool {
            self.path.add(programmed, tool);
            let error = distance(&programmed, &tool);
            self.tool_error.add(time, error * 1000.0);
            if self.has_whole_path {
                self.contour_times.push_back(time);
                if let Some(error) = self.contour.add(programmed, tool) {
                    self.add_contour(error);
                }
            }
        } else {
            self.path.add(programmed, programmed);
        }
        self.history.push_back((time, programmed, tool, joints));
        // Half a period absorbs rounding.
        let due = time - SPEED_SPAN_S + self.period_s / 2.0;
        while self.history.front().is_some_and(|oldest| oldest.0 <= due) {
            self.add_speeds(has_tool);
        }
    }

    /// Ends the data: the pending contour errors are added.
    pub fn finish(&mut self) {
        for error in std::mem::take(&mut self.contour).finish() {
            self.add_contour(error);
        }
    }

    fn add_contour(&mut self, error: f64) {
        if let Some(time) = self.contour_times.pop_front() {
            self.contour_error.add(time, error * 1000.0);
        }
    }

    /// Adds the speeds between the oldest record of the history, which is removed, and the newest.
    fn add_speeds(&mut self, has_tool: bool) {
        let (Some(old), Some(new)) = (self.history.pop_front(), self.history.back()) else {
            return;
        };
        let (span, middle) = (new.0 - old.0, (new.0 + old.0) / 2.0);
        let speed = |a: &Point, b: &Point| distance(a, b) / span;
        self.tip_speed[0].add(middle, speed(&old.1, &new.1));
        if has_tool {
            self.tip_speed[1].add(middle, speed(&old.2, &new.2));
        }
        for (axis, (before, after)) in old.3.iter().zip(&new.3).enumerate() {
            self.joint_speed[axis].add(middle, (after - before) / span);
        }
    }
}
