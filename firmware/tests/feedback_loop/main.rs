//! The loop through the hand, all of it: the controller with its haptic arm, the watches over the
//! energy, the way from hand to tool, the mover that follows, the force loop and the peak over a
//! revolution are the firmware's own, driven period by period. In f64 are the hand, the motors'
//! lag, the drives' lag, the contact and the line ([`rig`]).
//!
//! `cargo test -p haptimill-firmware --test feedback_loop -- --nocapture` shows the sweep as a
//! table; `--ignored` the whole one, with more hands, contacts and lines.

#![allow(
    clippy::needless_range_loop,
    reason = "an index is an axis here, of several arrays at once"
)]

#[path = "../arm/mod.rs"]
mod arm;
#[path = "../haptics/bench.rs"]
mod bench;
mod rig;

use rig::{Case, Outcome, run};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// All cases, on as many threads as there are processors.
fn sweep(cases: &[Case]) -> Vec<Outcome> {
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

/// Sweeps, shows, and checks what holds for every hand, contact and line.
fn check(grips: &[f64], contacts: &[f64], delays: &[f64], yields: bool, time: f64, relapse: f64) {
    let mut cases = vec![];
    for &delay in delays {
        for &contact in contacts {
            for &grip in grips {
                cases.push(Case {
                    grip,
                    contact,
                    delay,
                    yields,
                    time,
                });
            }
        }
    }
    println!(
        "line ms  contact  hand N/mm  swing of the hand, mm: 3-15 s, then  of the force, N  largest N on the tool  felt N  felt / law"
    );
    let outcomes = sweep(&cases);
    for (case, out) in cases.iter().zip(&outcomes) {
        println!(
            "{:7.0} {:8.0} {:10.1}   {:28.3} {:8.3} {:16.2} {:21.1} {:8.3} {:10.3}",
            case.delay * 1e3,
            case.contact,
            case.grip,
            out.early,
            out.late,
            out.force_swing,
            out.peak,
            out.felt,
            out.felt / out.law
        );
    }
    for (case, out) in cases.iter().zip(&outcomes) {
        let place = format!("{case:?}\n{out:?}");
        assert!(out.runs, "the mill stopped: {place}");
        // Swings get smaller, or are below what a finger feels as motion; or they are one that came
        // back when its debt was forgiven, no larger than `relapse`.
        let most = (1.1 * out.early + 0.05).max(relapse);
        assert!(out.late <= most, "it grows: {place}");
        // A soft hand breathes by less than 2.5 mm, a firm one by less than one.
        assert!(
            out.late < if case.grip < 0.2 { 2.5 } else { 1.4 },
            "it swings: {place}"
        );
        let ratio = out.felt / out.law;
        if case.delay == 0.0 {
            assert!((0.95..=1.05).contains(&ratio), "{ratio:.3}: {place}");
        } else {
            // Wanted with a line of 50 ms: half of it. What there is:
            assert!((0.85..=1.15).contains(&ratio), "{ratio:.3}: {place}");
        }
        assert!(out.most <= 3.2, "beyond the limit: {place}");
        assert!(out.step <= 0.050_001, "beyond the step: {place}");
    }
}

/// Nothing grows, the hand feels what the law says, never more than the limit, and the mill goes
/// on.
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

/// The tool need not yield, as on a machine without force control.
#[test]
fn force_feedback_loop_is_stable_without_compliance() {
    check(&[0.3, 2.0], &[2.0, 20.0], &[0.0, 0.05], false, 27.0, 0.0);
}

/// The same with more of each, and means over 36 s where they are over 12 s above: a soft hand
/// breathes in seconds, and a mean over some breaths is off by 5 %. Within 51 s seven of 330 cells
/// swing up once more when their debt is forgiven, by 0.14 to 0.93 mm, until they owe again. Some
/// minutes.
#[test]
#[ignore = "long: run by hand when the loop is changed"]
fn the_whole_sweep() {
    let contacts = [
        1.0, 2.0, 5.0, 10.0, 20.0, 35.0, 50.0, 75.0, 100.0, 150.0, 200.0,
    ];
    check(
        &[0.1, 0.2, 0.3, 0.5, 1.0, 2.0],
        &contacts,
        &[0.0, 0.005, 0.01, 0.025, 0.05],
        true,
        51.0,
        1.0,
    );
}
