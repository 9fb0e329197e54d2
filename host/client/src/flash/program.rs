//! Programs that write an image: `probe-rs` with a debug probe, `dfu-util` over the USB of the boot
//! ROM.

use super::Chip;
use crate::{Error, ErrorKind};
use std::ffi::{OsStr, OsString};
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

/// A program that writes an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Program {
    /// `probe-rs`, with a debug probe.
    ProbeRs,
    /// `dfu-util`, over the USB of the boot ROM.
    DfuUtil,
}

/// Folders in which programs are looked for, in this order.
#[derive(Debug, Clone)]
pub struct SearchPath(pub Vec<PathBuf>);

/// A program that sees one device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Writer {
    /// The program.
    pub program: Program,
    /// Its file.
    pub file: PathBuf,
}

/// What the programs of a computer see.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Seen {
    /// The first program that sees a device.
    Device(Writer),
    /// No program sees a device: why, and what to do.
    Nothing(String),
}

impl Program {
    /// All programs, the preferred one first.
    pub const ALL: [Self; 2] = [Self::ProbeRs, Self::DfuUtil];

    /// Its name, which is that of its file, too.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::ProbeRs => "probe-rs",
            Self::DfuUtil => "dfu-util",
        }
    }

    /// Finds a program by name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|program| program.name() == name)
    }

    /// The argument that lists its devices.
    const fn list(self) -> &'static str {
        match self {
            Self::ProbeRs => "list",
            Self::DfuUtil => "-l",
        }
    }

    /// Its device, in words.
    const fn device(self) -> &'static str {
        match self {
            Self::ProbeRs => "debug probe",
            Self::DfuUtil => "boot ROM of the chip",
        }
    }

    /// What makes a device appear.
    const fn connect(self) -> &'static str {
        match self {
            Self::ProbeRs => "connect the ST-LINK of the board",
            Self::DfuUtil => {
                "connect the USB of the chip, set BOOT0 high, and reset the board for DFU"
            }
        }
    }

    /// What to do when it is missing.
    fn missing(self) -> String {
        let name = self.name();
        format!("{name} is not on the search path (PATH): install it")
    }

    /// The devices in its list.
    fn devices(self, list: &str, chip: &Chip) -> usize {
        let is_device = |line: &&str| match self {
            // `[0]: STLink V2 -- 0483:3748:... (ST-LINK)`
            Self::ProbeRs => {
                let number = line
                    .strip_prefix('[')
                    .and_then(|rest| rest.split_once("]:"));
                number.is_some_and(|(number, _)| number.parse::<u32>().is_ok())
            }
            // `Found DFU: [0483:df11] ver=2200, ..., alt=0, name="@Internal Flash ...", ...`; a
            // line for each memory of the device.
            Self::DfuUtil => {
                line.starts_with(&format!("Found DFU: [{}]", usb_ids(chip)))
                    && line.contains(" alt=0,")
            }
        };
        list.lines().map(str::trim).filter(is_device).count()
    }

    /// What to do when it fails.
    fn remedy(self) -> &'static str {
        match self {
            Self::ProbeRs => {
                "read what it printed, check the ST-LINK and its wires to the chip, and repeat"
            }
            // A chip that leaves its boot ROM does not answer any more, which some versions report.
            Self::DfuUtil => {
                "if it printed `File downloaded successfully`, the image is in the flash: set BOOT0 \
                 low and reset the board; else set BOOT0 high, reset the board for DFU, and repeat"
            }
        }
    }
}

/// USB ids of the boot ROM of a chip, as `dfu-util` has them.
fn usb_ids(chip: &Chip) -> String {
    let (vendor, product) = chip.dfu;
    format!("{vendor:04x}:{product:04x}")
}

impl SearchPath {
    /// That of the environment: `PATH`.
    #[must_use]
    pub fn of_environment() -> Self {
        let path = std::env::var_os("PATH").unwrap_or_default();
        Self(std::env::split_paths(&path).collect())
    }

    /// The file of a program.
    fn file(&self, program: Program) -> Option<PathBuf> {
        let name = format!("{}{}", program.name(), std::env::consts::EXE_SUFFIX);
        let mut files = self.0.iter().map(|folder| folder.join(&name));
        files.find(|file| is_executable(file))
    }

