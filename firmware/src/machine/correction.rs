//! Volumetric compensation in the machine: between the commanded pose, or the reference under force
//! control, and the inverse kinematics.
//!
//! The commanded pose is the one of the program. Joints and strokes use the corrected one. The
//! correction is subtracted from the measured pose, so that it can be compared with the commanded
//! one.

use super::Machine;
use super::configure::VOLUMETRIC_PART;
use crate::config::digest::Digest;
use crate::config::volumetric::ERRORS;
use crate::volumetric::Fade;
use haptimill_kinematics::{Kinematics, Pose};
use haptimill_math::Coordinate;

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

    /// Adds a digest part of the error tables: 0 has the sizes, the others the values of one axis
    /// each.
    pub(super) fn digest_volumetric(&self, part: usize, digest: &mut Digest) {
        let Some(config) = &self.config.volumetric else {
            return;
        };
        let Some(axis) = part.checked_sub(1) else {
            digest.add(&(&config.axes, config.shift, config.squareness));
            let constants = self.compensation.as_ref().map(|known| known.constants());
            digest.add(&constants);
            return;
        };
        let start = config.start(axis);
        let end = start + usize::from(config.axes[axis].nodes) * ERRORS;
        digest.add(&config.values.get(start..end));
        debug_assert!(part < super::PARTS - VOLUMETRIC_PART);
    }
}
