//! A plate that a flat tool cuts, and its surface against the drawing.
//!
//! What should be cut is computed from the drawing by distances on the grid, independent of the
//! offsets and paths of the job.

mod clearance;

use crate::curves::distance_to_segment;
use crate::drawing::Drawing;
use crate::geometry::{Path, Point};
use crate::job::{Operation, Options, Side};
use crate::toolpath::Tab;
use serde::Serialize;

/// Largest number of cells.
const CELLS: f64 = 4e6;

/// Width of the band along edges that is not judged, cells: the grid does not resolve it.
const BAND: f64 = 2.0;

/// Distance, cells, within which the way of the tool's centre beside a contour has points farther
/// from the contour, where the tool has clearance: the way is known within a cell on either side,
/// and in a right-angled corner the distance grows more slowly.
const NEAR: f64 = 4.0;

/// Cells of the largest patch that a comparison may find wrong: the grid places the fillets of
/// corners within some cells.
const UNRESOLVED: f64 = 16.0;

/// Heights of the plate's surface on a square grid; 0 is the uncut top.
#[derive(Debug, Clone)]
pub struct Plate {
    low: Point,
    cell: f64,
    columns: usize,
    rows: usize,
    heights: Vec<f32>,
}

/// The surface after the cut against the drawing.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct PlateReport {
    /// Distance of the points at which the surface is compared, mm.
    pub cell_mm: f64,
    /// Width of the band along edges that is not judged, mm.
    pub band_mm: f64,
    /// Area that the drawing asks to be cut, mm^2.
    pub asked_mm2: f64,
    /// Part of it that the tool cannot reach, such as inside corners, mm^2.
    pub unreachable_mm2: f64,
    /// Area that is compared, without the band along edges, mm^2.
    pub judged_mm2: f64,
    /// Reachable area that is not cut to half of the depth, mm^2.
    pub uncut_mm2: f64,
    /// Area that is cut although it should stay, mm^2.
    pub over_cut_mm2: f64,
    /// Largest connected patch of the uncut or the over-cut area, mm^2.
    pub largest_patch_mm2: f64,
    /// Depth that was asked for, mm.
    pub depth_mm: f64,
    /// Least depth in the cut area, mm.
    pub min_depth_mm: f64,
    /// Mean depth there, mm.
    pub mean_depth_mm: f64,
    /// Greatest depth anywhere, mm.
    pub max_depth_mm: f64,
}

impl PlateReport {
    /// Whether the surface differs from the drawing by more than the grid can miss.
    #[must_use]
    pub fn differs(&self) -> bool {
        self.largest_patch_mm2 > UNRESOLVED * self.cell_mm * self.cell_mm
    }

    /// Whether less than half of the reachable area was compared: the grid is coarse for the tool.
    #[must_use]
    pub fn is_coarse(&self) -> bool {
        self.judged_mm2 < 0.5 * (self.asked_mm2 - self.unreachable_mm2)
    }
}

impl Plate {
    /// An uncut plate around an area (low and high corner, mm) with `cell` mm between its points,
    /// or more if the grid would be too large.
    #[must_use]
    pub fn new([low, high]: [Point; 2], cell: f64) -> Self {
        let (width, height) = (high[0] - low[0], high[1] - low[1]);
        let cell = cell.max((width * height / CELLS).sqrt());
        let columns = (width / cell).ceil() as usize + 1;
        let rows = (height / cell).ceil() as usize + 1;
        Self {
            low,
            cell,
            columns,
            rows,
            heights: vec![0.0; columns * rows],
        }
    }

    /// Columns and rows.
    #[must_use]
    pub const fn size(&self) -> [usize; 2] {
        [self.columns, self.rows]
    }

    /// Heights, row by row from low y, mm.
    #[must_use]
    pub fn heights(&self) -> &[f32] {
        &self.heights
    }

    /// Position of a point of the grid, mm.
    #[must_use]
    pub fn at(&self, column: usize, row: usize) -> Point {
        [
            self.low[0] + column as f64 * self.cell,
            self.low[1] + row as f64 * self.cell,
        ]
    }