    /// Looks for a program that sees a device; `with` is the only one to be asked.
    ///
    /// # Errors
    /// No program is there, or one sees several devices; what to do.
    pub fn find(&self, with: Option<Program>, chip: &Chip) -> Result<Seen, Error> {
        let programs = Program::ALL.into_iter();
        let mut reasons = Vec::new();
        let mut is_there = false;
        for program in programs.filter(|&program| with.is_none_or(|with| with == program)) {
            let Some(file) = self.file(program) else {
                reasons.push(program.missing());
                continue;
            };
            is_there = true;
            let writer = Writer { program, file };
            match writer.devices(chip) {
                Ok(0) => reasons.push(format!(
                    "{} sees no {}: {}",
                    program.name(),
                    program.device(),
                    program.connect()
                )),
                Ok(1) => return Ok(Seen::Device(writer)),
                Ok(count) => {
                    let what = format!(
                        "{} sees {count} devices: leave only that of the board connected",
                        program.name()
                    );
                    return Err(Error::new(ErrorKind::Port, what));
                }
                Err(reason) => reasons.push(reason),
            }
        }
        let reasons = reasons.join("; or: ");
        match is_there {
            true => Ok(Seen::Nothing(reasons)),
            false => Err(Error::new(ErrorKind::Port, reasons)),
        }
    }
}

#[cfg(unix)]
fn is_executable(file: &Path) -> bool {
    use std::os::unix::fs::PermissionsExt as _;
    std::fs::metadata(file).is_ok_and(|it| it.is_file() && it.permissions().mode() & 0o111 != 0)
}

#[cfg(not(unix))]
fn is_executable(file: &Path) -> bool {
    file.is_file()
}

impl Writer {
    /// The devices that it sees, or why it does not say.
    fn devices(&self, chip: &Chip) -> Result<usize, String> {
        let list = self.program.list();
        let named = format!("`{} {list}`", self.program.name());
        let output = Command::new(&self.file)
            .arg(list)
            .stdin(Stdio::null())
            .output();
        let Output {
            status,
            stdout,
            stderr,
        } = output.map_err(|error| format!("{named}: {error}: install it again"))?;
        if !status.success() {
            let text = String::from_utf8_lossy(&stderr);
            let last = text.trim().lines().next_back().unwrap_or("no message");
            return Err(format!(
                "{named} failed ({status}): {last}: {}",
                self.program.connect()
            ));
        }
        Ok(self
            .program
            .devices(&String::from_utf8_lossy(&stdout), chip))
    }

    /// Writes an image: its path, and the contents of this file. The board restarts. What the
    /// program prints goes to the standard error. `scratch` is a folder for a file for the program.
    ///
    /// # Errors
    /// The image is not for this chip, or the program fails: its exit code, and what to do.
    pub fn write(
        &self,
        path: &Path,
        image: &[u8],
        chip: &Chip,
        scratch: &Path,
    ) -> Result<(), Error> {
        match self.program {
            Program::ProbeRs => {
                let chip = ["--chip", chip.name].map(OsStr::new);
                let download = [OsStr::new("download"), chip[0], chip[1]];
                let file = [OsStr::new("--verify"), path.as_os_str()];
                self.run(&[&download[..], &file].concat())?;
                self.run(&[OsStr::new("reset"), chip[0], chip[1]])
            }
            Program::DfuUtil => {
                let bad = |what| {
                    let what = format!("{} {what}", path.display());
                    Error::new(ErrorKind::BadInput, what)
                };
                let contents = chip.contents(image).map_err(bad)?;
                let file = scratch.join("image.bin");
                std::fs::write(&file, contents).map_err(|error| {
                    let what = format!("{}: {error}", file.display());
                    Error::new(ErrorKind::Output, what)
                })?;
                let place = format!("{:#010x}:leave", chip.flash.start);
                let ids = usb_ids(chip);
                let memory = ["-a", "0", "-d", &ids, "-s", &place, "-D"].map(OsStr::new);
                self.run(&[&memory[..], &[file.as_os_str()]].concat())
            }
        }
    }

    /// Runs the program to its end.
    fn run(&self, arguments: &[&OsStr]) -> Result<(), Error> {
        let failed = |what: &str| {
            let command = [&[OsStr::new(self.program.name())], arguments].concat();
            let command: OsString = command.join(OsStr::new(" "));
            let what = format!("`{}` {what}; {}", command.display(), self.program.remedy());
            Error::new(ErrorKind::Output, what)
        };
        let status = Command::new(&self.file)
            .args(arguments)
            .stdin(Stdio::null())
            // The standard output has the results of this program.
            .stdout(Stdio::from(io::stderr()))
            .status()
            .map_err(|error| failed(&format!("did not start: {error}")))?;
        match status.code() {
            Some(0) => Ok(()),
            Some(code) => Err(failed(&format!("ended with exit code {code}"))),
            None => Err(failed(&format!("was ended: {status}"))),
        }
    }
}

#[cfg(all(test, unix))]
mod tests;
