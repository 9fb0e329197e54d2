//! Identification of the joints of a machine through its controller, and gains from the result.
//!
//! The measurement uses the protocol alone: setpoints of jobs, and telemetry with the counts and
//! the drive command of each frame. It works the same on a board and on the simulated machine, and
//! never reads the section `[plant]` of a machine file.
//!
//! - [`line`](mod@line): where a joint can move.
//! - [`excitation`]: constant rates, and sines on top of a constant rate.
//! - [`measure`]: friction, and the response at a frequency, by least squares.
//! - [`two_mass`]: the model of a joint, and its fit to the response.
//! - [`identify`]: the sequence on a machine.
//! - [`lost_steps`], [`switch_test`]: limits of step motors without encoder, by home switches.
//! - [`index_pulses`]: places of index pulses and their spread.
//! - [`lost_motion`]: lost motion of a joint, by a gauge.
//! - [`servo_loop`], [`tune`]: margins of gains, and the proposal.
//! - [`record`], [`edit`], [`page`]: the results as a file, in the machine file, as a page.

pub mod complex;
pub mod edit;
pub mod excitation;
pub mod identify;
pub mod index_pulses;
pub mod least_squares;
pub mod line;
pub mod lost_motion;
pub mod lost_steps;
pub mod measure;
pub mod page;
pub mod record;
pub mod servo_loop;
pub mod switch_test;
pub mod tune;
pub mod two_mass;
