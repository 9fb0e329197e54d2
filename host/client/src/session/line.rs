//! The line between a session and its controller.

use crate::port::{PortError, Transport};
use std::time::{Duration, Instant};

use super::JobRecording;
use crate::{Error, ErrorKind};
use haptimill_firmware::snapshot::Snapshot;
use haptimill_hil_sim::process::CuttingConfig;
use haptimill_protocol::haptic::{COMPONENTS, MasterTelemetry};
use haptimill_protocol::message::Telemetry;
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

/// A line on which a job can be recorded.
pub trait JobLine: Line {
    /// Starts a recording: of every control period of a simulated machine, otherwise of every
    /// telemetry frame.
    fn begin_recording(&mut self, recording: JobRecording);

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

    /// Ends the recording and returns it.
    fn end_recording(&mut self) -> Option<Recorder>;
}

/// Longest wait for bytes in one exchange: a thousand steps a second.
const WAIT: Duration = Duration::from_millis(1);

/// Longest wait for a port to accept bytes. The link detects a port that accepts none for longer.
const WRITE_WAIT: Duration = Duration::from_millis(20);

/// A controller behind a port, in real time.
pub struct PortLine {
    port: Box<dyn Transport>,
    started_at: Instant,
    /// Bytes that the port has not accepted yet.
    waiting: Vec<u8>,
    recording: Option<JobRecording>,
}

impl PortLine {
    /// A line over an open port.
    #[must_use]
    pub fn new(port: Box<dyn Transport>) -> Self {
        Self {
            port,
            started_at: Instant::now(),
            waiting: Vec::new(),
            recording: None,
        }
    }
}

impl Line for PortLine {
    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError> {
        self.waiting.extend_from_slice(transmit);
        if !self.waiting.is_empty() {
            let taken = self.port.write(&self.waiting, WRITE_WAIT)?;
            self.waiting.drain(..taken);
        }
        // The time before the read: bytes that arrived before it are then read before the link
        // checks for silence. With the time after the read, a delay of this process between the two
        // would count as silence of the controller.
        let now_us = u64::try_from(self.started_at.elapsed().as_micros()).unwrap_or(u64::MAX);
        let mut buffer = [0; 4096];
        let count = self.port.read(&mut buffer, WAIT)?;
        received.extend_from_slice(&buffer[..count]);
        Ok(now_us)
    }

    fn name(&self) -> String {
        self.port.name().to_string()
    }

    fn is_recording_broken(&self) -> bool {
        self.recording.as_ref().is_some_and(JobRecording::is_broken)
    }

    fn record_telemetry(&mut self, telemetry: &Telemetry) {
        if let Some(recording) = &mut self.recording {
            recording.add_telemetry(telemetry);
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
