//! The image of a board on an emulated chip, with its pins wired to the simulated machine.
//!
//! The emulator is a program of its own (`host/emulator`) with the chip, the machine and the
//! wires between them. This end has the line of the board, which is the serial line of the emulated
//! chip: nothing else reaches the controller. For the recording the board reports the inputs and
//! the pulse commands of each control period; a controller in this process that is given the
//! same inputs completes them, and its commands must have the same bits.
//!
//! At its end the emulator compares every edge of the step and direction pins with the commands.

mod frame;
pub mod record;

pub use frame::{Answer, Turn, read_bytes};

use super::sim::PeriodSeen;
use super::{JobLine, JobRecording, Line};
use crate::flash::Board;
use crate::port::PortError;
use crate::{Error, ErrorKind};
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::Outputs;
use haptimill_firmware::snapshot::Snapshot;
use haptimill_hil_sim::plant::GroundTruth;
use haptimill_machine_file::MachineFile;
use haptimill_trace::{IoLog, Recorder};
use record::Period;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::io;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

/// Name of the port.
pub const NAME: &str = "emu:pico2";

/// Program of the emulator, and the command that makes it and the images.
const EMULATOR: &str = "host/emulator/target/release/haptimill-emulator";
const REMEDY: &str = "make it with `cargo xtask emulator --build` in the source tree";

/// Longest wait for an answer: a control period takes some 10 ms, the start and the checks at the
/// end some seconds.
const STALL: Timespec = Timespec {
    tv_sec: 120,
    tv_nsec: 0,
};

/// Finds a product of the source tree, unless a variable names it.
fn find(variable: &str, path: &str) -> Result<PathBuf, Error> {
    if let Some(named) = std::env::var_os(variable) {
        return Ok(PathBuf::from(named));
    }
    let here = std::env::current_dir().unwrap_or_default();
    here.ancestors()
        .chain(Path::new(env!("CARGO_MANIFEST_DIR")).ancestors())
        .map(|root| root.join(path))
        .find(|file| file.is_file())
        .ok_or_else(|| {
            let what = format!("{NAME}: {path} is missing; {REMEDY}, or name it in {variable}");
            Error::new(ErrorKind::Port, what)
        })
}

/// The line of an emulated board.
pub struct PinLine {
    child: Child,
    to_board: Option<ChildStdin>,
    from_board: ChildStdout,
    /// Completes the records of the board.
    controller: Controller,
    outputs: Outputs,
    truth: GroundTruth,
    snapshot: Option<Snapshot>,
    axes: usize,
    period_us: u32,
    io_log: Option<IoLog>,
    recording: Option<JobRecording>,
}

impl PinLine {
    /// Starts the emulator with the machine of a file. `image` replaces the image of the source
    /// tree, which is [that of the machine](Board::of_machine); `vcd` is a file for the lines that
    /// the board drove.
    ///
    /// # Errors
    /// The board cannot drive the machine; emulator or image are missing, or do not start.
    pub fn start(
        machine: &MachineFile,
        image: Option<&Path>,
        vcd: Option<&Path>,
    ) -> Result<Self, Error> {
        let failed = |error: io::Error| Error::new(ErrorKind::Port, format!("{NAME}: {error}"));
        let board = Board::of_machine(machine);
        board.check_machine(machine)?;
        let program = find("HAPTIMILL_EMULATOR", EMULATOR)?;
        let image = match image {
            Some(image) => image.to_path_buf(),
            None => find("HAPTIMILL_IMAGE", board.image)?,
        };
        let mut command = Command::new(&program);
        command.arg("--image").arg(image);
        if let Some(vcd) = vcd {
            command.arg("--vcd").arg(vcd);
        }
        let mut child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            // Ctrl-C is for this process, which stops the machine along its path.
            .process_group(0)
            .spawn()
            .map_err(|error| {
                let what = format!("{NAME}: {}: {error}; {REMEDY}", program.display());
                Error::new(ErrorKind::Port, what)
            })?;
        let (Some(mut to_board), Some(from_board)) = (child.stdin.take(), child.stdout.take())
        else {
            return Err(failed(io::Error::other("the emulator has no pipes")));
        };
        // A write fails when the emulator has ended; the answer below has the reason.
        let _ = frame::write_bytes(&mut to_board, machine.file.as_bytes())
            .and_then(|()| frame::write_bytes(&mut to_board, machine.text.as_bytes()));
        let mut line = Self {
            child,
            to_board: Some(to_board),
            from_board,
            controller: Controller::new(machine.config.period_us),
            outputs: Outputs::default(),
            truth: GroundTruth::default(),
            snapshot: None,
            axes: machine.config.joints.len(),
            period_us: u32::from(machine.config.period_us),
            io_log: Some(IoLog::new()),
            recording: None,
        };
        match line.answer() {
            Ok(Answer::Turn(turn)) => line
                .take(&turn)
                .map_err(|reason| failed(io::Error::other(reason)))?,
            Ok(Answer::Failed(reason)) => return Err(failed(io::Error::other(reason))),
            Ok(_) => {
                return Err(failed(io::Error::other(
                    "the emulator sent its last frame first",
                )));
            }
            Err(error) => return Err(failed(error)),
        }
        Ok(line)
    }

