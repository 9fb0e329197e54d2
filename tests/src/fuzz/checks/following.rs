//! Following error: runaways, unreported errors, and the lag of a healthy machine.

use super::super::bench::FuzzBench;
use super::super::episode::joint_of;
use super::super::units::{PERIOD, class, joint_unit};
use super::position::is_position_known;
use super::{Cause, CheckResult, Checks, bounds, gantry_partner};
use haptimill_firmware::config::JointSettings;
use haptimill_protocol::message::State;

/// Periods for which the conditions of this file have lasted.
#[derive(Debug, Default)]
pub(super) struct FollowingRecord {
    /// The drives have been on since homing, so the flanks of the screws are known.
    pub homed_and_on: bool,
    /// Periods at standstill.
    pub standstill: u32,
    /// Periods of motion since the joint was last faster than [`bounds::KNEE`].
    slow_motion: [u32; 6],
    /// Commanded travel of each joint since it last reversed, in mm or degrees, with its sign.
    travel: [f64; 6],
    /// Rate of each joint in the period before, mm/s or degrees/s.
    rates: [f64; 6],
    /// The joint was decelerated so hard, since it last reversed, that its slide may have coasted
    /// across the backlash.
    coasted: [bool; 6],
    /// Periods with a following error above its limit, by joint.
    unreported: [u32; 6],
    /// Periods far from the target, by joint.
    runaway: [u32; 6],
}

/// Returns the distance of two positions of a joint, in mm or degrees.
pub(super) fn distance(limits: &JointSettings, a: f64, b: f64) -> f64 {
    let off = (a - b).abs();
    if limits.wraps() {
        off.rem_euclid(360.0).min((-off).rem_euclid(360.0))
    } else {
        off
    }
}

impl Checks {
    /// Counts the periods at standstill.
    pub(super) fn count_standstill(&mut self, bench: &FuzzBench) {
        let controller = bench.controller();
        let safety = controller.safety();
        let inactive = controller
            .machine()
            .and_then(|machine| machine.force.as_ref())
            .is_none_or(|force| force.is_inactive());
        let still = safety.drives_on() && safety.state() == State::Idle && inactive;
        self.following.standstill = if still {
            self.following.standstill + 1
        } else {
            0
        };
    }

    /// Counts the periods of motion in which friction is not compensated in full, and the travel
    /// since the last reversal.
    pub(super) fn count_motion(&mut self, joint: usize, limits: &JointSettings) {
        let rate = self.previous.joint_rates[joint] / joint_unit(limits);
        let travel = &mut self.following.travel[joint];
        if rate * *travel < 0.0 {
            *travel = 0.0;
            self.following.coasted[joint] = false;
        }
        *travel += rate * PERIOD;
        let before = core::mem::replace(&mut self.following.rates[joint], rate);
        let braking = (before.abs() - rate.abs()) / PERIOD;
        self.following.coasted[joint] |= braking > bounds::COASTING;
        let rate = rate.abs();
        let slow = &mut self.following.slow_motion[joint];
        if rate > bounds::KNEE {
            *slow = 0;
        } else if rate > 0.0 {
            *slow = slow.saturating_add(1);
        }
    }

    /// Checks that a following error above its limit has latched a fault.
    pub(super) fn check_reported_error(
        &mut self,
        bench: &FuzzBench,
        joint: usize,
        measured: i32,
    ) -> CheckResult {
        let controller = bench.controller();
        let (safety, Some(machine)) = (controller.safety(), controller.machine()) else {
            return Ok(());
        };
        let unit = joint_unit(&machine.config.joints[joint]);
        let Some(limits) = &machine.config.joints[joint].encoder else {
            return Ok(());
        };
        // The firmware compares the present measurement with the command of the period before.
        let commanded = self.previous.joints[joint] as i64 as i32;
        let error = f64::from(measured.wrapping_sub(commanded)).abs();
        let rate = self.previous.joint_rates[joint].abs();
        let lag = rate * f64::from(limits.following_lag) / 65_536.0;
        let limit = (f64::from(limits.following.0) + lag) * bounds::REPORTED + 4.0;
        let unreported = &mut self.following.unreported[joint];
        let above = safety.drives_on() && self.previous.drives_on && error > limit;
        *unreported = if above { *unreported + 1 } else { 0 };
        if *unreported > 3 && safety.state() != State::Fault {
            violated!(
                bench,
                "following error not reported",
                "joint {joint} is {:.4} off, limit {:.4}, in {:?}",
                error / unit,
                limit / unit,
                safety.state()
            );
        }
        Ok(())
    }

