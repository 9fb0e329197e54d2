//! Position truth: measured positions against the simulated machine.

use super::super::bench::FuzzBench;
use super::super::episode::{JOINTS, joint_of};
use super::super::units::{class, joint_unit};
use super::following::distance;
use super::{Cause, CheckResult, Checks, PERIOD, PreviousPeriod, bounds, jump_threshold};
use haptimill_firmware::config::{Drive, EncoderSettings, JointSettings};
use haptimill_hil_sim::fault::{Channel, FaultKind};
use haptimill_protocol::message::State;

/// What may be wrong with the encoder of a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum EncoderDefect {
    /// Nothing.
    None,
    /// One fault of its encoder is all that has happened to the joint.
    Single,
    /// The counter gained or lost counts one by one, or slipped with the drives off.
    ///
    /// Only index pulses can reveal a slip that is smaller than a counter jump.
    Uncounted,
    /// More has happened to the joint.
    Several,
    /// Both channels were dead.
    Dead,
}

/// Injected encoder faults of each joint, and the position errors since.
#[derive(Debug, Default)]
pub(super) struct EncoderRecord {
    /// A fault was injected into the encoder since it was last known to be right.
    suspect: [bool; 6],
    /// Index pulses since the fault was injected.
    index_pulses: [u32; 6],
    /// The encoder slipped while the drives were off.
    slipped_off: [bool; 6],
    /// A fault was injected into the encoder during this homing, maybe after its index pulse.
    homing_fault: [bool; 6],
    /// Periods with a position error above its lasting bound.
    wrong: [u32; 6],
    /// Count and true motor position of the period before.
    last: [Option<(i32, f64)>; 6],
    /// True motion, in mm or degrees, in periods that left the count of a defective encoder as it
    /// was.
    unseen: [f64; 6],
    /// Largest motion of a motor in a period since a fault was injected into its encoder.
    fastest: [f64; 6],
    /// Error by true motion with the drives off that a reversed encoder counted the other way.
    ///
    /// No effort and no command tells the direction there.
    reversed_off: [f64; 6],
}

impl EncoderRecord {
    /// Records a fault that is injected into an encoder.
    pub(super) fn record_fault(&mut self, kind: &FaultKind, previous: &PreviousPeriod) {
        let slip = matches!(kind, FaultKind::EncoderSlip { .. });
        let encoder = slip
            || matches!(
                kind,
                FaultKind::EncoderStuck { .. }
                    | FaultKind::EncoderSwapped { .. }
                    | FaultKind::EncoderNoise { .. }
            );
        if let Some(joint) = kind.joint().and_then(joint_of)
            && encoder
        {
            self.suspect[joint] = true;
            self.index_pulses[joint] = 0;
            self.slipped_off[joint] |= slip && !previous.drives_on;
            self.homing_fault[joint] |= previous.state == State::Homing;
        }
    }

    /// Homing has ended the errors that the counters had before it.
    pub(super) const fn end_of_errors(&mut self) {
        self.suspect = self.homing_fault;
        self.unseen = [0.0; 6];
        self.fastest = [0.0; 6];
        self.reversed_off = [0.0; 6];
        self.slipped_off = [false; 6];
    }

    /// Records the count and the true position of a motor. `count` is the size of a count, and
    /// `unwatched` says that its encoder is reversed and the drives are off.
    ///
    /// The live channel of an encoder has an edge every second count. A period with an even number
    /// of them leaves the count as it was, although the motor moved by more than two counts.
    fn record_unseen_motion(
        &mut self,
        joint: usize,
        counts: i32,
        place: f64,
        count: f64,
        unwatched: bool,
    ) {
        if let Some((before, from)) = self.last[joint].replace((counts, place)) {
            let travel = (place - from).abs();
            if unwatched {
                self.reversed_off[joint] += 2.0 * travel;
            }
            if self.suspect[joint] {
                self.fastest[joint] = self.fastest[joint].max(travel);
            }
            if self.suspect[joint] && counts == before && travel > 2.0 * count {
                self.unseen[joint] += travel;
            }
        }
    }

    /// Returns whether a fault was injected into the encoder of this device during homing.
    pub(super) fn has_homing_fault(&self, kind: &FaultKind) -> bool {
        kind.joint()
            .and_then(joint_of)
            .is_some_and(|joint| self.homing_fault[joint])
    }

    /// Forgets the faults of the homing that has ended.
    pub(super) const fn end_of_homing(&mut self) {
        self.homing_fault = [false; 6];
    }
}

/// Bounds of the position error of a joint.
struct ErrorBounds {
    /// Error above which a single period is a violation.
    max: f64,
    /// Error that may last.
    lasting: f64,
    /// Periods for which the error may exceed `lasting`.
    periods: u32,
    /// Name of the largest error in the report.
    name: &'static str,
}