    /// Columns and rows within a box.
    fn window(&self, low: Point, high: Point) -> [std::ops::Range<usize>; 2] {
        let counts = [self.columns, self.rows];
        std::array::from_fn(|axis| {
            let place = |value: f64| (value - self.low[axis]) / self.cell;
            let first = place(low[axis]).ceil().max(0.0) as usize;
            let last = place(high[axis]).floor() + 1.0;
            first..(last.max(0.0) as usize).min(counts[axis]).max(first)
        })
    }

    /// Cuts with a flat tool that moves straight from one point to another.
    pub fn sweep(&mut self, radius: f64, from: [f64; 3], to: [f64; 3]) {
        let z = from[2].min(to[2]);
        if z >= 0.0 {
            return;
        }
        let (a, b) = ([from[0], from[1]], [to[0], to[1]]);
        let low = [a[0].min(b[0]) - radius, a[1].min(b[1]) - radius];
        let high = [a[0].max(b[0]) + radius, a[1].max(b[1]) + radius];
        let way = crate::geometry::Segment {
            from: a,
            to: b,
            bulge: 0.0,
        };
        let [columns, rows] = self.window(low, high);
        for row in rows {
            for column in columns.clone() {
                let slot = row * self.columns + column;
                if f64::from(self.heights[slot]) > z
                    && distance_to_segment(self.at(column, row), &way) <= radius
                {
                    self.heights[slot] = z as f32;
                }
            }
        }
    }

    /// Which points closed paths enclose, by the even-odd rule.
    fn inside(&self, paths: &[Path]) -> Vec<bool> {
        let mut mask = vec![false; self.heights.len()];
        let points: Vec<Vec<Point>> = paths
            .iter()
            .filter(|one| one.closed)
            .map(|one| one.points(self.cell / 20.0))
            .collect();
        let mut crossings: Vec<Vec<f64>> = vec![Vec::new(); self.rows];
        for polygon in &points {
            for pair in polygon.windows(2) {
                let (a, b) = (pair[0], pair[1]);
                let place = |y: f64| ((y - self.low[1]) / self.cell).max(0.0) as usize;
                let last = (place(a[1].max(b[1])) + 2).min(self.rows);
                let first = place(a[1].min(b[1])).min(last);
                for (row, xs) in crossings[first..last].iter_mut().enumerate() {
                    let y = self.at(0, first + row)[1];
                    if (a[1] <= y) != (b[1] <= y) {
                        xs.push(a[0] + (y - a[1]) * (b[0] - a[0]) / (b[1] - a[1]));
                    }
                }
            }
        }
        for (row, xs) in crossings.iter_mut().enumerate() {
            xs.sort_by(f64::total_cmp);
            for pair in xs.chunks_exact(2) {
                let [columns, _] = self.window([pair[0], 0.0], [pair[1], 0.0]);
                for column in columns {
                    mask[row * self.columns + column] = true;
                }
            }
        }
        mask
    }

    /// Distance of every point to the nearest one of a mask, mm (Felzenszwalb and Huttenlocher,
    /// *Distance transforms of sampled functions*, 2012).
    fn distances(&self, mask: &[bool]) -> Vec<f64> {
        let far = ((self.columns + self.rows) as f64).powi(2) * 4.0;
        let mut field: Vec<f64> = mask
            .iter()
            .map(|&one| if one { 0.0 } else { far })
            .collect();
        let mut line = Vec::new();
        for row in 0..self.rows {
            let from = row * self.columns;
            line.clear();
            line.extend_from_slice(&field[from..from + self.columns]);
            field[from..from + self.columns].copy_from_slice(&parabolas(&line));
        }
        for column in 0..self.columns {
            line.clear();
            line.extend((0..self.rows).map(|row| field[row * self.columns + column]));
            for (row, value) in parabolas(&line).into_iter().enumerate() {
                field[row * self.columns + column] = value;
            }
        }
        field
            .into_iter()
            .map(|square| square.sqrt() * self.cell)
            .collect()
    }

