//! Episodes: what a seed stands for. A script is data, so a failing one can be shortened and run again.

use super::command;
use haptimill_hil_sim::fault::{
    Along, Channel, FaultKind, HapticEncoder, HapticFault, HapticSensor, Level, Switch,
};
use haptimill_hil_sim::random::Random;
use haptimill_protocol::message::Command;

/// Draws from the stream of a seed.
#[derive(Debug, Clone)]
pub struct Dice(Random);

impl Dice {
    /// The dice of a seed.
    #[must_use]
    pub const fn new(seed: u64, stream: u64) -> Self {
        Self(Random::new(seed, stream))
    }

    /// 64 random bits.
    pub const fn bits(&mut self) -> u64 {
        self.0.draw()
    }

    /// A whole number from 0 to below `count`.
    pub const fn below(&mut self, count: u64) -> u64 {
        self.0.draw() % count
    }

    /// A place in a list of so many.
    pub const fn place(&mut self, count: usize) -> usize {
        (self.0.draw() % count as u64) as usize
    }

    /// A number between two.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.fraction()
    }

    /// A number between two positive ones, its logarithm evenly spread.
    pub fn spread(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.0.fraction())
    }

    /// True with a probability.
    pub const fn happens(&mut self, probability: f64) -> bool {
        self.0.happens(probability)
    }

    /// One of a list.
    pub fn pick<T: Clone>(&mut self, list: &[T]) -> T {
        list[self.place(list.len())].clone()
    }
}

/// What an episode is about: it says which stimuli there are, and which checks hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Theme {
    /// No fault, and nothing but valid commands of a careful host.
    Healthy,
    /// The same with force control and something at the tool.
    Force,
    /// The same with a hand that leads the tool, or with a master arm.
    Hand,
    /// One fault of the machine.
    Fault,
    /// Several faults of the machine.
    Faults,
    /// Any command in any state with any arguments.
    Wild,
    /// A bad serial line, and hosts that come and go.
    Line,
    /// Mutated configurations.
    Config,
    /// Corrupted files for the parsers of the host.
    Files,
}

impl Theme {
    /// All of them, each with its weight.
    pub const ALL: [(Self, u64); 9] = [
        (Self::Healthy, 24),
        (Self::Force, 8),
        (Self::Hand, 7),
        (Self::Fault, 24),
        (Self::Faults, 8),
        (Self::Wild, 14),
        (Self::Line, 7),
        (Self::Config, 6),
        (Self::Files, 2),
    ];

    /// Whether a fault that latches is a false alarm.
    #[must_use]
    pub const fn healthy(self) -> bool {
        matches!(self, Self::Healthy | Self::Force | Self::Hand)
    }

    /// Whether the line between host and controller is perfect.
    #[must_use]
    pub const fn clean_line(self) -> bool {
        !matches!(self, Self::Line | Self::Wild)
    }
}

/// Which machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// `machines/h4.toml`.
    Torque,
    /// `machines/h4-step.toml`.
    Step,
    /// The first one with a haptic arm.
    Hand,
    /// The first one, which follows a hand afar.
    Follow,
    /// A haptic arm alone.
    Master,
}

/// How a job is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JobPlan {
    /// Its dice.
    pub seed: u64,
    /// Setpoints.
    pub count: u16,
    /// Periods from one to the next, about.
    pub span: u16,
    /// Part of the largest rates at which it goes.
    pub speed: f64,
    /// Spindle and pauses.
    pub actions: bool,
    /// The host stops to send for so many periods, in the middle.
    pub gap: u16,
    /// Part of the setpoints that make no sense.
    pub absurd: f64,
    /// The host never says that the job is complete.
    pub open: bool,
}

