//! Joint rate limit of the setpoints of a job, checked when a setpoint is accepted. The check does
//! not depend on the host's planner.
//!
//! A segment is cut into pieces of at most [`PIECE`] periods. Joint positions and rates are known
//! at the ends of a piece. In between, a joint follows its own cubic Hermite polynomial to fourth
//! order. The rate of that cubic lies within the hull of three control points: both end rates, and
//! 3 (q1 - q0) / T - q0' - q1'. The check needs no division by the time.
//!
//! Joint rates grow with the speed factor: the limit is divided by the maximum speed factor that
//! the override mode of the segment, or of a faster part before it, allows.
//!
//! docs/decisions/0025-joint-rate-limit.md explains why a setpoint is refused and the path is not
//! slowed down.

use super::Machine;
use haptimill_kinematics::{Accelerations, JointMotion, Kinematics, Pose, PoseError};
use haptimill_math::{Coordinate, Rate};
use haptimill_protocol::message::{MAX_AXES, RATE_SHIFT, Refusal};
use haptimill_protocol::setpoint::Setpoint;

/// Longest piece of a segment, periods: 51 ms at 200 us. With shorter pieces setpoints wait for
/// longer than the link waits for an acknowledgement.
pub const PIECE: u16 = 256;

/// Joint positions and rates at a time on the path.
#[derive(Debug, Clone, Copy, Default)]
pub struct Node {
    motion: JointMotion,
    /// The program is the source of all coordinates, without an offset. Positions may then be
    /// compared with those of the next node.
    alone: bool,
}

/// The setpoint under validation, after those that were accepted.
#[derive(Debug, Default)]
pub struct JointRates {
    /// At the setpoint accepted last.
    tail: Node,
    /// At the end of the piece checked last.
    last: Node,
    /// At the setpoint under validation.
    end: Node,
}

/// Maximum joint rate at the programmed speed, if the speed factor may be `speed_factor` percent. A
/// rate is rounded down by less than 200 units.
const fn limit(rate: Rate, speed_factor: i32) -> i32 {
    if speed_factor > 100 {
        rate.0 / speed_factor * 100
    } else {
        rate.0
    }
}

/// Maximum joint rate that setpoints may command: 2 % above the limit, for the rounding of a
/// planner that uses the limit.
const fn allowed(limit: i32) -> i64 {
    limit as i64 + (limit / 50) as i64
}

impl Machine {
    /// Starts the check of a job: at the commanded pose, at rest.
    pub fn begin_joint_rates(&mut self) {
        self.joint_rates = JointRates::default();
        let pose = self.motion.commanded().pose;
        if let Ok(node) = self.node(&pose, &Default::default()) {
            self.joint_rates.tail = node;
        }
    }

    /// Joint positions and rates at a pose of the program, with offsets and with the coordinates of
    /// other sources.
    fn node(&self, pose: &Pose, rates: &[Rate; MAX_AXES]) -> Result<Node, PoseError> {
        let mut node = Node {
            alone: self.motion.program_alone(),
            ..Node::default()
        };
        let pose = self.motion.destination(pose);
        self.kinematics
            .solve(&pose, rates, &Accelerations::default(), &mut node.motion)?;
        Ok(node)
    }

    /// Stores the joint positions and rates at a setpoint whose pose is within the soft limits.
    pub(super) fn append_end(&mut self, setpoint: &Setpoint) -> Result<(), PoseError> {
        let mut pose = Pose::default();
        let mut rates = [Rate::ZERO; MAX_AXES];
        let to = setpoint.pose.iter().zip(&setpoint.rates);
        for (coordinate, (solve, rate)) in to.enumerate() {
            pose.0[coordinate] = Coordinate(*solve);
            if self.motion.is_led_by_program(coordinate) {
                // Rates from the wire are below 2^24; the setpoint check refuses others.
                rates[coordinate] = Rate(rate.saturating_mul(1 << RATE_SHIFT));
            }
        }
        self.joint_rates.end = self.node(&pose, &rates)?;
        Ok(())
    }

    /// Number of pieces of the segment to a setpoint, 1 to 240.
    #[must_use]
    pub fn pieces(&self, setpoint: &Setpoint) -> u8 {
        if self.motion.program.stays_until(setpoint) {
            return 1;
        }
        let pieces = setpoint.periods.saturating_sub(1) / PIECE + 1;
        pieces.min(240) as u8
    }

    /// Checks the joint rates of one piece of the segment to a setpoint whose coordinates have
    /// passed their checks. Callers must check the pieces in order, from 0.
    ///
    /// # Errors
    /// [`Refusal::JointRate`] for the first joint that would exceed its maximum rate, or the
    /// refusal of a pose without joint positions.
    #[inline(never)]
    pub fn check_piece(
        &mut self,
        number: u32,
        setpoint: &Setpoint,
        piece: u8,
        pieces: u8,
    ) -> Result<(), Refusal> {
        if piece == 0 {
            self.joint_rates.last = self.joint_rates.tail;
        }
        let begun = u16::from(piece) * PIECE;
        let (node, periods) = if piece + 1 == pieces {
            (self.joint_rates.end, setpoint.periods - begun)
        } else {
            let sample = self.motion.program.sample_to(setpoint, begun + PIECE);
            let sample = sample.ok_or(Refusal::Setpoint { setpoint: number })?;
            let mut rates = sample.rates;
            for (coordinate, rate) in rates.iter_mut().enumerate() {
                if !self.motion.is_led_by_program(coordinate) {
                    *rate = Rate::ZERO;
                }
            }
            let node = self.node(&sample.pose, &rates);
            let node = node.map_err(|error| Refusal::Pose {
                setpoint: number,
                error,
            })?;
            (node, PIECE)
        };
        let time = i64::from(periods) * i64::from(self.config.period_us);
        let speed_factor = i32::from(self.motion.program.max_percent());
        let last = &self.joint_rates.last;
        for (index, joint) in self.config.joints.iter().enumerate() {
            let (before, after) = (last.motion.rates[index].0, node.motion.rates[index].0);
            let both = i64::from(before) + i64::from(after);
            // Wraps: a rotary joint takes the short way.
            let distance = node.motion.joints.0[index].wrapping_sub(last.motion.joints.0[index]);
            // The middle control point, times the time in microseconds: below 2^53 + 2^48.
            let middle = 3_000_000 * i64::from(distance.0) - both * time;
            let limit = limit(joint.rate, speed_factor);
            let max = allowed(limit);
            let too_fast = i64::from(after).abs() > max;
            let too_fast_between = node.alone && last.alone && middle.abs() > max * time;
            if too_fast || too_fast_between {
                let rate = if too_fast {
                    i64::from(after)
                } else {
                    middle / time
                };
                return Err(Refusal::JointRate {
                    setpoint: number,
                    joint: index as u8,
                    rate: Rate::saturating_from(rate).0,
                    limit,
                });
            }
        }
        self.joint_rates.last = node;
        Ok(())
    }

    /// Makes the accepted setpoint the start of the next check.
    pub const fn accept_end(&mut self) {
        self.joint_rates.tail = self.joint_rates.end;
    }
}
