//! Boards whose images this computer writes: how, what each of them can drive, and its images.

use super::{elf, uf2};
use crate::{Error, ErrorKind};
use haptimill_firmware::config::{ChipKind, JointSettings};
use haptimill_machine_file::{MachineFile, input};
use std::fmt;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Largest file of an image: 16 MiB of flash as UF2 blocks, or an ELF file with names.
const MAX: u64 = 32 << 20;

/// A board with one of its images: another wiring is another board.
#[derive(Debug, PartialEq, Eq)]
pub struct Board {
    /// Name on the command line.
    pub name: &'static str,
    /// Its name.
    pub title: &'static str,
    /// How its flash is written.
    pub writing: Writing,
    /// USB port of its image.
    pub usb: Option<UsbPort>,
    /// Image that the source tree makes.
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
    /// Widths and set-up times of pulses are multiples of this, ticks.
    pub slot_ticks: u16,
    /// Joints from the first on that may have an encoder.
    pub encoders: usize,
    /// It has inputs for the index pulses of its encoders.
    pub has_index_pulses: bool,
    /// It reads limit switches.
    pub has_limit_switches: bool,
    /// Kind of the chips of the drives at its bus, if it has one.
    pub chips: Option<ChipKind>,
    /// Largest rate of a joint, steps/s.
    pub step_rate: u32,
    /// Control periods that an image can have, us.
    pub periods: &'static [u16],
    /// Digital inputs and outputs: their channels count from 0. It has no analog ones.
    pub digital: (u8, u8),
}

/// How the flash of a board is written.
#[derive(Debug, PartialEq, Eq)]
pub enum Writing {
    /// A UF2 file is copied onto the drive of its boot ROM.
    Drive(BootRom),
    /// A program writes the segments of an ELF file.
    Program(Chip),
}

/// A boot ROM that appears as a drive.
#[derive(Debug, PartialEq, Eq)]
pub struct BootRom {
    /// Its `Board-ID`, which is the label of its drive, too.
    pub id: &'static str,
    /// Its USB ids: vendor and product.
    pub usb: (u16, u16),
    /// Family of its chip in UF2 files.
    pub family: u32,
    /// How it is started.
    pub start: &'static str,
}

/// A chip whose flash a program writes.
#[derive(Debug, PartialEq, Eq)]
pub struct Chip {
    /// Its name for `probe-rs`.
    pub name: &'static str,
    /// USB ids of its boot ROM for `dfu-util`: vendor and product.
    pub dfu: (u16, u16),
    /// Addresses of its flash. The vector table is at the first one.
    pub flash: Range<u32>,
    /// Addresses of its memories in which the stack can be.
    pub ram: [Range<u32>; 2],
}

/// The USB port of an image.
#[derive(Debug, PartialEq, Eq)]
pub struct UsbPort {
    /// Its ids: vendor and product. Other devices have them, too.
    pub ids: (u16, u16),
    /// Name of the product.
    pub product: &'static str,
}

/// All boards whose images this computer writes.
pub const BOARDS: &[Board] = &[PICO2, PICO2_ENCODERS, PICO2_SPI, STM32];

const PICO2: Board = Board {
    name: "pico2",
    title: "Raspberry Pi Pico 2",
    writing: Writing::Drive(BootRom {
        id: "RP2350",
        usb: (0x2E8A, 0x000F),
        family: 0xE48B_FF59,
        start: "hold the button BOOTSEL while you plug the board in",
    }),
    usb: Some(UsbPort {
        ids: PICO2_USB,
        product: "Haptimill Pico 2",
    }),
    image: "firmware/boards/pico2/target/thumbv8m.main-none-eabihf/release/haptimill-pico2.uf2",
    make: "cargo xtask board pico2 --uf2",
    baud: 1_000_000,
    line: "its USB port, or, with the image for the UART, GP0 and GP1 at a serial converter",
    step_drives: (5, 75),
    slot_ticks: 1,
    encoders: 0,
    has_index_pulses: false,
    has_limit_switches: false,
    chips: Some(ChipKind::Tmc2209),
    step_rate: 1_000_000,
    periods: &[200, 250, 320, 400, 500],
    digital: (2, 1),
};

const PICO2_USB: (u16, u16) = (0x2E8A, 0x0009);

/// The Pico 2 with encoders and shift registers.
const PICO2_ENCODERS: Board = Board {
    name: "pico2-encoders",
    title: "Raspberry Pi Pico 2 with encoders",
    usb: Some(UsbPort {
        ids: PICO2_USB,
        product: "Haptimill encoder Pico 2",
    }),
    image: "firmware/boards/pico2/target/thumbv8m.main-none-eabihf/release/haptimill-pico2-encoders.uf2",
    make: "cargo xtask board pico2 --encoders",
    line: "its USB port",
    encoders: 4,
    has_limit_switches: true,
    chips: None,
    digital: (4, 7),
    ..PICO2
};

