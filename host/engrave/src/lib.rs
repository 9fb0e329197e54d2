//! From a drawing to a part program for an engraver.
//!
//! | module | content |
//! | --- | --- |
//! | [`read`] | DXF and SVG files to a [`drawing::Drawing`] |
//! | [`geometry`], [`curves`] | paths of lines and arcs, curves as arcs |
//! | [`shape`] | regions between closed paths: offsets, islands, clearing |
//! | [`job`], [`toolpath`] | operations, depths, ramps, leads, tabs |
//! | [`gcode`] | part programs |
//! | [`plate`] | a plate that is cut, against the drawing |
//! | [`preview`], [`times`] | the page of a job, and its time |
//! | [`order`] | the order in which paths are cut |
//! | [`thesis`] | the experiments of the thesis, repeated |

pub mod chain;
pub mod curves;
pub mod drawing;
pub mod gcode;
pub mod geometry;
pub mod job;
pub mod order;
pub mod plate;
pub mod preview;
pub mod read;
pub mod shape;
pub mod thesis;
pub mod times;
pub mod toolpath;

pub use kurbo;