/// Something that happens.
#[derive(Debug, Clone, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "scripts are short; a box would hide the values in a printed one"
)]
pub enum What {
    /// Nothing.
    Wait,
    /// The host says this, whatever the answer.
    Say(Command),
    /// At standstill; a refusal may change nothing.
    Probe(Command),
    /// A job from the pose where the machine stands.
    Job(JobPlan),
    /// Jogs of these parts of the largest rates, said again and again for as long as the step takes.
    Jog {
        /// Parts of the largest rates.
        rates: [f64; 5],
        /// Dead-man, ms.
        deadline_ms: u16,
        /// Periods between two.
        every: u16,
        /// How far the epoch goes on before.
        epoch: i16,
        /// At the end the host cancels; else the deadline ends the motion.
        cancel: bool,
    },
    /// A jog of an old or cancelled epoch.
    StaleJog,
    /// The host does all that gets the machine homed and idle.
    Ready,
    /// The host waits until the machine is idle, for no more than the periods of the step.
    Idle,
    /// Another host greets, or the same one again.
    Greet,
    /// The host neither hears nor speaks, or does again.
    Away(bool),
    /// The urgent stop, past the link.
    Urgent,
    /// Bytes that are no frame.
    Garbage(Vec<u8>),
    /// What becomes of bytes in either direction: probabilities of a flipped bit, a lost byte, a doubled byte.
    Line([[f64; 3]; 2]),
    /// The emergency stop circuit opens or closes.
    Circuit(bool),
    /// A device breaks.
    Break(FaultKind),
    /// Something leans on a joint, harder and harder over the periods of the step, until it is healed.
    Lean(usize, f64),
    /// All devices are whole again.
    Heal,
    /// The controller misses so many periods.
    Miss(u16),
    /// A body at the tool: an elastic wall at a distance in mm, with a stiffness; or a block that can be cut; or nothing.
    Contact(Option<(u8, f64, f64)>),
    /// A block that is cut.
    Block,
    /// The configuration is sent anew with so many mutations drawn from these dice; `preset` is [`Command::Activate`]'s.
    Configure {
        /// Dice of the mutations.
        seed: u64,
        /// How many; 0 sends the machine's own.
        mutations: u8,
        /// Counting from the presets.
        preset: bool,
    },
    /// The person at the haptic arm wants the tip there, mm from home, and holds the button or not.
    Lead([f64; 3], bool),
    /// A hand afar says where it is for as long as the step takes: dice, age in ms.
    Afar(u64, u8),
    /// A corrupted file for a parser of the host.
    File(u64),
}

/// One step of a script.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// What happens.
    pub what: What,
    /// Control periods until the next one.
    pub periods: u32,
}

/// An episode.
#[derive(Debug, Clone, PartialEq)]
pub struct Episode {
    /// Its seed.
    pub seed: u64,
    /// What it is about.
    pub theme: Theme,
    /// On which machine.
    pub kind: Kind,
    /// Speed of the line.
    pub baud: Option<u32>,
    /// Efforts on the joints before the first configuration.
    pub pushed: Option<[f64; 5]>,
    /// Whether inputs and outputs are recorded and replayed.
    pub replayed: bool,
    /// What happens.
    pub script: Vec<Step>,
}

/// Names of the joints of the H-4 machines.
pub const JOINTS: [&str; 5] = ["l1", "l2", "l3", "l4", "alpha"];

impl Episode {
    /// The episode of a seed.
    #[must_use]
    pub fn of(seed: u64) -> Self {
        let mut dice = Dice::new(seed, 900);
        let total: u64 = Theme::ALL.iter().map(|(_, weight)| weight).sum();
        let mut at = dice.below(total);
        let mut theme = Theme::Healthy;
        for (other, weight) in Theme::ALL {
            if at < weight {
                theme = other;
                break;
            }
            at -= weight;
        }
        let kind = match theme {
            Theme::Hand => dice.pick(&[Kind::Hand, Kind::Hand, Kind::Follow, Kind::Master]),
            Theme::Wild => dice.pick(&[
                Kind::Torque,
                Kind::Torque,
                Kind::Step,
                Kind::Hand,
                Kind::Follow,
                Kind::Master,
            ]),
            Theme::Faults | Theme::Fault => dice.pick(&[
                Kind::Torque,
                Kind::Torque,
                Kind::Torque,
                Kind::Step,
                Kind::Step,
                Kind::Hand,
            ]),
            Theme::Force | Theme::Config => Kind::Torque,
            _ => dice.pick(&[Kind::Torque, Kind::Torque, Kind::Step]),
        };
        let baud = dice
            .happens(0.2)
            .then(|| dice.pick(&[115_200, 460_800, 921_600]));
        let pushed = (kind != Kind::Master && dice.happens(0.03)).then(|| {
            core::array::from_fn(|joint| {
                let most = if joint == 4 { 6.0 } else { 130.0 };
                if dice.happens(0.5) {
                    dice.between(-most, most)
                } else {
                    0.0
                }
            })
        });
        let replayed = dice.happens(0.12);
        let script = script(theme, kind, &mut dice);
        Self {
            seed,
            theme,
            kind,
            baud,
            pushed,
            replayed,
            script,
        }
    }

