//! What boards share.

#![no_std]

pub mod step_words;
