//! The workpiece and its cut surface.
//!
//! The surface is a height map: a height at each point of a square grid in the frame of the table,
//! which turns with the table. Heights are f32, with a resolution of 0.004 um at 30 mm, far below
//! the error of the grid. Between the grid points the surface is bilinear.
//!
//! On a surface that a ball of radius R has cut, with its normal tilted by kappa from the vertical,
//! the error along the normal is within cell^2 / (4 R cos^2 kappa): 0.2 um on the floor of an 8 mm
//! ball, 0.6 um at 60 degrees. On a wall and on the part of the ball next to it the error is within
//! 1.5 cells.
//!
//! A height map cannot represent undercuts. A tilted tool removes the volume that its ball sweeps
//! and everything above it; its tilted shank removes nothing.
//!
//! Cutting removes the exact sweep of a ball along a straight line. Only points that the ball
//! lowers are written, so the cost of a sweep of 0.1 mm is that of the points ahead of the ball's
//! centre.

use crate::process::config::{Area, WorkpieceConfig};

/// Material with its surface.
#[derive(Debug, Clone)]
pub struct Workpiece {
    config: WorkpieceConfig,
    /// Rise of the top per mm in x and y.
    slope: [f64; 2],
    per_cell: f64,
    columns: usize,
    rows: usize,
    heights: Vec<f32>,
    /// Highest point of the stock within the map.
    highest: f64,
    missed: u64,
}

impl Workpiece {
    /// Creates an uncut block; the configuration must have passed its check.
    pub fn new(config: &WorkpieceConfig) -> Self {
        let radian = core::f64::consts::PI / 180.0;
        let slope = [
            libm::tan(config.rise_x_deg * radian),
            libm::tan(config.rise_y_deg * radian),
        ];
        let map = &config.map;
        let columns = ((map.x_max - map.x_min) / config.cell_mm).round() as usize + 1;
        let rows = ((map.y_max - map.y_min) / config.cell_mm).round() as usize + 1;
        let mut piece = Self {
            config: config.clone(),
            slope,
            per_cell: 1.0 / config.cell_mm,
            columns,
            rows,
            heights: Vec::with_capacity(columns * rows),
            highest: f64::NEG_INFINITY,
            missed: 0,
        };
        for row in 0..rows {
            for column in 0..columns {
                let [x, y] = piece.place(column, row);
                piece.heights.push(piece.original(x, y) as f32);
            }
        }
        for x in [config.stock.x_min, config.stock.x_max] {
            for y in [config.stock.y_min, config.stock.y_max] {
                let corner = piece.plane(x, y);
                piece.highest = if corner > piece.highest {
                    corner
                } else {
                    piece.highest
                };
            }
        }
        piece
    }

    /// Configuration of the workpiece.
    pub const fn config(&self) -> &WorkpieceConfig {
        &self.config
    }

    /// Number of map points in x and in y.
    pub const fn size(&self) -> [usize; 2] {
        [self.columns, self.rows]
    }

    /// Position of a map point, mm.
    #[inline]
    pub fn place(&self, column: usize, row: usize) -> [f64; 2] {
        [
            self.config.map.x_min + column as f64 * self.config.cell_mm,
            self.config.map.y_min + row as f64 * self.config.cell_mm,
        ]
    }

    /// Area that the map points span.
    pub fn area(&self) -> Area {
        let [x_max, y_max] = self.place(self.columns - 1, self.rows - 1);
        Area {
            x_max,
            y_max,
            ..self.config.map
        }
    }

    /// Heights, row by row from low y, each row from low x.
    pub fn heights(&self) -> &[f32] {
        &self.heights
    }

    #[inline]
    fn plane(&self, x: f64, y: f64) -> f64 {
        self.config.top_mm + self.slope[0] * x + self.slope[1] * y
    }

    /// Height of the uncut surface, mm; the underside where there is no material.
    #[inline]
    pub fn original(&self, x: f64, y: f64) -> f64 {
        let bottom = self.config.bottom_mm;
        if self.config.stock.contains(x, y) {
            let top = self.plane(x, y);
            if top > bottom { top } else { bottom }
        } else {
            bottom
        }
    }

