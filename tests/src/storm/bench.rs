//! The machine in the storm: rig, host's end of the link, a line that can be spoilt, devices that can be broken.

use super::script::{Dice, Episode, JOINTS, Kind};
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
use std::sync::OnceLock;

/// The most periods that are recorded to be replayed.
const RECORDED: usize = 60_000;

/// The controller, with what it sensed and said.
#[derive(Debug)]
pub struct Board {
    /// The controller.
    pub controller: Controller,
    /// Periods that the next one takes beyond its own.
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

/// A request that was not answered yet.
#[derive(Debug, Clone)]
pub struct Pending {
    /// Its number.
    pub id: u8,
    /// The command.
    pub command: Command,
    /// The period in which it was sent.
    pub sent: u64,
}

/// An answer with its request.
#[derive(Debug, Clone)]
pub struct Answered {
    /// The command.
    pub command: Command,
    /// What became of it.
    pub result: Result<(), Refusal>,
}

/// The machine, and all around it.
pub struct World {
    /// Machine, controller and line.
    pub rig: Rig<Board>,
    /// The host's end of the link.
    pub link: HostLink,
    /// The machine file.
    pub machine: &'static MachineFile,
    /// The simulated machine's configuration.
    pub plant: PlantConfig,
    /// Joints.
    pub axes: usize,
    /// Unanswered requests in the order in which they were sent.
    pub pending: VecDeque<Pending>,
    /// Requests of a session that was given up; the controller may have carried them out.
    pub ghosts: VecDeque<Pending>,
    /// Answers of the last period.
    pub answers: Vec<Answered>,
    /// Names of the commands that were answered in the last period: carried out in it, or before.
    pub just: Vec<&'static str>,
    /// Answers that belong to no request, or came out of order.
    pub stray: Option<String>,
    /// Events of the last period.
    pub events: Vec<(u64, Event)>,
    /// Telemetry of the last period.
    pub telemetry: Option<Telemetry>,
    /// Both sides of the joints when the inputs of the last period were latched.
    pub latched: Bodies,
    /// The host is away since this period.
    pub away: Option<u64>,
    /// The period in which the newest session was begun.
    pub greeted: u64,
    /// Commands by kind.
    pub counts: BTreeMap<&'static str, u64>,
    /// Periods, the missed ones included.
    pub period: u64,
    /// What is broken now.
    pub broken: Vec<FaultKind>,
    /// Bytes of the line were spoilt since the session began.
    pub spoilt: bool,
    schedule: Schedule,
    wires: [SerialLine; 2],
    noise: [[f64; 3]; 2],
    dice: Dice,
    id: u8,
    session: u32,
    inject: Vec<u8>,
}

/// The machine file of a kind.
#[must_use]
pub fn machine(kind: Kind) -> &'static MachineFile {
    static FILES: OnceLock<[MachineFile; 5]> = OnceLock::new();
    let files = FILES.get_or_init(|| {
        let torque = MachineFile::built_in().expect("sound");
        let step = include_str!("../../../machines/h4-step.toml");
        [
            torque.clone(),
            MachineFile::parse("machines/h4-step.toml", step).expect("sound"),
            torque.with_haptic_arm().expect("sound"),
            torque.with_follow().expect("sound"),
            MachineFile::built_in_master().expect("sound"),
        ]
    });
    &files[match kind {
        Kind::Torque => 0,
        Kind::Step => 1,
        Kind::Hand => 2,
        Kind::Follow => 3,
        Kind::Master => 4,
    }]
}

/// The name of a command without its arguments.
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
    }
}

