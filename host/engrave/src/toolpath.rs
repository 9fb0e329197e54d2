//! Tool paths with depths, ramps, leads and tabs.

mod tabs;

use crate::geometry::{Path, Point, Segment, distance};
use crate::times::Speeds;
use serde::Serialize;
use tabs::Held;
pub use tabs::{Tab, Tabs, tabs_of};

/// A step of a cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PathStep {
    /// Along a segment; Z changes evenly to its end value, mm.
    Along(Segment, f64),
    /// Straight up or down to this Z, mm.
    Vertical(f64),
}

/// A cut between two lifted moves. The tool comes down to `z` at the start of its first step.
#[derive(Debug, Clone, PartialEq)]
pub struct Cut {
    /// Where the tool comes down.
    pub start: Point,
    /// Z to which it plunges, mm.
    pub z: f64,
    /// Steps.
    pub steps: Vec<PathStep>,
    /// Entity of the drawing.
    pub entity: usize,
}

impl Cut {
    /// Where the tool comes up.
    #[must_use]
    pub fn end(&self) -> Point {
        let ends = self.steps.iter().rev().find_map(|step| match step {
            PathStep::Along(segment, _) => Some(segment.to),
            PathStep::Vertical(_) => None,
        });
        ends.unwrap_or(self.start)
    }

    /// Z at the end, mm.
    #[must_use]
    pub fn floor(&self) -> f64 {
        self.steps.last().map_or(self.z, |step| match step {
            PathStep::Along(_, z) | PathStep::Vertical(z) => *z,
        })
    }

    /// Length along the segments, mm.
    #[must_use]
    pub fn length(&self) -> f64 {
        let lengths = self.steps.iter().map(|step| match step {
            PathStep::Along(segment, _) => segment.length(),
            PathStep::Vertical(_) => 0.0,
        });
        lengths.sum()
    }
}

/// Cuts in their order.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Toolpath {
    /// The cuts.
    pub cuts: Vec<Cut>,
}

/// Lengths of a tool path.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Lengths {
    /// Along the cuts, mm.
    pub cut_mm: f64,
    /// Lifted, from and to the reference included, mm.
    pub air_mm: f64,
    /// Number of times that the tool goes down.
    pub lifts: usize,
    /// Straight down and up at the feed of plunges, from the surface on, mm.
    pub plunge_mm: f64,
    /// From the ends of the cuts up to the surface, mm.
    pub rise_mm: f64,
}

impl Toolpath {
    /// Lengths from `reference` and back to it.
    #[must_use]
    pub fn lengths(&self, reference: Point) -> Lengths {
        Self::lengths_of(&self.cuts, reference)
    }

    /// Lengths of cuts from `reference` and back to it.
    #[must_use]
    pub fn lengths_of(cuts: &[Cut], reference: Point) -> Lengths {
        let mut lengths = Lengths::default();
        let mut at = reference;
        for cut in cuts {
            lengths.cut_mm += cut.length();
            lengths.air_mm += distance(at, cut.start);
            lengths.lifts += 1;
            let mut z = cut.z;
            lengths.plunge_mm += z.abs();
            for step in &cut.steps {
                match step {
                    PathStep::Along(_, to) => z = *to,
                    PathStep::Vertical(to) => {
                        lengths.plunge_mm += (to - z).abs();
                        z = *to;
                    }
                }
            }
            lengths.rise_mm += z.abs();
            at = cut.end();
        }
        lengths.air_mm += distance(at, reference);
        lengths
    }
}

/// Depths of cuts along a path.
#[derive(Debug, Clone, PartialEq)]
pub struct Depths {
    /// Z of each pass, from the top, mm; all below 0.
    pub levels: Vec<f64>,
    /// Slope of ramps (depth for a unit of length); `None` plunges.
    pub slope: Option<f64>,
    /// Tabs of closed contours, and the diameter of the tool that leaves them, mm.
    pub tabs: Option<(Tabs, f64)>,
}

/// Joins cuts that begin where the one before ends, as far as that takes no more time: the tool
/// does not come up and down again at the same point. `max` is the largest gap, mm.
#[must_use]
pub fn join_cuts(cuts: Vec<Cut>, max: f64, speeds: &Speeds) -> Vec<Cut> {
    let mut out: Vec<Cut> = Vec::with_capacity(cuts.len());
    for cut in cuts {
        let Some(last) = out.last_mut() else {
            out.push(cut);
            continue;
        };
        let (end, floor) = (last.end(), last.floor());
        let gap = distance(end, cut.start);
        // Without a lift the tool moves at the feed of plunges to where the next cut begins.
        let straight = (floor - cut.z).abs() / speeds.plunge;
        let lifted =
            (speeds.lift_mm - floor) / speeds.rise + (speeds.lift_mm - cut.z) / speeds.plunge;
        if gap > max || straight > lifted {
            out.push(cut);
            continue;
        }
        if floor != cut.z {
            last.steps.push(PathStep::Vertical(cut.z));
        }
        if gap > 0.0 {
            let link = Segment {
                from: end,
                to: cut.start,
                bulge: 0.0,
            };
            last.steps.push(PathStep::Along(link, cut.z));
        }
        last.steps.extend(cut.steps);
    }
    out
}

