//! Writes an image into the flash of a board whose boot ROM appears as a drive.
//!
//! The boot ROM has a file `INFO_UF2.TXT` with the name of its chip. It writes the blocks of a UF2
//! file into the flash as they arrive, restarts after the last one, and its drive disappears.

pub mod uf2;

use crate::{Error, ErrorKind};
use haptimill_firmware::config::{Drive as JointDrive, Home};
use haptimill_machine_file::model::Model;
use haptimill_machine_file::scale::{PER_COUNT, per_unit};
use haptimill_machine_file::{MachineFile, input};
use std::fmt;
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// A board that takes UF2 files, with one of its images: another wiring is another board.
#[derive(Debug, PartialEq, Eq)]
pub struct Board {
    /// Name on the command line.
    pub name: &'static str,
    /// Its name.
    pub title: &'static str,
    /// `Board-ID` of its boot ROM, which is the label of its drive, too.
    pub boot_id: &'static str,
    /// USB ids of its boot ROM: vendor and product.
    pub boot_usb: (u16, u16),
    /// USB ids of its image; other devices have them, too.
    pub usb: (u16, u16),
    /// Name of the product on the USB.
    pub usb_product: &'static str,
    /// Family of its chip in UF2 files.
    pub family: u32,
    /// How the boot ROM is started.
    pub boot_mode: &'static str,
    /// Image that the source tree makes, and the command that makes it.
    pub image: &'static str,
    /// Command that makes the image.
    pub make: &'static str,
    /// Baud rate of its line to the host.
    pub baud: u32,
    /// Its line to the host.
    pub line: &'static str,
    /// Joints with a step drive, and ticks of their step clock in a microsecond. It has no torque
    /// drives.
    pub step_drives: (usize, u16),
    /// Joints from the first on that may have an encoder. It has no inputs for index pulses.
    pub encoders: usize,
    /// It reads limit switches.
    pub has_limit_switches: bool,
    /// It has the bus of the chips of the drives.
    pub has_chip_bus: bool,
    /// Largest rate of a joint, steps/s.
    pub step_rate: u32,
    /// Control periods that an image can have, us.
    pub periods: &'static [u16],
    /// Digital inputs and outputs: their channels count from 0. It has no analog ones.
    pub digital: (u8, u8),
}

/// All boards that take UF2 files.
pub const BOARDS: &[Board] = &[PICO2, PICO2_ENCODERS];

const PICO2: Board = Board {
    name: "pico2",
    title: "Raspberry Pi Pico 2",
    boot_id: "RP2350",
    boot_usb: (0x2E8A, 0x000F),
    usb: (0x2E8A, 0x0009),
    usb_product: "Haptimill Pico 2",
    family: 0xE48B_FF59,
    boot_mode: "hold the button BOOTSEL while you plug the board in",
    image: "firmware/boards/pico2/target/thumbv8m.main-none-eabihf/release/haptimill-pico2.uf2",
    make: "cargo xtask board pico2 --uf2",
    baud: 1_000_000,
    line: "its USB port, or, with the image for the UART, GP0 and GP1 at a serial converter",
    step_drives: (5, 75),
    encoders: 0,
    has_limit_switches: false,
    has_chip_bus: true,
    step_rate: 1_000_000,
    periods: &[200, 250, 320, 400, 500],
    digital: (2, 1),
};

/// The Pico 2 with encoders and shift registers.
const PICO2_ENCODERS: Board = Board {
    name: "pico2-encoders",
    title: "Raspberry Pi Pico 2 with encoders",
    usb_product: "Haptimill encoder Pico 2",
    image: "firmware/boards/pico2/target/thumbv8m.main-none-eabihf/release/haptimill-pico2-encoders.uf2",
    make: "cargo xtask board pico2 --encoders",
    line: "its USB port",
    encoders: 4,
    has_limit_switches: true,
    has_chip_bus: false,
    digital: (4, 7),
    ..PICO2
};

