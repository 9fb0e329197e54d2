//! Simulation of the machine: drives, mechanics, sensors, cutting process, haptic arm and serial
//! line.
//!
//! The physics is computed in f64 and in virtual time. The crate uses no clock and no thread; all
//! random numbers are seeded. The same seed and the same inputs give the same bits on every host:
//! transcendental functions come from the crate libm, and no product is fused into a sum.
//!
//! * [`config`]: the `[plant]` section of a machine file; [`check`]: its problems.
//! * [`joint`]: mechanics, encoder and drive of one joint.
//! * [`machines`]: machine geometries, from their loop-closure equations.
//! * [`process`]: spindle, cutter, workpiece, cutting force, structure, force sensor.
//! * [`haptics`]: the haptic master arm; [`operator`]: the operator model that moves it.
//! * [`contact`]: named inputs, the contacts of a probe and a tool setter.
//! * [`polyhedron`]: a convex body that planes cut, for gems.
//! * [`plant`]: the complete machine, advanced by one control period at a time.
//! * [`mod@line`]: the serial line; [`fault`], [`schedule`]: injected faults and their times.
//! * [`rig`]: plant, controller and line in lockstep; [`io_log`]: all inputs and outputs of the
//!   controller.
//! * [`tmc2209`], [`tmc5160`]: chips of step drives on one wire, and in a chain.

pub mod check;
pub mod config;
pub mod contact;
mod driver_chip;
pub mod fault;
pub mod haptics;
pub mod io_log;
pub mod joint;
pub mod line;
pub mod machines;
pub mod operator;
pub mod plant;
pub mod polyhedron;
pub mod process;
pub mod random;
pub mod remote;
pub mod rig;
pub mod schedule;
pub mod tmc2209;
pub mod tmc5160;
pub mod vector;

pub use config::PlantConfig;
pub use fault::Fault;
pub use plant::{GroundTruth, Plant};
pub use rig::{Control, Rig, RigOptions};
