//! Messages between host and controller.
//!
//! Coordinates on the wire are `i32` in *axis units*: 2^-20 mm for a linear axis, 2^-32 turn for a
//! rotary one. Rates are axis units per second divided by 2^[`RATE_SHIFT`]. Times are counts of
//! control periods.
//!
//! A message has no integrity check of its own. Callers must decode only bytes that came through
//! [`crate::link`].

mod command;
mod drive_alarm;
mod event;
mod override_mode;
mod problem;
mod report;
mod session;
mod setpoints;
mod state;

pub use command::{Command, ConfigChunk, Request, Source};
pub use drive_alarm::{Alarms, DriveAlarm};
pub use event::Event;
pub use override_mode::OverrideMode;
pub use problem::{
    ConfigField, ConfigProblem, Fault, HomingProblem, InputProblem, OutputProblem, PoseError,
    Refusal,
};
pub use report::{ActiveLines, IoTelemetry, MoreTelemetry, Report, Telemetry};
pub use session::{Hello, HelloRefusal, Kept, Welcome};
pub use setpoints::{Action, SetpointBatch, SetpointDelta};
pub use state::State;

use heapless::Vec;

/// Largest number of pose coordinates, and of joints, of a machine.
pub const MAX_AXES: usize = 6;

/// Version of this protocol; both endpoints must have the same.
pub const PROTOCOL_VERSION: u16 = 9;

/// Speed factor in reports at the programmed speed.
pub const FULL_SPEED_FACTOR: u16 = 1 << 15;

/// Largest number of named analog inputs, and of named analog outputs.
pub const ANALOG: usize = 4;

/// A rate on the wire is in axis units per second divided by 2^8: 2^-12 mm/s, or 2^-24 turn/s.
pub const RATE_SHIFT: u32 = 8;

/// Largest number of configuration bytes in one [`Command::Configure`].
pub const CONFIG_CHUNK: usize = 64;

/// Largest number of setpoints in one [`Command::Setpoints`].
pub const SETPOINT_BATCH: usize = 4;

/// One value for each axis of the machine, in axis units.
pub type AxisValues = Vec<i32, MAX_AXES>;