    /// Height of the surface, mm.
    #[inline]
    pub fn height(&self, x: f64, y: f64) -> f64 {
        let column = (x - self.config.map.x_min) * self.per_cell;
        let row = (y - self.config.map.y_min) * self.per_cell;
        // The last column and row are excluded, so the four neighbours always exist.
        let inside = column >= 0.0
            && row >= 0.0
            && column < (self.columns - 1) as f64
            && row < (self.rows - 1) as f64;
        if !inside {
            return self.original(x, y);
        }
        // The values are not negative and below 2^31, so this conversion is the shortest.
        let (i, j) = (column as i32, row as i32);
        let (u, v) = (column - f64::from(i), row - f64::from(j));
        let at = (j as usize)
            .wrapping_mul(self.columns)
            .wrapping_add(i as usize);
        let next = at.wrapping_add(self.columns);
        let (Some(below), Some(above)) = (
            self.heights.get(at..at.wrapping_add(2)),
            self.heights.get(next..next.wrapping_add(2)),
        ) else {
            return self.original(x, y);
        };
        let near = f64::from(below[0]) + u * (f64::from(below[1]) - f64::from(below[0]));
        let far = f64::from(above[0]) + u * (f64::from(above[1]) - f64::from(above[0]));
        near + v * (far - near)
    }

    /// Upper bound of the height of all material, mm.
    pub const fn highest(&self) -> f64 {
        self.highest
    }

    /// Volume removed from the map, mm^3. The function reads every point and takes about a
    /// millisecond.
    pub fn removed_mm3(&self) -> f64 {
        let mut depths = 0.0;
        for (row, line) in self.heights.chunks_exact(self.columns).enumerate() {
            for (column, height) in line.iter().enumerate() {
                let [x, y] = self.place(column, row);
                // The original height is rounded to f32 as well, so an untouched point counts
                // exactly 0.
                depths += f64::from(self.original(x, y) as f32) - f64::from(*height);
            }
        }
        depths * self.config.cell_mm * self.config.cell_mm
    }

    /// Number of sweeps through stock outside the map, where the cut is lost.
    pub const fn missed(&self) -> u64 {
        self.missed
    }

    /// Removes the volume that a ball sweeps whose centre moves on a straight line. The ball must
    /// have been at `from` before, or `from` must equal `to`: the sweep skips points behind `from`.
    pub fn sweep(&mut self, radius: f64, from: [f64; 3], to: [f64; 3]) {
        let lowest = if from[2] < to[2] { from[2] } else { to[2] };
        if lowest - radius >= self.highest {
            return;
        }
        // Radius of the ball's section at the highest material.
        let above = lowest - self.highest;
        let reach = if above > 0.0 {
            (radius * radius - above * above).sqrt()
        } else {
            radius
        };
        let order = |a: f64, b: f64| if a < b { (a, b) } else { (b, a) };
        let (left, right) = order(from[0], to[0]);
        let (near, far) = order(from[1], to[1]);
        let cell = self.config.cell_mm;
        let map = self.area();
        let stock = &self.config.stock;
        let beyond = (left - reach < map.x_min && stock.x_min < map.x_min)
            || (right + reach > map.x_max && stock.x_max > map.x_max)
            || (near - reach < map.y_min && stock.y_min < map.y_min)
            || (far + reach > map.y_max && stock.y_max > map.y_max);
        let over_stock = right + reach > stock.x_min
            && left - reach < stock.x_max
            && far + reach > stock.y_min
            && near - reach < stock.y_max;
        self.missed += u64::from(beyond && over_stock);

        let first = |low: f64, origin: f64, count: usize| -> usize {
            let at = ((low - origin) / cell).ceil();
            if at > 0.0 {
                (at as usize).min(count)
            } else {
                0
            }
        };
        let sweep = Sweep::new(radius, from, to);
        let bottom = self.config.bottom_mm as f32;
        let rows = first(near - reach, map.y_min, self.rows)
            ..first(far + reach + cell, map.y_min, self.rows);
        let columns = first(left - reach, map.x_min, self.columns)
            ..first(right + reach + cell, map.x_min, self.columns);
        for row in rows {
            let y = map.y_min + row as f64 * cell;
            // Part of the row under the moving ball, plus one cell of margin.
            let clear = if y < near {
                near - y
            } else if y > far {
                y - far
            } else {
                0.0
            };
            let inside = reach * reach - clear * clear;
            if inside <= 0.0 {
                continue;
            }
            let half = inside.sqrt();
            let (ahead_from, ahead_to) = sweep.ahead(y - from[1], reach + sweep.length);
            let start = first(
                (left - half).max(from[0] + ahead_from),
                map.x_min,
                self.columns,
            )
            .max(columns.start);
            let end = first(
                (right + half).min(from[0] + ahead_to) + cell,
                map.x_min,
                self.columns,
            )
            .min(columns.end);
            if start >= end {
                continue;
            }
            let line = &mut self.heights[row * self.columns + start..row * self.columns + end];
            let (x, y) = (map.x_min + start as f64 * cell - from[0], y - from[1]);
            if sweep.lead == 0.0 {
                lower(line, bottom, |column| sweep.level(x + column * cell, y));
            } else {
                lower(line, bottom, |column| sweep.sloping(x + column * cell, y));
            }
        }
    }
}

