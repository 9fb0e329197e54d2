//! What boards share.

#![no_std]

pub mod config_store;
pub mod step_words;
