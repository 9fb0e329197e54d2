//! The checks of every period, against the simulated machine's truth and against f64.

#![allow(
    clippy::needless_range_loop,
    reason = "an axis is a place in several lists at once"
)]

use super::bench::{World, name};
use super::reference::{Arithmetic, Course, Tracked};
use super::script::{Episode, Theme};
use haptimill_firmware::config::{Drive, JointAxis};
use haptimill_firmware::io::{DriveCommand, HapticOutputs};
use haptimill_hil_sim::fault::{Channel, FaultKind, HapticFault, Switch};
use haptimill_protocol::force::{ForceProblem, Gate};
use haptimill_protocol::message::{Command, Event, Fault, Refusal, Source, State};
use std::collections::VecDeque;

/// Axis units of a millimetre and of a degree.
pub const MM: f64 = (1 << 20) as f64;
/// Axis units of a degree.
pub const DEGREE: f64 = 4_294_967_296.0 / 360.0;
/// A control period, s.
pub const PERIOD: f64 = 2e-4;

/// Bounds of the checks; docs/storm.md states each with its reason.
pub mod bounds {
    /// Believed less true motor side of a joint whose encoder is whole: half the play, the index, a count (mm, degrees).
    pub const MOTOR: [f64; 2] = [0.022, 0.008];
    /// Counts by which an index pulse may be off its place before the counter is known to be wrong.
    pub const INDEX_SLACK: [f64; 2] = [0.13, 0.06];
    /// More than backlash and a count: a joint of which an encoder was broken is not believed wrongly by so much for longer than [`LASTING`] (mm, degrees).
    pub const OFF: f64 = 0.05;
    /// Bound of one broken encoder with a live channel, and periods above [`OFF`]; those of tests/tests/position_kept.rs.
    pub const FOUND: f64 = 0.12;
    /// 0.05 s.
    pub const LASTING: u32 = 250;
    /// The same where other faults of the joint come with it and take the slide along.
    pub const PUSHED: f64 = 0.6;
    /// 0.5 s.
    pub const PUSHED_LASTING: u32 = 2500;
    /// The same where both channels are dead: the second index pulse tells.
    pub const TWO_TURNS: f64 = 20.0;
    /// A joint this far from its target runs away (mm, degrees).
    pub const RUNAWAY: [f64; 2] = [4.0, 4.0];
    /// A healthy machine's slide against its target in motion: constant part, and seconds of travel.
    pub const FOLLOWING: [f64; 2] = [0.20, 0.12];
    /// The same after a second at rest. A slide that moved by less than its play has an unknown flank: half of both plays (18 um compensated, 10 um real) is 14 um. 8 N of friction that is not
    /// compensated are 5 um at 1600 N/mm.
    pub const REST: [f64; 2] = [0.019, 0.025];
    /// The same for a slide whose last 0.05 s of motion, or more, were slower than [`KNEE`]: its 40 N of friction are not compensated and are 25 um (firmware/src/joint/friction.rs).
    pub const REST_SLOW: f64 = 0.039;
    /// Rate from which on the friction is compensated in full: five times `coulomb_rate_mm_s`, mm/s.
    pub const KNEE: f64 = 0.1;
    /// Following error that must have been reported, as a part of the configured limit, for more than three periods.
    pub const REPORTED: f64 = 1.02;
    /// Commanded pose against the interpolation of the setpoints, axis units.
    pub const CUBIC: f64 = 24.0;
    /// Periods from a request to its answer on a clean, fast line.
    pub const ANSWER: u64 = 5000;
    /// Rod length residual of commanded joints at the commanded pose, mm.
    pub const RESIDUAL: f64 = 2e-4;
}

/// A check that failed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Violation {
    /// Which check.
    pub check: &'static str,
    /// What was seen.
    pub text: String,
    /// In which period.
    pub period: u64,
}

/// What was in the period before.
#[derive(Debug, Clone, Default)]
struct Before {
    state: State,
    on: bool,
    homed: bool,
    kept: bool,
    pose: [f64; 6],
    rates: [f64; 6],
    joints: [f64; 6],
    joint_rates: [f64; 6],
    sources: [Source; 6],
    configured: bool,
    haptic: [f64; 3],
    valid: bool,
    index: [u8; 6],
    /// Step motors lock.
    locking: bool,
}

/// Newest jog epoch as far as the answers tell; what is stale here is stale for certain.
#[derive(Debug, Clone, Copy, Default)]
struct Epochs {
    newest: Option<u16>,
    cancelled: bool,
}

/// The memory of the checks.
pub struct Watch {
    theme: Theme,
    before: Before,
    arithmetic: Arithmetic,
    /// The job that is checked against its setpoints.
    pub course: Course,
    epochs: Epochs,
    /// The override that was taken last.
    percent: u8,
    /// Periods since the path rate should have settled.
    settled: u32,
    /// The configuration is not that of the plant.
    pub foreign: bool,
    /// Devices that were ever broken since the machine was homed.
    pub ever: Vec<FaultKind>,
    /// Missed periods, away hosts: causes of faults that are no devices.
    pub causes: Vec<Cause>,
    /// An encoder was broken since it was last right.
    suspect: [bool; 6],
    /// Index pulses since an encoder was broken.
    pulses: [u32; 6],
    /// The encoder slipped while the drives were off.
    slipped_off: [bool; 6],
    /// The encoder slipped during this homing, maybe after its index pulse was used.
    slipped_homing: [bool; 6],
    /// Periods of motion since the joint was last faster than [`bounds::KNEE`].
    crept: [u32; 6],
    wrong: [u32; 6],
    away: [u32; 6],
    unreported: [u32; 6],
    /// The drives have been on since the references were found, so the flanks of the screws are known.
    steady: bool,
    slow: [u32; 6],
    /// Periods in standstill.
    still: u32,
    history: VecDeque<(u64, State, [i32; 6], bool)>,
    chain: Option<State>,
    pushed: [(u32, f64); 3],
    jog_until: u64,
    held: u32,
    urgent: u32,
    loops: [f64; 3],
    last_fault: u64,
    /// Periods that were looked at.
    pub periods: u64,
    /// Ticks since periods were missed.
    missed_at: Option<u64>,
    /// Largest motion of each joint in a period since the references were found, as a part of what is taken for a jump of the counter.
    fastest: [f64; 6],
    /// Where the motors were.
    places: Option<[f64; 6]>,
    /// The commanded pose was set up beyond a soft limit of this coordinate.
    outside: [bool; 6],
    /// A new session begins when nothing is active: the override is 100 % then.
    greeted: u64,
    /// Gaps in what was told of states: no more than events that the controller gave up when its queue was full.
    breaks: u32,
    /// Commanded joints when the step motors had locked.
    locked_at: [f64; 6],
    /// Largest values of what is compared with a bound, for the documentation.
    pub largest: Vec<(&'static str, f64)>,
}

/// What may be wrong with an encoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Doubt {
    /// Nothing.
    None,
    /// One fault of its encoder is all that has happened to the joint.
    Single,
    /// Its counter gained or lost counts one by one, or by less than a jump while the drives were off: index pulses tell.
    Uncounted,
    /// More has happened to the joint.
    Several,
    /// Both channels were dead.
    Dead,
}

/// A cause of a fault that is no broken device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// Missed periods.
    Late,
    /// A host that was away, or a line that was spoilt.
    Silence,
    /// The emergency stop circuit.
    Circuit,
    /// A body at the tool.
    Contact,
    /// A hand that leads.
    Lead,
    /// A sensor of force that was fitted anew and not tared since.
    Refitted,
}

