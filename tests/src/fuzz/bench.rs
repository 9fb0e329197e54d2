//! The machine of the fuzz test: rig, host's endpoint, line noise and injected faults.

use super::episode::{Episode, JOINTS};
use super::machines::machine;
use super::rng::Rng;
use haptimill_firmware::config::Drive;
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{Inputs, Outputs};
use haptimill_firmware::snapshot::Snapshot;
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::fault::{Fault, FaultKind};
use haptimill_hil_sim::joint::mechanics::Bodies;
use haptimill_hil_sim::line::SerialLine;
use haptimill_hil_sim::random::Random;
use haptimill_hil_sim::rig::{Control, Rig, RigOptions};
use haptimill_hil_sim::schedule::Schedule;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::link::{HostLink, LinkState, Timing};
use haptimill_protocol::message::{Command, Event, Refusal, Report, Request, Telemetry};
use std::collections::{BTreeMap, VecDeque};

/// Largest number of periods that are recorded for the replay.
const RECORDED: usize = 60_000;

/// The controller, with its inputs and outputs.
#[derive(Debug)]
pub struct Board {
    /// The controller.
    pub controller: Controller,
    /// Overrun of the next period, in periods.
    pub late: u16,
    overrun: u16,
    log: Option<Vec<(Inputs, Outputs)>>,
}

impl Control for Board {
    fn tick(&mut self, inputs: &Inputs, outputs: &mut Outputs) {
        self.controller.tick(inputs, outputs, &mut ());
        self.overrun = core::mem::take(&mut self.late);
        if let Some(log) = &mut self.log
            && log.len() < RECORDED
        {
            log.push((inputs.clone(), outputs.clone()));
        }
    }

    fn snapshot(&self, inputs: &Inputs) -> Option<Snapshot> {
        self.controller.snapshot(inputs)
    }

    fn overrun(&self) -> u16 {
        self.overrun
    }
}

/// An unanswered request.
#[derive(Debug, Clone)]
pub struct Pending {
    /// Its number.
    pub id: u8,
    /// The command.
    pub command: Command,
    /// The period in which it was sent.
    pub sent: u64,
}

/// A request with its answer.
#[derive(Debug, Clone)]
pub struct Answered {
    /// The command.
    pub command: Command,
    /// The answer.
    pub result: Result<(), Refusal>,
}

/// The machine, and everything around it.
pub struct FuzzBench {
    /// Machine, controller and line.
    pub rig: Rig<Board>,
    /// The host's endpoint of the link.
    pub link: HostLink,
    /// The machine file.
    pub machine: &'static MachineFile,
    /// The simulated machine's configuration.
    pub plant: PlantConfig,
    /// Number of joints.
    pub axes: usize,
    /// Unanswered requests in the order of sending.
    pub pending: VecDeque<Pending>,
    /// Requests of a session that has ended; the controller may have executed them.
    pub abandoned: VecDeque<Pending>,
    /// Answers of the last period.
    pub answers: Vec<Answered>,
    /// Names of the commands that were answered in the last period.
    pub answered_names: Vec<&'static str>,
    /// Description of an answer without a request, or out of order.
    pub unexpected_answer: Option<String>,
    /// Events of the last period.
    pub events: Vec<(u64, Event)>,
    /// Telemetry of the last period.
    pub telemetry: Option<Telemetry>,
    /// Motors and slides when the inputs of the last period were latched.
    pub latched: Bodies,
    /// The period in which the host vanished.
    pub away_since: Option<u64>,
    /// The period in which the newest session began.
    pub session_start: u64,
    /// Sent commands by kind.
    pub counts: BTreeMap<&'static str, u64>,
    /// Control periods, including missed ones.
    pub period: u64,
    /// The injected faults.
    pub faults: Vec<FaultKind>,
    /// Bytes were corrupted since the session began.
    pub corrupted: bool,
    schedule: Schedule,
    lines: [SerialLine; 2],
    noise: [[f64; 3]; 2],
    rng: Rng,
    id: u8,
    session: u32,
    inject: Vec<u8>,
}

