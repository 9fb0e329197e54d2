//! Integration tests, as one binary because it builds faster than many. Tests of one module:
//! `cargo test -p haptimill-facet --test all cutting`.

mod cutting;
mod designs;
mod machine;
