//! The image with encoders and shift registers.

mod common;

use common::{
    bench_with_encoders, board_with, enabled_with_encoders, encoder_image, fault,
    mill_with_encoders, session, with_encoders,
};
use haptimill_client::session::pins::record::Period;
use haptimill_client::session::{
    JobRun, JobStatus, NoObserver, Session, find_home_pose, plan_straight_move,
};
use haptimill_emulator::checks::Checks;
use haptimill_emulator::encoders::{ENCODERS, Edge};
use haptimill_emulator::pico2::Pico2;
use haptimill_firmware::io::{DriveCommand, Inputs};
use haptimill_hil_sim::joint::encoder::EncoderCondition;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::{program_options, settings};
use haptimill_planner::Plan;
use haptimill_protocol::message::Fault;

/// Control periods in which the last pulses leave and the slides come to rest.
const REST: usize = 250;

fn board(machine: &MachineFile) -> Pico2 {
    board_with(&encoder_image(), machine)
}

fn run(board: &mut Pico2, periods: usize) {
    for _ in 0..periods {
        board.run_period().expect("the emulator runs");
    }
}

fn steps(session: &mut Session<Pico2>, periods: usize) {
    for _ in 0..periods {
        session.step().expect("the line works");
    }
}

/// Homing by the switches over the shift registers, then a part program. The counts of the board
/// are those of the encoders of the machine.
#[test]
fn a_mill_with_encoders_homes_and_runs_a_program() {
    const STEPS_PER_MM: f64 = 640.0;
    let machine = mill_with_encoders();
    let mut session = enabled_with_encoders(&machine);
    let home = find_home_pose(&machine, session.model()).expect("a home pose");
    session
        .go_home(&machine, &home)
        .expect("the joints find their switches");
    steps(&mut session, REST);
    let before = session.line_mut().steps;
    let model = session.model();
    let options = program_options(&machine, model.to_engineering_units(&home));
    let program = haptimill_gcode::read("part.ngc", include_bytes!("part.ngc"), &options)
        .unwrap_or_else(|refused| panic!("{refused}"));
    let plan = Plan::new(&program, &settings(&machine), model);
    let setpoints = plan.unwrap_or_else(|it| panic!("{it:?}")).setpoints;
    let end = session
        .run_job(2, home, setpoints, &mut NoObserver)
        .expect("the program begins");
    session
        .check_completed(&end)
        .expect("the program is complete");
    steps(&mut session, REST);
    let mut board = session.into_line();
    for (joint, moved) in [1.0, 2.0, -1.5].into_iter().enumerate() {
        let steps = board.steps[joint] - before[joint];
        assert_eq!(steps, (moved * STEPS_PER_MM) as i64, "joint {joint}");
    }
    let mut truth = Inputs::default();
    board.plant().latch(&mut truth);
    let last = board.periods.last().expect("control periods");
    for joint in 0..3 {
        let (seen, real) = (last.inputs.joints[joint].counts, truth.joints[joint].counts);
        println!("joint {joint}: {seen} counts");
        assert_eq!(seen, real, "joint {joint}");
        let counts = board
            .periods
            .iter()
            .map(|it| it.inputs.joints[joint].counts);
        let range = counts.clone().max().unwrap_or(0) - counts.min().unwrap_or(0);
        assert!(range > 10_000, "joint {joint} moved by {range} counts");
    }
    let checks = Checks::of(&mut board, &machine);
    println!("{checks}");
    println!("{} edges compared", checks.pulses.compared());
    assert!(checks.passed());
    assert_eq!(checks.missed_enabled, 0);
    for axis in &checks.pulses.axes {
        assert_eq!(axis.compared, 2 * axis.pulses, "every edge is compared");
    }
}

/// Level of SysTick, which counts down to the start of a control period.
const SYSTICK: u32 = 0xE000_E018;
const PERIOD: u64 = 30_000;

/// Edges of all encoders, one every `interval` cycles: up by `count` counts, down by twice as many,
/// and up again. Odd joints move in the other direction.
fn up_and_down(start: u64, interval: u64, count: i64) -> Vec<Edge> {
    let path = (1..=count)
        .chain((-count..count).rev())
        .chain(1 - count..=0);
    let times = (start..).step_by(interval as usize);
    let edge = |(cycle, count): (u64, i64), joint: usize| {
        let count = if joint.is_multiple_of(2) {
            count
        } else {
            -count
        };
        let (a, b) =
            [(false, false), (true, false), (true, true), (false, true)][(count & 3) as usize];
        Edge { cycle, joint, a, b }
    };
    let all = times.zip(path).collect::<Vec<_>>();
    (0..ENCODERS)
        .flat_map(|joint| all.iter().map(move |it| edge(*it, joint)))
        .collect()
}