    /// What should be cut, and what of it a tool reaches.
    fn asked(&self, drawing: &Drawing, options: &Options) -> Asked {
        let radius = options.tool_mm / 2.0;
        let chains = crate::chain::chain(drawing.paths.clone(), options.join_mm);
        match (options.operation, options.side) {
            (Operation::Outline, Side::On) => Asked::same(self.beside(&chains, radius)),
            (Operation::Drill, _) => {
                let circles = drawing
                    .paths
                    .iter()
                    .filter_map(|path| drawing.circle_centre(path));
                let centres = circles.chain(drawing.points.iter().map(|one| one.0));
                let dots: Vec<Path> = centres
                    .map(|at| {
                        Path::from_segments(
                            &[crate::geometry::Segment {
                                from: at,
                                to: at,
                                bulge: 0.0,
                            }],
                            0,
                        )
                    })
                    .collect();
                Asked::same(self.beside(&dots, radius))
            }
            (Operation::Pocket, _) => {
                let asked = self.inside(&chains);
                let outside: Vec<bool> = asked.iter().map(|one| !one).collect();
                let off = self.distances(&outside);
                // What a tool reaches with its centre at these points.
                let reached = |centres: &[bool], radius: f64| -> Vec<bool> {
                    let off = self.distances(centres);
                    let both = asked.iter().zip(off);
                    both.map(|(asked, off)| *asked && off <= radius).collect()
                };
                let centres: Vec<bool> = off.iter().map(|off| *off >= radius).collect();
                let clearance = self.clearance(&asked, &off, &chains, radius);
                let in_wide = reached(&clearance.wide, radius + self.cell);
                let in_narrow = reached(&clearance.narrow, radius);
                let either = in_wide.into_iter().zip(in_narrow);
                Asked {
                    reached: reached(&centres, radius),
                    judged: either.map(|(wide, narrow)| wide || narrow).collect(),
                    asked,
                    kept: None,
                }
            }
            (Operation::Outline, side) => {
                let inside = self.inside(&chains);
                // The part that the tool must not touch.
                let kept: Vec<bool> = inside
                    .iter()
                    .map(|one| *one == (side == Side::Outside))
                    .collect();
                let off = self.distances(&kept);
                let beside = |on_path: &[bool]| -> Vec<bool> {
                    let cut = self.distances(on_path);
                    cut.iter().map(|d| *d <= radius - 2.0 * self.cell).collect()
                };
                let on_path: Vec<bool> = off
                    .iter()
                    .map(|d| (d - radius).abs() <= self.cell)
                    .collect();
                let free: Vec<bool> = kept.iter().map(|one| !one).collect();
                let clearance = self.clearance(&free, &off, &chains, radius);
                let to_wide = self.distances(&clearance.wide);
                let to_narrow = self.distances(&clearance.narrow);
                let is_clear = |slot: usize| {
                    to_wide[slot] <= NEAR * self.cell || to_narrow[slot] <= 1.5 * self.cell
                };
                let on_clear_path: Vec<bool> = (0..on_path.len())
                    .map(|slot| on_path[slot] && is_clear(slot))
                    .collect();
                Asked {
                    kept: Some(kept),
                    judged: beside(&on_clear_path),
                    ..Asked::same(beside(&on_path))
                }
            }
        }
    }

    /// Points at least a distance inside of a mask.
    fn at_least(&self, mask: &[bool], distance: f64) -> Vec<bool> {
        let outside: Vec<bool> = mask.iter().map(|one| !one).collect();
        self.distances(&outside)
            .into_iter()
            .map(|d| d >= distance)
            .collect()
    }

    /// Points within a distance of paths.
    fn beside(&self, paths: &[Path], radius: f64) -> Vec<bool> {
        let mut mask = vec![false; self.heights.len()];
        for segment in paths.iter().flat_map(Path::segments) {
            let [low, high] = segment.bounds();
            let [columns, rows] = self.window(
                [low[0] - radius, low[1] - radius],
                [high[0] + radius, high[1] + radius],
            );
            for row in rows {
                for column in columns.clone() {
                    let slot = row * self.columns + column;
                    mask[slot] =
                        mask[slot] || distance_to_segment(self.at(column, row), &segment) <= radius;
                }
            }
        }
        mask
    }