fn unit(axis: usize) -> f64 {
    if axis < 3 { MM } else { DEGREE }
}

fn joint_unit(joint: usize) -> f64 {
    if joint < 4 { MM } else { DEGREE }
}

const fn class(joint: usize) -> usize {
    if joint < 4 { 0 } else { 1 }
}

/// A motion in a period that the firmware takes for a jump of the counter: the following error at standstill and ten times the highest rate; axis units.
fn way_of_a_jump(limits: &JointAxis) -> f64 {
    f64::from(limits.following.0) + f64::from(limits.rate.0) * 10.0 * PERIOD
}

/// The storm's own list of faults for which the machine brakes and holds.
const fn holds(fault: &Fault) -> bool {
    matches!(
        fault,
        Fault::LostHost { .. }
            | Fault::LatePeriod { .. }
            | Fault::SoftLimit { .. }
            | Fault::JointRate { .. }
            | Fault::Force(_)
            | Fault::Master(_)
    )
}

/// Which state may follow which in one period, and the commands that may cause it.
fn cause(from: State, to: State) -> Option<&'static [&'static str]> {
    use State::{Disabled, EmergencyStop, Fault, Hold, Homing, Idle, Jog, Run};
    Some(match (from, to) {
        (_, EmergencyStop) => &[],
        (Disabled, Idle) => &["Enable"],
        (Idle, Disabled) => &["Disable"],
        (Idle, Homing) => &["Home"],
        (Idle, Run) => &["JobStart"],
        (Idle, Jog) => &["Jog"],
        (Hold, Run) => &["Resume"],
        (Fault, Disabled | Idle) | (EmergencyStop, Disabled) => &["Reset"],
        (Disabled | Idle | Homing | Run | Jog | Hold, Fault)
        | (Homing | Jog | Run | Hold, Idle)
        | (Run, Hold) => &[],
        _ => return None,
    })
}

macro_rules! violated {
    ($world:expr, $check:literal, $($text:tt)*) => {
        return Err(Violation { check: $check, text: format!($($text)*), period: $world.period })
    };
}

type Checked = Result<(), Violation>;

impl Watch {
    /// Nothing seen yet.
    #[must_use]
    pub fn new(episode: &Episode, world: &World) -> Self {
        Self {
            theme: episode.theme,
            before: Before::default(),
            arithmetic: Arithmetic::new(&world.plant),
            course: Course::default(),
            epochs: Epochs::default(),
            percent: 100,
            settled: 0,
            foreign: false,
            ever: vec![],
            causes: vec![],
            suspect: [false; 6],
            crept: [0; 6],
            wrong: [0; 6],
            away: [0; 6],
            unreported: [0; 6],
            steady: false,
            slow: [0; 6],
            still: 0,
            history: VecDeque::new(),
            chain: None,
            pushed: [(0, 0.0); 3],
            jog_until: 0,
            held: 0,
            urgent: 0,
            loops: [64.0; 3],
            last_fault: 0,
            periods: 0,
            missed_at: None,
            fastest: [0.0; 6],
            places: None,
            outside: [false; 6],
            greeted: u64::MAX,
            breaks: 0,
            locked_at: [0.0; 6],
            pulses: [0; 6],
            slipped_off: [false; 6],
            slipped_homing: [false; 6],
            largest: vec![],
        }
    }

    fn note(&mut self, what: &'static str, value: f64) {
        match self.largest.iter_mut().find(|(name, _)| *name == what) {
            Some((_, largest)) => *largest = largest.max(value),
            None => self.largest.push((what, value)),
        }
    }

    /// A device broke.
    pub fn broke(&mut self, kind: &FaultKind) {
        let joint = super::script::JOINTS
            .iter()
            .position(|joint| Some(*joint) == kind.axis());
        if let Some(joint) = joint
            && matches!(
                kind,
                FaultKind::EncoderStuck { .. }
                    | FaultKind::EncoderSwapped { .. }
                    | FaultKind::EncoderSlip { .. }
                    | FaultKind::EncoderNoise { .. }
            )
        {
            self.suspect[joint] = true;
            self.pulses[joint] = 0;
            self.slipped_off[joint] |=
                matches!(kind, FaultKind::EncoderSlip { .. }) && !self.before.on;
            self.slipped_homing[joint] |= self.before.state == State::Homing;
        }
        self.ever.push(kind.clone());
    }

    /// Whether nothing was ever broken and nothing else is wrong.
    fn sound(&self, world: &World) -> bool {
        self.ever.is_empty() && world.broken.is_empty() && !self.foreign
    }

    /// Looks at the period that has just passed.
    ///
    /// # Errors
    /// The first check that failed.
    pub fn look(&mut self, world: &mut World, ticked: bool) -> Checked {
        self.travel(world);
        if !ticked || world.rig.inputs().missed > 0 {
            self.missed_at = Some(world.period);
        }
        self.answers(world)?;
        self.events(world)?;
        if !ticked {
            self.before.valid = false;
            return Ok(());
        }
        self.periods += 1;
        self.safe(world)?;
        self.transition(world)?;
        self.life(world)?;
        self.motion(world)?;
        self.truth(world)?;
        self.force(world)?;
        self.haptic(world)?;
        self.telemetry(world)?;
        self.remember(world);
        Ok(())
    }

    /// How fast the joints truly move, compared with what the firmware takes for a jump: its following error at standstill and ten times its highest rate.
    fn travel(&mut self, world: &World) {
        let places = self.places.replace(world.latched.motor);
        let (Some(before), Some(machine)) = (places, world.controller().machine()) else {
            return;
        };
        for (joint, limits) in machine.config.joints.iter().enumerate() {
            let way = way_of_a_jump(limits) / joint_unit(joint);
            let part = (world.latched.motor[joint] - before[joint]).abs() / way;
            self.fastest[joint] = self.fastest[joint].max(part);
        }
    }

