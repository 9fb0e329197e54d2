//! How a side of the stone is on the dop, and the pose of the machine for a facet.

use crate::design::Side;
use haptimill_hil_sim::vector::Vector;

/// How the stone sits on the dop: as in the design, or turned over about x for the pavilion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mount {
    /// Side that is cut.
    pub side: Side,
}

pub(super) const RADIAN: f64 = core::f64::consts::PI / 180.0;

/// Largest index of the first branch, degrees; beyond, the other one is taken.
const BRANCH_DEG: f64 = 160.0;

impl Mount {
    /// Images of x, y and z of the design in the frame of the tip, and the other way round.
    #[must_use]
    pub const fn axes(&self) -> [Vector; 3] {
        let flip = match self.side {
            Side::Pavilion => -1.0,
            Side::Crown => 1.0,
        };
        [[1.0, 0.0, 0.0], [0.0, flip, 0.0], [0.0, 0.0, flip]]
    }

    /// Angle and index of the machine that put a normal of the design on the lap, degrees: the
    /// angle of the facet with 180 degrees less its azimuth, or both negative. On a machine whose
    /// index wraps around the angle is that of the facet, and the index 0 to 360.
    #[must_use]
    pub fn pose(&self, normal: Vector, index_wraps: bool) -> [f64; 2] {
        let axes = self.axes();
        let turned: Vector = core::array::from_fn(|i| axes[i][i] * normal[i]);
        let across = libm::hypot(turned[0], turned[1]);
        let angle = libm::atan2(across, turned[2]) / RADIAN;
        if across < 1e-12 {
            return [angle, 0.0];
        }
        let azimuth = libm::atan2(turned[1], turned[0]) / RADIAN;
        let index = 180.0 - azimuth;
        if index_wraps {
            return [angle, index.rem_euclid(360.0)];
        }
        let index = index - 360.0 * libm::round(index / 360.0);
        if index.abs() > BRANCH_DEG {
            [-angle, -azimuth]
        } else {
            [angle, index]
        }
    }
}

/// Words of the index in the order of the job.
pub(super) struct IndexWords {
    /// The index wraps around.
    pub wraps: bool,
    /// Index before the next word, degrees.
    pub at: f64,
}

impl IndexWords {
    /// The word of an index. Where it wraps around, the word is the angle below a turn, and its
    /// sign the direction of the shorter way there.
    pub fn word(&mut self, index: f64) -> String {
        if !self.wraps {
            return format!("C{index:.6}");
        }
        // As it is written: it may round to a turn.
        let index = (1e6 * index).round() / 1e6;
        let index = index.rem_euclid(360.0);
        let turn = (index - self.at).rem_euclid(360.0);
        self.at = index;
        let sign = if turn > 180.0 { "-" } else { "" };
        format!("C{sign}{index:.6}")
    }
}
