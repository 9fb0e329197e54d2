//! Code for several boards.

#![no_std]

pub mod chips;
pub mod config_store;
pub mod counter;
pub mod encoder_words;
pub mod lamp;
pub mod link;
#[cfg(feature = "defmt")]
pub mod log;
pub mod period_record;
pub mod reset_cause;
pub mod shift_chain;
pub mod spindle;
pub mod step_samples;
pub mod step_words;
