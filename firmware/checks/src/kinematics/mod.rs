//! The conformance suite of machine kinematics: what every machine must pass.
//!
//! A new machine is one [`subject::Subject`] (a truth in f64, written from the closure of its loops and not from the firmware's formulas), one
//! row in the firmware's test `kinematics_conformance`, and one here. Here the counts are what a small chip without an f64 unit does in a second.
#![allow(
    clippy::needless_range_loop,
    reason = "an index is an axis here, of several arrays at once"
)]

pub mod h4;
pub mod subject;
pub mod suite;

use crate::Check;

/// Poses and joints of a check on a chip.
const COUNT: usize = 4000;

/// The checks of this module.
pub const CHECKS: &[Check] = &[
    Check {
        name: "kinematics::h4_reference::inverse_is_the_closure_and_forward_turns_it_round",
        run: || {
            suite::inverse_against_closure(&h4::Arm::new(h4::REFERENCE), COUNT);
        },
    },
    Check {
        name: "kinematics::h4_reference::no_wrong_pose",
        run: || {
            suite::forward_is_certified(&h4::Arm::new(h4::REFERENCE), COUNT);
        },
    },
    Check {
        name: "kinematics::h4_reference::extremes",
        run: || suite::extremes(&h4::Arm::new(h4::REFERENCE), COUNT),
    },
    Check {
        name: "kinematics::h4_reference::derivatives",
        run: || suite::derivatives_against_differences(&h4::Arm::new(h4::REFERENCE), COUNT / 50),
    },
    Check {
        name: "kinematics::h4_other::inverse_is_the_closure_and_forward_turns_it_round",
        run: || {
            suite::inverse_against_closure(&h4::Arm::new(h4::OTHER), COUNT / 4);
        },
    },
    Check {
        name: "kinematics::h4_other::no_wrong_pose",
        run: || {
            suite::forward_is_certified(&h4::Arm::new(h4::OTHER), COUNT / 4);
        },
    },
];
