//! The built-in simulator as a line: controller, machine and serial line, in virtual time.

use super::haptic_trace::{HapticTrace, HapticTraceRecorder};
use super::{JobLine, Line, Session, fresh_number};
use crate::client::Options;
use crate::port::PortError;
use crate::{Error, ErrorKind};
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{Inputs, Outputs};
use haptimill_firmware::motion::interpolator::FULL_FACTOR;
use haptimill_firmware::snapshot::{ForceSnapshot, HapticSnapshot, Snapshot};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::fault::Fault;
use haptimill_hil_sim::plant::GroundTruth;
use haptimill_hil_sim::process::{CuttingConfig, Workpiece};
use haptimill_hil_sim::rig::{Control, Rig, RigError, RigOptions};
use haptimill_machine_file::MachineFile;
use haptimill_planner::SharedTrack;
use haptimill_protocol::haptic::{COMPONENTS, MasterTelemetry};
use haptimill_protocol::message::{ANALOG, AxisValues, MAX_AXES, State, Telemetry};
use haptimill_trace::{IoLog, Record, Recorder, flag};
use std::sync::Arc;

/// A simulated machine in this process.
pub struct SimLine<C = Controller> {
    rig: Rig<C>,
    name: String,
    /// I/O since the power-on of the controller, until a recording starts.
    io_log: Option<IoLog>,
    /// Events before the recording.
    record_event: Vec<(u64, u8, String)>,
    recording: Option<JobRecording>,
    haptic_trace: Option<HapticTraceRecorder>,
}

/// Events before a recording that are kept.
const MAX_EVENTS: usize = 1000;

/// A recording of a job, with the ground truth of a simulated machine and the programmed geometry.
pub struct JobRecording {
    recorder: Recorder,
    /// The programmed motion; `None` in teleoperation, where nothing is programmed.
    track: Option<SharedTrack>,
    /// Axis units per millimetre or degree of the pose coordinates.
    units: [f64; MAX_AXES],
    /// Pose coordinates that wrap around, one bit each.
    wrapping: u8,
    /// The newest telemetry of the master, for a controller behind a port.
    master: Option<MasterTelemetry>,
}

/// Telemetry frames, 20 ms apart or more, after which the recording is written to disk.
const SPILL_EVERY: u64 = 12;

/// Builds the simulated machine of a machine file.
///
/// # Errors
/// The file has no `[plant]` section, or the machine cannot have one of the faults.
pub fn rig(
    machine: &MachineFile,
    seed: Option<u64>,
    baud: Option<u32>,
    faults: Vec<Fault>,
) -> Result<Rig<Controller>, Error> {
    let controller = Controller::new(machine.config.period_us);
    rig_around(controller, machine, seed, baud, faults)
}

/// As [`rig`], with any controller.
///
/// # Errors
/// As [`rig`].
pub fn rig_around<C: Control>(
    controller: C,
    machine: &MachineFile,
    seed: Option<u64>,
    baud: Option<u32>,
    faults: Vec<Fault>,
) -> Result<Rig<C>, Error> {
    let mut plant: PlantConfig = machine.plant()?;
    plant.seed = seed.unwrap_or(plant.seed);
    let period_us = machine.config.period_us;
    let options = RigOptions {
        period_us,
        baud,
        faults,
        ..RigOptions::default()
    };
    Rig::new(&plant, &options, controller).map_err(|error| match error {
        RigError::Plant(_) => Error::in_file(&machine.file, error),
        RigError::Fault(error) => Error::new(ErrorKind::Usage, format!("--{error}")),
    })
}

/// Configures the controller of a simulated machine over its line, as the manufacturer does before
/// delivery.
///
/// # Errors
/// A fault of the machine or of its line prevents it; with the machine, which has no configuration.
#[allow(clippy::result_large_err)]
pub fn commissioned(
    rig: Rig<Controller>,
    machine: &MachineFile,
) -> Result<Rig<Controller>, (Rig<Controller>, Error)> {
    let options = Options {
        connect_us: COMMISSION_US,
        ..Options::default()
    };
    let mut line = SimLine::new(rig);
    line.io_log = None;
    let mut session = Session::new(line, machine, options, Arc::default());
    let done = session
        .connect(fresh_number())
        .and_then(|()| session.configure(machine));
    let mut rig = session.into_line().rig;
    // The remaining bytes of this session must not reach the next host.
    rig.host_read(&mut Vec::new());
    match done {
        Ok(()) => Ok(rig),
        Err(error) => Err((rig, error)),
    }
}

