//! Quantities of force control: forces on the tool, gains of admittance control, and the compliant
//! displacement.
//!
//! | type | resolution | range |
//! | --- | --- | --- |
//! | [`Force`] | 2^-16 N | +-32768 N; sensor values are within [`Force::MAX`], 2048 N |
//! | [`VirtualMass`] | 2^-16 N s^2/mm | below 65536 |
//! | [`VirtualDamping`] | 2^-16 N s/mm | below 65536 |
//! | [`Displacement`] | 2^-40 mm | +-8.4 m |
//!
//! A [`Force`] is the force of the workpiece on the tool (docs/control.md 1.3). Callers must use
//! [`super::Effort`] for the effort of a drive.

use super::{Length, scale};

quantity! {
    /// A force on the tool along an axis of the workpiece, 2^-16 N.
    Force
}

impl Force {
    /// Raw units per newton.
    pub const PER_NEWTON: i32 = 1 << 16;
    /// Zero.
    pub const ZERO: Self = Self(0);
    /// Largest force that a sensor of this controller reports: 2048 N.
    pub const MAX: Self = Self(1 << 27);

    /// A force in thousandths of a newton, rounded to the nearest raw unit, saturating at the end
    /// of the range.
    #[must_use]
    pub const fn millinewtons(millinewtons: i32) -> Self {
        let raw = millinewtons as i64 * Self::PER_NEWTON as i64;
        Self(scale::saturate((raw + 500).div_euclid(1000)))
    }

    /// Magnitude as an integer.
    #[must_use]
    pub const fn magnitude(self) -> u32 {
        self.0.unsigned_abs()
    }

    /// This force, clamped to +-[`Force::MAX`].
    #[must_use]
    pub const fn held(self) -> Self {
        Self(if self.0 > Self::MAX.0 {
            Self::MAX.0
        } else if self.0 < -Self::MAX.0 {
            -Self::MAX.0
        } else {
            self.0
        })
    }
}

quantity! {
    /// Virtual mass K_A of docs/control.md (3.30): 2^-16 N s^2/mm.
    VirtualMass: u32
}

quantity! {
    /// Virtual damping K_V of docs/control.md (3.30): 2^-16 N s/mm.
    VirtualDamping: u32
}

/// A displacement for integration over a long time: 2^-40 mm.
///
/// A resolution of 2^-20 mm is too coarse for admittance control: a force of 0.024 N moves K_V = 5
/// N s/mm by less than one such unit in a period of 200 us.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Displacement(pub i64);

impl Displacement {
    /// The nearest length, saturating at the end of the range.
    #[must_use]
    pub const fn length(self) -> Length {
        Length(scale::saturate(scale::round_shift(self.0, 20)))
    }

    /// A length as a displacement.
    #[must_use]
    pub const fn from_length(length: Length) -> Self {
        Self((length.0 as i64) << 20)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forces_round_and_hold() {
        assert_eq!(Force::millinewtons(1000), Force(65_536));
        assert_eq!(Force::millinewtons(-1), Force(-66));
        assert_eq!(Force(i32::MIN).held(), Force(-Force::MAX.0));
        assert_eq!(Force(i32::MAX).held(), Force::MAX);
        assert_eq!(Force(i32::MIN).magnitude(), 1 << 31);
    }

    #[test]
    fn displacements_round_to_lengths() {
        assert_eq!(Displacement(1 << 19).length(), Length(1));
        assert_eq!(Displacement((1 << 19) - 1).length(), Length(0));
        assert_eq!(Displacement(i64::MIN).length(), Length::MIN);
        assert_eq!(Displacement::from_length(Length(-7)).length(), Length(-7));
    }
}
