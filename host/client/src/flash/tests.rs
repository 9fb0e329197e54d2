//! Boards in boot mode, as folders of a test.

use super::{BOARDS, Board, Drive, Found, Places, drive_in, unescape};
use crate::ErrorKind;
use haptimill_machine_file::MachineFile;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

const INFO: &str = "UF2 Bootloader v1.0\nModel: Raspberry Pi RP2350\nBoard-ID: RP2350\n";
const OTHER: &str = "UF2 Bootloader v3.0\nModel: Raspberry Pi RP2\nBoard-ID: RPI-RP2\n";

struct Computer {
    folder: tempfile::TempDir,
    mounts: String,
}

impl Computer {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        for name in ["labels", "usb"] {
            fs::create_dir(folder.path().join(name)).unwrap();
        }
        Self {
            folder,
            mounts: "proc /proc proc rw 0 0\n".to_string(),
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Mounts a drive with this information of a boot ROM.
    fn mount(&mut self, name: &str, kind: &str, info: &str) -> PathBuf {
        let folder = self.path(name);
        fs::create_dir(&folder).unwrap();
        fs::write(folder.join("INFO_UF2.TXT"), info).unwrap();
        let text = folder.display().to_string().replace(' ', "\\040");
        self.mounts += &format!("/dev/sdx1 {text} {kind} rw,nosuid 0 0\n");
        folder
    }

    fn plug(&self, vendor: &str, product: &str) {
        let folder = self.path("usb").join("1-1");
        fs::create_dir(&folder).unwrap();
        fs::write(folder.join("idVendor"), format!("{vendor}\n")).unwrap();
        fs::write(folder.join("idProduct"), format!("{product}\n")).unwrap();
    }

    fn places(&self) -> Places {
        fs::write(self.path("mounts"), &self.mounts).unwrap();
        Places {
            mounts: self.path("mounts"),
            labels: self.path("labels"),
            usb: self.path("usb"),
        }
    }

    fn find(&self) -> Found {
        self.places().find(BOARDS[0].boot_rom().unwrap())
    }
}

fn drive(folder: &Path) -> Drive {
    drive_in(folder).unwrap()
}

#[test]
fn a_mounted_drive_is_found_also_with_a_space_in_its_path() {
    let mut computer = Computer::new();
    assert_eq!(computer.find(), Found::Nothing);
    let folder = computer.mount("my drive", "vfat", INFO);
    assert_eq!(computer.find(), Found::Mounted(drive(&folder)));
    let second = computer.mount("second", "vfat", INFO);
    assert_eq!(computer.find(), Found::Several(vec![folder, second]));
}

#[test]
fn only_file_systems_of_boot_roms_are_read() {
    let mut computer = Computer::new();
    computer.mount("remote", "nfs", INFO);
    assert_eq!(computer.find(), Found::Nothing);
}

#[test]
fn another_chip_is_told_apart() {
    let mut computer = Computer::new();
    let folder = computer.mount("other", "vfat", OTHER);
    let found = computer.find();
    assert_eq!(found, Found::OtherChip(drive(&folder)));
    let error = drive(&folder).check(&BOARDS[0]).unwrap_err();
    assert_eq!(error.kind, ErrorKind::BadInput);
    assert!(error.message.contains("has the chip RPI-RP2"), "{error:?}");
    let own = computer.mount("own", "vfat", INFO);
    assert_eq!(computer.find(), Found::Mounted(drive(&own)));
}

#[test]
fn an_unmounted_drive_and_a_board_without_a_drive_are_told_apart() {
    let computer = Computer::new();
    computer.plug("1d6b", "0002");
    assert_eq!(computer.find(), Found::Nothing);
    assert!(computer.places().boards_in_boot_mode().is_empty());
    let computer = Computer::new();
    computer.plug("2e8a", "000f");
    assert_eq!(computer.find(), Found::NoDrive);
    assert_eq!(computer.places().boards_in_boot_mode(), [&BOARDS[0]]);
    let device = computer.path("labels").join("RP2350");
    fs::write(&device, "").unwrap();
    assert_eq!(computer.find(), Found::NotMounted(device));
}

#[test]
fn a_folder_that_is_no_drive_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let error = drive_in(folder.path()).unwrap_err();
    assert!(error.message.contains("is not the drive of a board"));
    fs::write(folder.path().join("INFO_UF2.TXT"), "nothing").unwrap();
    let error = drive_in(folder.path()).unwrap_err();
    assert!(error.message.contains("names no board"), "{error:?}");
}

