//! Time of a job without acceleration.

use crate::toolpath::Lengths;
use serde::Serialize;

/// Speeds of a job.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Speeds {
    /// Feed along the paths, mm/s.
    pub feed: f64,
    /// Feed of plunges, mm/s.
    pub plunge: f64,
    /// Lifted moves, mm/s.
    pub rapid: f64,
    /// Rapid moves straight up, mm/s.
    pub rise: f64,
    /// Height of lifted moves, mm.
    pub lift_mm: f64,
}

impl Default for Speeds {
    /// Those of the built-in engraver with the feeds of `haptimill engrave`.
    fn default() -> Self {
        Self {
            feed: 5.0,
            plunge: 1.0,
            rapid: 20.0,
            rise: 4.0,
            lift_mm: 1.0,
        }
    }
}

/// Times of a job, s.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Times {
    /// Along the cuts.
    pub cut: f64,
    /// Lifted moves.
    pub air: f64,
    /// Straight down and up.
    pub lifts: f64,
}

impl Times {
    /// The times of lengths.
    #[must_use]
    pub fn of(lengths: &Lengths, speeds: &Speeds) -> Self {
        let above = lengths.lifts as f64 * speeds.lift_mm;
        Self {
            cut: lengths.cut_mm / speeds.feed,
            air: lengths.air_mm / speeds.rapid,
            lifts: (above + lengths.plunge_mm) / speeds.plunge
                + (above + lengths.rise_mm) / speeds.rise,
        }
    }

    /// Their sum.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.cut + self.air + self.lifts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Path;
    use crate::toolpath::{Depths, Toolpath, cut_path};

    /// A square of 10 mm at (3, 4), in two depths down to 1 mm: `L_cut / v + L_air / v_air + n Tz`
    /// with the numbers of the drawing. A lift cycle is 2 mm down at 1 mm/s and 2 mm up at 4 mm/s.
    #[test]
    fn the_time_is_that_of_the_formula() {
        let square = [[3.0, 4.0], [13.0, 4.0], [13.0, 14.0], [3.0, 14.0]];
        let depths = Depths {
            levels: vec![-0.5, -1.0],
            slope: None,
            tabs: None,
        };
        let cut = cut_path(&Path::polygon(&square, 0), &depths);
        let speeds = Speeds {
            feed: 5.0,
            plunge: 1.0,
            rapid: 20.0,
            rise: 4.0,
            lift_mm: 1.0,
        };
        let toolpath = Toolpath { cuts: vec![cut] };
        let times = Times::of(&toolpath.lengths([0.0; 2]), &speeds);
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
        close(times.cut, 80.0 / 5.0);
        close(times.air, 10.0 / 20.0);
        close(times.lifts, 2.0 / 1.0 + 2.0 / 4.0);
        close(times.total(), 16.0 + 0.5 + 2.5);
    }
}
