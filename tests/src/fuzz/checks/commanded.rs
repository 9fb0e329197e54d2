//! Commanded motion: rates, accelerations, soft limits and strokes by finite differences.

use super::super::bench::FuzzBench;
use super::super::units::{PERIOD, joint_unit, kind_unit};
use super::{CheckResult, Checks, PreviousPeriod, bounds, commanded_pose, gantry_partner};
use haptimill_firmware::config::{JointSettings, PoseAxis};
use haptimill_firmware::machine::Machine;
use haptimill_protocol::message::State;

/// What the checks of this file compare in a period.
struct CommandedMotion<'a> {
    bench: &'a FuzzBench,
    machine: &'a Machine,
    state: State,
    before: PreviousPeriod,
    /// The commanded position was set to the measured one, or was unknown before.
    initialised: bool,
    /// A reset or homing adds the compliant displacement to the commanded pose.
    rebased: bool,
    pose: [f64; 6],
    joints: [f64; 6],
}

const fn is_active(state: State) -> bool {
    matches!(state, State::Run | State::Hold | State::Jog | State::Homing)
}

/// Returns how far a value is outside a range.
const fn excess(value: f64, low: f64, high: f64) -> f64 {
    (value - high).max(low - value).max(0.0)
}

impl Checks {
    /// Checks the commanded pose and the commanded joints against those of the period before.
    pub(super) fn check_commanded(&mut self, bench: &FuzzBench) -> CheckResult {
        let controller = bench.controller();
        let Some(machine) = controller.machine() else {
            return Ok(());
        };
        if machine.axes() == 0 {
            return Ok(());
        }
        let state = controller.safety().state();
        let before = self.previous.clone();
        let motion = CommandedMotion {
            bench,
            machine,
            state,
            // Step motors take their commanded position when the last rotor has locked.
            initialised: !before.drives_on
                || (before.locking && !machine.is_locking())
                || !before.configured
                || !before.valid
                || (before.state == State::Homing && state != State::Homing),
            rebased: before.state == State::Fault || state == State::Homing,
            before,
            pose: commanded_pose(bench),
            joints: machine.target().joints.0.map(|place| f64::from(place.0)),
        };
        let limits = machine.config.pose.iter().take(machine.axes());
        if motion.initialised || motion.rebased {
            for (axis, limits) in limits.clone().enumerate() {
                let tolerance = f64::from(limits.kind.soft_limit_tolerance());
                let range =
                    f64::from(limits.low.0) - tolerance..=f64::from(limits.high.0) + tolerance;
                self.faults.outside_soft_limits[axis] = !range.contains(&motion.pose[axis]);
            }
        }
        if !controller.safety().drives_on() {
            return Ok(());
        }
        if !motion.initialised {
            for (axis, limits) in limits.enumerate() {
                motion.check_rate(axis, limits)?;
                motion.check_jog_acceleration(axis, limits)?;
                motion.check_soft_limits(axis, limits)?;
            }
            self.check_kinematics(&motion)?;
        }
        if !motion.initialised && !motion.rebased {
            for (joint, limits) in machine.config.joints.iter().enumerate() {
                self.check_joint_rate(&motion, joint, limits)?;
                motion.check_stroke(joint, limits)?;
                self.check_joint_derivative(&motion, joint)?;
            }
        }
        if machine.is_moving_off() && !motion.initialised && !self.foreign_configuration {
            motion.check_move_off(usize::from(machine.move_off_joint()))?;
        }
        Ok(())
    }

    /// Checks that the commanded joints close the rods of the simulator's geometry.
    fn check_kinematics(&mut self, motion: &CommandedMotion) -> CheckResult {
        // A joint that moves off its limit switch moves alone.
        let leaves = motion.machine.is_moving_off() || self.previous.is_moving_off;
        if self.foreign_configuration || leaves {
            return Ok(());
        }
        let pose = if motion.machine.force.is_some() {
            motion.machine.reference().pose
        } else {
            motion.machine.motion.commanded().pose
        };
        let residual = self
            .kinematics
            .residual(&pose.0.map(|place| f64::from(place.0)), &motion.joints);
        self.record_largest("residual mm", residual);
        if residual > bounds::RESIDUAL {
            violated!(
                motion.bench,
                "kinematics",
                "commanded joints miss the commanded pose by {residual} mm"
            );
        }
        Ok(())
    }

    fn check_joint_rate(
        &mut self,
        motion: &CommandedMotion,
        joint: usize,
        limits: &JointSettings,
    ) -> CheckResult {
        let max = f64::from(limits.rate.0) * PERIOD;
        let part = motion.joint_step(joint).abs() / max;
        let state = motion.state;
        if state == State::Jog {
            self.record_largest("joint rate in a jog, part of its limit", part);
        } else if state == State::Run {
            self.record_largest("joint rate in a job, part of its limit", part);
        }
        let in_job = matches!(state, State::Run | State::Hold);
        let bound = if in_job { 1.03125 } else { 1.0 };
        // A step is rounded to whole axis units.
        if part > bound + 1.5 / max && !self.foreign_configuration {
            let text = format!("joint {joint} commanded at {part:.3} of its limit in {state:?}");
            if in_job {
                violated!(motion.bench, "joint rate in a job", "{text}");
            }
            violated!(motion.bench, "joint rate in a jog", "{text}");
        }
        Ok(())
    }

