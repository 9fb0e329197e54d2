//! Part programs through the image of the Pico 2: the planner of the host, the USB, the controller
//! on the chip, the pins, and the simulated machine behind them. The counts at the end are those of
//! the programmed distances, and every pulse edge is at its commanded tick.

mod common;

use common::{bench, enabled, h4, mill, session};
use haptimill_client::session::{
    JobRun, JobStatus, NoObserver, Session, find_home_pose, plan_straight_move,
};
use haptimill_emulator::checks::Checks;
use haptimill_emulator::pico2::Pico2;
use haptimill_firmware::io::DriveCommand;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::{program_options, settings};
use haptimill_planner::Plan;
use haptimill_protocol::message::{AxisValues, Command};
use haptimill_protocol::setpoint::Setpoint;

/// Steps of a slide of the mill in a millimetre: 3200 steps a turn, 5 mm a turn.
const MILL_STEPS_PER_MM: f64 = 640.0;
/// Control periods in which the last pulses leave and the slides come to rest.
const REST: usize = 250;

/// Plans a part program from a pose.
fn plan(
    session: &Session<Pico2>,
    machine: &MachineFile,
    from: &AxisValues,
    program: &str,
) -> Vec<Setpoint> {
    let model = session.model();
    let options = program_options(machine, model.to_engineering_units(from));
    let program = haptimill_gcode::read("part.ngc", program.as_bytes(), &options)
        .unwrap_or_else(|refused| panic!("{refused}"));
    let plan = Plan::new(&program, &settings(machine), model);
    plan.unwrap_or_else(|refused| panic!("{refused:?}"))
        .setpoints
}

/// Runs a part program from a pose; nothing moves at its end.
fn run(session: &mut Session<Pico2>, machine: &MachineFile, from: &AxisValues, program: &str) {
    let setpoints = plan(session, machine, from, program);
    let end = session
        .run_job(2, from.clone(), setpoints, &mut NoObserver)
        .expect("the program begins");
    session
        .check_completed(&end)
        .expect("the program is complete");
    for _ in 0..REST {
        session.step().expect("the line works");
    }
}

/// The checks of a run must pass, without a missed control period while a drive was on. Returns the
/// seconds from the first pulse to the last.
fn assert_passed(board: &mut Pico2, machine: &MachineFile) -> f64 {
    let checks = Checks::of(board, machine);
    println!("{checks}");
    println!("{} edges compared", checks.pulses.compared());
    assert!(checks.passed());
    assert_eq!(checks.missed_enabled, 0);
    for axis in &checks.pulses.axes {
        assert_eq!(axis.compared, 2 * axis.pulses, "every edge is compared");
    }
    let has_pulses = |command: &DriveCommand| match command {
        DriveCommand::Steps(segment) => segment.count != 0,
        _ => false,
    };
    let moves: Vec<bool> = board
        .periods
        .iter()
        .map(|period| period.commands.iter().any(has_pulses))
        .collect();
    let first = moves.iter().position(|moves| *moves).expect("a pulse");
    let last = moves.iter().rposition(|moves| *moves);
    let periods = last.unwrap_or(first) - first;
    let seconds = periods as f64 * f64::from(machine.config.period_us) / 1e6;
    println!("{seconds:.3} s from the first pulse to the last");
    seconds
}

/// Homing by the switches, then a part program whose end is known from its text.
#[test]
fn a_part_program_of_the_mill_ends_at_its_exact_counts() {
    let machine = mill();
    let mut session = enabled(&machine);
    let home = find_home_pose(&machine, session.model()).expect("a home pose");
    session
        .go_home(&machine, &home)
        .expect("the joints find their switches");
    for _ in 0..REST {
        session.step().expect("the line works");
    }
    let before = session.line_mut().steps;
    let truth = *session.line_mut().plant().truth();
    run(&mut session, &machine, &home, include_str!("part.ngc"));
    let board = session.line_mut();
    // The last words of the program are X1, Y2 and Z48.5; home is X0 Y0 Z50.
    let moved = [1.0, 2.0, -1.5];
    for (joint, moved) in moved.into_iter().enumerate() {
        let steps = board.steps[joint] - before[joint];
        assert_eq!(steps, (moved * MILL_STEPS_PER_MM) as i64, "joint {joint}");
        // The slides of the machine moved with the pulses.
        let now = board.plant().truth().joints[joint];
        let slide = now - truth.joints[joint];
        println!("joint {joint}: {steps} steps, the slide moved {slide:.4} mm");
        assert!((slide - moved).abs() < 0.01, "joint {joint}: {slide}");
    }
    let seconds = assert_passed(&mut session.into_line(), &machine);
    assert!(seconds >= 2.0, "{seconds}");
}