/// Timeout of the controller of a simulated machine that is being configured, microseconds of its
/// time.
const COMMISSION_US: u64 = 2_000_000;

impl<C: Control> SimLine<C> {
    /// A line to a simulated machine.
    #[must_use]
    pub fn new(rig: Rig<C>) -> Self {
        Self::named(rig, "simulator")
    }

    /// A line to a simulated machine with this name.
    #[must_use]
    pub fn named(rig: Rig<C>, name: &str) -> Self {
        // The I/O log must begin at the power-on of the controller.
        let io_log = (rig.time_ns() == 0).then(IoLog::new);
        Self {
            rig,
            name: name.to_string(),
            io_log,
            record_event: Vec::new(),
            recording: None,
            haptic_trace: None,
        }
    }

    /// Keeps no I/O log: nothing of this line will be recorded.
    #[must_use]
    pub fn unrecorded(mut self) -> Self {
        self.io_log = None;
        self
    }

    /// Starts a haptic trace.
    pub fn begin_haptic_trace(&mut self) {
        self.haptic_trace = Some(HapticTraceRecorder::default());
    }

    /// Ends the haptic trace, and returns it.
    pub fn end_haptic_trace(&mut self) -> Option<HapticTrace> {
        self.haptic_trace
            .take()
            .map(HapticTraceRecorder::into_trace)
    }

    /// The machine with its controller and its line, for fault injection.
    pub const fn rig_mut(&mut self) -> &mut Rig<C> {
        &mut self.rig
    }

    /// The machine with its controller and its line, with the ground truth.
    #[must_use]
    pub const fn rig(&self) -> &Rig<C> {
        &self.rig
    }
}

/// Clamps stock on the table of a simulated machine, at the present position of the tool.
///
/// # Errors
/// The stock is invalid for the machine.
pub fn clamp<C: Control>(rig: &mut Rig<C>, stock: &CuttingConfig) -> Result<(), Error> {
    rig.plant_mut().clamp(stock).map_err(|problems| {
        let problems: Vec<String> = problems.iter().map(ToString::to_string).collect();
        Error::new(ErrorKind::BadInput, problems.join("\n"))
    })
}

impl<C: Control> JobLine for SimLine<C> {
    fn begin_recording(&mut self, mut recording: JobRecording) {
        if let Some(io_log) = self.io_log.take() {
            recording.start_io_log(io_log);
        }
        for (period, level, text) in self.record_event.drain(..) {
            recording.recorder.event(period, level, &text);
        }
        self.recording = Some(recording);
    }

    fn end_recording(&mut self) -> Option<Recorder> {
        self.recording.take().map(JobRecording::into_recorder)
    }
}

impl<C: Control> Line for SimLine<C> {
    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError> {
        if !transmit.is_empty() {
            self.rig.host_write(transmit);
        }
        let ticked = self.rig.step();
        if let Some(reason) = self.rig.control().failure() {
            return Err(PortError::Failed {
                name: self.name.clone(),
                reason: reason.to_string(),
            });
        }
        self.rig.host_read(received);
        if ticked {
            match (&mut self.recording, &mut self.io_log) {
                (Some(recording), _) => recording.add(&PeriodSeen::of(&self.rig)),
                (None, Some(io_log)) => io_log.add(self.rig.inputs(), self.rig.outputs()),
                (None, None) => {}
            }
        }
        if ticked
            && let Some(trace) = &mut self.haptic_trace
            && let Some(snapshot) = self.rig.control().snapshot(self.rig.inputs())
        {
            trace.sample(self.rig.plant(), &snapshot);
        }
        Ok(self.rig.time_ns() / 1000)
    }

    fn name(&self) -> String {
        self.name.clone()
    }

    fn clamp(&mut self, stock: &CuttingConfig) -> Result<(), Error> {
        clamp(&mut self.rig, stock)
    }

    fn stock(&mut self) -> Option<&Workpiece> {
        let cutting = self.rig.plant_mut().process_mut()?.cutting_mut()?;
        cutting.settle();
        Some(cutting.workpiece())
    }

    fn truth(&self) -> Option<&GroundTruth> {
        Some(self.rig.plant().truth())
    }

