//! Surface metrology of the cut workpiece: grooves in a section, extents, circles, and the view
//! from above.
//!
//! An edge is the point where the surface crosses a depth below the uncut top (`level`, mm), by
//! linear interpolation between the points of the map. A level of two cells or more avoids the
//! corner, which the map rounds off; the expected error there is half a cell, and a few um
//! elsewhere. Callers must call [`crate::process::Cutting::settle`] first, because the map does not
//! yet include the last teeth.

use crate::process::config::Area;
use crate::process::workpiece::Workpiece;

/// A groove in a section.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Groove {
    /// First edge, mm from the start of the section.
    pub begins: f64,
    /// Second edge, mm from the start of the section.
    pub ends: f64,
    /// Greatest depth below the uncut top, mm.
    pub depth: f64,
}

impl Groove {
    /// Distance of the edges, mm.
    pub fn width(&self) -> f64 {
        self.ends - self.begins
    }

    /// Midpoint between the edges, mm from the start of the section.
    pub fn middle(&self) -> f64 {
        0.5 * (self.begins + self.ends)
    }
}

/// A circle fitted to measured points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Circle {
    /// Centre, mm.
    pub centre: [f64; 2],
    /// Least-squares radius, mm.
    pub radius: f64,
    /// Least-squares roundness: largest minus smallest distance of a point from the centre, mm.
    pub roundness: f64,
    /// Number of points.
    pub points: usize,
}

/// A closed groove around a centre.
#[derive(Debug, Clone, PartialEq)]
pub struct Ring {
    /// Outer edge.
    pub outer: Circle,
    /// Inner edge.
    pub inner: Circle,
    /// Centre line between the edges.
    pub middle: Circle,
    /// Extent of the centre line in x through the centre, mm.
    pub extent_x: f64,
    /// Extent of the centre line in y through the centre, mm.
    pub extent_y: f64,
}

/// Image of the surface: heights row by row from low y, each row from low x.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Area that the outer points span.
    pub area: Area,
    /// Number of points in x.
    pub columns: usize,
    /// Number of points in y.
    pub rows: usize,
    /// Heights, mm.
    pub heights: Vec<f32>,
    /// Depths below the uncut top, mm, in the same order.
    pub depths: Vec<f32>,
}

impl Workpiece {
    /// Depth of the surface below the uncut top, mm.
    pub fn depth(&self, x: f64, y: f64) -> f64 {
        self.original(x, y) - self.height(x, y)
    }

    /// Measures the groove around the deepest point of a section; `None` when the section has no
    /// depth above `level`.
    pub fn groove(&self, from: [f64; 2], to: [f64; 2], level: f64) -> Option<Groove> {
        let way = [to[0] - from[0], to[1] - from[1]];
        let length = (way[0] * way[0] + way[1] * way[1]).sqrt();
        let steps = (4.0 * length / self.config().cell_mm).ceil() as usize;
        if steps == 0 {
            return None;
        }
        let depths: Vec<f64> = (0..=steps)
            .map(|step| {
                let part = step as f64 / steps as f64;
                self.depth(from[0] + part * way[0], from[1] + part * way[1])
            })
            .collect();
        let mut deepest = 0;
        for (step, depth) in depths.iter().enumerate() {
            if *depth > depths[deepest] {
                deepest = step;
            }
        }
        if depths[deepest] <= level {
            return None;
        }
        let unit = length / steps as f64;
        let crossing = |inside: usize, outside: usize| {
            let part = (depths[inside] - level) / (depths[inside] - depths[outside]);
            unit * (inside as f64 + part * (outside as f64 - inside as f64))
        };
        let begins = (0..deepest)
            .rev()
            .find(|step| depths[*step] <= level)
            .map_or(0.0, |step| crossing(step + 1, step));
        let ends = (deepest + 1..=steps)
            .find(|step| depths[*step] <= level)
            .map_or(length, |step| crossing(step - 1, step));
        Some(Groove {
            begins,
            ends,
            depth: depths[deepest],
        })
    }

    /// Area in which the surface is deeper than `level`; `None` if there is none.
    pub fn extents(&self, level: f64) -> Option<Area> {
        let [columns, rows] = self.size();
        let depth = |column: usize, row: usize| {
            let [x, y] = self.place(column, row);
            self.original(x, y) - f64::from(self.heights()[row * columns + column])
        };
        // Fraction of a cell from a point inside to the edge, towards a point outside.
        let part = |inside: f64, outside: f64| (inside - level) / (inside - outside);
        let mut found: Option<Area> = None;
        for row in 0..rows {
            for column in 0..columns {
                let here = depth(column, row);
                if here <= level {
                    continue;
                }
                let [x, y] = self.place(column, row);
                let mut area = Area {
                    x_min: x,
                    x_max: x,
                    y_min: y,
                    y_max: y,
                };
                let cell = self.config().cell_mm;
                let edge = |outside: f64| {
                    if outside <= level {
                        cell * part(here, outside)
                    } else {
                        0.0
                    }
                };
                if column > 0 {
                    area.x_min -= edge(depth(column - 1, row));
                }
                if column + 1 < columns {
                    area.x_max += edge(depth(column + 1, row));
                }
                if row > 0 {
                    area.y_min -= edge(depth(column, row - 1));
                }
                if row + 1 < rows {
                    area.y_max += edge(depth(column, row + 1));
                }
                found = Some(found.map_or(area, |before| Area {
                    x_min: before.x_min.min(area.x_min),
                    x_max: before.x_max.max(area.x_max),
                    y_min: before.y_min.min(area.y_min),
                    y_max: before.y_max.max(area.y_max),
                }));
            }
        }
        found
    }

