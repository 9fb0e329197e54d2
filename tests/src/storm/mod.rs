//! The storm: random robustness episodes of the whole controller, each from one seed.
//! docs/storm.md describes it.

pub mod bench;
pub mod checks;
pub mod command;
pub mod episode;
pub mod files;
pub mod machines;
mod player;
pub mod reference;
pub mod report;
pub mod rng;
pub mod run;
mod script;
pub mod shrink;
pub mod units;
