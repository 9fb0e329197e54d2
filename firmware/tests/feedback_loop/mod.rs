//! The closed loop of force feedback through the operator's hand.
//!
//! The firmware's own code runs period by period: the controller with its haptic arm, the passivity
//! observers, the master-to-tool mapping, the tracking profile generator, the force loop and the
//! peak force over a revolution. A model in f64 ([`rig`]) has the hand, the lag of the motors, the
//! lag of the drives, the contact and the line.
//!
//! `cargo test -p haptimill-firmware --test all feedback_loop -- --nocapture` prints a table of the
//! cases. `--ignored` runs more hands, contacts and delays.

#![allow(
    clippy::needless_range_loop,
    reason = "an index is an axis here, of several arrays at once"
)]

mod rig;

use rig::{Case, CaseResult, run};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// All cases, on as many threads as there are processors.
fn run_all(cases: &[Case]) -> Vec<CaseResult> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let next = AtomicUsize::new(0);
    let outcomes = Mutex::new(vec![None; cases.len()]);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while let Some((index, case)) = {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    cases.get(index).map(|case| (index, case))
                } {
                    let outcome = run(case);
                    outcomes.lock().expect("no panic")[index] = Some(outcome);
                }
            });
        }
    });
    let outcomes = outcomes.into_inner().expect("no panic");
    outcomes.into_iter().flatten().collect()
}

/// Runs all combinations, prints them, and checks what holds for every hand, contact and delay.
fn check(
    grips: &[f64],
    contacts: &[f64],
    delays: &[f64],
    compliant: bool,
    time: f64,
    returned: f64,
) {
    let mut cases = vec![];
    for &delay in delays {
        for &contact in contacts {
            for &grip in grips {
                cases.push(Case {
                    grip,
                    contact,
                    delay,
                    compliant,
                    time,
                });
            }
        }
    }
    println!(
        "line ms  contact  hand N/mm  oscillation of the hand, mm: 3-15 s, then  of the force, N  largest N on the tool  hand N  hand / law"
    );
    let outcomes = run_all(&cases);
    for (case, out) in cases.iter().zip(&outcomes) {
        println!(
            "{:7.0} {:8.0} {:10.1}   {:28.3} {:8.3} {:16.2} {:21.1} {:8.3} {:10.3}",
            case.delay * 1e3,
            case.contact,
            case.grip,
            out.early,
            out.late,
            out.force_oscillation,
            out.peak,
            out.force,
            out.force / out.law
        );
    }
    for (case, out) in cases.iter().zip(&outcomes) {
        let case_text = format!("{case:?}\n{out:?}");
        assert!(out.runs, "the mill stopped: {case_text}");
        // The oscillation decays, or is below the threshold of perception, or is one that returned
        // after the leak of the energy deficit, no larger than `returned`.
        let max = (1.1 * out.early + 0.05).max(returned);
        assert!(out.late <= max, "the oscillation grows: {case_text}");
        // A soft grip oscillates slowly by less than 2.5 mm, a firm one by less than 1.4 mm.
        assert!(
            out.late < if case.grip < 0.2 { 2.5 } else { 1.4 },
            "the oscillation is too large: {case_text}"
        );
        let ratio = out.force / out.law;
        if case.delay == 0.0 {
            assert!((0.95..=1.05).contains(&ratio), "{ratio:.3}: {case_text}");
        } else {
            // A delay of 50 ms costs accuracy. The bound is the measured one.
            assert!((0.85..=1.15).contains(&ratio), "{ratio:.3}: {case_text}");
        }
        assert!(out.max <= 3.2, "beyond the limit: {case_text}");
        assert!(out.step <= 0.050_001, "beyond the step: {case_text}");
    }
}

/// No oscillation grows, the force feedback follows its law within its limit, and the mill keeps
/// running.
#[test]
fn force_feedback_loop_is_stable() {
    check(
        &[0.1, 0.3, 1.0, 2.0],
        &[2.0, 20.0, 50.0, 200.0],
        &[0.0, 0.01, 0.05],
        true,
        27.0,
        0.0,
    );
}

/// The same without compliance, as on a machine without force control.
#[test]
fn force_feedback_loop_is_stable_without_compliance() {
    check(&[0.3, 2.0], &[2.0, 20.0], &[0.0, 0.05], false, 27.0, 0.0);
}

/// The same with more cases, and means over 36 s instead of 12 s: a soft grip oscillates with a
/// period of seconds, and a mean over a few periods is off by 5 %. Within 51 s eight of 330 cases
/// oscillate once more after the leak of their energy deficit, by 0.22 to 1.04 mm. Which ones and
/// by how much depends on changes of 0.2 % of the stiffness of the hand. Takes minutes.
#[test]
#[ignore = "long: run by hand when the loop is changed"]
fn force_feedback_loop_is_stable_in_all_cases() {
    let contacts = [
        1.0, 2.0, 5.0, 10.0, 20.0, 35.0, 50.0, 75.0, 100.0, 150.0, 200.0,
    ];
    check(
        &[0.1, 0.2, 0.3, 0.5, 1.0, 2.0],
        &contacts,
        &[0.0, 0.005, 0.01, 0.025, 0.05],
        true,
        51.0,
        1.2,
    );
}
