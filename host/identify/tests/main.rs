//! Integration tests, as one binary because it builds faster than many. Tests of one module:
//! `cargo test -p haptimill-identify --test all lost_motion`.

mod index_pulses;
mod lost_motion;
mod simulated;
mod step_motors;
