//! Connection to the controller: opened in the background, reopened after a loss.
//!
//! Opening a port may take seconds (name resolution, a machine that is switched off), so a thread
//! does it while key input continues.

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

/// First and longest delay between two attempts.
const RETRY: (Duration, Duration) = (Duration::from_millis(300), Duration::from_secs(2));

/// Sleep after an exchange without data from the simulated machine.
const IDLE_SLEEP: Duration = Duration::from_micros(500);

/// The simulated machine in this process, in real time.
struct PacedSim {
    rig: Rig<Controller>,
    /// Operator model at its haptic arm.
    operator: Option<ScriptedOperator>,
    pace: Pace,
    started: Instant,
}

impl Line for PacedSim {
    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError> {
        if !transmit.is_empty() {
            self.rig.host_write(transmit);
        }
        let real_ns = u64::try_from(self.started.elapsed().as_nanos()).unwrap_or(u64::MAX);
        for _ in 0..self.pace.due(real_ns, self.rig.time_ns()) {
            if let Some(operator) = &mut self.operator {
                operator.act(&mut self.rig);
            }
            self.rig.step();
        }
        let before = received.len();
        self.rig.host_read(received);
        if received.len() == before {
            std::thread::sleep(IDLE_SLEEP);
        }
        Ok(self.rig.time_ns() / 1000)
    }

    fn name(&self) -> String {
        "simulator".to_string()
    }
}

/// Progress of the connection.
pub(super) enum Progress {
    /// No change.
    Nothing,
    /// A line was opened; a session can start.
    Open,
    /// The port cannot be opened now; the next attempt follows automatically.
    Failed(PortError),
}

enum Stage {
    /// A thread opens the port.
    Opening(Receiver<Result<Box<dyn Transport>, PortError>>),
    /// Next attempt at this time.
    Waiting(Instant),
    Open(Box<PortLine>),
    Simulated(Box<PacedSim>),
}

/// The line to the controller, and the state of its opening.
pub(super) struct Connection {
    spec: PortSpec,
    baud: u32,
    stage: Stage,
    retry_delay: Duration,
}

fn open_in_thread(spec: &PortSpec, baud: u32) -> Stage {
    let (sender, receiver) = mpsc::channel();
    let spec = spec.clone();
    std::thread::spawn(move || {
        // The receiver is gone if the console has quit meanwhile.
        let _ = sender.send(port::open(&spec, baud));
    });
    Stage::Opening(receiver)
}

impl Connection {
    /// Starts to open a port. The simulator of `machine` is open at once.
    pub(super) fn new(
        spec: &PortSpec,
        baud: u32,
        machine: &MachineFile,
        seed: Option<u64>,
        faults: Vec<Fault>,
        operator: Option<&Script>,
    ) -> Result<Self, CliError> {
        let stage = match spec {
            PortSpec::Simulator => Stage::Simulated(Box::new(PacedSim {
                rig: session::rig(machine, seed, None, faults)?,
                operator: operator.map(ScriptedOperator::new),
                pace: Pace::new(u64::from(machine.config.period_us) * 1000),
                started: Instant::now(),
            })),
            spec => open_in_thread(spec, baud),
        };
        Ok(Self {
            spec: spec.clone(),
            baud,
            stage,
            retry_delay: RETRY.0,
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

    /// Clamps stock on the table of the simulated machine in this process, at the present tool
    /// position.
    ///
    /// # Errors
    /// There is no simulated machine, or the stock is invalid for it.
    pub(super) fn clamp(&mut self, stock: &CuttingConfig) -> Result<(), String> {
        let Stage::Simulated(sim) = &mut self.stage else {
            return Err("there is no simulated machine in this process".to_string());
        };
        sim.rig.plant_mut().clamp(stock).map_err(|problems| {
            let problems: Vec<String> = problems.iter().map(ToString::to_string).collect();
            problems.join("; ")
        })
    }

    /// Displayed name of the port.
    pub(super) fn name(&self) -> String {
        match &self.spec {
            PortSpec::Simulator => "simulator".to_string(),
            spec => spec.to_string(),
        }
    }

    /// Drops the line and schedules the next attempt.
    pub(super) fn drop_line(&mut self) {
        self.schedule_retry();
    }

    fn schedule_retry(&mut self) {
        self.stage = Stage::Waiting(Instant::now() + self.retry_delay);
        self.retry_delay = (self.retry_delay * 2).min(RETRY.1);
    }

    /// Resets the retry delay, since a session is open.
    pub(super) fn reset_backoff(&mut self) {
        self.retry_delay = RETRY.0;
    }

    /// Advances the opening of the port. Never blocks.
    pub(super) fn advance(&mut self) -> Progress {
        match &self.stage {
            Stage::Open(_) | Stage::Simulated(_) => Progress::Nothing,
            Stage::Waiting(until) if Instant::now() < *until => Progress::Nothing,
            Stage::Waiting(_) => {
                self.stage = open_in_thread(&self.spec, self.baud);
                Progress::Nothing
            }
            Stage::Opening(receiver) => match receiver.try_recv() {
                Ok(Ok(port)) => {
                    self.stage = Stage::Open(Box::new(PortLine::new(port)));
                    Progress::Open
                }
                Ok(Err(error)) => {
                    self.schedule_retry();
                    Progress::Failed(error)
                }
                Err(TryRecvError::Empty) => Progress::Nothing,
                Err(TryRecvError::Disconnected) => {
                    self.schedule_retry();
                    Progress::Nothing
                }
            },
        }
    }
}
