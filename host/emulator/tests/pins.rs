//! The pins of the table in docs/hardware/pico2.md, one by one: their functions, what each input
//! tells the controller, and what each output does.

mod common;

use common::table::{assert_is_set, table};
use common::{
    ENDLESS_LOOP, UNDEFINED_INSTRUCTION, board, board_with, mill, replace_period, session,
    uart_image,
};
use haptimill_client::session::pins::record::Period;
use haptimill_client::session::{
    JobRun, JobStatus, NoObserver, find_home_pose, plan_straight_move,
};
use haptimill_emulator::pico2::Pico2;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::{program_options, settings};
use haptimill_planner::Plan;
use haptimill_protocol::message::{Command, Event};

/// The page with the table.
const PAGE: &str = include_str!("../../../docs/hardware/pico2.md");
/// Registers of the chip (RP2350 datasheet, 12.5).
const PWM_SLICE_2: u32 = 0x400A_8000 + 2 * 0x14;
/// Cycle counter of the core.
const CYCLES: u32 = 0xE000_1004;

const DIRECTION: u32 = 22;
const LED: u32 = 25;
const OUTPUT: u32 = 26;

/// Each pin of the table has its direction, and what it does without a wire.
#[test]
fn every_pin_of_the_table_is_set() {
    let machine = mill();
    let rows = table(PAGE);
    let pins: Vec<u32> = rows.iter().flat_map(|row| row.pins.clone()).collect();
    // All but GP23 to GP25, which the board has for itself.
    let mut sorted = pins.clone();
    sorted.sort_unstable();
    assert_eq!(sorted, (0..=22).chain(26..=28).collect::<Vec<u32>>());
    for has_uart in [false, true] {
        let mut board = match has_uart {
            false => board(&machine),
            true => board_with(&uart_image(), &machine),
        };
        for row in &rows {
            for (at, &pin) in row.pins.iter().enumerate() {
                if pin >= 2 || has_uart {
                    let is_output = row.directions[at.min(row.directions.len() - 1)];
                    assert_is_set(board.chip(), pin, is_output, has_uart);
                }
            }
        }
    }
}

/// What the controller gets: home switches, digital inputs, emergency stop, drives that are
/// ready.
fn seen(period: &Period) -> (Vec<bool>, u32, bool, bool) {
    let joints = &period.inputs.joints;
    (
        joints[..5].iter().map(|joint| joint.home).collect(),
        period.inputs.digital,
        period.inputs.emergency_stop,
        joints[..5].iter().all(|joint| joint.drive_ready),
    )
}

/// Each input pin reaches its own signal and no other, after a level of three control periods; the
/// emergency stop at once.
#[test]
fn each_input_pin_reaches_its_own_signal() {
    let machine = mill();
    let mut board = board(&machine);
    let rows = table(PAGE);
    let row = |signal: &str| {
        let row = rows.iter().find(|row| row.signal.starts_with(signal));
        row.unwrap_or_else(|| panic!("the table has no {signal}"))
    };
    let run = |board: &mut Pico2, periods: usize| {
        let first = board.periods.len();
        for _ in 0..periods {
            board.run_period().expect("the emulator runs");
        }
        board.periods[first..].iter().map(seen).collect::<Vec<_>>()
    };
    run(&mut board, 5);
    let nothing = (vec![false; 5], 0, false, true);
    let mut expected = Vec::new();
    for (joint, &pin) in row("home switches").pins.iter().enumerate() {
        let mut homes = vec![false; 5];
        homes[joint] = true;
        expected.push((pin, (homes, 0, false, true)));
    }
    expected.push((
        row("digital input 0").pins[0],
        (vec![false; 5], 1, false, true),
    ));
    expected.push((
        row("digital input 1").pins[0],
        (vec![false; 5], 2, false, true),
    ));
    expected.push((
        row("alarm of the drives").pins[0],
        (vec![false; 5], 0, false, false),
    ));
    assert_eq!(expected.len(), 8);
    for (pin, signal) in expected {
        board.hold_high(1 << pin);
        let short = run(&mut board, 2);
        board.hold_high(0);
        let after = run(&mut board, 5);
        assert!(
            short.iter().chain(&after).all(|it| *it == nothing),
            "GP{pin}: two periods are noise"
        );
        board.hold_high(1 << pin);
        let long = run(&mut board, 6);
        assert_eq!(long.last(), Some(&signal), "GP{pin}");
        assert!(
            long.iter().all(|it| *it == nothing || *it == signal),
            "GP{pin}"
        );
        board.hold_high(0);
        assert_eq!(run(&mut board, 6).last(), Some(&nothing), "GP{pin} again");
    }
    board.hold_high(1 << row("emergency stop").pins[0]);
    let stopped = run(&mut board, 2);
    assert!(stopped.last().is_some_and(|it| it.2), "not filtered");
}