/// Number of passes to a depth with at most `step` each.
#[must_use]
pub fn passes(depth_mm: f64, step_mm: f64) -> f64 {
    // A depth of three times the step may be a rounding error above it.
    (depth_mm / step_mm - 1e-9).ceil().max(1.0)
}

/// Z of passes to a depth with at most `step` each, mm. All passes have the same step.
#[must_use]
pub fn levels(depth_mm: f64, step_mm: f64) -> Vec<f64> {
    let count = passes(depth_mm, step_mm);
    (1..=count as usize)
        .map(|k| -depth_mm * k as f64 / count)
        .collect()
}

/// Cuts a path in all of its depths. A closed path goes around once for each depth. An open one
/// goes to and fro without a lift. A closed path has its own places of tabs.
#[must_use]
pub fn cut_path(path: &Path, depths: &Depths) -> Cut {
    let tabs = match &depths.tabs {
        Some((tabs, tool_mm)) if path.closed => tabs_of(path, tabs, *tool_mm),
        _ => Vec::new(),
    };
    let places: Vec<Point> = tabs.iter().map(|tab| tab.at).collect();
    cut_path_with_tabs(path, depths, &places)
}

/// Cuts a path as [`cut_path`] does, with its tabs at the points nearest to these places.
#[must_use]
pub fn cut_path_with_tabs(path: &Path, depths: &Depths, places: &[Point]) -> Cut {
    let mut path = path.clone();
    let start = path.start().unwrap_or_default();
    let entity = path.entity;
    let held = Held::new(&path, depths, places);
    let mut tool = Tool {
        steps: Vec::new(),
        z: 0.0,
        along: 0.0,
        held: &held,
    };
    let mut above = 0.0;
    if depths.slope.is_none() {
        tool.z = held.lifted(0.0, depths.levels.first().copied().unwrap_or(0.0));
    }
    let first = tool.z;
    for &z in &depths.levels {
        match depths.slope {
            Some(slope) if path.closed => path = ramp_around(&path, above, z, slope, &mut tool),
            Some(slope) => {
                ramp_to_and_fro(&path, above, z, slope, &mut tool.steps);
                tool.z = z;
            }
            None => {}
        }
        for segment in path.segments() {
            tool.follow(&segment, z, z);
        }
        if !path.closed {
            path = path.reversed();
        }
        above = z;
    }
    Cut {
        start,
        z: first,
        steps: tool.steps,
        entity,
    }
}

/// Cuts a closed path as [`cut_path_with_tabs`] does, with leads at its start.
///
/// Both leads are cut at each of `levels`, so that no lead is deeper than a pass: where the contour
/// is not cut at a level, its leads still are. Between two levels the tool goes back along them. A
/// ramp begins at the surface, where its way in cuts nothing. It ends elsewhere than the contour
/// began, so it has a way out only where it ends at its start, in a single pass.
#[must_use]
pub fn cut_path_with_leads(
    path: &Path,
    depths: &Depths,
    places: &[Point],
    leads: &Leads,
    levels: &[f64],
) -> Cut {
    const SAME: f64 = 1e-9;
    let Leads { into, out } = *leads;
    let start = into.from;
    if depths.slope.is_some() {
        let mut cut = cut_path_with_tabs(path, depths, places);
        let (returns, floor) = (distance(cut.end(), out.from) < 1e-6, cut.floor());
        cut.steps.insert(0, PathStep::Along(into, cut.z));
        if returns && levels.len() == 1 {
            cut.steps.push(PathStep::Along(out, floor));
        }
        return Cut { start, ..cut };
    }
    let held = Held::new(path, depths, places);
    let lead_z = |level: f64| held.lifted(0.0, level);
    let z = lead_z(levels.first().copied().unwrap_or(0.0));
    let mut tool = Tool {
        steps: Vec::new(),
        z,
        along: 0.0,
        held: &held,
    };
    for (k, &level) in levels.iter().enumerate() {
        let z = lead_z(level);
        if k > 0 {
            for lead in [out, into] {
                tool.steps.push(PathStep::Along(lead.reversed(), tool.z));
            }
            tool.down(z);
        }
        tool.steps.push(PathStep::Along(into, z));
        if depths.levels.iter().any(|one| (one - level).abs() < SAME) {
            for segment in path.segments() {
                tool.follow(&segment, level, level);
            }
            tool.down(z);
        }
        tool.steps.push(PathStep::Along(out, z));
    }
    Cut {
        start,
        z,
        steps: tool.steps,
        entity: path.entity,
    }
}

