//! A teleoperation session on a connected machine.

use super::args::{TeleopArgs, line_rate};
use super::commands;
use super::display::{Display, describe};
use super::master::MasterSpec;
use super::page::{JointErrors, page};
use crate::commands::board::file_of;
use crate::commands::run::job::refuse_latched_fault;
use crate::commands::run::results::{self, ResultFolder};
use crate::commands::run::{describe_growth, describe_size};
use crate::commands::{CliError, Exit, interrupt};
use haptimill_client::board::Chosen;
use haptimill_client::client::Options;
#[cfg(unix)]
use haptimill_client::port::Board;
use haptimill_client::port::PortSpec;
use haptimill_client::session::{self, JobLine, JobRecording, PortLine, Session, SimLine};
#[cfg(unix)]
use haptimill_client::session::{pil, pins::PinLine};
use haptimill_hil_sim::process::CuttingConfig;
#[cfg(unix)]
use haptimill_hil_sim::remote::RemoteController;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::Command;
use haptimill_report::Cut;
use haptimill_teleop::{Ended, MasterDevice, Row, Teleop, TeleopOptions, TeleopOutcome};
use haptimill_trace::{Header, Recorded, Recorder, Recording, RecordingError, write_csv};
use std::io::{BufWriter, Write};
use std::path::Path;

/// The table of reports.
pub(super) const TABLE_FILE: &str = "teleop.csv";

/// What a session leaves.
pub(super) struct SessionEnd {
    pub(super) outcome: TeleopOutcome,
    /// The recording of the machine.
    pub(super) recorded: Recorded,
    /// What was cut from a simulated stock.
    pub(super) cut: Option<Cut>,
}

/// A teleoperation session.
pub(super) struct TeleopSession<'a> {
    pub(super) args: &'a TeleopArgs,
    pub(super) machine: &'a MachineFile,
    /// The machine file that the board is compared with.
    pub(super) chosen: &'a Chosen,
    pub(super) stock: Option<&'a CuttingConfig>,
    pub(super) options: &'a TeleopOptions,
    /// Folder for the results.
    pub(super) dir: &'a Path,
}

