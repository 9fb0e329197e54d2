//! Virtual fixture: a box around the master's tip, whose faces push back and may move
//! (docs/control.md 3.5, 7.1 item 30).
//!
//! A face pushes in proportion to the penetration of the tip, up to a limit. Units: lengths 2^-20
//! mm, forces 2^-16 N.
//!
//! A stationary face is a spring: it returns only energy that was put in.
//! [`VirtualFixtures::stored`] reports its present energy, so that the passivity observer lets it
//! return. A face that moves against the operator does work of its own, which does not count as
//! stored.
//!
//! A box must not be smaller than the ball at the tip; [`VirtualFixtures::set`] refuses it.

use haptimill_math::force::Force;
use haptimill_math::scale::{product, saturate, total};
use haptimill_math::{Length, Rate};
use haptimill_protocol::haptic::COMPONENTS;
use serde::{Deserialize, Serialize};

/// Stiffness and force limit of the virtual fixtures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct FixtureConfig {
    /// Stiffness, 2^-16 N/mm: 0.05 to 2 N/mm. (0.35: result of E6 in docs/control.md 3.5.)
    pub stiffness: u32,
    /// Largest force of a face: 0.5 to 10 N.
    pub max: Force,
}

impl FixtureConfig {
    /// Whether both values are in range.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        (3276..=2 << 16).contains(&self.stiffness) && (1 << 15..=10 << 16).contains(&self.max.0)
    }
}

/// Error: a face is too near the opposite one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TooSmall;

/// Face of the box.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Face {
    /// Position, 2^-40 mm.
    at: i64,
    /// Displacement per control period, 2^-40 mm.
    step: i64,
    on: bool,
}

/// Faces of the virtual fixtures.
#[derive(Debug, Clone)]
pub struct VirtualFixtures {
    stiffness: i64,
    max: i64,
    /// Penetration at which the force of a face reaches its limit, 2^-20 mm.
    deep: i64,
    period_us: i64,
    /// Smallest distance of two opposite faces.
    room: i64,
    /// Lower and upper face of each axis.
    faces: [[Face; 2]; COMPONENTS],
    stored: i64,
}

impl VirtualFixtures {
    /// Creates fixtures without faces. `ball` is the diameter of the ball at the tip.
    #[must_use]
    pub fn new(config: &FixtureConfig, ball: Length, period_us: u16) -> Self {
        let stiffness = i64::from(config.stiffness.max(1));
        Self {
            stiffness,
            max: i64::from(config.max.0),
            deep: (i64::from(config.max.0) << 20) / stiffness,
            period_us: i64::from(period_us),
            room: i64::from(ball.0) << 20,
            faces: [[Face::default(); 2]; COMPONENTS],
            stored: 0,
        }
    }

    /// Sets a face of an axis (`upper` or lower) at a position, moving at a rate; or removes it.
    ///
    /// # Errors
    ///
    /// Returns [`TooSmall`] if the ball does not fit between it and the opposite face, or if there
    /// is no such axis. Nothing changes.
    pub fn set(
        &mut self,
        axis: usize,
        upper: bool,
        place: Option<(Length, Rate)>,
    ) -> Result<(), TooSmall> {
        let Some(faces) = self.faces.get_mut(axis) else {
            return Err(TooSmall);
        };
        let side = usize::from(upper);
        let Some((at, rate)) = place else {
            faces[side].on = false;
            return Ok(());
        };
        let at = i64::from(at.0) << 20;
        let opposite = &faces[1 - side];
        let gap = if upper {
            at - opposite.at
        } else {
            opposite.at - at
        };
        if opposite.on && gap < self.room {
            return Err(TooSmall);
        }
        faces[side] = Face {
            at,
            // 2^-20 mm/s to 2^-40 mm per control period: below 2^31 * 2^10 * 2^20.
            step: i64::from(rate.0) * self.period_us * (1 << 20) / 1_000_000,
            on: true,
        };
        Ok(())
    }

    /// Removes all faces.
    pub fn clear(&mut self) {
        self.faces = [[Face::default(); 2]; COMPONENTS];
    }

    /// Positions of the faces of an axis, lower and upper; `None` for no face.
    #[must_use]
    pub fn faces(&self, axis: usize) -> [Option<Length>; 2] {
        let faces = self.faces.get(axis).copied().unwrap_or_default();
        faces.map(|face| face.on.then(|| Length(saturate(face.at >> 20))))
    }

    /// Energy that the fixtures would return if the tip left them now, 2^-36 N mm.
    #[must_use]
    pub const fn stored(&self) -> i64 {
        self.stored
    }

    /// Computes the force on a tip, and moves the faces by one control period.
    pub fn push(&mut self, tip: &[i32; COMPONENTS]) -> [Force; COMPONENTS] {
        let mut forces = [Force::ZERO; COMPONENTS];
        self.stored = 0;
        for (axis, faces) in self.faces.iter_mut().enumerate() {
            for (face, sign) in faces.iter_mut().zip([1, -1]) {
                if !face.on {
                    continue;
                }
                // A face stops at the end of the range of a length.
                face.at = total(face.at, face.step).clamp(-(1 << 51), 1 << 51);
                // Both are at most 2^31.
                let beyond = (face.at >> 20) - i64::from(tip[axis]);
                let depth = if sign < 0 { -beyond } else { beyond };
                if depth <= 0 {
                    continue;
                }
                // At most 2^20 << 20 before the shift; the stored energy is below 2^20 * 2^33 for
                // each face.
                let spring = depth.min(self.deep);
                let force = (product(spring, self.stiffness) >> 20).min(self.max);
                self.stored = total(self.stored, product(force, depth - spring / 2));
                let force = force as i32;
                forces[axis].0 += if sign < 0 { -force } else { force };
            }
        }
        forces
    }
}
