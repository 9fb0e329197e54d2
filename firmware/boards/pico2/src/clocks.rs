//! Clocks and resets: 150 MHz for the cores, the PIO and the devices, from the crystal of 12 MHz.

use crate::registers::{
    CLOCKS, DWT, PLL_SYS, RESETS, TICKS, WATCHDOG, XOSC, clear, read, set, write,
};

/// Control period, us. The period of the machine file must be the same.
pub const PERIOD_US: u16 = 200;
/// Cycles in a microsecond.
pub const CYCLES_PER_US: u32 = 150;
/// Cycles of a control period.
pub const PERIOD_CYCLES: u32 = CYCLES_PER_US * PERIOD_US as u32;
/// Frequency of the crystal, MHz.
const CRYSTAL_MHZ: u32 = 12;

/// Devices that are used: DMA, I/O bank, pads, PIO0, PIO1, PLL, PWM, UART0.
const USED: u32 = 1 << 2 | 1 << 6 | 1 << 9 | 1 << 11 | 1 << 12 | 1 << 14 | 1 << 16 | 1 << 26;

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
    // PLL: 12 MHz * 125 = 1500 MHz, divided by 5 and by 2.
    write(PLL_SYS, 0x0, 1);
    write(PLL_SYS, 0x8, 125);
    clear(PLL_SYS, 0x4, 1 | 1 << 5);
    while read(PLL_SYS, 0x0) >> 31 == 0 {}
    write(PLL_SYS, 0xC, 5 << 16 | 2 << 12);
    clear(PLL_SYS, 0x4, 1 << 3);
    write(CLOCKS, 0x3C, 0);
    write(CLOCKS, 0x3C, 1);
    while read(CLOCKS, 0x44) != 1 << 1 {}
    // Devices: the system clock.
    write(CLOCKS, 0x48, 1 << 11);
    // Microseconds of the watchdog.
    write(WATCHDOG, 0x0, 0);
    write(TICKS, 0x34, CRYSTAL_MHZ);
    write(TICKS, 0x30, 1);
}
