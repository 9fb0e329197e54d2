//! The operator of a run: keys of the terminal, and requests of other processes.

use super::args::RunArgs;
use super::keys::{is_enter, is_hold};
use super::overrides::Overrides;
use crate::commands::requests::{NO_REPORT, Request, Requests};
use crate::commands::status::StatusReport;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_protocol::message::{Kept, Telemetry};

/// Commands of the operator, from the first job of a run to the last one.
pub(super) struct Operator {
    pub(super) overrides: Overrides,
    /// A hold was commanded.
    pub(super) holds: bool,
    /// The end of a hold or a pause was commanded.
    pub(super) resumes: bool,
    /// The job holds or pauses.
    pub(super) is_held: bool,
    /// The newest report of the machine.
    telemetry: Option<Telemetry>,
    /// Name of the machine, check of its configuration and what its board keeps, and its model.
    machine: (String, (u32, Kept), Model),
    requests: Requests,
}

impl Operator {
    /// Takes requests of other processes, of a machine behind a port; `speeds` are the slowest and
    /// the fastest speed of the spindle in the program, rev/min.
    pub(super) fn new(
        args: &RunArgs,
        machine: &MachineFile,
        kept: Kept,
        speeds: Option<[u16; 2]>,
    ) -> Self {
        Self {
            overrides: Overrides::new(args, machine.spindle, speeds),
            holds: false,
            resumes: false,
            is_held: false,
            telemetry: None,
            machine: (
                machine.config.name.to_string(),
                (machine.encoded().map_or(0, |(_, crc)| crc), kept),
                Model::new(machine),
            ),
            // A job runs without them.
            requests: Requests::listen(&args.port.port).unwrap_or_else(|error| {
                eprintln!("{error}");
                Requests::default()
            }),
        }
    }

    /// Notes the newest report of the machine.
    pub(super) fn note_report(&mut self, telemetry: &Telemetry) {
        let known = self.telemetry.as_ref().map(|known| known.period);
        if known != Some(telemetry.period) {
            self.telemetry = Some(telemetry.clone());
        }
    }

    /// Follows a key; other keys change nothing.
    ///
    /// # Errors
    /// Why an override does not change.
    pub(super) fn key(&mut self, key: u8) -> Result<(), String> {
        self.holds |= is_hold(key);
        self.resumes |= is_enter(key);
        self.overrides.key(key)
    }

    /// Answers the requests of other processes.
    pub(super) fn serve(&mut self) {
        let mut requests = std::mem::take(&mut self.requests);
        requests.serve(|request| self.answer(request));
        self.requests = requests;
    }

    /// Does what a request asks, and describes it.
    ///
    /// # Errors
    /// Why it is not done.
    fn answer(&mut self, request: Request) -> Result<String, String> {
        match request {
            Request::Override([feed, rapid, spindle]) => {
                self.overrides.set(feed, rapid, spindle)?;
                Ok(self.overrides.to_string())
            }
            Request::Hold if self.is_held => Ok("the job is held".into()),
            Request::Hold => {
                self.holds = true;
                Ok("the job holds along its path".into())
            }
            Request::Resume if self.is_held => {
                self.resumes = true;
                Ok("the job continues".into())
            }
            Request::Resume => Err("the job is not held, and does not pause".into()),
            Request::Status => {
                let telemetry = self.telemetry.as_ref().ok_or(NO_REPORT)?;
                let (name, configuration, model) = &self.machine;
                Ok(StatusReport::new(name, *configuration, model, telemetry).answer())
            }
        }
    }
}
