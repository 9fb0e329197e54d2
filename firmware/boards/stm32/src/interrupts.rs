//! Table of the interrupts.

use cortex_m::interrupt::InterruptNumber;

/// An interrupt by its number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Number(u16);

// SAFETY: the numbers are those of the table below and do not change.
unsafe impl InterruptNumber for Number {
    fn number(self) -> u16 {
        self.0
    }
}

/// Update of TIM1.
pub const TIM1_UPDATE: Number = Number(25);
/// USART3.
pub const USART3: Number = Number(39);

/// Interrupts of an STM32F427; an STM32F407 has the first 82 of them.
const COUNT: usize = 91;

/// Handler of all other interrupts.
extern "C" fn unexpected() {
    panic!("an interrupt came that was not enabled");
}

/// Interrupt vectors, by number.
#[unsafe(link_section = ".vector_table.interrupts")]
#[unsafe(no_mangle)]
static __INTERRUPTS: [extern "C" fn(); COUNT] = {
    let mut table: [extern "C" fn(); COUNT] = [unexpected; COUNT];
    table[TIM1_UPDATE.0 as usize] = crate::period::begin;
    table[USART3.0 as usize] = crate::line::serve;
    table
};