impl Board {
    /// Finds a board by name.
    #[must_use]
    pub fn named(name: &str) -> Option<&'static Self> {
        BOARDS.iter().find(|board| board.name == name)
    }

    /// The image of a Pico 2 for a machine: the one with encoders if a joint has one, or needs
    /// limit switches.
    #[must_use]
    pub fn of_machine(machine: &MachineFile) -> &'static Self {
        let mut joints = machine.config.joints.iter();
        match joints.any(|joint| joint.encoder.is_some() || joint.needs_limit_switches()) {
            true => &BOARDS[1],
            false => &BOARDS[0],
        }
    }

    /// The board whose name on the USB is in these contents of the flash.
    #[must_use]
    pub fn of_flash(flash: &[u8]) -> Option<&'static Self> {
        let has = |name: &str| flash.windows(name.len()).any(|at| at == name.as_bytes());
        BOARDS.iter().find(|board| has(board.usb_product))
    }

    /// Checks that it can drive a machine.
    ///
    /// # Errors
    /// The first joint, input or other part that it does not have or cannot drive, the key, and
    /// what to do.
    pub fn check_machine(&self, machine: &MachineFile) -> Result<(), Error> {
        self.check_joints(machine)?;
        let refused = |what: String| {
            let what = format!("{}: {what} ({})", machine.file, self.title);
            Err(Error::new(ErrorKind::BadInput, what))
        };
        let config = &machine.config;
        if let Some(problem) = self.channels(machine) {
            return refused(problem);
        }
        if let Some(problem) = self.chips(machine) {
            return refused(problem);
        }
        if config.force.is_some() {
            return refused("the board has no force sensor; remove [force]".to_string());
        }
        if config.haptic.is_some() {
            return refused("the board has no haptic arm; remove [haptic]".to_string());
        }
        if !self.periods.contains(&config.period_us) {
            let periods: Vec<String> = self.periods.iter().map(ToString::to_string).collect();
            return refused(format!(
                "period_us = {}, but an image of the board has a control period of {} us; set it \
                 to one of them",
                config.period_us,
                periods.join(", ")
            ));
        }
        Ok(())
    }

    /// The first joint with a chip, if the board has no bus for it.
    fn chips(&self, machine: &MachineFile) -> Option<String> {
        if self.has_chip_bus {
            return None;
        }
        let name = first_chip(machine)?;
        Some(format!(
            "joint {name}: [joint.drive.tmc2209]: the board has no bus for these chips; set them \
             by their pins and remove the section, or take the image without encoders"
        ))
    }

    /// The first input or output that the board does not have.
    fn channels(&self, machine: &MachineFile) -> Option<String> {
        let (inputs, outputs) = self.digital;
        let (io, names) = (&machine.config.io, &machine.io);
        let input = io.inputs.iter().zip(&names.inputs);
        let input = input.map(|(it, name)| ("input", "inputs", it.channel, inputs, name));
        let output = io.outputs.iter().zip(&names.outputs);
        let output = output.map(|(it, name)| ("output", "outputs", it.channel, outputs, name));
        let missing = input.chain(output).find(|it| it.2 >= it.3);
        if let Some((one, all, channel, count, name)) = missing {
            let own = match count {
                0..=2 => {
                    let own: Vec<String> = (0..count).map(|channel| channel.to_string()).collect();
                    own.join(" and ")
                }
                _ => format!("0 to {}", count - 1),
            };
            return Some(format!(
                "{one} {name}: channel = {channel}, but the digital {all} of the board have \
                 channel {own}; use one of them, or remove it"
            ));
        }
        let analog = names.analog_inputs.first().map(|it| ("input", it));
        let analog = analog.or_else(|| names.analog_outputs.first().map(|it| ("output", it)));
        analog.map(|(one, analog)| {
            let name = &analog.name;
            format!("[[analog_{one}]] {name}: the board has no analog {one}s; remove it")
        })
    }

    /// Checks the joints of a machine.
    fn check_joints(&self, machine: &MachineFile) -> Result<(), Error> {
        let (joints, ticks) = self.step_drives;
        let model = Model::new(machine);
        let names = model.joint_names();
        for (joint, config) in machine.config.joints.iter().enumerate() {
            let what = match config.drive {
                _ if joint >= joints => format!("the board has {joints} drives"),
                JointDrive::Torque { .. } => "the board has no torque drives".to_string(),
                JointDrive::Steps { ticks_per_us, .. } if ticks_per_us != ticks => format!(
                    "ticks_per_us = {ticks_per_us}, but the step clock of the board has {ticks}; \
                     change it here and below [plant]"
                ),
                JointDrive::Steps { .. } if config.encoder.is_some() && joint >= self.encoders => {
                    match self.encoders {
                        0 => "the board has no encoder inputs; remove its encoder, or take the \
                              image with encoders (`haptimill flash pico2-encoders`)"
                            .to_string(),
                        count => format!(
                            "the board has encoder inputs for {count} joints; remove the encoder \
                             of this one"
                        ),
                    }
                }
                JointDrive::Steps { .. }
                    if matches!(config.home, Home::Index | Home::SwitchAndIndex(_)) =>
                {
                    let home = match config.home {
                        Home::Index => "index",
                        _ => "switch_and_index",
                    };
                    format!(
                        "home = \"{home}\", but the board has no inputs for index pulses; set \
                         home = \"switch\" with [joint.switch], or home = \"none\""
                    )
                }
                JointDrive::Steps { .. }
                    if config.needs_limit_switches() && !self.has_limit_switches =>
                {
                    "the board has no inputs for limit switches; search the home switch, and leave \
                     limit_low_active and limit_high_active out, or take the image with encoders \
                     (`haptimill flash pico2-encoders`)"
                        .to_string()
                }
                JointDrive::Steps { per_step, .. } => {
                    let Some(limits) = machine.joints.get(joint) else {
                        continue;
                    };
                    let step = per_step.unsigned_abs() as f64 / PER_COUNT / per_unit(config.kind);
                    let rate = limits.rate / step;
                    if rate <= f64::from(self.step_rate) {
                        continue;
                    }
                    format!(
                        "its rate is {rate:.0} steps/s, but a joint of the board makes at most {}; \
                         lower the rate of the joint, or steps_per_turn and the microsteps of its \
                         drive",
                        self.step_rate
                    )
                }
            };
            let file = &machine.file;
            let name = names.get(joint).copied().unwrap_or("?");
            let what = format!("{file}: joint {name}: {what} ({})", self.title);
            return Err(Error::new(ErrorKind::BadInput, what));
        }
        Ok(())
    }

    /// The board of an image, by its name on the USB; an image for another line has none.
    fn of_image(&self, image: &[u8]) -> Option<&'static Self> {
        let pieces = uf2::read(image, self.family).unwrap_or_default();
        let flash: Vec<u8> = pieces
            .iter()
            .flat_map(|(_, piece)| *piece)
            .copied()
            .collect();
        Self::of_flash(&flash)
    }

    /// Checks that an image is not that of another board.
    ///
    /// # Errors
    /// The other board, and what to do.
    pub fn check_own(&self, image: &[u8]) -> Result<(), Error> {
        let what = match self.of_image(image) {
            Some(other) if other != self => format!(
                "the image is that of {} ({}); give its name, or another image",
                other.name, other.title
            ),
            // Only the board without encoders has an image for another line.
            None if self.encoders > 0 => format!(
                "the image has no USB port, or is not that of {} ({}); make it with `{}`",
                self.name, self.title, self.make
            ),
            _ => return Ok(()),
        };
        Err(Error::new(ErrorKind::BadInput, what))
    }

    /// Checks that an image can set the chips of the drives of a machine: one whose line to the
    /// host is the USB leaves the pins of their bus free.
    ///
    /// # Errors
    /// The first joint with a chip, and what to do.
    pub fn check_image(&self, machine: &MachineFile, image: &[u8]) -> Result<(), Error> {
        let Some(name) = first_chip(machine) else {
            return Ok(());
        };
        if self.of_image(image).is_some() {
            return Ok(());
        }
        let what = format!(
            "{}: joint {name}: [joint.drive.tmc2209]: the image has its line to the host at the \
             pins of the bus of these chips; take the image with the USB, or remove the section \
             ({})",
            machine.file, self.title
        );
        Err(Error::new(ErrorKind::BadInput, what))
    }

    /// The image of the source tree.
    ///
    /// # Errors
    /// It is not built.
    pub fn find_image(&self) -> Result<PathBuf, Error> {
        let here = std::env::current_dir().unwrap_or_default();
        here.ancestors()
            .chain(Path::new(env!("CARGO_MANIFEST_DIR")).ancestors())
            .map(|root| root.join(self.image))
            .find(|file| file.is_file())
            .ok_or_else(|| {
                let what = format!(
                    "{} is missing; make it with `{}` in the source tree, or give a UF2 file with \
                     --image",
                    self.image, self.make
                );
                Error::new(ErrorKind::BadInput, what)
            })
    }

    /// Reads an image, and checks that it is a whole one for this board.
    ///
    /// # Errors
    /// The file cannot be read, is no UF2 file, is damaged, or for another chip.
    pub fn read_image(&self, path: &Path) -> Result<Vec<u8>, Error> {
        let bad = |what: &dyn fmt::Display| {
            Error::new(ErrorKind::BadInput, format!("{} {what}", path.display()))
        };
        let bytes = input::read(path, MAX).map_err(|error| bad(&error))?;
        uf2::read(&bytes, self.family).map_err(|what| bad(&what))?;
        Ok(bytes)
    }
}

