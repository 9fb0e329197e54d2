//! Integration tests, as one binary because it builds faster than many. Tests of one module:
//! `cargo test -p haptimill-engrave --test all jobs`.

mod common;
mod jobs;
mod program;
mod read_dialects;
mod read_dxf;
mod read_svg;
mod read_text;
mod thesis_order;
