//! The Haptimill controller on a Raspberry Pi Pico 2 (RP2350).
//!
//! Up to five open-loop step drives. [`pins`] has the table of the pins.
//!
//! | module | |
//! | --- | --- |
//! | [`steps`] | pulses: PIO state machines, fed by DMA |
//! | [`period`] | control period: SysTick latches and starts the pulses, PendSV computes |
//! | [`serial`] | line to the host, UART0 |
//! | [`ending`] | panic, processor fault, watchdog, and what the LED shows of them |
//! | [`record`] | last control period, for a debugger or an emulator |
//!
//! All memory accesses and instructions that need `unsafe` are in this crate.
#![no_std]
#![no_main]

mod boot_block;
mod clocks;
mod ending;
mod period;
mod pins;
mod record;
mod registers;
mod serial;
mod steps;

#[cortex_m_rt::entry]
fn main() -> ! {
    ending::guard_stack();
    let cause = ending::take_cause();
    clocks::start();
    pins::start();
    serial::start();
    period::start();
    // The drives stay off until the controller enables them, so the watchdog starts last.
    ending::start_watchdog();
    loop {
        ending::show(cause);
    }
}
