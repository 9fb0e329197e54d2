//! The line between a session and its controller.

use crate::port::{self, Observers, PortError, PortSpec, Transport};
use std::sync::mpsc::{self, Receiver, TryRecvError};
use std::time::{Duration, Instant};

use super::JobRecording;
use crate::flash::Board;
use crate::{Error, ErrorKind};
use haptimill_firmware::snapshot::Snapshot;
use haptimill_hil_sim::plant::GroundTruth;
use haptimill_hil_sim::process::{CuttingConfig, Workpiece};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_protocol::haptic::{COMPONENTS, MasterTelemetry};
use haptimill_protocol::message::{FULL_SPEED_FACTOR, Telemetry};
use haptimill_trace::Recorder;

/// A byte channel to a controller, with a clock.
pub trait Line {
    /// Sends bytes, waits for a short time, appends received bytes to `received`, and returns the
    /// time, microseconds.
    ///
    /// # Errors
    /// The port failed.
    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError>;

    /// Its name in messages.
    fn name(&self) -> String;

    /// The board at its other end, if the port names it. A serial converter does not.
    fn board(&self) -> Option<&'static Board> {
        None
    }

    /// Closes the port after a failure, so that [`Line::open`] can open it again. False for a line
    /// without a port that can be opened.
    fn close(&mut self) -> bool {
        false
    }

    /// Advances the opening of a closed port without waiting. Returns the time of the line once the
    /// port is open, microseconds; it does not restart.
    ///
    /// # Errors
    /// An attempt failed; the next one follows after a delay.
    fn open(&mut self) -> Result<Option<u64>, PortError> {
        Ok(None)
    }

    /// Clamps stock on the table of a simulated machine, at the present position of the tool.
    ///
    /// # Errors
    /// The machine is not simulated, or the stock is invalid.
    fn clamp(&mut self, _: &CuttingConfig) -> Result<(), Error> {
        Err(Error::new(
            ErrorKind::Usage,
            "--stock is for the simulated machine; clamp the stock yourself",
        ))
    }

    /// The stock on the table of a simulated machine, with all material removed that the tool has
    /// passed; `None` for others.
    fn stock(&mut self) -> Option<&Workpiece> {
        None
    }

    /// Ground truth of a simulated machine; `None` for others.
    fn truth(&self) -> Option<&GroundTruth> {
        None
    }

    /// Internal values of a simulated controller in the last period; `None` for others.
    fn snapshot(&self) -> Option<Snapshot> {
        None
    }

    /// The force on the remote tool that the controller of a simulated haptic arm received last,
    /// 2^-6 N; `None` for others.
    fn remote_force(&self) -> Option<[i16; COMPONENTS]> {
        None
    }

    /// Whether the recording ended before the job, because the disk is full or failed.
    fn is_recording_broken(&self) -> bool {
        false
    }

    /// Records telemetry.
    fn record_telemetry(&mut self, _: &Telemetry) {}

    /// Records telemetry of the master.
    fn record_master(&mut self, _: &MasterTelemetry) {}

    /// Records an event; `level` is 0 for information, 1 for a warning, 2 for an error.
    fn record_event(&mut self, _period: u64, _level: u8, _text: &str) {}
}

impl<L: Line + ?Sized> Line for Box<L> {
    fn board(&self) -> Option<&'static Board> {
        (**self).board()
    }

    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError> {
        (**self).exchange(transmit, received)
    }

    fn name(&self) -> String {
        (**self).name()
    }

    fn close(&mut self) -> bool {
        (**self).close()
    }

    fn open(&mut self) -> Result<Option<u64>, PortError> {
        (**self).open()
    }

    fn clamp(&mut self, stock: &CuttingConfig) -> Result<(), Error> {
        (**self).clamp(stock)
    }

    fn stock(&mut self) -> Option<&Workpiece> {
        (**self).stock()
    }

    fn truth(&self) -> Option<&GroundTruth> {
        (**self).truth()
    }

    fn snapshot(&self) -> Option<Snapshot> {
        (**self).snapshot()
    }

    fn remote_force(&self) -> Option<[i16; COMPONENTS]> {
        (**self).remote_force()
    }

    fn is_recording_broken(&self) -> bool {
        (**self).is_recording_broken()
    }

    fn record_telemetry(&mut self, telemetry: &Telemetry) {
        (**self).record_telemetry(telemetry);
    }

    fn record_master(&mut self, master: &MasterTelemetry) {
        (**self).record_master(master);
    }

    fn record_event(&mut self, period: u64, level: u8, text: &str) {
        (**self).record_event(period, level, text);
    }
}

