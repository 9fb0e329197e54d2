//! What a session talks over.

use crate::port::{PortError, Transport};
use std::time::{Duration, Instant};

use super::JobRecording;
use crate::{Error, ErrorKind};
use haptimill_firmware::snapshot::Snapshot;
use haptimill_hil_sim::process::CuttingConfig;
use haptimill_protocol::haptic::{COMPONENTS, MasterTelemetry};
use haptimill_protocol::message::Telemetry;
use haptimill_trace::Recorder;

/// Carries bytes to a controller and back, and has a clock.
pub trait Line {
    /// Sends bytes, lets a little time pass, adds what has arrived to `received`, and gives the time in microseconds.
    ///
    /// # Errors
    /// The port is gone.
    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError>;

    /// What people call it.
    fn name(&self) -> String;

    /// What the controller knew of itself in the last period; `None` where it cannot be looked into.
    fn snapshot(&self) -> Option<Snapshot> {
        None
    }

    /// What the controller of a haptic arm was told last of the force on a tool afar, 2^-6 N; `None` where it cannot be looked into.
    fn told_force(&self) -> Option<[i16; COMPONENTS]> {
        None
    }

    /// Whether the recording of a job has ended before the job, because of the disk.
    fn recording_is_broken(&self) -> bool {
        false
    }

    /// The controller reported how things stand.
    fn reported(&mut self, _: &Telemetry) {}

    /// The controller reported how a hand stands at its haptic arm.
    fn reported_hand(&mut self, _: &MasterTelemetry) {}

    /// The controller said that something happened; `level` is 0 for news, 1 for a warning, 2 for an error.
    fn happened(&mut self, _period: u64, _level: u8, _text: &str) {}
}

/// A line on which a job can be recorded.
pub trait JobLine: Line {
    /// Records from now on: every control period where the line sees them all, every telemetry frame otherwise.
    fn begin_recording(&mut self, recording: JobRecording);

    /// Clamps a work on the table, with the tool where it stands. A real machine has its operator for that.
    ///
    /// # Errors
    /// The line has no table in reach, or the work makes no sense.
    fn clamp(&mut self, _: &CuttingConfig) -> Result<(), Error> {
        Err(Error::new(
            ErrorKind::Usage,
            "--stock is for the simulated machine; clamp the work by hand",
        ))
    }

    /// Ends the recording and hands it back.
    fn end_recording(&mut self) -> Option<Recorder>;
}

/// Longest wait for bytes in one exchange: a thousand steps a second.
const WAIT: Duration = Duration::from_millis(1);

/// Longest wait for a port to take bytes. A port that takes none for so long is not reading; the link notices the silence.
const WRITE_WAIT: Duration = Duration::from_millis(20);

/// A controller behind a port, in real time.
pub struct PortLine {
    port: Box<dyn Transport>,
    begun: Instant,
    /// Bytes that the port has not taken yet.
    waiting: Vec<u8>,
    recording: Option<JobRecording>,
}

impl PortLine {
    /// A line over an open port.
    #[must_use]
    pub fn new(port: Box<dyn Transport>) -> Self {
        Self {
            port,
            begun: Instant::now(),
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
        // The time of before the read: if this process is held up at whatever point, what the controller said until then is read before its silence
        // is judged. Taken afterwards, a delay between the two would count as silence of a controller that has not been listened to.
        let now_us = u64::try_from(self.begun.elapsed().as_micros()).unwrap_or(u64::MAX);
        let mut buffer = [0; 4096];
        let count = self.port.read(&mut buffer, WAIT)?;
        received.extend_from_slice(&buffer[..count]);
        Ok(now_us)
    }

    fn name(&self) -> String {
        self.port.name().to_string()
    }

    fn recording_is_broken(&self) -> bool {
        self.recording.as_ref().is_some_and(JobRecording::is_broken)
    }

    fn reported(&mut self, telemetry: &Telemetry) {
        if let Some(recording) = &mut self.recording {
            recording.add_telemetry(telemetry);
        }
    }

    fn reported_hand(&mut self, hand: &MasterTelemetry) {
        if let Some(recording) = &mut self.recording {
            recording.add_hand(hand);
        }
    }

    fn happened(&mut self, period: u64, level: u8, text: &str) {
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
