//! The conformance suite of machine kinematics with large counts, for every machine in the list of
//! `haptimill_checks::kinematics`. The same checks run on a chip, with smaller counts.

use haptimill_checks::kinematics::*;
use haptimill_checks::subjects;

/// Poses and joints of a subject with the share 1.
const COUNT: usize = 1_000_000;

/// Defines the tests of each subject.
macro_rules! tests {
    ($($name:ident: $subject:expr, $share:literal, $chip:literal;)*) => {
        $(mod $name {
            use super::*;

            /// Poses and joints of this subject.
            const SHARE: usize = (COUNT as f64 * $share) as usize;

            #[test]
            fn inverse_matches_closure_and_forward_inverts_it() {
                let (inverse, forward) = suite::inverse_against_closure(&$subject, SHARE);
                println!(
                    "largest error, share of the bound: inverse {inverse:.3}, forward {forward:.3}"
                );
            }

            #[test]
            fn no_wrong_pose() {
                let worst = suite::forward_is_verified(&$subject, SHARE);
                println!("largest error, share of the bound: {worst:.3}");
            }

            #[test]
            fn extremes() {
                suite::extremes(&$subject, SHARE / 2);
            }

            #[test]
            fn derivatives() {
                suite::derivatives_against_differences(&$subject, SHARE / 50);
            }

            #[test]
            fn boxes() {
                let share = bounds::boxes_bound_their_poses(&$subject, SHARE / 5);
                println!("{share:.2} of the boxes are bounded");
                // Bounds that are much too wide refuse boxes that the machine reaches.
                assert!(share > 0.25, "{share}");
            }

            #[test]
            fn searches() {
                bounds::a_search_moves_its_joints(&$subject, SHARE / 100);
            }
        })*
    };
}

subjects!(tests);
