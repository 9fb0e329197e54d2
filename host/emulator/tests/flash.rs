//! The configuration that a board keeps in its flash: kept by an order of the host, activated after
//! a reset, and sound whatever moment the power is cut at.

mod common;

use common::{bench, board, board_with, image, mill, session, uart_image};
use haptimill_board_common::config_store::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash,
};
use haptimill_board_common::config_store::{ConfigStore, PAGE};
use haptimill_client::client::{Options, RequestError};
use haptimill_client::session::Session;
use haptimill_emulator::flash::{BYTES, SECTOR, Work};
use haptimill_emulator::pico2::Pico2;
use haptimill_firmware::kept;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::{Command, Kept, Refusal};
use std::sync::Arc;

/// The slots of `firmware/boards/pico2/src/storage.rs`.
const SLOT: u32 = 8192;
const START: u32 = BYTES as u32 - 2 * SLOT;

/// Watchdog of the chip (RP2350 datasheet, 12.9): control register and its trigger.
const WATCHDOG: u32 = 0x400D_8000;
const TRIGGER: u32 = 1 << 31;

/// Contents of a flash, for the code of the board in this process.
struct Contents(Vec<u8>);

impl ErrorType for Contents {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Contents {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        let from = offset as usize;
        bytes.copy_from_slice(&self.0[from..from + bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.len()
    }
}

impl NorFlash for Contents {
    const WRITE_SIZE: usize = PAGE;
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        self.0[from as usize..to as usize].fill(0xFF);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        for (byte, written) in self.0[offset as usize..].iter_mut().zip(bytes) {
            *byte &= written;
        }
        Ok(())
    }
}

fn store(contents: Vec<u8>) -> ConfigStore<Contents> {
    ConfigStore::new(Contents(contents), START, SLOT).expect("whole sectors")
}

/// What a flash with these contents keeps.
fn kept_in(contents: &[u8]) -> Option<Vec<u8>> {
    let mut buffer = [0; SLOT as usize];
    let mut store = store(contents.to_vec());
    store
        .load(&mut buffer)
        .expect("readable")
        .map(<[u8]>::to_vec)
}

/// Bytes and CRC of the configuration of a machine.
fn encoded(machine: &MachineFile) -> (Vec<u8>, u32) {
    machine.encoded().expect("it can be encoded")
}

/// What a board keeps that was given this machine file.
fn kept_bytes(machine: &MachineFile) -> Vec<u8> {
    [&kept::prefix()[..], &encoded(machine).0].concat()
}

fn crc(machine: &MachineFile) -> u32 {
    encoded(machine).1
}

/// A session with a board to which no machine file is sent.
fn session_without_file(board: Pico2, machine: &MachineFile) -> Session<Pico2> {
    let mut session = Session::new(board, machine, Options::default(), Arc::default());
    session.connect(2).expect("the board answers");
    session
}

fn contents(session: &mut Session<Pico2>) -> Vec<u8> {
    session.line_mut().chip().flash().contents().to_vec()
}

/// A board that has lost its supply, and got it again.
fn after_power_on(contents: &[u8], machine: &MachineFile) -> Session<Pico2> {
    session_without_file(board_with(contents, machine), machine)
}

/// Active configuration and what is kept, as a board reports them.
fn reported(session: &Session<Pico2>) -> (u32, Kept) {
    let welcome = session.client().controller().expect("a session");
    (welcome.config_crc, welcome.kept)
}

/// The board keeps the machine file by an order only. It activates it after a reset by the watchdog
/// and after power-on, and homes without a file. No control period is missed while it writes.
#[test]
fn a_kept_configuration_is_active_after_a_reset_and_homes() {
    let machine = mill();
    let mut first = session(board(&machine), &machine);
    assert_eq!(reported(&first), (0, Kept::Nothing));
    assert!(first.line_mut().chip().flash().done.is_empty(), "no order");
    let periods = first.line_mut().periods.len();
    first.store(&machine).expect("kept");
    assert_eq!(first.kept(), Kept::Config(crc(&machine)));
    let board = first.line_mut();
    let missed = board.periods.iter().skip(periods);
    assert!(missed.clone().count() > 450, "90 ms of two erases");
    assert!(missed.clone().all(|it| it.inputs.missed == 0));
    assert_eq!(board.chip().resets(), 0);
    let flash = board.chip().flash();
    assert!(flash.ignored.is_empty(), "{:?}", flash.ignored);
    let works = |erases: bool| {
        let done = flash.done.iter();
        done.filter(|(work, _)| matches!(work, Work::Erase(_)) == erases)
            .count()
    };
    let pages = kept_bytes(&machine).len().div_ceil(PAGE) + 1;
    assert_eq!((works(true), works(false)), (2, pages));
    println!("two sectors erased, {pages} pages programmed");
    assert_eq!(kept_in(flash.contents()), Some(kept_bytes(&machine)));
    // An equal one does not wear the flash.
    let before = flash.done.len();
    first.store(&machine).expect("kept");
    assert_eq!(first.line_mut().chip().flash().done.len(), before);

    let written = contents(&mut first);
    let mut board = first.into_line();
    board.chip().set_register(WATCHDOG, TRIGGER);
    for _ in 0..200 {
        board.run_period().expect("the emulator runs");
    }
    assert_eq!(board.chip().resets(), 1);
    let again = session_without_file(board, &machine);
    let active = (crc(&machine), Kept::Config(crc(&machine)));
    assert_eq!(reported(&again), active);

    let mut session = after_power_on(&written, &machine);
    assert_eq!(reported(&session), active);
    session.enable().expect("the drives are ready");
    session.home().expect("the machine is homed");
    assert!(session.status().expect("an answer").homed);
}

/// The power is cut in each erase, in each program of a page, and behind each: the flash keeps the
/// old configuration or the new one. Boards that start with some of these contents report it.
#[test]
fn a_power_cut_keeps_the_old_configuration_or_the_new_one() {
    let (old, new) = (bench(), mill());
    let mut session = session(board(&old), &old);
    session.store(&old).expect("kept");
    session.configure(&new).expect("the board takes it");
    let ticket = session.client_mut().store(&encoded(&new).0);
    let mut cuts: Vec<(Option<Work>, Vec<u8>)> = Vec::new();
    let mut seed = 1;
    let mut since = 0;
    loop {
        session.step().expect("the line works");
        seed += 1;
        since += 1;
        let flash = session.line_mut().chip().flash();
        let work = flash.work().cloned();
        let is_new = cuts.last().is_none_or(|(last, _)| *last != work);
        // Within an erase, which takes 225 control periods, three more.
        if is_new || work.is_some() && since >= 60 {
            cuts.push((work, flash.after_cut(seed)));
            since = 0;
        }
        if let Some(answer) = session.answer(ticket) {
            answer.expect("kept");
            break;
        }
    }
    cuts.push((None, contents(&mut session)));
    let erases = |(work, _): &&(Option<Work>, _)| matches!(work, Some(Work::Erase(_)));
    let programs = |(work, _): &&(Option<Work>, _)| matches!(work, Some(Work::Program(..)));
    let count = (
        cuts.iter().filter(erases).count(),
        cuts.iter().filter(programs).count(),
    );
    let pages = kept_bytes(&new).len().div_ceil(PAGE) + 1;
    assert!(count.0 >= 6 && count.1 >= pages, "{count:?}");
    let (old_bytes, new_bytes) = (kept_bytes(&old), kept_bytes(&new));
    let kept: Vec<bool> = cuts
        .iter()
        .map(|(work, contents)| match kept_in(contents) {
            Some(kept) if kept == old_bytes => false,
            Some(kept) if kept == new_bytes => true,
            other => panic!("{work:?}: {other:?}"),
        })
        .collect();
    let news = kept.iter().filter(|is_new| **is_new).count();
    println!(
        "{} cuts in {} erases and {} programs: {news} keep the new configuration",
        cuts.len(),
        count.0,
        count.1
    );
    assert!(kept.is_sorted() && !kept[0] && kept[kept.len() - 1]);
    // In the first and the last erase, in the program of the head, and behind it.
    let last_erase = cuts.iter().rposition(|cut| erases(&cut)).expect("an erase");
    let head = cuts
        .iter()
        .rposition(|cut| programs(&cut))
        .expect("a program");
    for index in [1, last_erase, head, cuts.len() - 1] {
        let session = after_power_on(&cuts[index].1, &new);
        let expected = if kept[index] { crc(&new) } else { crc(&old) };
        assert_eq!(reported(&session), (expected, Kept::Config(expected)));
    }
}

/// A damaged slot falls back to the other one. With both damaged the board waits for a machine
/// file.
#[test]
fn a_damaged_slot_falls_back_to_the_other_one() {
    let (old, new) = (bench(), mill());
    let mut both = store(image_contents());
    both.save(&kept_bytes(&old)).expect("written");
    both.save(&kept_bytes(&new)).expect("written");
    let mut contents = both.into_flash().0;
    let session_of = |contents: &[u8]| after_power_on(contents, &new);
    assert_eq!(reported(&session_of(&contents)).0, crc(&new));
    // The second slot has the newer one. A bit of its configuration, then of the other head.
    contents[(START + SLOT) as usize + PAGE + 40] ^= 4;
    let old_crc = crc(&old);
    let report = reported(&session_of(&contents));
    assert_eq!(report, (old_crc, Kept::Config(old_crc)));
    contents[START as usize + 9] ^= 1;
    let mut session = session_of(&contents);
    assert_eq!(reported(&session), (0, Kept::Nothing));
    let refused = session.enable().expect_err("no configuration");
    assert!(
        refused
            .message
            .contains("the controller has no configuration"),
        "{refused:?}"
    );
    session.configure(&new).expect("it takes a machine file");
    session.enable().expect("the drives are ready");
}

/// Contents of the flash of a board that was never ordered to keep anything.
fn image_contents() -> Vec<u8> {
    let mut contents = image();
    contents.resize(BYTES, 0xFF);
    contents
}

/// What an image with other messages kept is ignored, and reported; so is a configuration that this
/// image refuses. An order replaces it.
#[test]
fn a_configuration_of_another_version_is_ignored_and_reported() {
    let machine = bench();
    let mut other = kept_bytes(&machine);
    other[3] ^= 0x10;
    let mut flash = store(image_contents());
    flash.save(&other).expect("written");
    let mut session = after_power_on(&flash.into_flash().0, &machine);
    assert_eq!(reported(&session), (0, Kept::OtherVersion));
    session.store(&machine).expect("kept");
    let written = contents(&mut session);
    let active = (crc(&machine), Kept::Config(crc(&machine)));
    assert_eq!(reported(&after_power_on(&written, &machine)), active);

    let text = machine
        .text
        .replacen("period_us = 200", "period_us = 250", 1);
    let text = text.replacen("substep_us = 20", "substep_us = 25", 1);
    let slow = MachineFile::parse("slow.toml", &text).unwrap_or_else(|error| panic!("{error}"));
    let mut flash = store(image_contents());
    flash.save(&kept_bytes(&slow)).expect("written");
    let session = after_power_on(&flash.into_flash().0, &machine);
    let (active, kept) = reported(&session);
    assert_eq!(active, 0);
    assert!(
        matches!(kept, Kept::Refused(Refusal::Config(_))),
        "{kept:?}"
    );
}

/// The board keeps nothing while its drives are on, and while it keeps something it neither
/// switches them on nor activates another configuration.
#[test]
fn drives_and_orders_exclude_each_other() {
    let machine = bench();
    let mut session = session(board(&machine), &machine);
    session.enable().expect("the drives are ready");
    let refused = session.store(&machine).expect_err("the drives are on");
    assert!(
        refused
            .message
            .contains("the drives are on; disable them first"),
        "{refused:?}"
    );
    assert!(session.line_mut().chip().flash().done.is_empty());
    session.ask(Command::Disable).expect("off");
    let bytes = encoded(&machine).0;
    let stored = session.client_mut().store(&bytes);
    let enabled = session.client_mut().request(Command::Enable);
    let activated = session.client_mut().configure(&bytes, true);
    let (mut answers, mut order) = (Vec::new(), Vec::new());
    while answers.len() < 3 {
        session.step().expect("the line works");
        for ticket in [stored, enabled, activated] {
            if let Some(answer) = session.answer(ticket) {
                order.push(ticket);
                answers.push(answer);
            }
        }
        assert!(!session.line_mut().is_enabled());
    }
    assert_eq!(order, [enabled, activated, stored]);
    for refused in &answers[..2] {
        let refused = refused.as_ref().expect_err("it is keeping one");
        let why = RequestError::Refused(Refusal::Storing).to_string();
        assert!(refused.message.contains(&why), "{refused:?}");
    }
    assert_eq!(answers[2], Ok(()));
    session.enable().expect("the drives are ready");
    assert_eq!(session.line_mut().chip().resets(), 0);
}

/// The image whose line is the UART keeps it, too.
#[test]
fn the_image_for_the_uart_keeps_the_configuration() {
    let machine = mill();
    let mut session = session(board_with(&uart_image(), &machine), &machine);
    session.store(&machine).expect("kept");
    let written = contents(&mut session);
    let active = (crc(&machine), Kept::Config(crc(&machine)));
    assert_eq!(reported(&after_power_on(&written, &machine)), active);
}
