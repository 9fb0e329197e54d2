//! The image of the Pico 2 with its pins wired to a simulated mill: what the board commands is what
//! the controller commands natively, and what leaves its pins is what it commands.

mod common;

use common::{board, enabled, enabled_in_320_us, five_in_320_us, mill, session};
use haptimill_client::session::pins::record::JOINTS;
use haptimill_client::session::{Homing, Session};
use haptimill_emulator::checks::Checks;
use haptimill_emulator::pico2::Pico2;
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::Command;

/// Control periods of the test: 0.5 s, in which the mill searches its first switch.
const PERIODS: usize = 2500;
/// Cycles of a control period of 320 us, in which five joints move at 1,000,000 steps/s each.
const PERIOD_CYCLES: u64 = 48_000;
/// Control periods until a stopped joint is at standstill.
const STANDSTILL: usize = 500;

/// The checks of a run must pass, with at least this number of pulses of a joint, and at most this
/// number of missed control periods while the drives are on.
fn assert_passed(
    board: &mut Pico2,
    machine: &MachineFile,
    (joint, pulses): (usize, u64),
    missed: u64,
) {
    let checks = Checks::of(board, machine);
    println!("{checks}");
    assert!(checks.passed());
    assert!(checks.missed_enabled <= missed);
    for axis in &checks.pulses.axes {
        assert_eq!(axis.compared, 2 * axis.pulses);
    }
    assert!(checks.pulses.axes[joint].pulses > pulses);
}

/// Activates machine files with all that a configuration may have, also force control, which this
/// board cannot do: the activation takes more of the stack than motion.
#[test]
fn the_stack_has_a_margin() {
    const MARGIN: u32 = 16 * 1024;
    let trunnion = include_str!("../../../machines/trunnion5.toml");
    let force = include_str!("../../../machines/h4.toml");
    for (name, text) in [("trunnion5.toml", trunnion), ("h4.toml", force)] {
        let machine = MachineFile::parse(name, text).unwrap_or_else(|error| panic!("{error}"));
        let mut session = session(board(&machine), &machine);
        let stack = session.line_mut().stack();
        println!("{name}: {stack:?}");
        assert!(stack.used + MARGIN <= stack.size, "{stack:?}");
        // The start does always the same.
        assert!(stack.start + 4096 <= stack.size, "{stack:?}");
    }
}

#[test]
fn the_pulses_of_a_search_are_those_of_the_native_controller() {
    let machine = mill();
    let mut session = enabled(&machine);
    let _homing = Homing::start(&mut session);
    for _ in 0..PERIODS {
        session.step().expect("the line works");
    }
    // At standstill no pulse lies across the end of the record.
    session.ask(Command::Stop).expect("the joint stops");
    for _ in 0..STANDSTILL {
        session.step().expect("the line works");
    }
    assert_passed(&mut session.into_line(), &machine, (2, 1000), 0);
}

/// The level of the pin of the emergency stop ends the pulses within 2 us, also shortly before the
/// edge of a pulse, and the board still knows how many have left.
#[test]
fn the_emergency_stop_ends_the_pulses_within_two_microseconds() {
    // Cycles from the pin to the next rising edge of a joint. After four stops the joints, which
    // coast, would be near their switches.
    let worst = [&[2, 4, 6, 8][..], &[10, 40, 100]].map(last_edge_after_the_pin);
    let worst = worst.into_iter().max().unwrap_or(0);
    println!("last step edge at most {worst} cycles of 1/150 us after the emergency stop");
    assert!(worst > 0, "an edge 2 cycles later cannot be held back");
}

/// Waits until all joints have moved at their full rate for three control periods: a pulse every
/// 150 cycles.
fn reach_full_rate(session: &mut Session<Pico2>) {
    let mut fast_periods = 0;
    for waited in 0.. {
        assert!(waited < 150, "the joints do not reach their full rate");
        let before = session.line_mut().steps;
        session.step().expect("the line works");
        let steps = session.line_mut().steps.iter().zip(before);
        fast_periods = match { steps }.all(|(now, before)| (now - before).abs() > 314) {
            true => fast_periods + 1,
            false => 0,
        };
        if fast_periods == 3 {
            break;
        }
    }
}

