//! Joint rates of the setpoints of a job: checked when a setpoint is accepted, whatever the host planned.
//!
//! A segment between two setpoints is cut into pieces of at most [`PIECE`] periods. At the ends of a piece the joints and their rates are known, and in between a joint follows
//! its own cubic Hermite to fourth order. The rate of that cubic is within the hull of three control points: both end rates and 3 (l1 - l0) / T - l0' - l1'. No division is needed.
//!
//! Why a refusal, and no slower path: see docs/decisions/0025-joint-rate-limit.md.

use super::Machinery;
use crate::kinematics::{Accelerations, JointMotion, Pose, PoseError};
use crate::units::{Coordinate, Rate};
use haptimill_protocol::message::{MAX_AXES, RATE_SHIFT, Refusal};
use haptimill_protocol::setpoint::Setpoint;

/// Longest piece of a segment, periods: 13 ms at 200 us.
pub const PIECE: u16 = 64;

/// Joints and their rates at a time on the path.
#[derive(Debug, Clone, Copy, Default)]
pub struct Node {
    motion: JointMotion,
    /// The program alone led all coordinates, without an offset: places may be compared with those of the next node.
    alone: bool,
}

/// The setpoint that is looked at, between those that were accepted and its end.
#[derive(Debug, Default)]
pub struct JointRates {
    /// At the setpoint that was accepted last.
    tail: Node,
    /// At the end of the piece that was checked last.
    last: Node,
    /// At the setpoint that is looked at.
    end: Node,
}

/// What a joint may be commanded by setpoints: a fiftieth more than its maximum rate, for the rounding of a planner that goes to the maximum.
const fn allowed(rate: Rate) -> i64 {
    rate.0 as i64 + rate.0 as i64 / 50
}

impl Machinery {
    /// A job begins at the commanded pose, at rest.
    pub fn begin_joint_rates(&mut self) {
        self.joint_rates = JointRates::default();
        let pose = self.motion.wanted().pose;
        if let Ok(node) = self.node(&pose, &Default::default()) {
            self.joint_rates.tail = node;
        }
    }

    /// Joints and their rates at a pose of the program, with offsets and with coordinates that something else leads.
    fn node(&self, pose: &Pose, rates: &[Rate; MAX_AXES]) -> Result<Node, PoseError> {
        let mut node = Node {
            alone: self.motion.program_alone(),
            ..Node::default()
        };
        let pose = self.motion.destination(pose);
        self.machine
            .place(&pose, rates, &Accelerations::default(), &mut node.motion)?;
        Ok(node)
    }

    /// Notes the joints and their rates at a setpoint, of which the pose is within the soft limits.
    pub(super) fn note_end(&mut self, setpoint: &Setpoint) -> Result<(), PoseError> {
        let mut pose = Pose::default();
        let mut rates = [Rate::ZERO; MAX_AXES];
        let to = setpoint.pose.iter().zip(&setpoint.rates);
        for (axis, (place, rate)) in to.enumerate() {
            pose.0[axis] = Coordinate(*place);
            if self.motion.is_led_by_program(axis) {
                // Of the wire: below 2^24 where it is not refused for itself.
                rates[axis] = Rate(rate.saturating_mul(1 << RATE_SHIFT));
            }
        }
        self.joint_rates.end = self.node(&pose, &rates)?;
        Ok(())
    }

    /// Pieces of the segment to a setpoint.
    #[must_use]
    pub fn pieces(&self, setpoint: &Setpoint) -> u8 {
        if self.motion.program.rests_until(setpoint) {
            return 1;
        }
        let pieces = setpoint.periods.saturating_sub(1) / PIECE + 1;
        pieces.min(240) as u8
    }

    /// Checks the joint rates of a piece of the segment to a setpoint, of which all coordinates may go there; the pieces in order, from 0.
    ///
    /// # Errors
    /// The first joint that would exceed its maximum rate.
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
            for (axis, rate) in rates.iter_mut().enumerate() {
                if !self.motion.is_led_by_program(axis) {
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
        let last = &self.joint_rates.last;
        for (index, joint) in self.config.joints.iter().enumerate() {
            let (before, after) = (last.motion.rates[index].0, node.motion.rates[index].0);
            let both = i64::from(before) + i64::from(after);
            // Of a rotary joint the short way.
            let way = node.motion.joints.0[index].wrapping_sub(last.motion.joints.0[index]);
            // The middle control point, times the time in microseconds: below 2^53 + 2^48.
            let middle = 3_000_000 * i64::from(way.0) - both * time;
            let most = allowed(joint.rate);
            let fast = i64::from(after).abs() > most;
            let bulges = node.alone && last.alone && middle.abs() > most * time;
            if fast || bulges {
                let rate = if fast {
                    i64::from(after)
                } else {
                    middle / time
                };
                return Err(Refusal::JointRate {
                    setpoint: number,
                    axis: index as u8,
                    rate: Rate::saturating_from(rate).0,
                    limit: joint.rate.0,
                });
            }
        }
        self.joint_rates.last = node;
        Ok(())
    }

    /// The setpoint was accepted.
    pub const fn take_end(&mut self) {
        self.joint_rates.tail = self.joint_rates.end;
    }
}
