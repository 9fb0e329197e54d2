//! A machine, a controller and a serial line between them and the host, in lockstep and in virtual time.
//!
//! [`Rig::step`] is one control period: faults that are due come and go; bytes that have arrived go through the urgent recogniser into the
//! board's ring; inputs are latched; the controller is called; then the machine moves for a period under the outputs of the call *before*,
//! since outputs take effect at the start of the next period. In a missed period the controller is not called: torques stay, pulses end.
//!
//! Nothing here knows the wall clock; whoever wants real time calls `step` at its pace.

use crate::check::PlantError;
use crate::config::PlantConfig;
use crate::fault::{Fault, FaultError};
use crate::line::SerialLine;
use crate::plant::{GroundTruth, Plant};
use crate::random::Random;
use crate::schedule::Schedule;
use core::fmt;
use haptimill_firmware::io::{DriveCommand, Inputs, Outputs, RECEIVE_BYTES, StepSegment};
use haptimill_firmware::snapshot::Snapshot;
use haptimill_protocol::urgent::UrgentDetector;
use std::collections::VecDeque;

/// Bytes that the board's transmit ring holds.
const TRANSMIT_RING: usize = 256;

/// A controller as the rig sees it.
pub trait Control {
    /// One control period.
    fn tick(&mut self, inputs: &Inputs, outputs: &mut Outputs);

    /// Bytes that have arrived on the line since the last period. A controller with a line of its own takes them from here, not from
    /// [`Inputs::received`]; lost and waiting ones are then its own affair.
    fn arrived(&mut self, _bytes: &[u8]) {}

    /// How the controller stands after the last period; `None` before it is configured, and of a controller that does not tell.
    fn snapshot(&self, _inputs: &Inputs) -> Option<Snapshot> {
        None
    }

    /// Periods that the last one took beyond its own: they are missed.
    fn overrun(&self) -> u16 {
        0
    }

    /// Why the controller does nothing any more; its outputs are safe from then on.
    fn failure(&self) -> Option<&str> {
        None
    }
}

/// The controller of this project, in the same process.
impl Control for haptimill_firmware::controller::Controller {
    fn tick(&mut self, inputs: &Inputs, outputs: &mut Outputs) {
        Self::tick(self, inputs, outputs, &mut ());
    }

    fn snapshot(&self, inputs: &Inputs) -> Option<Snapshot> {
        Self::snapshot(self, inputs)
    }
}

/// How a rig is put together, besides its machine.
#[derive(Debug, Clone)]
pub struct RigOptions {
    /// Control period, microseconds.
    pub period_us: u16,
    /// Speed of the serial line in both directions; `None` is as fast as may be.
    pub baud: Option<u32>,
    /// Bytes that the board's receive ring holds; what comes on top is lost and counted.
    pub ring_bytes: usize,
    /// What goes wrong, and when.
    pub faults: Vec<Fault>,
}

impl Default for RigOptions {
    fn default() -> Self {
        Self {
            period_us: 200,
            baud: None,
            ring_bytes: haptimill_firmware::comm::rx_ring::RING_BYTES,
            faults: Vec::new(),
        }
    }
}

/// Why a rig cannot be put together.
#[derive(Debug, Clone, PartialEq)]
pub enum RigError {
    /// The machine makes no sense; every problem.
    Plant(Vec<PlantError>),
    /// A fault makes no sense on this machine.
    Fault(FaultError),
}

impl fmt::Display for RigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Plant(problems) => {
                for (place, problem) in problems.iter().enumerate() {
                    if place > 0 {
                        f.write_str("\n")?;
                    }
                    write!(f, "{problem}")?;
                }
                Ok(())
            }
            Self::Fault(error) => write!(f, "{error}"),
        }
    }
}

impl core::error::Error for RigError {}

/// A machine with its controller and its serial line.
#[derive(Debug)]
pub struct Rig<C> {
    control: C,
    plant: Plant,
    schedule: Schedule,
    to_machine: SerialLine,
    to_host: SerialLine,
    ring: VecDeque<u8>,
    /// What arrived in this period.
    arrived: Vec<u8>,
    /// Periods that the controller is behind.
    late: u16,
    ring_bytes: usize,
    urgent: UrgentDetector,
    urgent_seen: bool,
    lost_bytes: u16,
    missed: u16,
    inputs: Inputs,
    outputs: Outputs,
    /// What really was when the inputs were latched.
    truth: GroundTruth,
    /// Outputs in effect during the current period.
    effective: Outputs,
}