/// The tool on its way around a path.
struct Tool<'h> {
    steps: Vec<PathStep>,
    z: f64,
    /// Distance from the start of the path.
    along: f64,
    held: &'h Held,
}

impl Tool<'_> {
    /// Follows a segment from one Z to another, lifted over tabs.
    fn follow(&mut self, segment: &Segment, from: f64, to: f64) {
        const SHORT: f64 = 1e-9;
        let held = self.held;
        if held.spans.is_empty() {
            self.down(from);
            self.z = to;
            self.steps.push(PathStep::Along(*segment, to));
            return;
        }
        let length = segment.length();
        let mut parts = vec![0.0, 1.0];
        if from.min(to) < held.top {
            for bound in held.spans.iter().flatten() {
                let mut off = (bound - self.along).rem_euclid(held.total);
                while off < length - SHORT {
                    if off > SHORT {
                        parts.push(off / length);
                    }
                    off += held.total;
                }
            }
            if from > held.top {
                parts.push((from - held.top) / (from - to));
            }
            parts.sort_by(f64::total_cmp);
        }
        for pair in parts.windows(2) {
            if (pair[1] - pair[0]) * length <= SHORT && parts.len() > 2 {
                continue;
            }
            let middle = self.along + f64::midpoint(pair[0], pair[1]) * length;
            let z = |part: f64| held.lifted(middle, from + (to - from) * part);
            self.down(z(pair[0]));
            let piece = if parts.len() == 2 {
                *segment
            } else {
                let (before, _) = segment.split(pair[1]);
                before.split(pair[0] / pair[1]).1
            };
            self.z = if pair[1] == 1.0 {
                held.lifted(middle, to)
            } else {
                z(pair[1])
            };
            self.steps.push(PathStep::Along(piece, self.z));
        }
        self.along += length;
    }

    fn down(&mut self, z: f64) {
        if (z - self.z).abs() > 1e-12 {
            self.steps.push(PathStep::Vertical(z));
            self.z = z;
        }
    }
}

/// Descends along a closed path and returns the path from the point where the depth is reached.
fn ramp_around(path: &Path, from: f64, to: f64, slope: f64, tool: &mut Tool) -> Path {
    let mut left = (from - to) / slope;
    let mut z = from;
    for index in (0..path.segment_count()).cycle() {
        let segment = path.segment(index);
        let length = segment.length();
        if length >= left - 1e-9 {
            let part = (left / length).min(1.0);
            if part >= 1.0 - 1e-9 {
                tool.follow(&segment, z, to);
                return path.rotated((index + 1) % path.segment_count(), 0.0);
            }
            let (ramp, _) = segment.split(part);
            tool.follow(&ramp, z, to);
            return path.rotated(index, part);
        }
        left -= length;
        tool.follow(&segment, z, z - length * slope);
        z -= length * slope;
    }
    path.clone()
}

/// Descends along an open path and back, as often as needed, to its start.
fn ramp_to_and_fro(path: &Path, from: f64, to: f64, slope: f64, steps: &mut Vec<PathStep>) {
    let needed = (from - to) / slope;
    let length = path.length();
    if length <= 0.0 {
        steps.push(PathStep::Vertical(to));
        return;
    }
    let trips = (needed / (2.0 * length)).ceil().max(1.0);
    // Length of one way, and the depth along it.
    let way = needed / (2.0 * trips);
    let mut out = Vec::new();
    let mut left = way;
    for segment in path.segments() {
        let length = segment.length();
        if length >= left {
            if left > 1e-9 {
                out.push(segment.split((left / length).min(1.0)).0);
            }
            break;
        }
        left -= length;
        out.push(segment);
    }
    let mut z = from;
    for _ in 0..trips as usize {
        let back: Vec<Segment> = out.iter().rev().map(Segment::reversed).collect();
        for segment in out.iter().chain(&back) {
            z = (z - segment.length() * slope).max(to);
            steps.push(PathStep::Along(*segment, z));
        }
    }
    if z > to {
        steps.push(PathStep::Vertical(to));
    }
}

/// Arcs that lead onto a closed contour and off it, tangent to it, on the side of the waste.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Leads {
    /// The arc towards the start of the contour.
    pub into: Segment,
    /// The arc away from it.
    pub out: Segment,
}

