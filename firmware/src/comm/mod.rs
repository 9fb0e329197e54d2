//! Communication with the host: receive ring of the board, and the controller's endpoint of the
//! link with its time slices and telemetry.

pub mod rx_ring;
pub mod schedule;
pub mod server;
pub mod telemetry;
