//! Test of open-loop joints for lost steps, against their home switches.
//!
//! The controller counts the steps of a step motor without encoder; it cannot see whether the motor
//! made them. Homing finds the count at which the switch trips. A motion between two homings that
//! loses steps shifts that count, by whole electrical turns of the motor.
//!
//! Losses of the motions in both directions can cancel: a motor that stalls on both is where it
//! was. So a test has two parts with a homing each. The first one makes the motion away from the
//! switch and comes back slowly, the second one goes there slowly and comes back with the motion. A
//! motor that stalls is off by the travel of the motion, to either side, so both sides of the home
//! pose have room for it.
//!
//! Rates above those of the machine file are tested, so the controller gets the machine file with
//! higher ones for the test ([`SwitchTest::raised`]). Homing stays as it is. A machine with a joint
//! that does not home by a switch would lose its position; its controller keeps its limits.

use crate::excitation::{Builder, Ramp};
use crate::line::{Geometry, Line};
use crate::lost_steps::{Bounds, Motion, StepLimits};
use haptimill_client::session::{self, NoObserver, Session, plan_straight_move};
use haptimill_client::{Error, ErrorKind};
use haptimill_firmware::config::{AxisKind, Drive};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_machine_file::scale::{per_unit, to_i32};
use haptimill_math::{Acceleration, Rate};
use haptimill_protocol::message::AxisValues;
use toml_edit::{DocumentMut, Item};

/// What the test may do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepOptions {
    /// Longest motion of a joint, mm or degrees.
    pub travel: f64,
    /// Maximum rate and acceleration, as a multiple of those of the machine file.
    pub beyond: f64,
}

/// With this multiple the proposal confirms the limits of the machine file.
pub const BEYOND: f64 = 1.0 / crate::lost_steps::MARGIN;

/// Lowest rate as a part of the largest one.
const LOWEST: f64 = 1.0 / 40.0;

/// Time at the rate, seconds.
const CRUISE: f64 = 0.3;

/// Part of the travel to each side of the home pose that the motion leaves free.
const FREE: f64 = 0.1;

/// Part of the maximum pulse rate that is used.
const PULSES: f64 = 0.95;

/// Homings before the tests: how well the switch repeats.
const HOMINGS: usize = 4;

/// A controller accepts setpoints with up to 16 times the acceleration of a jog; half of it is
/// used.
const ACCELERATION: f64 = 8.0;

/// Number of the first job.
const FIRST_JOB: u32 = 10_000;

/// A joint to test.
#[derive(Debug, Clone)]
pub struct StepJoint {
    /// Index of the joint.
    pub joint: usize,
    /// Its line; 0 is the home pose.
    line: Line,
    /// End of the motion on the line, away from the switch.
    pub end: f64,
    /// Range of the tests.
    pub bounds: Bounds,
    /// Why the maximum rate is below the multiple of the machine file.
    pub lower: Option<&'static str>,
    /// Least loss: an electrical turn of a motor with 50 of them in a turn, steps.
    turn: f64,
    /// Rate to the switch.
    homing_rate: f64,
    /// Axis units per step.
    per_step: f64,
}

impl StepJoint {
    /// The places on its line where the joint can be in the test, also where its motor stalls.
    #[must_use]
    pub fn reach(&self) -> Line {
        let mut line = self.line.clone();
        (line.low, line.high) = (-self.end.abs(), self.end.abs());
        line
    }
}

/// A joint that is not measured, and why.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Skipped {
    /// Its name.
    pub name: String,
    /// The reason.
    pub reason: String,
}

/// Why the rate is not above the limits of the machine file.
const FIXED: &str = "the controller keeps its limits: a new configuration would lose the position of \
                     a joint that does not home by a switch";

/// Whether the controller can get another configuration and home afterwards without a person: all
/// joints home by a switch.
fn takes_configuration(machine: &MachineFile) -> bool {
    let mut joints = machine.config.joints.iter();
    joints.all(|joint| joint.home.switch().is_some())
}

/// Steps of a motor turn in the machine file.
fn steps_per_turn(document: Option<&DocumentMut>, joint: usize) -> Option<f64> {
    let joints = document?.get("joint").and_then(Item::as_array_of_tables)?;
    let value = joints.get(joint)?.get("drive")?.get("steps_per_turn")?;
    value.as_float().or(value.as_integer().map(|it| it as f64))
}

/// Time in which the planner builds up an acceleration, seconds.
fn build_up(machine: &MachineFile) -> f64 {
    let ratio = machine.pose.iter().map(|it| it.jerk / it.acceleration);
    (1.0 / ratio.fold(0.0, f64::max)).clamp(0.002, 0.2)
}

