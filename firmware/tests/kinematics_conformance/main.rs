//! The conformance suite of machine kinematics: what every machine must pass, and the rows of those
//! that do.
//!
//! A new machine is one subject in `haptimill_checks::kinematics` and one row below; the same
//! checks run on a chip, with smaller counts.

use haptimill_checks::kinematics::{cartesian, h4, suite, trunnion};

/// Poses and joints of the big checks.
const COUNT: usize = 1_000_000;

macro_rules! row {
    ($name:ident, $subject:expr, $count:expr) => {
        mod $name {
            use super::*;

            #[test]
            fn inverse_matches_closure_and_forward_inverts_it() {
                let (inverse, forward) = suite::inverse_against_closure(&$subject, $count);
                println!(
                    "largest error, share of the bound: inverse {inverse:.3}, forward {forward:.3}"
                );
            }

            #[test]
            fn no_wrong_pose() {
                let worst = suite::forward_is_certified(&$subject, $count);
                println!("largest error, share of the bound: {worst:.3}");
            }

            #[test]
            fn extremes() {
                suite::extremes(&$subject, $count / 2);
            }

            #[test]
            fn derivatives() {
                suite::derivatives_against_differences(&$subject, $count / 50);
            }
        }
    };
}

row!(h4_reference, h4::Arm::new(h4::REFERENCE), COUNT);
row!(h4_other, h4::Arm::new(h4::OTHER), COUNT / 5);
row!(cartesian_slides, cartesian::Slides::default(), COUNT / 10);
row!(
    trunnion_apart,
    trunnion::TrunnionMill::new(trunnion::APART),
    COUNT / 2
);
row!(
    trunnion_meeting,
    trunnion::TrunnionMill::new(trunnion::MEETING),
    COUNT / 10
);
