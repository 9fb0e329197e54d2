//! Serial line of the emulated chip: bit errors, garbage, floods, a stop during a flood,
//! configurations that do not fit.
//!
//! The chip gives the same outputs as the controller in this process. Also periods with too many
//! instructions.
//!
//! Needs the feature `emulated`; see `emulated.rs`.

use crate::emulator;
use emulator::{BOARDS, PeriodResult, Remote, assert_same, bench, period_result};
use haptimill::commands::Exit;
use haptimill_client::port::Board;
use haptimill_firmware::comm::rx_ring::RING_BYTES;
use haptimill_firmware::io::DriveCommand;
use haptimill_hil_sim::line::LineCounters;
use haptimill_hil_sim::random::Random;
use haptimill_hil_sim::rig::{Control, RigOptions};
use haptimill_protocol::message::{
    CONFIG_CHUNK, Command, ConfigChunk, Event, Fault, Refusal, State,
};
use haptimill_protocol::out_of_band::STOP;
use haptimill_tests::{Bench, line_in_x};

/// A machine in the middle of a line at 10 mm/s, and its outputs from then on.
struct Scene<C> {
    bench: Bench<C>,
    deeds: Vec<PeriodResult>,
}

impl<C: Control> Scene<C> {
    fn new(mut bench: Bench<C>) -> Self {
        bench.make_ready();
        bench.steps(500);
        let start = bench.status().commanded;
        bench.start_job(1, &line_in_x(&start, 10.0, 40));
        bench.steps(1000);
        Self {
            bench,
            deeds: Vec::new(),
        }
    }

    /// Runs one period in which the host also sends these bytes.
    fn step(&mut self, besides: &[u8]) {
        self.bench
            .step_with_fault(|bytes| bytes.extend_from_slice(besides));
        assert_eq!(self.bench.rig.control().failure(), None);
        self.deeds.push(period_result(&self.bench));
    }

    fn quiet(&mut self, periods: usize) {
        (0..periods).for_each(|_| self.step(&[]));
    }

    fn state(&self) -> State {
        let last = self
            .deeds
            .last()
            .and_then(|period_result| period_result.snapshot);
        last.expect("configured").state
    }

    fn garbage(&mut self, periods: usize) {
        let mut random = Random::new(99, 0);
        for _ in 0..periods {
            let count = (random.fraction() * 40.0) as usize;
            let bytes: Vec<u8> = (0..count)
                .map(|_| (random.fraction() * 256.0) as u8)
                .map(|byte| if byte == STOP[1] { 0x19 } else { byte })
                .collect();
            self.step(&bytes);
        }
    }
}

/// Sends garbage, then floods larger than the receive ring, then a stop behind one. Returns the
/// reports.
fn flood_and_garbage<C: Control>(bench: Bench<C>) -> (Vec<PeriodResult>, Vec<Event>, u32, u32) {
    let mut setup = Scene::new(bench);
    let x = |setup: &Scene<C>| {
        setup
            .deeds
            .last()
            .and_then(|period_result| period_result.snapshot)
            .expect("configured")
            .commanded[0]
    };
    setup.quiet(1);
    // The garbage is shorter than the heartbeat; hardly a frame survives it.
    setup.garbage(2000);
    setup.quiet(500);
    let before = x(&setup);
    for _ in 0..3 {
        // One and a half times the receive ring, in one period.
        setup.step(&[0x55; RING_BYTES * 3 / 2]);
        setup.quiet(150);
        assert_eq!(setup.state(), State::Run, "{:?}", setup.bench.events);
    }
    assert!(x(&setup) > before, "it stands");
    // The receive ring is full when the stop arrives.
    let mut flood = vec![0x55; RING_BYTES + 100];
    flood.extend_from_slice(&STOP);
    setup.step(&flood);
    setup.quiet(1);
    assert_eq!(setup.state(), State::Hold);
    // The link recovers by itself, and the job is still there.
    setup.quiet(4000);
    setup.bench.ask(Command::Resume).expect("goes on");
    assert!(setup.bench.wait_for(State::Idle, 60_000));
    let status = setup.bench.status();
    assert_eq!(status.fault, None);
    (
        setup.deeds,
        setup.bench.events,
        status.lost_bytes,
        status.bad_frames,
    )
}

