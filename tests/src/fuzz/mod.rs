//! The fuzz test: random sequences of events against the whole controller, each from one seed.
//! docs/fuzzing.md describes it.

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
