//! Checks of the controller that run natively and, unchanged, on a chip.
//!
//! A check is a function that panics when its claim does not hold. [`CHECKS`] lists them. The
//! native test of this crate runs the list, and a board's check image runs it on the chip and
//! reports it. All random numbers are seeded, so both use the same samples. The reference values
//! are f64 (which a chip computes in software), integers of 128 bits, or the messages sent at the
//! other end of a link.
//!
//! No product image contains this crate. Float is allowed; there is no allocator.
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
    /// Name: module and claim.
    pub name: &'static str,
    /// Panics when the claim does not hold.
    pub run: fn(),
}

/// All checks, by module.
pub const CHECKS: &[&[Check]] = &[
    memory::CHECKS,
    units::CHECKS,
    kinematics::CHECKS,
    kinematics::facet::CHECKS,
    haptic::CHECKS,
    link::CHECKS,
    queue::CHECKS,
    states::CHECKS,
];

/// A check that fails, for a test of the failure report. No list contains it.
pub const FAILING: Check = Check {
    name: "failing::two_and_two_are_five",
    run: || assert_eq!(core::hint::black_box(2) + 2, 5, "two and two"),
};

/// Returns all checks in order.
pub fn all() -> impl Iterator<Item = &'static Check> {
    CHECKS.iter().copied().flatten()
}