/// Runs a job over a line of 115,200 baud with every kind of error from the first byte on.
fn job_with_all_errors<C: Control>(
    bench: Bench<C>,
) -> (Vec<PeriodResult>, Vec<Event>, LineCounters, u32) {
    let mut setup = Scene::new(bench);
    setup
        .bench
        .ask(Command::Telemetry { every: 50 })
        .expect("accepted");
    setup.quiet(1);
    for _ in 0..40_000 {
        setup.step(&[]);
        if setup.state() == State::Idle {
            break;
        }
    }
    assert_eq!(setup.state(), State::Idle);
    let status = setup.bench.status();
    assert_eq!(status.fault, None);
    let count = setup.bench.rig.to_machine().count();
    (setup.deeds, setup.bench.events, count, status.bad_frames)
}

#[test]
fn a_bad_line_ends_a_job_as_natively() {
    let faults = [
        "link-errors rate=0.0003",
        "link-drop rate=0.0005",
        "link-duplicate rate=0.0005",
        "link-delay ms=3 at=3s",
    ];
    let options = RigOptions {
        baud: Some(115_200),
        faults: faults.map(|fault| fault.parse().expect("a fault")).to_vec(),
        ..RigOptions::default()
    };
    let native = job_with_all_errors(Bench::with_options(&options));
    let count = native.2;
    assert!(
        count.flipped > 3 && count.dropped > 0 && count.duplicated > 0,
        "{count:?}"
    );
    assert!(native.3 > 3, "{} broken frames", native.3);
    for board in BOARDS {
        let emulated = job_with_all_errors(bench(board, &options));
        assert_same("bad line", &native.0, &emulated.0);
        assert_eq!(
            (&native.1, count, native.3),
            (&emulated.1, emulated.2, emulated.3)
        );
        println!(
            "{board}: {} periods, {count:?}, {} broken frames, as natively",
            native.0.len(),
            native.3
        );
    }
}

#[test]
fn floods_and_garbage_in_motion_act_as_natively() {
    let options = RigOptions::default();
    let native = flood_and_garbage(Bench::with_options(&options));
    assert!(native.2 as usize > RING_BYTES, "{} lost", native.2);
    assert!(native.3 > 10, "{} broken frames", native.3);
    for board in BOARDS {
        let emulated = flood_and_garbage(bench(board, &options));
        assert_same("worst line", &native.0, &emulated.0);
        assert_eq!(
            (&native.1, native.2, native.3),
            (&emulated.1, emulated.2, emulated.3)
        );
        println!(
            "{board}: {} periods, {} bytes lost, {} broken frames, as natively",
            native.0.len(),
            native.2,
            native.3
        );
    }
}

/// Runs a short job of `haptimill run` over a line of 115,200 baud with bit errors. Returns the
/// recording, or the error text.
fn job_with_bit_errors(port: &str, rate: &str) -> Result<Vec<u8>, String> {
    let out = emulator::results(&format!("bit-errors-{rate}-{}", port.replace(':', "-")));
    std::fs::create_dir_all(&out).expect("made");
    let program = out.join("corner.ngc");
    let text = "G21 G90 G94\nM3 S12000\nG1 X5 F600\nG1 X0 Y4\nM5\nM30\n";
    std::fs::write(&program, text).expect("written");
    let fault = format!("link-errors rate={rate}");
    let more = ["--baud", "115200", "--fault", &fault];
    match emulator::run(&program, port, &out, &more) {
        Ok(()) => Ok(std::fs::read(out.join("recording.hmr")).expect("recorded")),
        Err(error) => {
            assert_eq!(error.exit, Exit::Port, "{error}");
            Err(error
                .message
                .replace("simulator: ", "")
                .replace(&format!("{port}: "), ""))
        }
    }
}

/// Up to the error rate at which the link fails, and beyond: the same recording, or the same text
/// with cause and remedy.
#[test]
fn bit_errors_end_a_job_as_natively() {
    for (rate, through) in [
        ("0.0005", Some(true)),
        ("0.002", Some(true)),
        // At the limit chance decides: a quarter of the frames arrives.
        ("0.003", None),
        // The reason differs: a silence, a missing answer, or a message that was resent too often.
        ("0.004", Some(false)),
        ("0.005", Some(false)),
        ("0.01", Some(false)),
    ] {
        let native = job_with_bit_errors("sim", rate);
        let emulated = job_with_bit_errors("pil:mps2", rate);
        if let Some(through) = through {
            assert_eq!(native.is_ok(), through, "at {rate}: {:?}", native.err());
        }
        match (&native, &emulated) {
            (Ok(native), Ok(emulated)) => {
                assert!(native == emulated, "at {rate} the recordings differ");
            }
            (Err(native), Err(emulated)) => {
                assert_eq!(native, emulated);
                let words = [" broken frames", "line", "check cable, shield and speed"];
                assert!(words.iter().all(|word| native.contains(word)), "{native}");
                println!("bit errors of {rate}: {native}");
            }
            _ => panic!(
                "at {rate}: {:?} natively, {:?} on the chip",
                native.err(),
                emulated.err()
            ),
        }
    }
}

