//! Fixed-point quantities. A length is not an angle; neither is an integer.
//!
//! The corridor works on axes that are linear or rotary, whichever the machine file says. Their quantities are in *axis units* (au):
//! 2^-20 mm for a linear axis, 2^-32 turn for a rotary one; the geometry of a machine, which knows which is which, converts to
//! [`Length`] and [`Angle`].
//!
//! | type | resolution, linear | range, linear | resolution, rotary | range, rotary |
//! | --- | --- | --- | --- | --- |
//! | [`Coordinate`] | 2^-20 mm | +-2048 mm | 2^-32 turn | one turn, wraps around |
//! | [`Rate`] | 2^-20 mm/s | +-2048 mm/s | 2^-32 turn/s | +-0.5 turn/s |
//! | [`Acceleration`] | 2^-12 mm/s^2 | +-524 m/s^2 | 2^-24 turn/s^2 | +-128 turn/s^2 |
//! | [`Effort`] | 2^-16 N | +-32768 N | 2^-16 N m | +-32768 N m |

/// Defines a newtype over `i32` with its raw value public.
macro_rules! quantity {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub struct $name(pub i32);
    };
}

quantity! {
    /// A length, 2^-20 mm (0.95 nm), +-2048 mm.
    Length
}
quantity! {
    /// An angle, 2^-32 turn; wrap-around is the arithmetic's own. -2^31 is -180 degrees.
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
    /// The acceleration of an axis, 256 axis units per second squared: 2^-12 mm/s^2 or 2^-24 turn/s^2.
    Acceleration
}
quantity! {
    /// What a drive exerts on its axis: 2^-16 N on a linear axis, 2^-16 N m on a rotary one.
    Effort
}
