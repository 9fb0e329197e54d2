//! Integration tests, as one binary because it builds faster than many. Tests of one module:
//! `cargo test -p haptimill-gcode --test all codes`.

mod codes;
mod language;
mod refusals;
mod tool_length;