impl World {
    /// The machine of an episode, just switched on.
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
            log: episode.replayed.then(Vec::new),
        };
        let rig = Rig::new(&plant, &options, board).expect("sound");
        let mut timing = Timing::default();
        if let Some(baud) = episode.baud {
            timing.line_rate = baud / 10;
        }
        let axes = rig.plant().axes();
        let mut world = Self {
            latched: rig.plant().bodies().clone(),
            rig,
            link: HostLink::new(timing),
            machine,
            plant,
            axes,
            pending: VecDeque::new(),
            ghosts: VecDeque::new(),
            answers: vec![],
            just: vec![],
            stray: None,
            events: vec![],
            telemetry: None,
            away: None,
            greeted: 0,
            counts: BTreeMap::new(),
            period: 0,
            broken: vec![],
            spoilt: false,
            schedule: Schedule::new(&[], &[]).expect("empty"),
            wires: [1, 2].map(|stream| SerialLine::new(None, Random::new(1, stream))),
            noise: [[0.0; 3]; 2],
            dice: Dice::new(episode.seed, 901),
            id: 0,
            session: 0,
            inject: vec![],
        };
        world.greet();
        world
    }

    /// A new session.
    pub fn greet(&mut self) {
        self.session = (self.dice.bits() as u32) | 1;
        self.link.open(self.session, self.rig.time_ns() / 1000);
        self.ghosts.extend(self.pending.drain(..));
        self.greeted = self.period;
        self.spoilt = self.noise != [[0.0; 3]; 2];
    }

    /// Sends a request; false if there is no room, or no session.
    pub fn say(&mut self, command: &Command) -> bool {
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

    /// Bytes that go on the line beside the link.
    pub fn inject(&mut self, bytes: &[u8]) {
        self.inject.extend_from_slice(bytes);
    }

    /// What becomes of bytes from now on.
    pub fn set_noise(&mut self, noise: [[f64; 3]; 2]) {
        self.noise = noise;
        self.spoilt |= noise != [[0.0; 3]; 2];
    }

    /// Whether bytes are spoilt now.
    #[must_use]
    pub fn noisy(&self) -> bool {
        self.noise != [[0.0; 3]; 2]
    }

    /// The faults of the devices become these.
    pub fn set_broken(&mut self, broken: Vec<FaultKind>) {
        // A schedule with any fault sets the conditions of all devices; one that is over sets them to healthy.
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
        let joints = if self.axes == 0 { &[][..] } else { &JOINTS[..] };
        let faults: Vec<Fault> = lasting.collect();
        if let Ok(schedule) = Schedule::new(&faults, joints) {
            self.schedule = schedule;
            self.broken = broken;
        }
    }

    fn spoil(&mut self, way: usize, bytes: Vec<u8>) -> Vec<u8> {
        let [flip, lose, double] = self.noise[way];
        if self.noise[way] == [0.0; 3] {
            return bytes;
        }
        let mut spoilt = Vec::with_capacity(bytes.len());
        for byte in bytes {
            if self.dice.happens(lose) {
                continue;
            }
            let mut byte = byte;
            if flip > 0.0 {
                for bit in 0..8 {
                    if self.dice.happens(flip) {
                        byte ^= 1 << bit;
                    }
                }
            }
            spoilt.push(byte);
            if self.dice.happens(double) {
                spoilt.push(byte);
            }
        }
        spoilt
    }

    /// One control period; false when the controller missed it.
    pub fn step(&mut self) -> bool {
        self.answers.clear();
        self.just.clear();
        self.events.clear();
        self.telemetry = None;
        let now = self.rig.time_ns() / 1000;
        if self.away.is_none() {
            let mut buffer = [0; 256];
            let count = self.link.transmit(now, &mut buffer);
            if count > 0 {
                let bytes = self.spoil(0, buffer[..count].to_vec());
                self.rig.host_write(&bytes);
            }
        }
        if !self.inject.is_empty() {
            let bytes = core::mem::take(&mut self.inject);
            self.rig.host_write(&bytes);
        }
        let [to_machine, to_host] = &mut self.wires;
        let time = self.rig.time_ns();
        self.schedule
            .apply(time, self.rig.plant_mut(), to_machine, to_host);
        self.latched.clone_from(self.rig.plant().bodies());
        let ticked = self.rig.step();
        self.period += 1;
        let mut received = Vec::new();
        self.rig.host_read(&mut received);
        if self.away.is_some() {
            return ticked;
        }
        let received = self.spoil(1, received);
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
        // Step motors lock before the request to enable them is answered; others are answered meanwhile.
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
                self.just.push(name(&pending.command));
                self.answers.push(Answered {
                    command: pending.command,
                    result,
                });
            }
            other => {
                self.stray = Some(format!(
                    "an answer to request {id} came, and the oldest unanswered request is {:?}",
                    other.map(|pending| (pending.id, name(&pending.command)))
                ));
            }
        }
    }

    /// How the host's end of the link stands.
    #[must_use]
    pub fn link_state(&self) -> LinkState {
        self.link.state(self.rig.time_ns() / 1000)
    }

    /// The controller.
    #[must_use]
    pub const fn controller(&self) -> &Controller {
        &self.rig.control().controller
    }

    /// What was recorded.
    pub fn take_log(&mut self) -> Option<Vec<(Inputs, Outputs)>> {
        self.rig.control_mut().log.take()
    }

    /// The recorded inputs in a new controller: the first period in which it says something else.
    pub fn replay(&mut self) -> Option<u64> {
        let log = self.take_log()?;
        let mut controller = Controller::new(200);
        let mut outputs = Outputs::default();
        for (inputs, said) in &log {
            outputs.transmit.clear();
            controller.tick(inputs, &mut outputs, &mut ());
            if outputs != *said {
                return Some(inputs.period);
            }
        }
        None
    }
}
