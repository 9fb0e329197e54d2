//! Integration tests, as one binary because it builds faster than many. Tests of one module:
//! `cargo test -p haptimill-machine-file --test all gantry`.

mod drive_chip;
mod gantry;
mod keys;
mod migrate;
mod one_mistake;
mod plant_keys;
mod plant_switches;
mod setpoint_bits;
