//! Pins and shift registers of the image with encoders, as docs/hardware/pico2-encoders.md has
//! them.

mod common;

use common::table::{assert_is_set, table};
use common::{
    UNDEFINED_INSTRUCTION, bench_with_encoders, board_with, encoder_image, fault, image,
    replace_period, session,
};
use haptimill_client::session::{
    JobRun, JobStatus, NoObserver, find_home_pose, plan_straight_move,
};
use haptimill_emulator::chain::Cuts;
use haptimill_emulator::pico2::Pico2;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::{program_options, settings};
use haptimill_planner::Plan;
use haptimill_protocol::message::Fault;

const PAGE: &str = include_str!("../../../docs/hardware/pico2-encoders.md");

/// Channel A of the PWM slice of GP0.
const PWM_SLICE_0: u32 = 0x400A_8000;
/// 100 % is 24,000 rev/min.
const COUNTS: u32 = 15_000;

fn board(machine: &MachineFile) -> Pico2 {
    let mut board = board_with(&encoder_image(), machine);
    run(&mut board, 10);
    board
}

fn run(board: &mut Pico2, periods: usize) {
    for _ in 0..periods {
        board.run_period().expect("the emulator runs");
    }
}

/// Each pin of the table has its direction, and what it does without a wire.
#[test]
fn every_pin_of_the_table_is_set() {
    let mut board = board(&bench_with_encoders());
    let rows = table(PAGE);
    let mut pins: Vec<u32> = rows.iter().flat_map(|row| row.pins.clone()).collect();
    for row in &rows {
        for &pin in &row.pins {
            assert_is_set(board.chip(), pin, row.directions[0], false);
        }
    }
    // All but GP23 to GP25, which the board has for itself.
    pins.sort_unstable();
    assert_eq!(pins, (0..=22).chain(26..=28).collect::<Vec<u32>>());
}

/// What the controller gets: home switches, both limit switches, alarms, digital inputs.
type Seen = ([[bool; 4]; 5], u32);

fn seen(board: &mut Pico2, periods: usize) -> Vec<Seen> {
    let first = board.periods.len();
    run(board, periods);
    let of = |period: &haptimill_client::session::pins::record::Period| -> Seen {
        let joints = core::array::from_fn(|joint| {
            let it = &period.inputs.joints[joint];
            [it.home, it.limit_low, it.limit_high, !it.drive_ready]
        });
        (joints, period.inputs.digital)
    };
    board.periods[first..].iter().map(of).collect()
}

/// The inputs of the table: bit in the chain, and what the controller sees of it alone.
fn inputs() -> Vec<(u32, Seen)> {
    let (_, table) = PAGE
        .split_once("| chip | inputs | signal |\n")
        .expect("the page has the table");
    let rows = table.lines().take_while(|line| line.starts_with('|'));
    let mut inputs = Vec::new();
    for row in rows.skip(1) {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let [_, chip, letters, signal, _] = cells[..] else {
            panic!("{row}")
        };
        let chip: u32 = chip.parse().expect("a number");
        let first = u32::from(letters.as_bytes()[0] - b'A');
        for which in 0..4 {
            let mut seen = ([[false; 4]; 5], 0);
            match signal.strip_prefix("joint ") {
                Some(joint) => seen.0[joint.parse::<usize>().expect("a joint")][which] = true,
                None => seen.1 = 1 << which,
            }
            // The first chip is the last one of the chain.
            inputs.push((8 * (3 - chip) + first + which as u32, seen));
        }
    }
    inputs
}

/// Each input reaches its own signal and no other, after a level of three control periods.
#[test]
fn each_input_reaches_its_own_signal() {
    let mut board = board(&common::bench());
    let nothing = ([[false; 4]; 5], 0);
    assert_eq!(seen(&mut board, 1), [nothing]);
    let inputs = inputs();
    let bits: u32 = inputs.iter().map(|(bit, _)| 1 << bit).sum();
    assert_eq!(bits, 0xFF_FFFF, "24 inputs");
    for (bit, signal) in inputs {
        board.hold_high(1 << bit);
        let short = seen(&mut board, 2);
        board.hold_high(0);
        let after = seen(&mut board, 6);
        assert!(
            short.iter().chain(&after).all(|it| *it == nothing),
            "bit {bit}: two periods are noise"
        );
        board.hold_high(1 << bit);
        let long = seen(&mut board, 7);
        assert_eq!(long.last(), Some(&signal), "bit {bit}");
        assert!(long.iter().all(|it| *it == nothing || *it == signal));
        board.hold_high(0);
        assert_eq!(seen(&mut board, 7).last(), Some(&nothing), "bit {bit}");
    }
}