/// The joints that are tested, and those that the identification does not measure at all.
#[must_use]
pub fn step_joints(machine: &MachineFile, options: &StepOptions) -> (Vec<StepJoint>, Vec<Skipped>) {
    let document = machine.text.parse::<DocumentMut>().ok();
    let (mut tested, mut skipped) = (Vec::new(), Vec::new());
    for (joint, axis) in machine.config.joints.iter().enumerate() {
        if matches!(axis.drive, Drive::Torque { .. }) {
            continue;
        }
        match step_joint(machine, document.as_ref(), joint, options) {
            Ok(found) => tested.push(found),
            Err(reason) => skipped.push(Skipped {
                name: machine.joints[joint].name.clone(),
                reason,
            }),
        }
    }
    (tested, skipped)
}

fn step_joint(
    machine: &MachineFile,
    document: Option<&DocumentMut>,
    joint: usize,
    options: &StepOptions,
) -> Result<StepJoint, String> {
    let (axis, limits) = (&machine.config.joints[joint], &machine.joints[joint]);
    let Drive::Steps {
        per_step,
        ticks_per_us,
        pulse,
        ..
    } = axis.drive
    else {
        return Err("it has no step drive".to_string());
    };
    if axis.encoder.is_some() {
        return Err("its step drive has an encoder, which shows lost steps in operation".into());
    }
    let Some(switch) = axis.home.switch() else {
        return Err("it has no home switch to find lost steps with".to_string());
    };
    let mut gantries = machine
        .config
        .joints
        .iter()
        .filter_map(|it| it.gantry.as_ref());
    if axis.gantry.is_some() || gantries.any(|it| usize::from(it.of) == joint) {
        return Err("it is a motor of a gantry, and steps lost on one side would rack it".into());
    }
    let turn = steps_per_turn(document, joint).ok_or("its steps_per_turn is unknown")? / 50.0;
    let longest = (4.0 * options.travel).max(200.0);
    let line = Geometry::new(machine).alone(joint, longest);
    let line = line.ok_or("it cannot move alone by 5 mm or degrees from the home pose")?;
    let room = (1.0 - FREE)
        * (-line.low)
            .min(line.high)
            .min(options.travel / (1.0 - FREE));
    let ramp = |acceleration| Ramp {
        acceleration,
        build_up: build_up(machine),
    };
    let gentle = line.acceleration;
    let mut max = limits.rate * options.beyond;
    let mut lower = None;
    let step = per_step.unsigned_abs() as f64 / f64::from(1 << 24) / per_unit(axis.kind);
    let pulses = PULSES * step * 1e6 * f64::from(ticks_per_us) / (2.0 * f64::from(pulse));
    let range = match axis.kind {
        AxisKind::Linear => 2000.0,
        AxisKind::Rotary => 179.0,
        AxisKind::MultiTurn => f64::INFINITY,
    };
    let mut hardest = (limits.acceleration * options.beyond).max(gentle);
    let mut fixed = f64::INFINITY;
    if !takes_configuration(machine) {
        fixed = line.rate;
        hardest = hardest.min(ACCELERATION * line.acceleration);
    }
    for (bound, reason) in [
        (pulses, "pulses of the drive allow no higher rate"),
        (range, "a machine file allows no higher rate"),
        (fixed, FIXED),
    ] {
        if max > bound {
            (max, lower) = (bound, Some(reason));
        }
    }
    while ramp(gentle).travel(max, CRUISE) > room && max > 1e-3 {
        max *= 0.98;
        lower = Some(
            "a higher rate needs a longer travel; a larger --travel helps where there is room",
        );
    }
    let rate = f64::from(switch.rate.0) / per_unit(axis.kind);
    if max < rate {
        return Err(format!(
            "its travel of {room:.1} mm or degrees to each side of the home pose is too short to reach \
             the rate of homing"
        ));
    }
    Ok(StepJoint {
        joint,
        line,
        end: if switch.downwards { room } else { -room },
        bounds: Bounds {
            rate: [LOWEST * max, max],
            acceleration: [gentle, hardest],
        },
        lower,
        turn,
        homing_rate: rate,
        per_step: per_step as f64 / f64::from(1 << 24),
    })
}

/// Part of a test.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Part {
    /// The motion leads away from the switch.
    Away,
    /// It leads towards the switch.
    Towards,
}

/// A test of the step joints in a session. The drives must be on all the time.
pub struct SwitchTest<'a, L> {
    session: &'a mut Session<L>,
    machine: &'a MachineFile,
    /// The machine with the rates of homing, for the motion to the home pose.
    slow: MachineFile,
    model: Model,
    joints: &'a [StepJoint],
    /// Coordinates of the joints and emitted steps at the end of the last homing.
    counts: Option<(AxisValues, AxisValues)>,
    job: u32,
}

