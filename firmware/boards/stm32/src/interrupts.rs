//! Table of the interrupts.

use crate::registers::{TIM1_UPDATE_INTERRUPT, USART3_INTERRUPT};

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
    table[TIM1_UPDATE_INTERRUPT.0 as usize] = crate::period::begin;
    table[USART3_INTERRUPT.0 as usize] = crate::line::serve;
    table
};
