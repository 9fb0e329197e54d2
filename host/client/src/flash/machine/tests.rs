//! Machines for the STM32F407.

use crate::flash::elf::tests::chip;
use crate::flash::{BOARDS, Board};
use haptimill_machine_file::MachineFile;

const MILL: &str = include_str!("../../../../../machines/mill3.toml");

fn problem(text: &str) -> Result<(), String> {
    let machine = MachineFile::parse("own.toml", text).unwrap_or_else(|it| panic!("{it}"));
    let checked = Board::named("stm32").unwrap().check_machine(&machine);
    checked.map_err(|error| error.message)
}

#[test]
fn machines_with_switches_or_encoders_fit() {
    assert_eq!(problem(MILL), Ok(()));
    // Four joints with encoders and index pulses fit; the fifth has a torque drive.
    let h4 = include_str!("../../../../../machines/h4-step.toml");
    let refused = "own.toml: joint alpha: the board has no torque drives (STM32F407 or STM32F427)";
    assert_eq!(problem(h4), Err(refused.to_string()));
    let limits = MILL.split("\n[plant]").next().unwrap().replacen(
        "home = \"switch\"\n",
        "home = \"switch\"\nlimit_high_active = \"low\"\n",
        1,
    );
    assert_eq!(problem(&limits), Ok(()));
}

#[test]
fn what_the_board_cannot_drive_is_refused() {
    let refused = |text: &str, what: &str| {
        let error = problem(text).unwrap_err();
        assert_eq!(error, format!("own.toml: {what} (STM32F407 or STM32F427)"));
    };
    let bench = include_str!("../../../../../machines/bench.toml");
    refused(
        bench,
        "joint x: ticks_per_us = 75, but the step clock of the board has 84; change it here and \
         below [plant]",
    );
    let mill = MILL.split("\n[plant]").next().unwrap();
    for change in [
        ("pulse_us = 2.5", "pulse_us = 2.25"),
        ("setup_us = 5.0", "setup_us = 5.25"),
    ] {
        let text = mill.replacen(change.0, change.1, 1);
        assert_ne!(text, mill);
        refused(
            &text,
            "joint x: pulse_us and setup_us of the board are multiples of 0.5; change them",
        );
    }
    let chip = "direction = 1\n\n[joint.drive.tmc2209]\naddress = 3\nmicrosteps = 16\n\
                run_current_a = 0.8\nhold_current_a = 0.4\n";
    let bench = bench.replace("ticks_per_us = 75", "ticks_per_us = 84");
    assert_eq!(problem(&bench), Ok(()));
    refused(
        &bench.replacen("direction = 1\n", chip, 1),
        "joint x: [joint.drive.tmc2209]: the board has no bus for these chips; set them by their \
         pins and remove the section, or take a board with the bus (pico2)",
    );
    refused(
        &mill.replacen("period_us = 200", "period_us = 250", 1),
        "period_us = 250, but an image of the board has a control period of 200 us; set it to one \
         of them",
    );
}

/// An image without a USB port is taken as it is, and no other image is one of this board.
#[test]
fn its_image_has_no_name_on_the_usb() {
    let board = Board::named("stm32").unwrap();
    assert_eq!(board.check_own(&[]), Ok(()));
    assert_eq!(Board::of_flash(&[0xFF; 100]), None);
    let machine = MachineFile::parse("own.toml", MILL).unwrap();
    assert_eq!(board.check_image(&machine, &[]), Ok(()));
    assert_eq!(BOARDS.iter().filter(|it| it.usb.is_none()).count(), 1);
}

/// Memories and step clock are those of the image.
#[test]
fn the_memories_and_the_step_clock_are_those_of_the_image() {
    let map = include_str!("../../../../../firmware/boards/stm32/memory.x");
    let memory = |name: &str| {
        let start = format!("  {name} ");
        let line = map.lines().find(|it| it.starts_with(&start)).unwrap();
        let (_, rest) = line.split_once("ORIGIN = 0x").unwrap();
        let (origin, length) = rest.split_once(", LENGTH = ").unwrap();
        let origin = u32::from_str_radix(origin, 16).unwrap();
        let unit = if length.ends_with('M') {
            1 << 20
        } else {
            1 << 10
        };
        let length = length.trim_end_matches(['M', 'K']).parse::<u32>().unwrap();
        origin..origin + length * unit
    };
    assert_eq!(chip().flash, memory("FLASH"));
    assert_eq!(chip().ram, [memory("STACK"), memory("RAM")]);
    let steps = include_str!("../../../../../firmware/boards/stm32/src/steps.rs");
    let (_, ticks) = Board::named("stm32").unwrap().step_drives;
    assert!(steps.contains(&format!("const TICKS_PER_US: u32 = {ticks};")));
}