    fn is_recording_broken(&self) -> bool {
        self.recording.as_ref().is_some_and(JobRecording::is_broken)
    }

    fn snapshot(&self) -> Option<Snapshot> {
        self.rig.control().snapshot(self.rig.inputs())
    }

    fn record_event(&mut self, period: u64, level: u8, text: &str) {
        match &mut self.recording {
            Some(recording) => recording.add_event(period, level, text),
            None if self.record_event.len() < MAX_EVENTS => {
                self.record_event.push((period, level, text.to_string()));
            }
            None => {}
        }
    }
}

impl JobRecording {
    /// The line of the program of the motion towards a setpoint.
    pub(super) fn line_of(&self, setpoint: u32) -> Option<u32> {
        let track = self.track.as_ref()?;
        Some(track.lock().place_of(setpoint).line)
    }

    /// A recording of a job with its programmed motion. What the machine has passed is forgotten.
    #[must_use]
    pub fn new(recorder: Recorder, track: SharedTrack, machine: &MachineFile) -> Self {
        Self {
            track: Some(track),
            ..Self::unplanned(recorder, machine)
        }
    }

    /// A recording of a job without a plan: teleoperation.
    #[must_use]
    pub fn unplanned(recorder: Recorder, machine: &MachineFile) -> Self {
        let mut units = [1.0; MAX_AXES];
        for (slot, axis) in units.iter_mut().zip(&machine.config.pose) {
            *slot = haptimill_machine_file::scale::per_unit(axis.kind);
        }
        Self {
            recorder,
            track: None,
            units,
            wrapping: machine.config.wrapping(),
            master: None,
        }
    }

    /// The recorder.
    #[must_use]
    pub fn into_recorder(self) -> Recorder {
        self.recorder
    }

    /// Whether it ended before the job, because the disk is full or failed.
    #[must_use]
    pub fn is_broken(&self) -> bool {
        self.recorder.is_broken()
    }

    /// Adds an event.
    pub fn add_event(&mut self, period: u64, level: u8, text: &str) {
        self.recorder.event(period, level, text);
    }

    /// Adds telemetry of the master behind a port; it is recorded with the next telemetry frame.
    pub const fn add_master(&mut self, master: &MasterTelemetry) {
        self.master = Some(*master);
    }

    /// Adds a telemetry frame of a machine behind a port: the tool position is the measured one.
    pub fn add_telemetry(&mut self, telemetry: &Telemetry) {
        let mut record = Record {
            period: telemetry.period,
            setpoint: telemetry.setpoint,
            speed_factor: telemetry.speed_factor,
            state: telemetry.state,
            ..Record::default()
        };
        if let Some(force) = &telemetry.force {
            record.force = ForceSnapshot {
                high: force.high,
                low: force.low,
                displacement: force.displacement,
            };
        }
        if let Some(io) = &telemetry.io {
            record.io.inputs = io.inputs;
            record.io.outputs = io.outputs;
            let copy = |to: &mut [i16; ANALOG], from: &[i16]| {
                to.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
            };
            copy(&mut record.io.analog_inputs, &io.analog_inputs);
            copy(&mut record.io.analog_outputs, &io.analog_outputs);
        }
        let flags = [
            (telemetry.force.is_some(), flag::FORCE),
            (telemetry.homed, flag::HOMED),
            (!telemetry.measured.is_empty(), flag::TOOL_MEASURED),
            (telemetry.fault.is_some(), flag::FAULT),
            (telemetry.compensation() == Some(100), flag::COMPENSATED),
        ];
        record.flags = flags
            .iter()
            .filter(|(set, _)| *set)
            .fold(0, |all, (_, flag)| all | flag);
        let copy = |to: &mut [i32; MAX_AXES], from: &AxisValues| {
            to.iter_mut().zip(from).for_each(|(to, from)| *to = *from)
        };
        if let Some(master) = self.master.take() {
            let newtons = |force: [i16; COMPONENTS]| force.map(|part| i32::from(part) << 8);
            record.haptic = HapticSnapshot {
                tip: master.pose.tip,
                force: newtons(master.force),
                feedback: newtons(master.feedback),
                fixture: newtons(master.fixture),
                axes: master.pose.axes,
            };
            record.haptic_flags = flag::HAPTIC_KNOWN;
            if master.pose.enabling_switch {
                record.haptic_flags |= flag::ENABLING_SWITCH;
            }
        }
        copy(&mut record.commanded, &telemetry.commanded);
        copy(&mut record.joints, &telemetry.joints);
        copy(&mut record.following_error, &telemetry.following_error);
        copy(&mut record.drive, &telemetry.drive);
        copy(&mut record.tool, &telemetry.measured);
        for (commanded, (joint, error)) in record
            .joints_commanded
            .iter_mut()
            .zip(record.joints.iter().zip(record.following_error))
        {
            *commanded = joint.wrapping_add(error);
        }
        self.add_programmed(&mut record, f64::from(telemetry.program_periods));
        self.recorder.record(&record);
        // A block fills slowly at this rate. A host that crashes loses a quarter of a second at
        // most.
        if self.recorder.records().is_multiple_of(SPILL_EVERY) {
            self.recorder.spill();
        }
    }

