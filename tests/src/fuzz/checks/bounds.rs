//! Bounds of the checks; docs/fuzzing.md states each with its reason.
//!
//! Of two values the first is for slides (mm), the second for the table (degrees).

/// Measured minus true motor position with a whole encoder: half the lost motion, the index, one
/// count.
pub const MOTOR: [f64; 2] = [0.022, 0.008];
/// Offset of an index pulse above which the counter is known to be wrong.
pub const INDEX_SLACK: [f64; 2] = [0.13, 0.06];
/// Error of a joint with a defective encoder that may last, in mm or degrees.
///
/// It is more than backlash and a count. A larger error lasts at most [`LASTING`] periods, but for
/// a slow motion that ends before [`REVERSALS`] of the count.
pub const OFF: f64 = 0.05;
/// Largest error after one fault of an encoder with a live channel, in mm or degrees.
///
/// This bound and [`LASTING`] are those of tests/tests/position_kept.rs.
pub const FOUND: f64 = 0.12;
/// Periods for which an error may exceed [`OFF`]: 0.05 s.
pub const LASTING: u32 = 250;
/// Largest error where other faults of the joint come with it and move the slide.
///
/// A dead channel is found by [`REVERSALS`] of the count, at most one in a period: a fast joint
/// moves farther meanwhile. Motion in a period with an even number of edges of the live channel
/// adds to this bound: the count does not change.
pub const PUSHED: f64 = 0.6;
/// Reversals of the count that show a dead channel.
pub const REVERSALS: f64 = 24.0;
/// Periods for which that error may exceed [`OFF`]: 0.5 s.
pub const PUSHED_LASTING: u32 = 2500;
/// Largest error while both channels are dead: the second index pulse reveals it.
pub const TWO_TURNS: f64 = 20.0;
/// Distance of a joint from its target that is a runaway.
pub const RUNAWAY: [f64; 2] = [4.0, 4.0];
/// Distance of a healthy slide from its target in motion, less 2 ms of travel.
pub const FOLLOWING: [f64; 2] = [0.20, 0.12];
/// Distance of a healthy slide from its target after a second at standstill.
///
/// The integrator ignores 1.5 counts, which are 1.9 um. The largest distance in 114 million periods
/// (seeds 1 to 1895) was 0.011 mm.
pub const REST: [f64; 2] = [0.015, 0.025];
/// The same for a slide whose flank of the screw is unknown: it moved by less than [`CROSSING`]
/// since its last reversal, or braked harder than [`COASTING`]. Half of both lost motions (25.8 um
/// compensated, 25.8 um real) is 25.8 um.
pub const REST_UNKNOWN_FLANK: f64 = 0.028;
/// Distance of a healthy joint of another machine from its target at standstill.
pub const OTHER_REST: f64 = 0.05;
/// Distance of a healthy tool of another machine from its commanded pose, in mm or degrees, less
/// [`TOOL_LAG`] of travel.
pub const TOOL: f64 = 0.3;
/// Time by which a tool may lag behind its commanded pose, in s.
pub const TOOL_LAG: f64 = 0.005;
/// Position error of a joint without an encoder on a healthy machine: a step and the lost motion.
pub const OPEN_LOOP: f64 = 0.1;
/// Travel after which a slide is on the flank of its direction, in mm: twice its lost motion.
pub const CROSSING: f64 = 0.052;
/// Deceleration above which a slide may coast across the backlash of its screw, in mm/s^2: half of
/// 40 N on 40 kg.
pub const COASTING: f64 = 500.0;
/// The same for a slide whose motion ended with more than [`LASTING`] periods below [`KNEE`].
///
/// Its friction of 40 N is not compensated and is 25 um (firmware/src/joint/friction.rs); half of
/// both lost motions is 14 um.
pub const REST_SLOW: f64 = 0.039;
/// Rate of a slide above which its friction is compensated in full, in mm/s.
///
/// It is five times `coulomb_rate_mm_s` of machines/h4.toml.
pub const KNEE: f64 = 0.1;
/// Following error, as a part of its limit, that must be reported after three periods.
pub const REPORTED: f64 = 1.02;
/// Commanded pose against the interpolation of the setpoints, in axis units.
pub const CUBIC: f64 = 24.0;
/// Periods from a request to its answer on a clean, fast line.
pub const ANSWER: u64 = 5000;
/// Accuracy of the controller's joints, in mm or degrees: 0.1 um
/// (firmware/kinematics/src/machines/h4).
pub const ARITHMETIC: f64 = 1e-4;
/// Rod length residual of the commanded joints at the commanded pose, in mm.
pub const RESIDUAL: f64 = 2e-4;