/// All four encoders at once, in both directions, through zero: every count is right at any
/// latch, and the time of the last edge within 0.2 us.
#[test]
fn counts_are_exact_in_both_directions_through_zero() {
    let machine = common::bench();
    // 1,000,000 and 10,700,000 edges/s.
    for (interval, count) in [(150, 2_000), (14, 20_000)] {
        let mut board = board(&machine);
        run(&mut board, 5);
        let start = board.cycles() + 1_001;
        let edges = up_and_down(start, interval, count);
        board.chain().1.add(edges);
        let systick = u64::from(board.chip().register(SYSTICK));
        // Cycle at which a control period began.
        let begun = board.cycles() - (PERIOD - 1 - systick);
        let periods = 4 * count as u64 * interval / PERIOD + 20;
        let first = board.periods.len();
        run(&mut board, periods as usize);
        let (mut seen, mut worst) = (0, 0.0_f64);
        for period in &board.periods[first..] {
            let joints = &period.inputs.joints;
            for (joint, input) in joints[..ENCODERS].iter().enumerate() {
                let up = if joint % 2 == 0 { 1 } else { -1 };
                assert!(
                    (input.counts - up * joints[0].counts).abs() <= 1,
                    "{joints:?}"
                );
                assert!(i64::from(input.counts).abs() <= count);
            }
            let age = period.inputs.time_ns.wrapping_sub(joints[0].edge_time_ns);
            if age.cast_signed().abs() < 10_000 {
                seen += 1;
                // An edge is at a whole number of intervals.
                let after = f64::from(joints[0].edge_time_ns % 200_000) * 0.15;
                let at = (after + begun as f64 - start as f64).rem_euclid(interval as f64);
                let error = at.min(interval as f64 - at);
                worst = worst.max(error);
            }
        }
        println!("an edge every {interval} cycles");
        let last = board.periods.last().expect("control periods");
        for joint in 0..ENCODERS {
            assert_eq!(last.inputs.joints[joint].counts, 0, "joint {joint}");
        }
        assert!(seen > 20, "{seen}");
        // The moments of an edge are known to half an interval.
        if interval > 100 {
            println!("times of edges within {worst:.0} cycles");
            assert!(worst <= 30.0);
        }
        let (max, min) = board.periods.iter().fold((0, 0), |(max, min), period| {
            let counts = period.inputs.joints[0].counts;
            (max.max(counts), min.min(counts))
        });
        println!("{min} to {max} counts seen");
        assert!(i64::from(max) > count * 9 / 10 && i64::from(min) < -count * 9 / 10);
    }
}

/// A move of the first motor of the bench by 20 mm, half done.
fn moving(machine: &MachineFile) -> Session<Pico2> {
    let mut session = enabled_with_encoders(machine);
    session.home().expect("the joints are at their presets");
    let from = session.status().expect("the board answers").commanded;
    let mut to = session.model().to_engineering_units(&from);
    to[0] += 20.0;
    let to = session.model().to_axis_units(&to);
    let plan = plan_straight_move(machine, session.model(), &from, &to, None);
    let setpoints = plan.expect("a move").setpoints;
    let mut job = JobRun::start(&mut session, 2, from, setpoints);
    while session.line_mut().steps[0] < 4000 {
        let status = job.advance(&mut session, &mut NoObserver);
        assert!(matches!(status, Ok(JobStatus::Running)), "the move ended");
        session.step().expect("the line works");
    }
    session
}

/// A line of an encoder that is cut in a move, which a pull-up then holds high, and channels that
/// are swapped: the drives go off, and the fault names the joint.
#[test]
fn a_cut_or_swapped_encoder_line_is_named_and_ends_safe() {
    let machine = bench_with_encoders();
    let (one, both) = (
        EncoderCondition {
            stuck_a: Some(true),
            ..EncoderCondition::default()
        },
        EncoderCondition {
            swapped: true,
            ..EncoderCondition::default()
        },
    );
    for (name, condition) in [("cut", one), ("swapped", both)] {
        let mut session = moving(&machine);
        let board = session.line_mut();
        let (moved, first) = (board.steps[0], board.periods.len());
        board.plant_mut().set_encoder_condition(0, condition);
        run(board, 150);
        assert!(!board.is_enabled(), "{name}");
        let steps = board.steps;
        run(board, 20);
        assert_eq!(board.steps, steps, "{name}: no pulse");
        let off = |period: &Period| period.commands.iter().all(|it| *it == DriveCommand::Off);
        let periods = &board.periods[first..];
        let after = periods.iter().position(off).expect("the drives go off");
        let reason = fault(board, machine.config.period_us);
        println!(
            "{name}: {reason:?} {:.1} ms after the fault, {:.3} mm on",
            after as f64 * 0.2,
            (steps[0] - moved) as f64 / 640.0
        );
        assert!(
            matches!(
                reason,
                Some(
                    Fault::StepsLost { joint: 0, .. }
                        | Fault::EncoderStuck { joint: 0 }
                        | Fault::EncoderReversed { joint: 0 }
                        | Fault::FollowingError { joint: 0, .. }
                )
            ),
            "{name}: {reason:?}"
        );
    }
}

/// A joint that needs an index pulse has no drive that is ready. `haptimill` refuses its machine
/// file before.
#[test]
fn a_joint_that_needs_an_index_reports_an_alarm() {
    let text = include_str!("mill3-short.toml");
    let text = with_encoders(text, 3, 20_000);
    let text = text.replacen("home = \"switch\"\n", "home = \"switch_and_index\"\n", 1);
    let machine = MachineFile::parse("index.toml", &text).unwrap_or_else(|it| panic!("{it}"));
    let mut board = board(&machine);
    run(&mut board, 10);
    let mut session = session(board, &machine);
    steps(&mut session, 20);
    let last = session.line_mut().periods.last().expect("control periods");
    let ready = last.inputs.joints.map(|joint| joint.drive_ready);
    assert_eq!(ready[..3], [false, true, true]);
    assert!(session.enable().is_err());
}