    /// The script in lines, for people.
    #[must_use]
    pub fn describe(&self) -> String {
        let mut text = format!(
            "seed {}: {:?} on {:?}, baud {:?}, pushed before configuration {:?}\n",
            self.seed, self.theme, self.kind, self.baud, self.pushed
        );
        for step in &self.script {
            text.push_str(&format!(
                "  {:?} then {} periods\n",
                step.what, step.periods
            ));
        }
        text
    }
}

fn periods(dice: &mut Dice) -> u32 {
    match dice.below(6) {
        0 | 1 => dice.between(1.0, 50.0) as u32,
        2 | 3 => dice.between(50.0, 800.0) as u32,
        _ => dice.between(800.0, 3000.0) as u32,
    }
}

fn script(theme: Theme, kind: Kind, dice: &mut Dice) -> Vec<Step> {
    let mut script = Vec::new();
    let mut add = |what, periods| script.push(Step { what, periods });
    if theme == Theme::Files {
        for _ in 0..40 {
            add(What::File(dice.bits()), 0);
        }
        return script;
    }
    let count = 3 + dice.place(9);
    let early = matches!(theme, Theme::Wild | Theme::Line | Theme::Config);
    if !(early && dice.happens(0.4)) {
        add(What::Ready, 200);
        if dice.happens(0.6) {
            let every = dice.pick(&[1, 20, 50, 200]);
            add(What::Say(Command::Telemetry { every }), 5);
        }
    }
    if theme == Theme::Force {
        add(What::Say(Command::Tare), 1500);
    }
    let mut broken = 0;
    for index in 0..count {
        if matches!(theme, Theme::Fault) && broken == 0 && (dice.happens(0.4) || index == count - 3)
        {
            broken = 1;
            if dice.happens(0.3) {
                for (what, periods) in trap(kind, dice) {
                    add(what, periods);
                }
                continue;
            }
            let (what, after) = breakage(kind, dice);
            add(what, after);
            continue;
        }
        if theme == Theme::Fault && broken == 1 && dice.happens(0.25) {
            broken = 2;
            add(What::Heal, periods(dice));
            add(What::Ready, 500);
            continue;
        }
        if theme == Theme::Faults && dice.happens(0.35) {
            let (what, after) = breakage(kind, dice);
            add(what, after.min(400));
            continue;
        }
        if theme == Theme::Faults && dice.happens(0.12) {
            for (what, periods) in trap(kind, dice) {
                add(what, periods);
            }
            continue;
        }
        if theme == Theme::Faults && dice.happens(0.15) {
            add(What::Heal, periods(dice));
            add(What::Ready, 500);
            continue;
        }
        let step = match theme {
            Theme::Wild => wild(kind, dice),
            Theme::Line => line(dice),
            Theme::Config => config(dice),
            Theme::Hand => hand(kind, dice),
            Theme::Force => force(dice),
            _ => careful(dice),
        };
        for (what, periods) in step {
            add(what, periods);
        }
    }
    if theme.healthy() || theme == Theme::Fault {
        add(What::Idle, 20_000);
        add(What::Wait, 1500);
    }
    script
}

