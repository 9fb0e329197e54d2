//! What Haptimill says on the wire.
//!
//! Three layers, each usable alone and none of them touching a port or a clock:
//!
//! * [`message`]: the commands and reports, as plain types (postcard payloads).
//! * [`mod@force`]: what is said of force control.
//! * [`setpoint`]: the compact coding of timed setpoints.
//! * [`frame`]: COBS framing with a CRC-32 around every payload.
//! * [`link`]: sequence numbers, acknowledgement, retransmission, window, session.
//! * [`urgent`]: the stop that is recognised byte by byte, before framing.
//! * [`text`]: refusals, faults and events in plain sentences.
//! * [`schema`]: one number for the shape of all messages, exchanged in the greeting.
#![no_std]

#[cfg(test)]
extern crate std;

pub mod force;
pub mod frame;
pub mod haptic;
pub mod link;
pub mod message;
pub mod schema;
pub mod setpoint;
pub mod text;
pub mod urgent;
mod wire;