/// Any wire to the chips that is cut makes all inputs active; that to the outputs none.
#[test]
fn a_broken_chain_reads_all_active() {
    let all = ([[true; 4]; 5], 0xF);
    let nothing = ([[false; 4]; 5], 0);
    let mut board = board(&common::bench());
    let cuts = |change: fn(&mut Cuts)| {
        let mut cuts = Cuts::default();
        change(&mut cuts);
        cuts
    };
    let cases = [
        (cuts(|it| it.data_in = true), all),
        (cuts(|it| it.clock = Some(false)), all),
        (cuts(|it| it.clock = Some(true)), all),
        (cuts(|it| it.latch = Some(false)), all),
        (cuts(|it| it.latch = Some(true)), all),
        (cuts(|it| it.data_out = true), nothing),
    ];
    for (cuts, expected) in cases {
        board.chain().0.cuts = cuts;
        let broken = seen(&mut board, 8);
        assert_eq!(broken.last(), Some(&expected), "{cuts:?}");
        board.chain().0.cuts = Cuts::default();
        assert_eq!(seen(&mut board, 8).last(), Some(&nothing), "{cuts:?}");
    }
}

/// A limit switch in a move: the controller names it, no pulse leaves, and the drives are off.
#[test]
fn a_limit_switch_stops_the_machine() {
    let machine = bench_with_encoders();
    let mut session = session(board(&machine), &machine);
    session.enable().expect("the drives are ready");
    session.home().expect("the joints are at their presets");
    let home = session.status().expect("the board answers").commanded;
    let mut to = session.model().to_engineering_units(&home);
    to[1] += 40.0;
    let to = session.model().to_axis_units(&to);
    let plan = plan_straight_move(&machine, session.model(), &home, &to, None).expect("a move");
    let before = session.line_mut().steps[1];
    let mut job = JobRun::start(&mut session, 2, home, plan.setpoints);
    while session.line_mut().steps[1] < before + 2000 {
        let status = job.advance(&mut session, &mut NoObserver);
        assert!(matches!(status, Ok(JobStatus::Running)));
        session.step().expect("the line works");
    }
    let board = session.line_mut();
    // The upper limit switch of joint 1.
    board.hold_high(1 << 22);
    run(board, 7);
    assert!(!board.is_enabled());
    let steps = board.steps;
    run(board, 20);
    assert_eq!(board.steps, steps, "no pulse");
    let reason = fault(board, machine.config.period_us);
    assert_eq!(reason, Some(Fault::LimitSwitch { joint: 1 }));
}

