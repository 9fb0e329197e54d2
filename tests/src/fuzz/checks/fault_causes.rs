//! Events and faults: no state change is lost, and each fault has a cause.

use super::super::bench::FuzzBench;
use super::super::episode::{Theme, joint_of};
use super::super::units::{self, joint_unit};
use super::{CheckResult, Checks, bounds, gantry_partner, jump_threshold};
use haptimill_firmware::config::{AxisKind, Drive};
use haptimill_hil_sim::fault::{FaultKind, Switch};
use haptimill_protocol::force::ForceProblem;
use haptimill_protocol::message::{Event, Fault, HomingProblem, PoseError, State};

/// A cause of faults that is not an injected device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// Missed control periods.
    MissedPeriods,
    /// A silent host, or a line with errors.
    HostSilent,
    /// The emergency stop circuit.
    EmergencyStop,
    /// A wall or workpiece at the tool.
    Contact,
    /// A master moves the tool.
    MasterMoves,
    /// The force sensor was fitted anew and not tared since.
    SensorNotTared,
    /// A digital input was forced.
    Input,
}

/// What else may explain a fault.
#[derive(Debug, Default)]
pub(super) struct FaultEvidence {
    /// The last period that the controller missed.
    missed_at: Option<u64>,
    /// True motor positions of the period before.
    motors: Option<[f64; 6]>,
    /// Largest true motion of each joint in a period since homing, per [`jump_threshold`].
    pub fastest_motion: [f64; 6],
    /// The commanded pose was initialised beyond a soft limit of this coordinate.
    pub outside_soft_limits: [bool; 6],
    /// Commanded joints when the rotors of the step motors had locked.
    pub locked_at: [f64; 6],
    /// The state that the last state event reported.
    pub reported_state: Option<State>,
    /// State events that do not continue the one before.
    reporting_gaps: u32,
}

impl Checks {
    /// Records missed periods and the true motion of the joints.
    pub(super) fn record_evidence(&mut self, bench: &FuzzBench, ticked: bool) {
        if !ticked || bench.rig.inputs().missed > 0 {
            self.faults.missed_at = Some(bench.period);
        }
        let before = self.faults.motors.replace(bench.latched.motor);
        let (Some(before), Some(machine)) = (before, bench.controller().machine()) else {
            return;
        };
        for (joint, limits) in machine.config.joints.iter().enumerate() {
            let threshold = jump_threshold(limits) / joint_unit(limits);
            let part = (bench.latched.motor[joint] - before[joint]).abs() / threshold;
            self.faults.fastest_motion[joint] = self.faults.fastest_motion[joint].max(part);
        }
    }

    /// Checks that no state change is lost, and the cause of each fault.
    pub(super) fn check_events(&mut self, bench: &mut FuzzBench) -> CheckResult {
        for (period, event) in core::mem::take(&mut bench.events) {
            match &event {
                Event::State { from, to, .. } => {
                    // On a slow line the controller drops the oldest events and counts them.
                    let lost = bench.controller().safety().events_lost();
                    let gap = self.faults.reported_state.is_some_and(|last| last != *from);
                    self.faults.reporting_gaps += u32::from(gap);
                    if self.theme.has_clean_line()
                        && !self.causes.contains(&Cause::HostSilent)
                        && let Some(last) = self.faults.reported_state
                        && last != *from
                        && self.faults.reporting_gaps > lost
                    {
                        violated!(
                            bench,
                            "lost event",
                            "state {from:?} -> {to:?} was reported after one that ended in {last:?}"
                        );
                    }
                    self.faults.reported_state = Some(*to);
                }
                Event::Fault(Fault::Internal { line }) => {
                    violated!(bench, "internal", "a defect in line {line}");
                }
                Event::Fault(fault) => {
                    self.check_fault_cause(bench, fault)?;
                }
                _ => {}
            }
            if period > bench.rig.inputs().period {
                violated!(bench, "event", "{event:?} is reported for period {period}");
            }
        }
        Ok(())
    }