impl<'a, L: session::Line> SwitchTest<'a, L> {
    /// A test of joints of a machine, whose controller has the [raised](Self::raised) limits.
    #[must_use]
    pub fn new(
        session: &'a mut Session<L>,
        machine: &'a MachineFile,
        joints: &'a [StepJoint],
    ) -> Self {
        let mut slow = machine.clone();
        for (limits, joint) in slow.joints.iter_mut().zip(&machine.config.joints) {
            if let Some(switch) = joint.home.switch() {
                let homing = f64::from(switch.rate.0) / per_unit(joint.kind);
                limits.rate = limits.rate.min(homing);
            }
        }
        Self {
            session,
            machine,
            slow,
            model: Model::new(machine),
            joints,
            counts: None,
            job: FIRST_JOB,
        }
    }

    /// The machine file with the rates and accelerations that the controller must accept in the
    /// tests. Strokes, soft limits and homing stay.
    #[must_use]
    pub fn raised(machine: &MachineFile, joints: &[StepJoint]) -> MachineFile {
        let mut raised = machine.clone();
        if !takes_configuration(machine) {
            return raised;
        }
        let geometry = Geometry::new(machine);
        for it in joints {
            let [rate, acceleration] = [it.bounds.rate[1], it.bounds.acceleration[1]];
            let axis = &mut raised.config.joints[it.joint];
            let scaled = Rate(to_i32(1.05 * rate * per_unit(axis.kind)));
            axis.rate = axis.rate.max(scaled);
            let faster = (1.05 * rate / it.line.rate).max(1.0);
            // A stop from the maximum rate takes at most four times the acceleration of a jog.
            let harder = acceleration / (ACCELERATION * it.line.acceleration);
            let harder = harder.max(faster);
            let ranges = geometry.ranges(&it.reach());
            let poses = raised.config.pose.iter_mut().zip(&machine.config.pose);
            for ((axis, before), (low, high)) in poses.zip(ranges) {
                if high - low < 0.01 {
                    continue;
                }
                let scale = |value: i32, factor: f64| to_i32(f64::from(value) * factor);
                axis.rate = axis.rate.max(Rate(scale(before.rate.0, faster)));
                let acceleration = Acceleration(scale(before.acceleration.0, harder));
                axis.acceleration = axis.acceleration.max(acceleration);
                axis.jerk = axis.jerk.max((f64::from(before.jerk) * harder) as u32);
            }
        }
        raised
    }

    /// Homes, and returns the steps that each joint lost since the last homing.
    fn home(&mut self) -> Result<Vec<f64>, Error> {
        self.session.home()?;
        let status = self.session.status()?;
        let (joints, steps) = (status.joints, status.drive);
        let difference = |a: &AxisValues, b: &AxisValues, joint: usize| {
            let pair = a.get(joint).zip(b.get(joint));
            pair.map_or(0.0, |(a, b)| f64::from(a.wrapping_sub(*b)))
        };
        let lost = self.joints.iter().map(|it| {
            let Some((joints_before, steps_before)) = &self.counts else {
                return 0.0;
            };
            let emitted = difference(&steps, steps_before, it.joint);
            let moved = difference(&joints, joints_before, it.joint);
            emitted - moved / it.per_step
        });
        let lost = lost.collect();
        self.counts = Some((joints, steps));
        Ok(lost)
    }

    /// Moves to the home pose at the rates of homing.
    fn approach(&mut self) -> Result<(), Error> {
        let home = session::find_home_pose(self.machine, &self.model)?;
        let here = self.session.status()?.commanded;
        let plan = plan_straight_move(&self.slow, &self.model, &here, &home, None)?;
        self.run(here, plan.setpoints)
    }

    fn run(
        &mut self,
        start: AxisValues,
        setpoints: Vec<haptimill_protocol::setpoint::Setpoint>,
    ) -> Result<(), Error> {
        self.job += 1;
        let end = self
            .session
            .run_job(self.job, start, setpoints, &mut NoObserver)?;
        self.session.check_completed(&end)
    }

