//! The machine file of a command on a port, and the agreement with the board on it.
//!
//! The drives obey the configuration that is active on the board. A command replaces it on request
//! only: with wrong lengths, scales or limits a machine collides with its own frame.

pub use crate::choice::{Chosen, Decision};

use crate::session::{Line, Session};
use crate::{Error, ErrorKind};
use haptimill_machine_file::MachineFile;

/// What a command needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Need {
    /// Nothing: it queries or switches off. It never changes the configuration.
    Nothing,
    /// An active configuration.
    Configuration,
    /// The machine file of the active configuration.
    File,
}

impl Chosen {
    /// The machine file of board and command; see [`Chosen::agree`].
    ///
    /// # Errors
    /// As [`Chosen::agree`].
    pub fn file_of<L: Line>(&self, session: &mut Session<L>) -> Result<MachineFile, Error> {
        let file = self.agree(session, Need::File)?;
        file.ok_or_else(|| Error::new(ErrorKind::Internal, "no machine file"))
    }

    /// Makes board and command use the same machine file, and returns it. The session must be open.
    /// A change of the configuration is a notice of the session.
    ///
    /// # Errors
    /// [`ErrorKind::Command`]: the board is configured as another machine, or has no configuration,
    /// or refuses the file.
    pub fn agree<L: Line>(
        &self,
        session: &mut Session<L>,
        need: Need,
    ) -> Result<Option<MachineFile>, Error> {
        let welcome = session.client_mut().controller().cloned();
        let Some(welcome) = welcome else {
            return Err(Error::new(ErrorKind::Internal, "no session"));
        };
        let decision = match (self.decide(&welcome), need) {
            // The command changes nothing: a different file is harmless.
            (Err(error), Need::Nothing) => Decision::Unknown(error.message),
            (Ok(Decision::Send(_)), Need::Nothing) => {
                Decision::Unknown(format!("the board is not configured as {}", self.file.file))
            }
            (decision, _) => decision?,
        };
        match decision {
            Decision::Active(file) => {
                session.set_machine(&file);
                Ok(Some(*file))
            }
            Decision::Send(what) => {
                session.notify(what);
                session.set_machine(&self.file);
                let before = session.status()?;
                session.configure(&self.file)?;
                if before.homed {
                    let kept = session.status()?.homed;
                    session.notify(if kept { KEPT } else { LOST });
                }
                Ok(Some(self.file.clone()))
            }
            Decision::Unknown(what) if need == Need::File => {
                Err(Error::new(ErrorKind::Command, what))
            }
            Decision::Unknown(what) if need == Need::Configuration && welcome.config_crc == 0 => {
                Err(Error::new(ErrorKind::Command, what))
            }
            Decision::Unknown(what) => {
                session.clear_axes();
                if welcome.config_crc != 0 {
                    session.notify(format!("coordinates and joints are not shown: {what}"));
                }
                Ok(None)
            }
        }
    }
}

/// Messages about the position after the configuration was replaced.
const KEPT: &str = "the position is kept";
const LOST: &str =
    "the position is lost; place the joints at their presets, then `haptimill home --at-preset`";
