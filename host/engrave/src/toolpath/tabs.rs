//! Holding tabs: their places on a closed path, and the parts of the path that they hold.

use super::Depths;
use crate::geometry::{Path, Point, Segment, distance};
use serde::Serialize;

/// Holding tabs of a contour.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Tabs {
    /// Number on each closed contour.
    pub count: usize,
    /// Width of a tab, mm.
    pub width_mm: f64,
    /// Height above the floor of the cut, mm.
    pub height_mm: f64,
}

impl Tabs {
    /// Length of a contour that the tabs need, with a tool of this diameter, mm.
    #[must_use]
    pub fn length(&self, tool_mm: f64) -> f64 {
        self.count as f64 * (self.width_mm + tool_mm)
    }

    /// Half of the longest part of a contour of this length that a tab may hold. A twentieth of the
    /// distance of two tabs is left to cut between them.
    fn longest_half(&self, total: f64) -> f64 {
        0.95 * total / self.count.max(1) as f64 / 2.0
    }
}

/// A tab of a contour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tab {
    /// The middle of the part of the tool's way that it holds.
    pub at: Point,
    /// Greatest distance of that part from its middle, mm.
    pub reach_mm: f64,
    /// Its width under the tool, mm.
    pub width_mm: f64,
}

/// The parts of a closed path that tabs hold.
pub(super) struct Held {
    pub total: f64,
    /// Distances from the start of the path to begin and end of each; the end may be behind the
    /// start.
    pub spans: Vec<[f64; 2]>,
    pub top: f64,
}

impl Held {
    pub fn new(path: &Path, depths: &Depths, places: &[Point]) -> Self {
        let mut held = Self {
            total: 0.0,
            spans: Vec::new(),
            top: 0.0,
        };
        if let Some((tabs, tool_mm)) = &depths.tabs
            && !places.is_empty()
        {
            let way = Way::of(path);
            let span = |&at: &Point| {
                let along = way.nearest(at);
                let half = way.half(along, tabs, *tool_mm);
                [along - half, along + half]
            };
            held.total = way.total;
            held.top = depths.levels.last().copied().unwrap_or(0.0) + tabs.height_mm;
            held.spans = places.iter().map(span).collect();
        }
        held
    }

    /// Z at a distance from the start where the path itself is at `z`.
    pub fn lifted(&self, along: f64, z: f64) -> f64 {
        let is_held = |[from, to]: &[f64; 2]| (along - from).rem_euclid(self.total) < to - from;
        if z < self.top && self.spans.iter().any(is_held) {
            self.top
        } else {
            z
        }
    }
}

/// Distances along a closed path.
struct Way {
    segments: Vec<Segment>,
    /// Distance from the start of the path to that of each segment.
    starts: Vec<f64>,
    total: f64,
}

impl Way {
    fn of(path: &Path) -> Self {
        let segments: Vec<Segment> = path.segments().collect();
        let mut total = 0.0;
        let starts = segments
            .iter()
            .map(|one| {
                total += one.length();
                total - one.length()
            })
            .collect();
        Self {
            segments,
            starts,
            total,
        }
    }

    fn point(&self, along: f64) -> Point {
        let along = along.rem_euclid(self.total);
        let index = self.starts.partition_point(|&one| one <= along).max(1) - 1;
        let segment = &self.segments[index];
        let part = (along - self.starts[index]) / segment.length().max(f64::MIN_POSITIVE);
        segment.point(part.clamp(0.0, 1.0))
    }

    /// Distance from the start of the path to its point nearest to `at`.
    fn nearest(&self, at: Point) -> f64 {
        let mut best = (f64::INFINITY, 0.0);
        for (segment, start) in self.segments.iter().zip(&self.starts) {
            let part = segment.nearest(at);
            let off = distance(segment.point(part), at);
            if off < best.0 {
                best = (off, start + part * segment.length());
            }
        }
        best.1
    }

    /// Half of the length about a point that a tab holds, so that its ends are as far apart as the
    /// tab and the tool are wide; at corners and bends it is longer than on a line. Where it would
    /// be too long, as on a small circle, it is that of a line.
    fn half(&self, along: f64, tabs: &Tabs, tool_mm: f64) -> f64 {
        let min = tabs.width_mm + tool_mm;
        let max = tabs.longest_half(self.total);
        let mut half = min / 2.0;
        while half < max {
            if self.apart(along, half) >= min - 1e-9 {
                return half;
            }
            half *= 1.02;
        }
        min / 2.0
    }

    /// Distance of the ends of a length about a point.
    fn apart(&self, along: f64, half: f64) -> f64 {
        distance(self.point(along - half), self.point(along + half))
    }

    /// Length of the shorter way between two points.
    fn between(&self, a: f64, b: f64) -> f64 {
        let off = (a - b).rem_euclid(self.total);
        off.min(self.total - off)
    }