/// Sends configurations that do not fit. Returns the answers.
fn invalid_configurations<C: Control>(mut bench: Bench<C>) -> Vec<Result<(), Refusal>> {
    bench.steps(500);
    let (bytes, crc) = bench.machine.encoded().expect("encodes");
    let chunk = |offset: usize, bytes: &[u8]| {
        Command::Configure(ConfigChunk {
            offset: offset as u16,
            bytes: bytes.iter().copied().collect(),
        })
    };
    let activate = |length: usize, crc: u32| Command::Activate {
        length: length as u16,
        crc,
        at_preset: false,
    };
    let mut answers = Vec::new();
    // The configuration is larger than the staging memory.
    for offset in (0..1200).step_by(CONFIG_CHUNK) {
        answers.push(bench.ask(chunk(offset, &[7; CONFIG_CHUNK])));
    }
    // The configuration is invalid, truncated, or has a wrong CRC.
    answers.push(bench.ask(activate(960, 0)));
    for (index, part) in bytes.chunks(CONFIG_CHUNK).enumerate() {
        answers.push(bench.ask(chunk(index * CONFIG_CHUNK, part)));
    }
    answers.push(bench.ask(activate(bytes.len() - 1, crc)));
    answers.push(bench.ask(activate(bytes.len(), crc ^ 1)));
    answers.push(bench.ask(Command::Enable));
    // The valid one is accepted after all that.
    answers.push(bench.ask(activate(bytes.len(), crc)));
    answers.push(bench.ask(Command::Enable));
    answers
}

#[test]
fn invalid_configurations_are_refused_as_natively() {
    let options = RigOptions::default();
    let native = invalid_configurations(Bench::with_options(&options));
    assert!(
        native.iter().filter(|answer| answer.is_err()).count() >= 4,
        "{native:?}"
    );
    assert_eq!(native[native.len() - 2..], [Ok(()), Ok(())]);
    assert_eq!(invalid_configurations(bench(Board::Mps2, &options)), native);
}

/// Runs a machine in motion on a chip with a budget of `share` of the mean instructions of a
/// period. Returns how it ended, and the number of missed periods.
fn with_budget(share: f64) -> (Bench<Remote>, u64) {
    let mut setup = Scene::new(bench(Board::Mps2, &RigOptions::default()));
    setup.quiet(1);
    let control = setup.bench.rig.control_mut();
    let cost = control.cost().lock().expect("not poisoned").clone();
    let mean = cost.sums.iter().sum::<u64>() as f64 / cost.periods as f64;
    control.set_budget((mean * share) as u32);
    let mut missed = 0;
    for _ in 0..4000 {
        setup.step(&[]);
        missed += u64::from(
            setup
                .deeds
                .last()
                .map_or(0, |period_result| period_result.missed),
        );
    }
    (setup.bench, missed)
}

#[test]
fn a_period_with_too_many_instructions_misses_the_next_ones() {
    // Two of three periods are missed.
    let (mut bench, missed) = with_budget(0.4);
    assert!(bench.wait_for(State::Fault, 20_000));
    let status = bench.status();
    println!("{missed} periods missed: {:?}", status.fault);
    assert!(missed > 5);
    let late = matches!(status.fault, Some(Fault::MissedPeriods { .. }));
    assert!(late, "{status:?}");
    assert_eq!(status.state, State::Fault);
    // The machine braked along its path: the drives are on, and it is at standstill.
    let outputs = bench.rig.outputs().joints;
    assert!(outputs[..5].iter().all(|axis| *axis != DriveCommand::Off));
    let before = bench.rig.truth().pose;
    bench.steps(500);
    let after = bench.rig.truth().pose;
    let moved = |axis: usize| (after[axis] - before[axis]).abs();
    let moved = (0..3).map(moved).fold(0.0, f64::max);
    assert!(moved < 0.02, "{moved} mm");
}

#[test]
fn a_period_within_its_instructions_misses_none() {
    let (mut bench, missed) = with_budget(20.0);
    assert_eq!((missed, bench.status().state), (0, State::Run));
}
