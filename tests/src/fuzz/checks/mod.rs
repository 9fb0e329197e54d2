//! The checks of every control period, against the simulated machine's truth and against f64.

#![allow(
    clippy::needless_range_loop,
    reason = "an axis is an index of several lists at once"
)]

/// Returns a violation of the named check from the present function.
macro_rules! violated {
    ($bench:expr, $check:literal, $($text:tt)*) => {
        return Err($crate::fuzz::checks::Violation {
            check: $check,
            text: format!($($text)*),
            period: $bench.period,
        })
    };
}

mod answers;
pub mod bounds;
mod commanded;
mod compliance;
mod fault_causes;
mod following;
mod haptics;
mod named_io;
mod outputs;
mod position;
mod refusal;
mod setpoints;
mod state_machine;
mod telemetry;
mod timeouts;
mod tool;

pub use fault_causes::Cause;
pub use refusal::{difference, fingerprint, is_at_standstill};

use super::bench::FuzzBench;
use super::episode::{Episode, Theme};
use super::reference::{PlannedJob, ReferenceKinematics};
use super::units::{PERIOD, joint_unit};
use haptimill_firmware::config::JointSettings;
use haptimill_firmware::io::JointInputs;
use haptimill_hil_sim::fault::FaultKind;
use haptimill_protocol::message::State;

/// A check that failed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Violation {
    /// Name of the check.
    pub check: &'static str,
    /// What was measured.
    pub text: String,
    /// The period in which it failed.
    pub period: u64,
}

type CheckResult = Result<(), Violation>;

/// State of the controller in the period before.
#[derive(Debug, Clone, Default)]
struct PreviousPeriod {
    state: State,
    drives_on: bool,
    homed: bool,
    configured: bool,
    /// False after a missed period.
    valid: bool,
    /// The rotors of the step motors are locking.
    locking: bool,
    /// A joint moves off its limit switch.
    is_moving_off: bool,
    /// The limit switches that were active when the drives were off last, two bits per joint.
    limits_with_drives_off: [u8; 6],
    pose: [f64; 6],
    rates: [f64; 6],
    joints: [f64; 6],
    joint_rates: [f64; 6],
    haptic_force: [f64; 3],
    index_pulses: [u8; 6],
}

/// The checks, with what they remember of earlier periods.
pub struct Checks {
    /// The job that is checked against its setpoints.
    pub job: PlannedJob,
    /// The configuration is not that of the plant.
    pub foreign_configuration: bool,
    /// Faults that were injected since the machine was homed.
    pub injected: Vec<FaultKind>,
    /// Causes of faults that are not injected devices.
    pub causes: Vec<Cause>,
    /// Largest values of what is compared with a bound, for docs/fuzzing.md.
    pub largest: Vec<(&'static str, f64)>,
    theme: Theme,
    /// The machine is not one of the H-4 machines: other bounds apply.
    other_machine: bool,
    previous: PreviousPeriod,
    kinematics: ReferenceKinematics,
    jog_epoch: answers::JogEpoch,
    faults: fault_causes::FaultEvidence,
    timeouts: timeouts::Timeouts,
    position: position::EncoderRecord,
    following: following::FollowingRecord,
    compliance: compliance::ComplianceRecord,
    telemetry_samples: telemetry::Samples,
    /// Periods of motion since the armed probe is in contact.
    contact_periods: u32,
    /// The tool clamp is off, was off in this job, or is an unknown output.
    opened_clamp: bool,
}

/// Returns the motion in one period that the firmware takes for a counter jump, in axis units.
///
/// It is the limit of the following error at standstill plus ten times the maximum rate.
fn jump_threshold(limits: &JointSettings) -> f64 {
    let following = limits
        .encoder
        .as_ref()
        .map_or(0, |encoder| encoder.following.0);
    f64::from(following) + f64::from(limits.rate.0) * 10.0 * PERIOD
}

/// Returns the other motor of the gantry of a joint.
fn gantry_partner(joints: &[JointSettings], joint: usize) -> Option<usize> {
    let first = |joint: usize| {
        let gantry = joints.get(joint)?.gantry.as_ref();
        gantry.map(|gantry| usize::from(gantry.of))
    };
    first(joint).or_else(|| (0..joints.len()).find(|other| first(*other) == Some(joint)))
}

/// Returns the active limit switches of each joint, one bit for each end.
fn limits(axes: &[JointInputs; 6]) -> [u8; 6] {
    axes.each_ref()
        .map(|joint| u8::from(joint.limit_low) | u8::from(joint.limit_high) << 1)
}

/// Returns the commanded pose in axis units.
fn commanded_pose(bench: &FuzzBench) -> [f64; 6] {
    bench.controller().machine().map_or([0.0; 6], |machine| {
        machine
            .motion
            .commanded()
            .pose
            .0
            .map(|place| f64::from(place.0))
    })
}

impl Checks {
    /// Creates the checks of an episode.
    #[must_use]
    pub fn new(episode: &Episode, bench: &FuzzBench) -> Self {
        Self {
            job: PlannedJob::default(),
            foreign_configuration: false,
            injected: vec![],
            causes: vec![],
            largest: vec![],
            theme: episode.theme,
            other_machine: episode.kind.file().is_some(),
            previous: PreviousPeriod::default(),
            kinematics: ReferenceKinematics::new(&bench.plant),
            jog_epoch: answers::JogEpoch::default(),
            faults: fault_causes::FaultEvidence::default(),
            timeouts: timeouts::Timeouts::default(),
            position: position::EncoderRecord::default(),
            following: following::FollowingRecord::default(),
            compliance: compliance::ComplianceRecord::default(),
            telemetry_samples: telemetry::Samples::default(),
            contact_periods: 0,
            opened_clamp: false,
        }
    }

