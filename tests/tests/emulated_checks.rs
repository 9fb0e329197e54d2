//! The checks of `haptimill-checks` on the emulated chips, each in a run of its own; and that one which fails is reported as failed.
//!
//! Needs the feature `emulated`; see `emulated.rs`.

mod chip;

use chip::{BOARDS, image, run_alone};
use std::time::Instant;

#[test]
fn every_check_holds_on_the_chip() {
    let image = image("checks");
    for board in BOARDS {
        let (begun, mut failed) = (Instant::now(), Vec::new());
        let count = haptimill_checks::all().count();
        println!("\n{board}: running {count} checks");
        for check in haptimill_checks::all() {
            let (code, said) = run_alone(board, &image, &[check.name]);
            print!("{said}");
            if code != Some(0) || said != format!("test {} ... ok\n", check.name) {
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
fn all_checks_hold_in_one_run() {
    let image = image("checks");
    let (code, said) = run_alone(BOARDS[0], &image, &[]);
    let names = haptimill_checks::all().map(|check| format!("test {} ... ok", check.name));
    assert_eq!(said.lines().collect::<Vec<_>>(), names.collect::<Vec<_>>());
    assert_eq!(code, Some(0));
}

#[test]
fn a_check_that_fails_is_reported_with_its_name_its_reason_and_an_exit_code() {
    let image = image("checks");
    for board in BOARDS {
        let failing = haptimill_checks::FAILING.name;
        let (code, said) = run_alone(board, &image, &[failing]);
        assert_eq!(code, Some(101), "{said}");
        assert!(
            said.starts_with(&format!("test {failing} ... panicked")),
            "{said}"
        );
        assert!(said.contains("two and two"), "{said}");
        let (code, said) = run_alone(board, &image, &["no::such_check"]);
        assert_eq!(code, Some(101), "{said}");
    }
}
