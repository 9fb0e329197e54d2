//! Options of a job.

use crate::drawing::{Problem, short};
use crate::geometry::Point;
use crate::shape::Clearing;
use crate::times::Speeds;
use crate::toolpath::{Depths, Tabs, levels, passes};
use serde::Serialize;

/// Largest number of passes.
const MAX_PASSES: f64 = 10_000.0;

/// What is done with the paths of the drawing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Operation {
    /// Trace the paths.
    Outline,
    /// Clear what the closed paths enclose.
    Pocket,
    /// Drill at points and at the centres of circles.
    Drill,
}

/// Where the tool runs beside a contour.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Side {
    /// Its centre is on the path.
    On,
    /// The enclosed material stays.
    Outside,
    /// The enclosed material goes.
    Inside,
}

/// How the paths are ordered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ordering {
    /// The shortest order that is found: paths are reversed, closed paths start anywhere. One of
    /// the others where the job takes less time in it.
    Short,
    /// The shortest of the file order and the four greedy conditions; single entities in their own
    /// direction.
    Greedy,
    /// The order of the file.
    File,
}

/// Options of a job.
#[derive(Debug, Clone, Serialize)]
pub struct Options {
    /// What is done.
    pub operation: Operation,
    /// Where the tool runs beside a contour.
    pub side: Side,
    /// Order of the paths.
    pub ordering: Ordering,
    /// How a pocket is cleared.
    pub clearing: Clearing,
    /// Diameter of the tool, mm.
    pub tool_mm: f64,
    /// Depth of the floor below the plate's surface, mm.
    pub depth_mm: f64,
    /// Largest depth of a pass, mm.
    pub step_mm: f64,
    /// Distance of rows or contours as a part of the tool's diameter.
    pub overlap: f64,
    /// Angle of the rows, degrees.
    pub angle_deg: f64,
    /// Material that a last pass along the walls removes, mm.
    pub finish_mm: f64,
    /// Angle of ramps, degrees; `None` plunges.
    pub ramp_deg: Option<f64>,
    /// Radius of the arcs that lead onto contours, mm; `None` for none.
    pub lead_mm: Option<f64>,
    /// Holding tabs.
    pub tabs: Option<Tabs>,
    /// Whether the tool cuts upwards of its rotation instead of down.
    pub conventional: bool,
    /// Largest gap between ends that are joined, mm.
    pub join_mm: f64,
    /// Where the tool starts and ends.
    pub reference: Point,
    /// Speeds, by which orders are compared.
    pub speeds: Speeds,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            operation: Operation::Outline,
            side: Side::On,
            ordering: Ordering::Short,
            clearing: Clearing::Contour,
            tool_mm: 1.0,
            depth_mm: 1.0,
            step_mm: 1.0,
            overlap: 0.5,
            angle_deg: 0.0,
            finish_mm: 0.0,
            ramp_deg: None,
            lead_mm: None,
            tabs: None,
            conventional: false,
            join_mm: 0.01,
            reference: [0.0; 2],
            speeds: Speeds::default(),
        }
    }
}

impl Options {
    /// Refuses numbers that make no job.
    ///
    /// # Errors
    /// The first of them.
    pub fn check(&self) -> Result<(), Problem> {
        let positive = [
            ("tool diameter", self.tool_mm, 100.0),
            ("depth", self.depth_mm, 1000.0),
            ("depth of a pass", self.step_mm, 1000.0),
            ("row distance", self.overlap, 1.0),
        ];
        for (name, value, max) in positive {
            if !(value > 0.0 && value <= max) {
                return Err(Problem::general(
                    format!("the {name} is {}", short(value)),
                    format!("it must be above 0 and at most {max}"),
                ));
            }
        }
        let passes = passes(self.depth_mm, self.step_mm);
        if passes > MAX_PASSES {
            return Err(Problem::general(
                format!(
                    "a depth of {} mm in steps of {} mm is {passes} passes",
                    self.depth_mm, self.step_mm
                ),
                format!("use steps with at most {MAX_PASSES} passes"),
            ));
        }
        if self.operation == Operation::Pocket && self.overlap > 0.5 {
            return Err(Problem::general(
                format!(
                    "rows {} diameters apart leave material in corners",
                    self.overlap
                ),
                "use at most 0.5",
            ));
        }
        if self.operation == Operation::Pocket && self.finish_mm > self.tool_mm / 2.0 {
            return Err(Problem::general(
                format!(
                    "the finishing allowance of {} mm is above the tool's radius of {} mm: the last \
                     pass would leave a ridge",
                    self.finish_mm,
                    self.tool_mm / 2.0
                ),
                "use at most the radius with --finish",
            ));
        }
        if let Some(angle) = self.ramp_deg
            && !(0.1..=60.0).contains(&angle)
        {
            let what = format!("the ramp angle is {angle} degrees");
            return Err(Problem::general(what, "it must be within 0.1 and 60"));
        }
        let tab = self.tabs.filter(|tabs| tabs.height_mm >= self.depth_mm);
        if let Some(tabs) = tab {
            return Err(Problem::general(
                format!(
                    "tabs of {} mm are as high as the cut is deep",
                    tabs.height_mm
                ),
                "lower them, or cut deeper",
            ));
        }
        Ok(())
    }

    /// Depths of cuts along a path.
    pub(super) fn depths(&self) -> Depths {
        Depths {
            levels: levels(self.depth_mm, self.step_mm),
            slope: self.ramp_deg.map(|angle| angle.to_radians().tan()),
            tabs: self.tabs.map(|tabs| (tabs, self.tool_mm)),
        }
    }
}