/// The H-4 mill: a plunge and a part of its slot, then back to its start. Its step motors are at
/// their presets; the tool is where the geometry of the simulated machine, which is not that of the
/// controller, has it.
#[test]
fn a_part_of_the_slot_of_the_h4_mill_ends_where_it_began() {
    let machine = h4();
    let mut session = enabled(&machine);
    let home = find_home_pose(&machine, session.model()).expect("a home pose");
    session
        .go_home(&machine, &home)
        .expect("the joints are at their presets");
    let before = session.line_mut().steps;
    let start = *session.line_mut().plant().truth();
    run(
        &mut session,
        &machine,
        &home,
        "G21 G90\nG1 Z19.232 F600\nX-4 F240\nM2\n",
    );
    let away = *session.line_mut().plant().truth();
    let moved: Vec<f64> = (0..5).map(|at| away.pose[at] - start.pose[at]).collect();
    println!("the tool moved {moved:.4?}");
    let expected = [-4.0, 0.0, 19.232 - 21.232, 0.0, 0.0];
    for (moved, expected) in moved.iter().zip(expected) {
        assert!((moved - expected).abs() < 0.02, "{moved}, {expected}");
    }
    assert_ne!(session.line_mut().steps, before);
    let here = session.status().expect("the board answers").commanded;
    run(
        &mut session,
        &machine,
        &here,
        "G21 G90\nG1 Z21.232 F600\nX0 F600\nM2\n",
    );
    assert_eq!(session.line_mut().steps, before, "a closed path");
    let seconds = assert_passed(&mut session.into_line(), &machine);
    assert!(seconds >= 2.0, "{seconds}");
}

/// The experiment E7 as a whole: the slot of 30 mm, 2 mm deep, and the way back to its start.
#[test]
#[ignore = "takes minutes: cargo xtask emulator --slot"]
fn the_whole_slot_of_the_h4_mill_ends_where_it_began() {
    let machine = h4();
    let mut session = enabled(&machine);
    let home = find_home_pose(&machine, session.model()).expect("a home pose");
    session
        .go_home(&machine, &home)
        .expect("the joints are at their presets");
    let before = session.line_mut().steps;
    let mut lowest = session.line_mut().plant().truth().pose;
    let setpoints = plan(
        &session,
        &machine,
        &home,
        include_str!("../../../examples/e7-slot.ngc"),
    );
    let mut run = JobRun::start(&mut session, 2, home, setpoints);
    let end = loop {
        match run.advance(&mut session, &mut NoObserver) {
            Ok(JobStatus::Ended(end)) => break end,
            Ok(_) => {}
            Err(error) => panic!("{error}"),
        }
        session.step().expect("the line works");
        let now = session.line_mut().plant().truth().pose;
        for (lowest, now) in lowest.iter_mut().zip(now) {
            *lowest = lowest.min(now);
        }
    };
    session.check_completed(&end).expect("the slot is complete");
    for _ in 0..REST {
        session.step().expect("the line works");
    }
    println!("lowest coordinates of the tool: {lowest:.4?}");
    // The end and the depth of the slot, as in the program.
    for (lowest, expected) in [(lowest[0], -30.0), (lowest[2], 19.232)] {
        assert!((lowest - expected).abs() < 0.02, "{lowest}, {expected}");
    }
    assert_eq!(session.line_mut().steps, before, "a closed path");
    let seconds = assert_passed(&mut session.into_line(), &machine);
    assert!(seconds > 10.0, "{seconds}");
}

/// The commands of "First motion" in docs/hardware/pico2.md: `home`, `jog --by x=5` at the feed of
/// that command, `disable`. The shaft of joint x turns once.
#[test]
fn the_first_motion_of_a_bare_board_is_one_turn() {
    /// Full steps of a turn times microsteps, as in the machine file and as set at the drive.
    const TURN: i64 = 200 * 16;
    let machine = bench();
    let mut session = session(common::board(&machine), &machine);
    assert!(!session.line_mut().is_enabled());
    session.enable().expect("the drives are ready");
    session.home().expect("the joints are at their presets");
    assert!(session.line_mut().is_enabled());
    assert_eq!(session.line_mut().steps, [0; 5], "no joint searches");
    let from = session.status().expect("the board answers").commanded;
    let mut to = session.model().to_engineering_units(&from);
    to[0] += 5.0;
    let to = session.model().to_axis_units(&to);
    let plan = plan_straight_move(&machine, session.model(), &from, &to, Some(300.0))
        .expect("the machine can make the move");
    let end = session
        .run_job(2, from, plan.setpoints, &mut NoObserver)
        .expect("the move begins");
    session.check_completed(&end).expect("the move is complete");
    for _ in 0..20 {
        session.step().expect("the line works");
    }
    let board = session.line_mut();
    assert_eq!(board.steps, [TURN, 0, 0, 0, 0]);
    let step = &board.lines.step[0];
    assert_eq!(step.changes.len() as i64, 2 * TURN);
    // High: the drive turns in its positive direction.
    assert!(board.level(3));
    assert!(board.is_enabled(), "it holds");
    session.ask(Command::Disable).expect("the drives go off");
    for _ in 0..5 {
        session.step().expect("the line works");
    }
    assert!(!session.line_mut().is_enabled());
    assert_passed(&mut session.into_line(), &machine);
}
