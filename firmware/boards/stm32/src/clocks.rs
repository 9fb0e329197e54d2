//! Clocks: 168 MHz for the core, 84 MHz and 42 MHz for the devices, from a crystal of 8 MHz.
//!
//! | bus | clock | timers on it |
//! | --- | --- | --- |
//! | AHB: core, memories, ports, DMA | 168 MHz | |
//! | APB2 | 84 MHz | TIM1, TIM8: 168 MHz |
//! | APB1: USART3 | 42 MHz | TIM2 to TIM5, TIM12: 84 MHz |

use crate::registers::{FLASH, RCC, change, wait, write};
use cortex_m::peripheral::{DCB, DWT};

/// Control period, us. The period of the machine file must be the same.
pub const PERIOD_US: u16 = 200;
/// Cycles of the core in a microsecond.
pub const CYCLES_PER_US: u32 = 168;
/// Cycles of the core in a control period.
pub const PERIOD_CYCLES: u32 = CYCLES_PER_US * PERIOD_US as u32;
/// Cycles of the core in a microsecond before [`start`]: the internal oscillator.
pub const RESET_CYCLES_PER_US: u32 = 16;

/// Control, PLL, configuration, and gates of the devices.
const CONTROL: usize = 0x00;
const PLL: usize = 0x04;
const CONFIGURATION: usize = 0x08;
const GATES_AHB1: usize = 0x30;
const GATES_APB1: usize = 0x40;
const GATES_APB2: usize = 0x44;

/// Bits of the control register.
const CRYSTAL_ON: u32 = 1 << 16;
const CRYSTAL_READY: u32 = 1 << 17;
const CRYSTAL_BYPASS: u32 = 1 << 18;
const PLL_ON: u32 = 1 << 24;
const PLL_READY: u32 = 1 << 25;

/// 8 MHz / 4 = 2 MHz, * 168 = 336 MHz, / 2 = 168 MHz; 336 MHz / 7 = 48 MHz, which nothing uses.
const PLL_FACTORS: u32 = 4 | 168 << 6 | 1 << 22 | 7 << 24;
/// AHB / 1, APB1 / 4, APB2 / 2.
const BUS_DIVIDERS: u32 = 0b101 << 10 | 0b100 << 13;
const SYSTEM_CLOCK_PLL: u32 = 0b10;
/// Five wait states at 168 MHz and 2.7 V to 3.6 V; prefetch, both caches.
const FLASH_ACCESS: u32 = 5 | 1 << 8 | 1 << 9 | 1 << 10;

/// Readings of a status, some ten cycles each: 100 ms or more at the clock of the reset.
const PATIENCE: u32 = 200_000;

/// Neither a crystal nor an external clock is at the oscillator pins.
pub struct NoCrystal;

/// Starts the cycle counter of the core.
pub fn count_cycles(dcb: &mut DCB, dwt: &mut DWT) {
    dcb.enable_trace();
    dwt.enable_cycle_counter();
}

/// Present count of the cycle counter.
#[inline(always)]
pub fn cycles() -> u32 {
    DWT::cycle_count()
}

/// Gives the ports their clock; it needs no crystal.
pub fn open_ports() {
    // Ports A to E.
    change(RCC, GATES_AHB1, 0x1F, 0x1F);
}

/// Sets all clocks, and gives the devices theirs.
///
/// The voltage scale is the one of the reset, scale 1, which 168 MHz require.
pub fn start() -> Result<(), NoCrystal> {
    change(RCC, CONTROL, CRYSTAL_ON, CRYSTAL_ON);
    if !wait(RCC, CONTROL, CRYSTAL_READY, CRYSTAL_READY, PATIENCE) {
        // Boards with a debug probe may give a clock of 8 MHz in place of a crystal.
        change(RCC, CONTROL, CRYSTAL_ON, 0);
        change(RCC, CONTROL, CRYSTAL_BYPASS, CRYSTAL_BYPASS);
        change(RCC, CONTROL, CRYSTAL_ON, CRYSTAL_ON);
        if !wait(RCC, CONTROL, CRYSTAL_READY, CRYSTAL_READY, PATIENCE) {
            return Err(NoCrystal);
        }
    }
    write(RCC, PLL, PLL_FACTORS);
    change(RCC, CONTROL, PLL_ON, PLL_ON);
    if !wait(RCC, CONTROL, PLL_READY, PLL_READY, PATIENCE) {
        return Err(NoCrystal);
    }
    write(FLASH, 0x0, FLASH_ACCESS);
    if !wait(FLASH, 0x0, 0xF, FLASH_ACCESS & 0xF, PATIENCE) {
        return Err(NoCrystal);
    }
    write(RCC, CONFIGURATION, BUS_DIVIDERS);
    write(RCC, CONFIGURATION, BUS_DIVIDERS | SYSTEM_CLOCK_PLL);
    // The clock in use is two bits above the one that was asked for.
    let (mask, in_use) = (0b11 << 2, SYSTEM_CLOCK_PLL << 2);
    if !wait(RCC, CONFIGURATION, mask, in_use, PATIENCE) {
        return Err(NoCrystal);
    }
    // DMA2.
    change(RCC, GATES_AHB1, 1 << 22, 1 << 22);
    // TIM2 to TIM5, TIM12, USART3.
    let apb1 = 0b1111 | 1 << 6 | 1 << 18;
    change(RCC, GATES_APB1, apb1, apb1);
    // TIM1, TIM8.
    change(RCC, GATES_APB2, 0b11, 0b11);
    Ok(())
}
