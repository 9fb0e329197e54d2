//! Code for several boards.

#![no_std]

pub mod config_store;
pub mod counter;
pub mod lamp;
pub mod link;
pub mod reset_cause;
pub mod step_samples;
pub mod step_words;

/// Words of the record of the last control period that a Pico 2 keeps in its RAM.
pub const PERIOD_RECORD_WORDS: usize = 61;
