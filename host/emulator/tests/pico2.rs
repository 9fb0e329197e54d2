//! The image of the Pico 2 with its pins wired to a simulated mill: what the board commands is what
//! the controller commands natively, and what leaves its pins is what it commands.

use haptimill_client::client::Options;
use haptimill_client::session::{Homing, Session};
use haptimill_emulator::image::flash;
use haptimill_emulator::pico2::Pico2;
use haptimill_emulator::record::{JOINTS, Period};
use haptimill_firmware::controller::Controller;
use haptimill_firmware::io::{DriveCommand, Outputs};
use haptimill_hil_sim::plant::Plant;
use haptimill_machine_file::MachineFile;
use haptimill_pulses::{Axis, Capture, Clock, NANOSECOND, Planned, Rules, check};
use std::sync::Arc;

/// Step clock of the board.
const CLOCK: Clock = Clock {
    ticks_per_us: 75,
    period_us: 200,
};

/// Control periods of the test: 0.5 s, in which the mill searches its first switch.
const PERIODS: usize = 2500;

fn image() -> Vec<u8> {
    let path = std::env::var("HAPTIMILL_IMAGE")
        .expect("HAPTIMILL_IMAGE is the path of the image; `cargo xtask emulator` sets it");
    let file = std::fs::read(&path).unwrap_or_else(|error| panic!("{path}: {error}"));
    flash(&file).unwrap_or_else(|error| panic!("{path}: {error}"))
}

fn mill() -> MachineFile {
    MachineFile::parse("mill3-short.toml", include_str!("mill3-short.toml"))
        .unwrap_or_else(|error| panic!("{error}"))
}

fn board(machine: &MachineFile) -> Pico2 {
    let config = machine.plant().expect("the file has a plant");
    let plant = Plant::new(&config, machine.config.period_us).expect("a sound plant");
    Pico2::new(&image(), plant).expect("an emulator")
}

/// Runs the controller natively on the inputs of the board; the commands must be the same bits.
fn assert_same_as_native(periods: &[Period]) {
    let mut controller = Controller::new(200);
    let mut outputs = Outputs::default();
    let mut next = 0;
    for period in periods {
        let number = period.inputs.period;
        next += u64::from(period.inputs.missed);
        assert_eq!(number, next, "a period is not in the record");
        next += 1;
        outputs.transmit.clear();
        controller.tick(&period.inputs, &mut outputs, &mut ());
        assert_eq!(outputs.axes[..JOINTS], period.commands, "period {number}");
    }
}

/// Segments of a joint, by the period in which their pulses leave.
fn planned(periods: &[Period], joint: usize) -> Vec<Planned> {
    let steps = |period: &Period| match period.commands[joint] {
        DriveCommand::Steps(segment) if segment.count != 0 => Some(Planned {
            period: period.inputs.period + 1,
            segment,
        }),
        _ => None,
    };
    periods.iter().filter_map(steps).collect()
}

#[test]
fn the_pulses_of_a_search_are_those_of_the_native_controller() {
    let machine = mill();
    let options = Options::default();
    let mut session = Session::new(board(&machine), &machine, options, Arc::default());
    session.connect(1).expect("the board answers");
    session
        .configure(&machine)
        .expect("the board accepts the file");
    session.enable().expect("the drives are ready");
    let _homing = Homing::start(&mut session);
    for _ in 0..PERIODS {
        session.step().expect("the line works");
    }
    let board = session.into_line();
    let periods = &board.periods;
    let missed: u32 = periods
        .iter()
        .map(|period| u32::from(period.inputs.missed))
        .sum();
    assert_same_as_native(periods);
    // Each edge, with no tolerance but that of the rounding to fs.
    let names = ["x", "y", "z"];
    let commanded: Vec<Vec<Planned>> = (0..names.len())
        .map(|joint| planned(periods, joint))
        .collect();
    let axes: Vec<Axis<'_>> = names
        .iter()
        .enumerate()
        .map(|(joint, name)| Axis {
            name,
            step: &board.lines.step[joint],
            direction: &board.lines.direction[joint],
            planned: Some(&commanded[joint]),
        })
        .collect();
    let capture = Capture {
        resolution: 1,
        start: 0,
        end: (i128::from(board.cycles()) * 20_000_000 / 3) as i64,
        signals: Vec::new(),
    };
    let rules = Rules {
        clock: CLOCK,
        tolerance: 2,
        width: 2500 * NANOSECOND - 2,
        pause: 2500 * NANOSECOND - 2,
        setup: 5000 * NANOSECOND - 2,
        hold: 5000 * NANOSECOND - 2,
        exact_width: Some(188),
    };
    let report = check(&capture, &axes, Some(&board.lines.enable), &rules);
    for (joint, axis) in report.axes.iter().enumerate() {
        println!(
            "{}: {} pulses, {} edges compared, {} faults, largest error {} fs, sum {} of {:?}",
            axis.name,
            axis.pulses,
            axis.compared,
            axis.fault_count,
            axis.largest_error,
            axis.count,
            axis.commanded
        );
        assert_eq!(axis.fault_count, 0, "{:#?}", axis.faults);
        assert_eq!(axis.commanded, Some(axis.count));
        assert_eq!(axis.compared, 2 * axis.pulses);
        let counted = periods
            .last()
            .map(|period| i64::from(period.inputs.axes[joint].steps));
        println!(
            "counted by the board {counted:?}, at its pins {}",
            board.steps[joint]
        );
    }
    assert!(report.axes[2].pulses > 1000);
    let cycles = |period: &Period| u64::from(period.cycles());
    let moving = periods.iter().filter(|period| {
        period
            .commands
            .iter()
            .any(|command| matches!(command, DriveCommand::Steps(segment) if segment.count != 0))
    });
    let (count, sum, worst) =
        moving.fold((0, 0, 0), |(count, sum, worst): (u64, u64, u64), period| {
            (count + 1, sum + cycles(period), worst.max(cycles(period)))
        });
    println!(
        "{} periods, {missed} missed; {} cycles a period in motion, at worst {worst}",
        periods.len(),
        sum / count.max(1)
    );
}
