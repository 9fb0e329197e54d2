//! Rings between the line to the host and the controller.

use haptimill_board_common::link::{self, Rings};
use haptimill_board_cortex::shared::Shared;

/// Ends of the rings at the line.
pub type Wire = link::Wire<'static>;
/// Ends of the rings at the controller.
pub type Bytes = link::Bytes<'static>;

// Only `start` uses it, once; the ends of the rings are made for two contexts.
static RINGS: Shared<Rings> = Shared::new();

/// Makes the rings. Only `main` calls it, once.
pub fn start() -> (Wire, Bytes) {
    // SAFETY: called once, so this is the only reference.
    let place = unsafe { RINGS.place() };
    place.write(Rings::new()).split()
}