    /// Number of points of the largest connected patch of a mask.
    fn largest_patch(&self, mut mask: Vec<bool>) -> usize {
        let mut largest = 0;
        let mut open = Vec::new();
        for first in 0..mask.len() {
            if !std::mem::take(&mut mask[first]) {
                continue;
            }
            open.push(first);
            let mut count = 0;
            while let Some(slot) = open.pop() {
                count += 1;
                let (column, row) = (slot % self.columns, slot / self.columns);
                let beside = [
                    (column > 0).then(|| slot - 1),
                    (column + 1 < self.columns).then(|| slot + 1),
                    (row > 0).then(|| slot - self.columns),
                    (row + 1 < self.rows).then(|| slot + self.columns),
                ];
                for next in beside.into_iter().flatten() {
                    if std::mem::take(&mut mask[next]) {
                        open.push(next);
                    }
                }
            }
            largest = largest.max(count);
        }
        largest
    }

    /// Points that tabs may cover.
    fn tabbed(&self, tabs: &[Tab]) -> Vec<bool> {
        let mut mask = vec![false; self.heights.len()];
        for tab in tabs {
            let reach = tab.reach_mm + self.cell;
            let [columns, rows] =
                self.window(tab.at.map(|at| at - reach), tab.at.map(|at| at + reach));
            for row in rows {
                for column in columns.clone() {
                    let off = crate::geometry::distance(self.at(column, row), tab.at);
                    mask[row * self.columns + column] |= off <= reach;
                }
            }
        }
        mask
    }

    /// Compares the surface with the drawing; the job leaves these tabs.
    #[must_use]
    pub fn compare(&self, drawing: &Drawing, options: &Options, tabs: &[Tab]) -> PlateReport {
        let Asked {
            asked,
            reached,
            judged,
            kept,
        } = self.asked(drawing, options);
        let area = self.cell * self.cell;
        let band = BAND * self.cell;
        let not_asked: Vec<bool> = match kept {
            Some(kept) => kept,
            None => asked.iter().map(|one| !one).collect(),
        };
        let core = self.at_least(&judged, band);
        let spared = self.at_least(&not_asked, band);
        let mut report = PlateReport {
            cell_mm: self.cell,
            band_mm: band,
            depth_mm: options.depth_mm,
            min_depth_mm: f64::INFINITY,
            ..PlateReport::default()
        };
        // Tabs stay; above them the plate is cut.
        let above = options.depth_mm - options.tabs.map_or(0.0, |tabs| tabs.height_mm);
        let tabbed = self.tabbed(tabs);
        let (mut uncut, mut over_cut) = (vec![false; core.len()], vec![false; core.len()]);
        let (mut sum, mut count) = (0.0, 0_u64);
        for (slot, &height) in self.heights.iter().enumerate() {
            let depth = -f64::from(height);
            report.max_depth_mm = report.max_depth_mm.max(depth);
            report.asked_mm2 += if asked[slot] { area } else { 0.0 };
            report.unreachable_mm2 += if asked[slot] && !reached[slot] {
                area
            } else {
                0.0
            };
            if core[slot] {
                report.judged_mm2 += area;
                let deep = if tabbed[slot] {
                    above
                } else {
                    options.depth_mm
                };
                if depth < deep / 2.0 {
                    report.uncut_mm2 += area;
                    uncut[slot] = true;
                } else {
                    report.min_depth_mm = report.min_depth_mm.min(depth);
                    sum += depth;
                    count += 1;
                }
            }
            if spared[slot] && depth > 0.01 {
                report.over_cut_mm2 += area;
                over_cut[slot] = true;
            }
        }
        let largest = self.largest_patch(uncut).max(self.largest_patch(over_cut));
        report.largest_patch_mm2 = largest as f64 * area;
        report.mean_depth_mm = if count > 0 { sum / count as f64 } else { 0.0 };
        if count == 0 {
            report.min_depth_mm = 0.0;
        }
        report
    }
}

/// Masks of the plate.
struct Asked {
    asked: Vec<bool>,
    reached: Vec<bool>,
    /// What the tool reaches for certain: in wide places by distances on the grid, which may be up
    /// to a cell too large, in narrow ones by distances from the contours.
    judged: Vec<bool>,
    /// What must stay, if that is not all the rest.
    kept: Option<Vec<bool>>,
}

