//! Integration tests, as one binary because it builds faster than many. Tests of one module:
//! `cargo test -p haptimill --test all board_configuration`.

mod board_configuration;
mod calibrate;
mod cli;
#[cfg(feature = "console")]
mod console;
mod engrave;
mod facet;
mod faults;
mod flash;
#[cfg(unix)]
mod flash_programs;
mod force_settings;
mod grbl;
mod identify;
mod invalid_inputs;
mod machine_files;
mod machines;
mod mcap;
mod operation;
mod pulses;
mod result_files;
mod run;
mod scenario;
mod scene;
mod serve;
mod served_access;
mod simple_commands;
mod step_drives;
mod teleop;
#[cfg(unix)]
mod terminal;
mod trace;
#[cfg(feature = "console")]
mod web;
