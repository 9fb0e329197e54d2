//! Homing by switches: each joint moves alone, in its own coordinate. The commanded pose is
//! constant until all joints are found.

use super::Machine;
use super::move_off::MoveOff;
use crate::config::{Home, SwitchInput};
use crate::io::{Inputs, JointInputs, first_alarm};
use crate::joint::encoder::sum;
use crate::safety::switch_search::{SearchInputs, SwitchSearch};
use haptimill_kinematics::Joints;
use haptimill_math::{Acceleration, Coordinate, Rate};
use haptimill_protocol::message::{Fault, HomingProblem, MAX_AXES};

/// The search of all joints.
#[derive(Debug, Default)]
pub struct Switches {
    active: bool,
    /// Commanded joints at the start.
    pub(super) origin: Joints,
    /// A joint moves off its limit switch, in place of a search.
    pub(super) move_off: Option<MoveOff>,
    /// Active limit switches that are no fault meanwhile, by joint.
    ignored: [u8; MAX_AXES],
    /// The position was known at the start.
    known: bool,
    /// Shifts of the coordinates of the joints that were found.
    shifts: [Coordinate; MAX_AXES],
    searches: [SwitchSearch; MAX_AXES],
}

impl Switches {
    /// Distance of a joint from the start of its search.
    pub(super) fn moved(&self, joint: usize) -> i64 {
        self.searches.get(joint).map_or(0, SwitchSearch::moved)
    }

    /// Shifts of the coordinates of the joints that the last search found.
    pub(super) const fn shifts(&self) -> &[Coordinate; MAX_AXES] {
        &self.shifts
    }

    /// Whether the position was known when the last search began.
    pub(super) const fn was_known(&self) -> bool {
        self.known
    }
}

impl Machine {
    /// Whether joints search their switches. The pose is not commanded then.
    #[must_use]
    #[inline]
    pub const fn searches_switches(&self) -> bool {
        self.switches.active
    }

    /// Starts the search of the joints that home by a switch.
    pub(super) fn begin_switches(&mut self, known: bool) {
        let mut joints = self.config.joints.iter();
        self.switches = Switches {
            active: joints.any(|joint| joint.home.switch().is_some()),
            origin: self.target.joints,
            known,
            ..Switches::default()
        };
        self.set_placed(!self.switches.active);
    }

    /// Starts the motion of a joint off its limit switch, with the drives just switched on.
    pub(super) fn start_move_off(&mut self, move_off: MoveOff, ignored: [u8; MAX_AXES]) {
        self.switches = Switches {
            active: true,
            origin: self.target.joints,
            move_off: Some(move_off),
            ignored,
            ..Switches::default()
        };
        self.plain_switches = false;
        // A joint on its limit switch is beyond its stroke.
        self.joints
            .iter_mut()
            .for_each(|joint| joint.set_placed(false));
    }

    /// Ends the search, or the motion off a limit switch, without a result.
    pub(super) fn end_switch_motion(&mut self) {
        if self.switches.active {
            self.switches.active = false;
            self.switches.move_off = None;
            self.switches.ignored = [0; MAX_AXES];
            self.plain_switches = self.has_plain_switches();
            self.set_placed(true);
        }
    }

    /// Sets whether the strokes of the joints that home by a switch are supervised.
    fn set_placed(&mut self, placed: bool) {
        for (joint, settings) in self.joints.iter_mut().zip(&self.config.joints) {
            joint.set_placed(placed || settings.home.switch().is_none());
        }
    }

    /// One period of the search, and the joints commanded in it. Returns whether it has ended: all
    /// joints are found, or at rest after a stop.
    ///
    /// # Errors
    /// The fault that stops all joints.
    #[inline(never)]
    pub fn advance_switches(&mut self, inputs: &Inputs, stopping: bool) -> Result<bool, Fault> {
        let order = self.present_order();
        let period_us = self.config.period_us;
        let mut rest = true;
        // The motors of a gantry wait for each other, as they were in the period before.
        let before = self.switches.searches;
        for (index, settings) in self.config.joints.iter().enumerate() {
            let (Some(config), Some(joint)) = (settings.home.switch(), self.joints.get(index))
            else {
                continue;
            };
            let search = &mut self.switches.searches[index];
            if stopping || Some(config.order) != order {
                rest &= search.halt(config, period_us);
            } else {
                rest = false;
                let encoder = settings.encoder.as_ref();
                let index_travel = match settings.home {
                    Home::SwitchAndIndex(_) => {
                        encoder.map(|encoder| i64::from(encoder.index_pitch.0) * 6 / 5)
                    }
                    _ => None,
                };
                let measurement = joint.measurement();
                let partner = self.config.partner(index).and_then(|it| before.get(it));
                let search_inputs = SearchInputs {
                    config,
                    partner,
                    active: settings.active_switches(&inputs.joints[index]) & config.input.bit()
                        != 0,
                    place: measurement.coordinate,
                    index: measurement.index.map(|(_, coordinate)| coordinate),
                    index_travel,
                    period_us,
                };
                search
                    .advance(&search_inputs)
                    .map_err(|problem| Fault::Homing {
                        joint: index as u8,
                        problem,
                    })?;
            }
            let moved = Coordinate(search.moved() as i32);
            self.target.joints.0[index] = sum(settings.kind, self.switches.origin.0[index], moved);
            self.target.rates[index] = Rate::saturating_from(search.rate());
            let change = search.change() * 1_000_000 / i64::from(period_us.max(1)) / 256;
            self.target.accelerations[index] = Acceleration(change as i32);
        }
        if let Some(fault) = self.racked_in_search() {
            return Err(fault);
        }
        let found = self.present_order().is_none();
        if found || (stopping && rest) {
            self.place_joints(inputs, found)?;
            self.end_switch_motion();
            return Ok(true);
        }
        Ok(false)
    }

