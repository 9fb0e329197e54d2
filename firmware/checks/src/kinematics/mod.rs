//! Conformance suite of machine kinematics: every machine must pass it.
//!
//! A new machine needs a [`subject::Subject`] and its rows in the list of `subjects!`. The subject
//! has reference values in f64 from the closure of its loops and not from the firmware's formulas.
//! The list gives the checks of a chip here, and the tests with large counts in the firmware's test
//! `kinematics_conformance`.
#![allow(
    clippy::needless_range_loop,
    reason = "an index is an axis here, of several arrays at once"
)]

pub mod bounds;
pub mod cartesian;
pub mod corexy;
pub mod facet;
pub mod five_bar;
pub mod h4;
pub mod linear_delta;
pub mod polar_mill;
pub mod scara;
pub mod subject;
pub mod suite;
pub mod trunnion;

use crate::Check;

/// The list of subjects: calls the macro `$rows` with a row for each.
///
/// A row is a name, a subject, the share of the natively tested poses, and the number of poses on a
/// chip. A small chip without an f64 unit does 4000 poses in a second.
#[macro_export]
macro_rules! subjects {
    ($rows:ident) => {
        $rows! {
            h4_reference: h4::Arm::new(h4::REFERENCE), 1.0, 4000;
            h4_other: h4::Arm::new(h4::OTHER), 0.2, 1000;
            cartesian_slides: cartesian::CartesianAxes::<3>::default(), 0.1, 1000;
            four_axis: cartesian::CartesianAxes::<4>::default(), 0.1, 500;
            six_axis: cartesian::CartesianAxes::<6>::default(), 0.1, 500;
            trunnion_apart: trunnion::TrunnionMill::new(trunnion::APART), 0.5, 1000;
            trunnion_meeting: trunnion::TrunnionMill::new(trunnion::MEETING), 0.1, 200;
            facet_long: facet::Faceter::new(facet::LONG), 0.5, 1000;
            facet_short: facet::Faceter::new(facet::SHORT), 0.1, 200;
            scara_right: scara::Arm::new(scara::RIGHT), 0.2, 500;
            scara_left: scara::Arm::new(scara::LEFT), 0.1, 200;
            delta_even: linear_delta::Slides::new(linear_delta::EVEN), 0.2, 500;
            delta_uneven: linear_delta::Slides::new(linear_delta::UNEVEN), 0.1, 200;
            five_bar_apart: five_bar::Arms::new(five_bar::APART), 0.2, 500;
            five_bar_on_one_axis: five_bar::Arms::new(five_bar::ON_ONE_AXIS), 0.1, 200;
            polar_aside: polar_mill::Table::new(polar_mill::ASIDE), 0.2, 500;
            polar_centred: polar_mill::Table::new(polar_mill::CENTRED), 0.1, 200;
            corexy_belts: corexy::Belts::default(), 0.1, 500;
        }
    };
}

/// Defines the checks of a chip.
macro_rules! checks {
    ($($name:ident: $subject:expr, $share:literal, $count:literal;)*) => {
        /// The checks of this module.
        pub const CHECKS: &[Check] = &[$(
            Check {
                name: concat!(
                    "kinematics::",
                    stringify!($name),
                    "::inverse_matches_closure_and_forward_inverts_it"
                ),
                run: || {
                    suite::inverse_against_closure(&$subject, $count);
                },
            },
            Check {
                name: concat!("kinematics::", stringify!($name), "::no_wrong_pose"),
                run: || {
                    suite::forward_is_verified(&$subject, $count);
                },
            },
            Check {
                name: concat!("kinematics::", stringify!($name), "::extremes"),
                run: || suite::extremes(&$subject, $count),
            },
            Check {
                name: concat!("kinematics::", stringify!($name), "::derivatives"),
                run: || suite::derivatives_against_differences(&$subject, $count / 50),
            },
            Check {
                name: concat!("kinematics::", stringify!($name), "::boxes"),
                run: || {
                    bounds::boxes_bound_their_poses(&$subject, $count / 20);
                },
            },
            Check {
                name: concat!("kinematics::", stringify!($name), "::searches"),
                run: || bounds::a_search_moves_its_joints(&$subject, $count / 50),
            },
        )*];
    };
}

subjects!(checks);
