//! The checks of `haptimill-checks` on the emulated chips, each in its own run. A failing check is
//! reported.
//!
//! Needs the feature `emulated`; see `emulated.rs`.

use crate::emulator;
use emulator::{BOARDS, image, run_alone};
use std::time::Instant;

#[test]
fn every_check_passes_on_the_chip() {
    let image = image("checks");
    for board in BOARDS {
        let (begun, mut failed) = (Instant::now(), Vec::new());
        let count = haptimill_checks::all().count();
        println!("\n{board}: running {count} checks");
        for check in haptimill_checks::all() {
            let (code, console) = run_alone(board, &image, &[check.name]);
            print!("{console}");
            if code != Some(0) || console != format!("test {} ... ok\n", check.name) {
                failed.push(check.name);
            }
        }
        println!(
            "{board}: check result: {}. {} passed; {} failed; finished in {:.2}s",
            if failed.is_empty() { "ok" } else { "FAILED" },
            count - failed.len(),
            failed.len(),
            begun.elapsed().as_secs_f64()
        );
        assert!(failed.is_empty(), "{board}: {failed:?}");
    }
}

#[test]
fn all_checks_pass_in_one_run() {
    let image = image("checks");
    let (code, console) = run_alone(BOARDS[0], &image, &[]);
    let names = haptimill_checks::all().map(|check| format!("test {} ... ok", check.name));
    assert_eq!(
        console.lines().collect::<Vec<_>>(),
        names.collect::<Vec<_>>()
    );
    assert_eq!(code, Some(0));
}

#[test]
fn a_failing_check_is_reported_with_name_reason_and_exit_code() {
    let image = image("checks");
    for board in BOARDS {
        let failing = haptimill_checks::FAILING.name;
        let (code, console) = run_alone(board, &image, &[failing]);
        assert_eq!(code, Some(101), "{console}");
        assert!(
            console.starts_with(&format!("test {failing} ... panicked")),
            "{console}"
        );
        assert!(console.contains("two and two"), "{console}");
        let (code, console) = run_alone(board, &image, &["no::such_check"]);
        assert_eq!(code, Some(101), "{console}");
    }
}