/// The Pico 2 with TMC5160 at its SPI, which has the pins of a digital input, of the digital output
/// and of the alarm.
const PICO2_SPI: Board = Board {
    name: "pico2-spi",
    title: "Raspberry Pi Pico 2 with SPI",
    usb: Some(UsbPort {
        ids: PICO2_USB,
        product: "Haptimill SPI Pico 2",
    }),
    image: "firmware/boards/pico2/target/thumbv8m.main-none-eabihf/release/haptimill-pico2-spi.uf2",
    make: "cargo xtask board pico2 --spi",
    line: "its USB port",
    chips: Some(ChipKind::Tmc5160),
    digital: (1, 0),
    ..PICO2
};

const STM32: Board = Board {
    name: "stm32",
    title: "STM32F407 or STM32F427",
    writing: Writing::Program(Chip {
        name: "STM32F407VG",
        dfu: (0x0483, 0xDF11),
        flash: 0x0800_0000..0x0810_0000,
        ram: [0x1000_0000..0x1001_0000, 0x2000_0000..0x2002_0000],
    }),
    usb: None,
    image: "firmware/boards/stm32/target/thumbv7em-none-eabihf/release/haptimill-stm32",
    make: "cargo xtask board stm32",
    baud: 1_000_000,
    line: "PD8 and PD9 at a serial converter",
    step_drives: (5, 84),
    // 0.5 us.
    slot_ticks: 42,
    encoders: 4,
    has_index_pulses: true,
    has_limit_switches: true,
    chips: None,
    step_rate: 1_000_000,
    periods: &[200],
    digital: (2, 1),
};

impl Chip {
    /// The contents of its flash from an ELF file ([`elf::read`]).
    ///
    /// # Errors
    /// The file is no image for this chip.
    pub fn contents(&self, file: &[u8]) -> Result<Vec<u8>, String> {
        elf::read(file, &self.flash, &self.ram)
    }
}

impl Board {
    /// Finds a board by name.
    #[must_use]
    pub fn named(name: &str) -> Option<&'static Self> {
        BOARDS.iter().find(|board| board.name == name)
    }

    /// The image of a Pico 2 for a machine: the one with encoders if a joint has one, or needs
    /// limit switches; the one with SPI if a joint has a chip for it.
    #[must_use]
    pub fn of_machine(machine: &MachineFile) -> &'static Self {
        let joints = &machine.config.joints;
        let is_of_spi = |joint: &JointSettings| {
            let chip = joint.chip();
            chip.is_some_and(|chip| chip.kind == ChipKind::Tmc5160)
        };
        if joints
            .iter()
            .any(|joint| joint.encoder.is_some() || joint.needs_limit_switches())
        {
            &PICO2_ENCODERS
        } else if joints.iter().any(is_of_spi) {
            &PICO2_SPI
        } else {
            &PICO2
        }
    }

    /// The board whose name on the USB is in these contents of the flash.
    #[must_use]
    pub fn of_flash(flash: &[u8]) -> Option<&'static Self> {
        let has = |name: &str| flash.windows(name.len()).any(|at| at == name.as_bytes());
        let is_own = |board: &&Self| board.usb.as_ref().is_some_and(|usb| has(usb.product));
        BOARDS.iter().find(is_own)
    }

    /// Its boot ROM, if that appears as a drive.
    #[must_use]
    pub const fn boot_rom(&self) -> Option<&BootRom> {
        match &self.writing {
            Writing::Drive(boot_rom) => Some(boot_rom),
            Writing::Program(_) => None,
        }
    }

    /// The board of an image, by its name on the USB; an image for another line has none.
    pub(super) fn of_image(&self, image: &[u8]) -> Option<&'static Self> {
        let boot_rom = self.boot_rom()?;
        let pieces = uf2::read(image, boot_rom.family).unwrap_or_default();
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
            // Only this board has an image for another line.
            None if self.usb.is_some() && *self != PICO2 => format!(
                "the image has no USB port, or is not that of {} ({}); make it with `{}`",
                self.name, self.title, self.make
            ),
            _ => return Ok(()),
        };
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
                    "{} is missing; make it with `{}` in the source tree, or give a file with --image",
                    self.image, self.make
                );
                Error::new(ErrorKind::BadInput, what)
            })
    }

    /// Reads an image, and checks that it is a whole one for this board.
    ///
    /// # Errors
    /// The file cannot be read, is no UF2 file or ELF file, is damaged, or for another chip.
    pub fn read_image(&self, path: &Path) -> Result<Vec<u8>, Error> {
        let bad = |what: &dyn fmt::Display| {
            Error::new(ErrorKind::BadInput, format!("{} {what}", path.display()))
        };
        let bytes = input::read(path, MAX).map_err(|error| bad(&error))?;
        match &self.writing {
            Writing::Drive(boot_rom) => {
                uf2::read(&bytes, boot_rom.family).map_err(|what| bad(&what))?;
            }
            Writing::Program(chip) => {
                let failed = |what| bad(&format_args!("{what}; make it with `{}`", self.make));
                chip.contents(&bytes).map_err(failed)?;
            }
        }
        Ok(bytes)
    }
}
