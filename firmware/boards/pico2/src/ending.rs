//! Abnormal ends: panic, processor fault, stack overflow, a control period that does not end. The
//! drives go off, the watchdog resets the chip, and the LED shows the cause after the reset.

use crate::clocks::{CYCLES_PER_US, cycles};
use crate::pins;
use crate::registers::{PIO, PSM, WATCHDOG, read, set, write};
use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicU8, Ordering};
use haptimill_board_common::lamp;
use haptimill_board_common::reset_cause::{Cause, ENDED, RUNNING};

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
    for block in PIO {
        write(block, 0x0, 0);
    }
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

/// Sets the limit of the stack: below it are no data, but the addresses answer.
pub fn guard_stack() {
    unsafe extern "C" {
        static _stack_end: u32;
    }
    let limit = &raw const _stack_end as usize;
    // SAFETY: the stack pointer is above the limit.
    unsafe { core::arch::asm!("msr msplim, {}", in(reg) limit) };
}

/// Bytes of the stack of the fault handler.
const FAULT_STACK_BYTES: usize = 512;

/// Stack of the fault handler, because the main stack may be the cause.
#[repr(C, align(8))]
struct FaultStack(UnsafeCell<[u8; FAULT_STACK_BYTES]>);

// SAFETY: only the handler below uses it, and it never returns.
unsafe impl Sync for FaultStack {}

static FAULT_STACK: FaultStack = FaultStack(UnsafeCell::new([0; FAULT_STACK_BYTES]));

/// Handler of all processor faults and unexpected interrupts.
///
/// # Safety
/// Only the processor may call it.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn HardFault() -> ! {
    core::arch::naked_asm!(
        "mrs r0, msp",
        "movs r1, #0",
        "msr msplim, r1",
        "movw r1, #:lower16:{stack}",
        "movt r1, #:upper16:{stack}",
        "add r1, r1, #{bytes}",
        "msr msp, r1",
        "b {report}",
        stack = sym FAULT_STACK,
        bytes = const FAULT_STACK_BYTES,
        report = sym report,
    )
}

/// Reports a fault; `frame` is the stack pointer at its entry.
extern "C" fn report(frame: usize) -> ! {
    unsafe extern "C" {
        static _stack_start: u32;
        static _stack_end: u32;
    }
    let (low, high) = (
        &raw const _stack_end as usize,
        &raw const _stack_start as usize,
    );
    // The address of the fault is the seventh word of the frame, if the frame was stacked.
    let place = if frame >= low && frame + 32 <= high {
        // SAFETY: it lies within the stack.
        unsafe { ((frame + 24) as *const u32).read_volatile() }
    } else {
        0
    };
    end(Cause::Fault, place)
}
