//! Commands of an operator on a served simulator: blocks, jogs by a distance, probing cycles,
//! programs from a line on, over a serial line and from post-processors.
#![cfg(unix)]

mod dnc;
mod mdi;
mod observers;
mod operate;
mod posts;
mod probing;
mod run;
mod stream;
#[cfg(target_os = "linux")]
mod terminal_keys;
