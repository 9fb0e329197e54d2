//! The simulated machine.
//!
//! Plain f64 physics in virtual time: no clock, no thread, no randomness but seeded. The same seed and the same inputs give the
//! same bits on every host: transcendental functions come from the crate libm, and no product is fused into a sum.
//!
//! * [`config`]: what the machine is made of; the `[plant]` section of a machine file.
//! * [`mechanics`]: masses, screws, frictions, hard stops.
//! * [`encoder`], [`stepper`]: the devices between the mechanics and the controller's counts and codes.
//! * [`geometry`]: where the tool is, from the closed loops of the rods.
//! * [`cutting`]: the mill, the workpiece that it shapes, and the force between them.
//! * [`structure`]: what gives way between slides and tool; [`sensor`]: what measures the force under the work.
//! * [`haptic`]: the master arm that a hand leads; [`hand`]: the person at it.
//! * [`process`]: all of that, one control period at a time.
//! * [`plant`]: all of it, one control period at a time.
//! * [`wire`]: the serial line; [`fault`], [`schedule`]: what goes wrong, and when.
//! * [`rig`]: machine, controller and line in lockstep; [`tape`]: all that the controller sensed and said.

pub mod config;
pub mod cutting;
pub mod encoder;
pub mod fault;
pub mod geometry;
pub mod hand;
pub mod haptic;
pub mod mechanics;
pub mod plant;
pub mod process;
pub mod random;
pub mod remote;
pub mod rig;
pub mod schedule;
pub mod sensor;
pub mod stepper;
pub mod structure;
pub mod tape;
pub mod wire;

pub use config::PlantConfig;
pub use fault::Fault;
pub use plant::{Plant, Truth};
pub use rig::{Control, Rig, RigOptions};