    /// Moves a joint away from its switch and back to the home pose, one of the two slowly.
    fn make(&mut self, joint: &StepJoint, motion: Motion, part: Part) -> Result<(), Error> {
        let geometry = Geometry::new(self.machine);
        let period = f64::from(self.machine.config.period_us) * 1e-6;
        let build_up = build_up(self.machine);
        let ramp = Ramp {
            acceleration: motion.acceleration,
            build_up,
        };
        let gentle = Ramp {
            acceleration: joint.bounds.acceleration[0],
            build_up,
        };
        // A low rate needs a part of the travel only.
        let travel = ramp.travel(motion.rate, CRUISE).min(joint.end.abs());
        let end = travel * joint.end.signum();
        let mut builder = Builder::new(&geometry, &joint.line, period, 0.0);
        let slow = gentle.slowed(joint.homing_rate.min(motion.rate), travel);
        let [first, second] = match part {
            Part::Away => [(motion.rate, &ramp), (slow, &gentle)],
            Part::Towards => [(slow, &gentle), (motion.rate, &ramp)],
        };
        builder.stroke(end, first.0, first.1)?;
        builder.rest(0.15)?;
        builder.stroke(0.0, second.0, second.1)?;
        builder.rest(0.15)?;
        let (stimulus, _) = builder.finish();
        let start = self.session.status()?.commanded;
        self.run(start, stimulus.setpoints)
    }

    /// Makes one part of the test of each joint that has a motion, and homes.
    fn part(&mut self, motions: &[Option<Motion>], part: Part) -> Result<Vec<f64>, Error> {
        self.approach()?;
        for (joint, motion) in self.joints.iter().zip(motions) {
            if let Some(motion) = motion {
                self.make(joint, *motion, part)?;
            }
        }
        self.home()
    }

    /// Measures all joints.
    ///
    /// # Errors
    /// The machine does not complete a motion, a switch does not repeat, or a joint loses steps at
    /// the rate of homing.
    pub fn measure(&mut self, progress: &mut dyn FnMut(&str)) -> Result<Vec<StepLimits>, Error> {
        progress("lost steps: how well the home switches repeat");
        self.home()?;
        let mut spread = vec![0.0_f64; self.joints.len()];
        for _ in 1..HOMINGS {
            self.approach()?;
            let lost = self.home()?;
            for (spread, lost) in spread.iter_mut().zip(lost) {
                *spread = spread.max(lost.abs());
            }
        }
        let joints = self.joints.iter().zip(&spread);
        let mut found = joints
            .map(|(it, spread)| {
                let joint = &self.machine.joints[it.joint];
                if 4.0 * spread > it.turn / 2.0 {
                    let what = format!(
                        "joint {}: its home switch trips {spread:.1} steps apart, and a loss of \
                         {:.0} steps must show; lower touch_rate, mend the switch, or lower \
                         the rate in [joint.switch], at which the motor may lose steps",
                        joint.name, it.turn,
                    );
                    return Err(Error::new(ErrorKind::Refused, what));
                }
                Ok(StepLimits {
                    joint: it.joint,
                    name: joint.name.clone(),
                    kind: joint.kind,
                    bounds: it.bounds,
                    threshold: (4.0 * spread).max(it.turn / 4.0),
                    rates: Vec::new(),
                    accelerations: Vec::new(),
                    proposal: None,
                })
            })
            .collect::<Result<Vec<_>, Error>>()?;
        loop {
            let motions: Vec<Option<Motion>> = found.iter().map(StepLimits::next).collect();
            if motions.iter().all(Option::is_none) {
                return Ok(found);
            }
            let away = self.part(&motions, Part::Away)?;
            // A joint that lost steps needs no second part.
            let kept: Vec<Option<Motion>> = (found.iter().zip(&motions).zip(&away))
                .map(|((found, motion), lost)| motion.filter(|_| !found.is_loss(*lost)))
                .collect();
            let towards = if kept.iter().any(Option::is_some) {
                self.part(&kept, Part::Towards)?
            } else {
                vec![0.0; away.len()]
            };
            let lost = away.iter().zip(&towards).map(|(away, towards)| {
                if away.abs() > towards.abs() {
                    *away
                } else {
                    *towards
                }
            });
            let mut said = Vec::new();
            for ((found, motion), steps) in found.iter_mut().zip(motions).zip(lost) {
                let Some(motion) = motion else {
                    if found.is_loss(steps) {
                        let what = format!(
                            "joint {}: it lost {steps:.0} steps in the motion to the home pose and at \
                             homing; lower its rate in [joint.switch], or raise the current of its \
                             drive",
                            found.name
                        );
                        return Err(Error::new(ErrorKind::Refused, what));
                    }
                    continue;
                };
                found.record(motion, steps);
                let [rate_unit, unit] = found.units();
                said.push(format!(
                    "{} {:.1} {rate_unit}, {:.0} {unit}: {}",
                    found.name,
                    motion.rate,
                    motion.acceleration,
                    if found.is_loss(steps) {
                        format!("{steps:+.0} steps")
                    } else {
                        "no loss".to_string()
                    }
                ));
            }
            progress(&said.join("; "));
        }
    }
}