    fn answers(&mut self, world: &mut World) -> Checked {
        if let Some(text) = world.stray.take()
            && world.period > world.greeted + 300
        {
            violated!(world, "answers", "{text}");
        }
        for answer in core::mem::take(&mut world.answers) {
            match (&answer.command, &answer.result) {
                (Command::Jog { epoch, .. }, Ok(())) => {
                    let age = self
                        .epochs
                        .newest
                        .map_or(-1, |newest| newest.wrapping_sub(*epoch) as i16);
                    if age > 0 || (age == 0 && self.epochs.cancelled) {
                        violated!(
                            world,
                            "stale jog",
                            "a jog of epoch {epoch} was taken; newest {:?}, cancelled {}",
                            self.epochs.newest,
                            self.epochs.cancelled
                        );
                    }
                    self.epochs = Epochs {
                        newest: Some(*epoch),
                        cancelled: false,
                    };
                }
                (Command::JogCancel { epoch }, Ok(())) => {
                    let age = self
                        .epochs
                        .newest
                        .map_or(-1, |newest| newest.wrapping_sub(*epoch) as i16);
                    if age <= 0 {
                        self.epochs = Epochs {
                            newest: Some(*epoch),
                            cancelled: true,
                        };
                    }
                }
                (Command::Tare, Ok(())) => self.causes.retain(|cause| *cause != Cause::Refitted),
                (Command::Hold, Ok(())) => self.epochs.cancelled = true,
                (Command::Override { percent }, Ok(())) => {
                    if !(1..=100).contains(percent) {
                        violated!(world, "range", "an override of {percent} % was taken");
                    }
                    self.percent = *percent;
                    self.settled = 0;
                }
                (Command::ForceLoop { axis, settings }, Ok(())) => {
                    if let Some(limit) = self.loops.get_mut(usize::from(*axis)) {
                        *limit = limit.max(f64::from(settings.limit) / MM);
                    }
                }
                (Command::Jog { deadline_ms, .. }, _) if *deadline_ms == 0 => {}
                _ => {}
            }
            if let (Command::Jog { deadline_ms, .. }, Ok(())) = (&answer.command, &answer.result) {
                if !(1..=1000).contains(deadline_ms) {
                    violated!(world, "range", "a jog for {deadline_ms} ms was taken");
                }
                self.jog_until = self
                    .jog_until
                    .max(world.period + u64::from(*deadline_ms) * 5);
            }
            if self.theme.healthy()
                && self.sound(world)
                && matches!(answer.command, Command::Setpoints(_))
                && let Err(
                    refusal
                    @ (Refusal::OutOfOrder { .. } | Refusal::QueueFull | Refusal::AxisCount),
                ) = answer.result
                && !self.course.spoilt
            {
                violated!(world, "setpoint refused", "{refusal:?}");
            }
            if answer.result.is_err() && matches!(answer.command, Command::Setpoints(_)) {
                self.course.spoilt = true;
            }
        }
        // A request that is never answered, on a line that carries all.
        let quick = world.rig.to_machine().in_flight() < 200;
        if self.theme.clean_line()
            && quick
            && world.away.is_none()
            && !world.spoilt
            && let Some(oldest) = world.pending.front()
            && world.period > oldest.sent + bounds::ANSWER
            && world.period > world.greeted + bounds::ANSWER
            && !self.causes.contains(&Cause::Silence)
            && !self.causes.contains(&Cause::Late)
        {
            violated!(
                world,
                "no answer",
                "{} of period {} was not answered",
                name(&oldest.command),
                oldest.sent
            );
        }
        Ok(())
    }

    fn events(&mut self, world: &mut World) -> Checked {
        for (period, event) in core::mem::take(&mut world.events) {
            match &event {
                Event::State { from, to, .. } => {
                    // The oldest gives way where the line is slower than what happens.
                    let lost = world.controller().safety().events_lost();
                    let broken = self.chain.is_some_and(|last| last != *from);
                    self.breaks += u32::from(broken);
                    if self.theme.clean_line()
                        && !self.causes.contains(&Cause::Silence)
                        && let Some(last) = self.chain
                        && last != *from
                        && self.breaks > lost
                    {
                        violated!(
                            world,
                            "lost event",
                            "state {from:?} -> {to:?} was told after one that ended in {last:?}"
                        );
                    }
                    self.chain = Some(*to);
                }
                Event::Fault(Fault::Internal { line }) => {
                    violated!(world, "internal", "a defect in line {line}");
                }
                Event::Fault(fault) => {
                    self.last_fault = world.period;
                    self.judge(world, fault)?;
                }
                _ => {}
            }
            if period > world.rig.inputs().period {
                violated!(world, "event", "{event:?} is told to be of period {period}");
            }
        }
        Ok(())
    }

    /// Whether a fault has a cause.
    fn judge(&mut self, world: &World, fault: &Fault) -> Checked {
        if self.foreign {
            return Ok(());
        }
        let mut caused = match fault {
            Fault::LostHost { .. } => {
                self.causes.contains(&Cause::Silence)
                    || world.spoilt
                    || world.greeted + 5000 > world.period
                    || world.noisy()
            }
            Fault::LatePeriod { .. } => self.causes.contains(&Cause::Late),
            // Step motors that are told nothing stand at once, and their rotors swing.
            Fault::StepsLost { axis, .. } => {
                let joint = usize::from(*axis);
                self.missed_at
                    .is_some_and(|missed| world.period < missed + 500)
                    || self.falls_into_place(world, joint)
            }
            // A joint that is pushed faster than a counter is believed.
            Fault::EncoderIllegal { axis, .. } => self.fastest[usize::from(*axis)] > 0.98,
            Fault::Stroke { .. } | Fault::LimitSwitch { .. } => self.causes.contains(&Cause::Late),
            Fault::Master(_) => self.causes.contains(&Cause::Lead),
            Fault::Force(ForceProblem::Drift { .. }) if self.causes.contains(&Cause::Refitted) => {
                true
            }
            Fault::Force(_) => self.causes.contains(&Cause::Contact) && !self.theme.healthy(),
            // Setpoints between which the interpolation leaves the limits are checked at their ends only.
            // A machine that was pushed beyond them while its drives were off stands beyond them.
            Fault::SoftLimit { axis } => {
                self.course.spoilt || self.theme == Theme::Wild || self.outside[usize::from(*axis)]
            }
            _ => false,
        };
        // A push or a jam can do what a controller cannot tell from another thing.
        for kind in &self.ever {
            caused |= explains(kind, fault);
        }
        if caused {
            return Ok(());
        }
        if self.ever.is_empty() {
            violated!(
                world,
                "false alarm",
                "{fault:?}, and nothing is wrong; causes {:?}",
                self.causes
            );
        }
        violated!(
            world,
            "fault class",
            "{fault:?} is none of what {:?} leads to",
            self.ever
        );
    }