    /// Measures a closed groove on `rays` lines from the centre of its extents. `None` when a line
    /// crosses no groove with an island inside, or when `rays` is below 8.
    pub fn ring(&self, level: f64, rays: usize) -> Option<Ring> {
        if rays < 8 {
            return None;
        }
        let extents = self.extents(level)?;
        let centre = [
            0.5 * (extents.x_min + extents.x_max),
            0.5 * (extents.y_min + extents.y_max),
        ];
        let reach = (extents.x_max - extents.x_min).max(extents.y_max - extents.y_min);
        let (mut outer, mut inner, mut middle) = (Vec::new(), Vec::new(), Vec::new());
        let along = |angle: f64| -> Option<[[f64; 2]; 3]> {
            let (sin, cos) = libm::sincos(angle);
            let end = [centre[0] + reach * cos, centre[1] + reach * sin];
            let groove = self.groove(centre, end, level)?;
            let at = |distance: f64| [centre[0] + distance * cos, centre[1] + distance * sin];
            (groove.begins > 0.0).then(|| [at(groove.begins), at(groove.middle()), at(groove.ends)])
        };
        for ray in 0..rays {
            let [near, half, far] = along(core::f64::consts::TAU * ray as f64 / rays as f64)?;
            inner.push(near);
            middle.push(half);
            outer.push(far);
        }
        let half = core::f64::consts::PI;
        let across = |first: f64, axis: usize| -> Option<f64> {
            Some(along(first)?[1][axis] - along(first + half)?[1][axis])
        };
        Some(Ring {
            outer: circle(&outer)?,
            inner: circle(&inner)?,
            middle: circle(&middle)?,
            extent_x: across(0.0, 0)?,
            extent_y: across(0.5 * half, 1)?,
        })
    }

    /// Image of the surface with at most `max` points along its longer side; each is the mean of
    /// the map points that it covers.
    pub fn picture(&self, max: usize) -> Picture {
        let [columns, rows] = self.size();
        let block = columns.max(rows).div_ceil(max.max(1));
        let (wide, high) = (columns.div_ceil(block), rows.div_ceil(block));
        let mut heights = Vec::with_capacity(wide * high);
        let mut depths = Vec::with_capacity(wide * high);
        for top in 0..high {
            for left in 0..wide {
                let (mut height, mut depth, mut count) = (0.0, 0.0, 0.0);
                for row in top * block..((top + 1) * block).min(rows) {
                    for column in left * block..((left + 1) * block).min(columns) {
                        let here = f64::from(self.heights()[row * columns + column]);
                        let [x, y] = self.place(column, row);
                        height += here;
                        depth += self.original(x, y) - here;
                        count += 1.0;
                    }
                }
                heights.push((height / count) as f32);
                depths.push((depth / count) as f32);
            }
        }
        Picture {
            area: self.area(),
            columns: wide,
            rows: high,
            heights,
            depths,
        }
    }
}

/// Circle with the least sum of squared distances to the points (Gauss-Newton from the linear fit);
/// `None` when they lie on a line.
pub fn circle(points: &[[f64; 2]]) -> Option<Circle> {
    let count = points.len() as f64;
    if points.len() < 3 {
        return None;
    }
    let mut centre = [0.0; 2];
    for point in points {
        centre[0] += point[0] / count;
        centre[1] += point[1] / count;
    }
    let distance = |point: &[f64; 2], centre: &[f64; 2]| {
        let (x, y) = (point[0] - centre[0], point[1] - centre[1]);
        (x * x + y * y).sqrt()
    };
    let mut radius = 0.0;
    for _ in 0..50 {
        radius = points
            .iter()
            .map(|point| distance(point, &centre))
            .sum::<f64>()
            / count;
        // Normal equations of the distances in the centre, with the radius eliminated: u is the
        // unit vector to a point minus the mean of all.
        let unit = |point: &[f64; 2]| {
            let length = distance(point, &centre).max(1e-12);
            [
                (point[0] - centre[0]) / length,
                (point[1] - centre[1]) / length,
            ]
        };
        let mut mean = [0.0; 2];
        for point in points {
            let u = unit(point);
            mean[0] += u[0] / count;
            mean[1] += u[1] / count;
        }
        let (mut a, mut b, mut c, mut p, mut q) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for point in points {
            let u = unit(point);
            let u = [u[0] - mean[0], u[1] - mean[1]];
            let off = distance(point, &centre) - radius;
            a += u[0] * u[0];
            b += u[0] * u[1];
            c += u[1] * u[1];
            p += u[0] * off;
            q += u[1] * off;
        }
        let determinant = a * c - b * b;
        if determinant <= 1e-9 * count * count {
            return None;
        }
        let step = [(c * p - b * q) / determinant, (a * q - b * p) / determinant];
        centre[0] += step[0];
        centre[1] += step[1];
        if step[0].abs() + step[1].abs() < 1e-12 {
            break;
        }
    }
    let (mut min, mut max) = (f64::INFINITY, 0.0_f64);
    for point in points {
        let off = distance(point, &centre);
        min = min.min(off);
        max = max.max(off);
    }
    Some(Circle {
        centre,
        radius,
        roundness: max - min,
        points: points.len(),
    })
}
