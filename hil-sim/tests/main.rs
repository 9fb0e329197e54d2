//! Integration tests, as one binary because it builds faster than many. Tests of one module:
//! `cargo test -p haptimill-hil-sim --test all cutting`.

mod cutting;
mod cutting_experiments;
mod cutting_forces;
mod cutting_surface;
mod devices;
mod geometry;
mod grinding;
mod haptic_dynamics;
mod haptic_geometry;
mod haptic_rig;
mod machine;
mod mechanics;
mod mill;
mod operator;
mod polyhedron;
mod process;
mod rig;
mod sensor;
