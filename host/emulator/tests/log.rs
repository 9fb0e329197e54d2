//! The log of the image with the option `log`: its lines over RTT, and what it costs.

mod common;

use common::{LOG_IMAGE, board_with, enabled_board, image, log_image, mill, path, with_chips};
use haptimill_client::session::pins::record::Period;
use haptimill_client::session::{Homing, Session};
use haptimill_emulator::checks::Checks;
use haptimill_emulator::pico2::Pico2;
use haptimill_firmware::io::DriveCommand;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::Command;
use std::path::Path;
use std::process;

/// Largest difference between the moments in their control periods at which two of them begin,
/// cycles: 0.2 us, as in `jitter.rs`.
const JITTER: u32 = 30;

fn steps(session: &mut Session<Pico2>, periods: usize) {
    for _ in 0..periods {
        session.step().expect("the line works");
    }
}

/// A joint searches its switch, and its chip switches the motor off. The operator presses the
/// emergency stop, and pulls the cable.
fn run(image: &[u8], machine: &MachineFile) -> Pico2 {
    let mut session = enabled_board(board_with(image, machine), machine);
    session
        .ask(Command::Enable)
        .expect_err("the drives are on already");
    let _homing = Homing::start(&mut session);
    steps(&mut session, 300);
    let board = session.line_mut();
    let joint = (0..3).find(|joint| board.steps[*joint] != 0);
    let joint = joint.expect("a joint searches");
    board.drive_chip(joint).set_temperature(150.0);
    steps(&mut session, 300);
    let board = session.line_mut();
    assert!(!board.is_enabled());
    board.drive_chip(joint).set_temperature(30.0);
    board.set_emergency_stop(true);
    steps(&mut session, 20);
    let mut board = session.into_line();
    let now = board.cycles();
    board.chip().usb_host.leave(now);
    for _ in 0..50 {
        board.run_period().expect("the emulator runs");
    }
    board
}

/// The lines of a log, by the program that prints the log of the emulated Cortex-M4F: it has the
/// decoder of defmt, and a lock file of its own.
fn decoded(log: &[u8]) -> Vec<String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("pico2.log");
    std::fs::write(&file, log).expect("written");
    let output = process::Command::new(env!("CARGO"))
        .args(["run", "--quiet", "--locked", "--manifest-path"])
        .arg(root.join("tests/log/Cargo.toml"))
        .arg("--")
        .args([Path::new(&path(LOG_IMAGE)), &file])
        .output()
        .expect("cargo starts");
    let [text, problem] = [output.stdout, output.stderr].map(|it| String::from_utf8(it));
    assert!(output.status.success(), "{}", problem.expect("text"));
    text.expect("text").lines().map(String::from).collect()
}

/// Asserts that the log has these lines in this order; others may be between them.
fn assert_has(lines: &[String], expected: &[&str]) {
    let mut rest = lines.iter();
    for text in expected {
        assert!(
            rest.any(|line| line[11..].trim() == *text),
            "'{text}' is missing, or not in its place: {lines:#?}"
        );
    }
}

/// The control periods from the first one with a drive on.
fn with_drives(board: &Pico2) -> &[Period] {
    let is_on = |period: &Period| period.commands.iter().any(|it| *it != DriveCommand::Off);
    let first = board.periods.iter().position(is_on);
    &board.periods[first.expect("a control period with a drive on")..]
}

/// Control period of a line.
fn period(line: &str) -> u64 {
    line[..10].trim().parse().expect("a number")
}

/// The log has the lines of the run in their order, no control period is missed, and the moments at
/// which they begin, and all pulses, are those of the image without a log.
#[test]
fn the_log_says_what_happens_and_moves_no_edge() {
    let machine = with_chips(&mill());
    let mut plain = run(&image(), &machine);
    assert!(plain.log().is_empty());
    let mut board = run(&log_image(), &machine);
    let lines = decoded(board.log());
    lines.iter().for_each(|line| println!("{line}"));
    println!("{} bytes, {} lines", board.log().len(), lines.len());
    assert_has(&lines, &[]);
    assert!(lines.is_sorted_by_key(|line| period(line)), "{lines:#?}");

    let (without, with) = (
        Checks::of(&mut plain, &machine),
        Checks::of(&mut board, &machine),
    );
    println!("{with}");
    assert!(with.passed());
    assert_eq!(with.missed_enabled, 0);
    assert_eq!(without.late, with.late);
    assert_eq!(with.late.1 - with.late.0, JITTER);

    let pairs = with_drives(&plain).iter().zip(with_drives(&board));
    let (mut silent, mut logging) = ((0, 0), 0);
    for (plain, logged) in pairs {
        assert_eq!(plain.commands, logged.commands, "{}", logged.inputs.period);
        let more = i64::from(logged.busy) - i64::from(plain.busy);
        if lines
            .iter()
            .any(|line| period(line) == logged.inputs.period)
        {
            println!(
                "control period {}: {more} cycles more",
                logged.inputs.period
            );
            logging = logging.max(more);
        } else {
            silent = (silent.0 + more, silent.1 + 1);
        }
    }
    println!(
        "worst control period {} and {} cycles; with lines {logging} cycles more at most, without {:.1}",
        without.busy,
        with.busy,
        silent.0 as f64 / f64::from(silent.1),
    );
}