/// Lowers the points of a row to these heights where the heights are lower. The loop has no branch,
/// so it vectorises.
#[inline(always)]
fn lower(line: &mut [f32], bottom: f32, height: impl Fn(f64) -> f64) {
    for (column, point) in (0_i32..).zip(line) {
        let z = height(f64::from(column)) as f32;
        let z = if z > bottom { z } else { bottom };
        *point = if z < *point { z } else { *point };
    }
}

/// A ball that moves on a straight line.
struct Sweep {
    square: f64,
    radius: f64,
    height: f64,
    /// Unit vector of the motion in the plan view.
    along: [f64; 2],
    /// Length of the motion in the plan view, and its rise per mm of that length.
    length: f64,
    slope: f64,
    /// Sine of the slope: distance between the centre and the lowest point of the ball at a grid
    /// point, relative to the ball's radius there. Below 1/1000 it counts as level, with an error
    /// of 2 nm.
    lead: f64,
}

impl Sweep {
    fn new(radius: f64, from: [f64; 3], to: [f64; 3]) -> Self {
        let (x, y, rise) = (to[0] - from[0], to[1] - from[1], to[2] - from[2]);
        let length = (x * x + y * y).sqrt();
        let square = radius * radius;
        // A vertical or zero motion has no length in the plan view; the ball is at its lower end.
        if length < 1e-9 {
            return Self {
                square,
                radius,
                height: if rise < 0.0 { to[2] } else { from[2] },
                along: [1.0, 0.0],
                length: 0.0,
                slope: 0.0,
                lead: 0.0,
            };
        }
        let lead = rise / (length * length + rise * rise).sqrt();
        Self {
            square,
            radius,
            height: from[2],
            along: [x / length, y / length],
            length,
            slope: rise / length,
            lead: if lead.abs() < 1e-3 { 0.0 } else { lead },
        }
    }

    /// Range in a row at `y` in which the sweep can lower a point, without the part behind the
    /// start, where the ball was before. `far` lies beyond all points.
    fn ahead(&self, y: f64, far: f64) -> (f64, f64) {
        if self.length == 0.0 {
            return (-far, far);
        }
        // A descending ball is lowest behind its centre.
        let min = if self.lead < 0.0 {
            self.lead * self.radius
        } else {
            0.0
        };
        let [x_part, y_part] = self.along;
        let bound = min - y * y_part;
        if x_part > 1e-6 {
            (bound / x_part, far)
        } else if x_part < -1e-6 {
            (-far, bound / x_part)
        } else if bound <= 1e-5 {
            (-far, far)
        } else {
            (far, -far)
        }
    }

    /// Lowest height of the ball's underside over a point (relative to the start) on a level
    /// motion; infinity beside the path.
    #[inline(always)]
    fn level(&self, x: f64, y: f64) -> f64 {
        let ahead = x * self.along[0] + y * self.along[1];
        let aside = y * self.along[0] - x * self.along[1];
        self.underside(self.square - aside * aside, ahead, ahead)
    }

    /// The same on any motion: the section of the ball at this lateral distance is lowest where its
    /// slope equals that of the motion.
    #[inline(always)]
    fn sloping(&self, x: f64, y: f64) -> f64 {
        let ahead = x * self.along[0] + y * self.along[1];
        let aside = y * self.along[0] - x * self.along[1];
        let square = self.square - aside * aside;
        let root = if square > 0.0 { square.sqrt() } else { 0.0 };
        self.underside(square, ahead, ahead - root * self.lead)
    }

    #[inline(always)]
    fn underside(&self, square: f64, ahead: f64, best: f64) -> f64 {
        let travelled = if best > 0.0 { best } else { 0.0 };
        let travelled = if travelled < self.length {
            travelled
        } else {
            self.length
        };
        let off = ahead - travelled;
        let depth = square - off * off;
        let inside = depth > 0.0;
        let root = (if inside { depth } else { 0.0 }).sqrt();
        let height = self.height + travelled * self.slope - root;
        if inside { height } else { f64::INFINITY }
    }
}
