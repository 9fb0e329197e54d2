//! Virtual walls: a box that the hand is kept in, any face of which may move (docs/control.md 3.5, 7.1 item 30).
//!
//! A face pushes back in proportion to how far the tip is beyond it, and only then; up to a limit. Lengths 2^-20 mm, forces 2^-16 N.
//!
//! A face that stands is a spring: what it gives back was put in. What it holds at the moment is told ([`Walls::stored`]), so that the watch over the hand's energy lets it give that back. A face that moves against the hand
//! does work of its own, and that is not lent to it.
//!
//! Misuse: a box smaller than the ball at the tip; [`Walls::set`] refuses it.

use haptimill_math::force::Force;
use haptimill_math::scale::{product, saturate, total};
use haptimill_math::{Length, Rate};
use haptimill_protocol::haptic::COMPONENTS;
use serde::{Deserialize, Serialize};

/// How stiff the walls are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct WallConfig {
    /// Stiffness, 2^-16 N/mm: 0.05 to 2 N/mm. (0.35: what docs/control.md 3.5 finds in E6.)
    pub stiffness: u32,
    /// The most that a face pushes: 0.5 to 10 N.
    pub most: Force,
}

impl WallConfig {
    /// Whether both are within their ranges.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        (3276..=2 << 16).contains(&self.stiffness) && (1 << 15..=10 << 16).contains(&self.most.0)
    }
}

/// A face that is too near the opposite one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TooSmall;

/// A face of the box.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Face {
    /// Where it is, 2^-40 mm.
    at: i64,
    /// What it moves in a period, 2^-40 mm.
    step: i64,
    on: bool,
}

/// The walls around the hand.
#[derive(Debug, Clone)]
pub struct Walls {
    stiffness: i64,
    most: i64,
    /// How far beyond a face its push is the most, 2^-20 mm.
    deep: i64,
    period_us: i64,
    /// Least distance of two opposite faces.
    room: i64,
    /// Of each axis the lower and the upper face.
    faces: [[Face; 2]; COMPONENTS],
    stored: i64,
}

impl Walls {
    /// No faces. `ball` is the diameter of the tip.
    #[must_use]
    pub fn new(config: &WallConfig, ball: Length, period_us: u16) -> Self {
        let stiffness = i64::from(config.stiffness.max(1));
        Self {
            stiffness,
            most: i64::from(config.most.0),
            deep: (i64::from(config.most.0) << 20) / stiffness,
            period_us: i64::from(period_us),
            room: i64::from(ball.0) << 20,
            faces: [[Face::default(); 2]; COMPONENTS],
            stored: 0,
        }
    }

    /// Puts a face of an axis (`upper` or lower) at a place, moving at a rate; or takes it away.
    ///
    /// # Errors
    /// [`TooSmall`]: the ball would not fit between it and the opposite face. Nothing changes.
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
            // 2^-20 mm/s to 2^-40 mm in a period: below 2^31 * 2^10 * 2^20.
            step: i64::from(rate.0) * self.period_us * (1 << 20) / 1_000_000,
            on: true,
        };
        Ok(())
    }

    /// Takes all faces away.
    pub fn clear(&mut self) {
        self.faces = [[Face::default(); 2]; COMPONENTS];
    }

    /// Where the faces of an axis are.
    #[must_use]
    pub fn faces(&self, axis: usize) -> [Option<Length>; 2] {
        let faces = self.faces.get(axis).copied().unwrap_or_default();
        faces.map(|face| face.on.then(|| Length(saturate(face.at >> 20))))
    }

    /// What the walls would give back if the hand went out of them now, 2^-36 N mm.
    #[must_use]
    pub const fn stored(&self) -> i64 {
        self.stored
    }

    /// One period: the push on a tip.
    pub fn push(&mut self, tip: &[i32; COMPONENTS]) -> [Force; COMPONENTS] {
        let mut forces = [Force::ZERO; COMPONENTS];
        self.stored = 0;
        for (axis, faces) in self.faces.iter_mut().enumerate() {
            for (face, sign) in faces.iter_mut().zip([1, -1]) {
                if !face.on {
                    continue;
                }
                // It comes to a stop at the end of what a length can be.
                face.at = total(face.at, face.step).clamp(-(1 << 51), 1 << 51);
                // Both are at most 2^31.
                let beyond = (face.at >> 20) - i64::from(tip[axis]);
                let depth = if sign < 0 { -beyond } else { beyond };
                if depth <= 0 {
                    continue;
                }
                // At most 2^20 << 20 before it is shifted; what is stored is below 2^20 * 2^33 for each face.
                let spring = depth.min(self.deep);
                let force = (product(spring, self.stiffness) >> 20).min(self.most);
                self.stored = total(self.stored, product(force, depth - spring / 2));
                let force = force as i32;
                forces[axis].0 += if sign < 0 { -force } else { force };
            }
        }
        forces
    }
}
