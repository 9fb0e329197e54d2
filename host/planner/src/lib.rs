//! Planner: from a part program to a trajectory, and to its setpoints.
//!
//! - A [`Planner`] takes the steps of a program one by one and makes setpoints, in memory that does
//!   not depend on the length of the program.
//! - [`check`] takes a whole program and makes no setpoint: problems, and the figures of the plan.
//! - A [`Track`] is the programmed motion of a job that runs, around its present place.
//! - A [`Plan`] is the whole trajectory of a program, with its setpoints.
//!
//! Every block and every setpoint is checked against soft limits and the machine's geometry. The
//! trajectory is cubic in time between setpoints, as the controller interpolates it.
//!
//! - Along a block: seven phases of constant jerk, no acceleration at the block's ends. A setpoint
//!   is at every change of jerk.
//! - On an arc, setpoints are so close that the cubic stays within 0.1 um of the circle.
//! - A corner of up to 120 degrees is passed at constant speed and rounded within
//!   [`Settings::tolerance_mm`]. The motion stops at sharper corners, with G61, and between moves
//!   of the tip and moves of rotary axes alone. Between a line and an arc, the change of
//!   centripetal acceleration is below [`Settings::curvature_step`] of the limit, and its jerk
//!   within the limit.
//! - Limits of rate, acceleration and jerk hold for every pose coordinate and every joint. A rapid
//!   move is limited to them. A feed that exceeds a rate of the pose is refused, with the largest
//!   possible feed. Joints, acceleration and look-ahead may keep a move below its feed: near a
//!   singularity the feed falls. A move whose joints allow very different speeds is divided.
//!
//! Setpoints are on whole control periods, phases are not: the trajectory is evaluated at the
//! period nearest to each change of jerk. Only standstills begin and end on whole periods.
//!
//! Look-ahead covers 4096 to 8192 blocks, or 32768 moves that are joined to fewer ones: the planned
//! speed allows a stop at the end of the last block that was read.
//!
//! All computations are f64 with the transcendental functions of the crate libm, so a plan has the
//! same bits on every host.
//!
//! Each setpoint states which override applies behind it, and the factor up to which the limits
//! hold.
//!
//! Commands (spindle, coolant, outputs) and dwells are at standstill. G38 and M66 depend on what
//! the machine finds, so that a plan refuses them.
//!
//! A path is checked at the setpoints and at samples of the blocks (at most 1 mm, 1 degree apart),
//! not between them. A pause (M0) takes no time in the plan.

mod block;
mod check;
mod corner;
mod figures;
mod joining;
mod limits;
mod lookahead;
mod messages;
mod outputs;
mod override_mode;
mod plan;
mod planner;
mod profile;
mod samples;
mod setpoints;
mod track;
mod trajectory;

pub use check::{CheckError, check};
pub use figures::Figures;
pub use limits::{
    AnalogueOutput, JointLimits, MachineModel, Outputs, PoseLimits, PoseProblem, Settings,
};
pub use plan::Plan;
pub use planner::Planner;
pub use setpoints::Planned;
pub use track::{SharedTrack, Track};
pub use trajectory::Cursor;
