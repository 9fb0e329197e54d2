//! Integration tests, as one binary because it builds faster than many. Tests of one module:
//! `cargo test -p haptimill-volumetric --test all equations`.

mod equations;
mod evaluators;
mod file;
mod golden;