    /// Waits for an answer of the emulator.
    fn answer(&mut self) -> io::Result<Answer> {
        let mut descriptors = [PollFd::new(&self.from_board, PollFlags::IN)];
        match poll(&mut descriptors, Some(&STALL)) {
            Ok(0) => {
                let what = format!("the emulator did not answer for {} s", STALL.tv_sec);
                return Err(io::Error::new(io::ErrorKind::TimedOut, what));
            }
            Ok(_) | Err(rustix::io::Errno::INTR) => {}
            Err(error) => return Err(error.into()),
        }
        Answer::read(&mut self.from_board).map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => io::Error::other(match self.child.wait() {
                Ok(status) => format!("the emulator ended ({status})"),
                Err(error) => error.to_string(),
            }),
            _ => error,
        })
    }

    /// Runs a control period.
    fn run_period(&mut self, transmit: &[u8]) -> Result<Box<Turn>, String> {
        let Some(to_board) = &mut self.to_board else {
            return Err("the emulator has ended".to_string());
        };
        // A write fails when the emulator has ended; the answer has the reason.
        let written = frame::write_bytes(to_board, transmit);
        match self.answer().map_err(|error| error.to_string())? {
            Answer::Turn(turn) => {
                written.map_err(|error| error.to_string())?;
                self.take(&turn)?;
                Ok(turn)
            }
            Answer::Failed(reason) => Err(reason),
            _ => Err("the emulator ended early".to_string()),
        }
    }

    /// Completes and records the control periods of a turn.
    fn take(&mut self, turn: &Turn) -> Result<(), String> {
        for words in &turn.records {
            let period = Period::decode(words, self.period_us);
            self.outputs.transmit.clear();
            self.controller
                .tick(&period.inputs, &mut self.outputs, &mut ());
            if self.outputs.joints[..record::JOINTS] != period.commands {
                return Err(format!(
                    "control period {}: the board commands {:?}, and the controller in this process {:?}",
                    period.inputs.period,
                    period.commands,
                    &self.outputs.joints[..record::JOINTS]
                ));
            }
            self.snapshot = self.controller.snapshot(&period.inputs);
            let seen = PeriodSeen {
                inputs: &period.inputs,
                outputs: &self.outputs,
                snapshot: self.snapshot,
                truth: &self.truth,
                axes: self.axes,
                has_force: false,
            };
            match (&mut self.recording, &mut self.io_log) {
                (Some(recording), _) => recording.add(&seen),
                (None, Some(io_log)) => io_log.add(seen.inputs, seen.outputs),
                (None, None) => {}
            }
        }
        self.truth = turn.truth;
        Ok(())
    }

    /// Ends the emulator. Returns what its checks compared.
    ///
    /// # Errors
    /// An edge of a pin is not where the controller commanded it; the text has the faults.
    pub fn finish(&mut self) -> Result<String, Error> {
        self.to_board = None;
        let failed = |what: &str| Error::new(ErrorKind::Command, format!("{NAME}: {what}"));
        match self.answer() {
            Ok(Answer::Passed(text)) => Ok(text),
            Ok(Answer::Failed(text) | Answer::Faulty(text)) => Err(failed(&text)),
            Ok(Answer::Turn(_)) => Err(failed("the emulator sent a frame after its last one")),
            Err(error) => Err(failed(&error.to_string())),
        }
    }
}

impl Drop for PinLine {
    fn drop(&mut self) {
        // Fails when it has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Line for PinLine {
    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError> {
        let turn = self
            .run_period(transmit)
            .map_err(|reason| PortError::Failed {
                name: self.name(),
                reason,
            })?;
        received.extend(&turn.sent);
        Ok(turn.time_us)
    }

    fn name(&self) -> String {
        NAME.to_string()
    }

    fn is_recording_broken(&self) -> bool {
        self.recording.as_ref().is_some_and(JobRecording::is_broken)
    }

    fn snapshot(&self) -> Option<Snapshot> {
        self.snapshot
    }

    fn record_event(&mut self, period: u64, level: u8, text: &str) {
        if let Some(recording) = &mut self.recording {
            recording.add_event(period, level, text);
        }
    }
}

impl JobLine for PinLine {
    fn begin_recording(&mut self, mut recording: JobRecording) {
        if let Some(io_log) = self.io_log.take() {
            recording.start_io_log(io_log);
        }
        self.recording = Some(recording);
    }

    fn end_recording(&mut self) -> Option<Recorder> {
        self.recording.take().map(JobRecording::into_recorder)
    }
}
