//! Measures the geometric errors of a simulated machine through the real protocol, and shows what
//! their compensation does.
//!
//! | module | content |
//! | --- | --- |
//! | [`observed`] | a simulated machine whose ground truth is sampled |
//! | [`drive`] | home it, run part programs on it, read the places where it stood still |
//! | [`targets`] | target positions of ISO 230-2, evaluation of its cycles |
//! | [`laser`] | the instruments: laser interferometer, roll instrument, square |
//! | [`calibrate`] | a whole measurement, and the error functions that it identifies |
//! | [`cut`] | the test piece, cut and measured |
//! | [`ball_bar`] | the circle test of ISO 230-4 |
//! | [`arm`] | calibration of the H-4 arm by a fit |
//! | [`statistics`] | trend curves and correlations of the thesis |
//! | [`comparison`] | model against part, as the thesis tabulates it |
//! | [`scenario`] | everything in one run |

pub mod arm;
pub mod ball_bar;
pub mod calibrate;
pub mod comparison;
pub mod cut;
pub mod drive;
pub mod laser;
pub mod noise;
pub mod observed;
pub mod page;
pub mod rewrite;
pub mod scenario;
pub mod statistics;
pub mod targets;
