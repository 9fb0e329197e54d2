//! What the tests of the chips of the drives share.

use super::{parse, steps};
use haptimill_client::client::Options;
use haptimill_client::session::{Homing, NoObserver, Session, plan_straight_move};
use haptimill_emulator::checks::Checks;
use haptimill_emulator::pico2::Pico2;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::{Alarms, Command, DriveAlarm, Fault, State};
use std::sync::Arc;

/// Addresses and currents of the TMC2209 of joints x, y and z.
pub const CHIPS: [(u8, f64, f64); 3] = [(2, 0.8, 0.4), (0, 1.2, 0.6), (1, 0.5, 0.1)];

/// A machine of three step drives that have these chips.
pub fn with_chips(machine: &MachineFile) -> MachineFile {
    let sections = CHIPS.map(|(address, run, hold)| {
        format!(
            "[joint.drive.tmc2209]\naddress = {address}\nmicrosteps = 16\n\
             run_current_a = {run}\nhold_current_a = {hold}\n"
        )
    });
    with_sections(machine, &sections)
}

/// A machine of three step drives, each with one more section behind it.
pub fn with_sections(machine: &MachineFile, sections: &[String; 3]) -> MachineFile {
    const END: &str = "hold_us = 5.0\ndirection = 1\n";
    let mut parts = machine.text.split(END);
    let mut text = parts.next().expect("a first part").to_string();
    let mut sections = sections.iter();
    for part in parts {
        let section = sections.next().expect("the file has three drives");
        text += &format!("{END}\n{section}{part}");
    }
    assert_eq!(sections.next(), None, "the file has three drives");
    parse(&machine.file, &text)
}

/// The alarms that the board reports.
pub fn alarms(session: &mut Session<Pico2>) -> Alarms {
    session.status().expect("an answer").lines().alarms
}

/// The alarm of one joint.
pub fn only(joint: usize, alarm: DriveAlarm) -> Alarms {
    Alarms::default().with(joint, Some(alarm))
}

/// Runs until the drives are off; returns the time for which they were on, ms.
pub fn until_off(session: &mut Session<Pico2>) -> f64 {
    let begin = session.line_mut().cycles();
    while session.line_mut().is_enabled() {
        steps(session, 1);
        assert!(session.line_mut().cycles() < begin + 150 * 60_000, "60 ms");
    }
    (session.line_mut().cycles() - begin) as f64 / 150e3
}

/// Moves joint x of [`bench`](super::bench) by 1 mm, and checks every edge.
pub fn move_by_one_millimetre(session: &mut Session<Pico2>, machine: &MachineFile) {
    session.home().expect("the joints are at their presets");
    let from = session.status().expect("the board answers").commanded;
    let mut to = session.model().to_engineering_units(&from);
    to[0] += 1.0;
    let to = session.model().to_axis_units(&to);
    let plan = plan_straight_move(machine, session.model(), &from, &to, Some(600.0))
        .expect("the machine can make the move");
    let end = session
        .run_job(2, from, plan.setpoints, &mut NoObserver)
        .expect("the move begins");
    session.check_completed(&end).expect("the move is complete");
    steps(session, 20);
    let board = session.line_mut();
    assert_eq!(board.steps, [640, 0, 0, 0, 0], "1 mm of 5 mm a turn");
    let late = board.periods.iter().map(|period| period.late).max();
    println!("control periods begin {late:?} cycles late at most");
    let checks = Checks::of(board, machine);
    println!("{checks}");
    assert!(checks.passed());
    assert_eq!(checks.missed_enabled, 0);
}

/// A chip switches its motor off because of its temperature, in a search for a switch of
/// [`mill`](super::mill): the enable line falls, no pulse leaves from then on, and the fault names
/// the joint. After it has cooled down the drives go on again.
///
/// `set_temperature` sets that of the chip of a joint, C, and returns whether it drives its motor;
/// `assert_set` checks the settings of all chips.
pub fn assert_heat_ends_safe(
    mut session: Session<Pico2>,
    set_temperature: impl Fn(&mut Pico2, usize, f64) -> bool,
    assert_set: impl Fn(&mut Pico2),
) {
    session.enable().expect("the drives are ready");
    let _homing = Homing::start(&mut session);
    steps(&mut session, 300);
    let board = session.line_mut();
    let joint = (0..3).find(|joint| board.steps[*joint] != 0);
    let joint = joint.expect("a joint searches");
    assert!(board.is_enabled());
    assert!(!set_temperature(board, joint, 155.0));
    let after = until_off(&mut session);
    println!("drives off {after:.1} ms after the chip switched its motor off");
    // Those of a control period that was handed over before.
    steps(&mut session, 2);
    let before = session.line_mut().steps;
    steps(&mut session, 200);
    let status = session.status().expect("the board answers");
    assert_eq!(session.line_mut().steps, before, "no pulse");
    assert_eq!(status.state, State::Fault);
    let alarm = DriveAlarm::Overheated;
    let fault = Fault::Drive {
        joint: joint as u8,
        alarm,
    };
    assert_eq!(status.fault, Some(fault));
    let said = session.fault(&fault).message;
    assert!(
        said.contains("is too hot and switched the motor off"),
        "{said}"
    );
    assert!(!session.line_mut().is_enabled());
    assert_eq!(alarms(&mut session), only(joint, alarm), "it is still hot");
    set_temperature(session.line_mut(), joint, 60.0);
    session.ask(Command::Reset).expect("the fault is reset");
    session.enable().expect("the drives are ready");
    assert!(session.line_mut().is_enabled());
    assert_set(session.line_mut());
}

/// The image has no bus for the chips of the machine file: it never switches the drives on. `place`
/// is that of the chip of joint x.
pub fn assert_no_bus(board: Pico2, machine: &MachineFile, place: &str) {
    let mut session = Session::new(board, machine, Options::default(), Arc::default());
    session.connect(1).expect("the board answers");
    session.configure(machine).expect("it takes the file");
    let refused = session.enable().expect_err("no bus");
    let expected = format!("the drive of x is not ready: its driver chip ({place}) has no bus");
    assert!(refused.message.contains(&expected), "{refused:?}");
    let board = session.line_mut();
    assert!(!board.is_enabled());
    assert!(board.lines.enable.changes.is_empty(), "it never rose");
}
