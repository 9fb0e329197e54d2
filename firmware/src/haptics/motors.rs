//! Six motors of the haptic arm: from the force on the operator to codes of the current amplifiers.
//!
//! Arithmetic is in f32, like the statics. If a motor would exceed its limit, all six are scaled by
//! the same factor, so the force keeps its direction.
#![allow(
    clippy::float_arithmetic,
    reason = "behind the 6 x 6 system of the haptic arm, which is f32"
)]

use super::config::Amplifier;
use crate::io::LEGS;
use core::hash::{Hash, Hasher};
use haptimill_kinematics::haptic_arm::statics::{Singular, Wrench};
use haptimill_kinematics::haptic_arm::{ArmPose, HapticArm};

/// Largest magnitude of a code.
const CODE_MAX: f32 = 8191.0;

/// Amplifiers: codes per unit of effort, and largest effort, in N or N mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motors {
    gains: [[f32; 2]; LEGS],
    limits: [[f32; 2]; LEGS],
    condition: f32,
}

impl Hash for Motors {
    fn hash<H: Hasher>(&self, state: &mut H) {
        for value in self.gains.iter().chain(&self.limits).flatten() {
            value.to_bits().hash(state);
        }
        self.condition.to_bits().hash(state);
    }
}

impl Motors {
    /// Creates the motors of a sound configuration.
    #[must_use]
    pub fn new(amplifiers: &[[Amplifier; 2]; LEGS], condition: u16) -> Self {
        // Efforts are in 2^-16 N or N m; the statics use N and N mm.
        let unit = |index: usize| {
            if index == 0 {
                1.0 / 65_536.0
            } else {
                1000.0 / 65_536.0
            }
        };
        let each = |value: fn(&Amplifier, f32) -> f32| {
            amplifiers.map(|leg| core::array::from_fn(|index| value(&leg[index], unit(index))))
        };
        Self {
            gains: each(|amplifier, unit| 8192.0 / (amplifier.full_scale.0 as f32 * unit)),
            limits: each(|amplifier, unit| amplifier.limit.0 as f32 * unit),
            condition: f32::from(condition),
        }
    }

    /// Computes the codes of a wrench, and the fraction of the wrench that they produce, 2^-16.
    ///
    /// # Errors
    ///
    /// Returns [`Singular`] if the statics are singular.
    pub fn currents(
        &self,
        arm: &HapticArm,
        pose: &ArmPose,
        wrench: &Wrench,
    ) -> Result<([[i16; 2]; LEGS], i32), Singular> {
        let efforts = arm.efforts(pose, wrench, self.condition)?;
        let mut share = 1.0_f32;
        for (effort, limit) in efforts
            .iter()
            .zip(&self.limits)
            .flat_map(|(efforts, limits)| efforts.iter().zip(limits))
        {
            let size = effort.abs();
            if size * share > *limit {
                share = limit / size;
            }
        }
        let mut codes = [[0; 2]; LEGS];
        for (leg, codes) in codes.iter_mut().enumerate() {
            for (index, code) in codes.iter_mut().enumerate() {
                let value = efforts[leg][index] * share * self.gains[leg][index];
                let rounded = value + if value < 0.0 { -0.5 } else { 0.5 };
                // A cast truncates towards zero and converts NaN to 0. A cast to a word is one
                // instruction.
                *code = rounded.clamp(-CODE_MAX, CODE_MAX) as i32 as i16;
            }
        }
        Ok((codes, (share * 65_536.0) as i32))
    }
}
