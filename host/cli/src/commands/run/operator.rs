//! The operator of a run: keys of the terminal, and requests of other processes.

use super::args::RunArgs;
use super::keys::{is_enter, is_hold};
use super::overrides::Overrides;
#[cfg(unix)]
use haptimill_client::port::Control;
use haptimill_machine_file::MachineFile;
use serde_json::{Value, json};

/// What the operator orders, from the first job of a run to the last one.
pub(super) struct Operator {
    pub(super) overrides: Overrides,
    /// A hold was ordered.
    pub(super) holds: bool,
    /// The end of a hold or a pause was ordered.
    pub(super) resumes: bool,
    /// The job holds or pauses.
    pub(super) is_held: bool,
    #[cfg(unix)]
    control: Option<Control>,
}

impl Operator {
    /// Takes requests of other processes, of a machine behind a port; `speeds` are the slowest and
    /// the fastest speed of the spindle in the program, rev/min.
    pub(super) fn new(args: &RunArgs, machine: &MachineFile, speeds: Option<[u16; 2]>) -> Self {
        Self {
            overrides: Overrides::new(args, machine.spindle, speeds),
            holds: false,
            resumes: false,
            is_held: false,
            #[cfg(unix)]
            control: listen(args),
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
        #[cfg(unix)]
        if let Some(mut control) = self.control.take() {
            control.serve(|request| match self.answer(request) {
                Ok(what) => json!({ "done": what }).to_string(),
                Err(what) => json!({ "error": what }).to_string(),
            });
            self.control = Some(control);
        }
    }

    /// Does what a request asks, and describes it.
    ///
    /// # Errors
    /// Why it is not done.
    fn answer(&mut self, request: &str) -> Result<String, String> {
        let request: Value = serde_json::from_str(request).map_err(|error| error.to_string())?;
        match request["order"].as_str() {
            Some("override") => {
                let [feed, rapid, spindle] = ["feed", "rapid", "spindle"].map(|key| {
                    let percent = request[key].as_u64();
                    // A number that is too large is refused as out of range.
                    percent.map(|percent| u8::try_from(percent).unwrap_or(u8::MAX))
                });
                self.overrides.set(feed, rapid, spindle)?;
                Ok(self.overrides.to_string())
            }
            Some("hold") if self.is_held => Ok("the job is held".into()),
            Some("hold") => {
                self.holds = true;
                Ok("the job holds along its path".into())
            }
            Some("resume") if self.is_held => {
                self.resumes = true;
                Ok("the job goes on".into())
            }
            Some("resume") => Err("the job is not held, and does not pause".into()),
            _ => Err("the request is not known; use the same version of haptimill".into()),
        }
    }
}

/// Listens for requests. A job runs without them.
#[cfg(unix)]
fn listen(args: &RunArgs) -> Option<Control> {
    if args.port.is_simulated() {
        return None;
    }
    let control = Control::listen(&args.port.port);
    control.inspect_err(|error| eprintln!("{error}")).ok()
}