impl Asked {
    fn same(asked: Vec<bool>) -> Self {
        Self {
            reached: asked.clone(),
            judged: asked.clone(),
            asked,
            kept: None,
        }
    }
}

/// Lower envelope of the parabolas over the values of a line.
fn parabolas(values: &[f64]) -> Vec<f64> {
    let count = values.len();
    let mut places = vec![0_usize; count];
    let mut from = vec![f64::NEG_INFINITY; count + 1];
    let mut last = 0;
    from[1.min(count)] = f64::INFINITY;
    for q in 1..count {
        loop {
            let p = places[last];
            let meet = ((values[q] + (q * q) as f64) - (values[p] + (p * p) as f64))
                / (2.0 * (q as f64 - p as f64));
            if meet > from[last] {
                last += 1;
                places[last] = q;
                from[last] = meet;
                from[last + 1] = f64::INFINITY;
                break;
            }
            last -= 1;
        }
    }
    let mut at = 0;
    (0..count)
        .map(|q| {
            while from[at + 1] < q as f64 {
                at += 1;
            }
            let off = q as f64 - places[at] as f64;
            off * off + values[places[at]]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_those_of_a_full_search() {
        let plate = Plate::new([[0.0, 0.0], [3.0, 2.0]], 0.1);
        let [columns, rows] = plate.size();
        let mask: Vec<bool> = (0..columns * rows)
            .map(|slot| slot * 7919 % 53 == 3)
            .collect();
        let found = plate.distances(&mask);
        for row in 0..rows {
            for column in 0..columns {
                let at = plate.at(column, row);
                let mut best = f64::INFINITY;
                for slot in (0..mask.len()).filter(|&slot| mask[slot]) {
                    let other = plate.at(slot % columns, slot / columns);
                    best = best.min(crate::geometry::distance(at, other));
                }
                assert!((found[row * columns + column] - best).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_cut_beside_the_path_is_uncut_and_over_cut() {
        let mut drawing = Drawing::default();
        let entity = drawing.add_entity(crate::drawing::Entity::default());
        let line = crate::geometry::Segment {
            from: [2.0, 5.0],
            to: [8.0, 5.0],
            bulge: 0.0,
        };
        drawing.paths.push(Path::from_segments(&[line], entity));
        let options = Options {
            tool_mm: 1.0,
            depth_mm: 0.5,
            ..Options::default()
        };
        let mut plate = Plate::new([[0.0, 0.0], [10.0, 10.0]], 0.05);
        plate.sweep(0.5, [2.0, 5.0, -0.5], [8.0, 5.0, -0.5]);
        let report = plate.compare(&drawing, &options, &[]);
        assert_eq!((report.uncut_mm2, report.over_cut_mm2), (0.0, 0.0));
        assert!(
            (report.asked_mm2 - 6.0 - std::f64::consts::PI / 4.0).abs() < 0.4,
            "{report:?}"
        );
        assert!((report.mean_depth_mm - 0.5).abs() < 1e-6);
        assert!(report.judged_mm2 > 4.0 && !report.is_coarse(), "{report:?}");
        // On a grid that is coarse for the tool, next to nothing of the slot is beyond the band.
        let report = Plate::new([[0.0, 0.0], [10.0, 10.0]], 0.4).compare(&drawing, &options, &[]);
        assert!(report.judged_mm2 < 0.1 && report.is_coarse(), "{report:?}");
        // The same cut 0.3 mm aside.
        let mut plate = Plate::new([[0.0, 0.0], [10.0, 10.0]], 0.05);
        plate.sweep(0.5, [2.0, 5.3, -0.5], [8.0, 5.3, -0.5]);
        let report = plate.compare(&drawing, &options, &[]);
        // 0.3 mm less twice the band of 0.1 mm, over about 6.4 mm.
        assert!(
            report.uncut_mm2 > 0.5 && report.over_cut_mm2 > 0.5,
            "{report:?}"
        );
    }
}
