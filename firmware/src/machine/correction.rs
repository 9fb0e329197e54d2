//! Volumetric compensation in the machine: between the commanded pose, or the reference under force
//! control, and the inverse kinematics.
//!
//! The commanded pose is the one of the program. Joints and strokes use the corrected one. The
//! correction is subtracted from the measured pose, so that it can be compared with the commanded
//! one.

use super::Machine;
use crate::config::volumetric::ERROR_VALUES;
use crate::digest::Digest;
use crate::volumetric::{Compensation, Fade};
use haptimill_kinematics::{Kinematics, Pose};
use haptimill_math::Coordinate;

/// Values of the error tables in one digest part. It bounds the instructions of a period for tables
/// of any size.
const DIGEST_VALUES: usize = 48;

/// Number of digest parts of the error tables.
pub(super) const VOLUMETRIC_PARTS: usize = 2 + ERROR_VALUES.div_ceil(DIGEST_VALUES);

impl Machine {
    /// One period of the fade. With the drives off there is no correction: at enable the commanded
    /// position becomes the measured one.
    #[inline]
    pub fn fade_compensation(&mut self, powered: bool, fade: Fade) {
        let locking = self.is_locking();
        if let Some(compensation) = &mut self.compensation {
            if powered {
                compensation.advance(if locking { Fade::Out } else { fade });
            } else {
                compensation.reset();
            }
        }
    }

    /// Makes the corrected pose the commanded one, and ends the correction: nothing moves.
    pub(super) fn rebase_on_correction(&mut self) {
        let Some(compensation) = &mut self.compensation else {
            return;
        };
        if compensation.is_active() {
            compensation.reset();
            if let Ok(pose) = self.kinematics.forward(&self.target.joints) {
                self.motion.set_position(&pose);
            }
        }
    }

    /// The pose of the tool from the pose of the joints: the correction is subtracted.
    #[inline]
    pub(super) fn uncorrected(&self, mut pose: Pose) -> Pose {
        if let Some(compensation) = &self.compensation
            && compensation.is_active()
        {
            for (coordinate, taken) in pose.0.iter_mut().zip(compensation.taken()) {
                *coordinate = Coordinate(coordinate.0.saturating_add(taken));
            }
        }
        pose
    }

    /// Adds a digest part of the error tables: 0 has the sizes, 1 the constants, the others have
    /// [`DIGEST_VALUES`] values each.
    pub(super) fn digest_volumetric(&self, part: usize, digest: &mut Digest) {
        let Some(config) = &self.config.volumetric else {
            return;
        };
        match part {
            0 => digest.add(&(&config.axes, config.shift, config.squareness)),
            1 => digest.add(&self.compensation.as_ref().map(Compensation::constants)),
            _ => digest.add(&config.values.chunks(DIGEST_VALUES).nth(part - 2)),
        }
    }
}