impl<C: Control> Rig<C> {
    /// Puts a controller on a machine at rest.
    ///
    /// # Errors
    /// The machine or a fault makes no sense.
    pub fn new(config: &PlantConfig, options: &RigOptions, control: C) -> Result<Self, RigError> {
        let plant = Plant::new(config, options.period_us).map_err(RigError::Plant)?;
        let joints: Vec<&str> = config
            .joint
            .iter()
            .map(|joint| joint.name.as_str())
            .collect();
        let schedule = Schedule::new(&options.faults, &joints).map_err(RigError::Fault)?;
        Ok(Self {
            control,
            truth: *plant.truth(),
            plant,
            schedule,
            to_machine: SerialLine::new(options.baud, Random::new(config.seed, 32)),
            to_host: SerialLine::new(options.baud, Random::new(config.seed, 33)),
            ring: VecDeque::with_capacity(options.ring_bytes),
            arrived: Vec::new(),
            late: 0,
            ring_bytes: options.ring_bytes,
            urgent: UrgentDetector::new(),
            urgent_seen: false,
            lost_bytes: 0,
            missed: 0,
            inputs: Inputs::default(),
            outputs: Outputs::default(),
            effective: Outputs::default(),
        })
    }

    /// One control period; false when the controller missed it.
    pub fn step(&mut self) -> bool {
        let now = self.plant.time_ns();
        let miss = self.schedule.apply(
            now,
            &mut self.plant,
            &mut self.to_machine,
            &mut self.to_host,
        );
        self.listen(now);
        if miss || self.late > 0 {
            self.late = self.late.saturating_sub(1);
            self.missed = self.missed.saturating_add(1);
            self.plant.advance(&self.effective);
            end_pulses(&mut self.effective);
            return false;
        }
        self.plant.latch(&mut self.inputs);
        self.truth = *self.plant.truth();
        self.inputs.urgent = core::mem::take(&mut self.urgent_seen);
        self.inputs.missed = self.missed;
        self.missed = 0;
        self.inputs.lost_bytes = self.lost_bytes;
        let unsent = self.to_host.unsent(now);
        self.inputs.transmit_room = TRANSMIT_RING.saturating_sub(unsent) as u16;
        self.inputs.received.clear();
        while self.inputs.received.len() < RECEIVE_BYTES {
            let Some(byte) = self.ring.pop_front() else {
                break;
            };
            // There is room: the loop ends at the capacity.
            let _ = self.inputs.received.push(byte);
        }
        self.inputs.waiting = u16::try_from(self.ring.len()).unwrap_or(u16::MAX);
        self.outputs.transmit.clear();
        self.control.tick(&self.inputs, &mut self.outputs);
        self.late = self.control.overrun();
        self.plant.advance(&self.effective);
        // Said at the end of the period, when the outputs are taken over.
        self.to_host
            .write(&self.outputs.transmit, self.plant.time_ns());
        self.effective.axes = self.outputs.axes;
        self.effective.spindle_rpm = self.outputs.spindle_rpm;
        self.effective.haptic = self.outputs.haptic;
        true
    }

    /// Takes from the line what has arrived.
    fn listen(&mut self, now: u64) {
        self.arrived.clear();
        while let Some(byte) = self.to_machine.read(now) {
            self.arrived.push(byte);
            if self.urgent.push(byte) {
                self.urgent_seen = true;
            }
            if self.ring.len() < self.ring_bytes {
                self.ring.push_back(byte);
            } else {
                self.lost_bytes = self.lost_bytes.wrapping_add(1);
            }
        }
        self.control.arrived(&self.arrived);
    }

    /// The host writes to its port, now.
    pub fn host_write(&mut self, bytes: &[u8]) {
        self.to_machine.write(bytes, self.plant.time_ns());
    }

    /// What has arrived at the host is added to `bytes`.
    pub fn host_read(&mut self, bytes: &mut Vec<u8>) {
        let now = self.plant.time_ns();
        while let Some(byte) = self.to_host.read(now) {
            bytes.push(byte);
        }
    }

    /// Virtual time, ns.
    pub const fn time_ns(&self) -> u64 {
        self.plant.time_ns()
    }

    /// What the controller saw last.
    pub const fn inputs(&self) -> &Inputs {
        &self.inputs
    }

    /// What the controller said last; in effect in the period that comes now.
    pub const fn outputs(&self) -> &Outputs {
        &self.outputs
    }

    /// What really was when [`Rig::inputs`] were latched; [`Plant::truth`] tells what is now.
    pub const fn truth(&self) -> &GroundTruth {
        &self.truth
    }

    /// The machine.
    pub const fn plant(&self) -> &Plant {
        &self.plant
    }

    /// The machine, to be meddled with.
    pub const fn plant_mut(&mut self) -> &mut Plant {
        &mut self.plant
    }

    /// The controller.
    pub const fn control(&self) -> &C {
        &self.control
    }

    /// The controller, to be meddled with.
    pub const fn control_mut(&mut self) -> &mut C {
        &mut self.control
    }

    /// The line from host to machine.
    pub const fn to_machine(&self) -> &SerialLine {
        &self.to_machine
    }

    /// The line from machine to host.
    pub const fn to_host(&self) -> &SerialLine {
        &self.to_host
    }
}

/// In a missed period torques stay on their DACs, but pulses do not repeat.
fn end_pulses(outputs: &mut Outputs) {
    for command in &mut outputs.axes {
        if let DriveCommand::Steps(segment) = command {
            *segment = StepSegment::default();
        }
    }
}