/// The charge pump changes once in every completed control period.
#[test]
fn the_charge_pump_changes_once_a_period() {
    const PERIODS: usize = 200;
    let machine = mill();
    let mut board = board(&machine);
    board.run_period().expect("the emulator runs");
    let (pump, first) = (board.pump, board.periods.len());
    for period in 1..=PERIODS {
        board.run_period().expect("the emulator runs");
        // The end of a control period may lie on either side of this moment.
        let completed = board.periods.len() - first;
        let changes = (board.pump - pump) as usize;
        assert!(completed.abs_diff(period) <= 1, "{completed}, {period}");
        assert!(changes.abs_diff(period) <= 1, "{changes}, {period}");
    }
}

/// The motors on the bench, with a section before that of the simulated machine.
fn bench_with(section: &str) -> MachineFile {
    let text = include_str!("../../../machines/bench.toml");
    let changed = text.replacen("[plant]\n", section, 1);
    assert_ne!(changed, text);
    MachineFile::parse("bench.toml", &changed).unwrap_or_else(|error| panic!("{error}"))
}

/// The motors on the bench, with an output for the coolant.
fn bench_with_output() -> MachineFile {
    let output = "[[output]]\nname = \"coolant\"\nfunction = \"coolant\"\nchannel = 0\n\
                  active = \"high\"\nsafe = \"off\"\nwithout_host = \"safe\"\n\n[plant]\n";
    bench_with(output)
}

/// Duty of the spindle in counts, level of its direction, level of the digital output.
fn outputs(board: &mut Pico2) -> (u32, bool, bool) {
    // Channel B of the slice.
    let duty = board.chip().register(PWM_SLICE_2 + 0xC) >> 16;
    (duty, board.level(DIRECTION), board.level(OUTPUT))
}

/// A part program switches spindle and coolant; an emergency stop switches both off. The direction
/// changes after a control period with a duty of 0 only.
#[test]
fn spindle_and_output_follow_the_program_and_the_emergency_stop() {
    /// 100 % is 24,000 rev/min.
    const COUNTS: u32 = 15_000;
    const PROGRAM: &str = "G21 G90\nS12000 M3\nG4 P0.01\nM8\nG4 P0.01\nS6000 M4\nG4 P0.01\nM9\n\
                           G4 P0.01\nM5\nG4 P0.01\nS24000 M3 M8\nG4 P0.4\nM2\n";
    let machine = bench_with_output();
    let mut session = session(board(&machine), &machine);
    session.enable().expect("the drives are ready");
    session.home().expect("the joints are at their presets");
    let chip = session.line_mut().chip();
    // Enabled, no phase correction, a count each cycle, 150 MHz / 15,000 = 10 kHz.
    assert_eq!(chip.register(PWM_SLICE_2) & 0x3F, 1);
    assert_eq!(chip.register(PWM_SLICE_2 + 0x4), 1 << 4);
    assert_eq!(chip.register(PWM_SLICE_2 + 0x10) + 1, COUNTS);
    let model = session.model().clone();
    let home = find_home_pose(&machine, &model).expect("a home pose");
    let options = program_options(&machine, model.to_engineering_units(&home));
    let program = haptimill_gcode::read("spindle.ngc", PROGRAM.as_bytes(), &options)
        .unwrap_or_else(|refused| panic!("{refused}"));
    let plan = Plan::new(&program, &settings(&machine), &model)
        .unwrap_or_else(|refused| panic!("{refused:?}"));
    let mut states = vec![outputs(session.line_mut())];
    let mut run = JobRun::start(&mut session, 2, home, plan.setpoints);
    let last = (COUNTS, true, true);
    while states.last() != Some(&last) {
        let status = run.advance(&mut session, &mut NoObserver);
        assert!(
            matches!(status, Ok(JobStatus::Running)),
            "the program ended: {states:?}"
        );
        session.step().expect("the line works");
        let now = outputs(session.line_mut());
        if states.last() != Some(&now) {
            states.push(now);
        }
    }
    session.line_mut().set_emergency_stop(true);
    for _ in 0..2 {
        session.line_mut().run_period().expect("the emulator runs");
    }
    let stopped = outputs(session.line_mut());
    println!("{states:?}, then {stopped:?}");
    let expected = [
        (0, false, false),
        (COUNTS / 2, true, false),
        (COUNTS / 2, true, true),
        (0, true, true),
        (COUNTS / 4, false, true),
        (COUNTS / 4, false, false),
        (0, false, false),
        (COUNTS, true, false),
        last,
    ];
    assert_eq!(states, expected);
    assert_eq!((stopped.0, stopped.2), (0, false));
}

