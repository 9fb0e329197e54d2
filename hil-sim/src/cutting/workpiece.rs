//! The workpiece and the surface that is left of it.
//!
//! The surface is a height above each point of a square grid in the frame of the table; it turns with the table and does not move in
//! it. Heights are kept as f32: 0.004 um at 30 mm, far below what the grid itself loses. Between its points the surface is bilinear. On a
//! surface that a ball of radius R has cut, where its normal leans by kappa from the vertical, that lies within
//! cell^2 / (4 R cos^2 kappa) of the truth along the normal (0.2 um on the floor of an 8 mm ball, 0.6 um at 60 degrees), and within 1.5 cells on a wall
//! and the part of the ball that is so near to it.
//!
//! What a height map cannot hold: undercuts. A leaning tool removes what its ball sweeps and all above it; its leaning shank removes nothing.
//!
//! Cutting takes away the exact sweep of a ball along a straight line. Only points that the ball lowers are written, so a sweep of
//! 0.1 mm costs the points ahead of its middle and no more.

use crate::cutting::config::{Area, WorkpieceConfig};

/// Material with its surface.
#[derive(Debug, Clone)]
pub struct Workpiece {
    config: WorkpieceConfig,
    /// Rise of the top for each mm in x and y.
    slope: [f64; 2],
    per_cell: f64,
    columns: usize,
    rows: usize,
    heights: Vec<f32>,
    /// Highest point of the stock over the map.
    highest: f64,
    removed_mm3: f64,
    missed: u64,
}

impl Workpiece {
    /// An uncut block; the configuration must have passed its check.
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
            removed_mm3: 0.0,
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

    /// How it was set up.
    pub const fn config(&self) -> &WorkpieceConfig {
        &self.config
    }

    /// Points of the map in x and in y.
    pub const fn size(&self) -> [usize; 2] {
        [self.columns, self.rows]
    }

    /// Where a point of the map is, mm.
    #[inline]
    pub fn place(&self, column: usize, row: usize) -> [f64; 2] {
        [
            self.config.map.x_min + column as f64 * self.config.cell_mm,
            self.config.map.y_min + row as f64 * self.config.cell_mm,
        ]
    }

    /// The area that the points of the map span.
    pub fn area(&self) -> Area {
        let [x_max, y_max] = self.place(self.columns - 1, self.rows - 1);
        Area {
            x_max,
            y_max,
            ..self.config.map
        }
    }

    /// The heights, row by row from low y, each from low x.
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
        // The last column and row are left out, so that the four neighbours are always there.
        let inside = column >= 0.0
            && row >= 0.0
            && column < (self.columns - 1) as f64
            && row < (self.rows - 1) as f64;
        if !inside {
            return self.original(x, y);
        }
        let (i, j) = (column as usize, row as usize);
        let (u, v) = (column - i as f64, row - j as f64);
        let at = j * self.columns + i;
        let below = &self.heights[at..at + 2];
        let above = &self.heights[at + self.columns..at + self.columns + 2];
        let near = f64::from(below[0]) + u * (f64::from(below[1]) - f64::from(below[0]));
        let far = f64::from(above[0]) + u * (f64::from(above[1]) - f64::from(above[0]));
        near + v * (far - near)
    }

    /// No material anywhere is higher than this, mm.
    pub const fn highest(&self) -> f64 {
        self.highest
    }

    /// Volume that has been taken away from the map, mm^3.
    pub const fn removed_mm3(&self) -> f64 {
        self.removed_mm3
    }

    /// Sweeps through the stock that lay partly outside of the map and were lost there.
    pub const fn missed(&self) -> u64 {
        self.missed
    }

    /// Takes away what a ball sweeps whose centre goes straight from one place to another. The ball must have stood at `from` before, or
    /// `from` must equal `to`: points that it lowers already at `from`, and no further, are left out.
    pub fn sweep(&mut self, radius: f64, from: [f64; 3], to: [f64; 3]) {
        let lowest = if from[2] < to[2] { from[2] } else { to[2] };
        if lowest - radius >= self.highest {
            return;
        }
        // Reach of the ball below the highest material.
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
        let mut lowered = 0.0;
        for row in rows {
            let y = map.y_min + row as f64 * cell;
            // Part of the row under the ball on its way, with a cell to spare.
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
            let start = first(left - half, map.x_min, self.columns).max(columns.start);
            let end = first(right + half + cell, map.x_min, self.columns).min(columns.end);
            if start >= end {
                continue;
            }
            let line = &mut self.heights[row * self.columns + start..row * self.columns + end];
            let y = y - from[1];
            for (offset, height) in line.iter_mut().enumerate() {
                let x = map.x_min + (start + offset) as f64 * cell - from[0];
                let Some(z) = sweep.lowest(x, y) else {
                    continue;
                };
                let z = z as f32;
                let z = if z > bottom { z } else { bottom };
                if z < *height {
                    lowered += f64::from(*height) - f64::from(z);
                    *height = z;
                }
            }
        }
        self.removed_mm3 += lowered * cell * cell;
    }
}

/// A ball on a straight way.
struct Sweep {
    square: f64,
    height: f64,
    /// Unit vector of the way, seen from above.
    along: [f64; 2],
    /// Length of the way seen from above, and its rise.
    length: f64,
    rise: f64,
    per_length: f64,
    /// Sine of the slope: how far ahead of its middle the ball is lowest at a point, in parts of its radius there.
    lead: f64,
}

impl Sweep {
    fn new(radius: f64, from: [f64; 3], to: [f64; 3]) -> Self {
        let (x, y, rise) = (to[0] - from[0], to[1] - from[1], to[2] - from[2]);
        let length = (x * x + y * y).sqrt();
        // Straight up or down, and standing still, are a way of no length with the ball at its lower end.
        let flat = length < 1e-9;
        let (along, per_length) = if flat {
            ([1.0, 0.0], 0.0)
        } else {
            ([x / length, y / length], 1.0 / length)
        };
        Self {
            square: radius * radius,
            height: if flat && rise < 0.0 { to[2] } else { from[2] },
            along,
            length: if flat { 0.0 } else { length },
            rise: if flat { 0.0 } else { rise },
            per_length,
            lead: if flat {
                f64::NEG_INFINITY
            } else {
                rise / (length * length + rise * rise).sqrt()
            },
        }
    }

    /// Lowest height of the ball's underside over a point (relative to the start), when it is lower on the way than at its start.
    #[inline(always)]
    fn lowest(&self, x: f64, y: f64) -> Option<f64> {
        let ahead = x * self.along[0] + y * self.along[1];
        let aside = y * self.along[0] - x * self.along[1];
        let square = self.square - aside * aside;
        if square <= 0.0 {
            return None;
        }
        // The lower side of the disc at this distance from the way, at its own lowest: from the derivative along the way.
        let past = if self.lead == 0.0 {
            ahead
        } else if self.lead == f64::NEG_INFINITY {
            0.0
        } else {
            ahead - square.sqrt() * self.lead
        };
        if past < 0.0 {
            return None;
        }
        let travelled = if past < self.length {
            past
        } else {
            self.length
        };
        let off = ahead - travelled;
        let depth = square - off * off;
        (depth > 0.0).then(|| self.height + travelled * self.per_length * self.rise - depth.sqrt())
    }
}
