//! Check of captured pulses: the levels of step, direction and enable lines against the segments
//! that the controller commanded.
//!
//! A [`Capture`] comes from a VCD file: of a logic analyser on a real board, or of an emulated
//! board. [`check`] compares every edge of the step lines with its time by
//! [`StepSegment`](haptimill_firmware::io::StepSegment), `start + delay + k * interval + ramp * k *
//! (k - 1) / 2`. One constant offset between the clock of the capture and the first control period
//! is allowed; every further difference is an edge in the wrong place. Width, pause, direction
//! set-up and hold are measured on the lines themselves and compared with the data sheet of the
//! drive.
//!
//! All times are in femtoseconds, so that the usual step clocks and time scales have no rounding
//! that matters: a tick of 150 MHz is 6,666,666.7 fs. An `i64` of them spans 2.5 hours.

mod align;
mod capture;
mod check;
mod expected;
mod picture;

pub use capture::{Capture, CaptureError, Signal};
pub use check::{AxisReport, AxisSignals, Fault, FaultKind, Report, Rules, check};
pub use expected::{Clock, Planned, Pulse, pulses};
pub use picture::picture;

/// Femtoseconds in a second.
pub const SECOND: i64 = 1_000_000_000_000_000;

/// Femtoseconds in a nanosecond.
pub const NANOSECOND: i64 = 1_000_000;