/// Returns the name of a command without its arguments.
#[must_use]
pub const fn name(command: &Command) -> &'static str {
    match command {
        Command::Setpoints(_) => "Setpoints",
        Command::Ping => "Ping",
        Command::Configure(_) => "Configure",
        Command::Activate { .. } => "Activate",
        Command::Enable => "Enable",
        Command::Disable => "Disable",
        Command::Home => "Home",
        Command::Reset => "Reset",
        Command::JobStart { .. } => "JobStart",
        Command::JobEnd { .. } => "JobEnd",
        Command::Hold => "Hold",
        Command::Resume => "Resume",
        Command::Stop => "Stop",
        Command::EmergencyStop => "EmergencyStop",
        Command::Jog { .. } => "Jog",
        Command::JogCancel { .. } => "JogCancel",
        Command::Source { .. } => "Source",
        Command::Override { .. } => "Override",
        Command::RapidOverride { .. } => "RapidOverride",
        Command::SpindleOverride { .. } => "SpindleOverride",
        Command::Telemetry { .. } => "Telemetry",
        Command::Status => "Status",
        Command::ForceMask { .. } => "ForceMask",
        Command::ForceLoop { .. } => "ForceLoop",
        Command::Tare => "Tare",
        Command::MasterPose { .. } => "MasterPose",
        Command::RemoteForce { .. } => "RemoteForce",
        Command::ForceFeedback(_) => "ForceFeedback",
        Command::VirtualFixture { .. } => "VirtualFixture",
        Command::PositionScale { .. } => "PositionScale",
        Command::MasterTelemetry { .. } => "MasterTelemetry",
        Command::ForceSettings { .. } => "ForceSettings",
        Command::SetOutput { .. } => "SetOutput",
        Command::SetAnalogOutput { .. } => "SetAnalogOutput",
        Command::ArmProbe { .. } => "ArmProbe",
        Command::Compensation { .. } => "Compensation",
        Command::MoveOff { .. } => "MoveOff",
        Command::Store { .. } => "Store",
    }
}

impl FuzzBench {
    /// Creates the machine of an episode, just switched on.
    #[must_use]
    pub fn new(episode: &Episode) -> Self {
        let machine = machine(episode.kind);
        let mut plant: PlantConfig = machine.plant().expect("has a plant");
        plant.seed = episode.seed;
        let options = RigOptions {
            baud: episode.baud,
            ..RigOptions::default()
        };
        let board = Board {
            controller: Controller::new(200),
            late: 0,
            overrun: 0,
            log: episode.with_replay.then(Vec::new),
        };
        let rig = Rig::new(&plant, &options, board).expect("sound");
        let mut timing = Timing::default();
        if let Some(baud) = episode.baud {
            timing.line_rate = baud / 10;
        }
        let axes = rig.plant().axes();
        let mut bench = Self {
            latched: rig.plant().bodies().clone(),
            rig,
            link: HostLink::new(timing),
            machine,
            plant,
            axes,
            pending: VecDeque::new(),
            abandoned: VecDeque::new(),
            answers: vec![],
            answered_names: vec![],
            unexpected_answer: None,
            events: vec![],
            telemetry: None,
            away_since: None,
            session_start: 0,
            counts: BTreeMap::new(),
            period: 0,
            faults: vec![],
            corrupted: false,
            schedule: Schedule::new(&[], &[], &[]).expect("empty"),
            lines: [1, 2].map(|stream| SerialLine::new(None, Random::new(1, stream))),
            noise: [[0.0; 3]; 2],
            rng: Rng::new(episode.seed, 901),
            id: 0,
            session: 0,
            inject: vec![],
        };
        bench.open_session();
        bench
    }

    /// Opens a new session.
    pub fn open_session(&mut self) {
        self.session = (self.rng.bits() as u32) | 1;
        self.link.open(self.session, self.rig.time_ns() / 1000);
        self.abandoned.extend(self.pending.drain(..));
        self.session_start = self.period;
        self.corrupted = self.noise != [[0.0; 3]; 2];
    }

    /// Sends a request. Returns false without room or session.
    pub fn send(&mut self, command: &Command) -> bool {
        if matches!(
            command,
            Command::MasterPose { .. } | Command::RemoteForce { .. }
        ) {
            let request = Request {
                id: 0,
                command: command.clone(),
            };
            let sent = self.link.send_latest(&request).is_ok();
            if sent {
                *self.counts.entry(name(command)).or_default() += 1;
            }
            return sent;
        }
        let id = self.id % 250 + 1;
        let request = Request {
            id,
            command: command.clone(),
        };
        if self.link.send(&request).is_err() {
            return false;
        }
        self.id = id;
        *self.counts.entry(name(command)).or_default() += 1;
        self.pending.push_back(Pending {
            id,
            command: command.clone(),
            sent: self.period,
        });
        true
    }

    /// Sends bytes outside the link.
    pub fn inject(&mut self, bytes: &[u8]) {
        self.inject.extend_from_slice(bytes);
    }

    /// Sets the noise of both directions.
    pub fn set_noise(&mut self, noise: [[f64; 3]; 2]) {
        self.noise = noise;
        self.corrupted |= noise != [[0.0; 3]; 2];
    }

    /// Returns whether there is noise.
    #[must_use]
    pub fn is_noisy(&self) -> bool {
        self.noise != [[0.0; 3]; 2]
    }

