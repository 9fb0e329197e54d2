//! The Haptimill controller.
//!
//! One idea carries it: **the controller is a function.** Every control period it takes what was sensed ([`io::Inputs`]) and says
//! what is to be done ([`io::Outputs`]). It owns no pin, no clock, no allocator and no interrupt. All of it is integer or
//! fixed-point arithmetic, but for the 6 x 6 statics of the haptic arm, which are f32 without anything that is rounded differently anywhere; so the same
//! inputs give the same bits on every target.
#![no_std]
// Not a float in the corridor, outside of tests and of the haptic arm's statics.
#![cfg_attr(not(test), deny(clippy::float_arithmetic))]

pub mod comm;
mod commands;
pub mod config;
pub mod controller;
mod core;
mod faults;
pub mod force;
pub mod haptics;
pub mod io;
pub mod joint;
pub mod machine;
mod modes;
pub mod motion;
pub mod pil;
pub mod profiler;
pub mod safety;
pub mod snapshot;