/// A line on which a job can be recorded.
pub trait JobLine: Line {
    /// Starts a recording: of every control period of a simulated machine, otherwise of every
    /// telemetry frame.
    fn begin_recording(&mut self, recording: JobRecording);

    /// Ends the recording and returns it.
    fn end_recording(&mut self) -> Option<Recorder>;
}

/// Longest wait for bytes in one exchange: a thousand steps a second.
const WAIT: Duration = Duration::from_millis(1);

/// Longest wait for a port to accept bytes. The link detects a port that accepts none for longer.
const WRITE_WAIT: Duration = Duration::from_millis(20);

/// Delay before each attempt to open a port again.
const RETRY: Duration = Duration::from_millis(300);

/// Progress of a port.
enum PortState {
    Open(Box<dyn Transport>),
    /// The next attempt to open it begins at this time.
    Closed(Instant),
    /// A thread opens it: that may take seconds, for a name to be resolved or for a machine that is
    /// switched off.
    Opening(Receiver<Result<Box<dyn Transport>, PortError>>),
}

/// Time since the line was made, microseconds.
fn now_us(started_at: Instant) -> u64 {
    u64::try_from(started_at.elapsed().as_micros()).unwrap_or(u64::MAX)
}

/// A controller behind a port, in real time.
pub struct PortLine {
    spec: PortSpec,
    baud: u32,
    port: PortState,
    started_at: Instant,
    /// Bytes that the port has not accepted yet.
    waiting: Vec<u8>,
    recording: Option<JobRecording>,
    observed: Option<Observed>,
}

/// Observers, and the machine of which they get reports.
struct Observed {
    observers: Observers,
    model: Model,
}

impl PortLine {
    /// A line over a port, which is opened now: that may take seconds.
    ///
    /// # Errors
    /// See [`PortError`].
    pub fn opened(spec: &PortSpec, baud: u32) -> Result<Self, PortError> {
        let port = PortState::Open(port::open(spec, baud)?);
        Ok(Self::new(spec, baud, port))
    }

    /// A line over a port that [`Line::open`] opens; for [`Session::with_closed_line`].
    ///
    /// [`Session::with_closed_line`]: super::Session::with_closed_line
    #[must_use]
    pub fn closed(spec: &PortSpec, baud: u32) -> Self {
        Self::new(spec, baud, PortState::Closed(Instant::now()))
    }

    fn new(spec: &PortSpec, baud: u32, port: PortState) -> Self {
        Self {
            spec: spec.clone(),
            baud,
            port,
            started_at: Instant::now(),
            waiting: Vec::new(),
            recording: None,
            observed: None,
        }
    }

    /// Passes reports and events on to observers, one JSON object per line: the keys are `period`,
    /// `state`, `homed`, `line` of the program, `speed_factor`, `coordinates` and
    /// `units` in the order of the machine, `commanded` (null while the drives are off) and
    /// `measured` by the names of the coordinates; or `period`, `level` and `event`.
    pub fn observe(&mut self, observers: Observers, machine: &MachineFile) {
        let model = Model::new(machine);
        self.observed = Some(Observed { observers, model });
    }

    /// The report of a telemetry frame for observers.
    fn report(&self, model: &Model, telemetry: &Telemetry) -> String {
        let pose = |values| -> serde_json::Value {
            let values = model.unwound_pose(values, telemetry);
            let names = model.pose_names().into_iter().zip(values);
            names
                .map(|(name, value)| (name.to_string(), value))
                .collect()
        };
        let line = self.recording.as_ref();
        let line = line.and_then(|recording| recording.line_of(telemetry.setpoint));
        serde_json::json!({
            "period": telemetry.period,
            "state": telemetry.state.to_string().trim_start_matches("in "),
            "homed": telemetry.homed,
            "line": line,
            "speed_factor": f64::from(telemetry.speed_factor) / f64::from(FULL_SPEED_FACTOR),
            "coordinates": model.pose_names(),
            "units": model.pose_units(),
            "commanded": (!telemetry.state.has_drives_off()).then(|| pose(&telemetry.commanded)),
            "measured": pose(&telemetry.measured),
        })
        .to_string()
    }
}

