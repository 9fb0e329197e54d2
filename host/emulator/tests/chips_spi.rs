//! Chips of the drives at SPI1: the image with SPI sets the TMC5160 of a machine file over its pins
//! before it switches the drives on, watches them, and stops the machine when one of them fails or
//! a wire of their chain breaks.

mod common;

use common::chips::{
    alarms, assert_heat_ends_safe, assert_no_bus, move_by_one_millimetre, only, until_off,
    with_chips, with_sections,
};
use common::table::{assert_is_set, table};
use common::{bench, board, board_with, mill, session, spi_image, steps};
use haptimill_emulator::pico2::Pico2;
use haptimill_hil_sim::tmc5160::{CHOPCONF, Cut, GSTAT};
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::{Alarms, Command, DriveAlarm, Fault};

const PAGE: &str = include_str!("../../../docs/hardware/pico2.md");

/// Registers of functions, pads and outputs of the pins (RP2350 datasheet, 9.11, 9.8, 3.1.11), and
/// the function of an SPI.
const IO_BANK0: u32 = 0x4002_8000;
const PADS_BANK0: u32 = 0x4003_8000;
const SIO_OUTPUT_ENABLE: u32 = 0xD000_0030;
const SPI: u32 = 1;
const SOFTWARE: u32 = 5;

/// Chip select, and clock and data of SPI1.
const CHIP_SELECT: u32 = 1;
const SPI_PINS: [u32; 3] = [26, 27, 28];

/// Positions and currents of the chips of joints x, y and z.
const CHIPS: [(u8, f64, f64); 3] = [(2, 1.5, 0.7), (0, 2.4, 1.2), (1, 0.5, 0.1)];

/// Sense resistors, ohm.
const SENSE: f64 = 0.075;

/// A machine of three step drives that have these chips.
fn with_chain(machine: &MachineFile) -> MachineFile {
    let sections = CHIPS.map(|(position, run, hold)| {
        format!(
            "[joint.drive.tmc5160]\nposition = {position}\nmicrosteps = 16\n\
             run_current_a = {run}\nhold_current_a = {hold}\n"
        )
    });
    with_sections(machine, &sections)
}

fn spi_board(machine: &MachineFile) -> Pico2 {
    board_with(&spi_image(), machine)
}

fn functions(board: &mut Pico2) -> [u32; 3] {
    SPI_PINS.map(|pin| board.chip().register(IO_BANK0 + 4 + 8 * pin) & 0x1F)
}

/// The chips have the settings of the machine file: currents up to those of the file, less than a
/// step of the scaler below the run current, and less than a step of the run current below the hold
/// current.
fn assert_set(board: &mut Pico2) {
    for (joint, (_, run, hold)) in CHIPS.into_iter().enumerate() {
        let chip = board.chain_chip(joint);
        assert_eq!(chip.microsteps(), 16, "joint {joint}");
        let [set_run, set_hold] = chip.currents(SENSE);
        let all = format!("joint {joint}: {set_run} {set_hold}");
        assert!(set_run <= run + 1e-9 && set_run > run - 0.013, "{all}");
        assert!(set_hold <= hold + 1e-9, "{all}");
        assert!(set_hold > hold - set_run / 32.0 - 1e-3, "{all}");
        assert_eq!(chip.register(GSTAT), 0, "joint {joint}");
    }
}

/// The alarms of a chain that is interrupted behind the chip of a joint.
fn interrupted(joint: usize) -> Alarms {
    let unreachable = Some(DriveAlarm::Unreachable);
    (0..3)
        .filter(|other| *other != joint)
        .fold(only(joint, DriveAlarm::Silent), |all, other| {
            all.with(other, unreachable)
        })
}

/// Without chips in the machine file the pins stay free; with them they are set before the enable
/// line rises for the first time, and the machine moves as with other drives.
#[test]
fn the_image_configures_the_chain_of_a_machine_file() {
    let plain = bench();
    let machine = with_chain(&plain);
    let mut session = session(spi_board(&machine), &plain);
    let free = functions(session.line_mut());
    assert!(!free.contains(&SPI), "{free:?}");
    assert_eq!(session.line_mut().chip_chain().transfers, 0);
    for joint in 0..3 {
        let chopper = session.line_mut().chain_chip(joint).register(CHOPCONF);
        assert_eq!(chopper & 0xF, 0, "the power stage is off");
    }
    let before = session.line_mut().cycles();
    session
        .configure(&machine)
        .expect("the board accepts the file");
    session.set_machine(&machine);
    // The first request comes too early, and is repeated.
    session
        .ask(Command::Enable)
        .expect("the drives are ready in time");
    let board = session.line_mut();
    assert!(board.is_enabled());
    assert_set(board);
    assert_eq!(functions(board), [SPI; 3]);
    let rise = board.lines.enable.changes[0] as f64 / 1e15;
    let start = before as f64 / 150e6;
    println!("drives on {:.3} s after the machine file", rise - start);
    assert!(rise - start < 0.3, "{rise} {start}");

    let chain = session.line_mut().chip_chain();
    let (transfers, mode_errors) = (chain.transfers, chain.mode_errors);
    move_by_one_millimetre(&mut session, &machine);
    let chain = session.line_mut().chip_chain();
    let asked = chain.transfers - transfers;
    println!("{asked} transfers in the move");
    assert!(asked > 0, "the chips are asked meanwhile");
    assert_eq!(chain.mode_errors, mode_errors);
}

