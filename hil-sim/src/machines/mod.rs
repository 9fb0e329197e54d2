//! Machine geometries of the simulator, one file each.
//!
//! A geometry is written in f64 from the loop-closure equations, independently of the firmware's
//! formulas.

pub mod h4;
