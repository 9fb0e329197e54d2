//! Memory-mapped registers of the RP2350. The devices of the line to the host are in its modules.

/// Resets of the devices.
pub const RESETS: usize = 0x4002_0000;
/// Clock generators.
pub const CLOCKS: usize = 0x4001_0000;
/// Power-on state machine.
pub const PSM: usize = 0x4001_8000;
/// Functions of the pins.
pub const IO_BANK0: usize = 0x4002_8000;
/// Pads of the pins.
pub const PADS_BANK0: usize = 0x4003_8000;
/// Crystal oscillator.
pub const XOSC: usize = 0x4004_8000;
/// PLL of the system clock.
pub const PLL_SYS: usize = 0x4005_0000;
/// PLL of the USB.
pub const PLL_USB: usize = 0x4005_8000;
/// Pulse-width modulation.
pub const PWM: usize = 0x400A_8000;
/// Watchdog.
pub const WATCHDOG: usize = 0x400D_8000;
/// Generators of microseconds.
pub const TICKS: usize = 0x4010_8000;
/// DMA.
pub const DMA: usize = 0x5000_0000;
/// Programmable I/O, first two blocks.
pub const PIO: [usize; 2] = [0x5020_0000, 0x5030_0000];
/// Third block.
#[cfg(feature = "encoders")]
pub const PIO2: usize = 0x5040_0000;
/// Levels of the pins.
pub const SIO: usize = 0xD000_0000;
/// SysTick of the core.
pub const SYSTICK: usize = 0xE000_E010;
/// Cycle counter of the core.
pub const DWT: usize = 0xE000_1000;

/// Aliases of a device whose writes set or clear bits.
const SET: usize = 0x2000;
const CLEAR: usize = 0x3000;

/// Reads a register.
#[inline(always)]
pub fn read(device: usize, offset: usize) -> u32 {
    // SAFETY: callers pass a device; reading its registers has no effect on memory.
    unsafe { ((device + offset) as *const u32).read_volatile() }
}

/// Writes a register.
#[inline(always)]
pub fn write(device: usize, offset: usize, value: u32) {
    // SAFETY: callers pass a device. Only the DMA accesses memory; `steps` gives it the addresses
    // of its own buffers.
    unsafe { ((device + offset) as *mut u32).write_volatile(value) }
}

/// Sets bits of a register; not for the core's own devices and SIO.
#[inline(always)]
pub fn set(device: usize, offset: usize, bits: u32) {
    write(device + SET, offset, bits);
}

/// Clears bits of a register; not for the core's own devices and SIO.
#[inline(always)]
pub fn clear(device: usize, offset: usize, bits: u32) {
    write(device + CLEAR, offset, bits);
}