    /// Lowest order of the joints that are not found yet.
    fn present_order(&self) -> Option<u8> {
        let joints = self.config.joints.iter().zip(&self.switches.searches);
        let missing = joints.filter(|(_, search)| !search.is_done());
        missing
            .filter_map(|(joint, _)| Some(joint.home.switch()?.order))
            .min()
    }

    /// Places the joints at the coordinates of their switches; joints that were not found are
    /// placed at their presets. Nothing moves.
    pub(super) fn place_joints(&mut self, inputs: &Inputs, found: bool) -> Result<(), Fault> {
        let mut commanded = self.target.joints;
        for (index, settings) in self.config.joints.iter().enumerate() {
            let (Some(config), Some(joint)) = (settings.home.switch(), self.joints.get_mut(index))
            else {
                continue;
            };
            let motor = joint.measurement().motor;
            let (touched, pulse) = self.switches.searches[index].found();
            let mut by = config.coordinate.0.wrapping_sub(touched.0);
            if !found {
                by = settings.preset.0.wrapping_sub(motor.0);
            } else if let (Some(pulse), Some(encoder)) = (pulse, &settings.encoder) {
                // The pulses come once a turn of the motor.
                let pitch = i64::from(encoder.index_pitch.0).max(1);
                let place = i64::from(pulse.0.wrapping_add(by));
                let off = (i64::from(encoder.index.0) - place).rem_euclid(pitch);
                let off = if off > pitch / 2 { off - pitch } else { off };
                if off.abs() > i64::from(encoder.search.0) {
                    return Err(Fault::Homing {
                        joint: index as u8,
                        problem: HomingProblem::Implausible,
                    });
                }
                by = by.wrapping_add(off as i32);
            }
            let counter = joint.counter(&inputs.joints[index]);
            let shift = joint.set_reference(counter, Coordinate(motor.0.wrapping_add(by)));
            self.switches.shifts[index] = shift;
            commanded.0[index] = sum(settings.kind, commanded.0[index], shift);
            self.homing.place(index, 0);
        }
        self.update_measured();
        self.set_joints(&commanded).map_err(Fault::Pose)?;
        self.motion.begin_jog(false);
        Ok(())
    }

    /// Places the joints that home by a switch at their presets while the drives are off: their
    /// positions are unknown, so no other check keeps them within their strokes.
    pub fn forget_joints(&mut self, inputs: &Inputs) {
        for (index, settings) in self.config.joints.iter().enumerate() {
            if settings.home.switch().is_some()
                && let Some(joint) = self.joints.get_mut(index)
            {
                joint.set_reference(joint.counter(&inputs.joints[index]), settings.preset);
            }
        }
        self.update_measured();
    }

    /// A limit switch that is active, or a drive that reports a fault, on a machine whose switches
    /// are active at a low level or serve for homing, or while a joint moves off its limit switch.
    #[cold]
    #[inline(never)]
    pub fn hardware_fault(&self, inputs: &[JointInputs; MAX_AXES], homed: bool) -> Option<Fault> {
        for (index, joint) in self.config.joints.iter().enumerate() {
            let seen = inputs.get(index)?;
            let mut limits = SwitchInput::LimitLow.bit() | SwitchInput::LimitHigh.bit();
            limits &= !self.switches.ignored[index];
            if let Some(home) = joint.home.switch()
                && !homed
            {
                limits &= !home.input.bit();
            }
            if joint.active_switches(seen) & limits != 0 {
                return Some(Fault::LimitSwitch { joint: index as u8 });
            }
            if !seen.drive_ready {
                let (joint, alarm) = first_alarm(inputs.get(..self.config.joints.len())?)?;
                return Some(Fault::Drive { joint, alarm });
            }
        }
        None
    }

    /// Whether every switch is active at a high level and none of the limits serves for homing.
    pub(super) fn has_plain_switches(&self) -> bool {
        self.config.joints.iter().all(|joint| {
            let input = joint.home.switch().map(|switch| switch.input);
            joint.active_low == 0 && !input.is_some_and(|input| input != SwitchInput::Home)
        })
    }
}
