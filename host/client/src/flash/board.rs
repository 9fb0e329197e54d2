//! Boards that take UF2 files: what each of them can drive, and its images.

use super::uf2;
use crate::{Error, ErrorKind};
use haptimill_firmware::config::{Drive as JointDrive, Home};
use haptimill_machine_file::model::Model;
use haptimill_machine_file::scale::{PER_COUNT, per_unit};
use haptimill_machine_file::{MachineFile, input};
use std::fmt;
use std::path::{Path, PathBuf};

/// Largest UF2 file: 16 MiB of flash.
const MAX: u64 = 32 << 20;

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
