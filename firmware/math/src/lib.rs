//! Fixed-point quantities. Lengths, angles and integers are distinct types.
//!
//! The control cycle works on linear and rotary axes alike, as the machine file defines them. Their
//! quantities are in *axis units* (au): 2^-20 mm for a linear axis, 2^-32 turn for a rotary one. A
//! multi-turn rotary joint has 2^-22 turn: 1024 times the ranges of the table, without
//! wrap-around.
//! The geometry of a machine knows the kind of each axis and converts to [`Length`] and [`Angle`].
//!
//! | type | resolution, linear | range, linear | resolution, rotary | range, rotary |
//! | --- | --- | --- | --- | --- |
//! | [`Coordinate`] | 2^-20 mm | +-2048 mm | 2^-32 turn | one turn, wraps around |
//! | [`Rate`] | 2^-20 mm/s | +-2048 mm/s | 2^-32 turn/s | +-0.5 turn/s |
//! | [`Acceleration`] | 2^-12 mm/s^2 | +-524 m/s^2 | 2^-24 turn/s^2 | +-128 turn/s^2 |
//! | [`Effort`] | 2^-16 N | +-32768 N | 2^-16 N m | +-32768 N m |

#![no_std]
#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

/// Defines a newtype with a public raw value, over `i32` or over the named integer type.
macro_rules! quantity {
    ($(#[$doc:meta])* $name:ident) => {
        quantity! { $(#[$doc])* $name: i32 }
    };
    ($(#[$doc:meta])* $name:ident: $raw:ty) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub struct $name(pub $raw);
    };
}

quantity! {
    /// A gain of a control loop, 2^-8 of its unit (1/s^2, 1/s or 1/s^3, depending on its use), up
    /// to 16.7 million.
    Gain: u32
}

quantity! {
    /// A length, 2^-20 mm (0.95 nm), +-2048 mm.
    Length
}
quantity! {
    /// An angle, 2^-32 turn; wrap-around is that of the integer. -2^31 is -180 degrees.
    Angle
}
quantity! {
    /// The coordinate of an axis, in axis units: 2^-20 mm or 2^-32 turn.
    Coordinate
}
quantity! {
    /// The rate of an axis, axis units per second: 2^-20 mm/s or 2^-32 turn/s.
    Rate
}
quantity! {
    /// The acceleration of an axis, 256 axis units per second squared: 2^-12 mm/s^2 or 2^-24
    /// turn/s^2.
    Acceleration
}
quantity! {
    /// Effort of a drive: 2^-16 N on a linear axis, 2^-16 N m on a rotary one.
    Effort
}

pub mod force;
pub mod reciprocal;
pub mod root;
pub mod scale;
pub mod trig;

/// Operations that every quantity has. The name of each states its behaviour at the end of the
/// range.
macro_rules! operations {
    ($($name:ident),*) => {$(
        impl $name {
            /// Zero.
            pub const ZERO: Self = Self(0);
            /// Smallest value.
            pub const MIN: Self = Self(i32::MIN);
            /// Largest value.
            pub const MAX: Self = Self(i32::MAX);

            /// Sum, or `None` beyond the range.
            pub const fn checked_add(self, other: Self) -> Option<Self> {
                match self.0.checked_add(other.0) {
                    Some(raw) => Some(Self(raw)),
                    None => None,
                }
            }

            /// Difference, or `None` beyond the range.
            pub const fn checked_sub(self, other: Self) -> Option<Self> {
                match self.0.checked_sub(other.0) {
                    Some(raw) => Some(Self(raw)),
                    None => None,
                }
            }

            /// Sum, saturating at the end of the range.
            pub const fn saturating_add(self, other: Self) -> Self {
                Self(self.0.saturating_add(other.0))
            }

            /// Difference, saturating at the end of the range.
            pub const fn saturating_sub(self, other: Self) -> Self {
                Self(self.0.saturating_sub(other.0))
            }

            /// Negative value; that of [`Self::MIN`] is [`Self::MAX`].
            pub const fn saturating_neg(self) -> Self {
                Self(self.0.saturating_neg())
            }

            /// Magnitude as an integer, which also holds that of [`Self::MIN`].
            pub const fn magnitude(self) -> u32 {
                self.0.unsigned_abs()
            }

            /// Quantity from a wider raw value, saturating at the end of the range.
            pub const fn saturating_from(raw: i64) -> Self {
                Self(scale::saturate(raw))
            }
        }
    )*};
}

operations!(Length, Coordinate, Rate, Acceleration, Effort);

impl Length {
    /// Raw units per millimetre.
    pub const PER_MILLIMETRE: i32 = 1 << 20;

    /// A whole number of millimetres, saturating at the end of the range (+-2047 mm).
    pub const fn millimetres(millimetres: i32) -> Self {
        Self::saturating_from(millimetres as i64 * Self::PER_MILLIMETRE as i64)
    }

    /// A whole number of nanometres, rounded to the nearest raw unit (0.95 nm), saturating at the
    /// end of the range.
    pub const fn nanometres(nanometres: i32) -> Self {
        let raw = nanometres as i64 * Self::PER_MILLIMETRE as i64;
        Self::saturating_from((raw + 500_000).div_euclid(1_000_000))
    }
}

impl Angle {
    /// Zero.
    pub const ZERO: Self = Self(0);
    /// Quarter turn, 90 degrees.
    pub const QUARTER: Self = Self(1 << 30);
    /// Half turn; +180 and -180 degrees are the same angle.
    pub const HALF: Self = Self(i32::MIN);

    /// A whole number of degrees, wrapped into one turn and rounded to the nearest raw unit.
    pub const fn degrees(degrees: i32) -> Self {
        let raw = (degrees as i64) << 32;
        Self((raw + 180).div_euclid(360) as i32)
    }

    /// Sum, wrapping around at the turn.
    pub const fn wrapping_add(self, other: Self) -> Self {
        Self(self.0.wrapping_add(other.0))
    }

    /// Difference, the shorter way round.
    pub const fn wrapping_sub(self, other: Self) -> Self {
        Self(self.0.wrapping_sub(other.0))
    }

    /// Negative angle; that of a half turn is the half turn.
    pub const fn wrapping_neg(self) -> Self {
        Self(self.0.wrapping_neg())
    }
}

impl Coordinate {
    /// Sum, wrapping around at the turn; for rotary axes only.
    pub const fn wrapping_add(self, other: Self) -> Self {
        Self(self.0.wrapping_add(other.0))
    }

    /// Difference, the shorter way round; for rotary axes only.
    pub const fn wrapping_sub(self, other: Self) -> Self {
        Self(self.0.wrapping_sub(other.0))
    }

    /// Coordinate of a linear axis as a length.
    pub const fn length(self) -> Length {
        Length(self.0)
    }

    /// Coordinate of a rotary axis as an angle.
    pub const fn angle(self) -> Angle {
        Angle(self.0)
    }
}

impl From<Length> for Coordinate {
    fn from(length: Length) -> Self {
        Self(length.0)
    }
}

impl From<Angle> for Coordinate {
    fn from(angle: Angle) -> Self {
        Self(angle.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constructors_round_and_hold() {
        assert_eq!(Length::millimetres(-3), Length(-3 << 20));
        assert_eq!(Length::millimetres(4000), Length::MAX);
        assert_eq!(Length::nanometres(1_000_000), Length::millimetres(1));
        assert_eq!(Length::nanometres(-1), Length(-1));
        assert_eq!(Angle::degrees(90), Angle::QUARTER);
        assert_eq!(Angle::degrees(-180), Angle::HALF);
        assert_eq!(Angle::degrees(450), Angle::QUARTER);
    }

    #[test]
    fn the_ends_of_the_range_are_kept_or_reported() {
        assert_eq!(Rate::MAX.checked_add(Rate(1)), None);
        assert_eq!(Rate::MIN.checked_sub(Rate(1)), None);
        assert_eq!(Rate::MAX.saturating_add(Rate(1)), Rate::MAX);
        assert_eq!(Rate::MIN.saturating_neg(), Rate::MAX);
        assert_eq!(Effort::MIN.magnitude(), 1 << 31);
        assert_eq!(Effort::saturating_from(i64::MIN), Effort::MIN);
    }

    #[test]
    fn an_angle_goes_round() {
        assert_eq!(Angle::HALF.wrapping_neg(), Angle::HALF);
        let three_quarters = Angle::HALF.wrapping_add(Angle::QUARTER);
        assert_eq!(three_quarters, Angle::QUARTER.wrapping_neg());
        assert_eq!(three_quarters.wrapping_sub(Angle::QUARTER), Angle::HALF);
    }
}