/// One of the faults that the simulator knows, with how long to wait after it.
fn breakage(kind: Kind, dice: &mut Dice) -> (What, u32) {
    let axis = dice.pick(&JOINTS).to_string();
    let table = axis == "alpha";
    let channel = dice.pick(&[Channel::A, Channel::B]);
    let level = dice.pick(&[Level::Low, Level::High]);
    let along = dice.pick(&[Along::X, Along::Y, Along::Z]);
    let effort = if table { 50.0 } else { 1500.0 };
    let fault = match dice.below(if kind == Kind::Hand { 21 } else { 19 }) {
        0 => FaultKind::EncoderStuck {
            axis,
            channel,
            level,
        },
        1 => FaultKind::EncoderSwapped { axis },
        2 | 3 => {
            let size = dice.spread(1.0, 6000.0) as i32;
            let counts = if dice.happens(0.5) { size } else { -size };
            FaultKind::EncoderSlip { axis, counts }
        }
        4 => FaultKind::EncoderNoise {
            axis,
            per_second: dice.spread(0.5, 50_000.0),
        },
        5 => FaultKind::IndexMissing { axis },
        6 => FaultKind::DriveDead { axis },
        7 => FaultKind::DriveTripped { axis },
        8 => FaultKind::DriveWeak {
            axis,
            gain: dice.pick(&[0.02, 0.1, 0.3, 0.7, 1.5, 3.0]),
        },
        9 => FaultKind::DriveReversed { axis },
        10 => FaultKind::SlideJammed {
            axis,
            effort: dice
                .happens(0.6)
                .then(|| dice.spread(effort * 0.02, effort)),
        },
        11 => {
            let size = dice.spread(effort * 0.02, effort);
            let effort = if dice.happens(0.5) { size } else { -size };
            if dice.happens(0.8) {
                let joint = JOINTS.iter().position(|joint| *joint == axis).unwrap_or(0);
                let over = dice.between(500.0, 8000.0) as u32;
                // Around what the drive can hold against, which is where a following error grows.
                let most = if joint == 4 { 36.0 } else { 750.0 };
                let effort = effort.signum() * most * dice.between(0.5, 1.3);
                return (What::Lean(joint, effort), over);
            }
            FaultKind::Push { axis, effort }
        }
        12 => FaultKind::SwitchStuck {
            axis,
            switch: dice.pick(&[Switch::Home, Switch::LimitLow, Switch::LimitHigh]),
            active: dice.happens(0.8),
        },
        13 => dice.pick(&[
            FaultKind::SensorStuck { along },
            FaultKind::SensorDropped { along },
            FaultKind::SensorReversed { along },
            FaultKind::SensorSaturated { along, level },
            FaultKind::SensorDrift { along, rate: 5.0 },
        ]),
        14 => FaultKind::SpindleStalled,
        15 => return (What::Circuit(true), periods(dice)),
        16 | 17 => {
            let count = dice.spread(1.0, 400.0) as u16;
            return (What::Miss(count), 3000);
        }
        18 => return (What::Away(true), 6000),
        _ => {
            let place = HapticEncoder {
                leg: 1 + dice.below(3) as u8,
                sensor: dice.pick(&[HapticSensor::Slide, HapticSensor::Turn, HapticSensor::Hinge]),
            };
            FaultKind::HapticArm(dice.pick(&[
                HapticFault::EncoderStuck {
                    place,
                    channel,
                    level,
                },
                HapticFault::EncoderSwapped(place),
                HapticFault::EncoderSlip { place, counts: 500 },
                HapticFault::EncoderDropped(place),
                HapticFault::EncoderNoise {
                    place,
                    per_second: 20_000.0,
                },
                HapticFault::AmplifiersTripped,
            ]))
        }
    };
    (What::Break(fault), periods(dice))
}

/// Faults that need a machine in a certain state: with its drives off, in a jog, or with other faults of the same joint.
fn trap(kind: Kind, dice: &mut Dice) -> Vec<(What, u32)> {
    let axis = dice.pick(&JOINTS).to_string();
    let joint = JOINTS.iter().position(|name| *name == axis).unwrap_or(0);
    let part = if joint == 4 { 0.04 } else { 1.0 };
    let slip = |dice: &mut Dice, most| {
        let size = dice.spread(1.0, most) as i32;
        FaultKind::EncoderSlip {
            axis: axis.clone(),
            counts: if dice.happens(0.5) { size } else { -size },
        }
    };
    let push = |dice: &mut Dice| dice.pick(&[-1.0, 1.0]) * dice.spread(30.0, 300.0) * part;
    match dice.below(if kind == Kind::Step { 4 } else { 3 }) {
        0 => vec![
            // A counter jumps while the drives are off.
            (What::Idle, 20_000),
            (What::Say(Command::Disable), periods(dice)),
            (What::Break(slip(dice, 60_000.0)), periods(dice)),
            (What::Say(Command::Enable), 1200),
            (What::Ready, 200),
        ],
        1 => vec![
            // An encoder is reversed, or loses a channel, in a jog.
            (What::Idle, 20_000),
            (creep(dice), dice.between(50.0, 2500.0) as u32),
            (
                What::Break(if dice.happens(0.6) {
                    FaultKind::EncoderSwapped { axis }
                } else {
                    FaultKind::EncoderStuck {
                        axis,
                        channel: dice.pick(&[Channel::A, Channel::B]),
                        level: dice.pick(&[Level::Low, Level::High]),
                    }
                }),
                2500,
            ),
        ],
        2 => {
            // Slip, noise, a stuck channel and a push, one after the other on one joint.
            let channel = dice.pick(&[Channel::A, Channel::B]);
            let mut steps = vec![(What::Idle, 20_000), (creep(dice), 200)];
            for _ in 0..3 {
                let hold = 5 + dice.spread(10.0, 1500.0) as u32;
                let kind = match dice.below(4) {
                    0 => slip(dice, 1000.0),
                    1 => FaultKind::EncoderNoise {
                        axis: axis.clone(),
                        per_second: dice.spread(1.0, 200.0),
                    },
                    2 => FaultKind::EncoderStuck {
                        axis: axis.clone(),
                        channel,
                        level: dice.pick(&[Level::Low, Level::High]),
                    },
                    _ => FaultKind::Push {
                        axis: axis.clone(),
                        effort: push(dice),
                    },
                };
                steps.push((What::Break(kind), hold));
                if dice.happens(0.4) {
                    steps.push((What::Heal, 5));
                }
            }
            steps
        }
        _ => vec![
            // Step motors lose their current in motion, and something moves them while it is off.
            (What::Idle, 20_000),
            (jog(dice), dice.between(300.0, 2500.0) as u32),
            (creep(dice), dice.between(50.0, 900.0) as u32),
            (What::Circuit(true), dice.between(1.0, 400.0) as u32),
            (
                What::Break(FaultKind::Push {
                    axis,
                    effort: push(dice) * 0.3,
                }),
                dice.between(5.0, 300.0) as u32,
            ),
            (What::Heal, periods(dice)),
            (What::Ready, 500),
        ],
    }
}

