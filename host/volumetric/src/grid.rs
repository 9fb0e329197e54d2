//! Volumetric error over a grid of work points.

use crate::Vector;

/// Points of a grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    /// Coordinates of the points along each axis, mm.
    pub places: [Vec<f64>; 3],
}

impl Grid {
    /// The grid of the acceptance of the simulated machine: 9 x 9 points over the part of 160 mm,
    /// at three heights of its features.
    #[must_use]
    pub fn part() -> Self {
        let side: Vec<f64> = (0..9).map(|step| -80.0 + 20.0 * f64::from(step)).collect();
        Self {
            places: [side.clone(), side, vec![0.0, -10.0, -38.0]],
        }
    }

    /// All points; x changes fastest, and every second row runs backwards, as a machine drives it.
    #[must_use]
    pub fn points(&self) -> Vec<Vector> {
        let [xs, ys, zs] = &self.places;
        let mut points = Vec::with_capacity(xs.len() * ys.len() * zs.len());
        let mut backwards = false;
        for z in zs {
            for y in ys {
                let row = xs.iter().map(|x| Vector::new(*x, *y, *z));
                if backwards {
                    points.extend(row.rev());
                } else {
                    points.extend(row);
                }
                backwards = !backwards;
            }
        }
        points
    }
}

/// Sizes of a set of errors, mm.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sizes {
    /// Largest.
    pub largest: f64,
    /// Root of the mean square.
    pub rms: f64,
}

impl Sizes {
    /// Sizes of these errors; 0 without any.
    #[must_use]
    pub fn of(errors: impl IntoIterator<Item = Vector>) -> Self {
        let (mut count, mut squares, mut largest) = (0_u32, 0.0_f64, 0.0_f64);
        for error in errors {
            count += 1;
            squares += error.norm_squared();
            largest = largest.max(error.norm());
        }
        Self {
            largest,
            rms: libm::sqrt(squares / f64::from(count.max(1))),
        }
    }
}

/// The point that a control commands so that the tool comes to `point`: one pass, c = p - error(p).
pub fn compensated(point: Vector, error: impl Fn(Vector) -> Vector) -> Vector {
    point - error(point)
}

/// Where the tool is when the control commands `commanded`.
pub fn reached(commanded: Vector, error: impl Fn(Vector) -> Vector) -> Vector {
    commanded + error(commanded)
}
