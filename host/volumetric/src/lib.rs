//! Geometric errors of machine tools with three linear axes: what they are, what they do to the
//! tool and to the part, and how they are measured.
//!
//! | module | content |
//! | --- | --- |
//! | [`errors`] | the 21 error functions, by their names of ISO 230-1 |
//! | [`mod@file`] | error tables and closed forms as CSV |
//! | [`chain`] | the error of the tool relative to the workpiece, from the functions |
//! | [`grid`] | volumetric error over a grid of points |
//! | [`gdt`] | form and position from measured points: least squares and minimum zone |
//! | [`readings`] | readings of a laser as CSV |
//! | [`circle_readings`] | readings of a double ball bar as CSV |
//! | [`part`] | the test piece A160 of ISO 10791-7: its features, its surfaces, its tolerances |
//!
//! Units are mm and radians. Files have um and urad, and say so. Every error has the sign of the
//! tool relative to the workpiece, positive along the coordinate, or about it by the right-hand
//! rule.

pub mod chain;
pub mod circle_readings;
pub mod errors;
pub mod file;
pub mod gdt;
pub mod grid;
pub mod part;
pub mod readings;

/// A vector in x, y, z.
pub type Vector = nalgebra::Vector3<f64>;