/// A part program switches spindle and outputs; the direction changes with a duty of 0 only. A
/// fault of the processor switches all off.
#[test]
fn spindle_and_outputs_follow_the_program() {
    const PROGRAM: &str = "G21 G90\nS12000 M3\nG4 P0.01\nM8\nG4 P0.01\nS6000 M4\nG4 P0.01\nM9\n\
                           G4 P0.01\nM5\nG4 P0.01\nS24000 M3 M8\nG4 P0.4\nM2\n";
    let output = "[[output]]\nname = \"coolant\"\nfunction = \"coolant\"\nchannel = 6\n\
                  active = \"high\"\nsafe = \"off\"\nwithout_host = \"safe\"\n\n[plant]\n";
    let text = include_str!("../../../machines/bench.toml").replacen("[plant]\n", output, 1);
    let machine = MachineFile::parse("bench.toml", &text).unwrap_or_else(|it| panic!("{it}"));
    let mut session = session(board(&machine), &machine);
    session.enable().expect("the drives are ready");
    session.home().expect("the joints are at their presets");
    let model = session.model().clone();
    let home = find_home_pose(&machine, &model).expect("a home pose");
    let options = program_options(&machine, model.to_engineering_units(&home));
    let program = haptimill_gcode::read("spindle.ngc", PROGRAM.as_bytes(), &options)
        .unwrap_or_else(|refused| panic!("{refused}"));
    let plan = Plan::new(&program, &settings(&machine), &model)
        .unwrap_or_else(|refused| panic!("{refused:?}"));
    let outputs = |board: &mut Pico2| {
        let duty = board.chip().register(PWM_SLICE_0 + 0xC) & 0xFFFF;
        (duty, board.chain().0.outputs)
    };
    let mut states = vec![outputs(session.line_mut())];
    let mut job = JobRun::start(&mut session, 2, home, plan.setpoints);
    let last = (COUNTS, 0x81);
    while states.last() != Some(&last) {
        let status = job.advance(&mut session, &mut NoObserver);
        assert!(matches!(status, Ok(JobStatus::Running)), "{states:?}");
        session.step().expect("the line works");
        let now = outputs(session.line_mut());
        if states.last() != Some(&now) {
            states.push(now);
        }
    }
    println!("{states:?}");
    let expected = [
        (0, 0),
        (COUNTS / 2, 1),
        (COUNTS / 2, 0x81),
        (0, 0x81),
        (COUNTS / 4, 0x80),
        (COUNTS / 4, 0),
        (0, 0),
        (COUNTS, 1),
        last,
    ];
    assert_eq!(states, expected);
    let board = session.line_mut();
    replace_period(board, UNDEFINED_INSTRUCTION);
    for _ in 0..10 {
        run(board, 1);
        if board.chip().resets() == 1 {
            break;
        }
    }
    // The start after the reset takes longer than a control period.
    assert_eq!(board.chip().resets(), 1);
    assert_eq!(outputs(board), (0, 0));
}

const PERIOD: u64 = 30_000;
/// Moments of a control period at which an input changes.
const MOMENTS: u64 = 51;

/// Cycles from a change of the digital input 0 to the start of the control period whose controller
/// sees it, at all moments of a period: the least, and the most.
fn latched(board: &mut Pico2, input: u32) -> (u64, u64) {
    let mut waited = Vec::new();
    for moment in 0..MOMENTS {
        let offset = PERIOD * moment / MOMENTS;
        for (high, level) in [(input, 1), (0, 0)] {
            let rest = 8 * PERIOD - board.cycles() % PERIOD + offset;
            let end = board.cycles() + rest;
            while board.cycles() < end {
                board
                    .run_cycles(1000.min(end - board.cycles()))
                    .expect("it runs");
                board.read_record();
            }
            board.hold_high(high);
            let begun = board.cycles();
            loop {
                board.run_cycles(2).expect("the emulator runs");
                board.read_record();
                let last = board.periods.last().expect("control periods");
                if last.inputs.digital & 1 == level {
                    waited.push(board.cycles() - u64::from(last.busy) - begun);
                    break;
                }
                assert!(board.cycles() < begun + 10 * PERIOD, "it is not seen");
            }
        }
    }
    let min = waited.iter().copied().min().unwrap_or(0);
    (min, waited.iter().copied().max().unwrap_or(0))
}

/// An input over the shift registers is seen a control period later than at a pin, less the time
/// from its start to the load of the registers.
#[test]
fn an_input_is_seen_a_period_later_than_at_a_pin() {
    let machine = common::bench();
    // GP20 of the image without shift registers; E of the third chip.
    let pin = latched(&mut board_with(&image(), &machine), 1 << 20);
    let chain = latched(&mut board(&machine), 1 << 4);
    let us = |cycles: u64| cycles as f64 / 150.0;
    for (name, (min, max)) in [("pin", pin), ("shift registers", chain)] {
        println!("{name}: {:.1} to {:.1} us", us(min), us(max));
        assert!(max - min <= PERIOD + 1000);
    }
    let later = chain.1 as i64 - pin.1 as i64;
    println!("{:.1} us later", later as f64 / 150.0);
    let period = PERIOD as i64;
    assert!((period - 3000..=period + 300).contains(&later), "{later}");
}
