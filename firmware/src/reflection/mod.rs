//! The hand: where it is, what it shall feel.

pub mod law;
pub mod passivity;
pub mod wall;
