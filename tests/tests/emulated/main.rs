//! Tests of emulated boards, one binary. They need the image of a board and the emulator: `cargo
//! xtask test` provides both.

mod checks;
mod emulator;
mod faults;
mod instructions;
mod job;
mod line;
mod log;