/// Name of the first joint with a chip that the board sets.
fn first_chip(machine: &MachineFile) -> Option<&str> {
    let joints = machine.config.joints.iter().zip(&machine.joints);
    let mut chips = joints.filter(|(joint, _)| joint.tmc2209().is_some());
    chips.next().map(|(_, limits)| limits.name.as_str())
}

/// Largest UF2 file: 16 MiB of flash.
const MAX: u64 = 32 << 20;

/// File of a boot ROM.
const INFO: &str = "INFO_UF2.TXT";

/// Where this computer shows drives and USB devices.
#[derive(Debug, Clone)]
pub struct Places {
    /// Table of the mounted drives.
    pub mounts: PathBuf,
    /// Folder with the drives by their labels.
    pub labels: PathBuf,
    /// Folder of the USB devices.
    pub usb: PathBuf,
}

impl Default for Places {
    /// Those of Linux.
    fn default() -> Self {
        Self {
            mounts: "/proc/mounts".into(),
            labels: "/dev/disk/by-label".into(),
            usb: "/sys/bus/usb/devices".into(),
        }
    }
}

/// A drive of a boot ROM.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Drive {
    /// Its folder.
    pub folder: PathBuf,
    /// Name of its chip.
    pub boot_id: String,
}

/// Where a board in boot mode was found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Found {
    /// Its drive is mounted.
    Mounted(Drive),
    /// Its drive is there and not mounted.
    NotMounted(PathBuf),
    /// It is on the USB, without a drive.
    NoDrive,
    /// Several are mounted.
    Several(Vec<PathBuf>),
    /// Only boards with another chip are in boot mode.
    OtherChip(Drive),
    /// No board is in boot mode.
    Nothing,
}

