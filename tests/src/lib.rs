//! What the whole-system tests and benchmarks share: a simulated machine with a host that says one thing after the other.

#[cfg(feature = "emulated")]
pub mod log;
pub mod storm;

use haptimill::machine::MachineFile;
use haptimill_firmware::controller::Controller;
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::rig::{Control, Rig, RigOptions};
use haptimill_protocol::haptic::HandTelemetry;
use haptimill_protocol::link::{HostLink, Timing};
use haptimill_protocol::message::{
    Action, AxisValues, CONFIG_CHUNK, Command, ConfigChunk, Event, Refusal, Report, Request,
    SETPOINT_BATCH, SetpointBatch, State, Telemetry,
};
use haptimill_protocol::setpoint::{Setpoint, SetpointCoder};

/// A controller in the simulated machine, and the host's end of the link to it.
pub struct Bench<C = Controller> {
    /// The machine.
    pub rig: Rig<C>,
    /// The host's end of the link.
    pub link: HostLink,
    /// The machine file.
    pub machine: MachineFile,
    /// The newest telemetry.
    pub telemetry: Option<Telemetry>,
    /// The newest telemetry of the hand.
    pub hand: Option<HandTelemetry>,
    /// All events so far.
    pub events: Vec<Event>,
    answers: Vec<(u8, Result<(), Refusal>)>,
    id: u8,
}

impl Bench {
    /// The built-in machine, healthy.
    #[must_use]
    pub fn new() -> Self {
        Self::with(&RigOptions::default(), Controller::new(200))
    }

    /// The built-in machine with faults or a slow line.
    #[must_use]
    pub fn with_options(options: &RigOptions) -> Self {
        Self::with(options, Controller::new(200))
    }
}

impl Default for Bench {
    fn default() -> Self {
        Self::new()
    }
}

impl<C: Control> Bench<C> {
    /// The built-in machine around any controller.
    #[must_use]
    pub fn with(options: &RigOptions, control: C) -> Self {
        Self::of_machine(MachineFile::built_in().expect("sound"), options, control)
    }

    /// A machine of a machine file around any controller.
    #[must_use]
    pub fn of_machine(machine: MachineFile, options: &RigOptions, control: C) -> Self {
        let plant: PlantConfig = machine.plant().expect("has a plant");
        let rig = Rig::new(&plant, options, control).expect("sound");
        let mut link = HostLink::new(Timing::default());
        link.open(77, 0);
        Self {
            rig,
            link,
            machine,
            telemetry: None,
            hand: None,
            events: vec![],
            answers: vec![],
            id: 0,
        }
    }

    /// One control period, and what the host does in it.
    pub fn step(&mut self) {
        self.step_spoiled(|_| ());
    }

    /// One control period, with something done to the bytes that the host says in it.
    pub fn step_spoiled(&mut self, spoil: impl FnOnce(&mut Vec<u8>)) {
        let now = self.rig.time_ns() / 1000;
        let mut buffer = [0; 256];
        let count = self.link.transmit(now, &mut buffer);
        let mut bytes = buffer[..count].to_vec();
        spoil(&mut bytes);
        self.rig.host_write(&bytes);
        self.rig.step();
        let mut received = Vec::new();
        self.rig.host_read(&mut received);
        self.link.receive(self.rig.time_ns() / 1000, &received);
        while let Some(report) = self.link.poll_message() {
            match report {
                Report::Answer { id, result } => self.answers.push((id, result)),
                Report::Event { event, .. } => self.events.push(event),
                Report::Telemetry(telemetry) => self.telemetry = Some(telemetry),
                Report::Hand(hand) => self.hand = Some(hand),
            }
        }
    }

    /// So many control periods.
    pub fn steps(&mut self, count: usize) {
        for _ in 0..count {
            self.step();
        }
    }

    /// Asks without waiting, if there is room; the number that the answer will have.
    pub fn say(&mut self, command: Command) -> Option<u8> {
        let id = self.id % 250 + 1;
        self.link.send(&Request { id, command }).ok()?;
        self.id = id;
        Some(id)
    }

    /// Answers that have come since the last call.
    pub fn take_answers(&mut self) -> Vec<(u8, Result<(), Refusal>)> {
        core::mem::take(&mut self.answers)
    }

    /// Asks as soon as there is room, and waits for the answer.
    pub fn ask(&mut self, command: Command) -> Result<(), Refusal> {
        self.id = self.id % 250 + 1;
        let id = self.id;
        let request = Request { id, command };
        let mut said = false;
        for _ in 0..5000 {
            said = said || self.link.send(&request).is_ok();
            self.step();
            if let Some(index) = self
                .answers
                .iter()
                .position(|(answered, _)| *answered == id)
            {
                return self.answers.remove(index).1;
            }
        }
        panic!("no answer");
    }