/// A stop that is shorter than a pulse is seen only by the joints that make none. The board stops
/// the others in the next control period, and knows how many steps each of them has made.
#[test]
fn a_stop_that_one_joint_does_not_see_stops_all() {
    const STOP_CYCLES: u64 = 8;
    // Pulses of 30 cycles, and of 60 cycles of the other joints.
    let machine = five_in_320_us(0.2);
    let mut session = enabled_in_320_us(&machine);
    // Three joints are in their pulse at the first moment, and none at the second.
    for after_edge in [40, 70] {
        let _homing = Homing::start(&mut session);
        reach_full_rate(&mut session);
        let board = session.line_mut();
        while board.run_cycles(2).expect("the emulator runs").is_none() {}
        board.run_cycles(after_edge).expect("the emulator runs");
        let from = board.cycles();
        board.set_emergency_stop(true);
        board.run_cycles(STOP_CYCLES).expect("the emulator runs");
        board.set_emergency_stop(false);
        let last = board
            .run_cycles(PERIOD_CYCLES * 10)
            .expect("the emulator runs");
        let late = last.map_or(0, |last| last - from);
        println!("{after_edge}: last edge {late} cycles after the pin");
        for _ in 0..20 {
            session.step().expect("the line works");
        }
        let board = session.line_mut();
        let last = board.periods.last().expect("control periods");
        assert!(
            last.inputs.emergency_stop,
            "{after_edge} cycles after an edge"
        );
        let counted = last.inputs.joints[..JOINTS].iter();
        let counted: Vec<i64> = counted.map(|axis| axis.steps.into()).collect();
        assert_eq!(counted, board.steps, "{after_edge} cycles after an edge");
        // The control period in which it was, and the one that finds it.
        assert!(late <= 2 * PERIOD_CYCLES, "{late} cycles");
        for _ in 0..400 {
            session.step().expect("the line works");
        }
        session.ask(Command::Reset).expect("the stop is over");
        session.enable().expect("the drives are ready");
    }
}

/// Opens the emergency stop at these moments before an edge; the most cycles from the pin to the
/// last edge.
fn last_edge_after_the_pin(before_edges: &[u64]) -> u64 {
    const CYCLES_PER_US: u64 = 150;
    let machine = five_in_320_us(0.4);
    let mut worst = 0;
    let mut session = enabled_in_320_us(&machine);
    for &before_edge in before_edges {
        let _homing = Homing::start(&mut session);
        reach_full_rate(&mut session);
        let board = session.line_mut();
        while board.run_cycles(2).expect("the emulator runs").is_none() {}
        board
            .run_cycles(CYCLES_PER_US - before_edge)
            .expect("the emulator runs");
        let from = board.cycles();
        board.set_emergency_stop(true);
        let last = board
            .run_cycles(PERIOD_CYCLES * 10)
            .expect("the emulator runs")
            .unwrap_or(from);
        let late = last - from;
        worst = worst.max(late);
        assert!(
            late <= 2 * CYCLES_PER_US,
            "{late} cycles, {before_edge} before an edge"
        );
        for _ in 0..20 {
            session.step().expect("the line works");
        }
        let board = session.line_mut();
        let last = board.periods.last().expect("control periods");
        let counted: Vec<i64> = last.inputs.joints[..JOINTS]
            .iter()
            .map(|axis| axis.steps.into())
            .collect();
        println!("{before_edge}: last edge {late} cycles after the pin; counted {counted:?}");
        assert_eq!(
            counted, board.steps,
            "the count of the board, and that of its pins"
        );
        board.set_emergency_stop(false);
        for _ in 0..70 {
            session.step().expect("the line works");
        }
        session.ask(Command::Reset).expect("the stop is over");
        session.enable().expect("the drives are ready");
    }
    worst
}