/// A contact at GP20 in a probing move is latched two to three control periods after it, which are
/// at most 4 steps here, and ends the move.
#[test]
fn a_probe_at_its_pin_ends_the_move_and_is_latched_in_time() {
    /// 10 mm/s at 640 steps/mm are 1.28 steps in a control period.
    const FEED: f64 = 600.0;
    const MAX_STEPS: f64 = 3.0 * 1.28 + 1.0;
    let probe = "[[input]]\nname = \"probe\"\nfunction = \"probe\"\nchannel = 0\n\
                 active = \"high\"\nfilter_ms = 0\ncontact = \"fault\"\n\n[plant]\n";
    let machine = bench_with(probe);
    let mut session = session(board(&machine), &machine);
    session.enable().expect("the drives are ready");
    session.home().expect("the joints are at their presets");
    let from = session.status().expect("the board answers").commanded;
    let mut to = session.model().to_engineering_units(&from);
    to[0] += 5.0;
    let to = session.model().to_axis_units(&to);
    let plan = plan_straight_move(&machine, session.model(), &from, &to, Some(FEED));
    let setpoints = plan.expect("the machine can make the move").setpoints;
    let armed = Command::ArmProbe {
        input: 0,
        active: true,
    };
    session.ask(armed).expect("the probe is armed");
    let first = session.events.len();
    let mut run = JobRun::start(&mut session, 2, from, setpoints);
    let mut contact = None;
    loop {
        match run.advance(&mut session, &mut NoObserver) {
            Ok(JobStatus::Ended(_)) => break,
            status => assert!(matches!(status, Ok(JobStatus::Running))),
        }
        session.step().expect("the line works");
        let board = session.line_mut();
        if contact.is_none() && board.steps[0] >= 1600 {
            contact = Some(board.steps[0] as f64);
            board.hold_high(1 << 20);
        }
    }
    let contact = contact.expect("the move was half done");
    let found = session.events[first..].iter().find_map(|(_, it)| match it {
        Event::ProbedAt {
            coordinate: 0,
            measured,
            ..
        } => Some(*measured),
        _ => None,
    });
    let found = [found.expect("the contact is reported")];
    let found = session
        .model()
        .to_engineering_units(&found.into_iter().collect());
    let late = found[0] * 640.0 - contact;
    let end = session.line_mut().steps[0];
    println!("latched {late:.2} steps after the contact at {contact}, ended at {end}");
    assert!((-0.01..=MAX_STEPS).contains(&late), "{late}");
    assert!((end as f64) < 3200.0, "{end}");
}

/// Flashes of the LED between two pauses. The cycle counter, by which the lamp counts its time, is
/// advanced by 25 ms at a time.
fn flashes(board: &mut Pico2) -> u32 {
    const STEP_MS: u32 = 25;
    // The longest dark between two flashes is 200 ms, and the pause after them 700 ms.
    const PAUSE: u32 = 400 / STEP_MS;
    let (mut dark, mut was_on, mut count, mut pauses) = (0, false, 0, 0);
    for _ in 0..400 {
        let now = board.chip().register(CYCLES);
        let later = now.wrapping_add(STEP_MS * 150_000);
        board.chip().set_register(CYCLES, later);
        board.run_period().expect("the emulator runs");
        let on = board.level(LED);
        count += u32::from(on && !was_on);
        dark = if on { 0 } else { dark + 1 };
        was_on = on;
        if dark == PAUSE {
            pauses += 1;
            if pauses == 2 {
                return count;
            }
            count = 0;
        }
    }
    panic!("the LED does not flash with pauses");
}

/// The LED flashes once after power-on, twice after a control period that did not end, and four
/// times after a fault of the processor.
#[test]
fn the_led_shows_the_cause_of_the_last_reset() {
    for (code, expected) in [
        (None, 1),
        (Some(ENDLESS_LOOP), 2),
        (Some(UNDEFINED_INSTRUCTION), 4),
    ] {
        let machine = mill();
        let mut board = board(&machine);
        if let Some(code) = code {
            replace_period(&mut board, code);
            for _ in 0..200 {
                board.run_period().expect("the emulator runs");
                if board.chip().resets() == 1 {
                    break;
                }
            }
            assert_eq!(board.chip().resets(), 1, "{expected} flashes");
            // The code is copied into the RAM again by the start.
            for _ in 0..100 {
                board.run_period().expect("the emulator runs");
            }
            assert_eq!(board.chip().resets(), 1, "{expected} flashes");
        }
        let cause = board.periods.last().map(|period| u32::from(period.cause));
        assert_eq!(cause, Some(expected));
        assert_eq!(flashes(&mut board), expected);
    }
}
