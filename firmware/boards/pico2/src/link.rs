//! Rings between the line to the host and the controller.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;
use haptimill_board_common::link::{self, Rings};

/// Ends of the rings at the line.
pub type Wire = link::Wire<'static>;
/// Ends of the rings at the controller.
pub type Bytes = link::Bytes<'static>;

struct Place(UnsafeCell<MaybeUninit<Rings>>);

// SAFETY: only `start` uses it, once; the ends of the rings are made for two contexts.
unsafe impl Sync for Place {}

static RINGS: Place = Place(UnsafeCell::new(MaybeUninit::uninit()));

/// Makes the rings. Only `main` calls it, once.
pub fn start() -> (Wire, Bytes) {
    // SAFETY: called once, so this is the only reference.
    let place = unsafe { &mut *RINGS.0.get() };
    place.write(Rings::new()).split()
}
