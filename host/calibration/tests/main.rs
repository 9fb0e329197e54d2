//! Integration tests, as one binary because it builds faster than many. Tests of one module:
//! `cargo test -p haptimill-calibration --test all arm`.

mod arm;
mod calibration;
mod compensation;
mod cut;
mod instruments;
mod report;
mod rewriting;
mod statistics;
mod tables;