/// The drive of a boot ROM in a folder.
///
/// # Errors
/// The folder is none.
pub fn drive_in(folder: &Path) -> Result<Drive, Error> {
    let bad = |what: &str| {
        let what = format!("{}: {what}", folder.display());
        Error::new(ErrorKind::BadInput, what)
    };
    let info = fs::read(folder.join(INFO)).map_err(|error| {
        bad(&format!(
            "is not the drive of a board in boot mode: {INFO}: {error}"
        ))
    })?;
    let text = String::from_utf8_lossy(&info);
    let id = text.lines().find_map(|line| line.strip_prefix("Board-ID:"));
    let boot_id = id.ok_or_else(|| bad(&format!("{INFO} names no board")))?;
    Ok(Drive {
        folder: folder.to_path_buf(),
        boot_id: boot_id.trim().to_string(),
    })
}

impl Places {
    /// Folders of the mounted drives with a FAT file system, which boot ROMs have. Other file
    /// systems may be remote, and slow.
    fn mounted(&self) -> Vec<PathBuf> {
        let text = fs::read(&self.mounts).unwrap_or_default();
        let text = String::from_utf8_lossy(&text);
        let rows = text.lines().filter_map(|line| {
            let mut words = line.split(' ');
            let (folder, kind) = (words.nth(1)?, words.next()?);
            matches!(kind, "vfat" | "msdos").then(|| unescape(folder))
        });
        rows.collect()
    }