#[test]
fn octal_numbers_of_paths_are_decoded() {
    assert_eq!(unescape("/a\\040b\\134c"), PathBuf::from("/a b\\c"));
    assert_eq!(unescape("/a\\9"), PathBuf::from("/a\\9"));
    assert_eq!(unescape("/a\\"), PathBuf::from("/a\\"));
}

#[test]
fn a_board_that_does_not_restart_is_an_error() {
    let mut computer = Computer::new();
    let folder = computer.mount("drive", "vfat", INFO);
    let error = drive(&folder)
        .write("image.uf2", b"image", Duration::from_millis(100))
        .unwrap_err();
    assert_eq!(error.kind, ErrorKind::Output);
    assert!(error.message.contains("did not restart"), "{error:?}");
    assert_eq!(fs::read(folder.join("image.uf2")).unwrap(), b"image");
}

/// The board restarts with the last block: what the system reports of the drive then is no error.
#[cfg(target_os = "linux")]
#[test]
fn a_drive_that_cannot_be_written_is_an_error_and_one_that_is_gone_is_none() {
    let mut computer = Computer::new();
    let folder = computer.mount("drive", "vfat", INFO);
    let drive = drive(&folder);
    // Writes to it fail.
    std::os::unix::fs::symlink("/dev/full", folder.join("image.uf2")).unwrap();
    let write = || drive.write("image.uf2", b"image", Duration::ZERO);
    assert_eq!(write().unwrap_err().kind, ErrorKind::Output);
    fs::remove_file(folder.join("INFO_UF2.TXT")).unwrap();
    write().unwrap();
    // A board that was unplugged before the copy has no image.
    fs::remove_dir_all(&folder).unwrap();
    assert_eq!(write().unwrap_err().kind, ErrorKind::Output);
}

/// What a board cannot drive is said with the file, the joint and the remedy.
#[test]
fn a_machine_file_for_another_board_is_refused() {
    let problem = |text: &str| {
        let machine = MachineFile::parse("own.toml", text).unwrap();
        let checked = BOARDS[0].check_machine(&machine);
        checked.map_err(|error| {
            assert_eq!(error.kind, ErrorKind::BadInput);
            error.message
        })
    };
    let mill = include_str!("../../../../machines/mill3.toml");
    let clock = problem(mill).unwrap_err();
    assert!(
        clock.starts_with("own.toml: joint x: ticks_per_us = 84"),
        "{clock}"
    );
    assert_eq!(
        problem(&mill.replace("ticks_per_us = 84", "ticks_per_us = 75")),
        Ok(())
    );
    // This board does not read limit switches.
    let mill = mill.replace("ticks_per_us = 84", "ticks_per_us = 75");
    // Without the simulated machine, whose switches would be others.
    let mill = mill.split("\n[plant]").next().unwrap();
    for (from, to) in [
        (
            "[joint.switch]\n",
            "[joint.switch]\ninput = \"limit_low\"\n",
        ),
        (
            "home = \"switch\"\n",
            "home = \"switch\"\nlimit_high_active = \"low\"\n",
        ),
    ] {
        let limits = problem(&mill.replacen(from, to, 1)).unwrap_err();
        assert!(
            limits.contains("joint x: the board has no inputs for limit switches"),
            "{limits}"
        );
    }
    let h4 = include_str!("../../../../machines/h4.toml");
    assert!(problem(h4).unwrap_err().contains("no torque drives"));
}