/// A chip without its supply keeps the drives off. Its joint and its position are named, although
/// no chip of the chain can be reached. With its supply all are configured, and the drives go on.
#[test]
fn a_chip_without_supply_keeps_the_drives_off_and_is_named() {
    let machine = with_chain(&bench());
    let mut board = spi_board(&machine);
    board.chain_chip(2).set_powered(false);
    let mut session = session(board, &machine);
    let refused = session.enable().expect_err("a chip is silent");
    assert!(
        refused.message.contains(
            "the drive of z is not ready: its driver chip (position 1) does not answer; check the \
             supply of the motors"
        ),
        "{refused:?}"
    );
    assert_eq!(alarms(&mut session), interrupted(2));
    let board = session.line_mut();
    assert!(!board.is_enabled());
    assert!(board.lines.enable.changes.is_empty(), "it never rose");
    board.chain_chip(2).set_powered(true);
    session.enable().expect("the drives are ready");
    let board = session.line_mut();
    assert!(board.is_enabled());
    assert_set(board);
}

/// See [`assert_heat_ends_safe`].
#[test]
fn an_overheated_chip_of_the_chain_in_motion_ends_safe() {
    let machine = with_chain(&mill());
    let set_temperature = |board: &mut Pico2, joint: usize, celsius: f64| {
        let chip = board.chain_chip(joint);
        chip.set_temperature(celsius);
        chip.drives()
    };
    assert_heat_ends_safe(
        session(spi_board(&machine), &machine),
        set_temperature,
        assert_set,
    );
}

/// A reset of a chip by its supply in standstill, with the drives on, is a fault of its joint: its
/// power stage is off.
#[test]
fn a_chip_of_the_chain_that_was_reset_is_a_fault_of_its_joint() {
    let machine = with_chain(&bench());
    let mut session = session(spi_board(&machine), &machine);
    session.enable().expect("the drives are ready");
    steps(&mut session, 50);
    let chip = session.line_mut().chain_chip(2);
    chip.set_powered(false);
    chip.set_powered(true);
    assert!(!chip.drives());
    // 60 ms.
    steps(&mut session, 300);
    let status = session.status().expect("the board answers");
    let alarm = DriveAlarm::Reset;
    assert_eq!(status.fault, Some(Fault::Drive { joint: 2, alarm }));
    assert!(!session.line_mut().is_enabled());
    assert_set(session.line_mut());
}

/// A broken wire from SDO of a chip, which reads high or low at its other end, switches the drives
/// off. The fault names the chip before the wire, and every chip of the chain is reported.
#[test]
fn a_broken_wire_of_the_chain_is_a_fault_of_the_joint_before_it() {
    let machine = with_chain(&bench());
    let mut session = session(spi_board(&machine), &machine);
    for (joint, level) in [(2, true), (0, false), (1, false)] {
        session.enable().expect("the drives are ready");
        steps(&mut session, 50);
        let position = usize::from(CHIPS[joint].0);
        session.line_mut().chip_chain().cut = Some(Cut { position, level });
        let after = until_off(&mut session);
        println!("drives off {after:.1} ms after the wire behind position {position} broke");
        steps(&mut session, 200);
        let status = session.status().expect("the board answers");
        let alarm = DriveAlarm::Silent;
        let fault = Fault::Drive {
            joint: joint as u8,
            alarm,
        };
        assert_eq!(status.fault, Some(fault), "position {position}");
        assert_eq!(alarms(&mut session), interrupted(joint));
        session.line_mut().chip_chain().cut = None;
        session.ask(Command::Reset).expect("the fault is reset");
    }
    session.enable().expect("the drives are ready");
    assert_set(session.line_mut());
}

/// Each image has the bus of one kind of chip: with the other kind in the machine file it never
/// switches the drives on.
#[test]
fn an_image_refuses_chips_of_the_other_bus() {
    let (spi, uart) = (with_chain(&bench()), with_chips(&bench()));
    assert_no_bus(board(&spi), &spi, "position 2");
    assert_no_bus(spi_board(&uart), &uart, "address 2");
}

/// The pins of the page, with a machine file that has chips.
#[test]
fn every_pin_of_the_chain_is_set() {
    let (_, part) = PAGE
        .split_once("\n## TMC5160 at an SPI\n")
        .expect("the page has the part");
    let own = table(part);
    let pins = own
        .iter()
        .flat_map(|row| row.pins.iter().zip(&row.directions));
    let pins: Vec<(u32, bool)> = pins.map(|(pin, out)| (*pin, *out)).collect();
    assert_eq!(pins, [(1, true), (26, true), (27, true), (28, false)]);
    let machine = with_chain(&bench());
    let mut session = session(spi_board(&machine), &machine);
    session.enable().expect("the drives are ready");
    let chip = session.line_mut().chip();
    for (pin, _) in &pins {
        let function = chip.register(IO_BANK0 + 4 + 8 * pin) & 0x1F;
        let pad = chip.register(PADS_BANK0 + 4 + 4 * pin);
        let by_software = chip.register(SIO_OUTPUT_ENABLE) >> pin & 1 != 0;
        let text = format!("GP{pin}: function {function}, pad {pad:#x}, software {by_software}");
        // Not disabled, not isolated, with the input buffer and the pull-up only.
        assert_eq!(pad >> 2 & 0b111_0011, 0b001_0010, "{text}");
        let expected = if *pin == CHIP_SELECT { SOFTWARE } else { SPI };
        assert_eq!(function, expected, "{text}");
        assert_eq!(by_software, *pin == CHIP_SELECT, "{text}");
    }
    // The others are those of the first table.
    let taken = |pin: u32| pin == 0 || pins.iter().any(|(own, _)| *own == pin);
    for row in table(PAGE) {
        for (index, pin) in row.pins.iter().enumerate() {
            if !taken(*pin) {
                let is_output = row.directions[index.min(row.directions.len() - 1)];
                assert_is_set(chip, *pin, is_output, false);
            }
        }
    }
}
