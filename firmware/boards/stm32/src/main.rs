//! The Haptimill controller on an STM32F407 or STM32F427.
//!
//! Up to five step drives, four of them with an encoder. [`pins`] has the table of the pins.
//!
//! | module | |
//! | --- | --- |
//! | [`clocks`] | 168 MHz from a crystal of 8 MHz |
//! | [`steps`] | pulses: words for a port, fed by DMA at the rate of TIM8 |
//! | [`encoders`] | quadrature counters and index latches: TIM2 to TIM5 |
//! | [`period`] | control period: TIM1 latches and hands the words over, PendSV computes |
//! | [`line`] | line to the host: USART3 |
//! | [`ending`] | panic, processor fault, watchdog, and what the LED shows of them |
//! | [`interrupts`] | table of the interrupts |
//! | [`record`] | last control period, for a debugger or an emulator |
//!
//! All memory accesses and instructions that need `unsafe` are in this crate and in
//! `haptimill_board_cortex`.
#![no_std]
#![no_main]

mod clocks;
mod encoders;
mod ending;
mod interrupts;
mod line;
mod period;
mod pins;
mod record;
mod registers;
mod steps;

#[cfg(feature = "log")]
use haptimill_board_common::log;

/// Name and version of the image in its log.
#[cfg(feature = "log")]
const IMAGE: &str = concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION"));

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(mut core) = cortex_m::Peripherals::take() else {
        panic!("the peripherals of the core are taken once");
    };
    ending::watch(&mut core.SCB, &mut core.MPU);
    #[cfg(feature = "log")]
    let place = ending::kept_place();
    let cause = ending::take_cause();
    #[cfg(feature = "log")]
    log::start(IMAGE, clocks::PERIOD_US, cause, place);
    clocks::count_cycles(&mut core.DCB, &mut core.DWT);
    pins::start();
    if clocks::start().is_err() {
        // The drives stay off, and no one feeds a watchdog.
        ending::show_for_ever(ending::NO_CRYSTAL, clocks::RESET_CYCLES_PER_US)
    }
    let bytes = line::start(&mut core.NVIC);
    period::start(&mut core.SCB, &mut core.NVIC, bytes);
    // The drives stay off until the controller enables them, so the watchdog starts last.
    ending::start_watchdog();
    ending::show_for_ever(cause as u32, clocks::CYCLES_PER_US)
}
