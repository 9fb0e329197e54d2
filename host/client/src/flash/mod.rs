//! Writes an image into the flash of a board: onto the drive of its boot ROM, or with a program.
//!
//! A boot ROM with a drive has a file `INFO_UF2.TXT` with the name of its chip. It writes the
//! blocks of a UF2 file into the flash as they arrive, restarts after the last one, and its drive
//! disappears.

mod board;
pub mod elf;
mod machine;
pub mod program;
pub mod uf2;

pub use board::{BOARDS, Board, BootRom, Chip, UsbPort, Writing};

use crate::{Error, ErrorKind};
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

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
    pub fn find(&self, boot_rom: &BootRom) -> Found {
        let drives = self.mounted().into_iter();
        let drives: Vec<Drive> = drives.filter_map(|folder| drive_in(&folder).ok()).collect();
        let (mut own, other): (Vec<Drive>, Vec<Drive>) = drives
            .into_iter()
            .partition(|drive| drive.boot_id == boot_rom.id);
        if own.len() > 1 {
            return Found::Several(own.into_iter().map(|drive| drive.folder).collect());
        }
        if let Some(drive) = own.pop() {
            return Found::Mounted(drive);
        }
        let device = self.labels.join(boot_rom.id);
        if device.exists() {
            return Found::NotMounted(device);
        }
        if self.usb_devices().contains(&boot_rom.usb) {
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
        let boot_roms = BOARDS.iter().map(|board| (board, board.boot_rom()));
        let is_there = |it: &BootRom| devices.contains(&it.usb);
        let mut found: Vec<_> = boot_roms
            .filter(|(_, boot_rom)| boot_rom.is_some_and(is_there))
            .collect();
        found.dedup_by_key(|(_, boot_rom)| boot_rom.map(|it| it.id));
        found.into_iter().map(|(board, _)| board).collect()
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
        let own = board.boot_rom().map_or("none", |boot_rom| boot_rom.id);
        if self.boot_id == own {
            return Ok(());
        }
        let what = format!(
            "{}: the board in boot mode has the chip {}; {} ({}) has {own}",
            self.folder.display(),
            self.boot_id,
            board.name,
            board.title
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