/// What the board does not have is said with the key and the remedy.
#[test]
fn a_machine_file_with_parts_that_the_board_lacks_is_refused() {
    let mill = include_str!("../../../../machines/mill3.toml");
    let mill = mill.replace("ticks_per_us = 84", "ticks_per_us = 75");
    let mill = mill.split("\n[plant]").next().unwrap();
    let problem = |text: &str| {
        let machine = MachineFile::parse("own.toml", text).unwrap_or_else(|it| panic!("{it}"));
        let checked = BOARDS[0].check_machine(&machine);
        checked.map_err(|error| error.message)
    };
    assert_eq!(problem(mill), Ok(()));
    let input = |channel: u8| {
        format!(
            "{mill}\n[[input]]\nname = \"probe\"\nfunction = \"probe\"\nchannel = {channel}\n\
             active = \"high\"\ncontact = \"fault\"\n"
        )
    };
    assert_eq!(problem(&input(1)), Ok(()));
    assert_eq!(
        problem(&input(2)).unwrap_err(),
        "own.toml: input probe: channel = 2, but the digital inputs of the board have channel 0 \
         and 1; use one of them, or remove it (Raspberry Pi Pico 2)"
    );
    let output = |channel: u8| {
        format!(
            "{mill}\n[[output]]\nname = \"air\"\nfunction = \"general\"\nchannel = {channel}\n\
             active = \"high\"\nsafe = \"off\"\nwithout_host = \"safe\"\n"
        )
    };
    assert_eq!(problem(&output(0)), Ok(()));
    let outputs = problem(&output(1)).unwrap_err();
    assert!(
        outputs.contains("output air: channel = 1, but the digital outputs"),
        "{outputs}"
    );
    let analog =
        "[[analog_input]]\nname = \"load\"\nchannel = 0\nunit = \"V\"\nfull_scale = 10.0\n";
    let analog = problem(&format!("{mill}\n{analog}")).unwrap_err();
    assert!(
        analog.contains("[[analog_input]] load: the board has no analog inputs"),
        "{analog}"
    );
    // 640 steps/mm at 50 mm/s are 32,000 steps/s; 32 times as many are too fast.
    let fine = mill.replacen("steps_per_turn = 3200", "steps_per_turn = 102400", 1);
    let fine = fine.replacen("pulse_us = 2.5", "pulse_us = 0.2", 1);
    let rate = problem(&fine).unwrap_err();
    assert!(
        rate.starts_with(
            "own.toml: joint x: its rate is 1024000 steps/s, but a joint of the board"
        ),
        "{rate}"
    );
    let period = problem(&mill.replacen("period_us = 200", "period_us = 1000", 1)).unwrap_err();
    assert!(
        period
            .contains("period_us = 1000, but an image of the board has a control period of 200, "),
        "{period}"
    );
}

/// The image with encoders is a board of its own: it has encoders, limit switches and more inputs,
/// and no index pulses and no bus for the chips of the drives.
#[test]
fn a_machine_with_encoders_needs_the_image_with_encoders() {
    let [plain, encoders, ..] = BOARDS else {
        panic!()
    };
    let parse =
        |text: &str| MachineFile::parse("own.toml", text).unwrap_or_else(|it| panic!("{it}"));
    let problem = |board: &Board, text: &str| {
        let checked = board.check_machine(&parse(text));
        checked.map_err(|error| error.message)
    };
    let mill = include_str!("../../../../machines/mill3.toml");
    let mill = mill.replace("ticks_per_us = 84", "ticks_per_us = 75");
    let mill = mill.split("\n[plant]").next().unwrap();
    assert_eq!(Board::of_machine(&parse(mill)), plain);
    assert_eq!(problem(encoders, mill), Ok(()), "an encoder is no must");
    let with_encoder = mill
        .replacen(
            "lead_mm = 5.0\n",
            "lead_mm = 5.0\ncounts_per_turn = 4000\nfollowing_error_mm = 0.3\n\
             following_error_lag_ms = 10\nencoder_stuck_mm = 0.2\nindex_mm = 0.5\n\
             search_mm = 1.0\n",
            1,
        )
        .replacen("direction = 1\n", "direction = 1\nlost_mm = 0.1\n", 1)
        .replacen(
            "missed_periods = ",
            "illegal_transitions = 20\nmissed_periods = ",
            1,
        );
    assert_eq!(Board::of_machine(&parse(&with_encoder)), encoders);
    assert_eq!(problem(encoders, &with_encoder), Ok(()));
    let refused = problem(plain, &with_encoder).unwrap_err();
    assert!(
        refused.contains("joint x: the board has no encoder inputs; remove its encoder, or take"),
        "{refused}"
    );
    let limits = mill.replacen(
        "home = \"switch\"\n",
        "home = \"switch\"\nlimit_high_active = \"low\"\n",
        1,
    );
    assert_eq!(Board::of_machine(&parse(&limits)), encoders);
    assert_eq!(problem(encoders, &limits), Ok(()));
    let index = with_encoder.replacen("home = \"switch\"\n", "home = \"switch_and_index\"\n", 1);
    assert_eq!(
        problem(encoders, &index).unwrap_err(),
        "own.toml: joint x: home = \"switch_and_index\", but the board has no inputs for index \
         pulses; set home = \"switch\" with [joint.switch], or home = \"none\" (Raspberry Pi Pico 2 \
         with encoders)"
    );
    let bench = include_str!("../../../../machines/bench.toml");
    let chip = "direction = 1\n\n[joint.drive.tmc2209]\naddress = 3\nmicrosteps = 16\n\
                run_current_a = 0.8\nhold_current_a = 0.4\n";
    let chips = problem(encoders, &bench.replacen("direction = 1\n", chip, 1)).unwrap_err();
    assert!(
        chips.contains("joint x: [joint.drive.tmc2209]: the board has no bus for these chips"),
        "{chips}"
    );
    let input = format!(
        "{mill}\n[[input]]\nname = \"probe\"\nfunction = \"probe\"\nchannel = 4\n\
         active = \"high\"\ncontact = \"fault\"\n"
    );
    let input = problem(encoders, &input).unwrap_err();
    assert!(input.contains("have channel 0 to 3; use one"), "{input}");
}

