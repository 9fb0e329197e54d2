//! Integration tests, as one binary because it builds faster than many. Tests of one module:
//! `cargo test -p haptimill-gcode --test all codes`.

mod codes;
mod language;
mod refusals;
mod tool_length;

use haptimill_gcode::Options;

/// Options of a machine with these letters, coolant and outputs.
fn options(letters: &str) -> Options {
    Options {
        coolant: true,
        outputs: true,
        ..Options::of_letters(letters, Default::default())
    }
}
