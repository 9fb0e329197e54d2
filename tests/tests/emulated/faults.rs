//! Failures of an image: a panic in each stage, a processor fault, a stack overflow, an endless
//! period.
//!
//! The drives go off, the reason reaches the host, and the command ends with an error.
//!
//! Needs the feature `emulated`; see `emulated.rs`.

use crate::emulator;
use emulator::{BOARDS, Remote, image, remote, results, root, run};
use haptimill::commands::Exit;
use haptimill_client::port::Board;
use haptimill_firmware::io::DriveCommand;
use haptimill_firmware::profiler::Stage;
use haptimill_hil_sim::rig::{Control, RigOptions};
use haptimill_protocol::message::Command;
use haptimill_tests::Bench;
use std::time::{Duration, Instant};

/// Names of the stages of a control period, and of the main program between two periods.
fn places() -> impl Iterator<Item = &'static str> {
    Stage::ALL.into_iter().map(Stage::name).chain(["main"])
}

/// A period in which the drives are on.
const PERIOD: u32 = 4000;

/// Enables the drives of an image with an injected failure and waits for it. Returns the reason,
/// and the duration of the step that noticed it.
fn run_until_failure(board: Board, words: &[&str; 3]) -> (String, Duration) {
    let control = remote(board, &image("faults"), words);
    let mut bench: Bench<Remote> = Bench::with(&RigOptions::default(), control);
    bench.steps(500);
    bench.configure();
    bench.ask(Command::Enable).expect("enabled");
    bench.steps(200);
    let off = |bench: &Bench<Remote>| {
        let outputs = bench.rig.outputs();
        let off = |joint: &DriveCommand| *joint == DriveCommand::Off;
        outputs.joints.iter().all(off) && outputs.spindle_rpm == 0
    };
    assert!(!off(&bench), "the drives are not on by period {PERIOD}");
    while bench.rig.inputs().period < u64::from(PERIOD) + 10 {
        let begun = Instant::now();
        bench.rig.step();
        if let Some(reason) = bench.rig.control().failure() {
            let reason = reason.to_string();
            assert_eq!(bench.rig.inputs().period, u64::from(PERIOD), "{words:?}");
            // The outputs are off in this period and take effect in the next one.
            assert!(off(&bench), "{words:?}");
            bench.rig.step();
            assert!(off(&bench), "{words:?}");
            return (reason, begun.elapsed());
        }
    }
    panic!("{words:?}: nothing happened");
}

#[test]
fn a_panic_in_any_stage_switches_the_drives_off_and_is_reported() {
    for place in places() {
        let words = ["panic", place, &PERIOD.to_string()];
        let (reason, after) = run_until_failure(Board::Mps2, &words);
        println!("{place}, after {after:?}: {reason}");
        let cause = format!("injected in stage {place} of period {PERIOD}");
        assert!(reason.contains(&cause), "{reason}");
        assert!(reason.contains("panicked at"), "{reason}");
        assert!(after < Duration::from_secs(2), "{after:?}");
    }
}

#[test]
fn a_stack_overflow_is_reported() {
    for board in BOARDS {
        for what in ["recurse", "frame"] {
            for place in ["servo", "main"] {
                let (reason, after) = run_until_failure(board, &[what, place, &PERIOD.to_string()]);
                println!("{board}, {what} in {place}, after {after:?}: {reason}");
                assert!(reason.contains("the stack has overflown"), "{reason}");
                assert!(after < Duration::from_secs(2), "{after:?}");
            }
        }
    }
}

#[test]
fn a_processor_fault_is_reported() {
    for board in BOARDS {
        let words = ["fault", "supervise", &PERIOD.to_string()];
        let (reason, after) = run_until_failure(board, &words);
        println!("{board}, after {after:?}: {reason}");
        assert!(reason.contains("processor fault at 0x"), "{reason}");
        assert!(after < Duration::from_secs(2), "{after:?}");
    }
}

#[test]
fn an_endless_period_is_aborted() {
    let words = ["hang", "report", &PERIOD.to_string()];
    let (reason, after) = run_until_failure(Board::Mps2, &words);
    println!("after {after:?}: {reason}");
    assert!(reason.contains("did not answer"), "{reason}");
    assert!(after < Duration::from_millis(2500), "{after:?}");
}

/// The command fails while the machine homes: exit code 5, and the reason as text.
#[test]
fn the_command_reports_the_failure_and_exits_with_an_error() {
    let image = image("faults").display().to_string();
    let program = root().join("examples/e11-circle.ngc");
    for place in places() {
        let begun = Instant::now();
        let more = [
            "--image",
            &image,
            "--image-word",
            "panic",
            "--image-word",
            place,
            "--image-word",
            "8000",
        ];
        let error = run(&program, "pil:mps2", &results("panicked"), &more);
        let error = error.expect_err("the image panicked");
        println!("{place}, after {:?}: {error}", begun.elapsed());
        assert_eq!(error.exit, Exit::Port);
        let cause = format!("injected in stage {place} of period 8000");
        assert!(error.to_string().contains(&cause), "{error}");
    }
}
