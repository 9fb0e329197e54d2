//! The Haptimill controller on a Raspberry Pi Pico 2 (RP2350).
//!
//! Up to five open-loop step drives, four of which may have a TMC2209 that the board sets; with the
//! feature `spi` all of them may have a TMC5160 instead; with the feature `encoders` four encoders
//! and limit switches instead of the chips. [`pins`] and [`signals`] have the tables of the pins.
//!
//! | module | |
//! | --- | --- |
//! | [`steps`] | pulses: PIO state machines, fed by DMA |
//! | [`period`] | control period: SysTick latches and starts the pulses, PendSV computes |
//! | `usb`, `usb_bus` | line to the host: a serial port on the USB |
//! | `uart` | line to the host with the feature `uart`: UART0 |
//! | [`storage`], [`flash`] | the configuration that is kept in the flash |
//! | [`chips`] | chips of the drives: what the control period has of them |
//! | `chip_bus` | their one-wire bus at UART0; not with the features `uart`, `encoders` and `spi` |
//! | `chip_chain` | their chain at SPI1 with the feature `spi` |
//! | `levels` | [`signals`]: switches, digital inputs and outputs, spindle, each at its pin |
//! | `chain` | the same with the feature `encoders`: over shift registers |
//! | `encoders` | encoders with the feature `encoders`: PIO state machines |
//! | [`link`] | rings between the line and the controller |
//! | [`ending`] | panic, processor fault, watchdog, and what the LED shows of them |
//! | [`record`] | last control period, for a debugger or an emulator |
//!
//! All memory accesses and instructions that need `unsafe` are in this crate and in
//! `haptimill_board_cortex`.
#![no_std]
#![no_main]

mod boot_block;
#[cfg(feature = "encoders")]
mod chain;
#[cfg(not(any(feature = "uart", feature = "encoders", feature = "spi")))]
mod chip_bus;
#[cfg(feature = "spi")]
mod chip_chain;
mod chips;
mod clocks;
#[cfg(feature = "encoders")]
mod encoders;
mod ending;
mod flash;
#[cfg(not(feature = "encoders"))]
mod levels;
mod link;
mod period;
mod pins;
mod record;
mod registers;
mod steps;
mod storage;
#[cfg(feature = "uart")]
mod uart;
#[cfg(not(feature = "uart"))]
mod usb;
#[cfg(not(feature = "uart"))]
mod usb_bus;
mod vectors;

#[cfg(all(feature = "uart", feature = "encoders"))]
compile_error!("the image with encoders has its line to the host at the USB");
#[cfg(all(feature = "spi", any(feature = "uart", feature = "encoders")))]
compile_error!("the image with the SPI has its line to the host at the USB, and no encoders");

#[cfg(feature = "encoders")]
use chain as signals;
#[cfg(not(feature = "encoders"))]
use levels as signals;
#[cfg(feature = "uart")]
use uart as line;
#[cfg(not(feature = "uart"))]
use usb as line;

#[cfg(feature = "log")]
use haptimill_board_common::log;
use haptimill_board_cortex::guard::limit_stack;

/// Name and version of the image in its log.
#[cfg(feature = "log")]
const IMAGE: &str = concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION"));

#[cortex_m_rt::entry]
fn main() -> ! {
    limit_stack();
    vectors::move_to_ram();
    let cause = ending::take_cause();
    #[cfg(feature = "log")]
    log::start(IMAGE, clocks::PERIOD_US, cause, ending::last_place());
    clocks::start();
    pins::start();
    let (wire, bytes) = link::start();
    let (in_period, between) = line::start(wire);
    let (follower, keeper) = chips::start();
    period::start(in_period, bytes, follower);
    // The drives stay off until the controller enables them, so the watchdog starts last.
    ending::start_watchdog();
    between.serve(ending::Lamp::new(cause), keeper)
}
