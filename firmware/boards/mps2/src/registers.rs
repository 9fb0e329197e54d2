//! Memory-mapped registers.

/// UART0 of the CMSDK.
pub const UART0: usize = 0x4000_4000;
/// UART2 of the CMSDK.
#[cfg(feature = "defmt")]
pub const UART2: usize = 0x4000_6000;
/// TIMER0 of the CMSDK.
pub const TIMER0: usize = 0x4000_0000;

/// Reads a register of a device.
#[inline(always)]
pub fn read(device: usize, offset: usize) -> u32 {
    // SAFETY: callers pass devices of this board. Reading their registers has no effect on memory.
    unsafe { ((device + offset) as *const u32).read_volatile() }
}

/// Writes a register of a device.
#[inline(always)]
pub fn write(device: usize, offset: usize, value: u32) {
    // SAFETY: callers pass devices of this board. None of them is a bus master that could access
    // memory.
    unsafe { ((device + offset) as *mut u32).write_volatile(value) }
}