/// A jog of one coordinate that is said once and lives for a second.
fn creep(dice: &mut Dice) -> What {
    let axis = dice.place(5);
    let unit = if axis < 3 {
        super::watch::MM
    } else {
        super::watch::DEGREE
    };
    let speed = dice.pick(&[-1.0, 1.0]) * dice.spread(0.01, 16.0);
    let mut rates = [0; 5];
    rates[axis] = (speed * unit / 256.0) as i32;
    What::Say(Command::Jog {
        epoch: 1000 + dice.below(20_000) as u16,
        deadline_ms: 1000,
        rates: rates.into_iter().collect(),
    })
}

/// A job of a careful host.
fn job(dice: &mut Dice) -> What {
    let tight = dice.happens(0.15);
    What::Job(JobPlan {
        seed: dice.bits(),
        count: if tight {
            40 + dice.below(300) as u16
        } else {
            6 + dice.below(60) as u16
        },
        span: if tight {
            dice.spread(10.0, 40.0) as u16
        } else {
            dice.spread(40.0, 900.0) as u16
        },
        speed: dice.spread(0.02, 0.9),
        actions: dice.happens(0.4),
        gap: if dice.happens(0.2) {
            dice.spread(100.0, 4000.0) as u16
        } else {
            0
        },
        absurd: 0.0,
        open: dice.happens(0.08),
    })
}

fn jog(dice: &mut Dice) -> What {
    let mut rates = [0.0; 5];
    for rate in &mut rates {
        if dice.happens(0.4) {
            *rate = dice.pick(&[-1.0, 1.0]) * dice.spread(0.01, 1.2);
        }
    }
    What::Jog {
        rates,
        deadline_ms: dice.pick(&[60, 150, 300, 1000]),
        every: dice.pick(&[50, 200, 250]),
        epoch: 1,
        cancel: dice.happens(0.6),
    }
}

