//! Data of handlers, in a static that is set up before they run.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;

/// Data that are written once, and then have one owner at a time: a handler, or handlers in turn.
/// The program decides by other means whose turn it is.
#[derive(Debug)]
pub struct Shared<T>(UnsafeCell<MaybeUninit<T>>);

// SAFETY: both functions give a reference only to a caller that guarantees to be the owner.
unsafe impl<T> Sync for Shared<T> {}

impl<T> Shared<T> {
    /// Nothing is written yet. The image has no bytes for the data.
    #[must_use]
    pub const fn new() -> Self {
        Self(UnsafeCell::new(MaybeUninit::uninit()))
    }

    /// The place of the data, to write them.
    ///
    /// # Safety
    /// No handler that uses the data runs yet, and there is no other reference.
    #[allow(
        clippy::mut_from_ref,
        reason = "that is what the cell is for; see Safety"
    )]
    pub const unsafe fn place(&self) -> &mut MaybeUninit<T> {
        // SAFETY: the caller guarantees it.
        unsafe { &mut *self.0.get() }
    }

    /// The data.
    ///
    /// # Safety
    /// They are written, and the caller owns them now.
    #[allow(
        clippy::mut_from_ref,
        reason = "that is what the cell is for; see Safety"
    )]
    pub const unsafe fn get(&self) -> &mut T {
        // SAFETY: the caller guarantees it.
        unsafe { (*self.0.get()).assume_init_mut() }
    }
}

impl<T> Default for Shared<T> {
    fn default() -> Self {
        Self::new()
    }
}
