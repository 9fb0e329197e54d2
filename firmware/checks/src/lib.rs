//! Checks of the controller that run natively and, the same ones, on a chip.
//!
//! A check is a function that panics when something is not as it should be. [`CHECKS`] lists them: the native test of this crate runs the list,
//! and a board's image of checks runs it on the chip and reports it. Everything random is seeded, so both look at the same samples; the truth
//! is f64 (which a chip computes in software), integers of 128 bits, or what one end of a link said and the other one has to hear.
//!
//! Nothing here is in the product; float is allowed, an allocator is not there.
#![no_std]

pub mod haptic;
pub mod kinematics;
pub mod link;
pub mod memory;
pub mod queue;
pub mod reference;
pub mod states;
pub mod units;

/// A check.
#[derive(Debug, Clone, Copy)]
pub struct Check {
    /// What it is called: module and claim.
    pub name: &'static str,
    /// Panics when the claim does not hold.
    pub run: fn(),
}

/// The checks, by module.
pub const CHECKS: &[&[Check]] = &[
    memory::CHECKS,
    units::CHECKS,
    kinematics::CHECKS,
    haptic::CHECKS,
    link::CHECKS,
    queue::CHECKS,
    states::CHECKS,
];

/// A check that fails, to show that one that does is reported; it stands in no list.
pub const FAILING: Check = Check {
    name: "failing::two_and_two_are_five",
    run: || assert_eq!(core::hint::black_box(2) + 2, 5, "two and two"),
};

/// All checks, in their order.
pub fn all() -> impl Iterator<Item = &'static Check> {
    CHECKS.iter().copied().flatten()
}
