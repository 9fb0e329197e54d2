//! Conformance suite of machine kinematics: every machine must pass it.
//!
//! A new machine needs one [`subject::Subject`], one row in the firmware's test
//! `kinematics_conformance`, and one row here. The subject has reference values in f64 from the
//! closure of its loops and not from the firmware's formulas. The counts here are those that a
//! small chip without an f64 unit does in a second.
#![allow(
    clippy::needless_range_loop,
    reason = "an index is an axis here, of several arrays at once"
)]

pub mod cartesian;
pub mod h4;
pub mod subject;
pub mod suite;
pub mod trunnion;

use crate::Check;

/// Number of poses and joint positions of a check on a chip.
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
    Check {
        name: "kinematics::cartesian::inverse_is_the_closure_and_forward_turns_it_round",
        run: || {
            suite::inverse_against_closure(&cartesian::Slides::default(), COUNT / 4);
        },
    },
    Check {
        name: "kinematics::cartesian::extremes",
        run: || suite::extremes(&cartesian::Slides::default(), COUNT / 4),
    },
    Check {
        name: "kinematics::trunnion::inverse_is_the_closure_and_forward_turns_it_round",
        run: || {
            let mill = trunnion::TrunnionMill::new(trunnion::APART);
            suite::inverse_against_closure(&mill, COUNT / 4);
        },
    },
    Check {
        name: "kinematics::trunnion::extremes",
        run: || {
            let mill = trunnion::TrunnionMill::new(trunnion::APART);
            suite::extremes(&mill, COUNT / 4);
        },
    },
    Check {
        name: "kinematics::trunnion::derivatives",
        run: || {
            let mill = trunnion::TrunnionMill::new(trunnion::APART);
            suite::derivatives_against_differences(&mill, COUNT / 50);
        },
    },
];
