//! Shared code of the whole-system tests and benchmarks: a simulated machine with a host that sends
//! one command at a time.

pub mod fuzz;
pub mod job;

use haptimill_firmware::controller::Controller;
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::rig::{Control, Rig, RigOptions};
use haptimill_machine_file::MachineFile;
use haptimill_protocol::haptic::MasterTelemetry;
use haptimill_protocol::link::{HostLink, Timing};
use haptimill_protocol::message::{
    Action, AxisValues, CONFIG_CHUNK, Command, ConfigChunk, Event, Refusal, Report, Request,
    SETPOINT_BATCH, SetpointBatch, State, Telemetry,
};
use haptimill_protocol::setpoint::{Setpoint, SetpointCoder};

/// A controller in the simulated machine, and the host's endpoint of the link.
pub struct Bench<C = Controller> {
    /// The simulated machine with its controller.
    pub rig: Rig<C>,
    /// The host's endpoint of the link.
    pub link: HostLink,
    /// The machine file.
    pub machine: MachineFile,
    /// The newest telemetry.
    pub telemetry: Option<Telemetry>,
    /// The newest telemetry of the master.
    pub master: Option<MasterTelemetry>,
    /// All events so far.
    pub events: Vec<Event>,
    answers: Vec<(u8, Result<(), Refusal>)>,
    id: u8,
}

impl Bench {
    /// Creates the built-in machine without faults.
    #[must_use]
    pub fn new() -> Self {
        Self::with(&RigOptions::default(), Controller::new(200))
    }

    /// Creates the built-in machine with injected faults or a slow line.
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
    /// Creates the built-in machine with any controller.
    #[must_use]
    pub fn with(options: &RigOptions, control: C) -> Self {
        Self::of_machine(MachineFile::built_in().expect("sound"), options, control)
    }

    /// Creates a machine from a machine file, with any controller.
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
            master: None,
            events: vec![],
            answers: vec![],
            id: 0,
        }
    }

    /// Runs one control period of machine and host.
    pub fn step(&mut self) {
        self.step_with_fault(|_| ());
    }

    /// Runs one control period, with a fault injected into the bytes that the host sends in it.
    pub fn step_with_fault(&mut self, corrupt: impl FnOnce(&mut Vec<u8>)) {
        let now = self.rig.time_ns() / 1000;
        let mut buffer = [0; 256];
        let count = self.link.transmit(now, &mut buffer);
        let mut bytes = buffer[..count].to_vec();
        corrupt(&mut bytes);
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
                Report::Master(master) => self.master = Some(master),
            }
        }
    }

    /// Runs `count` control periods.
    pub fn steps(&mut self, count: usize) {
        for _ in 0..count {
            self.step();
        }
    }

    /// Sends a command without waiting, if there is room. Returns the number of its answer.
    pub fn send(&mut self, command: Command) -> Option<u8> {
        let id = self.id % 250 + 1;
        self.link.send(&Request { id, command }).ok()?;
        self.id = id;
        Some(id)
    }

    /// Returns the answers received since the last call.
    pub fn take_answers(&mut self) -> Vec<(u8, Result<(), Refusal>)> {
        core::mem::take(&mut self.answers)
    }

    /// Sends a command as soon as there is room, and waits for the answer.
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

    /// Requests telemetry and returns it.
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

    /// Starts a job at the present pose and sends all of its setpoints and its end.
    pub fn start_job(&mut self, job: u32, setpoints: &[Setpoint]) {
        let start = self.status().commanded;
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
        let start = self.status().commanded;
        let batches = batches(self.machine.config.period_us, &start, setpoints);
        self.ask(Command::JobStart { job, pose: start })?;
        for batch in batches {
            self.ask(batch)?;
        }
        let count = setpoints.len() as u32;
        self.ask(Command::JobEnd { count })
    }

    /// Starts a job at `start`, the present pose, and sends setpoints without the end of the job.
    pub fn start_part(&mut self, job: u32, start: &AxisValues, setpoints: &[Setpoint]) {
        self.ask(Command::JobStart {
            job,
            pose: start.clone(),
        })
        .expect("started");
        for batch in batches(self.machine.config.period_us, start, setpoints) {
            self.ask(batch).expect("accepted");
        }
    }

    /// Waits for a state for at most `periods` control periods. Returns whether it was reached.
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

/// Returns the setpoints of a job that begins at `start` as commands.
#[must_use]
pub fn batches(period_us: u16, start: &AxisValues, setpoints: &[Setpoint]) -> Vec<Command> {
    let mut coder = SetpointCoder::new(period_us, start);
    let batches = setpoints.chunks(SETPOINT_BATCH).enumerate();
    batches
        .map(|(index, batch)| {
            Command::Setpoints(SetpointBatch {
                first: (index * SETPOINT_BATCH) as u32,
                items: batch
                    .iter()
                    .map(|setpoint| coder.encode(setpoint).expect("encodes"))
                    .collect(),
            })
        })
        .collect()
}

/// Returns a straight line in x from `start`: 0.1 s of acceleration to `speed` (mm/s), `spans`
/// times 0.1 s at that speed, 0.1 s of deceleration.
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
