//! Chips of the drives that the board sets.

use haptimill_board_common::chips::{self, Chips};
use haptimill_board_cortex::shared::Shared;
#[cfg(not(any(feature = "uart", feature = "encoders")))]
use haptimill_firmware::config::ChipKind;

/// Side of the control period.
pub type Follower = chips::Follower<'static>;

/// Side of the main loop.
#[cfg(not(any(feature = "uart", feature = "encoders")))]
pub type Keeper = chips::Keeper<'static>;

/// Other signals have the pins of the bus: a joint with a chip is never ready.
#[cfg(any(feature = "uart", feature = "encoders"))]
pub struct Keeper;

/// Without the bus nothing has to be done.
#[cfg(feature = "encoders")]
pub async fn serve(_: Keeper) {
    core::future::pending().await
}
#[cfg(not(any(feature = "uart", feature = "encoders", feature = "spi")))]
pub use crate::chip_bus::serve;
#[cfg(feature = "spi")]
pub use crate::chip_chain::serve;

/// Kind of the chips at the bus.
#[cfg(not(any(feature = "uart", feature = "encoders")))]
const KIND: ChipKind = if cfg!(feature = "spi") {
    ChipKind::Tmc5160
} else {
    ChipKind::Tmc2209
};

// Only `start` uses it, once; its two sides are made for two contexts.
static CHIPS: Shared<Chips> = Shared::new();

/// Makes both sides. Only `main` calls it, once.
pub fn start() -> (Follower, Keeper) {
    // SAFETY: called once, so this is the only reference.
    let place = unsafe { CHIPS.place() };
    let chips = place.write(Chips::new());
    #[cfg(not(any(feature = "uart", feature = "encoders")))]
    return chips.split(KIND);
    #[cfg(any(feature = "uart", feature = "encoders"))]
    return (chips.without_bus(), Keeper);
}
