//! Clocks and resets: 150 MHz for the cores, the PIO and the devices, from the crystal of 12 MHz.

use crate::registers::{
    CLOCKS, DWT, PLL_SYS, PLL_USB, RESETS, TICKS, WATCHDOG, XOSC, clear, read, set, write,
};

/// Control period, us: one of those in `build.rs`. The period of the machine file must be the same.
pub const PERIOD_US: u16 = match u16::from_str_radix(env!("HAPTIMILL_PERIOD_US"), 10) {
    Ok(period) => period,
    Err(_) => panic!("build.rs gives a number"),
};
/// Cycles in a microsecond.
pub const CYCLES_PER_US: u32 = 150;
/// Cycles of a control period.
pub const PERIOD_CYCLES: u32 = CYCLES_PER_US * PERIOD_US as u32;
/// Frequency of the crystal, MHz.
const CRYSTAL_MHZ: u32 = 12;

/// The USB controller and its PLL, if they are the line to the host.
const USB: u32 = if cfg!(feature = "uart") {
    0
} else {
    1 << 15 | 1 << 28
};
/// The third PIO block, if it has the encoders.
const PIO2: u32 = if cfg!(feature = "encoders") {
    1 << 13
} else {
    0
};
/// The SPI, if it has the chips of the drives.
const SPI1: u32 = if cfg!(feature = "spi") { 1 << 19 } else { 0 };
/// Devices that are used: DMA, I/O bank, pads, PIO0, PIO1, PLL, PWM, UART0, and those above.
const USED: u32 =
    1 << 2 | 1 << 6 | 1 << 9 | 1 << 11 | 1 << 12 | 1 << 14 | 1 << 16 | 1 << 26 | USB | PIO2 | SPI1;

/// Present count of the cycle counter.
#[inline(always)]
pub fn cycles() -> u32 {
    read(DWT, 0x4)
}

/// Sets all clocks, and takes the used devices out of reset.
pub fn start() {
    // Crystal: 1 to 15 MHz, a start-up time of 6 ms.
    write(XOSC, 0x0, 0xAA0);
    write(XOSC, 0xC, 282);
    set(XOSC, 0x0, 0xFAB << 12);
    while read(XOSC, 0x4) >> 31 == 0 {}
    // Reference clock: the crystal. System clock: the reference, while the PLL starts.
    write(CLOCKS, 0x30, 2);
    while read(CLOCKS, 0x38) != 1 << 2 {}
    clear(CLOCKS, 0x3C, 1);
    while read(CLOCKS, 0x44) != 1 {}
    // All devices begin in reset, also after a reset that left them running.
    set(RESETS, 0x0, USED);
    clear(RESETS, 0x0, USED);
    while read(RESETS, 0x8) & USED != USED {}
    // 12 MHz * 125 = 1500 MHz, divided by 5 and by 2.
    start_pll(PLL_SYS, 125, 5, 2);
    write(CLOCKS, 0x3C, 0);
    write(CLOCKS, 0x3C, 1);
    while read(CLOCKS, 0x44) != 1 << 1 {}
    // Devices: the system clock.
    write(CLOCKS, 0x48, 1 << 11);
    if !cfg!(feature = "uart") {
        // 12 MHz * 100 = 1200 MHz, divided by 5 and by 5: the 48 MHz of the USB.
        start_pll(PLL_USB, 100, 5, 5);
        write(CLOCKS, 0x60, 0);
        write(CLOCKS, 0x64, 1 << 16);
        write(CLOCKS, 0x60, 1 << 11);
    }
    // Microseconds of the watchdog.
    write(WATCHDOG, 0x0, 0);
    write(TICKS, 0x34, CRYSTAL_MHZ);
    write(TICKS, 0x30, 1);
}

/// Starts a PLL: crystal times `multiplier`, divided by `first` and by `second`.
fn start_pll(pll: usize, multiplier: u32, first: u32, second: u32) {
    write(pll, 0x0, 1);
    write(pll, 0x8, multiplier);
    clear(pll, 0x4, 1 | 1 << 5);
    while read(pll, 0x0) >> 31 == 0 {}
    write(pll, 0xC, first << 16 | second << 12);
    clear(pll, 0x4, 1 << 3);
}