/// What a careful host does with a healthy machine.
fn careful(dice: &mut Dice) -> Vec<(What, u32)> {
    let percent = dice.pick(&[1, 10, 37, 50, 80, 100]);
    match dice.below(20) {
        0 => {
            // A long job whose override outlasts a hold.
            let long = What::Job(JobPlan {
                seed: dice.bits(),
                count: 40,
                span: 400,
                speed: dice.spread(0.05, 0.5),
                actions: dice.happens(0.3),
                gap: 0,
                absurd: 0.0,
                open: false,
            });
            let percent = dice.pick(&[20, 37, 50, 80]);
            vec![
                (What::Idle, 6000),
                (long, 1000),
                (What::Say(Command::Override { percent }), 1500),
                (What::Say(Command::Hold), dice.between(100.0, 2500.0) as u32),
                (What::Say(Command::Resume), 6000),
                (What::Say(Command::Override { percent: 100 }), 500),
            ]
        }
        1..=6 => {
            let run = dice.spread(200.0, 8000.0) as u32;
            let mut steps = vec![(What::Idle, 6000), (job(dice), run)];
            for _ in 0..dice.below(4) {
                let wait = dice.spread(20.0, 4000.0) as u32;
                match dice.below(6) {
                    0 | 1 => {
                        steps.push((What::Say(Command::Hold), wait));
                        if dice.happens(0.3) {
                            let half = Command::Override {
                                percent: percent.max(20),
                            };
                            steps.push((What::Say(half), 100));
                        }
                        steps.push((What::Say(Command::Resume), 3000));
                    }
                    2 | 3 => steps.push((What::Say(Command::Override { percent }), wait)),
                    4 => steps.push((What::Say(Command::Stop), wait + 3000)),
                    _ => {
                        steps.push((What::Urgent, 2600));
                        steps.push((What::Say(Command::Resume), wait));
                    }
                }
            }
            steps.push((What::Say(Command::Override { percent: 100 }), 200));
            steps
        }
        7 => {
            // To a bound of the workspace, and fast along it.
            let far = dice.between(8000.0, 30_000.0) as u32;
            vec![
                (What::Idle, 6000),
                (jog(dice), far),
                (jog(dice), far / 3),
                (jog(dice), 3000),
            ]
        }
        8..=11 => {
            let long = dice.spread(300.0, 20_000.0) as u32;
            vec![(What::Idle, 6000), (jog(dice), long)]
        }
        12 => vec![(What::Idle, 6000), (What::StaleJog, 400)],
        13 => vec![
            (What::Idle, 6000),
            (What::Say(Command::Disable), periods(dice)),
            (What::Say(Command::Enable), 400),
        ],
        14 => vec![
            (What::Idle, 6000),
            (What::Probe(command::any(dice)), 20),
            (What::Probe(command::any(dice)), 20),
            (What::Probe(command::refused(dice)), 20),
            (What::Ready, 100),
        ],
        15 => {
            let held = dice.spread(1.0, 2000.0) as u32;
            vec![
                (What::Circuit(true), held),
                (What::Circuit(false), periods(dice)),
                (What::Ready, 200),
            ]
        }
        16 => vec![
            (What::Say(Command::EmergencyStop), periods(dice)),
            (What::Ready, 200),
        ],
        17 => vec![(What::Greet, 400), (What::Ready, 100)],
        18 => vec![(What::Idle, 6000), (What::Say(Command::Home), 4000)],
        _ => {
            let axis = dice.below(5) as u8;
            let source = dice.pick(&[
                haptimill_protocol::message::Source::Hold,
                haptimill_protocol::message::Source::Jog,
            ]);
            vec![
                (What::Idle, 6000),
                (What::Say(Command::Source { axis, source }), 20),
                (job(dice), 4000),
                (jog(dice), 3000),
                (What::Idle, 20_000),
                (
                    What::Say(Command::Source {
                        axis,
                        source: haptimill_protocol::message::Source::Program,
                    }),
                    20,
                ),
            ]
        }
    }
}