    /// Checks that the commanded rate of a joint is the derivative of its commanded position.
    fn check_joint_derivative(&mut self, motion: &CommandedMotion, joint: usize) -> CheckResult {
        let active = is_active(motion.state) && is_active(motion.before.state);
        if !active || self.foreign_configuration {
            return Ok(());
        }
        let step = motion.joint_step(joint);
        let rate = f64::from(motion.machine.target().rates[joint].0);
        let mean = (rate + motion.before.joint_rates[joint]) / 2.0 * PERIOD;
        // The second motor of a gantry closes its distance from the first one at the touch rate,
        // without a ramp.
        let axis = &motion.bench.machine.config.joints[joint];
        let switch = axis.home.switch().filter(|_| axis.gantry.is_some());
        let closing = switch.map_or(0.0, |switch| f64::from(switch.touch_rate.0) * PERIOD / 2.0);
        let off = (mean - step).abs() - step.abs() / 50.0 - closing;
        self.record_largest("joint rate less derivative, axis units", off);
        if off > 40.0 {
            violated!(
                motion.bench,
                "joint derivative",
                "joint {joint} moved by {step}, by its rate {mean}, in {:?}",
                motion.state
            );
        }
        Ok(())
    }
}

impl CommandedMotion<'_> {
    fn joint_step(&self, joint: usize) -> f64 {
        let place = self.machine.target().joints.0[joint].0;
        f64::from(place.wrapping_sub(self.before.joints[joint] as i64 as i32))
    }

    /// Checks that a joint on its limit switch moves away from it, and that the others stay.
    fn check_move_off(&self, moving: usize) -> CheckResult {
        let joints = &self.bench.machine.config.joints;
        let inputs = &self.bench.rig.inputs().joints;
        let partner = gantry_partner(joints, moving);
        for joint in 0..joints.len() {
            let step = self.joint_step(joint);
            let is_wrong = if joint == moving {
                step < 0.0 && inputs[joint].limit_low || step > 0.0 && inputs[joint].limit_high
            } else {
                step != 0.0 && partner != Some(joint)
            };
            if is_wrong && self.state == State::Homing {
                violated!(
                    self.bench,
                    "off a limit switch",
                    "joint {joint} is commanded by {step}, joint {moving} is to move off"
                );
            }
        }
        Ok(())
    }

    fn check_rate(&self, axis: usize, limits: &PoseAxis) -> CheckResult {
        if self.rebased {
            return Ok(());
        }
        let mut step = self.pose[axis] - self.before.pose[axis];
        if limits.wraps() {
            step = f64::from((step as i64) as i32);
        }
        let state = self.state;
        let per_period = f64::from(limits.rate.0) * PERIOD;
        let factor = match state {
            State::Run | State::Hold => 1.55,
            _ => 1.002,
        };
        if step.abs() > per_period * factor + 3.0 {
            violated!(
                self.bench,
                "commanded rate",
                "axis {axis}: {step} of {per_period} axis units in a period in {state:?}"
            );
        }
        if !is_active(state) && !is_active(self.before.state) && step != 0.0 {
            violated!(
                self.bench,
                "moves at rest",
                "axis {axis} by {step} in {state:?}"
            );
        }
        Ok(())
    }

    fn check_jog_acceleration(&self, axis: usize, limits: &PoseAxis) -> CheckResult {
        if self.state != State::Jog || self.before.state != State::Jog {
            return Ok(());
        }
        let rate = f64::from(self.machine.motion.commanded().rates[axis].0);
        let change = (rate - self.before.rates[axis]).abs();
        let max = f64::from(limits.acceleration.0) * 256.0 * PERIOD;
        if change > max * 1.01 + 600.0 {
            violated!(
                self.bench,
                "jog acceleration",
                "axis {axis}: rate changed by {change} of {max} in a period"
            );
        }
        Ok(())
    }

    /// Checks that a pose inside the soft limits stays inside, and one outside moves no farther.
    fn check_soft_limits(&self, axis: usize, limits: &PoseAxis) -> CheckResult {
        let (low, high) = (f64::from(limits.low.0), f64::from(limits.high.0));
        let outside = excess(self.pose[axis], low, high);
        if outside <= excess(self.before.pose[axis], low, high) {
            return Ok(());
        }
        let tolerance = f64::from(limits.kind.soft_limit_tolerance());
        let state = self.state;
        let allowed = match state {
            // A cubic between two setpoints may leave the limits; the fault brakes then.
            State::Run | State::Hold => 10.0 * kind_unit(limits.kind) + tolerance,
            State::Homing => f64::INFINITY,
            State::Jog => 2.0,
            _ => tolerance + 2.0,
        };
        if outside > allowed {
            violated!(
                self.bench,
                "soft limit",
                "axis {axis} commanded {} beyond, in {state:?}",
                outside / kind_unit(limits.kind)
            );
        }
        if state == State::Run
            && self.before.state == State::Run
            && outside > tolerance + 2.0
            && self.bench.controller().safety().pending().is_none()
        {
            violated!(
                self.bench,
                "soft limit",
                "axis {axis} {} beyond, and nothing stops it",
                outside / kind_unit(limits.kind)
            );
        }
        Ok(())
    }

    fn check_stroke(&self, joint: usize, limits: &JointSettings) -> CheckResult {
        let (low, high) = (f64::from(limits.low.0), f64::from(limits.high.0));
        let beyond = |place: f64| excess(place, low, high) / joint_unit(limits);
        let outside = beyond(self.joints[joint]);
        if outside > 0.001 && outside > beyond(self.before.joints[joint]) {
            violated!(
                self.bench,
                "stroke",
                "joint {joint} commanded {outside} beyond its stroke"
            );
        }
        Ok(())
    }
}
