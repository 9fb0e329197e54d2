//! The Haptimill controller.
//!
//! **The controller is a function.** Every control period it takes the latched inputs
//! ([`io::Inputs`]) and computes the outputs ([`io::Outputs`]). It owns no pin, no clock, no
//! allocator and no interrupt.
//!
//! The arithmetic is integer or fixed-point. The exception is the 6 x 6 statics of the haptic arm:
//! they use f32, and only operations that every target rounds alike. The same inputs therefore give
//! bit-identical outputs on every target.
#![no_std]
// The control cycle has no float, except in tests and in the statics of the haptic arm.
#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

pub mod comm;
mod commands;
pub mod config;
pub mod controller;
mod core;
pub mod digest;
mod faults;
pub mod force;
pub mod haptics;
pub mod io;
pub mod joint;
pub mod kept;
#[cfg(feature = "defmt")]
mod log;
pub mod machine;
mod modes;
pub mod motion;
pub mod named_io;
pub mod pil;
pub mod profiler;
pub mod rate_filter;
mod reactions;
pub mod safety;
pub mod snapshot;
pub mod volumetric;