/// An image has the name of its board on the USB; only the image for the UART has none.
#[test]
fn an_image_of_another_board_is_refused() {
    let [plain, encoders, spi, _] = BOARDS else {
        panic!()
    };
    let image = |board: &Board| {
        let mut flash = vec![0xFF; 250];
        flash.extend(board.usb.as_ref().unwrap().product.as_bytes());
        uf2(&flash)
    };
    for board in [plain, encoders, spi] {
        assert_eq!(board.check_own(&image(board)), Ok(()));
    }
    assert_eq!(plain.check_own(&uf2(&[0xFF; 600])), Ok(()), "the UART");
    let refused = |board: &Board, image: &[u8]| board.check_own(image).unwrap_err().message;
    let other = refused(plain, &image(encoders));
    assert!(
        other.contains("the image is that of pico2-encoders"),
        "{other}"
    );
    let other = refused(encoders, &image(plain));
    assert!(other.contains("the image is that of pico2 ("), "{other}");
    let other = refused(plain, &image(spi));
    assert!(other.contains("the image is that of pico2-spi"), "{other}");
    for (board, make) in [(encoders, "--encoders"), (spi, "--spi")] {
        let none = refused(board, &uf2(&[0xFF; 600]));
        let make = format!("make it with `cargo xtask board pico2 {make}`");
        assert!(none.contains(&make), "{none}");
    }
}

/// The control periods of the board are those for which its image can be built.
#[test]
fn the_control_periods_are_those_of_the_image() {
    let script = include_str!("../../../../firmware/boards/pico2/build.rs");
    let line = script.lines().find(|it| it.starts_with("const PERIODS"));
    let (_, list) = line.and_then(|it| it.split_once(" = ")).unwrap();
    let periods: Vec<u16> = list
        .split('"')
        .filter_map(|word| word.parse().ok())
        .collect();
    assert_eq!(periods, BOARDS[0].periods);
}

/// A UF2 file with these contents of the flash.
fn uf2(flash: &[u8]) -> Vec<u8> {
    let pieces: Vec<&[u8]> = flash.chunks(256).collect();
    let mut file = Vec::new();
    for (number, piece) in pieces.iter().enumerate() {
        let mut block = [0; 512];
        let words = [
            0x0A32_4655,
            0x9E5D_5157,
            0x2000,
            0x1000_0000 + 256 * number as u32,
            piece.len() as u32,
            number as u32,
            pieces.len() as u32,
            BOARDS[0].boot_rom().unwrap().family,
        ];
        for (at, word) in words.into_iter().enumerate() {
            block[4 * at..4 * at + 4].copy_from_slice(&word.to_le_bytes());
        }
        block[32..32 + piece.len()].copy_from_slice(piece);
        block[508..].copy_from_slice(&0x0AB1_6F30_u32.to_le_bytes());
        file.extend(block);
    }
    file
}

