//! Communication with the host: receive ring, and the controller's end of the link.

pub mod rx_ring;
pub mod server;
