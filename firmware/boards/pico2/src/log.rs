//! First lines of the log: which image runs, and why the chip was reset.

use crate::clocks::PERIOD_US;
use crate::ending;
use haptimill_board_common::reset_cause::Cause;
use haptimill_protocol::message::PROTOCOL_VERSION;
use haptimill_protocol::schema::schema_hash;

/// Writes them. `cause` is that of the reset. The code is in the flash (`image.x`).
#[cold]
#[inline(never)]
pub fn start(cause: Cause) {
    defmt::info!(
        "haptimill-pico2 {=str}, protocol {=u16}, messages {=u64:016x}, control period {=u16} us",
        env!("CARGO_PKG_VERSION"),
        PROTOCOL_VERSION,
        schema_hash(),
        PERIOD_US,
    );
    let place = ending::last_place();
    match cause {
        Cause::Power => defmt::info!("reset: {}", cause),
        Cause::Watchdog => defmt::error!("reset: {}", cause),
        Cause::Panic => defmt::error!("reset: {}, source line {=u32}", cause, place),
        Cause::Fault => defmt::error!("reset: {}, address {=u32:#010x}", cause, place),
    }
}
