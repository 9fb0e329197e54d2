//! First lines of a log: which image runs, and why the chip was reset.

use crate::reset_cause::Cause;
use haptimill_protocol::message::PROTOCOL_VERSION;
use haptimill_protocol::schema::schema_hash;

/// Logs them. `image` is the name of the image with its version, `period_us` its control period,
/// `cause` that of the reset; `place` is the source line of a panic, or the address of the
/// instruction that failed.
#[cold]
#[inline(never)]
pub fn start(image: &str, period_us: u16, cause: Cause, place: u32) {
    defmt::info!(
        "{=str}, protocol {=u16}, messages {=u64:016x}, control period {=u16} us",
        image,
        PROTOCOL_VERSION,
        schema_hash(),
        period_us,
    );
    match cause {
        Cause::Power => defmt::info!("reset: {}", cause),
        Cause::Watchdog => defmt::error!("reset: {}", cause),
        Cause::Panic => defmt::error!("reset: {}, source line {=u32}", cause, place),
        Cause::Fault => defmt::error!("reset: {}, address {=u32:#010x}", cause, place),
    }
}
