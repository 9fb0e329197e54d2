//! Communication with the host: receive ring of the board, and the controller's endpoint of the
//! link.

pub mod rx_ring;
pub mod server;