fn force(dice: &mut Dice) -> Vec<(What, u32)> {
    let axis = dice.below(3) as u8;
    match dice.below(9) {
        8 => {
            // So slowly that the slides stick and slip, towards a body to which the tool yields.
            let gap = dice.between(0.02, 0.3);
            let stiffness = dice.spread(2.0, 60.0);
            vec![
                (What::Idle, 20_000),
                (What::Say(Command::ForceMask { mask: 0 }), 800),
                (What::Say(Command::Tare), 1500),
                (
                    What::Say(Command::ForceLoop {
                        axis,
                        settings: command::yielding_loop(dice),
                    }),
                    400,
                ),
                (What::Say(Command::ForceMask { mask: 1 << axis }), 20),
                (What::Contact(Some((axis, gap, stiffness))), 20),
                (
                    What::Job(JobPlan {
                        seed: ((dice.between(300.0, 1500.0) as u64) << 3) | u64::from(axis + 1),
                        count: 0,
                        span: 500,
                        speed: dice.spread(0.0004, 0.01),
                        actions: true,
                        gap: 0,
                        absurd: 0.0,
                        open: false,
                    }),
                    14_000,
                ),
                (What::Say(Command::Stop), 3000),
                (What::Contact(None), 6000),
                (What::Say(Command::ForceMask { mask: 0 }), 400),
            ]
        }
        0 => vec![
            (What::Idle, 20_000),
            (What::Contact(None), 400),
            (What::Say(Command::Tare), 1500),
        ],
        1 | 2 => {
            let settings = command::sound_loop(dice);
            vec![(What::Say(Command::ForceLoop { axis, settings }), 400)]
        }
        3 => vec![(
            What::Say(Command::ForceMask {
                mask: dice.below(8) as u8,
            }),
            400,
        )],
        4 | 5 => {
            let gap = dice.between(0.2, 3.0);
            let stiffness = dice.spread(2.0, 60.0);
            vec![
                (What::Idle, 20_000),
                (What::Say(Command::ForceMask { mask: 0 }), 800),
                (What::Say(Command::Tare), 1500),
                (
                    What::Say(Command::ForceLoop {
                        axis,
                        settings: command::yielding_loop(dice),
                    }),
                    400,
                ),
                (What::Say(Command::ForceMask { mask: 1 << axis }), 20),
                (What::Contact(Some((axis, gap, stiffness))), 20),
                (towards(axis, gap, stiffness, dice), 14_000),
                (What::Say(Command::Stop), 3000),
                (What::Contact(None), 6000),
                (What::Say(Command::ForceMask { mask: 0 }), 400),
            ]
        }
        6 => vec![
            (What::Idle, 20_000),
            (What::Say(Command::ForceMask { mask: 0 }), 800),
            (What::Say(Command::Tare), 1500),
            (What::Say(Command::ForceMask { mask: 1 }), 20),
            (What::Block, 20),
            (
                What::Job(JobPlan {
                    seed: dice.bits() & !7,
                    count: 0,
                    span: 500,
                    speed: dice.between(0.02, 0.06),
                    actions: true,
                    gap: 0,
                    absurd: 0.0,
                    open: false,
                }),
                20_000,
            ),
            (What::Say(Command::Stop), 3000),
            (What::Contact(None), 8000),
            (What::Say(Command::ForceMask { mask: 0 }), 400),
        ],
        _ => careful(dice),
    }
}

/// A slow job towards a wall in the negative direction of an axis, into it no farther than the force limit allows.
fn towards(axis: u8, gap: f64, stiffness: f64, dice: &mut Dice) -> What {
    // The distance is packed into the seed: micrometres above the axis.
    let into = (30.0 / stiffness).min(6.0);
    let micrometres = ((gap + into) * 1000.0) as u64;
    What::Job(JobPlan {
        seed: (micrometres << 3) | u64::from(axis + 1),
        count: 0,
        span: 500,
        speed: dice.between(0.03, 0.08),
        actions: true,
        gap: 0,
        absurd: 0.0,
        open: false,
    })
}

fn hand(kind: Kind, dice: &mut Dice) -> Vec<(What, u32)> {
    use haptimill_protocol::message::Source;
    let to = core::array::from_fn(|_| dice.between(-15.0, 15.0));
    let lead = What::Lead(to, dice.happens(0.8));
    if kind == Kind::Master {
        return match dice.below(6) {
            0 => vec![(What::Say(Command::Disable), 200), (What::Ready, 100)],
            1 => vec![(What::Say(command::reflect(dice)), 200)],
            2 => vec![(What::Say(command::wall(dice)), 1000)],
            3 => vec![(What::Say(command::feel(dice)), 400)],
            4 => vec![(
                What::Say(Command::MasterTelemetry {
                    every: dice.pick(&[1, 10, 50]),
                }),
                200,
            )],
            _ => vec![(lead, 3000)],
        };
    }
    match dice.below(6) {
        0 | 1 => {
            let master = |axis| {
                What::Say(Command::Source {
                    axis,
                    source: Source::Master,
                })
            };
            let back = |axis| {
                What::Say(Command::Source {
                    axis,
                    source: Source::Program,
                })
            };
            let mut steps = vec![(What::Idle, 20_000)];
            for axis in 0..3 {
                if dice.happens(0.6) {
                    steps.push((master(axis), 20));
                }
            }
            steps.push((
                What::Job(JobPlan {
                    seed: 0,
                    count: 1,
                    span: 60_000,
                    speed: 0.0,
                    actions: false,
                    gap: 0,
                    absurd: 0.0,
                    open: false,
                }),
                60,
            ));
            if kind == Kind::Hand {
                steps.push((lead, 6000));
                steps.push((What::Lead([0.0; 3], true), 6000));
            } else {
                steps.push((What::Afar(dice.bits(), dice.below(20) as u8), 8000));
            }
            steps.push((What::Say(Command::Stop), 4000));
            for axis in 0..3 {
                steps.push((back(axis), 20));
            }
            steps
        }
        2 => vec![(What::Say(command::reflect(dice)), 200)],
        3 => vec![(
            What::Say(Command::PositionScale {
                scale: dice.between(410.0, 8192.0) as u16,
            }),
            200,
        )],
        _ => careful(dice),
    }
}

