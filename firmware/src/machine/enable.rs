//! Drives on and off, and the motions that set the commanded position to the measured one: the
//! locking of step motors, and homing.

use super::Machine;
use crate::config::Home;
use crate::io::Inputs;
use crate::joint::JointDrive;
use crate::safety::homing::Homing;
use haptimill_kinematics::{JointMotion, Joints, Kinematics, PoseError};
use haptimill_math::Coordinate;
use haptimill_protocol::message::{Fault, MAX_AXES};

/// A rotor has locked when it has not moved for this time, microseconds: six cycles of a rotor that
/// oscillates at 120 Hz.
const LOCKED_US: u32 = 50_000;

/// All rotors must have locked after this time, microseconds.
const LOCKING_US: u32 = 1_000_000;

impl Machine {
    /// Whether every joint moves at most twice its following-error limit per second (0.6 mm/s for
    /// 0.3 mm).
    #[must_use]
    pub fn is_at_standstill(&self) -> bool {
        self.joints
            .iter()
            .zip(&self.config.joints)
            .all(|(joint, axis)| {
                // Motion of a motor without an encoder is not measured while its drive is off.
                axis.encoder.as_ref().is_none_or(|encoder| {
                    i64::from(joint.rate().0).abs() <= 2 * i64::from(encoder.following.0).abs()
                })
            })
    }

    /// Switches the drives on; the measured position becomes the commanded one.
    pub fn enable(&mut self) -> Result<(), PoseError> {
        let measured = self.measured;
        self.set_joints(&measured)?;
        self.enable_joints();
        Ok(())
    }

    fn enable_joints(&mut self) {
        let mut locks = false;
        for joint in &mut self.joints {
            joint.enable();
            locks |= joint.begin_lock();
        }
        self.locking = locks.then(|| LOCKING_US / u32::from(self.config.period_us.max(1)));
    }

    /// Switches the drives on with the joints commanded to their measured positions, which need not
    /// give a pose: a joint may be beyond its stroke.
    pub(super) fn switch_on(&mut self) {
        self.target = JointMotion {
            joints: self.measured,
            ..JointMotion::default()
        };
        self.enable_joints();
        self.settle();
    }

    /// Commands these joint positions, at rest. An error changes nothing.
    #[inline(never)]
    pub(super) fn set_joints(&mut self, joints: &Joints) -> Result<(), PoseError> {
        let pose = self.kinematics.forward(joints)?;
        self.kinematics.rate_utilisation(&pose, &pose, &[])?;
        self.motion.set_position(&pose);
        self.place_gantries(joints);
        self.reset_force();
        self.settle();
        Ok(())
    }

    /// Whether the rotors of step motors are still locking after enable; nothing may be moved.
    #[must_use]
    #[inline]
    pub const fn is_locking(&self) -> bool {
        self.locking.is_some()
    }

    /// One period in which the rotors of step motors lock. Each rotor moves to the nearest detent,
    /// by two full steps at most, and oscillates there; its encoder counts that. When all have
    /// locked, the measured position becomes the commanded one, and steps count from there. For a
    /// motor without an encoder the time elapses without a check.
    ///
    /// # Errors
    /// A rotor that moved farther than the following-error limit at standstill, or that does not
    /// come to rest in time.
    #[cold]
    #[inline(never)]
    pub fn lock(&mut self) -> Result<(), Fault> {
        let Some(left) = &mut self.locking else {
            return Ok(());
        };
        *left = left.saturating_sub(1);
        let expired = *left == 0;
        let settled_periods = LOCKED_US / u32::from(self.config.period_us.max(1));
        let mut locked = true;
        for (index, (joint, settings)) in
            self.joints.iter_mut().zip(&self.config.joints).enumerate()
        {
            let Some((by, quiet)) = joint.locking(settings) else {
                continue;
            };
            let moves = quiet < settled_periods;
            let following = settings.encoder.as_ref().map(|encoder| encoder.following);
            let too_far = following.is_some_and(|limit| by.magnitude() > limit.magnitude());
            if too_far || (expired && moves) {
                return Err(Fault::NotLocked {
                    joint: index as u8,
                    by: by.0,
                });
            }
            locked &= !moves;
        }
        if locked {
            self.locking = None;
            self.rebase().map_err(Fault::Pose)?;
        }
        Ok(())
    }

    /// Commands step motors to their measured positions. Torque drives keep their commanded
    /// positions, because a load would push them further otherwise.
    fn rebase(&mut self) -> Result<(), PoseError> {
        let mut joints = self.target.joints;
        for (coordinate, joint) in joints.0.iter_mut().zip(&mut self.joints) {
            if let Some(locked) = joint.end_lock() {
                *coordinate = locked;
            }
        }
        if self.is_moving_off() {
            self.target.joints = joints;
            self.switches.origin = joints;
            self.settle();
            return Ok(());
        }
        self.set_joints(&joints)
    }

    /// Switches the drives off.
    #[inline]
    pub fn disable(&mut self) {
        self.end_switch_motion();
        self.locking = None;
        for joint in &mut self.joints {
            joint.disable();
        }
    }

    pub(super) fn settle(&mut self) {
        self.joints.iter_mut().for_each(JointDrive::settle);
    }

    /// Begins homing: the search for the switches and index pulses. `known` is true where the
    /// machine is homed and its position kept.
    pub fn begin_homing(&mut self, known: bool) {
        self.rebase_on_compliance();
        self.rebase_on_correction();
        self.joints.iter_mut().for_each(|joint| joint.search(true));
        self.motion.begin_jog(false);
        self.begin_switches(known);
        self.homing = Homing::default();
        for (index, (joint, settings)) in self.joints.iter().zip(&self.config.joints).enumerate() {
            if settings.home == Home::Preset {
                let motor = joint.measurement().motor;
                self.homing
                    .place(index, settings.preset.0.wrapping_sub(motor.0));
            }
        }
    }

    /// Passes the index pulses of this period to homing.
    #[inline]
    pub fn check_index_pulses(&mut self) -> Result<(), Fault> {
        for (index, joint) in self.config.joints.iter().enumerate() {
            if let Some((_, coordinate)) = self.joints[index].measurement().index
                && let Some(encoder) = &joint.encoder
                && let Some(fault) = self.homing.index(index, encoder, coordinate)
            {
                return Err(fault);
            }
        }
        Ok(())
    }

    /// Corrects the positions of all joints. The commanded positions shift with the measured ones,
    /// so nothing moves: a drive that holds a load keeps its following error.
    pub fn apply_homing(
        &mut self,
        corrections: &[Coordinate; MAX_AXES],
        inputs: &Inputs,
    ) -> Result<(), PoseError> {
        let mut commanded = self.target.joints;
        for (index, joint) in self.joints.iter_mut().enumerate() {
            let coordinate = joint
                .measurement()
                .motor
                .0
                .wrapping_add(corrections[index].0);
            let counter = joint.counter(&inputs.joints[index]);
            let shift = joint.set_reference(counter, Coordinate(coordinate));
            commanded.0[index] = commanded.0[index].wrapping_add(shift);
            joint.search(false);
        }
        self.update_measured();
        self.set_joints(&commanded)
    }
}
