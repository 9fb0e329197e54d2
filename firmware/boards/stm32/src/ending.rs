//! Abnormal ends: panic, processor fault, stack overflow, a control period that does not end. The
//! drives go off, the chip is reset, and the LED shows the cause after the reset.

use crate::clocks::cycles;
use crate::registers::{DBGMCU, IWDG, RCC, change, read, wait, write};
use crate::{pins, steps};
use core::cell::UnsafeCell;
use cortex_m::peripheral::{MPU, SCB};
use haptimill_board_common::lamp::Lamp;
use haptimill_board_common::reset_cause::{Cause, ENDED, RUNNING};
use haptimill_board_cortex::{fault_handler, faults, guard};

/// Flashes of the LED of a board without a crystal or a clock of 8 MHz. Other numbers are those of
/// [`Cause`].
pub const NO_CRYSTAL: u32 = 5;

/// Registers of the watchdog.
const KEY: usize = 0x0;
const DIVIDER: usize = 0x4;
const RELOAD: usize = 0x8;
const STATUS: usize = 0xC;
const START: u32 = 0xCCCC;
const UNLOCK: u32 = 0x5555;
const FEED: u32 = 0xAAAA;
/// Time without a completed control period after which the chip is reset: 160 counts of an
/// oscillator of 32 kHz divided by 4, 20 ms. The oscillator has 17 kHz to 47 kHz: 14 ms to 38 ms.
const WATCHDOG_COUNTS: u32 = 160;

/// Register of the reset causes: the watchdog's, and the bit that clears all.
const RESETS: usize = 0x74;
const BY_WATCHDOG: u32 = 1 << 29;
const CLEAR_RESETS: u32 = 1 << 24;

/// What the RAM keeps over a reset: mark, cause, and its place.
struct Kept(UnsafeCell<[u32; 3]>);

// SAFETY: only `keep` and `take_cause` use it: the start, before any interrupt, and an end, after
// all of them.
unsafe impl Sync for Kept {}

#[unsafe(link_section = ".uninit.reset_cause")]
static KEPT: Kept = Kept(UnsafeCell::new([0; 3]));

fn keep(words: [u32; 3]) {
    // SAFETY: see `Kept`. The write is volatile: nothing in the program reads it again.
    unsafe { KEPT.0.get().write_volatile(words) };
}

/// Source line of a panic, or address of the instruction that failed, before the last reset.
/// [`take_cause`] clears it.
#[cfg(feature = "log")]
pub fn kept_place() -> u32 {
    // SAFETY: see `Kept`; every content of the words is valid.
    unsafe { KEPT.0.get().read_volatile()[2] }
}

/// Finds the cause of the last reset.
pub fn take_cause() -> Cause {
    // SAFETY: see `Kept`; every content of the words is valid.
    let [mark, cause, _] = unsafe { KEPT.0.get().read_volatile() };
    let by_watchdog = read(RCC, RESETS) & BY_WATCHDOG != 0;
    change(RCC, RESETS, CLEAR_RESETS, CLEAR_RESETS);
    keep([0; 3]);
    Cause::of(mark, cause, by_watchdog)
}

/// Starts the watchdog. A debugger that halts the core also halts it, the control periods and the
/// pulses.
pub fn start_watchdog() {
    change(DBGMCU, 0x8, 1 << 12, 1 << 12);
    change(DBGMCU, 0xC, 0b11, 0b11);
    keep([RUNNING, 0, 0]);
    write(IWDG, KEY, START);
    write(IWDG, KEY, UNLOCK);
    write(IWDG, DIVIDER, 0);
    write(IWDG, RELOAD, WATCHDOG_COUNTS);
    // The values arrive within six cycles of its oscillator. Its own values at reset are 512 ms,
    // and stay if they do not.
    wait(IWDG, STATUS, 0b11, 0, 20_000);
    feed_watchdog();
}

/// A control period was completed.
pub fn feed_watchdog() {
    write(IWDG, KEY, FEED);
}

/// Switches the drives off, keeps the cause, and resets the chip.
fn end(cause: Cause, place: u32) -> ! {
    cortex_m::interrupt::disable();
    steps::halt();
    pins::make_safe();
    keep([ENDED, cause as u32, place]);
    SCB::sys_reset()
}

/// Shows a number of flashes for ever.
pub fn show_for_ever(flashes: u32, cycles_per_us: u32) -> ! {
    let mut lamp = Lamp::new(flashes, cycles_per_us * 1000);
    loop {
        if let Some(on) = lamp.update(cycles()) {
            pins::light(on);
        }
    }
}

#[panic_handler]
fn panicked(info: &core::panic::PanicInfo<'_>) -> ! {
    end(
        Cause::Panic,
        info.location().map_or(0, |place| place.line()),
    )
}

/// Closes the addresses below the stack, and enables the handlers of all faults.
pub fn watch(scb: &mut SCB, mpu: &mut MPU) {
    // SAFETY: the chip reserves the 32 MiB below the core-coupled memory.
    unsafe { guard::close_below_stack(scb, mpu, 0x0E00_0000, 25) };
}

fault_handler!(report, 512, all);

/// Reports a fault; `frame` is the stack pointer at its entry.
extern "C" fn report(frame: usize) -> ! {
    end(Cause::Fault, faults::address(frame))
}
