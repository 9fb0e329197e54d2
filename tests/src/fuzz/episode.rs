//! Episodes: the data that a seed stands for. A script is data, so a failing one can be shortened.

use super::machines::MachineKind;
use super::rng::Rng;
use super::script::script;
use haptimill_hil_sim::fault::FaultKind;
use haptimill_protocol::message::{Command, MAX_AXES};

/// The subject of an episode. It selects the stimuli and the checks that apply.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Theme {
    /// No fault, and only valid commands.
    Healthy,
    /// The same with force control and a wall or workpiece at the tool.
    Force,
    /// The same with a master that moves the tool, or with a master alone.
    Teleoperation,
    /// One fault of the machine.
    Fault,
    /// Several faults of the machine.
    Faults,
    /// Any command in any state with any arguments.
    AnyCommand,
    /// A bad serial line, and hosts that vanish and return.
    Line,
    /// Mutated configurations.
    Config,
    /// Corrupted files for the parsers of the host.
    Files,
}

impl Theme {
    /// All themes, each with its weight.
    pub const ALL: [(Self, u64); 9] = [
        (Self::Healthy, 24),
        (Self::Force, 8),
        (Self::Teleoperation, 7),
        (Self::Fault, 24),
        (Self::Faults, 8),
        (Self::AnyCommand, 14),
        (Self::Line, 7),
        (Self::Config, 6),
        (Self::Files, 2),
    ];

    /// Returns whether a fault that latches is a false alarm.
    #[must_use]
    pub const fn is_healthy(self) -> bool {
        matches!(self, Self::Healthy | Self::Force | Self::Teleoperation)
    }

    /// Returns whether the line between host and controller has no errors.
    #[must_use]
    pub const fn has_clean_line(self) -> bool {
        !matches!(self, Self::Line | Self::AnyCommand)
    }
}

/// How a job is planned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum JobPlan {
    /// A smooth path in all coordinates.
    Path(PathPlan),
    /// A line in the negative direction of an axis, with the spindle on.
    Line {
        /// The axis.
        axis: u8,
        /// Length of the line.
        distance_um: u32,
        /// Rate, as a part of 50 mm/s.
        speed: f64,
    },
    /// One setpoint at the present pose.
    Dwell {
        /// Its duration, in periods.
        periods: u16,
    },
}

/// A job along a smooth path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathPlan {
    /// Seed of its random numbers.
    pub seed: u64,
    /// Number of setpoints.
    pub count: u16,
    /// Mean segment duration, in periods.
    pub span: u16,
    /// Part of the maximum rates.
    pub speed: f64,
    /// Whether setpoints have spindle and pause actions.
    pub actions: bool,
    /// Periods for which the host sends nothing, in the middle.
    pub gap: u16,
    /// Part of the setpoints with random poses.
    pub absurd: f64,
    /// The host never sends the end of the job.
    pub open: bool,
}

/// A stimulus.
#[derive(Debug, Clone, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "scripts are short; a box would hide the values in a printed one"
)]
pub enum Stimulus {
    /// Nothing.
    Wait,
    /// The host sends a command, whatever the answer.
    Send(Command),
    /// The same at standstill; a refusal must change nothing.
    Probe(Command),
    /// A job from the present pose.
    Job(JobPlan),
    /// Jogs, repeated for the duration of the step.
    Jog {
        /// Parts of the maximum rates.
        rates: [f64; 5],
        /// Timeout, ms.
        timeout_ms: u16,
        /// Periods from one jog to the next.
        every: u16,
        /// Increment of the epoch before the first jog.
        epoch: i16,
        /// The host cancels at the end; else the timeout ends the motion.
        cancel: bool,
    },
    /// A jog of an old or cancelled epoch.
    StaleJog,
    /// The host recovers from faults, configures, enables and homes.
    Recover,
    /// The host waits until the machine is idle, for at most the periods of the step.
    WaitIdle,
    /// A host opens a new session.
    NewSession,
    /// The host vanishes or returns.
    HostAway(bool),
    /// The out-of-band stop.
    OutOfBandStop,
    /// Bytes that are no frame.
    Garbage(Vec<u8>),
    /// Noise in each direction: probabilities of a flipped bit, a lost byte, a doubled byte.
    LineNoise([[f64; 3]; 2]),
    /// The emergency stop circuit opens or closes.
    EmergencyStopCircuit(bool),
    /// A fault is injected into a device.
    InjectFault(FaultKind),
    /// A load on a joint rises over the periods of the step and stays until the faults are cleared.
    RampLoad(usize, f64),
    /// All injected faults end.
    ClearFaults,
    /// The controller misses this many periods.
    MissPeriods(u16),
    /// An elastic wall at the tool: axis, distance in mm, stiffness in N/mm; or none.
    VirtualFixture(Option<(u8, f64, f64)>),
    /// A workpiece that can be cut is clamped at the tool.
    ClampStock,
    /// A configuration with random mutations is sent and activated.
    Configure {
        /// Seed of the mutations.
        seed: u64,
        /// Number of mutations; 0 sends the machine's own configuration.
        mutations: u8,
        /// `at_preset` of [`Command::Activate`].
        preset: bool,
    },
    /// The operator moves the tip of the haptic arm: mm from home, enabling switch pressed or not.
    MoveMaster([f64; 3], bool),
    /// A remote master sends its pose for the duration of the step: seed, age in ms.
    RemoteMaster(u64, u8),
    /// A corrupted file for a parser of the host.
    CorruptFile(u64),
}

