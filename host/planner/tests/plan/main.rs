//! The planner against independent mathematics: the cubics of its integer setpoints, differentiated
//! here, and programs of known geometry.

mod deviations;
mod examples;
mod h4;
mod override_modes;
mod properties;
mod refusals;
mod spans;
mod stream;
mod times;
