//! Moving a joint off the limit switch on which it stands: the joint moves alone, slowly, away from
//! the switch, until the switch opens and the joint is within its stroke.
//!
//! The side of the active switch gives the direction. A switch that is stuck, inverted or wired to
//! the input of the other end must not run the joint through its stroke: the motion ends after a
//! sixteenth of the stroke. The two motors of a gantry move together, by the same distance.
//!
//! Limit switches that are active at the start are no fault until the end, because the other
//! joints do not move. Any other limit switch is. The position is lost: homing follows.

use super::Machine;
use crate::config::{JointSettings, SwitchHome, SwitchInput};
use crate::io::{Inputs, first_alarm};
use crate::joint::encoder::sum;
use crate::safety::switch_search::{SearchInputs, SwitchSearch};
use haptimill_math::{Acceleration, Coordinate, Rate};
use haptimill_protocol::message::{Fault, HomingProblem, InputProblem, MAX_AXES, Refusal};

/// Parts of the stroke: travel in which the switch must open, and distance beyond the opened
/// switch.
const TRAVEL_SHIFT: u32 = 4;
const BACK_OFF_SHIFT: u32 = 8;

/// Part of the stroke by which the joint ends within it, as a power of two.
const INSIDE_SHIFT: u32 = 5;

/// Part of the maximum rate of the joint with which it moves, as a power of two.
const RATE_SHIFT: u32 = 5;

/// The joint reaches the rate in this part of a second, as a power of two.
const RISE_SHIFT: u32 = 3;

/// Both limit switches.
const LIMITS: u8 = SwitchInput::LimitLow.bit() | SwitchInput::LimitHigh.bit();

/// A joint that moves off its limit switch.
#[derive(Debug)]
pub(super) struct MoveOff {
    joint: usize,
    /// The other motor of its gantry.
    partner: Option<usize>,
    /// The switch, and the distances and rates of the motion.
    motion: SwitchHome,
    search: SwitchSearch,
    /// The joint moved on from the opened switch into its stroke.
    is_extended: bool,
}

/// Width of the stroke; of a joint without ends that of the whole circle.
fn stroke(joint: &JointSettings) -> u32 {
    joint.high.0.wrapping_sub(joint.low.0) as u32
}

fn part(of: u32, shift: u32) -> Coordinate {
    Coordinate((of >> shift) as i32)
}

/// The motion off the limit switch at the lower or the upper end.
fn motion_off(joint: &JointSettings, input: SwitchInput) -> SwitchHome {
    let rate = Rate((joint.rate.0 >> RATE_SHIFT).max(1));
    let travel = part(stroke(joint), TRAVEL_SHIFT);
    SwitchHome {
        input,
        order: 0,
        downwards: matches!(input, SwitchInput::LimitLow),
        coordinate: Coordinate(0),
        rate,
        touch_rate: rate,
        // The unit of an acceleration is 2^8 axis units per second squared.
        acceleration: Acceleration(((rate.0 >> 8) << RISE_SHIFT).max(1)),
        back_off: part(stroke(joint), BACK_OFF_SHIFT),
        release: travel,
        travel,
    }
}

impl Machine {
    /// Whether a joint moves off its limit switch.
    #[must_use]
    pub const fn is_moving_off(&self) -> bool {
        self.switches.move_off.is_some()
    }

    /// The joint that moves off its limit switch.
    #[must_use]
    pub fn move_off_joint(&self) -> u8 {
        let move_off = self.switches.move_off.as_ref();
        move_off.map_or(0, |move_off| move_off.joint as u8)
    }

    /// Starts to move a joint off its limit switch. The drives are off until now.
    ///
    /// # Errors
    /// The joint is on no limit switch and within its stroke, or on both switches; a drive is not
    /// ready; the machine coasts.
    #[cold]
    #[inline(never)]
    pub fn begin_move_off(&mut self, index: u8, inputs: &Inputs) -> Result<(), Refusal> {
        let joint = usize::from(index);
        let settings = self.config.joints.get(joint).ok_or(Refusal::Range)?;
        let drives = inputs.joints.get(..self.config.joints.len());
        if let Some((joint, alarm)) = drives.and_then(first_alarm) {
            return Err(Refusal::Input(InputProblem::Drive { joint, alarm }));
        }
        let mut ignored = [0; MAX_AXES];
        let joints = self.config.joints.iter().zip(&inputs.joints);
        for (slot, (settings, seen)) in ignored.iter_mut().zip(joints) {
            *slot = settings.active_switches(seen) & LIMITS;
        }
        let partner = self.config.partner(joint);
        let active = ignored[joint] | partner.map_or(0, |partner| ignored[partner]);
        let none = Refusal::Input(InputProblem::NoLimitSwitch { joint: index });
        let input = match active {
            // Of a motion that was stopped between the switch and the stroke.
            0 => self.side_beyond_stroke(joint).ok_or(none)?,
            LIMITS => {
                let both = InputProblem::BothLimitSwitches { joint: index };
                return Err(Refusal::Input(both));
            }
            _ if active == SwitchInput::LimitLow.bit() => SwitchInput::LimitLow,
            _ => SwitchInput::LimitHigh,
        };
        if !self.is_at_standstill() {
            return Err(Refusal::Input(InputProblem::Coasting));
        }
        let move_off = MoveOff {
            joint,
            partner,
            motion: motion_off(settings, input),
            search: SwitchSearch::moving_off(),
            is_extended: false,
        };
        self.forget_joints(inputs);
        self.reset_force();
        self.motion.begin_jog(false);
        self.switch_on();
        self.start_move_off(move_off, ignored);
        Ok(())
    }

