//! The machine file that a command chose, and the decision about the configuration of a board.

use crate::{Error, ErrorKind};
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::Welcome;

/// The machine file of a command, before the configuration of the board is known.
#[derive(Debug, Clone)]
pub struct Chosen {
    /// The file that the user named, or the built-in one.
    pub file: MachineFile,
    /// The user named it.
    pub named: bool,
    /// The user allows replacing the configuration of another machine.
    pub replace: bool,
    /// The file before the command completed it: a board with this configuration gets the completed
    /// one.
    pub base: Option<MachineFile>,
    /// The board is that of a haptic arm beside a machine: it has options of its own.
    pub is_second: bool,
}

/// The decision about the configuration of a board.
#[derive(Debug, Clone, PartialEq)]
pub enum Decision {
    /// The configuration of this file is active; nothing is sent.
    Active(Box<MachineFile>),
    /// The file is sent, with this message.
    Send(String),
    /// No file is known, for this reason; nothing is sent.
    Unknown(String),
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

/// The file of an active configuration, if that is this file, or this file as `haptimill teleop`
/// completes it.
fn same_machine(file: &MachineFile, active: u32) -> Result<Option<MachineFile>, Error> {
    if crc(file)? == active {
        return Ok(Some(file.clone()));
    }
    if file.is_master() || file.config.haptic.is_some() {
        return Ok(None);
    }
    let mut completed = file.with_follow()?;
    if crc(&completed)? == active {
        return Ok(Some(completed));
    }
    for stale_ms in STALE_MS {
        if let Some(follow) = &mut completed.config.follow {
            follow.stale_ms = stale_ms;
        }
        if crc(&completed)? == active {
            return Ok(Some(completed));
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
            is_second: false,
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

    /// Decides on the configuration of a board that answered like this.
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
                        "the configuration of \"{name}\" on the board is completed for teleoperation"
                    )));
                }
            } else {
                known = same_machine(file, active)?;
            }
            let base = self.base.as_ref().unwrap_or(file);
            if known.is_none() && !self.named {
                known = same_machine(&base.with_haptic_arm()?, active)?;
            }
            if known.is_none() && !self.named {
                known = same_machine(&MachineFile::built_in_master()?, active)?;
            }
            if let Some(known) = known {
                return Ok(Decision::Active(Box::new(known)));
            }
        }
        let expected = file.config.name.as_str();
        let (machine_option, replace_option) = if self.is_second {
            ("--master-machine", "--replace-master-machine")
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
                "the board had no configuration; it is configured as \"{expected}\" of {}",
                file.file
            )),
            (true, _) if name == expected => Decision::Send(format!(
                "the configuration of \"{name}\" on the board (CRC {active:08x}) is replaced by {} (CRC {:08x})",
                file.file,
                crc(file)?
            )),
            (true, _) if self.replace => Decision::Send(format!(
                "the configuration of \"{name}\" on the board (CRC {active:08x}) is replaced by \"{expected}\" of {}",
                file.file
            )),
            (true, _) => {
                let what = format!(
                    "the board is configured as \"{name}\" (CRC {active:08x}), and {} is \"{expected}\"; give the machine file of \"{name}\", or, if this \
                     board drives \"{expected}\" now, {replace_option}",
                    file.file
                );
                return Err(Error::new(ErrorKind::Command, what));
            }
        })
    }
}