fn line(dice: &mut Dice) -> Vec<(What, u32)> {
    match dice.below(8) {
        0..=2 => {
            let way = |dice: &mut Dice| {
                [
                    if dice.happens(0.5) {
                        dice.spread(1e-6, 1e-2)
                    } else {
                        0.0
                    },
                    if dice.happens(0.4) {
                        dice.spread(1e-5, 0.1)
                    } else {
                        0.0
                    },
                    if dice.happens(0.4) {
                        dice.spread(1e-5, 0.1)
                    } else {
                        0.0
                    },
                ]
            };
            vec![(What::Line([way(dice), way(dice)]), periods(dice))]
        }
        3 => vec![(What::Line([[0.0; 3]; 2]), periods(dice))],
        4 => {
            let length = dice.place(300);
            let bytes = (0..length).map(|_| dice.bits() as u8).collect();
            vec![(What::Garbage(bytes), periods(dice))]
        }
        5 => vec![
            (What::Away(true), dice.spread(20.0, 8000.0) as u32),
            (What::Away(false), periods(dice)),
        ],
        6 => vec![(What::Greet, periods(dice)), (What::Ready, 200)],
        _ => {
            let mut steps = vec![(What::Line([[0.0; 3]; 2]), 2000), (What::Ready, 100)];
            steps.extend(careful(dice));
            steps
        }
    }
}

fn config(dice: &mut Dice) -> Vec<(What, u32)> {
    let mutations = if dice.happens(0.15) {
        0
    } else {
        1 + dice.below(4) as u8
    };
    let mut steps = vec![
        (What::Say(Command::Stop), 2500),
        (What::Say(Command::Disable), 1500),
        (
            What::Configure {
                seed: dice.bits(),
                mutations,
                preset: dice.happens(0.3),
            },
            50,
        ),
    ];
    if dice.happens(0.7) {
        steps.push((What::Ready, 200));
    }
    for _ in 0..dice.below(3) {
        steps.extend(careful(dice));
    }
    steps
}

fn wild(kind: Kind, dice: &mut Dice) -> Vec<(What, u32)> {
    let axis = dice.pick(&JOINTS).to_string();
    match dice.below(32) {
        0..=13 => vec![(What::Say(command::any(dice)), periods(dice))],
        14..=16 => vec![(What::Probe(command::any(dice)), 10)],
        17 | 18 => {
            let mut plan = job(dice);
            if let What::Job(plan) = &mut plan {
                plan.absurd = if dice.happens(0.5) { 0.05 } else { 0.0 };
            }
            vec![(plan, periods(dice))]
        }
        19 => vec![(jog(dice), periods(dice))],
        20 => vec![(What::Urgent, periods(dice))],
        21 => {
            let length = dice.place(300);
            let bytes = (0..length).map(|_| dice.bits() as u8).collect();
            vec![(What::Garbage(bytes), periods(dice))]
        }
        22 => vec![(What::Circuit(dice.happens(0.6)), periods(dice))],
        23 => vec![(What::Greet, periods(dice))],
        24 => vec![
            (What::Away(true), dice.spread(20.0, 8000.0) as u32),
            (What::Away(false), 100),
        ],
        25 => vec![
            (What::Break(FaultKind::DriveTripped { axis }), periods(dice)),
            (What::Heal, 10),
        ],
        26 => vec![
            (
                What::Break(FaultKind::SwitchStuck {
                    axis,
                    switch: Switch::LimitLow,
                    active: true,
                }),
                periods(dice),
            ),
            (What::Heal, 10),
        ],
        27 => vec![(What::StaleJog, 100)],
        28 => vec![(What::Miss(1 + dice.below(6) as u16), periods(dice))],
        29 if matches!(kind, Kind::Hand | Kind::Master) => {
            let to = core::array::from_fn(|_| dice.between(-30.0, 30.0));
            vec![(What::Lead(to, dice.happens(0.5)), periods(dice))]
        }
        29 => vec![(What::Afar(dice.bits(), dice.below(60) as u8), periods(dice))],
        _ => vec![(What::Circuit(false), 5), (What::Ready, periods(dice))],
    }
}