    /// Friction may hold a rotor at the dead point two full steps from its detent, where its torque is 0: nothing tells it from one that has locked. The first motion
    /// makes it fall into the detent. So steps may be lost before the joint was commanded by twice the limit.
    fn falls_into_place(&self, world: &World, joint: usize) -> bool {
        let Some(machine) = world.controller().machine() else {
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
        let way = self.before.joints[joint] - self.locked_at[joint];
        // One that falls without a command had not locked.
        (1.0..2.0 * f64::from(lost.0)).contains(&way.abs())
    }

    /// Check 2: outputs.
    fn safe(&mut self, world: &World) -> Checked {
        let controller = world.controller();
        let (safety, outputs, inputs) =
            (controller.safety(), world.rig.outputs(), world.rig.inputs());
        let state = safety.state();
        let on = outputs.axes.iter().any(|axis| *axis != DriveCommand::Off);
        let haptic = outputs.haptic != HapticOutputs::default();
        let all_off = !on && !haptic && outputs.spindle_rpm == 0;
        let holding = state == State::Fault && safety.fault().is_some_and(|fault| holds(&fault));
        let may = match state {
            State::Disabled | State::EmergencyStop => false,
            State::Fault => holding,
            _ => true,
        };
        if !may && !all_off {
            violated!(
                world,
                "outputs not safe",
                "state {state:?}, fault {:?}, drives {:?}, spindle {}, haptic {haptic}",
                safety.fault(),
                outputs.axes,
                outputs.spindle_rpm
            );
        }
        if inputs.emergency_stop && (state != State::EmergencyStop || !all_off) {
            violated!(
                world,
                "emergency stop",
                "the circuit is open in state {state:?}"
            );
        }
        if (state == State::Fault) != safety.fault().is_some() && state != State::EmergencyStop {
            violated!(world, "fault", "{state:?} with {:?}", safety.fault());
        }
        if outputs.spindle_rpm != 0 && !matches!(state, State::Run | State::Hold) {
            violated!(
                world,
                "spindle",
                "{} rev/min in {state:?}",
                outputs.spindle_rpm
            );
        }
        let configured = controller.machine();
        if let Some(machine) = configured {
            let bad = inputs.axes[..machine.axes()]
                .iter()
                .any(|axis| axis.limit_low || axis.limit_high || !axis.drive_ready);
            if bad && on && self.before.on {
                violated!(
                    world,
                    "limit or drive ignored",
                    "drives on in {state:?} with {:?}",
                    &inputs.axes
                );
            }
            for (joint, axis) in machine.config.joints.iter().enumerate() {
                match (&axis.drive, outputs.axes[joint]) {
                    (_, DriveCommand::Off) => {
                        if on {
                            violated!(world, "drive off", "joint {joint} alone is off");
                        }
                    }
                    (Drive::Torque { full_scale, limit }, DriveCommand::Torque(code)) => {
                        let most = f64::from(limit.0) / f64::from(full_scale.0).abs() * 8192.0;
                        if f64::from(code).abs() > most + 1.0 {
                            violated!(
                                world,
                                "effort",
                                "joint {joint}: code {code} of at most {most}"
                            );
                        }
                    }
                    (Drive::Steps { .. }, DriveCommand::Steps(_)) => {}
                    (_, command) => {
                        violated!(world, "drive kind", "joint {joint}: {command:?}");
                    }
                }
                if let Some(report) = world.rig.plant().pulse_report(joint)
                    && report.violations > 0
                    && !self.foreign
                {
                    violated!(world, "pulses", "joint {joint}: {:?}", report.first);
                }
            }
        } else if on {
            violated!(
                world,
                "outputs not safe",
                "drives on without a configuration"
            );
        }
        if inputs.urgent {
            self.urgent = 1;
            if state == State::Run {
                violated!(world, "urgent stop", "the job goes on");
            }
        } else if self.urgent > 0 {
            self.urgent += 1;
        }
        Ok(())
    }

    /// Transitions, each with its cause.
    fn transition(&mut self, world: &mut World) -> Checked {
        let state = world.controller().safety().state();
        let from = self.before.state;
        while world
            .ghosts
            .front()
            .is_some_and(|_| world.period > world.greeted + 3000)
        {
            world.ghosts.pop_front();
        }
        if from != state {
            self.settled = 0;
            self.still = 0;
            let Some(commands) = cause(from, state) else {
                violated!(world, "transition", "{from:?} -> {state:?}");
            };
            // What was asked and not answered before this period, or was answered in it.
            let asked = commands.is_empty()
                || world
                    .pending
                    .iter()
                    .chain(&world.ghosts)
                    .any(|pending| commands.contains(&name(&pending.command)))
                || world.just.iter().any(|name| commands.contains(name));
            if !asked {
                violated!(
                    world,
                    "transition without cause",
                    "{from:?} -> {state:?}, and no {commands:?} was asked for"
                );
            }
        }
        let job = matches!(state, State::Run | State::Hold);
        if state == State::Run && !matches!(from, State::Run | State::Hold) {
            let start = self.pose(world);
            self.course.begin(start);
        }
        if !job {
            self.course.end();
        }
        Ok(())
    }

    /// A host that is silent, holds and stops that must come to rest, dead-man's deadlines.
    fn life(&mut self, world: &World) -> Checked {
        let controller = world.controller();
        let safety = controller.safety();
        let state = safety.state();
        let Some(machine) = controller.machine() else {
            return Ok(());
        };
        let limit = machine.config.supervision.missed_periods;
        if world.rig.inputs().missed >= limit
            && self.before.on
            && state != State::EmergencyStop
            && safety.pending().is_none()
            && safety.fault().is_none()
        {
            violated!(
                world,
                "missed periods",
                "{} were missed and nothing stops the machine in {state:?}",
                world.rig.inputs().missed
            );
        }
        let moving = matches!(state, State::Run | State::Jog | State::Hold | State::Homing);
        if let Some(away) = world.away {
            let silent = world.period - away;
            let patience = u64::from(machine.config.supervision.heartbeat_ms) * 5;
            // What was under way, what waits in the ring, and the sign of life said just before.
            if silent > patience + 600 && moving && safety.pending().is_none() {
                violated!(
                    world,
                    "lost host",
                    "{state:?} after {silent} periods of silence"
                );
            }
            if silent > patience + 600 + 15_000 && moving && !self.foreign {
                violated!(world, "lost host", "{state:?} long after the host was lost");
            }
        }
        // A session that was given up gets no answers; the controller may have accepted its jogs.
        for request in &world.ghosts {
            if let Command::Jog { deadline_ms, .. } = request.command {
                let deadline = u64::from(deadline_ms.min(1000)) * 5;
                self.jog_until = self.jog_until.max(world.period + deadline);
            }
        }
        if state == State::Jog
            && world.period > self.jog_until + 12_500
            && !world
                .pending
                .iter()
                .any(|pending| name(&pending.command) == "Jog")
            && !self.foreign
        {
            violated!(
                world,
                "dead-man",
                "jogs on, {} periods after the last deadline",
                world.period - self.jog_until
            );
        }
        // Braking along the path ends within the configured time, and a hold stands then.
        self.held = if state == State::Hold && self.before.state == State::Hold {
            self.held + 1
        } else {
            0
        };
        let stop = u32::from(machine.config.stopping.time_ms) * 5;
        let back = matches!(safety.pending(), Some(Fault::Force(_)));
        if self.held > stop + 400 && !back {
            let rate = machine.motion.program.path_rate();
            if rate != 0 && !machine.motion.program.is_at_standstill() {
                violated!(
                    world,
                    "hold",
                    "path rate {rate} {} periods after the hold",
                    self.held
                );
            }
        }
        if self.urgent > 12_500 {
            self.urgent = 0;
        }
        // The path rate is the override's once it has settled.
        if self.greeted != world.greeted && !safety.active() {
            self.greeted = world.greeted;
            self.percent = 100;
            self.settled = 0;
        }
        let program = &machine.motion.program;
        let rest = program.is_at_standstill() || program.queued() == 0;
        let calm = state == State::Run
            && program.is_complete()
            && !rest
            && program.underrunning().is_none()
            && safety.pending().is_none()
            && self.course.wide;
        self.settled = if calm { self.settled + 1 } else { 0 };
        if self.settled > stop + 600 && !self.foreign && self.theme.clean_line() {
            let should = f64::from(self.percent) / 100.0;
            let is = program.path_rate() as f64 / 4_294_967_296.0;
            if (should - is).abs() > 1e-4
                && world
                    .pending
                    .iter()
                    .all(|pending| name(&pending.command) != "Override")
                && world.ghosts.is_empty()
            {
                violated!(world, "override", "path rate {is}, override {should}");
            }
        }
        if world.greeted + 2 > world.period {
            self.chain = None;
            self.epochs = Epochs::default();
        }
        Ok(())
    }

    fn pose(&self, world: &World) -> [f64; 6] {
        let mut pose = [0.0; 6];
        if let Some(machine) = world.controller().machine() {
            for (slot, place) in pose.iter_mut().zip(machine.motion.commanded().pose.0) {
                *slot = f64::from(place.0);
            }
        }
        pose
    }

    /// Checks 4 and 5: what is commanded.
    fn motion(&mut self, world: &World) -> Checked {
        let controller = world.controller();
        let Some(machine) = controller.machine() else {
            return Ok(());
        };
        if machine.axes() == 0 {
            return Ok(());
        }
        let safety = controller.safety();
        let state = safety.state();
        let on = safety.drives_on();
        let commanded = machine.motion.commanded();
        let pose = self.pose(world);
        let before = self.before.clone();
        let before = &before;
        // Step motors are commanded where their rotors locked, in the period in which the last one has.
        let placed = !before.on
            || (before.locking && !machine.is_locking())
            || !before.configured
            || !before.valid
            || (before.state == State::Homing && state != State::Homing);
        // A tool that yielded is taken over where it is by a reset and by homing.
        let absorbed = matches!(before.state, State::Fault) || state == State::Homing;
        let active = |state| matches!(state, State::Run | State::Hold | State::Jog | State::Homing);
        if placed || absorbed {
            for axis in 0..machine.axes() {
                let limits = &machine.config.pose[axis];
                self.outside[axis] =
                    !(f64::from(limits.low.0)..=f64::from(limits.high.0)).contains(&pose[axis]);
            }
        }
        if on && !placed {
            for axis in 0..machine.axes() {
                let limits = &machine.config.pose[axis];
                let mut step = pose[axis] - before.pose[axis];
                if axis > 2 {
                    step = f64::from((step as i64) as i32);
                }
                let per_period = f64::from(limits.rate.0) * PERIOD;
                let most = match state {
                    State::Run | State::Hold => per_period * 1.55 + 3.0,
                    _ => per_period * 1.002 + 3.0,
                };
                if step.abs() > most && !absorbed {
                    violated!(
                        world,
                        "commanded rate",
                        "axis {axis}: {} of {per_period} axis units in a period in {state:?}",
                        step
                    );
                }
                if !active(state) && !active(before.state) && step != 0.0 && !absorbed {
                    violated!(world, "moves at rest", "axis {axis} by {step} in {state:?}");
                }
                // Acceleration of jogs by differences of the stated rate.
                let rate = f64::from(commanded.rates[axis].0);
                if state == State::Jog && before.state == State::Jog {
                    let gain = (rate - before.rates[axis]).abs();
                    let most = f64::from(limits.acceleration.0) * 256.0 * PERIOD;
                    if gain > most * 1.01 + 600.0 {
                        violated!(
                            world,
                            "jog acceleration",
                            "axis {axis}: rate changed by {gain} of {most} in a period"
                        );
                    }
                    self.slow[axis] += 1;
                }
                // Soft limits: what is within stays within, what is beyond does not go farther.
                let (low, high) = (f64::from(limits.low.0), f64::from(limits.high.0));
                let beyond = |at: f64| (at - high).max(low - at).max(0.0);
                let room = match state {
                    // A cubic between two setpoints within may leave; the fault brakes then.
                    State::Run | State::Hold => 10.0 * unit(axis),
                    State::Homing => f64::INFINITY,
                    _ => 2.0,
                };
                let outside = beyond(pose[axis]);
                if outside > room && outside > beyond(before.pose[axis]) {
                    violated!(
                        world,
                        "soft limit",
                        "axis {axis} commanded {} beyond, in {state:?}",
                        outside / unit(axis)
                    );
                }
                if matches!(state, State::Run)
                    && outside > 2.0
                    && outside > beyond(before.pose[axis])
                    && safety.pending().is_none()
                    && before.state == State::Run
                {
                    violated!(
                        world,
                        "soft limit",
                        "axis {axis} {} beyond, and nothing stops it",
                        outside / unit(axis)
                    );
                }
            }
        }
        if on {
            // The joints that belong to the pose, by the geometry of the simulator.
            let reference = if machine.force.is_some() {
                machine.reference()
            } else {
                commanded
            };
            let target = machine.target();
            let mut joints = [0.0; 6];
            for (slot, place) in joints.iter_mut().zip(&target.joints.0) {
                *slot = f64::from(place.0);
            }
            if !self.foreign && !placed {
                let residual = self
                    .arithmetic
                    .residual(&reference.pose.0.map(|place| f64::from(place.0)), &joints);
                self.note("residual mm", residual);
                if residual > bounds::RESIDUAL {
                    violated!(
                        world,
                        "kinematics",
                        "commanded joints miss the commanded pose by {residual} mm"
                    );
                }
            }
            if !placed && !absorbed {
                for (joint, limits) in machine.config.joints.iter().enumerate() {
                    let step = f64::from(
                        target.joints.0[joint]
                            .0
                            .wrapping_sub(before.joints[joint] as i64 as i32),
                    );
                    let most = f64::from(limits.rate.0) * PERIOD;
                    let part = step.abs() / most;
                    if matches!(state, State::Jog) {
                        self.note("joint rate in a jog, part of its limit", part);
                    } else if state == State::Run {
                        self.note("joint rate in a job, part of its limit", part);
                    }
                    // A step of whole axis units is off by one.
                    let bound = match state {
                        State::Run | State::Hold => 1.03125,
                        _ => 1.0,
                    };
                    if part > bound + 1.5 / most && !self.foreign {
                        if matches!(state, State::Run | State::Hold) {
                            violated!(
                                world,
                                "joint rate in a job",
                                "joint {joint} commanded at {part:.3} of its limit in {state:?}"
                            );
                        }
                        violated!(
                            world,
                            "joint rate in a jog",
                            "joint {joint} commanded at {part:.3} of its limit in {state:?}"
                        );
                    }
                    let low = f64::from(limits.low.0);
                    let high = f64::from(limits.high.0);
                    let beyond = |at: f64| (at - high).max(low - at).max(0.0) / joint_unit(joint);
                    if beyond(joints[joint]) > 0.001
                        && beyond(joints[joint]) > beyond(before.joints[joint])
                    {
                        violated!(
                            world,
                            "stroke",
                            "joint {joint} commanded {} beyond its stroke",
                            beyond(joints[joint])
                        );
                    }
                    // The stated rate is the derivative.
                    let mean = (f64::from(target.rates[joint].0) + before.joint_rates[joint]) / 2.0
                        * PERIOD;
                    let off = (mean - step).abs();
                    if active(state) && active(before.state) && !self.foreign {
                        self.note(
                            "joint rate less derivative, axis units",
                            off - step.abs() / 50.0,
                        );
                        if off > 40.0 + step.abs() / 50.0 {
                            violated!(
                                world,
                                "joint derivative",
                                "joint {joint} went {step}, its rate says {mean} in {state:?}"
                            );
                        }
                    }
                }
            }
        }
        self.follow_course(world)
    }

    /// The commanded pose of a job against the interpolation of its setpoints.
    fn follow_course(&mut self, world: &World) -> Checked {
        let controller = world.controller();
        let Some(machine) = controller.machine() else {
            return Ok(());
        };
        let safety = controller.safety();
        let state = safety.state();
        if !matches!(state, State::Run | State::Hold) {
            return Ok(());
        }
        let led = (0..machine.axes()).any(|axis| machine.motion.source(axis) != Source::Program);
        if led || matches!(safety.pending(), Some(Fault::Force(_))) {
            self.course.trusted = false;
        }
        let program = &machine.motion.program;
        let seen = Tracked {
            time: program.program_time(),
            reached: program.reached(),
            accepted: program.accepted(),
            pose: self.pose(world),
            halted: state == State::Hold,
            spindle: world.rig.outputs().spindle_rpm,
            held: safety.pending().is_some(),
        };
        match self.course.check(&seen) {
            Ok(off) => {
                self.note("commanded pose less cubic, axis units", off);
                if off > bounds::CUBIC {
                    violated!(
                        world,
                        "interpolation",
                        "commanded pose is {off} axis units from the setpoints' cubic"
                    );
                }
                Ok(())
            }
            Err(text) => {
                violated!(world, "setpoints", "{text}");
            }
        }
    }

    /// Faults of a joint since it was homed.
    fn faults_of(&self, joint: usize) -> impl Iterator<Item = &FaultKind> {
        let name = super::script::JOINTS[joint];
        (self.ever.iter()).filter(move |kind| kind.axis() == Some(name))
    }

    /// What may be wrong with the encoder of a joint.
    fn doubt(&self, joint: usize) -> Doubt {
        if !self.suspect[joint] {
            return Doubt::None;
        }
        let faults: Vec<&FaultKind> = self.faults_of(joint).collect();
        let stuck = |which| {
            faults.iter().any(
                |kind| matches!(kind, FaultKind::EncoderStuck { channel, .. } if *channel == which),
            )
        };
        if stuck(Channel::A) && stuck(Channel::B) {
            Doubt::Dead
        } else if self.slipped_off[joint]
            || faults
                .iter()
                .any(|kind| matches!(kind, FaultKind::EncoderNoise { .. }))
        {
            Doubt::Uncounted
        } else if faults.len() > 1 || !self.causes.iter().all(|cause| *cause == Cause::Silence) {
            Doubt::Several
        } else {
            Doubt::Single
        }
    }

    /// Checks 3, 4 and 7: what is believed against what is.
    fn truth(&mut self, world: &World) -> Checked {
        let controller = world.controller();
        let safety = controller.safety();
        let Some(machine) = controller.machine() else {
            return Ok(());
        };
        if machine.axes() == 0 || self.foreign {
            return Ok(());
        }
        let (on, known) = (
            safety.drives_on(),
            safety.homed() && safety.position_kept() && safety.state() != State::Homing,
        );
        let truth = world.rig.truth();
        let sound = self.sound(world);
        let quiet = self.causes.iter().all(|cause| *cause == Cause::Silence);
        self.still = if on
            && matches!(safety.state(), State::Idle)
            && machine
                .force
                .as_ref()
                .is_none_or(|force| force.is_inactive())
        {
            self.still + 1
        } else {
            0
        };
        for (joint, reading) in machine.joints().enumerate() {
            let unit = joint_unit(joint);
            let believed = f64::from(reading.measured.0) / unit;
            let off = (believed - world.latched.motor[joint]).abs();
            if world.rig.inputs().axes[joint].index_pulses != self.before.index[joint] {
                self.pulses[joint] += 1;
            }
            if known && on {
                let doubt = self.doubt(joint);
                // Lost steps are less than their limit, and half a play off.
                let unseen = match &machine.config.joints[joint].drive {
                    Drive::Steps { lost, .. } => {
                        f64::from(lost.0) / unit + bounds::MOTOR[class(joint)]
                    }
                    Drive::Torque { .. } => 0.0,
                };
                let unseen = unseen.max(bounds::OFF);
                let (most, from, grace) = match doubt {
                    Doubt::None => {
                        let name = ["motor mm", "motor deg"][class(joint)];
                        self.note(name, off);
                        (f64::INFINITY, bounds::MOTOR[class(joint)], 25)
                    }
                    Doubt::Single => (bounds::FOUND, unseen, bounds::LASTING),
                    Doubt::Uncounted => {
                        let limits = &machine.config.joints[joint];
                        // The jump adds to the error that the joint had before.
                        let reach = way_of_a_jump(limits) / unit + bounds::MOTOR[class(joint)];
                        let from = if self.pulses[joint] > 2 {
                            bounds::INDEX_SLACK[class(joint)]
                        } else {
                            reach
                        };
                        (f64::INFINITY, from, bounds::PUSHED_LASTING)
                    }
                    Doubt::Several => {
                        // Each of them may stay below the bound of one; index pulses show the sum.
                        let together = if self.pulses[joint] > 2 {
                            unseen
                        } else {
                            unseen * self.faults_of(joint).count().max(1) as f64
                        };
                        (bounds::PUSHED, together, bounds::PUSHED_LASTING)
                    }
                    Doubt::Dead => (bounds::TWO_TURNS, unseen, u32::MAX),
                };
                if doubt != Doubt::None {
                    let name = [
                        "",
                        "off after one fault",
                        "off, noise or drives off",
                        "off after several",
                        "off, dead",
                    ][doubt as usize];
                    self.note(name, off);
                }
                self.wrong[joint] = if off > from { self.wrong[joint] + 1 } else { 0 };
                if self.wrong[joint] > grace || off > most {
                    violated!(
                        world,
                        "position wrong",
                        "joint {joint} is believed at {believed:.4} and is at {:.4}, {off:.4} off for {} periods and {} index pulses in {:?}; broken were {:?}",
                        world.latched.motor[joint],
                        self.wrong[joint],
                        self.pulses[joint],
                        safety.state(),
                        self.ever
                    );
                }
            } else {
                self.wrong[joint] = 0;
            }
            let limits = &machine.config.joints[joint];
            // The firmware compares what it measures now with what it commanded a period ago.
            let rate = self.before.joint_rates[joint].abs() / unit;
            if rate > bounds::KNEE {
                self.crept[joint] = 0;
            } else if rate > 0.0 {
                self.crept[joint] = self.crept[joint].saturating_add(1);
            }
            let error = f64::from(
                reading
                    .measured
                    .0
                    .wrapping_sub(self.before.joints[joint] as i64 as i32),
            )
            .abs();
            let lag =
                self.before.joint_rates[joint].abs() * f64::from(limits.following_lag) / 65_536.0;
            let reported = (f64::from(limits.following.0) + lag) * bounds::REPORTED + 4.0;
            self.unreported[joint] = if on && self.before.on && error > reported {
                self.unreported[joint] + 1
            } else {
                0
            };
            if self.unreported[joint] > 3 && !matches!(safety.state(), State::Fault) {
                violated!(
                    world,
                    "following error not reported",
                    "joint {joint} is {:.4} off, limit {:.4}, in {:?}",
                    error / unit,
                    reported / unit,
                    safety.state()
                );
            }
            let target = f64::from(reading.commanded.0) / unit;
            let far = (truth.joints[joint] - target).abs();
            if on && self.before.on {
                self.away[joint] = if known && far > bounds::RUNAWAY[class(joint)] {
                    self.away[joint] + 1
                } else {
                    0
                };
                if self.away[joint] > 50 {
                    violated!(
                        world,
                        "runaway",
                        "joint {joint} is {far:.3} from its target for {} periods in {:?}; broken were {:?}",
                        self.away[joint],
                        safety.state(),
                        self.ever
                    );
                }
                if known
                    && sound
                    && quiet
                    && self.before.homed
                    && !self.causes.contains(&Cause::Contact)
                {
                    let rate = self.before.joint_rates[joint].abs() / unit;
                    let name = ["following mm", "following deg"][class(joint)];
                    let beyond = far - 0.002 * rate;
                    self.note(name, beyond);
                    if beyond > bounds::FOLLOWING[class(joint)] {
                        violated!(
                            world,
                            "following",
                            "joint {joint} is {far:.4} from its target at {rate:.3}/s in {:?}",
                            safety.state()
                        );
                    }
                    if self.still > 5000 && self.steady {
                        let name = ["rest mm", "rest deg"][class(joint)];
                        self.note(name, far);
                        let slow = class(joint) == 0 && self.crept[joint] > bounds::LASTING;
                        let most = if slow {
                            bounds::REST_SLOW
                        } else {
                            bounds::REST[class(joint)]
                        };
                        if far > most {
                            violated!(
                                world,
                                "rest",
                                "joint {joint} rests {far:.4} from its target"
                            );
                        }
                    }
                    let (low, high) = (
                        f64::from(limits.low.0) / unit,
                        f64::from(limits.high.0) / unit,
                    );
                    let at = truth.joints[joint];
                    if at > high + 0.5 || at < low - 0.5 {
                        violated!(world, "stroke", "joint {joint} is at {at}");
                    }
                }
            } else {
                self.away[joint] = 0;
            }
        }
        Ok(())
    }

    /// Check 9: compliance.
    fn force(&mut self, world: &World) -> Checked {
        let controller = world.controller();
        let Some(machine) = controller.machine() else {
            return Ok(());
        };
        let Some(force) = &machine.force else {
            return Ok(());
        };
        let on = controller.safety().drives_on();
        let state = controller.safety().state();
        let truth = world.rig.truth();
        let (reference, commanded) = (machine.reference().pose, machine.motion.commanded().pose);
        for axis in 0..3 {
            // What was really made of it: the commanded reference less the pose without force control.
            let yielded = if on {
                f64::from(reference.0[axis].0.wrapping_sub(commanded.0[axis].0)) / MM
            } else {
                f64::from(force.displacements()[axis].length().0) / MM
            };
            if !on && yielded != 0.0 {
                violated!(
                    world,
                    "yield",
                    "axis {axis} yields {yielded} mm with the drives off"
                );
            }
            if yielded.abs() > self.loops[axis] + 0.001 {
                violated!(
                    world,
                    "yield",
                    "axis {axis} yields {yielded} mm of at most {}",
                    self.loops[axis]
                );
            }
            let settings = force.settings(axis);
            let desired = settings.map_or(0.0, |settings| f64::from(settings.desired.0) / 65_536.0);
            let pressed = truth.force[axis];
            let yields = force.mask() & (1 << axis) != 0
                && matches!(state, State::Run)
                && settings.is_some_and(|settings| settings.gate == Gate::Any)
                && force.condition().is_none()
                && force.conditioner().tared()
                && self.sound(world);
            let (periods, from) = &mut self.pushed[axis];
            if yields && pressed.abs() > desired + 3.0 {
                if *periods == 0 {
                    *from = yielded;
                }
                *periods += 1;
                let along = (yielded - *from) * pressed.signum();
                if *periods > 1500 && along < 0.0 && yielded * pressed.signum() < 0.0 {
                    violated!(
                        world,
                        "compliance",
                        "axis {axis}: {pressed:.2} N, and the tool went {along:.3} mm against it"
                    );
                }
            } else {
                *periods = 0;
            }
        }
        Ok(())
    }

    /// Check 9: the haptic arm.
    fn haptic(&mut self, world: &World) -> Checked {
        let controller = world.controller();
        let Some(machine) = controller.machine() else {
            return Ok(());
        };
        let (Some(arm), Some(config)) = (machine.masters.arm(), &machine.config.haptic) else {
            return Ok(());
        };
        let outputs = &world.rig.outputs().haptic;
        for (leg, currents) in outputs.currents.iter().enumerate() {
            for (motor, code) in currents.iter().enumerate() {
                let drive = &config.drives[leg][motor];
                let most =
                    f64::from(drive.limit.0) / f64::from(drive.full_scale.0).abs() * 8192.0 + 1.0;
                if f64::from(*code).abs() > most {
                    violated!(
                        world,
                        "haptic current",
                        "leg {leg} motor {motor}: code {code} of at most {most}"
                    );
                }
                if *code != 0 && !outputs.enabled {
                    violated!(world, "haptic current", "code {code} while disabled");
                }
            }
        }
        if outputs.enabled && !world.rig.inputs().haptic.drives_ready {
            violated!(
                world,
                "haptic current",
                "enabled, and the amplifiers are tripped"
            );
        }
        let force = arm.force().map(|force| f64::from(force.0));
        let step = f64::from(config.step.0);
        // A motor at its limit makes the whole force smaller by one factor. So 1/factor times the force is within a step of the force before, in each axis; 1 where no motor is at its limit.
        let cut = outputs.currents.iter().enumerate().any(|(leg, currents)| {
            currents.iter().enumerate().any(|(motor, code)| {
                let drive = &config.drives[leg][motor];
                let most = f64::from(drive.limit.0) / f64::from(drive.full_scale.0).abs() * 8192.0;
                f64::from(*code).abs() > most - 2.0
            })
        });
        if outputs.enabled && self.before.valid && !self.foreign {
            let (mut least, mut most) = (1.0_f64, if cut { f64::INFINITY } else { 1.0 });
            for axis in 0..3 {
                let (is, was) = (force[axis], self.before.haptic[axis]);
                // The firmware cuts the product and the factor to whole units.
                let slack = step + 2.0 + if cut { was.abs() / 32_768.0 } else { 0.0 };
                if is.abs() > 2.0 {
                    let ends = [(was - slack) / is, (was + slack) / is];
                    least = least.max(ends[0].min(ends[1]) - 1.0 / is.abs());
                    most = most.min(ends[0].max(ends[1]) + 1.0 / is.abs());
                } else if !cut && was.abs() > slack + 2.0 {
                    most = 0.0;
                }
            }
            if least > most {
                violated!(
                    world,
                    "haptic step",
                    "the force went from {:?} to {force:?} in a period, a step is {step}, a motor at its limit {cut}",
                    self.before.haptic
                );
            }
        }
        self.before.haptic = force;
        Ok(())
    }

    /// Check 8: telemetry.
    fn telemetry(&mut self, world: &World) -> Checked {
        let controller = world.controller();
        let safety = controller.safety();
        let commanded = controller.machine().map_or([0; 6], |machine| {
            machine.motion.commanded().pose.0.map(|place| place.0)
        });
        self.history.push_back((
            world.rig.inputs().period,
            safety.state(),
            commanded,
            safety.homed() && safety.position_kept(),
        ));
        if self.history.len() > 3000 {
            self.history.pop_front();
        }
        let Some(telemetry) = &world.telemetry else {
            return Ok(());
        };
        let at = self
            .history
            .binary_search_by_key(&telemetry.period, |entry| entry.0);
        let Ok(at) = at else { return Ok(()) };
        let (period, state, commanded, known) = &self.history[at];
        let same = telemetry.state == *state
            && telemetry
                .commanded
                .iter()
                .zip(commanded)
                .all(|(a, b)| a == b)
            && (telemetry.homed && telemetry.position_kept) == *known;
        if !same {
            violated!(
                world,
                "telemetry",
                "of period {period}: {telemetry:?}; it was {state:?} at {commanded:?}, position known {known}"
            );
        }
        Ok(())
    }

    fn remember(&mut self, world: &World) {
        let controller = world.controller();
        let safety = controller.safety();
        let haptic = self.before.haptic;
        let mut before = Before {
            state: safety.state(),
            on: safety.drives_on(),
            homed: safety.homed(),
            kept: safety.position_kept(),
            configured: controller.machine().is_some(),
            haptic,
            locking: controller
                .machine()
                .is_some_and(|machine| machine.is_locking()),
            valid: true,
            pose: self.pose(world),
            ..Before::default()
        };
        for (slot, axis) in before.index.iter_mut().zip(&world.rig.inputs().axes) {
            *slot = axis.index_pulses;
        }
        if let Some(machine) = controller.machine() {
            let target = machine.target();
            if self.before.locking && !before.locking {
                self.locked_at = target.joints.0.map(|place| f64::from(place.0));
            }
            for axis in 0..machine.axes() {
                before.rates[axis] = f64::from(machine.motion.commanded().rates[axis].0);
                before.joints[axis] = f64::from(target.joints.0[axis].0);
                before.joint_rates[axis] = f64::from(target.rates[axis].0);
                before.sources[axis] = machine.motion.source(axis);
            }
        }
        self.steady = before.on
            && (self.steady || (self.before.state == State::Homing && before.state == State::Idle));
        if before.homed && !self.before.homed && before.kept && world.broken.is_empty() {
            // The references are new: what was wrong with the counters before the homing is over.
            let during = self.slipped_homing;
            self.suspect = during;
            self.slipped_off = [false; 6];
            self.fastest = [0.0; 6];
            self.ever.retain(|kind| {
                let mut joints = super::script::JOINTS.iter();
                let joint = joints.position(|joint| Some(*joint) == kind.axis());
                joint.is_some_and(|joint| during[joint])
                    || !matches!(
                        kind,
                        FaultKind::EncoderSlip { .. } | FaultKind::EncoderNoise { .. }
                    )
            });
        }
        if before.state != State::Homing {
            self.slipped_homing = [false; 6];
        }
        self.before = before;
    }

    /// All is whole again, and the machine was homed.
    pub fn recovered(&mut self, world: &World) {
        if world.broken.is_empty() && self.before.homed && self.before.kept {
            self.causes
                .retain(|cause| matches!(cause, Cause::Contact | Cause::Lead | Cause::Refitted));
        }
    }

    /// A request for a fingerprint: all that a refused command may not change.
    #[must_use]
    pub fn fingerprint(world: &World) -> String {
        let controller = world.controller();
        let safety = controller.safety();
        let mut text = format!(
            "state {:?} fault {:?} homed {} kept {}\n",
            safety.state(),
            safety.fault(),
            safety.homed(),
            safety.position_kept()
        );
        let all = format!("{controller:?}");
        if let Some(at) = all.rfind("job: Job {") {
            let changing = [
                "since_urgent",
                "digest_backlog",
                "busy",
                "missed",
                "stale_commands",
                // Inputs: counts before the first configuration, of slides that somebody moves.
                "axes: [Counted {",
                "Counted {",
                "illegal_raw",
                "travelled",
                "illegal",
                "widest",
            ];
            for field in all[at..].split(", ") {
                if !changing.iter().any(|name| field.starts_with(name)) {
                    text.push_str(field);
                    text.push('\n');
                }
            }
        }
        if let Some(machine) = controller.machine() {
            text.push_str(&format!(
                "crc {} wanted {:?}\n",
                machine.crc,
                machine.motion.commanded()
            ));
            for field in format!("{:?}", machine.motion).split(", ") {
                text.push_str(field);
                text.push('\n');
            }
            if let Some(force) = &machine.force {
                text.push_str(&format!(
                    "force {} {} {:?}\n",
                    force.mask(),
                    force.conditioner().tared(),
                    [0, 1, 2].map(|axis| force.settings(axis).cloned())
                ));
            }
        }
        text
    }

    /// Whether the controller stands, so that a fingerprint stays as it is.
    #[must_use]
    pub fn stands(world: &World) -> bool {
        let controller = world.controller();
        let state = controller.safety().state();
        let machine = controller.machine();
        // A tool that returns from where it yielded to is no standstill.
        if !machine
            .and_then(|machine| machine.force.as_ref())
            .is_none_or(|force| force.is_inactive())
        {
            return false;
        }
        matches!(
            state,
            State::Idle | State::Disabled | State::Fault | State::EmergencyStop
        ) || (state == State::Hold
            && controller
                .machine()
                .is_some_and(|machine| machine.motion.is_at_standstill()))
    }

    /// The first line in which two fingerprints differ.
    #[must_use]
    pub fn difference(before: &str, after: &str) -> Option<String> {
        before
            .lines()
            .zip(after.lines())
            .find(|(a, b)| a != b)
            .map(|(a, b)| format!("{a} became {b}"))
    }
}

/// Whether a broken device leads to this fault.
fn explains(kind: &FaultKind, fault: &Fault) -> bool {
    use FaultKind as K;
    let joint = kind.axis().and_then(|axis| {
        super::script::JOINTS
            .iter()
            .position(|joint| *joint == axis)
    });
    let of = |axis: &u8| Some(usize::from(*axis)) == joint;
    match kind {
        K::EncoderStuck { .. } => match fault {
            Fault::EncoderStuck { axis }
            | Fault::EncoderReversed { axis }
            | Fault::EncoderIllegal { axis, .. }
            | Fault::EncoderSlip { axis, .. }
            | Fault::StepsLost { axis, .. }
            | Fault::FollowingError { axis, .. }
            | Fault::Homing { axis, .. }
            | Fault::Stroke { axis, .. } => of(axis),
            Fault::LimitSwitch { .. } | Fault::Pose(_) => true,
            _ => false,
        },
        K::EncoderSwapped { .. } => match fault {
            Fault::EncoderStuck { axis }
            | Fault::EncoderReversed { axis }
            | Fault::EncoderIllegal { axis, .. }
            | Fault::EncoderSlip { axis, .. }
            | Fault::StepsLost { axis, .. }
            | Fault::Homing { axis, .. } => of(axis),
            _ => false,
        },
        K::EncoderSlip { .. } => match fault {
            Fault::EncoderIllegal { axis, .. }
            | Fault::EncoderSlip { axis, .. }
            | Fault::EncoderStuck { axis }
            | Fault::EncoderReversed { axis }
            | Fault::StepsLost { axis, .. }
            | Fault::FollowingError { axis, .. }
            | Fault::Homing { axis, .. }
            | Fault::Stroke { axis, .. } => of(axis),
            Fault::Pose(_) => true,
            _ => false,
        },
        K::EncoderNoise { .. } => match fault {
            Fault::EncoderIllegal { axis, .. }
            | Fault::EncoderSlip { axis, .. }
            | Fault::EncoderStuck { axis }
            | Fault::EncoderReversed { axis }
            | Fault::StepsLost { axis, .. }
            | Fault::FollowingError { axis, .. }
            | Fault::Homing { axis, .. } => of(axis),
            _ => false,
        },
        K::IndexMissing { .. } => matches!(fault, Fault::Homing { axis, .. } if of(axis)),
        K::DriveTripped { .. } => matches!(fault, Fault::Drive { axis } if of(axis)),
        K::DriveDead { .. }
        | K::DriveWeak { .. }
        | K::DriveReversed { .. }
        | K::SlideJammed { .. }
        | K::Push { .. } => match fault {
            Fault::FollowingError { axis, .. }
            | Fault::EncoderStuck { axis }
            | Fault::EncoderReversed { axis }
            | Fault::StepsLost { axis, .. }
            | Fault::NotLocked { axis, .. }
            | Fault::Homing { axis, .. }
            | Fault::Stroke { axis, .. } => of(axis),
            Fault::LimitSwitch { axis } => of(axis),
            // What a joint does that runs away is seen by a sensor of force, and in the pose.
            Fault::Pose(_) => true,
            _ => false,
        },
        K::SwitchStuck { switch, active, .. } => {
            *switch != Switch::Home
                && *active
                && matches!(fault, Fault::LimitSwitch { axis } if of(axis))
        }
        K::SensorStuck { .. }
        | K::SensorDropped { .. }
        | K::SensorReversed { .. }
        | K::SensorDrift { .. }
        | K::SensorSaturated { .. }
        | K::SpindleStalled => matches!(fault, Fault::Force(_)),
        K::HapticArm(HapticFault::AmplifiersTripped) => matches!(fault, Fault::Master(_)),
        K::HapticArm(_) => matches!(fault, Fault::Master(_)),
        _ => false,
    }
}