    /// Sets the injected faults.
    pub fn set_faults(&mut self, broken: Vec<FaultKind>) {
        // A schedule sets every device only if it has a fault; one that has ended clears them.
        let over = Fault {
            at_s: 0.0,
            for_s: Some(1e-9),
            what: FaultKind::SpindleStalled,
        };
        let lasting = broken
            .iter()
            .map(|what| Fault {
                at_s: 0.0,
                for_s: None,
                what: what.clone(),
            })
            .chain([over]);
        let joints = &JOINTS[..self.axes];
        let inputs = self.plant.input.iter();
        let inputs: Vec<&str> = inputs.map(|input| input.name.as_str()).collect();
        let faults: Vec<Fault> = lasting.collect();
        if let Ok(schedule) = Schedule::new(&faults, joints, &inputs) {
            self.schedule = schedule;
            self.faults = broken;
        }
    }

    fn corrupt_bytes(&mut self, direction: usize, bytes: Vec<u8>) -> Vec<u8> {
        let [flip, lose, double] = self.noise[direction];
        if self.noise[direction] == [0.0; 3] {
            return bytes;
        }
        let mut corrupted = Vec::with_capacity(bytes.len());
        for byte in bytes {
            if self.rng.chance(lose) {
                continue;
            }
            let mut byte = byte;
            if flip > 0.0 {
                for bit in 0..8 {
                    if self.rng.chance(flip) {
                        byte ^= 1 << bit;
                    }
                }
            }
            corrupted.push(byte);
            if self.rng.chance(double) {
                corrupted.push(byte);
            }
        }
        corrupted
    }

    /// Runs one control period. Returns false if the controller missed it.
    pub fn step(&mut self) -> bool {
        self.answers.clear();
        self.answered_names.clear();
        self.events.clear();
        self.telemetry = None;
        let now = self.rig.time_ns() / 1000;
        if self.away_since.is_none() {
            let mut buffer = [0; 256];
            let count = self.link.transmit(now, &mut buffer);
            if count > 0 {
                let bytes = self.corrupt_bytes(0, buffer[..count].to_vec());
                self.rig.host_write(&bytes);
            }
        }
        if !self.inject.is_empty() {
            let bytes = core::mem::take(&mut self.inject);
            self.rig.host_write(&bytes);
        }
        let [to_machine, to_host] = &mut self.lines;
        let time = self.rig.time_ns();
        self.schedule
            .apply(time, self.rig.plant_mut(), to_machine, to_host);
        self.latched.clone_from(self.rig.plant().bodies());
        let ticked = self.rig.step();
        self.period += 1;
        let mut received = Vec::new();
        self.rig.host_read(&mut received);
        if self.away_since.is_some() {
            return ticked;
        }
        let received = self.corrupt_bytes(1, received);
        let now = self.rig.time_ns() / 1000;
        self.link.receive(now, &received);
        while let Some(report) = self.link.poll_message() {
            match report {
                Report::Answer { id, result } => self.answered(id, result),
                Report::Event { period, event } => self.events.push((period, event)),
                Report::Telemetry(telemetry) => self.telemetry = Some(telemetry),
                Report::Master(_) => {}
            }
        }
        ticked
    }

    fn has_step_motors(&self) -> bool {
        let mut joints = self.machine.config.joints.iter();
        joints.any(|joint| matches!(joint.drive, Drive::Steps { .. }))
    }

    fn answered(&mut self, id: u8, result: Result<(), Refusal>) {
        if id == 0 {
            return;
        }
        // `Enable` of step motors is answered after locking; later requests are answered before.
        let late = self.pending.front().is_some_and(|oldest| {
            oldest.id != id && oldest.command == Command::Enable && self.has_step_motors()
        });
        let pending = if late {
            let enable = self.pending.pop_front();
            let next = self.pending.pop_front();
            if let Some(enable) = enable {
                self.pending.push_front(enable);
            }
            next
        } else {
            self.pending.pop_front()
        };
        match pending {
            Some(pending) if pending.id == id => {
                self.answered_names.push(name(&pending.command));
                self.answers.push(Answered {
                    command: pending.command,
                    result,
                });
            }
            other => {
                self.unexpected_answer = Some(format!(
                    "an answer to request {id} came, and the oldest unanswered request is {:?}",
                    other.map(|pending| (pending.id, name(&pending.command)))
                ));
            }
        }
    }

    /// Returns the state of the host's link.
    #[must_use]
    pub fn link_state(&self) -> LinkState {
        self.link.state(self.rig.time_ns() / 1000)
    }

    /// Returns the controller.
    #[must_use]
    pub const fn controller(&self) -> &Controller {
        &self.rig.control().controller
    }

    /// Runs a new controller on the recorded inputs. Returns the first period that differs.
    pub fn replay(&mut self) -> Option<u64> {
        let log = self.rig.control_mut().log.take()?;
        let mut controller = Controller::new(200);
        let mut outputs = Outputs::default();
        for (inputs, recorded) in &log {
            outputs.transmit.clear();
            controller.tick(inputs, &mut outputs, &mut ());
            if outputs != *recorded {
                return Some(inputs.period);
            }
        }
        None
    }
}
