//! Abnormal ends: panic, processor fault, stack overflow, a control period that does not end. The
//! drives go off, the watchdog resets the chip, and the LED shows the cause after the reset.

use crate::clocks::{CYCLES_PER_US, cycles};
use crate::registers::{PSM, WATCHDOG, read, set, write};
use crate::{pins, steps};
use core::sync::atomic::{AtomicU8, Ordering};
use haptimill_board_common::lamp;
use haptimill_board_common::reset_cause::{Cause, ENDED, RUNNING};
use haptimill_board_cortex::{fault_handler, faults};

/// Time without a completed control period after which the chip is reset, us. The period in which a
/// configuration is activated takes 3 ms.
const WATCHDOG_US: u32 = 20_000;

/// Registers of the watchdog that keep their contents: mark, cause, and its place.
const MARK: usize = 0xC;
const CAUSE: usize = 0x10;
const PLACE: usize = 0x14;

/// The cause that [`take_cause`] found.
static LAST: AtomicU8 = AtomicU8::new(0);

/// Finds the cause of the last reset.
pub fn take_cause() -> Cause {
    let by_watchdog = read(WATCHDOG, 0x8) & 0b11 != 0;
    let cause = Cause::of(read(WATCHDOG, MARK), read(WATCHDOG, CAUSE), by_watchdog);
    write(WATCHDOG, MARK, 0);
    LAST.store(cause as u8, Ordering::Relaxed);
    cause
}

/// The cause of the last reset, as the flashes of the LED.
pub fn last_cause() -> u8 {
    LAST.load(Ordering::Relaxed)
}

/// Line of the panic, or address of the instruction that failed, of an earlier end.
#[cfg(feature = "log")]
pub fn last_place() -> u32 {
    read(WATCHDOG, PLACE)
}

/// Starts the watchdog.
pub fn start_watchdog() {
    // Everything is reset but the two oscillators.
    write(PSM, 0x8, 0x01FF_FFFF & !(1 << 2 | 1 << 3));
    feed_watchdog();
    write(WATCHDOG, MARK, RUNNING);
    set(WATCHDOG, 0x0, 1 << 30);
}

/// A control period was completed.
pub fn feed_watchdog() {
    write(WATCHDOG, 0x4, WATCHDOG_US);
}

/// Switches the drives off, keeps the cause, and resets the chip.
fn end(cause: Cause, place: u32) -> ! {
    cortex_m::interrupt::disable();
    steps::halt();
    pins::make_safe();
    write(WATCHDOG, CAUSE, cause as u32);
    write(WATCHDOG, PLACE, place);
    write(WATCHDOG, MARK, ENDED);
    write(PSM, 0x8, 0x01FF_FFFF & !(1 << 2 | 1 << 3));
    loop {
        set(WATCHDOG, 0x0, 1 << 31);
    }
}

/// The LED: the cause of the last reset as a number of flashes, then a pause. One flash a second
/// means normal operation after power-on.
pub struct Lamp(lamp::Lamp);

impl Lamp {
    /// The LED is off.
    pub const fn new(cause: Cause) -> Self {
        Self(lamp::Lamp::new(cause as u32, CYCLES_PER_US * 1000))
    }

    /// Switches the LED when it is time.
    pub fn update(&mut self) {
        if let Some(on) = self.0.update(cycles()) {
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

fault_handler!(report, 512);

/// Reports a fault; `frame` is the stack pointer at its entry.
extern "C" fn report(frame: usize) -> ! {
    end(Cause::Fault, faults::address(frame))
}
