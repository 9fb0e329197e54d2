//! The host's side of a controller: byte transports, the client of the link, and sessions.
//!
//! [`port`] carries bytes. [`client`] is a state machine on them that owns no clock and no thread.
//! [`session`] runs jobs, jogs and homing with it, at a port or in the simulator.

pub mod board;
mod choice;
pub mod client;
mod error;
pub mod flash;
pub mod port;
pub mod session;

pub use error::{Error, ErrorKind, Located};