impl TeleopSession<'_> {
    fn output_error(&self, error: &dyn std::fmt::Display) -> CliError {
        CliError::new(Exit::Output, format!("{}: {error}", self.dir.display()))
    }

    /// Creates a recording in the result folder.
    pub(super) fn create_recording(
        &self,
        machine: &MachineFile,
        file: &str,
    ) -> Result<JobRecording, CliError> {
        let header =
            Header::of(machine, "teleop").map_err(|error| CliError::new(Exit::Internal, error))?;
        let keep = self.args.record.keep(machine);
        let recorder = Recorder::create_thinned(&self.dir.join(file), &header, keep)
            .map_err(|error| self.output_error(&error))?;
        Ok(JobRecording::unplanned(recorder, machine))
    }

    /// Completes a recording.
    pub(super) fn finish_recording(
        &self,
        recorder: Option<Recorder>,
    ) -> Result<Recorded, CliError> {
        recorder
            .ok_or_else(|| CliError::new(Exit::Internal, "the recording was lost"))?
            .finish()
            .map_err(|error| results::recording_error(self.dir, &error))
    }

    /// Size of the recording of the machine after this time.
    fn recording_bytes(&self, seconds: f64) -> f64 {
        let is_simulated = self.args.port.is_simulated();
        self.args.record.bytes(self.machine, seconds, is_simulated)
    }

    /// Prints the size of the recording where it is known and large, else its growth.
    fn announce_size(&self) {
        let is_last = self.args.record.keeps_last();
        // A ring of records has its largest size after any long time.
        let seconds = self
            .options
            .duration_s
            .or(is_last.then_some(f64::from(u32::MAX)));
        let size = seconds.and_then(|seconds| describe_size(self.recording_bytes(seconds)));
        let growth = || describe_growth(self.recording_bytes(3600.0)).filter(|_| !is_last);
        if let Some(what) = size.or_else(growth) {
            self.args.print_message(&what);
        }
    }

    /// Runs a session with a master that has no recording of its own.
    ///
    /// # Errors
    /// See [`Exit`].
    pub(super) fn run<S: MasterDevice>(&self, source: &mut S) -> Result<(), CliError> {
        let folder = ResultFolder::open(self.dir)?;
        let ended = self.run_with(source, &folder, |_| Ok(()))?;
        self.report(ended, None)
    }

    /// Runs a session. When the machine is ready, clears the folder and calls `on_ready`.
    ///
    /// # Errors
    /// See [`Exit`].
    pub(super) fn run_with<S: MasterDevice>(
        &self,
        source: &mut S,
        folder: &ResultFolder,
        on_ready: impl FnOnce(&mut S) -> Result<(), CliError>,
    ) -> Result<SessionEnd, CliError> {
        let (args, machine) = (self.args, self.machine);
        if let Some(seconds) = self.options.duration_s {
            results::check_space(self.dir, self.recording_bytes(seconds))?;
        }
        source.prepare()?;
        let interrupted = interrupt::flag();
        match &args.port.port {
            PortSpec::Simulator => {
                let faults = args.simulator.fault.clone();
                let rig = session::rig(machine, args.simulator.seed, args.port.baud, faults)?;
                let line = SimLine::new(rig);
                let session = Session::new(line, machine, Options::default(), interrupted);
                // A constant session number makes every run of a script bit-identical.
                self.run_session(session, 1, source, folder, on_ready)
            }
            #[cfg(unix)]
            PortSpec::Emulated(board) => {
                let faults = args.simulator.fault.clone();
                let remote = emulated(*board, machine)?;
                let seed = args.simulator.seed;
                let rig = session::rig_around(remote, machine, seed, args.port.baud, faults)?;
                let line = SimLine::named(rig, &board.to_string());
                let session = Session::new(line, machine, Options::default(), interrupted);
                self.run_session(session, 1, source, folder, on_ready)
            }
            #[cfg(unix)]
            PortSpec::EmulatedPins => {
                let line = PinLine::start(machine, None, None)?;
                let session = Session::new(line, machine, Options::default(), interrupted);
                self.run_session(session, 1, source, folder, on_ready)
            }
            spec => {
                let line = PortLine::opened(spec, args.port.baud_or_default())?;
                let mut options = Options::default();
                options.timing.line_rate = line_rate(spec, args.port.baud);
                let session = Session::new(line, machine, options, interrupted);
                self.run_session(session, session::fresh_number(), source, folder, on_ready)
            }
        }
    }

    fn run_session<L: JobLine, S: MasterDevice>(
        &self,
        mut session: Session<L>,
        number: u32,
        source: &mut S,
        folder: &ResultFolder,
        on_ready: impl FnOnce(&mut S) -> Result<(), CliError>,
    ) -> Result<SessionEnd, CliError> {
        session.connect(number)?;
        self.prepare_machine(&mut session)?;
        folder.clear()?;
        on_ready(source)?;
        let recording = self.create_recording(self.machine, haptimill_report::RECORDING_FILE)?;
        session.line_mut().begin_recording(recording);
        let file = std::fs::File::create(self.dir.join(TABLE_FILE))
            .map_err(|error| self.output_error(&error))?;
        let mut table = BufWriter::new(file);
        let mut written = table.write_all(Row::HEAD.as_bytes());
        let mut display = Display::new(self.args);
        let reads_commands = !matches!(
            self.args.master,
            MasterSpec::Keyboard | MasterSpec::Script(_)
        );
        let lines = reads_commands.then(commands::listen);
        self.announce_size();
        self.args.print_message("teleoperation started");
        let teleop = Teleop::new(&mut session, source, self.options).with_command_input(lines);
        let outcome = teleop.run(&mut |row, event| {
            if let Some(row) = row {
                if written.is_ok() {
                    written = table.write_all(row.to_csv().as_bytes());
                }
                display.show_row(row);
            }
            if let Some(event) = event {
                display.show_event(event);
            }
        });
        display.finish();
        // The recording is kept after an error, too.
        let recorded = self.finish_recording(session.line_mut().end_recording());
        written
            .and_then(|()| table.flush())
            .map_err(|error| self.output_error(&error))?;
        let (outcome, recorded) = (outcome?, recorded?);
        let stock = session.line_mut().stock();
        let cut = stock.map(haptimill_experiments::cut_of);
        let trace = || -> Result<(), RecordingError> {
            let recording = Recording::open(&self.dir.join(haptimill_report::RECORDING_FILE))?;
            let path = self.dir.join(haptimill_report::TRACE_FILE);
            let file = std::fs::File::create(&path)
                .map_err(|error| RecordingError::Io(path.clone(), error))?;
            let mut file = BufWriter::new(file);
            write_csv(&recording, &mut file, self.args.trace_every)?;
            file.flush()
                .map_err(|error| RecordingError::Io(path, error))
        };
        trace().map_err(|error| self.output_error(&error))?;
        Ok(SessionEnd {
            outcome,
            recorded,
            cut,
        })
    }

    /// Prepares the machine: configuration, homing, stock, zero of the force sensor.
    fn prepare_machine<L: JobLine>(&self, session: &mut Session<L>) -> Result<(), CliError> {
        let (args, machine) = (self.args, self.machine);
        let controller = session.client_mut().controller();
        if let Some(arm) = controller.filter(|found| found.config_crc != 0 && found.axes == 0) {
            let what = format!(
                "\"{}\" is a haptic arm, not a machine; use --master for the arm, --port for the \
                 machine",
                arm.machine
            );
            return Err(CliError::new(Exit::Command, what));
        }
        let status = refuse_latched_fault(session)?;
        if args.port.is_simulated() {
            session.configure(machine)?;
        } else {
            refuse_own_arm(&file_of(self.chosen, session)?)?;
        }
        session.enable()?;
        if !status.homed {
            args.print_message("homing");
            let home = session::find_home_pose(machine, session.model())?;
            session.go_home(machine, &home)?;
        }
        if let Some(stock) = self.stock {
            session.line_mut().clamp(stock)?;
        }
        if machine.config.force.is_some() {
            session.set_force_mask(&[])?;
            session.tare()?;
        }
        Ok(session.ask(Command::Override { percent: 100 })?)
    }

    /// Writes and prints the summary.
    ///
    /// # Errors
    /// The session ended by a stop, a fault or a lost connection.
    pub(super) fn report(
        &self,
        ended: SessionEnd,
        master: Option<Recorded>,
    ) -> Result<(), CliError> {
        let SessionEnd {
            outcome,
            recorded,
            cut,
        } = ended;
        let joints = JointErrors::read(&self.dir.join(haptimill_report::RECORDING_FILE))
            .map_err(|error| self.output_error(&error))?;
        let mut value = serde_json::json!({
            "machine": self.machine.config.name.as_str(),
            "session": outcome,
            "periods": recorded.records,
            "trace_sha256": recorded.sha256,
            "hand_trace_sha256": master.map(|master| master.sha256),
            "recorded": self.args.record.keep(self.machine).describe(self.machine.config.period_us),
            "spindle_rpm": joints.spindle_rpm,
        });
        if let Some(cut) = &cut {
            value["removed_mm3"] = cut.removed_mm3.into();
            value["cut_depth_mm"] = cut.depth_mm.into();
        }
        let text = format!("{value:#}\n");
        std::fs::write(self.dir.join(haptimill_report::SUMMARY_FILE), &text)
            .map_err(|error| self.output_error(&error))?;
        let name = self.machine.config.name.as_str();
        let page = page(self.dir, name, &outcome, &joints, cut.as_ref());
        let report = self.dir.join(haptimill_report::REPORT_FILE);
        page.and_then(|page| Ok(std::fs::write(&report, page)?))
            .map_err(|error| self.output_error(&error))?;
        if self.args.json {
            print_line!("{value:#}");
        } else {
            print_line!(
                "{}",
                describe(&outcome, joints.spindle_rpm, cut.as_ref()).trim_end()
            );
            print_line!("results in {}", self.dir.display());
            print_line!("report     {}", report.display());
        }
        if recorded.disk_full {
            return Err(results::disk_full(self.dir).reported());
        }
        let (exit, why) = match outcome.ended {
            Ended::Done => return Ok(()),
            Ended::Stopped => (Exit::Stopped, "stopped by the operator".to_string()),
            Ended::Fault => (
                Exit::Fault,
                format!("machine fault: {}", outcome.faults.join("; ")),
            ),
            Ended::MasterLost => (
                Exit::Port,
                "the connection to the master is lost".to_string(),
            ),
            Ended::HapticFault => (
                Exit::Fault,
                "the motors of the haptic arm are off".to_string(),
            ),
        };
        let error = CliError::new(exit, outcome.because.unwrap_or(why));
        Err(if self.args.json {
            error.reported()
        } else {
            error
        })
    }
}

/// Starts an emulated board with the image for a machine.
#[cfg(unix)]
fn emulated(
    board: Board,
    machine: &MachineFile,
) -> Result<RemoteController<pil::Emulator>, CliError> {
    let emulator = pil::Emulator::start(board, &pil::image_for(board, machine)?)?;
    let period_us = machine.config.period_us;
    let mut remote = RemoteController::begin(emulator, period_us)
        .map_err(|reason| CliError::new(Exit::Port, format!("{board}: {reason}")))?;
    remote.set_budget(pil::counts(pil::budget(period_us)));
    Ok(remote)
}

/// Refuses a machine with a haptic arm on its own board, which takes no remote master.
pub(super) fn refuse_own_arm(machine: &MachineFile) -> Result<(), CliError> {
    if machine.config.haptic.is_none() {
        return Ok(());
    }
    let what = format!(
        "{}: this machine has a haptic arm on its own board, which is its master; it ignores a \
         remote master; use `haptimill console`, or remove [haptic]",
        machine.file
    );
    Err(CliError::new(Exit::BadInput, what))
}