/// Leads at the start of a contour. `waste_left` says on which side of the motion the waste is.
#[must_use]
pub fn leads(path: &Path, radius: f64, waste_left: bool) -> Option<Leads> {
    if path.segment_count() == 0 {
        return None;
    }
    let first = path.segment(0);
    let last = path.segment(path.segment_count() - 1);
    let at = first.from;
    let quarter = |direction: Point, sign: f64| {
        let side = if waste_left { 1.0 } else { -1.0 };
        let waste = [-direction[1] * side, direction[0] * side];
        [
            at[0] + radius * (waste[0] + sign * direction[0]),
            at[1] + radius * (waste[1] + sign * direction[1]),
        ]
    };
    let bulge = (std::f64::consts::FRAC_PI_8).tan() * if waste_left { 1.0 } else { -1.0 };
    Some(Leads {
        into: Segment {
            from: quarter(first.direction(0.0), -1.0),
            to: at,
            bulge,
        },
        out: Segment {
            from: at,
            to: quarter(last.direction(1.0), 1.0),
            bulge,
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> Path {
        Path::polygon(&[[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]], 0)
    }

    fn depths(levels: Vec<f64>) -> Depths {
        Depths {
            levels,
            slope: None,
            tabs: None,
        }
    }

    #[test]
    fn passes_have_equal_steps() {
        assert_eq!(levels(1.0, 0.4).len(), 3);
        assert_eq!(levels(1.0, 0.5), [-0.5, -1.0]);
        assert_eq!(levels(1.0, 5.0), [-1.0]);
        let three = 3.0 * 0.1;
        assert!(three / 0.1 > 3.0);
        assert_eq!((passes(three, 0.1), levels(three, 0.1).len()), (3.0, 3));
    }

    #[test]
    fn a_ramp_reaches_its_depth_and_a_full_turn_follows() {
        let ramped = Depths {
            slope: Some(0.1),
            ..depths(vec![-0.5, -1.0])
        };
        let cut = cut_path(&square(), &ramped);
        assert_eq!(cut.z, 0.0);
        // Each pass: 5 mm of ramp and 40 mm at the depth.
        assert!((cut.length() - 90.0).abs() < 1e-9, "{}", cut.length());
        let (mut z, mut at) = (cut.z, cut.start);
        for step in &cut.steps {
            let PathStep::Along(segment, to) = step else {
                panic!("{step:?}")
            };
            assert!(distance(at, segment.from) < 1e-9);
            assert!((z - to) / segment.length() <= 0.1 + 1e-9);
            (z, at) = (*to, segment.to);
        }
        assert_eq!(z, -1.0);
    }

    #[test]
    fn an_open_path_goes_to_and_fro() {
        let line = Path::from_segments(
            &[Segment {
                from: [0.0, 0.0],
                to: [10.0, 0.0],
                bulge: 0.0,
            }],
            0,
        );
        let cut = cut_path(&line, &depths(vec![-0.5, -1.0]));
        assert_eq!(cut.end(), [0.0, 0.0]);
        let ramped = Depths {
            slope: Some(0.01),
            ..depths(vec![-1.0])
        };
        let cut = cut_path(&line, &ramped);
        assert!((cut.length() - 110.0).abs() < 1e-6, "{}", cut.length());
        assert_eq!(cut.end(), [10.0, 0.0]);
    }

    #[test]
    fn tabs_keep_their_width_under_the_tool() {
        let tabs = Tabs {
            count: 4,
            width_mm: 2.0,
            height_mm: 0.4,
        };
        let tabbed = Depths {
            tabs: Some((tabs, 1.0)),
            ..depths(vec![-0.5, -1.0])
        };
        let cut = cut_path(&square(), &tabbed);
        let lifted: f64 = cut
            .steps
            .iter()
            .filter_map(|step| match step {
                PathStep::Along(segment, z) if (*z + 0.6).abs() < 1e-9 => Some(segment.length()),
                _ => None,
            })
            .sum();
        // Width of the tabs and the diameter of the tool, four times, in the last pass only.
        assert!((lifted - 4.0 * 3.0).abs() < 1e-9, "{lifted}");
        assert!((cut.length() - 80.0).abs() < 1e-9);
    }

    #[test]
    fn leads_are_tangent_to_the_contour() {
        let leads = leads(&square(), 1.0, false).unwrap();
        // Counter-clockwise, waste on the right: below the square.
        assert!(distance(leads.into.from, [-1.0, -1.0]) < 1e-12);
        let direction = leads.into.direction(1.0);
        assert!(distance(direction, [1.0, 0.0]) < 1e-12);
        assert!(distance(leads.out.direction(0.0), [0.0, -1.0]) < 1e-12);
    }
}