    /// Telemetry of now.
    pub fn status(&mut self) -> Telemetry {
        self.telemetry = None;
        self.ask(Command::Status).expect("status");
        self.steps(200);
        self.telemetry.clone().expect("telemetry")
    }

    /// Sends the configuration and activates it.
    pub fn configure(&mut self) {
        self.configure_as(false);
    }

    /// Sends the configuration and activates it; `at_preset` as in [`Command::Activate`].
    pub fn configure_as(&mut self, at_preset: bool) {
        let (bytes, crc) = self.machine.encoded().expect("encodes");
        for (index, chunk) in bytes.chunks(CONFIG_CHUNK).enumerate() {
            let chunk = ConfigChunk {
                offset: (index * CONFIG_CHUNK) as u16,
                bytes: chunk.iter().copied().collect(),
            };
            self.ask(Command::Configure(chunk)).expect("staged");
        }
        self.ask(Command::Activate {
            length: bytes.len() as u16,
            crc,
            at_preset,
        })
        .expect("activated");
    }

    /// Connects, configures, enables and homes.
    pub fn make_ready(&mut self) {
        self.steps(500);
        self.configure();
        self.ask(Command::Enable).expect("enabled");
        self.ask(Command::Home).expect("homing");
        for _ in 0..300 {
            self.steps(100);
            if self.events.contains(&Event::Homed) {
                return;
            }
        }
        panic!("not homed: {:?}", self.events);
    }

    /// Starts a job of setpoints where the machine stands, and brings all of them over.
    pub fn start_job(&mut self, job: u32, setpoints: &[Setpoint]) {
        let start = self.status().wanted;
        self.start_part(job, &start, setpoints);
        self.ask(Command::JobEnd {
            count: setpoints.len() as u32,
        })
        .expect("ended");
    }

    /// Starts a job whose setpoints may be refused.
    ///
    /// # Errors
    /// The first refusal.
    pub fn try_job(&mut self, job: u32, setpoints: &[Setpoint]) -> Result<(), Refusal> {
        let start = self.status().wanted;
        let mut coder = SetpointCoder::new(self.machine.config.period_us, &start);
        self.ask(Command::JobStart { job, pose: start })?;
        for (index, batch) in setpoints.chunks(SETPOINT_BATCH).enumerate() {
            let items = batch
                .iter()
                .map(|setpoint| coder.encode(setpoint).expect("codes"))
                .collect();
            let first = (index * SETPOINT_BATCH) as u32;
            self.ask(Command::Setpoints(SetpointBatch { first, items }))?;
        }
        let count = setpoints.len() as u32;
        self.ask(Command::JobEnd { count })
    }

    /// Starts a job at `start`, where the machine stands, and brings setpoints over without saying that they are all.
    pub fn start_part(&mut self, job: u32, start: &AxisValues, setpoints: &[Setpoint]) {
        self.ask(Command::JobStart {
            job,
            pose: start.clone(),
        })
        .expect("started");
        let mut coder = SetpointCoder::new(self.machine.config.period_us, start);
        for (index, batch) in setpoints.chunks(SETPOINT_BATCH).enumerate() {
            let items = batch
                .iter()
                .map(|setpoint| coder.encode(setpoint).expect("codes"))
                .collect();
            let first = (index * SETPOINT_BATCH) as u32;
            self.ask(Command::Setpoints(SetpointBatch { first, items }))
                .expect("taken");
        }
    }

    /// Waits for a state.
    pub fn wait_for(&mut self, state: State, periods: usize) -> bool {
        for _ in 0..periods / 250 + 1 {
            self.steps(50);
            if self.status().state == state {
                return true;
            }
        }
        false
    }
}

/// A straight line in x from `start`: 0.1 s up to `speed` (mm/s), so many spans of 0.1 s along, 0.1 s down.
#[must_use]
pub fn line_in_x(start: &AxisValues, speed: f64, spans: usize) -> Vec<Setpoint> {
    const MM: f64 = (1 << 20) as f64;
    let mut x = f64::from(start[0]);
    (0..spans + 2)
        .map(|span| {
            let ends = span == 0 || span == spans + 1;
            x += if ends { speed / 2.0 } else { speed } * 0.1 * MM;
            let rate = if span == spans + 1 { 0.0 } else { speed };
            let mut pose = start.clone();
            pose[0] = x as i32;
            Setpoint {
                periods: 500,
                pose,
                rates: [(rate * 4096.0) as i32, 0, 0, 0, 0].into_iter().collect(),
                action: Action::None,
            }
        })
        .collect()
}
