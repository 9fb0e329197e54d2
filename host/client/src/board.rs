//! Which machine file a command on a port goes by, and whether the board takes it.
//!
//! The drives obey the configuration that is active on the board. A command never replaces that configuration unasked: the wrong lengths, scales or
//! limits move a machine into its own frame.

use crate::session::{Line, Session};
use crate::{Error, ErrorKind};
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::Welcome;

/// The machine file of a command before the board was asked.
#[derive(Debug, Clone)]
pub struct Chosen {
    /// The file that was named, or the built-in one.
    pub file: MachineFile,
    /// The user named it.
    pub named: bool,
    /// The user allows that another machine's configuration is replaced.
    pub replace: bool,
    /// The file before the command completed it; a board that is configured as this machine takes the completed file.
    pub base: Option<MachineFile>,
    /// The board is that of a haptic arm beside a machine: its options have names of their own.
    pub beside: bool,
}

/// What is to be done about the configuration of a board.
#[derive(Debug, Clone, PartialEq)]
pub enum Decision {
    /// The active configuration is that of this file; nothing is sent.
    Active(Box<MachineFile>),
    /// The file is sent; this is said before.
    Send(String),
    /// Nothing is sent, and what needs the file cannot be done.
    Unknown(String),
}

/// What a command needs to know of the machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Need {
    /// Nothing: it asks, or switches off. It never changes the configuration.
    Nothing,
    /// An active configuration.
    Configuration,
    /// The machine file of the active configuration.
    File,
}

/// The CRC of a file's configuration.
fn crc(file: &MachineFile) -> Result<u32, Error> {
    let encoded = file.encoded();
    encoded
        .map(|(_, crc)| crc)
        .map_err(|error| Error::new(ErrorKind::Internal, error))
}

/// Times that `haptimill teleop --stale` can put into a configuration, ms.
const STALE_MS: std::ops::RangeInclusive<u16> = 5..=1000;

/// The file of an active configuration, if it is this one or this one as `haptimill teleop` completes it.
fn same_machine(file: &MachineFile, active: u32) -> Result<Option<MachineFile>, Error> {
    if crc(file)? == active {
        return Ok(Some(file.clone()));
    }
    if file.is_master() || file.config.haptic.is_some() {
        return Ok(None);
    }
    let mut following = file.with_follow()?;
    if crc(&following)? == active {
        return Ok(Some(following));
    }
    for stale_ms in STALE_MS {
        if let Some(follow) = &mut following.config.follow {
            follow.stale_ms = stale_ms;
        }
        if crc(&following)? == active {
            return Ok(Some(following));
        }
    }
    Ok(None)
}

impl Chosen {
    /// No file was named; this is the built-in one.
    #[must_use]
    pub const fn unnamed(file: MachineFile) -> Self {
        Self {
            file,
            named: false,
            replace: false,
            base: None,
            beside: false,
        }
    }

    /// The same, completed by the command.
    #[must_use]
    pub fn completed(self, file: MachineFile) -> Self {
        Self {
            base: Some(self.file),
            file,
            ..self
        }
    }

    /// What is to be done on a board that welcomed a session like this.
    ///
    /// # Errors
    /// [`ErrorKind::Command`]: the board is configured as another machine.
    pub fn decide(&self, welcome: &Welcome) -> Result<Decision, Error> {
        let (name, active) = (welcome.machine.as_str(), welcome.config_crc);
        let file = &self.file;
        if active != 0 {
            let mut known = None;
            if let Some(base) = &self.base {
                if crc(file)? == active {
                    return Ok(Decision::Active(Box::new(file.clone())));
                }
                if same_machine(base, active)?.is_some() {
                    return Ok(Decision::Send(format!(
                        "the configuration of \"{name}\" on the board is completed: the machine can follow a hand"
                    )));
                }
            } else {
                known = same_machine(file, active)?;
            }
            let base = self.base.as_ref().unwrap_or(file);
            if known.is_none() && !self.named {
                known = same_machine(&base.with_hand()?, active)?;
            }
            if known.is_none() && !self.named {
                known = same_machine(&MachineFile::built_in_master()?, active)?;
            }
            if let Some(known) = known {
                return Ok(Decision::Active(Box::new(known)));
            }
        }
        let wanted = file.config.name.as_str();
        let (machine_option, replace_option) = if self.beside {
            ("--hand-machine", "--replace-hand-machine")
        } else {
            ("--machine", "--replace-machine")
        };
        Ok(match (self.named, active) {
            (false, 0) => Decision::Unknown(format!(
                "the board has no configuration; give the machine file of this machine with {machine_option} FILE"
            )),
            (false, _) => Decision::Unknown(format!(
                "the board is configured as \"{name}\" (CRC {active:08x}), which is not a built-in machine; \
                 give its machine file with {machine_option} FILE"
            )),
            (true, 0) => Decision::Send(format!(
                "the board had no configuration; it is configured as \"{wanted}\" of {}",
                file.file
            )),
            (true, _) if name == wanted => Decision::Send(format!(
                "the configuration of \"{name}\" on the board (CRC {active:08x}) is replaced by {} (CRC {:08x})",
                file.file,
                crc(file)?
            )),
            (true, _) if self.replace => Decision::Send(format!(
                "the configuration of \"{name}\" on the board (CRC {active:08x}) is replaced by \"{wanted}\" of {}",
                file.file
            )),
            (true, _) => {
                let what = format!(
                    "the board is configured as \"{name}\" (CRC {active:08x}), and {} is \"{wanted}\"; give the machine file of \"{name}\", or, if this \
                     board drives \"{wanted}\" now, {replace_option}",
                    file.file
                );
                return Err(Error::new(ErrorKind::Command, what));
            }
        })
    }

    /// The machine file that the board and the command go by; see [`Chosen::agree`].
    ///
    /// # Errors
    /// As there.
    pub fn file_of<L: Line>(&self, session: &mut Session<L>) -> Result<MachineFile, Error> {
        let file = self.agree(session, Need::File)?;
        file.ok_or_else(|| Error::new(ErrorKind::Internal, "no machine file"))
    }

    /// Sees to it that board and command go by the same machine file, and gives it. The session has been opened.
    ///
    /// # Errors
    /// [`ErrorKind::Command`]: the board is configured as another machine, or not at all, or it refuses the configuration.
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
            // It changes nothing, so it does no harm that the file is another one.
            (Err(error), Need::Nothing) => Decision::Unknown(error.message),
            (Ok(Decision::Send(_)), Need::Nothing) => {
                Decision::Unknown(format!("the board is not configured as {}", self.file.file))
            }
            (decision, _) => decision?,
        };
        match decision {
            Decision::Active(file) => {
                session.use_machine(&file);
                Ok(Some(*file))
            }
            Decision::Send(what) => {
                eprintln!("{what}");
                session.use_machine(&self.file);
                let before = session.status()?;
                session.configure(&self.file)?;
                if before.position_kept {
                    let kept = session.status()?.position_kept;
                    eprintln!("{}", if kept { KEPT } else { LOST });
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
                session.forget_axes();
                if welcome.config_crc != 0 {
                    eprintln!("axes are not shown: {what}");
                }
                Ok(None)
            }
        }
    }
}

/// What becomes of a position when a configuration is replaced.
const KEPT: &str = "the position is kept";
const LOST: &str = "the position is lost; set the joints up at their presets by hand, then `haptimill home --at-preset`";