    /// Checks the true position of a joint against its target, in mm or degrees.
    pub(super) fn check_following(
        &mut self,
        bench: &FuzzBench,
        joint: usize,
        target: f64,
    ) -> CheckResult {
        let safety = bench.controller().safety();
        if !safety.drives_on() || !self.previous.drives_on {
            self.following.runaway[joint] = 0;
            return Ok(());
        }
        let known = is_position_known(bench);
        let Some(machine) = bench.controller().machine() else {
            return Ok(());
        };
        let limits = &machine.config.joints[joint];
        let far = distance(limits, bench.rig.truth().joints[joint], target);
        // Without an encoder nothing measures what a push or a reversed drive does to the joint, or
        // to the other motor of its gantry.
        let partner = gantry_partner(&machine.config.joints, joint);
        let of_joint = self.injected.iter().any(|kind| {
            let injected = kind.joint().and_then(joint_of);
            injected.is_some() && (injected == Some(joint) || injected == partner)
        });
        let seen = limits.encoder.is_some() || !of_joint;
        let runaway = &mut self.following.runaway[joint];
        let away = known && seen && far > bounds::RUNAWAY[class(limits)];
        *runaway = if away { *runaway + 1 } else { 0 };
        if *runaway > 50 {
            violated!(
                bench,
                "runaway",
                "joint {joint} is {far:.3} from its target for {runaway} periods in {:?}; \
                 injected were {:?}",
                safety.state(),
                self.injected
            );
        }
        let undisturbed = self.is_fault_free(bench)
            && self.causes.iter().all(|cause| *cause == Cause::HostSilent);
        if known && undisturbed && self.previous.homed {
            self.check_healthy_joint(bench, joint, limits, far)?;
        }
        Ok(())
    }

    /// Checks lag, standstill and stroke of a joint of a healthy machine.
    fn check_healthy_joint(
        &mut self,
        bench: &FuzzBench,
        joint: usize,
        limits: &JointSettings,
        far: f64,
    ) -> CheckResult {
        let unit = joint_unit(limits);
        let rate = self.previous.joint_rates[joint].abs() / unit;
        let beyond = far - 0.002 * rate;
        let class = class(limits);
        self.record_largest(["following mm", "following deg"][class], beyond);
        if beyond > bounds::FOLLOWING[class] {
            violated!(
                bench,
                "following",
                "joint {joint} is {far:.4} from its target at {rate:.3}/s in {:?}",
                bench.controller().safety().state()
            );
        }
        if self.following.standstill > 5000 && self.following.homed_and_on {
            self.record_largest(["rest mm", "rest deg"][class], far);
            let slow = self.following.slow_motion[joint] > bounds::LASTING;
            let crossed = self.following.travel[joint].abs() > bounds::CROSSING
                && !self.following.coasted[joint];
            let max = match class {
                _ if self.other_machine => bounds::OTHER_REST,
                0 if slow => bounds::REST_SLOW,
                0 if !crossed => bounds::REST_UNKNOWN_FLANK,
                class => bounds::REST[class],
            };
            if far > max {
                violated!(
                    bench,
                    "rest",
                    "joint {joint} is {far:.4} from its target at standstill"
                );
            }
        }
        if limits.wraps() {
            return Ok(());
        }
        let (low, high) = (
            f64::from(limits.low.0) / unit,
            f64::from(limits.high.0) / unit,
        );
        let place = bench.rig.truth().joints[joint];
        if place > high + 0.5 || place < low - 0.5 {
            violated!(bench, "stroke", "joint {joint} is at {place}");
        }
        Ok(())
    }
}
