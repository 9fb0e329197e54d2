//! Chips of the drives that the board sets.

use haptimill_board_common::chips::{self, Chips};
use haptimill_board_cortex::shared::Shared;

/// Side of the control period.
pub type Follower = chips::Follower<'static>;

/// Side of the main loop.
#[cfg(not(feature = "uart"))]
pub type Keeper = chips::Keeper<'static>;

/// The host has the pins of the bus: a joint with a chip is never ready.
#[cfg(feature = "uart")]
pub struct Keeper;

// Only `start` uses it, once; its two sides are made for two contexts.
static CHIPS: Shared<Chips> = Shared::new();

/// Makes both sides. Only `main` calls it, once.
pub fn start() -> (Follower, Keeper) {
    // SAFETY: called once, so this is the only reference.
    let place = unsafe { CHIPS.place() };
    let chips = place.write(Chips::new());
    #[cfg(not(feature = "uart"))]
    return chips.split();
    #[cfg(feature = "uart")]
    return (chips.without_bus(), Keeper);
}
