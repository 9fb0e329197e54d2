//! The planner against independent mathematics: the cubics of its integer setpoints, differentiated here; programs of known geometry.

mod h4;
mod properties;
mod spans;