    fn record_largest(&mut self, name: &'static str, value: f64) {
        match self.largest.iter_mut().find(|(other, _)| *other == name) {
            Some((_, largest)) => *largest = largest.max(value),
            None => self.largest.push((name, value)),
        }
    }

    /// Records a fault that is injected into a device.
    pub fn record_fault(&mut self, kind: &FaultKind) {
        if kind.input().is_some() {
            self.causes.push(Cause::Input);
            return;
        }
        self.position.record_fault(kind, &self.previous);
        self.injected.push(kind.clone());
    }

    /// Returns whether no fault was injected and the configuration is the plant's.
    fn is_fault_free(&self, bench: &FuzzBench) -> bool {
        self.injected.is_empty() && bench.faults.is_empty() && !self.foreign_configuration
    }

    /// Checks the period that has just passed.
    ///
    /// # Errors
    /// The first check that failed.
    pub fn check_period(&mut self, bench: &mut FuzzBench, ticked: bool) -> CheckResult {
        self.record_evidence(bench, ticked);
        self.check_answers(bench)?;
        self.check_events(bench)?;
        if !ticked {
            self.previous.valid = false;
            return Ok(());
        }
        self.check_outputs(bench)?;
        self.check_named_io(bench)?;
        self.check_transition(bench)?;
        self.check_timeouts(bench)?;
        self.check_commanded(bench)?;
        self.check_setpoints(bench)?;
        self.check_joints(bench)?;
        self.check_tool(bench)?;
        self.check_compliance(bench)?;
        self.check_haptics(bench)?;
        self.check_telemetry(bench)?;
        self.remember(bench);
        Ok(())
    }

    /// Checks the measured and the true position of each joint.
    fn check_joints(&mut self, bench: &FuzzBench) -> CheckResult {
        let Some(machine) = bench.controller().machine() else {
            return Ok(());
        };
        if machine.axes() == 0 || self.foreign_configuration {
            return Ok(());
        }
        self.count_standstill(bench);
        for (joint, reading) in machine.joints().enumerate() {
            let unit = joint_unit(&machine.config.joints[joint]);
            self.count_motion(joint, &machine.config.joints[joint]);
            self.check_position(bench, joint, f64::from(reading.measured.0) / unit)?;
            self.check_reported_error(bench, joint, reading.measured.0)?;
            self.check_following(bench, joint, f64::from(reading.commanded.0) / unit)?;
        }
        Ok(())
    }

    /// Keeps the state of this period for the next one.
    fn remember(&mut self, bench: &FuzzBench) {
        let controller = bench.controller();
        let safety = controller.safety();
        let machine = controller.machine();
        let mut now = PreviousPeriod {
            state: safety.state(),
            drives_on: safety.drives_on(),
            homed: safety.homed(),
            configured: machine.is_some(),
            valid: true,
            locking: machine.is_some_and(|machine| machine.is_locking()),
            is_moving_off: machine.is_some_and(|machine| machine.is_moving_off()),
            limits_with_drives_off: self.previous.limits_with_drives_off,
            pose: commanded_pose(bench),
            haptic_force: self.previous.haptic_force,
            ..PreviousPeriod::default()
        };
        for (slot, axis) in now.index_pulses.iter_mut().zip(&bench.rig.inputs().joints) {
            *slot = axis.index_pulses;
        }
        if !now.drives_on {
            now.limits_with_drives_off = limits(&bench.rig.inputs().joints);
        }
        if let Some(machine) = machine {
            let target = machine.target();
            if self.previous.locking && !now.locking {
                self.faults.locked_at = target.joints.0.map(|place| f64::from(place.0));
            }
            for axis in 0..machine.axes() {
                now.rates[axis] = f64::from(machine.motion.commanded().rates[axis].0);
            }
            // The second motors of gantries are joints too.
            for joint in 0..machine.joint_count() {
                now.joints[joint] = f64::from(target.joints.0[joint].0);
                now.joint_rates[joint] = f64::from(target.rates[joint].0);
            }
        }
        let just_homed = self.previous.state == State::Homing && now.state == State::Idle;
        self.following.homed_and_on = now.drives_on && (self.following.homed_and_on || just_homed);
        if now.homed && !self.previous.homed && bench.faults.is_empty() {
            // The references are new; errors of the counters from before the homing have ended.
            self.position.end_of_errors();
            self.faults.fastest_motion = [0.0; 6];
            self.injected.retain(|kind| {
                self.position.has_homing_fault(kind)
                    || !matches!(
                        kind,
                        FaultKind::EncoderSlip { .. } | FaultKind::EncoderNoise { .. }
                    )
            });
        }
        if now.state != State::Homing {
            self.position.end_of_homing();
        }
        self.previous = now;
    }

    /// Forgets the causes that ended: no fault is injected, and the machine was homed.
    pub fn recovered(&mut self, bench: &FuzzBench) {
        if bench.faults.is_empty() && self.previous.homed {
            self.causes.retain(|cause| {
                matches!(
                    cause,
                    Cause::Contact | Cause::MasterMoves | Cause::SensorNotTared
                )
            });
        }
    }
}
