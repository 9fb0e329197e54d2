//! Tabs of all contours of a job, found by where they are.

use crate::geometry::{Path, Point, Segment, distance};
use crate::toolpath::Tab;
use std::collections::{BTreeSet, HashMap};

/// Tabs by squares of a grid.
#[derive(Debug, Clone, Default)]
pub(super) struct TabGrid {
    tabs: Vec<Tab>,
    /// Side of the squares, mm.
    side: f64,
    squares: HashMap<[i64; 2], Vec<usize>>,
    /// Greatest reach of a tab, mm.
    widest: f64,
}

impl TabGrid {
    pub fn new(tabs: Vec<Tab>, side: f64) -> Self {
        let mut squares: HashMap<_, Vec<usize>> = HashMap::new();
        for (index, tab) in tabs.iter().enumerate() {
            squares.entry(square(tab.at, side)).or_default().push(index);
        }
        Self {
            side,
            squares,
            widest: tabs.iter().map(|tab| tab.reach_mm).fold(0.0, f64::max),
            tabs,
        }
    }

    /// Visits the tabs of all squares that meet a box and what is within `room` of it, mm.
    fn visit(&self, [low, high]: [Point; 2], room: f64, visit: &mut dyn FnMut(usize)) {
        if self.tabs.is_empty() {
            return;
        }
        let low = square(low.map(|at| at - room), self.side);
        let high = square(high.map(|at| at + room), self.side);
        let count = |axis: usize| (high[axis] - low[axis] + 1) as f64;
        if count(0) * count(1) > self.tabs.len() as f64 {
            (0..self.tabs.len()).for_each(visit);
            return;
        }
        for column in low[0]..=high[0] {
            for row in low[1]..=high[1] {
                let here = self.squares.get(&[column, row]);
                here.into_iter().flatten().for_each(|&index| visit(index));
            }
        }
    }

    /// Places of the tabs that are nearer than `room` to a path, mm.
    pub fn beside(&self, path: &Path, room: f64) -> Vec<Point> {
        let mut found = BTreeSet::new();
        for segment in path.segments() {
            self.visit(segment.bounds(), room, &mut |index| {
                if off(&segment, self.tabs[index].at) < room {
                    found.insert(index);
                }
            });
        }
        found.into_iter().map(|index| self.tabs[index].at).collect()
    }

    /// Whether a segment is nearer than `room` to a tab, mm.
    pub fn meets(&self, segment: &Segment, room: f64) -> bool {
        let mut meets = false;
        self.visit(segment.bounds(), self.widest + room, &mut |index| {
            let tab = &self.tabs[index];
            meets |= off(segment, tab.at) < tab.reach_mm + room;
        });
        meets
    }
}

fn square(at: Point, side: f64) -> [i64; 2] {
    at.map(|value| (value / side).floor() as i64)
}

/// Distance of a point from a segment, mm.
fn off(segment: &Segment, at: Point) -> f64 {
    distance(segment.point(segment.nearest(at)), at)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tabs_are_those_of_a_full_search() {
        let tab = |k: usize| Tab {
            at: [(k * 37 % 101) as f64 - 50.0, (k * 53 % 89) as f64 - 40.0],
            reach_mm: 1.0 + (k % 3) as f64,
            width_mm: 1.0,
        };
        let tabs: Vec<Tab> = (0..300).map(tab).collect();
        let grid = TabGrid::new(tabs.clone(), 1.5);
        for k in 0..60 {
            let from = [f64::from(k * 29 % 97) - 48.0, f64::from(k * 31 % 83) - 41.0];
            let segment = Segment {
                from,
                to: [from[0] + f64::from(k % 7), from[1] - f64::from(k % 5) - 0.5],
                bulge: f64::from(k % 4) * 0.3,
            };
            let path = Path::from_segments(&[segment], 0);
            let near = tabs.iter().filter(|tab| off(&segment, tab.at) < 1.5);
            let near: Vec<Point> = near.map(|tab| tab.at).collect();
            assert_eq!(grid.beside(&path, 1.5), near);
            let meets = |tab: &Tab| off(&segment, tab.at) < tab.reach_mm + 0.5;
            assert_eq!(grid.meets(&segment, 0.5), tabs.iter().any(meets));
        }
    }
}
