//! The out-of-band stop over both lines of the board: how long after its last byte the controller
//! decelerates.

mod common;

use common::{bench, board_with, image, mill, session, uart_image};
use haptimill_client::session::{JobRun, JobStatus, NoObserver, plan_straight_move};
use haptimill_emulator::pico2::Pico2;
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::Outputs;
use haptimill_protocol::out_of_band::STOP;

const CYCLES_PER_US: u64 = 150;
const PERIOD: u64 = 200 * CYCLES_PER_US;
/// A byte on a line of 1 Mbaud.
const BYTE: u64 = 10 * CYCLES_PER_US;
/// Moments of a control period at which the stop is sent.
const MOMENTS: u64 = 101;
/// Program time of a control period without an override.
const FULL_RATE: u64 = 1 << 32;

/// Both images, with their lines.
fn images() -> [(&'static str, Vec<u8>); 2] {
    [("USB", image()), ("UART", uart_image())]
}

/// Sends the stop. Returns the cycles from its last byte in the device of the line to the start of
/// the first control period whose controller gets it, and the number of that period.
fn stop(board: &mut Pico2) -> (u64, u64) {
    let first = board.periods.len();
    let begun = board.cycles();
    board.chip().receive(&STOP);
    let mut received = None;
    loop {
        board.run_cycles(2).expect("the emulator runs");
        if received.is_none() && board.chip().has_received() {
            received = Some(board.cycles());
        }
        let known = board.periods.len();
        board.read_record();
        let last = board.periods.last().expect("control periods");
        if board.periods.len() > known.max(first) && last.inputs.out_of_band_stop {
            let start = board.cycles() - u64::from(last.busy);
            let received = received.expect("the last byte has arrived");
            return (start.saturating_sub(received), last.inputs.period);
        }
        assert!(board.cycles() < begun + 10 * PERIOD, "it is not seen");
    }
}

/// The controller gets the stop in a control period that begins at most a period and the time of a
/// byte after its last byte, at any moment of a period.
#[test]
fn the_controller_gets_an_out_of_band_stop_within_a_period() {
    let machine = mill();
    for (name, image) in images() {
        let mut session = session(board_with(&image, &machine), &machine);
        session.enable().expect("the drives are ready");
        let board = session.line_mut();
        let mut waited = Vec::new();
        for moment in 0..MOMENTS {
            // From the end of a control period's work, so that the moments are all over a period.
            let offset = PERIOD * moment / MOMENTS;
            board
                .run_cycles(PERIOD - board.cycles() % PERIOD + offset)
                .expect("the emulator runs");
            board.read_record();
            waited.push(stop(board).0);
        }
        let worst = waited.iter().copied().max().unwrap_or(0);
        println!(
            "{name}: {:.1} to {:.1} us from the last byte to the control period",
            waited.iter().copied().min().unwrap_or(0) as f64 / 150.0,
            worst as f64 / 150.0
        );
        assert!(worst <= PERIOD + BYTE, "{name}: {waited:?}");
        // Some moments are late in their period, and some early.
        assert!(worst > PERIOD / 2, "{name}: {waited:?}");
    }
}

/// In that control period the controller decelerates: its program time falls behind for the first
/// time.
#[test]
fn the_controller_decelerates_in_the_period_that_gets_the_stop() {
    let machine = bench();
    for (name, image) in images() {
        let mut session = session(board_with(&image, &machine), &machine);
        session.enable().expect("the drives are ready");
        session.home().expect("the joints are at their presets");
        let from = session.status().expect("the board answers").commanded;
        let mut to = session.model().to_engineering_units(&from);
        to[0] += 50.0;
        let to = session.model().to_axis_units(&to);
        let plan = plan_straight_move(&machine, session.model(), &from, &to, None);
        let setpoints = plan.expect("the machine can make the move").setpoints;
        let mut run = JobRun::start(&mut session, 2, from, setpoints);
        // The move is 1 s from its end when 5 of 50 mm are behind it.
        while session.line_mut().steps[0] < 3200 {
            let status = run.advance(&mut session, &mut NoObserver);
            assert!(matches!(status, Ok(JobStatus::Running)), "the move ended");
            session.step().expect("the line works");
        }
        let board = session.line_mut();
        let (waited, stopped) = stop(board);
        for _ in 0..50 {
            board.run_period().expect("the emulator runs");
        }
        let mut controller = Controller::new(machine.config.period_us);
        let mut outputs = Outputs::default();
        let (mut rates, mut before) = (Vec::new(), 0);
        for period in &board.periods {
            outputs.transmit.clear();
            controller.tick(&period.inputs, &mut outputs, &mut ());
            // It is the controller of the board.
            assert_eq!(outputs.joints[..period.commands.len()], period.commands);
            let snapshot = controller.snapshot(&period.inputs);
            let time = snapshot.map_or(0, |it| it.program_time);
            rates.push((period.inputs.period, time.wrapping_sub(before)));
            before = time;
        }
        let at = rates
            .iter()
            .position(|it| it.0 == stopped)
            .expect("a period");
        let (before, after) = rates.split_at(at);
        let full = before.iter().rev().take(500).all(|it| it.1 == FULL_RATE);
        assert!(full, "{name}: it moves at its programmed rate");
        let falling: Vec<u64> = after.iter().take(40).map(|it| it.1).collect();
        println!(
            "{name}: after {:.1} us the path rates are {:.9}, {:.9}, {:.9}",
            waited as f64 / 150.0,
            falling[0] as f64 / FULL_RATE as f64,
            falling[1] as f64 / FULL_RATE as f64,
            falling[2] as f64 / FULL_RATE as f64,
        );
        assert!(falling[0] < FULL_RATE, "{name}: {falling:?}");
        assert!(falling.is_sorted_by(|a, b| a > b), "{name}: {falling:?}");
    }
}
