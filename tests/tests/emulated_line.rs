//! The host's line to the emulated chip at its worst: bit errors, garbage, floods, a stop in the middle of one, configurations that do not fit. What the chip
//! does is what the controller in this process does, bit for bit. And periods that take too many instructions.
//!
//! Needs the feature `emulated`; see `emulated.rs`.

mod chip;

use chip::{BOARDS, Deed, Remote, assert_same, bench, deed};
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
use haptimill_protocol::urgent::STOP;
use haptimill_tests::{Bench, line_in_x};

/// A machine in the middle of a line at 10 mm/s, and what was done from there on.
struct Scene<C> {
    bench: Bench<C>,
    deeds: Vec<Deed>,
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

    /// One period in which the host says this besides.
    fn step(&mut self, besides: &[u8]) {
        self.bench
            .step_with_fault(|bytes| bytes.extend_from_slice(besides));
        assert_eq!(self.bench.rig.control().failure(), None);
        self.deeds.push(deed(&self.bench));
    }

    fn quiet(&mut self, periods: usize) {
        (0..periods).for_each(|_| self.step(&[]));
    }

    fn state(&self) -> State {
        let last = self.deeds.last().and_then(|deed| deed.snapshot);
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

/// Garbage, then floods that no ring holds, then a stop behind one: what is told at the end.
fn worst_line<C: Control>(bench: Bench<C>) -> (Vec<Deed>, Vec<Event>, u32, u32) {
    let mut scene = Scene::new(bench);
    let x = |scene: &Scene<C>| {
        scene
            .deeds
            .last()
            .and_then(|deed| deed.snapshot)
            .expect("configured")
            .commanded[0]
    };
    scene.quiet(1);
    // Shorter than the silence after which a host is lost: hardly a frame survives this.
    scene.garbage(2000);
    scene.quiet(500);
    let before = x(&scene);
    for _ in 0..3 {
        // Half as much again as the ring holds, in one period.
        scene.step(&[0x55; RING_BYTES * 3 / 2]);
        scene.quiet(150);
        assert_eq!(scene.state(), State::Run, "{:?}", scene.bench.events);
    }
    assert!(x(&scene) > before, "it stands");
    // A stop that finds the ring full.
    let mut flood = vec![0x55; RING_BYTES + 100];
    flood.extend_from_slice(&STOP);
    scene.step(&flood);
    scene.quiet(1);
    assert_eq!(scene.state(), State::Hold);
    // The link comes back by itself, and the job is still there.
    scene.quiet(4000);
    scene.bench.ask(Command::Resume).expect("goes on");
    assert!(scene.bench.wait_for(State::Idle, 60_000));
    let status = scene.bench.status();
    assert_eq!(status.fault, None);
    (
        scene.deeds,
        scene.bench.events,
        status.lost_bytes,
        status.bad_frames,
    )
}

/// A job over a line of 115,200 baud on which everything is wrong that can be, from the first byte on.
fn bad_line<C: Control>(bench: Bench<C>) -> (Vec<Deed>, Vec<Event>, LineCounters, u32) {
    let mut scene = Scene::new(bench);
    scene
        .bench
        .ask(Command::Telemetry { every: 50 })
        .expect("taken");
    scene.quiet(1);
    for _ in 0..40_000 {
        scene.step(&[]);
        if scene.state() == State::Idle {
            break;
        }
    }
    assert_eq!(scene.state(), State::Idle);
    let status = scene.bench.status();
    assert_eq!(status.fault, None);
    let count = scene.bench.rig.to_machine().count();
    (scene.deeds, scene.bench.events, count, status.bad_frames)
}

#[test]
fn a_bad_line_ends_as_it_does_natively() {
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
    let native = bad_line(Bench::with_options(&options));
    let count = native.2;
    assert!(
        count.flipped > 3 && count.dropped > 0 && count.duplicated > 0,
        "{count:?}"
    );
    assert!(native.3 > 3, "{} broken frames", native.3);
    for board in BOARDS {
        let emulated = bad_line(bench(board, &options));
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
fn floods_and_garbage_while_moving_do_what_they_do_natively() {
    let options = RigOptions::default();
    let native = worst_line(Bench::with_options(&options));
    assert!(native.2 as usize > RING_BYTES, "{} lost", native.2);
    assert!(native.3 > 10, "{} broken frames", native.3);
    for board in BOARDS {
        let emulated = worst_line(bench(board, &options));
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

/// A short job of `haptimill run` over a line of 115,200 baud that flips bits: every byte of its recording, or what is said instead.
fn job_with_bit_errors(port: &str, rate: &str) -> Result<Vec<u8>, String> {
    let out = chip::results(&format!("bit-errors-{rate}-{}", port.replace(':', "-")));
    std::fs::create_dir_all(&out).expect("made");
    let program = out.join("corner.ngc");
    let text = "G21 G90 G94\nM3 S12000\nG1 X5 F600\nG1 X0 Y4\nM5\nM30\n";
    std::fs::write(&program, text).expect("written");
    let fault = format!("link-errors rate={rate}");
    let more = ["--baud", "115200", "--fault", &fault];
    match chip::run(&program, port, &out, &more) {
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

/// Up to where the line gives up, and beyond: the same recording, or the same words, which name the cause and what to do.
#[test]
fn bit_errors_end_a_job_as_they_do_natively() {
    for (rate, through) in [
        ("0.0005", true),
        ("0.002", true),
        ("0.003", true),
        // What ends it differs: a silence, an answer that does not come, a message that does not get through.
        ("0.004", false),
        ("0.005", false),
        ("0.01", false),
    ] {
        let native = job_with_bit_errors("sim", rate);
        let emulated = job_with_bit_errors("pil:mps2", rate);
        assert_eq!(native.is_ok(), through, "at {rate}: {:?}", native.err());
        match (&native, &emulated) {
            (Ok(native), Ok(emulated)) => {
                assert!(native == emulated, "at {rate} the recordings differ");
            }
            (Err(native), Err(emulated)) => {
                assert_eq!(native, emulated);
                let told = [" broken frames", "line", "check cable, shield and speed"];
                assert!(told.iter().all(|word| native.contains(word)), "{native}");
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

/// Configurations that do not fit: what is answered.
fn misfits<C: Control>(mut bench: Bench<C>) -> Vec<Result<(), Refusal>> {
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
    // More than there is room for.
    for offset in (0..1200).step_by(CONFIG_CHUNK) {
        answers.push(bench.ask(chunk(offset, &[7; CONFIG_CHUNK])));
    }
    // Senseless, cut off, with a wrong check.
    answers.push(bench.ask(activate(960, 0)));
    for (index, part) in bytes.chunks(CONFIG_CHUNK).enumerate() {
        answers.push(bench.ask(chunk(index * CONFIG_CHUNK, part)));
    }
    answers.push(bench.ask(activate(bytes.len() - 1, crc)));
    answers.push(bench.ask(activate(bytes.len(), crc ^ 1)));
    answers.push(bench.ask(Command::Enable));
    // And the right one after all that.
    answers.push(bench.ask(activate(bytes.len(), crc)));
    answers.push(bench.ask(Command::Enable));
    answers
}

#[test]
fn configurations_that_do_not_fit_are_refused_as_natively() {
    let options = RigOptions::default();
    let native = misfits(Bench::with_options(&options));
    assert!(
        native.iter().filter(|answer| answer.is_err()).count() >= 4,
        "{native:?}"
    );
    assert_eq!(native[native.len() - 2..], [Ok(()), Ok(())]);
    assert_eq!(misfits(bench(Board::Mps2, &options)), native);
}

/// A machine in motion on a chip that has as many instructions for a period as `share` of what one takes in the mean: how it ended, and how many periods
/// were missed.
fn with_budget(share: f64) -> (Bench<Remote>, u64) {
    let mut scene = Scene::new(bench(Board::Mps2, &RigOptions::default()));
    scene.quiet(1);
    let control = scene.bench.rig.control_mut();
    let cost = control.cost().lock().expect("not poisoned").clone();
    let mean = cost.sums.iter().sum::<u64>() as f64 / cost.periods as f64;
    control.set_budget((mean * share) as u32);
    let mut missed = 0;
    for _ in 0..4000 {
        scene.step(&[]);
        missed += u64::from(scene.deeds.last().map_or(0, |deed| deed.missed));
    }
    (scene.bench, missed)
}

#[test]
fn a_period_that_takes_too_many_instructions_misses_the_next_ones() {
    // Two of three periods are missed.
    let (mut bench, missed) = with_budget(0.4);
    assert!(bench.wait_for(State::Fault, 20_000));
    let status = bench.status();
    println!("{missed} periods missed: {:?}", status.fault);
    assert!(missed > 5);
    let late = matches!(status.fault, Some(Fault::LatePeriod { .. }));
    assert!(late, "{status:?}");
    assert_eq!(status.state, State::Fault);
    // It was braked along its path: the drives have it in hand, and it stands.
    let outputs = bench.rig.outputs().axes;
    assert!(outputs[..5].iter().all(|axis| *axis != DriveCommand::Off));
    let before = bench.rig.truth().pose;
    bench.steps(500);
    let after = bench.rig.truth().pose;
    let moved = |axis: usize| (after[axis] - before[axis]).abs();
    let moved = (0..3).map(moved).fold(0.0, f64::max);
    assert!(moved < 0.02, "{moved} mm");
}

#[test]
fn a_period_within_its_instructions_misses_nothing() {
    let (mut bench, missed) = with_budget(20.0);
    assert_eq!((missed, bench.status().state), (0, State::Run));
}
