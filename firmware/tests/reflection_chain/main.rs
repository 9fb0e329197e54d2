//! The loop through the hand, all of it: the controller with its haptic arm, the watches over the energy, the way from hand to tool, the mover that follows, the force loop and the peak over a revolution are the
//! firmware's own, driven period by period. In f64 are the hand, the motors' lag, the drives' lag, the contact and the line.
//!
//! With a line there are two controllers, one with the arm and one with the mill; a word each way every 10 ms, so late as the line makes it. Without, one has both.
//!
//! The hand is a mass on spring and damper that follow an intention: 4 mm into the contact at 10 mm/s, and there it stays.
#![allow(
    clippy::needless_range_loop,
    reason = "an index is an axis here, of several arrays at once"
)]

#[path = "../arm/mod.rs"]
mod arm;
#[path = "../hand/bed.rs"]
mod bed;
mod rig;

use rig::{Case, Outcome, run};

const GRIPS: [f64; 4] = [0.1, 0.3, 1.0, 2.0];
const CONTACTS: [f64; 6] = [2.0, 10.0, 20.0, 50.0, 100.0, 200.0];
const DELAYS: [f64; 4] = [0.0, 0.01, 0.025, 0.05];

/// All cases, on as many threads as there are processors.
fn sweep(cases: &[Case]) -> Vec<Outcome> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let next = std::sync::atomic::AtomicUsize::new(0);
    let mut outcomes = vec![None; cases.len()];
    let done = std::sync::Mutex::new(&mut outcomes);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                loop {
                    let index = next.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                    let Some(case) = cases.get(index) else { break };
                    let outcome = run(case);
                    done.lock().expect("no panic")[index] = Some(outcome);
                }
            });
        }
    });
    outcomes.into_iter().map(|outcome| outcome.expect("done")).collect()
}

fn table(cases: &[Case]) -> Vec<Outcome> {
    let outcomes = sweep(cases);
    println!("grip  contact delay  swing mm: early  late   N: late  peak   felt N  law N  felt/law  state");
    for (case, out) in cases.iter().zip(&outcomes) {
        println!(
            "{:4.1} {:7.0} {:4.0}          {:8.3} {:6.3}   {:6.2} {:6.1}   {:5.3} {:6.3}   {:5.3}   {} {:.2}",
            case.grip, case.contact, case.delay * 1e3, out.early, out.late, out.force_swing, out.peak, out.felt, out.law, out.felt / out.law, out.state, out.damped
        );
    }
    outcomes
}

#[test]
fn the_whole_chain() {
    let mut cases = vec![];
    if std::env::var("QUICK").is_ok() {
        for delay in [0.0, 0.05] {
            for contact in [2.0, 20.0, 200.0] {
                for grip in [0.1, 0.3, 2.0] {
                    cases.push(Case { grip, contact, delay, ..Case::default() });
                }
            }
        }
        table(&cases);
        return;
    }
    for delay in DELAYS {
        for contact in CONTACTS {
            for grip in GRIPS {
                cases.push(Case { grip, contact, delay, ..Case::default() });
            }
        }
    }
    table(&cases);
}

#[test]
#[ignore = "look"]
fn look() {
    let get = |name: &str, default: f64| std::env::var(name).map_or(default, |text| text.parse().unwrap());
    let case = Case { grip: get("GRIP", 0.3), contact: get("CONTACT", 200.0), delay: get("DELAY", 0.0), time: get("TIME", 6.0), ..Case::default() };
    let mut k = 0;
    let every = get("EVERY", 100.0) as usize;
    let outcome = rig::trace(&case, |moment| {
        if k % every == 0 {
            println!("{:6.3} hand {:7.3} tool {:7.3} F {:6.1} felt {:6.3} reflected {:6.3}", moment.time, moment.hand, moment.tool, moment.force, moment.felt, moment.reflected);
        }
        k += 1;
    });
    println!("{outcome:?}");
}