/// One step of a script.
#[derive(Debug, Clone, PartialEq)]
pub struct Step {
    /// The stimulus.
    pub stimulus: Stimulus,
    /// Control periods until the next one.
    pub periods: u32,
}

/// An episode.
#[derive(Debug, Clone, PartialEq)]
pub struct Episode {
    /// The seed.
    pub seed: u64,
    /// The subject.
    pub theme: Theme,
    /// The machine.
    pub kind: MachineKind,
    /// Baud rate of the line; none for an ideal line.
    pub baud: Option<u32>,
    /// Loads on the joints before the first configuration.
    pub initial_load: Option<[f64; 5]>,
    /// Whether inputs and outputs are recorded and replayed.
    pub with_replay: bool,
    /// The stimuli.
    pub script: Vec<Step>,
}

/// Returns the name of a stimulus in the counts.
#[must_use]
pub const fn stimulus_name(stimulus: &Stimulus) -> &'static str {
    match stimulus {
        Stimulus::Wait => "wait",
        Stimulus::Send(_) => "command in any state",
        Stimulus::Probe(_) => "probed command",
        Stimulus::Job(_) => "job",
        Stimulus::Jog { .. } => "jog",
        Stimulus::StaleJog => "stale jog",
        Stimulus::Recover => "recovery and homing",
        Stimulus::WaitIdle => "wait for idle",
        Stimulus::NewSession => "new session",
        Stimulus::HostAway(_) => "host away or back",
        Stimulus::OutOfBandStop => "out-of-band stop",
        Stimulus::Garbage(_) => "garbage on the line",
        Stimulus::LineNoise(_) => "noise on the line",
        Stimulus::EmergencyStopCircuit(_) => "emergency stop circuit",
        Stimulus::InjectFault(kind) => fault_name(kind),
        Stimulus::RampLoad(..) => "fault load ramp",
        Stimulus::ClearFaults => "faults cleared",
        Stimulus::MissPeriods(_) => "missed periods",
        Stimulus::VirtualFixture(_) => "elastic wall",
        Stimulus::ClampStock => "workpiece that is cut",
        Stimulus::Configure { .. } => "configuration",
        Stimulus::MoveMaster(..) => "operator at the haptic arm",
        Stimulus::RemoteMaster(..) => "remote master",
        Stimulus::CorruptFile(_) => "corrupted file",
    }
}

const fn fault_name(kind: &FaultKind) -> &'static str {
    match kind {
        FaultKind::EncoderStuck { .. } => "fault encoder-stuck",
        FaultKind::EncoderSwapped { .. } => "fault encoder-swapped",
        FaultKind::EncoderSlip { .. } => "fault encoder-slip",
        FaultKind::EncoderNoise { .. } => "fault encoder-noise",
        FaultKind::IndexMissing { .. } => "fault index-missing",
        FaultKind::DriveDead { .. } => "fault drive-dead",
        FaultKind::DriveTripped { .. } => "fault drive-tripped",
        FaultKind::DriveWeak { .. } => "fault drive-weak",
        FaultKind::DriveReversed { .. } => "fault drive-reversed",
        FaultKind::JointJammed { .. } => "fault joint-jammed",
        FaultKind::Push { .. } => "fault push",
        FaultKind::SwitchStuck { .. } => "fault switch-stuck",
        FaultKind::SwitchInverted { .. }
        | FaultKind::SwitchMissing { .. }
        | FaultKind::SwitchBounces { .. } => "fault of a switch",
        FaultKind::HapticArm(_) => "fault of the haptic arm",
        FaultKind::SpindleStalled => "fault spindle-stalled",
        _ => "fault of the force sensor",
    }
}