/// Returns the size of a count in mm or degrees.
fn size_of_count(encoder: &EncoderSettings, unit: f64) -> f64 {
    encoder.per_count.unsigned_abs() as f64 / f64::from(1 << 24) / unit
}

/// Returns the error of a joint with a reversed encoder when its runaway is found, mm or degrees.
///
/// With the sign of the feedback reversed the error of the loop grows as exp(g t), with
/// g^2 = kp + kd g / (1 + g T), where T is the time of the rate filter. The monitor looks at
/// efforts from an eighth of the drive's limit on, for four periods. The position is off by twice
/// the error of the loop: the joint moves as far as its count moves the other way. Friction and a
/// load that the law does not know slow the growth down, for which half as much is added.
fn runaway_error(limits: &JointSettings, unit: f64) -> f64 {
    let Drive::Torque { limit, .. } = &limits.drive else {
        return 0.0;
    };
    let law = &limits.law;
    let [kp, kd] = [law.kp, law.kd].map(|gain| f64::from(gain.0) / 256.0);
    let filter = f64::from(law.rate_filter_us) / 1e6;
    let stiffness = |growth: f64| kp + kd * growth / (1.0 + growth * filter);
    let growth = (0..50).fold(kp.sqrt(), |growth, _| stiffness(growth).sqrt());
    // Axis units per second squared in an effort over an inertia: `ServoConfig::inertia`.
    let limit = f64::from(limit.0) * f64::from(1 << 28) / f64::from(law.inertia);
    let error = limit / 8.0 / stiffness(growth) / unit;
    3.0 * error * (5.0 * growth * PERIOD).exp()
}

/// Returns whether the controller claims to know the position.
pub(super) fn is_position_known(bench: &FuzzBench) -> bool {
    let safety = bench.controller().safety();
    safety.homed() && safety.state() != State::Homing
}

impl Checks {
    /// Returns the injected faults of a joint since it was homed.
    fn faults_of(&self, joint: usize) -> impl Iterator<Item = &FaultKind> {
        let of_joint = move |kind: &&FaultKind| kind.joint() == Some(JOINTS[joint]);
        self.injected.iter().filter(of_joint)
    }

    fn encoder_defect(&self, joint: usize) -> EncoderDefect {
        if !self.position.suspect[joint] {
            return EncoderDefect::None;
        }
        let faults: Vec<&FaultKind> = self.faults_of(joint).collect();
        let stuck = |which| {
            faults.iter().any(
                |kind| matches!(kind, FaultKind::EncoderStuck { channel, .. } if *channel == which),
            )
        };
        let noise = faults
            .iter()
            .any(|kind| matches!(kind, FaultKind::EncoderNoise { .. }));
        if stuck(Channel::A) && stuck(Channel::B) {
            EncoderDefect::Dead
        } else if self.position.slipped_off[joint] || noise {
            EncoderDefect::Uncounted
        } else if faults.len() > 1 || !self.causes.iter().all(|cause| *cause == Cause::HostSilent) {
            EncoderDefect::Several
        } else {
            EncoderDefect::Single
        }
    }

    /// Counts by which the encoder of a joint slipped.
    fn slipped(&self, joint: usize) -> f64 {
        let counts = self.faults_of(joint).map(|kind| match kind {
            FaultKind::EncoderSlip { counts, .. } => f64::from(counts.unsigned_abs()),
            _ => 0.0,
        });
        counts.sum()
    }

    /// Whether the encoder of a joint was reversed.
    fn is_reversed(&self, joint: usize) -> bool {
        let mut faults = self.faults_of(joint);
        faults.any(|kind| matches!(kind, FaultKind::EncoderSwapped { .. }))
    }

    /// Largest error until the reversals of the count show a dead channel, at least `min`.
    fn until_found(&self, joint: usize, min: f64) -> f64 {
        let (fastest, unseen) = (self.position.fastest[joint], self.position.unseen[joint]);
        min.max(bounds::REVERSALS * fastest) + unseen
    }

