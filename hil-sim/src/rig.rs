//! The rig: plant, controller and serial line to the host, in lockstep and in virtual time.
//!
//! [`Rig::step`] simulates one control period:
//!
//! * Faults that are due begin and end.
//! * Bytes that have arrived pass the detector of out-of-band stops and enter the receive ring of
//!   the board.
//! * The inputs are latched, and the controller is called.
//! * The plant advances by one period under the outputs of the call *before*, because outputs take
//!   effect at the start of the next period.
//!
//! In a missed period the controller is not called: torques stay, and no pulses are emitted.
//!
//! The rig does not read the wall clock. Callers that need real time call `step` at that pace.

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
use haptimill_protocol::out_of_band::StopDetector;
use std::collections::VecDeque;

/// Capacity of the board's transmit ring, bytes.
const TRANSMIT_RING: usize = 256;

/// The controller's interface to the rig.
pub trait Control {
    /// Runs one control period.
    fn tick(&mut self, inputs: &Inputs, outputs: &mut Outputs);

    /// Takes the bytes that have arrived on the line since the last period. A controller with its
    /// own line model reads them here instead of [`Inputs::received`], and counts its lost and
    /// waiting bytes itself.
    fn arrived(&mut self, _bytes: &[u8]) {}

    /// State of the controller after the last period. `None` before it is configured, and for a
    /// controller that provides no snapshot.
    fn snapshot(&self, _inputs: &Inputs) -> Option<Snapshot> {
        None
    }

    /// Additional periods that the last call took. The rig counts them as missed.
    fn overrun(&self) -> u16 {
        0
    }

    /// Reason why the controller has stopped; its outputs are safe from then on.
    fn failure(&self) -> Option<&str> {
        None
    }
}

/// Controller of this project, in the same process.
impl Control for haptimill_firmware::controller::Controller {
    fn tick(&mut self, inputs: &Inputs, outputs: &mut Outputs) {
        Self::tick(self, inputs, outputs, &mut ());
    }

    fn snapshot(&self, inputs: &Inputs) -> Option<Snapshot> {
        Self::snapshot(self, inputs)
    }
}

/// Options of a rig, besides its plant configuration.
#[derive(Debug, Clone)]
pub struct RigOptions {
    /// Control period, microseconds.
    pub period_us: u16,
    /// Rate of the serial line in both directions, bit/s; `None` is unlimited.
    pub baud: Option<u32>,
    /// Capacity of the board's receive ring, bytes. Bytes beyond it are lost and counted.
    pub ring_bytes: usize,
    /// Faults to inject, with their times.
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

/// Error in the configuration of a rig.
#[derive(Debug, Clone, PartialEq)]
pub enum RigError {
    /// The plant configuration is invalid; all problems.
    Plant(Vec<PlantError>),
    /// A fault is invalid for this machine.
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

/// Plant, controller and serial line.
#[derive(Debug)]
pub struct Rig<C> {
    control: C,
    plant: Plant,
    schedule: Schedule,
    to_machine: SerialLine,
    to_host: SerialLine,
    ring: VecDeque<u8>,
    /// Bytes that arrived in this period.
    arrived: Vec<u8>,
    /// Periods that the controller is late.
    late: u16,
    ring_bytes: usize,
    stop_detector: StopDetector,
    out_of_band_stop: bool,
    lost_bytes: u16,
    missed: u16,
    inputs: Inputs,
    outputs: Outputs,
    /// Ground truth at the time when the inputs were latched.
    truth: GroundTruth,
    /// Outputs in effect during the current period.
    effective: Outputs,
}

impl<C: Control> Rig<C> {
    /// Connects a controller to a plant at standstill.
    ///
    /// # Errors
    /// The plant configuration or a fault is invalid.
    pub fn new(config: &PlantConfig, options: &RigOptions, control: C) -> Result<Self, RigError> {
        let plant = Plant::new(config, options.period_us).map_err(RigError::Plant)?;
        let joints: Vec<&str> = config
            .joint
            .iter()
            .map(|joint| joint.name.as_str())
            .collect();
        let inputs: Vec<&str> = config
            .input
            .iter()
            .map(|input| input.name.as_str())
            .collect();
        let schedule = Schedule::new(&options.faults, &joints, &inputs).map_err(RigError::Fault)?;
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
            stop_detector: StopDetector::new(),
            out_of_band_stop: false,
            lost_bytes: 0,
            missed: 0,
            inputs: Inputs::default(),
            outputs: Outputs::default(),
            effective: Outputs::default(),
        })
    }

    /// Whether the controller is late: it misses the next period.
    #[must_use]
    pub const fn is_late(&self) -> bool {
        self.late > 0
    }

    /// Simulates one control period. Returns false when the controller missed it.
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
        self.inputs.out_of_band_stop = core::mem::take(&mut self.out_of_band_stop);
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
            // The push cannot fail: the loop ends at the capacity.
            let _ = self.inputs.received.push(byte);
        }
        self.inputs.waiting = u16::try_from(self.ring.len()).unwrap_or(u16::MAX);
        self.outputs.transmit.clear();
        self.control.tick(&self.inputs, &mut self.outputs);
        self.late = self.control.overrun();
        self.plant.advance(&self.effective);
        // The bytes enter the line at the end of the period, when the outputs take effect.
        self.to_host
            .write(&self.outputs.transmit, self.plant.time_ns());
        self.effective.joints = self.outputs.joints;
        self.effective.spindle_rpm = self.outputs.spindle_rpm;
        self.effective.haptic = self.outputs.haptic;
        self.effective.digital = self.outputs.digital;
        self.effective.analog = self.outputs.analog;
        true
    }

    /// Reads the bytes that have arrived on the line.
    fn listen(&mut self, now: u64) {
        self.arrived.clear();
        while let Some(byte) = self.to_machine.read(now) {
            self.arrived.push(byte);
            if self.stop_detector.push(byte) {
                self.out_of_band_stop = true;
            }
            if self.ring.len() < self.ring_bytes {
                self.ring.push_back(byte);
            } else {
                self.lost_bytes = self.lost_bytes.wrapping_add(1);
            }
        }
        self.control.arrived(&self.arrived);
    }

    /// Writes bytes of the host to the line, at the present virtual time.
    pub fn host_write(&mut self, bytes: &[u8]) {
        self.to_machine.write(bytes, self.plant.time_ns());
    }

    /// Appends the bytes that have arrived at the host to `bytes`.
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

    /// Inputs of the last call of the controller.
    pub const fn inputs(&self) -> &Inputs {
        &self.inputs
    }

    /// Outputs of the last call of the controller; they are in effect in the coming period.
    pub const fn outputs(&self) -> &Outputs {
        &self.outputs
    }

    /// Ground truth at the time when [`Rig::inputs`] were latched; [`Plant::truth`] is the present
    /// one.
    pub const fn truth(&self) -> &GroundTruth {
        &self.truth
    }

    /// The plant.
    pub const fn plant(&self) -> &Plant {
        &self.plant
    }

    /// The plant, with mutable access for fault injection.
    pub const fn plant_mut(&mut self) -> &mut Plant {
        &mut self.plant
    }

    /// The controller.
    pub const fn control(&self) -> &C {
        &self.control
    }

    /// The controller, with mutable access for fault injection.
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

/// Clears the pulses. In a missed period torques stay on their DACs, but pulses do not repeat.
fn end_pulses(outputs: &mut Outputs) {
    for command in &mut outputs.joints {
        if let DriveCommand::Steps(segment) = command {
            *segment = StepSegment::default();
        }
    }
}