    /// Checks that a latched fault has a cause.
    fn check_fault_cause(&self, bench: &FuzzBench, fault: &Fault) -> CheckResult {
        if self.foreign_configuration {
            return Ok(());
        }
        let mut caused = match fault {
            Fault::LostHost { .. } => {
                self.causes.contains(&Cause::HostSilent)
                    || bench.corrupted
                    || bench.session_start + 5000 > bench.period
                    || bench.is_noisy()
            }
            Fault::MissedPeriods { .. } => self.causes.contains(&Cause::MissedPeriods),
            // Without commands step motors stop at once, and their rotors swing.
            Fault::StepsLost { joint, .. } => {
                let joint = usize::from(*joint);
                self.faults
                    .missed_at
                    .is_some_and(|missed| bench.period < missed + 500)
                    || self.leaves_dead_point(bench, joint)
            }
            // A joint was pushed faster than the threshold of a counter jump.
            Fault::CounterJump { joint, .. } => {
                self.faults.fastest_motion[usize::from(*joint)] > 0.98
            }
            Fault::Stroke { .. } | Fault::LimitSwitch { .. } => {
                self.causes.contains(&Cause::MissedPeriods)
            }
            // A jog may move the tool onto the probe, the tool setter or the block.
            Fault::ProbeContact { input } => {
                self.causes.contains(&Cause::Input) || is_wire_active(bench, usize::from(*input))
            }
            // A motor without friction runs away before its counts show the direction.
            Fault::FollowingError { joint, .. } if self.other_machine => {
                self.injected.iter().any(|kind| {
                    matches!(kind, FaultKind::EncoderSwapped { .. })
                        && kind.joint().and_then(joint_of) == Some(usize::from(*joint))
                })
            }
            // The cubic of a job may leave what the joints can reach between two setpoints.
            Fault::Pose(_) if self.other_machine => self.previous.state == State::Run,
            Fault::Master(_) => self.causes.contains(&Cause::MasterMoves),
            Fault::Force(ForceProblem::Drift { .. })
                if self.causes.contains(&Cause::SensorNotTared) =>
            {
                true
            }
            Fault::Force(ForceProblem::Drift { component, .. })
                if self.causes.contains(&Cause::Contact)
                    && is_soft_contact_drift(bench, usize::from(*component)) =>
            {
                true
            }
            Fault::Force(_) => self.causes.contains(&Cause::Contact) && !self.theme.is_healthy(),
            // So are strokes.
            Fault::Pose(PoseError::OutOfStroke { joint, .. }) => {
                self.leaves_stroke(bench, usize::from(*joint))
            }
            // A search that meets the end of the workspace on both sides.
            Fault::Homing {
                problem: HomingProblem::Workspace,
                ..
            } => self.is_near_workspace_end(bench),
            // Soft limits of a setpoint are checked at its end only: the cubic may leave them.
            // A machine that was pushed with its drives off may stand beyond a soft limit.
            Fault::SoftLimit { coordinate } => {
                self.job.altered
                    || self.theme == Theme::AnyCommand
                    || self.faults.outside_soft_limits[usize::from(*coordinate)]
            }
            _ => false,
        };
        // A controller cannot distinguish every cause: any injected fault may explain this one.
        caused |= self.injected.iter().any(|kind| explains(kind, fault))
            || self.explains_gantry(bench, fault);
        if caused {
            return Ok(());
        }
        if self.injected.is_empty() {
            violated!(
                bench,
                "false alarm",
                "{fault:?} without a cause; causes {:?}",
                self.causes
            );
        }
        violated!(
            bench,
            "fault class",
            "{fault:?} is not among the effects of {:?}",
            self.injected
        );
    }

    /// Returns whether a fault is the racking or the homing of a gantry with an injected fault of
    /// one of its two motors, or of a switch of one of them.
    fn explains_gantry(&self, bench: &FuzzBench, fault: &Fault) -> bool {
        let (Fault::Racking { joint, .. } | Fault::Homing { joint, .. }, Some(machine)) =
            (fault, bench.controller().machine())
        else {
            return false;
        };
        let joint = usize::from(*joint);
        let Some(partner) = gantry_partner(&machine.config.joints, joint) else {
            return false;
        };
        self.injected.iter().any(|kind| {
            let injected = kind.joint().and_then(joint_of);
            injected == Some(joint) || injected == Some(partner)
        })
    }

    /// Returns whether the planned path leaves the stroke of a joint between two setpoints whose
    /// joints are within it.
    fn leaves_stroke(&self, bench: &FuzzBench, joint: usize) -> bool {
        let Some(machine) = bench.controller().machine() else {
            return false;
        };
        let Some(limits) = machine.config.joints.get(joint) else {
            return false;
        };
        let unit = joint_unit(limits);
        let [low, high] = [limits.low, limits.high].map(|end| f64::from(end.0) / unit);
        let beyond = |pose: &[f64; 6]| {
            let place = self.kinematics.joint(pose, joint);
            place.map_or(0.0, |place| (low - place).max(place - high))
        };
        self.job.leaves_between(beyond, bounds::ARITHMETIC)
    }

    /// Returns whether a pose within 1 mm or 3 degrees of the commanded one, in one coordinate, has
    /// a joint beyond its stroke or is out of reach.
    fn is_near_workspace_end(&self, bench: &FuzzBench) -> bool {
        let Some(machine) = bench.controller().machine() else {
            return false;
        };
        let beyond = |pose: &[f64; 6]| {
            machine
                .config
                .joints
                .iter()
                .enumerate()
                .any(|(joint, limits)| {
                    let unit = joint_unit(limits);
                    let [low, high] = [limits.low, limits.high].map(|end| f64::from(end.0) / unit);
                    let place = self.kinematics.joint(pose, joint);
                    place.is_none_or(|place| !(low..high).contains(&place))
                })
        };
        let pose = self.previous.pose;
        machine
            .config
            .pose
            .iter()
            .enumerate()
            .any(|(axis, limits)| {
                let step = match limits.kind {
                    AxisKind::Linear => units::MM,
                    kind => 3.0 * units::kind_unit(kind),
                };
                [-step, step].iter().any(|step| {
                    let mut near = pose;
                    near[axis] += step;
                    beyond(&near)
                })
            })
    }