/// The bus of the chips is at the pins of the UART, so the image whose line is the UART has none.
#[test]
fn a_machine_file_with_chips_needs_the_image_with_the_usb() {
    let bench = include_str!("../../../../machines/bench.toml");
    let chip = "direction = 1\n\n[joint.drive.tmc2209]\naddress = 3\nmicrosteps = 16\n\
                run_current_a = 0.8\nhold_current_a = 0.4\n";
    let parse =
        |text: &str| MachineFile::parse("own.toml", text).unwrap_or_else(|it| panic!("{it}"));
    let plain = parse(bench);
    let chips = parse(&bench.replacen("direction = 1\n", chip, 1));
    let board = &BOARDS[0];
    assert!(board.check_machine(&chips).is_ok());
    // The name of the product crosses the end of a block.
    let mut flash = vec![0xFF; 250];
    flash.extend(b"Haptimill Pico 2");
    let (usb, uart) = (uf2(&flash), uf2(&[0xFF; 600]));
    assert_eq!(board.check_image(&chips, &usb), Ok(()));
    for image in [&usb, &uart] {
        assert_eq!(board.check_image(&plain, image), Ok(()));
    }
    let refused = board.check_image(&chips, &uart).unwrap_err();
    assert_eq!(refused.kind, ErrorKind::BadInput);
    assert_eq!(
        refused.message,
        "own.toml: joint x: [joint.drive.tmc2209]: the image has its line to the host at the pins \
         of the bus of these chips; take the image with the USB, or remove the section \
         (Raspberry Pi Pico 2)"
    );
}

/// The image with SPI is a board of its own: it has the bus of the TMC5160, a digital input less,
/// and no digital output.
#[test]
fn a_machine_file_with_a_chain_needs_the_image_with_spi() {
    let [plain, encoders, spi, _] = BOARDS else {
        panic!()
    };
    let bench = include_str!("../../../../machines/bench.toml");
    let parse =
        |text: &str| MachineFile::parse("own.toml", text).unwrap_or_else(|it| panic!("{it}"));
    let with = |chip: &str| {
        let section = format!(
            "direction = 1\n\n[joint.drive.{chip} = 0\nmicrosteps = 16\n\
             run_current_a = 0.8\nhold_current_a = 0.4\n"
        );
        parse(&bench.replacen("direction = 1\n", &section, 1))
    };
    let (uart, chain) = (with("tmc2209]\naddress"), with("tmc5160]\nposition"));
    assert_eq!(Board::of_machine(&chain), spi);
    assert_eq!(Board::of_machine(&uart), plain);
    assert_eq!(Board::of_machine(&parse(bench)), plain);
    assert_eq!(spi.check_machine(&chain), Ok(()));
    assert_eq!(spi.check_machine(&parse(bench)), Ok(()));
    let refused =
        |board: &Board, machine: &MachineFile| board.check_machine(machine).unwrap_err().message;
    for (board, machine, section, other) in [
        (plain, &chain, "tmc5160", "pico2-spi"),
        (encoders, &chain, "tmc5160", "pico2-spi"),
        (spi, &uart, "tmc2209", "pico2"),
    ] {
        assert_eq!(
            refused(board, machine),
            format!(
                "own.toml: joint x: [joint.drive.{section}]: the board has no bus for these chips; \
                 set them by their pins and remove the section, or take a board with the bus \
                 ({other}) ({})",
                board.title
            )
        );
    }
    let with_output = parse(&format!(
        "{}\n[[output]]\nname = \"mist\"\nfunction = \"mist\"\nchannel = 0\nsafe = \"off\"\nwithout_host = \"safe\"\n",
        bench.split("\n[plant]").next().unwrap()
    ));
    assert_eq!(plain.check_machine(&with_output), Ok(()));
    let output = refused(spi, &with_output);
    assert!(
        output.contains("output mist: the board has no digital outputs; remove it, or take"),
        "{output}"
    );
}
