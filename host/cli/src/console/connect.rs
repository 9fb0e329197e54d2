//! The way to the controller: opened beside the console, lost, and found again.
//!
//! Opening a port may take seconds (a name to be looked up, a machine that is off), so a thread of its own does it; keys are heard meanwhile.

use crate::commands::CliError;
use crate::commands::sim::Pace;
use haptimill_client::port::{self, PortError, PortSpec, Transport};
use haptimill_client::session::{self, Line, PortLine};
use haptimill_firmware::controller::Controller;
use haptimill_hil_sim::fault::Fault;
use haptimill_hil_sim::process::CuttingConfig;
use haptimill_hil_sim::rig::Rig;
use haptimill_machine_file::MachineFile;
use haptimill_teleop::script::{Script, ScriptedOperator};
use std::sync::mpsc::{self, Receiver, TryRecvError};
use std::time::{Duration, Instant};

/// First and longest pause between two attempts.
const AGAIN: (Duration, Duration) = (Duration::from_millis(300), Duration::from_secs(2));

/// Pause between two looks at the clock when the simulated machine said nothing.
const REST: Duration = Duration::from_micros(500);

/// The simulated machine in this process, in step with the clock on the wall.
struct PacedSim {
    rig: Rig<Controller>,
    /// Who holds the handle of its haptic arm.
    person: Option<ScriptedOperator>,
    pace: Pace,
    begun: Instant,
}

impl Line for PacedSim {
    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError> {
        if !transmit.is_empty() {
            self.rig.host_write(transmit);
        }
        let real_ns = u64::try_from(self.begun.elapsed().as_nanos()).unwrap_or(u64::MAX);
        for _ in 0..self.pace.due(real_ns, self.rig.time_ns()) {
            if let Some(person) = &mut self.person {
                person.act(&mut self.rig);
            }
            self.rig.step();
        }
        let before = received.len();
        self.rig.host_read(received);
        if received.len() == before {
            std::thread::sleep(REST);
        }
        Ok(self.rig.time_ns() / 1000)
    }

    fn name(&self) -> String {
        "simulator".to_string()
    }
}

/// What became of a look at the connection.
pub(super) enum Reached {
    /// Nothing new.
    Nothing,
    /// A line is open; a session can begin.
    Line,
    /// The port cannot be opened now; it is tried again by itself.
    Failed(PortError),
}

enum Stage {
    /// A thread opens the port.
    Opening(Receiver<Result<Box<dyn Transport>, PortError>>),
    /// It is tried again then.
    Waiting(Instant),
    Open(Box<PortLine>),
    Simulated(Box<PacedSim>),
}

/// The line to the controller, and how it is got.
pub(super) struct Connection {
    spec: PortSpec,
    baud: u32,
    stage: Stage,
    pause: Duration,
}

fn opening(spec: &PortSpec, baud: u32) -> Stage {
    let (sender, receiver) = mpsc::channel();
    let spec = spec.clone();
    std::thread::spawn(move || {
        // Nobody listens any more when the console was left meanwhile.
        let _ = sender.send(port::open(&spec, baud));
    });
    Stage::Opening(receiver)
}

impl Connection {
    /// Begins to open a port; the simulator of `machine` is there at once.
    pub(super) fn new(
        spec: &PortSpec,
        baud: u32,
        machine: &MachineFile,
        seed: Option<u64>,
        faults: Vec<Fault>,
        person: Option<&Script>,
    ) -> Result<Self, CliError> {
        let stage = match spec {
            PortSpec::Simulator => Stage::Simulated(Box::new(PacedSim {
                rig: session::rig(machine, seed, None, faults)?,
                person: person.map(ScriptedOperator::new),
                pace: Pace::new(u64::from(machine.config.period_us) * 1000),
                begun: Instant::now(),
            })),
            spec => opening(spec, baud),
        };
        Ok(Self {
            spec: spec.clone(),
            baud,
            stage,
            pause: AGAIN.0,
        })
    }

    /// The open line.
    pub(super) fn line(&mut self) -> Option<&mut dyn Line> {
        match &mut self.stage {
            Stage::Open(line) => Some(line.as_mut()),
            Stage::Simulated(sim) => Some(sim.as_mut()),
            _ => None,
        }
    }

    /// Clamps a work on the table of the simulated machine in this process, with the tool where it stands.
    ///
    /// # Errors
    /// In words: the work makes no sense there.
    pub(super) fn clamp(&mut self, work: &CuttingConfig) -> Result<(), String> {
        let Stage::Simulated(sim) = &mut self.stage else {
            return Err("there is no simulated machine in this process".to_string());
        };
        sim.rig.plant_mut().clamp(work).map_err(|problems| {
            let problems: Vec<String> = problems.iter().map(ToString::to_string).collect();
            problems.join("; ")
        })
    }

    /// What people call it.
    pub(super) fn name(&self) -> String {
        match &self.spec {
            PortSpec::Simulator => "simulator".to_string(),
            spec => spec.to_string(),
        }
    }

    /// The line is of no use any more; another attempt follows by itself.
    pub(super) fn drop_line(&mut self) {
        self.wait();
    }

    fn wait(&mut self) {
        self.stage = Stage::Waiting(Instant::now() + self.pause);
        self.pause = (self.pause * 2).min(AGAIN.1);
    }

    /// A session is open: the next attempt, if one is needed, comes soon.
    pub(super) fn is_good(&mut self) {
        self.pause = AGAIN.0;
    }

    /// Goes on with the way to the port. Does not wait.
    pub(super) fn advance(&mut self) -> Reached {
        match &self.stage {
            Stage::Open(_) | Stage::Simulated(_) => Reached::Nothing,
            Stage::Waiting(until) if Instant::now() < *until => Reached::Nothing,
            Stage::Waiting(_) => {
                self.stage = opening(&self.spec, self.baud);
                Reached::Nothing
            }
            Stage::Opening(receiver) => match receiver.try_recv() {
                Ok(Ok(port)) => {
                    self.stage = Stage::Open(Box::new(PortLine::new(port)));
                    Reached::Line
                }
                Ok(Err(error)) => {
                    self.wait();
                    Reached::Failed(error)
                }
                Err(TryRecvError::Empty) => Reached::Nothing,
                Err(TryRecvError::Disconnected) => {
                    self.wait();
                    Reached::Nothing
                }
            },
        }
    }
}