    /// Returns whether a rotor may have been locked at the dead point of its detent.
    ///
    /// Friction may hold a rotor two full steps from its detent, where its torque is 0. Such a
    /// rotor looks locked; the first motion moves it into the detent. So steps may be lost until
    /// the joint was commanded by twice the limit.
    fn leaves_dead_point(&self, bench: &FuzzBench, joint: usize) -> bool {
        let Some(machine) = bench.controller().machine() else {
            return false;
        };
        let Some(Drive::Steps { lost, .. }) = machine
            .config
            .joints
            .get(joint)
            .map(|limits| limits.drive.clone())
        else {
            return false;
        };
        let way = self.previous.joints[joint] - self.faults.locked_at[joint];
        // A rotor that moves without a command had not locked.
        (1.0..2.0 * f64::from(lost.0)).contains(&way.abs())
    }
}

/// Returns whether the wire of a named input has its active level.
fn is_wire_active(bench: &FuzzBench, input: usize) -> bool {
    let input = bench.machine.config.io.inputs.get(input);
    input.is_some_and(|input| {
        (bench.rig.inputs().digital >> input.channel & 1 == 1) != input.inverted
    })
}

/// Returns whether a contact of this component can be taken for drift while the spindle is off.
///
/// A force below half of f_d is not a contact yet (`ForceControl::unloaded`). Its mean over 0.1 s
/// can pass the limit of the drift only if that limit is smaller.
fn is_soft_contact_drift(bench: &FuzzBench, component: usize) -> bool {
    let machine = bench.controller().machine();
    let Some(force) = machine.and_then(|machine| machine.force.as_ref()) else {
        return false;
    };
    let drift = force.conditioner().sensor().drift;
    let settings = force.settings(component);
    settings.is_some_and(|settings| settings.setpoint.0 / 2 > drift.0)
}

/// Returns whether a fault is among the effects of an injected one.
fn explains(kind: &FaultKind, fault: &Fault) -> bool {
    use FaultKind as K;
    let joint = kind.joint().and_then(joint_of);
    let of = |other: &u8| Some(usize::from(*other)) == joint;
    let counter = match fault {
        Fault::EncoderStuck { joint }
        | Fault::EncoderReversed { joint }
        | Fault::EncoderIllegal { joint, .. }
        | Fault::CounterJump { joint, .. }
        | Fault::EncoderSlip { joint, .. }
        | Fault::StepsLost { joint, .. }
        | Fault::Homing { joint, .. } => of(joint),
        _ => false,
    };
    let following = matches!(fault, Fault::FollowingError { joint, .. } if of(joint));
    let stroke = matches!(fault, Fault::Stroke { joint, .. } if of(joint));
    let homing = matches!(fault, Fault::Homing { joint, .. } if of(joint));
    let switch = matches!(fault, Fault::LimitSwitch { joint } if of(joint));
    // The pose shows the motion of a joint that runs away.
    let pose = matches!(fault, Fault::Pose(_));
    match kind {
        K::EncoderStuck { .. } => {
            counter || following || stroke || pose || matches!(fault, Fault::LimitSwitch { .. })
        }
        K::EncoderSwapped { .. } => counter,
        K::EncoderSlip { .. } => counter || following || stroke || pose,
        K::EncoderNoise { .. } => counter || following,
        K::IndexMissing { .. } => matches!(fault, Fault::Homing { joint, .. } if of(joint)),
        K::DriveTripped { .. } => matches!(fault, Fault::Drive { joint, .. } if of(joint)),
        K::DriveDead { .. }
        | K::DriveWeak { .. }
        | K::DriveReversed { .. }
        | K::JointJammed { .. }
        | K::Push { .. } => {
            let plausible = !matches!(
                fault,
                Fault::EncoderIllegal { .. }
                    | Fault::CounterJump { .. }
                    | Fault::EncoderSlip { .. }
            );
            let unlocked = matches!(fault, Fault::NotLocked { joint, .. } if of(joint));
            (counter && plausible) || following || stroke || switch || pose || unlocked
        }
        K::SwitchStuck {
            switch: stuck,
            active,
            ..
        } => (switch && *active && *stuck != Switch::Home) || homing,
        K::SwitchInverted { .. } | K::SwitchMissing { .. } | K::SwitchBounces { .. } => {
            switch || homing || stroke || pose
        }
        K::SensorStuck { .. }
        | K::SensorDropped { .. }
        | K::SensorReversed { .. }
        | K::SensorDrift { .. }
        | K::SensorSaturated { .. }
        | K::SpindleStalled => matches!(fault, Fault::Force(_)),
        K::HapticArm(_) => matches!(fault, Fault::Master(_)),
        _ => false,
    }
}
