//! Construction of a joint from its configuration, with the checks of that configuration.

use super::backlash::Backlash;
use super::encoder::Encoder;
use super::index_monitor::IndexMonitor;
use super::monitor::JointMonitor;
use super::servo::ServoLaw;
use super::step_gen::{PulseTiming, StepPlanner};
use super::step_supervision::StepSupervision;
use super::torque::TorqueOutput;
use super::{JointCommand, JointDrive, JointMeasurement, Output, ServoOutput};
use crate::config::{Drive, JointSettings};
use haptimill_math::Coordinate;

/// Reason why the configuration of a joint is invalid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DriveError {
    /// The control period is not within 50 to 1000 us.
    Period,
    /// The size of an encoder count is zero.
    Encoder,
    /// The full scale of a torque drive is zero, or its limit is not above zero.
    Torque,
    /// A step is smaller than one axis unit, or the ticks per microsecond are not within 1 to 1000.
    Step,
    /// Pulse width and direction setup time do not fit into a control period.
    Timing,
    /// The backlash is below zero.
    Backlash,
}

/// Largest plausible rate of a joint (moved by hand, coasting, or runaway) over its highest
/// configured rate.
const REACH_FACTOR: u64 = 10;

/// Counts that a joint can move in a period. It is the following error at standstill (a rotor that
/// snaps, a screw that unwinds) plus the travel at [`REACH_FACTOR`] times the maximum rate. A
/// counter has jumped if it changes by more. After missed periods the mean change per period
/// counts.
///
/// A count of emitted steps cannot jump.
fn reach(joint: &JointSettings, period_us: u16) -> u32 {
    let Some(encoder) = &joint.encoder else {
        return u32::MAX;
    };
    let rate = u64::from(joint.rate.0.unsigned_abs());
    let travel = rate * REACH_FACTOR * u64::from(period_us) / 1_000_000;
    let reach = travel + u64::from(encoder.following.magnitude());
    let counts = (reach << 24) / encoder.per_count.unsigned_abs().max(1);
    counts.min(u64::from(u32::MAX)) as u32
}

/// Size of an encoder count, or of a step without an encoder.
fn count(per_count: i64) -> Coordinate {
    let size = per_count.unsigned_abs() >> 24;
    Coordinate(size.min(i32::MAX as u64) as i32)
}

impl JointDrive {
    /// A joint of a configuration, disabled. Its first measured position becomes coordinate 0.
    /// `period_us` is the control period, 50 to 1000 us.
    ///
    /// # Errors
    ///
    /// A [`DriveError`] if the configuration of the joint is invalid.
    pub fn new(joint: &JointSettings, period_us: u16) -> Result<Self, DriveError> {
        if !(50..=1000).contains(&period_us) {
            return Err(DriveError::Period);
        }
        let encoder = joint.encoder.as_ref();
        let per_count = match (encoder, &joint.drive) {
            (Some(encoder), _) => encoder.per_count,
            (None, Drive::Steps { per_step, .. }) => *per_step,
            (None, Drive::Torque { .. }) => 0,
        };
        if per_count == 0 {
            return Err(DriveError::Encoder);
        }
        let indexes = encoder.map_or(IndexMonitor::new(0, 1, 0), |encoder| {
            IndexMonitor::new(encoder.index_pitch.0, per_count, encoder.index_slack)
        });
        if joint.backlash.0 < 0 {
            return Err(DriveError::Backlash);
        }
        let output = match joint.drive {
            Drive::Torque { full_scale, limit } => {
                if full_scale.0 == 0 || limit.0 <= 0 {
                    return Err(DriveError::Torque);
                }
                Output::Torque {
                    law: ServoLaw::new(&joint.law, limit, period_us, count(per_count)),
                    output: TorqueOutput::new(full_scale),
                }
            }
            Drive::Steps {
                per_step,
                ticks_per_us,
                pulse,
                setup,
                hold,
                lost,
                ..
            } => {
                if per_step.unsigned_abs() < 1 << 24 || !(1..=1000).contains(&ticks_per_us) {
                    return Err(DriveError::Step);
                }
                let period = u32::from(ticks_per_us) * u32::from(period_us);
                let timing = PulseTiming {
                    period,
                    pulse,
                    setup,
                    hold,
                };
                if !timing.fits() {
                    return Err(DriveError::Timing);
                }
                Output::Steps {
                    planner: StepPlanner::new(joint.kind, per_step, timing, period_us),
                    supervision: StepSupervision::new(per_step, lost),
                }
            }
        };
        Ok(Self {
            kind: joint.kind,
            encoder: Encoder::new(joint.kind, per_count),
            indexes,
            backlash: Backlash::new(joint, period_us),
            output,
            monitor: JointMonitor::default(),
            commanded: JointCommand::default(),
            measurement: JointMeasurement::default(),
            servo_output: ServoOutput::default(),
            measured_once: false,
            enabled: false,
            reach: reach(joint, period_us),
            open_loop: encoder.is_none(),
            placed: true,
        })
    }
}
