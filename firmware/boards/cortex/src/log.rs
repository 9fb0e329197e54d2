//! The log of a board: defmt frames over RTT, which a debug probe reads while the board runs.
//!
//! A line never waits, and no interrupt is disabled: a line for which the buffer has no room is
//! dropped as a whole, and so is one of a handler that interrupts another line. The timestamp of a
//! line is the control period.

use core::sync::atomic::{AtomicU32, Ordering};
use defmt_rtt as _;

/// Number of the present control period.
static PERIOD: AtomicU32 = AtomicU32::new(0);

defmt::timestamp!("{=u32}", PERIOD.load(Ordering::Relaxed));

/// Records the start of a control period.
#[inline]
pub fn begin(period: u64) {
    PERIOD.store(period as u32, Ordering::Relaxed);
}
