//! Memory-mapped registers of the STM32F407 (RM0090).

use cortex_m::interrupt::InterruptNumber;

/// Timers in encoder mode.
pub const TIM2: usize = 0x4000_0000;
pub const TIM3: usize = 0x4000_0400;
pub const TIM4: usize = 0x4000_0800;
pub const TIM5: usize = 0x4000_0C00;
/// Timer of the spindle's PWM.
pub const TIM12: usize = 0x4000_1800;
/// Watchdog.
pub const IWDG: usize = 0x4000_3000;
/// Line to the host.
pub const USART3: usize = 0x4000_4800;
/// Timer of the control period.
pub const TIM1: usize = 0x4001_0000;
/// Timer of the step clock.
pub const TIM8: usize = 0x4001_0400;
/// Ports.
pub const GPIOA: usize = 0x4002_0000;
pub const GPIOB: usize = 0x4002_0400;
pub const GPIOC: usize = 0x4002_0800;
pub const GPIOD: usize = 0x4002_0C00;
pub const GPIOE: usize = 0x4002_1000;
/// Clocks and resets.
pub const RCC: usize = 0x4002_3800;
/// Access to the flash.
pub const FLASH: usize = 0x4002_3C00;
/// DMA controller that reaches the ports.
pub const DMA2: usize = 0x4002_6400;
/// What stands still while a debugger halts the core.
pub const DBGMCU: usize = 0xE004_2000;

/// An interrupt by its number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Interrupt(pub u16);

// SAFETY: the numbers are those of the chip and do not change.
unsafe impl InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        self.0
    }
}

/// Update of TIM1.
pub const TIM1_UPDATE_INTERRUPT: Interrupt = Interrupt(25);
/// USART3.
pub const USART3_INTERRUPT: Interrupt = Interrupt(39);

/// Registers of a timer.
pub mod timer {
    pub const CONTROL: usize = 0x00;
    pub const SLAVE: usize = 0x08;
    pub const ENABLES: usize = 0x0C;
    pub const STATUS: usize = 0x10;
    pub const EVENTS: usize = 0x14;
    pub const CHANNELS_1_2: usize = 0x18;
    pub const CHANNELS_3_4: usize = 0x1C;
    pub const CHANNEL_ENABLES: usize = 0x20;
    pub const COUNT: usize = 0x24;
    pub const PRESCALER: usize = 0x28;
    pub const RELOAD: usize = 0x2C;
    pub const CHANNEL_1: usize = 0x34;
    pub const CHANNEL_3: usize = 0x3C;

    /// Bits of [`CONTROL`]: the counter runs; only an overflow is an update.
    pub const RUN: u32 = 1;
    pub const OVERFLOW_ONLY: u32 = 1 << 2;
    /// Bits of [`ENABLES`]: interrupt and DMA request at an update.
    pub const UPDATE_INTERRUPT: u32 = 1;
    pub const UPDATE_DMA: u32 = 1 << 8;
    /// Bits of [`STATUS`]: update, capture of channel 3, a capture of it that was overwritten.
    pub const UPDATED: u32 = 1;
    pub const CAPTURED_3: u32 = 1 << 3;
    pub const OVERWRITTEN_3: u32 = 1 << 11;
    /// Bit of [`EVENTS`]: takes prescaler and reload value over.
    pub const UPDATE: u32 = 1;
}

/// Registers of a port.
pub mod port {
    pub const MODES: usize = 0x00;
    pub const SPEEDS: usize = 0x08;
    pub const PULLS: usize = 0x0C;
    pub const INPUT: usize = 0x10;
    pub const OUTPUT: usize = 0x14;
    /// Bits of the lower half set pins, bits of the upper half reset them.
    pub const SET_RESET: usize = 0x18;
    pub const FUNCTIONS: usize = 0x20;
}

/// Reads a register.
#[inline(always)]
pub fn read(device: usize, offset: usize) -> u32 {
    // SAFETY: callers pass a device; reading its registers has no effect on memory.
    unsafe { ((device + offset) as *const u32).read_volatile() }
}

/// Writes a register.
#[inline(always)]
pub fn write(device: usize, offset: usize, value: u32) {
    // SAFETY: callers pass a device. Only the DMA accesses memory; `steps` lets it read its own
    // buffers and write to a port.
    unsafe { ((device + offset) as *mut u32).write_volatile(value) }
}

/// Changes bits of a register: those of `mask` become those of `bits`.
pub fn change(device: usize, offset: usize, mask: u32, bits: u32) {
    write(device, offset, read(device, offset) & !mask | bits);
}

/// Waits until bits of a register have a value; false if they do not within `turns` readings.
pub fn wait(device: usize, offset: usize, mask: u32, value: u32, turns: u32) -> bool {
    (0..turns).any(|_| read(device, offset) & mask == value)
}
