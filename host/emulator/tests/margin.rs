//! How much of the control period is left in the worst one, with three and with five joints at
//! 1,000,000 steps/s each: the search of the switches, and moves of all joints after it. Likewise
//! with moves of the H-4 mill.
//! `cargo xtask emulator --period US` runs it with an image of this control period.

mod common;

use common::{
    enabled, enabled_with_encoders, five_in_period, five_with_encoders, h4_in_period, period_us,
    three_in_period, three_with_encoders,
};
use haptimill_client::session::{NoObserver, Session, find_home_pose, plan_straight_move};
use haptimill_emulator::checks::Checks;
use haptimill_emulator::pico2::Pico2;
use haptimill_firmware::io::{DriveCommand, Inputs};
use haptimill_machine_file::MachineFile;

/// Edges that must be compared.
const EDGES: u64 = 1_000_000;
/// Part of the worst control period that must be left, %.
const LEFT_PERCENT: f64 = 30.0;
/// Shortest control periods for which that holds with three and with five joints, us.
const THREE_JOINTS_US: u16 = 250;
const FIVE_JOINTS_US: u16 = 320;
/// The same with encoders on three and on four of five joints.
const THREE_ENCODERS_US: u16 = 250;
const FIVE_ENCODERS_US: u16 = 400;
/// The same for the H-4 mill with 3,200 steps/turn.
const H4_US: u16 = 250;

/// Homes a machine, moves all its coordinates by these, mm or degrees, and back, at a feed or
/// rapidly; prints the checks, which must pass, with at least this number of edges.
fn run(machine: &MachineFile, by: &[f64], feed: Option<f64>, edges: u64) -> Checks {
    run_with(enabled(machine), machine, by, feed, edges)
}

/// As [`run`], with a board whose drives are on. The counts at the end are those of the encoders of
/// the machine.
fn run_with(
    mut session: Session<Pico2>,
    machine: &MachineFile,
    by: &[f64],
    feed: Option<f64>,
    edges: u64,
) -> Checks {
    let model = session.model().clone();
    let home = find_home_pose(machine, &model).expect("a home pose");
    session
        .go_home(machine, &home)
        .expect("the joints find their switches");
    let mut engineering = model.to_engineering_units(&home);
    for (value, by) in engineering.iter_mut().zip(by) {
        *value += by;
    }
    let away = model.to_axis_units(&engineering);
    for (job, from, to) in [(2, &home, &away), (3, &away, &home)] {
        let plan = plan_straight_move(machine, &model, from, to, feed).expect("a move");
        let end = session
            .run_job(job, from.clone(), plan.setpoints, &mut NoObserver)
            .expect("the move begins");
        session.check_completed(&end).expect("the move is complete");
    }
    // The pulses of the last control periods leave.
    for _ in 0..20 {
        session.step().expect("the line works");
    }
    let mut board = session.into_line();
    let mut truth = Inputs::default();
    board.plant().latch(&mut truth);
    let last = board.periods.last().expect("control periods");
    let pairs = last.inputs.joints.iter().zip(&truth.joints);
    for (joint, (seen, real)) in pairs.enumerate() {
        // Edges are a control period late, and the slides tremble by some counts.
        assert!(
            (seen.counts - real.counts).abs() <= 20,
            "joint {joint}: {seen:?}, {real:?}"
        );
    }
    let joints = machine.config.joints.len();
    let full = i16::try_from(period_us()).expect("a period") - 2;
    let at_once = board.periods.iter().filter(|period| {
        period.commands[..joints]
            .iter()
            .all(|command| match command {
                DriveCommand::Steps(segment) => segment.count.abs() >= full,
                _ => false,
            })
    });
    println!(
        "{joints} joints, control period {} us: {} periods with {full} steps of each joint or more",
        period_us(),
        at_once.count()
    );
    let checks = Checks::of(&mut board, machine);
    println!("{checks}");
    println!("{} edges compared", checks.pulses.compared());
    assert!(checks.passed());
    assert!(checks.pulses.compared() >= edges);
    checks
}

/// Asserts that enough is left, if the control period of the image is this or longer.
fn assert_enough_is_left(checks: &Checks, from_us: u16) {
    if period_us() >= from_us {
        assert_eq!(checks.missed_enabled, 0);
        assert!(checks.margin_percent() >= LEFT_PERCENT);
    }
}

#[test]
#[ignore = "takes minutes: cargo xtask emulator --period 320"]
fn three_joints_at_a_million_steps_per_second_each() {
    let checks = run(&three_in_period(), &[6.0, 6.0, -6.0], None, EDGES);
    assert_eq!(checks.missed_enabled, 0);
    assert_enough_is_left(&checks, THREE_JOINTS_US);
}

#[test]
#[ignore = "takes minutes: cargo xtask emulator --period 320"]
fn five_joints_at_a_million_steps_per_second_each() {
    let checks = run(&five_in_period(), &[6.0, 6.0, -6.0, 5.0, 20.0], None, EDGES);
    assert_enough_is_left(&checks, FIVE_JOINTS_US);
}

#[test]
#[ignore = "takes minutes: cargo xtask emulator --period 320"]
fn three_joints_with_encoders_at_a_million_steps_per_second_each() {
    let machine = three_with_encoders();
    let session = enabled_with_encoders(&machine);
    let checks = run_with(session, &machine, &[6.0, 6.0, -6.0], None, EDGES);
    assert_eq!(checks.missed_enabled, 0);
    assert_enough_is_left(&checks, THREE_ENCODERS_US);
}

#[test]
#[ignore = "takes minutes: cargo xtask emulator --period 320"]
fn five_joints_with_encoders_at_a_million_steps_per_second_each() {
    let machine = five_with_encoders();
    let session = enabled_with_encoders(&machine);
    let by = [6.0, 6.0, -6.0, 5.0, 20.0];
    let checks = run_with(session, &machine, &by, None, EDGES);
    assert_enough_is_left(&checks, FIVE_ENCODERS_US);
}

/// All five coordinates of the H-4 mill at once: its joints make fewer steps, and its kinematics
/// take longer.
#[test]
#[ignore = "takes a minute: cargo xtask emulator --period 250"]
fn the_h4_mill_with_all_its_coordinates() {
    let by = [-6.0, 4.0, -2.0, 3.0, 4.0];
    let checks = run(&h4_in_period(), &by, None, 10_000);
    assert_eq!(checks.missed_enabled, 0);
    assert_enough_is_left(&checks, H4_US);
}
