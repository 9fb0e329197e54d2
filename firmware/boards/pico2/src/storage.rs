//! The configuration that the board keeps in its flash: in two slots at its end.
//!
//! The control period orders a write with the drives off; the main loop carries it out, and serves
//! the line to the host while the flash works. The control periods go on.

use crate::flash::{BYTES, Flash};
use core::sync::atomic::{AtomicU8, AtomicUsize, Ordering};
use haptimill_board_common::config_store::{ConfigStore, PAGE};
use haptimill_board_cortex::shared::Shared;
use haptimill_firmware::io::Storage;
use haptimill_firmware::kept::{MAX_BYTES, prefix};

/// Bytes of a slot: two sectors.
const SLOT: u32 = 8192;
/// Start of the first slot; `image.x` has it, too.
const START: u32 = BYTES as u32 - 2 * SLOT;
/// Whole pages for the longest configuration.
const ROOM: usize = MAX_BYTES.next_multiple_of(PAGE);
const _: () = assert!(ROOM + PAGE <= SLOT as usize);

// PendSV writes it unless `STATE` is `Busy`; then it belongs to the main loop.
static BUFFER: Shared<[u8; ROOM]> = Shared::new();
static LENGTH: AtomicUsize = AtomicUsize::new(0);
/// A [`Storage`].
static STATE: AtomicU8 = AtomicU8::new(Storage::None as u8);

/// What the board says of its memory.
#[inline]
pub fn state() -> Storage {
    Storage::of_code(STATE.load(Ordering::Acquire))
}

fn set_state(state: Storage) {
    STATE.store(state as u8, Ordering::Release);
}

/// Reads the configuration that is kept, before the first control period; `None` if there is none.
pub fn load(act: impl FnOnce(Option<&[u8]>)) {
    // SAFETY: no handler runs yet, and this function runs once.
    let buffer = unsafe { BUFFER.place() }.write([0; ROOM]);
    let mut store = ConfigStore::new(Flash::begin(|| ()), START, SLOT);
    let kept = store.as_mut().and_then(|store| store.load(buffer).ok()?);
    // The direct mode ends before code of the flash may run again.
    drop(store);
    act(kept);
    set_state(Storage::Ready);
}

/// Orders that a configuration is kept. PendSV calls it.
#[cold]
#[inline(never)]
pub fn order(config: &[u8]) {
    if state() == Storage::Busy {
        return;
    }
    // SAFETY: the main loop does not use it in this state, and `load` has written it.
    let buffer = unsafe { BUFFER.get() };
    let prefix = prefix();
    let (head, rest) = buffer.split_at_mut(prefix.len());
    let Some(place) = rest.get_mut(..config.len()) else {
        set_state(Storage::Failed);
        return;
    };
    head.copy_from_slice(&prefix);
    place.copy_from_slice(config);
    LENGTH.store(prefix.len() + config.len(), Ordering::Relaxed);
    set_state(Storage::Busy);
}

/// Keeps the configuration that was ordered. The main loop calls it; `wait` is called while the
/// flash works.
pub fn serve(wait: impl FnMut()) {
    if state() != Storage::Busy {
        return;
    }
    #[cfg(feature = "log")]
    defmt::info!("write to the flash: begun");
    // SAFETY: in this state no other code uses it.
    let buffer = unsafe { BUFFER.get() };
    let length = LENGTH.load(Ordering::Relaxed);
    let mut store = ConfigStore::new(Flash::begin(wait), START, SLOT);
    let saved = match (&mut store, buffer.get(..length)) {
        (Some(store), Some(config)) => store.save(config).is_ok(),
        _ => false,
    };
    // The direct mode ends before the controller may activate a configuration again.
    drop(store);
    set_state(if saved {
        Storage::Stored
    } else {
        Storage::Failed
    });
    #[cfg(feature = "log")]
    defmt::info!("write to the flash: {}", state());
}
