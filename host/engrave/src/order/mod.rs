//! The order in which paths are cut.
//!
//! [`edges`] has the four greedy conditions and the file order of the thesis, [`rows`] its rules
//! for the hatch rows of a pocket. [`tour`] is the order that the program uses: paths may be
//! reversed, closed paths may start anywhere.

pub mod edges;
mod entry;
mod exact;
mod local;
mod nearness;
mod neighbours;
mod pieces;
mod random;
pub mod rows;
mod start;
mod starts;
pub mod tour;

pub use pieces::Placed;
pub use tour::{Effort, Tour, order_passes, order_paths};
