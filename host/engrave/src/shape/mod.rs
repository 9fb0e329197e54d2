//! Regions between closed paths: nesting, offsets, hatch rows, clearing.

pub mod clear;
mod crossing;
mod duplicates;
mod meeting;
pub mod region;

pub use clear::{Clearing, Strand};
pub use region::Region;