    /// Adds the programmed pose at a program time in periods, if a job is running.
    fn add_programmed(&mut self, record: &mut Record, periods: f64) {
        if !matches!(record.state, State::Run | State::Hold) {
            return;
        }
        let Some(track) = &self.track else {
            return;
        };
        let mut track = track.lock();
        let time_s = periods * track.period_s();
        let programmed = track.programmed(time_s);
        let line = track.place_of(record.setpoint).line;
        track.discard(record.setpoint, time_s);
        drop(track);
        for (axis, (slot, value)) in record.programmed.iter_mut().zip(&programmed).enumerate() {
            *slot = self.axis_units(axis, *value);
        }
        record.flags |= flag::PROGRAMMED;
        record.line = line;
    }

    /// Axis units of a coordinate in millimetres or degrees; modulo a turn if it wraps around.
    fn axis_units(&self, axis: usize, value: f64) -> i32 {
        let value = (value * self.units[axis]).round();
        if self.wrapping >> axis & 1 != 0 {
            value as i64 as i32
        } else {
            value as i32
        }
    }

    /// Begins the log of the I/O with that since the power-on of the controller.
    pub(super) fn start_io_log(&mut self, io_log: IoLog) {
        self.recorder.start_io_log(io_log);
    }

    /// Adds a control period of a simulated machine.
    pub(super) fn add(&mut self, seen: &PeriodSeen<'_>) {
        self.recorder.period(seen.inputs, seen.outputs);
        let Some(snapshot) = seen.snapshot else {
            return;
        };
        let mut record = Record {
            true_force: seen
                .truth
                .force
                .map(|newtons| (newtons * 65_536.0).round() as i32),
            ..Record::default()
        };
        record.set_snapshot(seen.inputs.period, &snapshot);
        if seen.inputs.haptic.enabling_switch {
            record.haptic_flags |= flag::ENABLING_SWITCH;
        }
        for (set, flag) in [
            (seen.has_force, flag::FORCE),
            (seen.truth.pose_valid, flag::TOOL_TRUE),
        ] {
            if set {
                record.flags |= flag;
            }
        }
        let truth = seen.truth.pose.iter().take(seen.axes);
        for (axis, (tool, value)) in record.tool.iter_mut().zip(truth).enumerate() {
            *tool = self.axis_units(axis, *value);
        }
        self.add_programmed(
            &mut record,
            snapshot.program_time as f64 / FULL_FACTOR as f64,
        );
        self.recorder.record(&record);
    }
}

/// A control period of a simulated machine, for a recording.
pub(super) struct PeriodSeen<'a> {
    pub(super) inputs: &'a Inputs,
    pub(super) outputs: &'a Outputs,
    /// State of the controller after it.
    pub(super) snapshot: Option<Snapshot>,
    /// Ground truth at the time of the inputs.
    pub(super) truth: &'a GroundTruth,
    /// Joints of the machine.
    pub(super) axes: usize,
    /// The machine has a force sensor.
    pub(super) has_force: bool,
}

impl<'a> PeriodSeen<'a> {
    fn of<C: Control>(rig: &'a Rig<C>) -> Self {
        Self {
            inputs: rig.inputs(),
            outputs: rig.outputs(),
            snapshot: rig.control().snapshot(rig.inputs()),
            truth: rig.truth(),
            axes: rig.plant().axes(),
            has_force: rig.plant().force_codes().is_some(),
        }
    }
}
