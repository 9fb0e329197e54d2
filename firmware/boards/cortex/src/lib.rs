//! Unsafe code that boards with a Cortex-M processor share.
//!
//! | module | |
//! | --- | --- |
//! | [`shared`] | data that a handler and its start, or two handlers in turn, use |
//! | [`faults`] | the handler of processor faults, on a stack of its own |
//! | [`guard`] | a stack that overflows ends in that handler |
//! | `log` | log by defmt over RTT, with the feature `log` |
//!
//! A board chooses the feature `armv8m` if its processor is one.

#![no_std]

pub mod faults;
pub mod guard;
#[cfg(feature = "log")]
pub mod log;
pub mod shared;