    /// The end of its stroke that a joint is beyond. A joint that homes by a switch has no
    /// coordinate before it is homed.
    fn side_beyond_stroke(&self, joint: usize) -> Option<SwitchInput> {
        let settings = self.config.joints.get(joint)?;
        if settings.home.switch().is_some() || settings.wraps() {
            return None;
        }
        match self.measured.0[joint] {
            at if at < settings.low => Some(SwitchInput::LimitLow),
            at if at > settings.high => Some(SwitchInput::LimitHigh),
            _ => None,
        }
    }

    /// One period of the motion. Returns whether the joint is at rest, off the switch or after a
    /// stop.
    ///
    /// # Errors
    /// The switch did not open within the travel.
    #[cold]
    #[inline(never)]
    pub fn advance_move_off(&mut self, inputs: &Inputs, stopping: bool) -> Result<bool, Fault> {
        if self.is_locking() {
            return Ok(stopping);
        }
        let period_us = self.config.period_us;
        let Some(move_off) = &mut self.switches.move_off else {
            return Ok(true);
        };
        let (joint, partner) = (move_off.joint, move_off.partner);
        let motors = [Some(joint), partner];
        let motors = motors.into_iter().flatten();
        let bit = move_off.motion.input.bit();
        let active = motors.clone().any(|motor| {
            let switches = self.config.joints.get(motor).zip(inputs.joints.get(motor));
            switches.is_some_and(|(settings, seen)| settings.active_switches(seen) & bit != 0)
        });
        let at_rest = if stopping {
            move_off.search.halt(&move_off.motion, period_us)
        } else {
            let search_inputs = SearchInputs {
                config: &move_off.motion,
                partner: None,
                active,
                place: self.measured.0[joint],
                index: None,
                index_travel: None,
                period_us,
            };
            let failed = |_| Fault::Homing {
                joint: joint as u8,
                problem: HomingProblem::LimitStuck,
            };
            move_off.search.advance(&search_inputs).map_err(failed)?;
            move_off.search.is_done()
        };
        let moved = Coordinate(move_off.search.moved() as i32);
        let change = move_off.search.change() * 1_000_000 / i64::from(period_us.max(1)) / 256;
        for motor in motors {
            let origin = self.switches.origin.0[motor];
            let Some(settings) = self.config.joints.get(motor) else {
                continue;
            };
            self.target.joints.0[motor] = sum(settings.kind, origin, moved);
            self.target.rates[motor] = Rate::saturating_from(move_off.search.rate());
            self.target.accelerations[motor] = Acceleration(change as i32);
        }
        if !at_rest || stopping {
            return Ok(at_rest);
        }
        Ok(!self.extend_move_off())
    }

    /// Moves on where the joint is beyond its stroke or near its end, where soft limits would
    /// refuse the pose. Returns false where it is not, or where its coordinate says that the stroke
    /// is so far that the coordinate must be wrong.
    fn extend_move_off(&mut self) -> bool {
        let Some(move_off) = &mut self.switches.move_off else {
            return false;
        };
        let Some(settings) = self.config.joints.get(move_off.joint) else {
            return false;
        };
        let at = i64::from(self.target.joints.0[move_off.joint].0);
        let inside = i64::from(stroke(settings) >> INSIDE_SHIFT);
        let beyond = inside
            + if move_off.motion.downwards {
                i64::from(settings.low.0) - at
            } else {
                at - i64::from(settings.high.0)
            };
        let max = i64::from(move_off.motion.travel.0) * 2;
        if move_off.is_extended || beyond <= 0 || beyond > max {
            return false;
        }
        move_off.is_extended = true;
        move_off.motion.back_off.0 += beyond as i32;
        move_off.search.move_on();
        true
    }

    /// Ends the motion at rest. Returns whether the drives may hold the machine: no limit switch
    /// is active, and the joints give a pose.
    #[cold]
    #[inline(never)]
    pub fn end_move_off(&mut self, inputs: &Inputs) -> bool {
        self.end_switch_motion();
        self.locking.is_none()
            && self.hardware_fault(&inputs.joints, false).is_none()
            && self.place_joints(inputs, false).is_ok()
    }
}