    fn error_bounds(&self, bench: &FuzzBench, joint: usize) -> Option<ErrorBounds> {
        let limits = &bench.controller().machine()?.config.joints[joint];
        let unit = joint_unit(limits);
        let class = class(limits);
        // Lost steps below their limit are not reported; half the lost motion adds to them.
        let unseen = match &limits.drive {
            Drive::Steps { lost, .. } => f64::from(lost.0) / unit + bounds::MOTOR[class],
            Drive::Torque { .. } => 0.0,
        };
        let unseen = unseen.max(bounds::OFF);
        // A motion that ends one reversal before a dead channel is found.
        let creep = limits.encoder.as_ref().map_or(0.0, |encoder| {
            2.0 * bounds::REVERSALS * size_of_count(encoder, unit) + bounds::MOTOR[class]
        });
        if limits.encoder.is_none() {
            return self.is_fault_free(bench).then_some(ErrorBounds {
                max: f64::INFINITY,
                lasting: bounds::OPEN_LOOP,
                periods: 25,
                name: "open loop",
            });
        }
        // A reversed encoder takes up the lost motion with the wrong sign.
        let [runaway, wrong_lost_motion] = if self.is_reversed(joint) {
            [
                runaway_error(limits, unit),
                f64::from(limits.backlash.0) / unit,
            ]
        } else {
            [0.0; 2]
        };
        let found_by_index = self.position.index_pulses[joint] > 2;
        let reversed_off = self.position.reversed_off[joint];
        // The lasting bound is that of the H-4 machines. A slip that is no counter jump stays until
        // index pulses reveal it.
        let small_slip = match &limits.encoder {
            Some(encoder) if self.other_machine => {
                let slip = self.slipped(joint) * size_of_count(encoder, unit);
                if slip * unit <= jump_threshold(limits) {
                    slip + bounds::MOTOR[class]
                } else {
                    0.0
                }
            }
            _ => 0.0,
        };
        Some(match self.encoder_defect(joint) {
            EncoderDefect::None => ErrorBounds {
                max: f64::INFINITY,
                // The bound is that of the H-4 machines, whose lost motion is known.
                lasting: bounds::MOTOR[class]
                    + if self.other_machine {
                        f64::from(limits.backlash.0) / unit
                    } else {
                        0.0
                    },
                periods: 25,
                name: ["motor mm", "motor deg"][class],
            },
            EncoderDefect::Single => ErrorBounds {
                // The bound is that of the H-4 machines, which are slower and heavier.
                max: if self.other_machine {
                    self.until_found(joint, bounds::FOUND.max(runaway))
                } else {
                    bounds::FOUND
                } + wrong_lost_motion,
                lasting: unseen.max(creep).max(small_slip),
                periods: bounds::LASTING,
                name: "off after one fault",
            },
            EncoderDefect::Uncounted => ErrorBounds {
                max: self.until_found(joint, bounds::TWO_TURNS),
                lasting: if found_by_index {
                    bounds::INDEX_SLACK[class]
                } else {
                    // The jump adds to the error that the joint had before.
                    jump_threshold(limits) / unit + bounds::MOTOR[class]
                },
                periods: bounds::PUSHED_LASTING,
                name: "off, noise or drives off",
            },
            EncoderDefect::Several => ErrorBounds {
                max: self.until_found(joint, bounds::PUSHED) + reversed_off,
                // Each fault may stay below the bound of one; index pulses reveal the sum.
                lasting: if found_by_index {
                    unseen
                } else {
                    (unseen * self.faults_of(joint).count().max(1) as f64).max(small_slip)
                        + reversed_off
                },
                periods: bounds::PUSHED_LASTING,
                name: "off after several",
            },
            EncoderDefect::Dead => ErrorBounds {
                max: bounds::TWO_TURNS,
                lasting: unseen,
                periods: u32::MAX,
                name: "off, dead",
            },
        })
    }

    /// Checks the measured motor position, in mm or degrees, against the true one.
    pub(super) fn check_position(
        &mut self,
        bench: &FuzzBench,
        joint: usize,
        measured: f64,
    ) -> CheckResult {
        if bench.rig.inputs().joints[joint].index_pulses != self.previous.index_pulses[joint] {
            self.position.index_pulses[joint] += 1;
        }
        let actual = bench.latched.motor[joint];
        let counts = bench.rig.inputs().joints[joint].counts;
        if let Some(machine) = bench.controller().machine()
            && let Some(encoder) = &machine.config.joints[joint].encoder
        {
            let unit = joint_unit(&machine.config.joints[joint]);
            let count = size_of_count(encoder, unit);
            let unwatched = self.is_reversed(joint) && !bench.controller().safety().drives_on();
            (self.position).record_unseen_motion(joint, counts, actual, count, unwatched);
        }
        let safety = bench.controller().safety();
        if !safety.drives_on() || !is_position_known(bench) {
            self.position.wrong[joint] = 0;
            return Ok(());
        }
        let Some(machine) = bench.controller().machine() else {
            return Ok(());
        };
        let Some(allowed) = self.error_bounds(bench, joint) else {
            return Ok(());
        };
        let off = distance(&machine.config.joints[joint], measured, actual);
        self.record_largest(allowed.name, off);
        let wrong = &mut self.position.wrong[joint];
        *wrong = if off > allowed.lasting { *wrong + 1 } else { 0 };
        if *wrong > allowed.periods || off > allowed.max {
            violated!(
                bench,
                "position wrong",
                "joint {joint} is measured at {measured:.4} and is at {actual:.4}, \
                 {off:.4} off for {wrong} periods and {} index pulses in {:?}; \
                 injected were {:?}",
                self.position.index_pulses[joint],
                safety.state(),
                self.injected
            );
        }
        Ok(())
    }
}