/// Names of joints by their places: those of the H-4 machines, and one more.
pub const JOINTS: [&str; MAX_AXES] = ["l1", "l2", "l3", "l4", "alpha", "sixth"];

/// Number of joints of the H-4 machines.
pub const H4_JOINTS: usize = 5;

/// Returns the index of a joint by its name.
#[must_use]
pub fn joint_of(name: &str) -> Option<usize> {
    JOINTS.iter().position(|joint| *joint == name)
}

impl Episode {
    /// Returns the episode of a seed.
    #[must_use]
    pub fn of(seed: u64) -> Self {
        let mut rng = Rng::new(seed, 900);
        let total: u64 = Theme::ALL.iter().map(|(_, weight)| weight).sum();
        let mut at = rng.below(total);
        let mut theme = Theme::Healthy;
        for (other, weight) in Theme::ALL {
            if at < weight {
                theme = other;
                break;
            }
            at -= weight;
        }
        let kind = match theme {
            Theme::Teleoperation => rng.choose(&[
                MachineKind::HapticArm,
                MachineKind::HapticArm,
                MachineKind::RemoteMaster,
                MachineKind::MasterAlone,
            ]),
            Theme::AnyCommand => rng.choose(&[
                MachineKind::Torque,
                MachineKind::Torque,
                MachineKind::Step,
                MachineKind::HapticArm,
                MachineKind::RemoteMaster,
                MachineKind::MasterAlone,
            ]),
            Theme::Faults | Theme::Fault => rng.choose(&[
                MachineKind::Torque,
                MachineKind::Torque,
                MachineKind::Torque,
                MachineKind::Step,
                MachineKind::Step,
                MachineKind::HapticArm,
            ]),
            Theme::Force | Theme::Config => MachineKind::Torque,
            _ => rng.choose(&[MachineKind::Torque, MachineKind::Torque, MachineKind::Step]),
        };
        let baud = rng
            .chance(0.2)
            .then(|| rng.choose(&[115_200, 460_800, 921_600]));
        let initial_load = (kind != MachineKind::MasterAlone && rng.chance(0.03)).then(|| {
            core::array::from_fn(|joint| {
                let max = if joint == 4 { 6.0 } else { 130.0 };
                if rng.chance(0.5) {
                    rng.uniform(-max, max)
                } else {
                    0.0
                }
            })
        });
        let with_replay = rng.chance(0.12);
        let script = script(theme, kind, &mut rng);
        Self {
            seed,
            theme,
            kind,
            baud,
            initial_load,
            with_replay,
            script,
        }
    }

    /// Returns the episode of a seed on another machine file.
    #[must_use]
    pub fn on(seed: u64, machine: &'static str) -> Self {
        let kind = MachineKind::File(machine);
        let mut rng = Rng::new(seed, 906);
        let theme = rng.choose(&[
            Theme::Healthy,
            Theme::Healthy,
            Theme::Healthy,
            Theme::Fault,
            Theme::Fault,
            Theme::Faults,
            Theme::AnyCommand,
            Theme::AnyCommand,
            Theme::AnyCommand,
            Theme::Line,
            Theme::Config,
            Theme::Config,
        ]);
        let baud = rng
            .chance(0.2)
            .then(|| rng.choose(&[115_200, 460_800, 921_600]));
        let with_replay = rng.chance(0.12);
        let script = script(theme, kind, &mut rng);
        Self {
            seed,
            theme,
            kind,
            baud,
            initial_load: None,
            with_replay,
            script,
        }
    }

    /// Returns the script as text.
    #[must_use]
    pub fn describe(&self) -> String {
        let mut text = format!(
            "seed {}: {:?} on {:?}, baud {:?}, pushed before configuration {:?}\n",
            self.seed, self.theme, self.kind, self.baud, self.initial_load
        );
        for step in &self.script {
            text.push_str(&format!(
                "  {:?} then {} periods\n",
                step.stimulus, step.periods
            ));
        }
        text
    }
}
