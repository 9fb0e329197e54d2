//! Messages, framing and link of Haptimill.
//!
//! The modules can be used alone. None of them accesses a port or a clock:
//!
//! * [`message`]: commands and reports as plain types (postcard payloads).
//! * [`mod@force`]: settings and problems of force control.
//! * [`haptic`]: data of a haptic arm.
//! * [`setpoint`]: compact coding of timed setpoints.
//! * [`frame`]: COBS framing with a CRC-32 over each payload.
//! * [`link`]: sequence numbers, acknowledgement, resend, window, session.
//! * [`out_of_band`]: out-of-band stop, recognised byte by byte before framing.
//! * [`text`]: refusals, faults and events as sentences.
//! * [`schema`]: hash of all message types, exchanged in Hello and Welcome.
#![no_std]

#[cfg(test)]
extern crate std;

pub mod force;
pub mod frame;
pub mod haptic;
pub mod link;
pub mod message;
pub mod out_of_band;
pub mod schema;
pub mod setpoint;
pub mod text;
mod wire;