impl Line for PortLine {
    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError> {
        let PortState::Open(port) = &mut self.port else {
            return Err(PortError::Gone {
                name: self.spec.to_string(),
                reason: "it is closed".to_string(),
            });
        };
        self.waiting.extend_from_slice(transmit);
        if !self.waiting.is_empty() {
            let taken = port.write(&self.waiting, WRITE_WAIT)?;
            self.waiting.drain(..taken);
        }
        // The time before the read: bytes that arrived before it are then read before the link
        // checks for silence. With the time after the read, a delay of this process between the two
        // would count as silence of the controller.
        let now_us = now_us(self.started_at);
        let mut buffer = [0; 4096];
        let count = port.read(&mut buffer, WAIT)?;
        received.extend_from_slice(&buffer[..count]);
        if let Some(observed) = &mut self.observed {
            observed.observers.advance();
        }
        Ok(now_us)
    }

    fn name(&self) -> String {
        match &self.port {
            PortState::Open(port) => port.name().to_string(),
            _ => self.spec.to_string(),
        }
    }

    fn board(&self) -> Option<&'static Board> {
        match &self.spec {
            PortSpec::Serial(path) => port::board_of(path),
            _ => None,
        }
    }

    fn close(&mut self) -> bool {
        self.port = PortState::Closed(Instant::now() + RETRY);
        self.waiting.clear();
        true
    }

    fn open(&mut self) -> Result<Option<u64>, PortError> {
        match &self.port {
            PortState::Open(_) => return Ok(Some(now_us(self.started_at))),
            PortState::Closed(until) if Instant::now() < *until => {}
            PortState::Closed(_) => {
                let (sender, receiver) = mpsc::channel();
                let (spec, baud) = (self.spec.clone(), self.baud);
                std::thread::spawn(move || {
                    // The receiver is gone if the session has ended meanwhile.
                    let _ = sender.send(port::open(&spec, baud));
                });
                self.port = PortState::Opening(receiver);
            }
            PortState::Opening(receiver) => match receiver.try_recv() {
                Ok(Ok(port)) => {
                    self.port = PortState::Open(port);
                    return Ok(Some(now_us(self.started_at)));
                }
                Ok(Err(error)) => {
                    self.close();
                    return Err(error);
                }
                Err(TryRecvError::Empty) => {}
                Err(TryRecvError::Disconnected) => {
                    self.close();
                }
            },
        }
        Ok(None)
    }

    fn is_recording_broken(&self) -> bool {
        self.recording.as_ref().is_some_and(JobRecording::is_broken)
    }

    fn record_telemetry(&mut self, telemetry: &Telemetry) {
        if let Some(recording) = &mut self.recording {
            recording.add_telemetry(telemetry);
        }
        if let Some(mut observed) = self.observed.take() {
            if observed.observers.has_any() {
                let report = self.report(&observed.model, telemetry);
                observed.observers.send(&report);
            }
            self.observed = Some(observed);
        }
    }

    fn record_master(&mut self, master: &MasterTelemetry) {
        if let Some(recording) = &mut self.recording {
            recording.add_master(master);
        }
    }

    fn record_event(&mut self, period: u64, level: u8, text: &str) {
        if let Some(recording) = &mut self.recording {
            recording.add_event(period, level, text);
        }
        if let Some(observed) = &mut self.observed {
            let event = serde_json::json!({ "period": period, "level": level, "event": text });
            observed.observers.send(&event.to_string());
        }
    }
}

impl JobLine for PortLine {
    fn begin_recording(&mut self, recording: JobRecording) {
        self.recording = Some(recording);
    }

    fn end_recording(&mut self) -> Option<Recorder> {
        self.recording.take().map(JobRecording::into_recorder)
    }
}