    /// Looks for a board in boot mode.
    #[must_use]
    pub fn find(&self, board: &Board) -> Found {
        let drives = self.mounted().into_iter();
        let drives: Vec<Drive> = drives.filter_map(|folder| drive_in(&folder).ok()).collect();
        let (mut own, other): (Vec<Drive>, Vec<Drive>) = drives
            .into_iter()
            .partition(|drive| drive.boot_id == board.boot_id);
        if own.len() > 1 {
            return Found::Several(own.into_iter().map(|drive| drive.folder).collect());
        }
        if let Some(drive) = own.pop() {
            return Found::Mounted(drive);
        }
        let device = self.labels.join(board.boot_id);
        if device.exists() {
            return Found::NotMounted(device);
        }
        if self.usb_devices().contains(&board.boot_usb) {
            return Found::NoDrive;
        }
        let mut other = other.into_iter();
        other.next().map_or(Found::Nothing, Found::OtherChip)
    }

    /// Vendors and products of the USB devices of this computer.
    #[must_use]
    pub fn usb_devices(&self) -> Vec<(u16, u16)> {
        let entries = fs::read_dir(&self.usb).into_iter().flatten().flatten();
        let id = |folder: &Path, name: &str| {
            let text = fs::read_to_string(folder.join(name)).ok()?;
            u16::from_str_radix(text.trim(), 16).ok()
        };
        entries
            .filter_map(|entry| {
                let folder = entry.path();
                Some((id(&folder, "idVendor")?, id(&folder, "idProduct")?))
            })
            .collect()
    }

    /// Boards in boot mode on the USB; of those with the same boot ROM the first one.
    #[must_use]
    pub fn boards_in_boot_mode(&self) -> Vec<&'static Board> {
        let devices = self.usb_devices();
        let is_there = |board: &&Board| devices.contains(&board.boot_usb);
        let mut boards: Vec<&Board> = BOARDS.iter().filter(is_there).collect();
        boards.dedup_by_key(|board| board.boot_id);
        boards
    }
}

/// The path of a table of mounts: special characters are octal numbers.
fn unescape(text: &str) -> PathBuf {
    let mut path = Vec::new();
    let mut rest = text.as_bytes();
    while let Some((&byte, after)) = rest.split_first() {
        let number = (byte == b'\\')
            .then(|| after.get(..3))
            .flatten()
            .and_then(|digits| std::str::from_utf8(digits).ok())
            .and_then(|digits| u8::from_str_radix(digits, 8).ok());
        match number {
            Some(number) => {
                path.push(number);
                rest = &after[3..];
            }
            None => {
                path.push(byte);
                rest = after;
            }
        }
    }
    PathBuf::from(String::from_utf8_lossy(&path).into_owned())
}

impl Drive {
    /// Checks that the drive is that of a board.
    ///
    /// # Errors
    /// It is the drive of another chip.
    pub fn check(&self, board: &Board) -> Result<(), Error> {
        if self.boot_id == board.boot_id {
            return Ok(());
        }
        let what = format!(
            "{}: the board in boot mode has the chip {}; {} ({}) has {}",
            self.folder.display(),
            self.boot_id,
            board.name,
            board.title,
            board.boot_id
        );
        Err(Error::new(ErrorKind::BadInput, what))
    }

    /// Whether the boot ROM still runs.
    #[must_use]
    pub fn is_there(&self) -> bool {
        self.folder.join(INFO).exists()
    }

    /// Copies an image onto the drive, and waits until the board has restarted.
    ///
    /// # Errors
    /// The drive cannot be written, or is still there after `wait`.
    pub fn write(&self, name: &str, image: &[u8], wait: Duration) -> Result<(), Error> {
        const POLL: Duration = Duration::from_millis(50);
        let target = self.folder.join(name);
        let end = Instant::now() + wait;
        let failed = |error: &io::Error| {
            let what = format!("{}: {error}", target.display());
            Error::new(ErrorKind::Output, what)
        };
        let mut file = File::create(&target).map_err(|error| failed(&error))?;
        // The boot ROM gets the file now, not when the system has time.
        let written = file.write_all(image).and_then(|()| file.sync_all());
        drop(file);
        // The board restarts with the last block, often before the system has closed the file.
        while self.is_there() {
            if let Err(error) = &written {
                return Err(failed(error));
            }
            if Instant::now() >= end {
                let what = format!(
                    "{}: the image was copied, but the board did not restart within {:.0} s; \
                     unplug it, start its boot mode again, and repeat",
                    self.folder.display(),
                    wait.as_secs_f64()
                );
                return Err(Error::new(ErrorKind::Output, what));
            }
            std::thread::sleep(POLL);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