    /// The tab about a point.
    fn tab(&self, along: f64, half: f64, tool_mm: f64) -> Tab {
        const COUNT: i32 = 8;
        let at = self.point(along);
        let offs = (-COUNT..=COUNT).map(|k| half * f64::from(k) / f64::from(COUNT));
        let reaches = offs.map(|off| distance(self.point(along + off), at));
        Tab {
            at,
            reach_mm: reaches.fold(0.0, f64::max),
            width_mm: self.apart(along, half) - tool_mm,
        }
    }
}

/// Tabs of a closed path, evenly along it, or beside corners that would make them longer or join
/// two of them. None where the path is too short for the tabs. They are narrower than asked for
/// where the path is too round for them.
#[must_use]
pub fn tabs_of(path: &Path, tabs: &Tabs, tool_mm: f64) -> Vec<Tab> {
    const TRIES: i32 = 20;
    let way = Way::of(path);
    if tabs.count == 0 || tabs.length(tool_mm) >= way.total {
        return Vec::new();
    }
    let min = tabs.width_mm + tool_mm;
    let pitch = way.total / tabs.count as f64;
    // As far as two tabs that come nearer to each other stay apart.
    let room = (pitch - min) / 2.0;
    // Middle and half of the length of each.
    let mut held: Vec<[f64; 2]> = Vec::with_capacity(tabs.count);
    for k in 0..tabs.count {
        // The first tab is half a pitch after the start.
        let centre = (k as f64 + 0.5) * pitch;
        let mut best = (f64::INFINITY, centre);
        for step in 0..=2 * TRIES {
            // To and fro, with growing distance.
            let sign = if step % 2 == 0 { 1 } else { -1 };
            let along = centre + f64::from((step + 1) / 2 * sign) / f64::from(TRIES) * room;
            let half = way.half(along, tabs, tool_mm);
            // The others are farther away.
            let mut beside = held.first().into_iter().chain(held.last());
            if beside.any(|[other, reach]| way.between(*other, along) < reach + half - 1e-9) {
                continue;
            }
            let is_narrow = way.apart(along, half) < min - 1e-6;
            let cost = if is_narrow { f64::MAX } else { half };
            if cost < best.0 - 0.01 * min {
                best = (cost, along);
            }
            if cost <= 0.5 * min {
                break;
            }
        }
        held.push([best.1, way.half(best.1, tabs, tool_mm)]);
    }
    let tab = |&[along, half]: &[f64; 2]| way.tab(along, half, tool_mm);
    held.iter().map(tab).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Least length that is cut between two neighbours of the tabs of a path, mm.
    fn min_gap(path: &Path, tabs: Tabs, tool_mm: f64) -> f64 {
        let way = Way::of(path);
        let depths = Depths {
            tabs: Some((tabs, tool_mm)),
            levels: vec![-2.0],
            slope: None,
        };
        let placed = tabs_of(path, &tabs, tool_mm);
        assert_eq!(placed.len(), tabs.count);
        let places: Vec<Point> = placed.iter().map(|tab| tab.at).collect();
        let held = Held::new(path, &depths, &places);
        let gap = |k: usize| {
            let ([from, to], [next, end]) = (held.spans[k], held.spans[(k + 1) % tabs.count]);
            let middles = [f64::midpoint(from, to), f64::midpoint(next, end)];
            way.between(middles[0], middles[1]) - (to - from + end - next) / 2.0
        };
        (0..tabs.count).map(gap).fold(f64::INFINITY, f64::min)
    }

    /// Tabs do not join at corners, where they are longer: around stars of any number of points.
    #[test]
    fn tabs_stay_apart_at_corners() {
        let tool_mm = 2.0;
        for points in 3..12_u32 {
            for inner in [2.0, 5.0, 8.0, 10.0] {
                let corner = |k: u32| {
                    let radius = if k.is_multiple_of(2) { 12.0 } else { inner };
                    let angle = std::f64::consts::PI * f64::from(k) / f64::from(points);
                    [radius * angle.cos(), radius * angle.sin()]
                };
                let corners: Vec<Point> = (0..2 * points).map(corner).collect();
                let path = Path::polygon(&corners, 0);
                for count in 2..12 {
                    let tabs = Tabs {
                        count,
                        width_mm: 1.5,
                        height_mm: 1.0,
                    };
                    if tabs.length(tool_mm) > 0.95 * path.length() {
                        continue;
                    }
                    let gap = min_gap(&path, tabs, tool_mm);
                    assert!(gap > -1e-6, "{points} {inner} {count} {gap}");
                }
            }
        }
    }

    /// Around small rectangles the best place of a tab by itself may be within the one before it:
    /// by 0.6 to 1.0 mm here.
    #[test]
    fn tabs_that_would_join_are_moved_apart() {
        for (width, height, count, width_mm) in [
            (4.005, 9.332, 3, 2.21),
            (13.588, 6.414, 7, 0.79),
            (25.549, 7.111, 11, 1.07),
        ] {
            let corners = [[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]];
            let tabs = Tabs {
                count,
                width_mm,
                height_mm: 1.0,
            };
            let gap = min_gap(&Path::polygon(&corners, 0), tabs, 3.0);
            assert!(gap > 0.2, "{width} x {height}: {gap}");
        }
    }
}
