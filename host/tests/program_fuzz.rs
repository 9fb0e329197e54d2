//! Any bytes: the reader, and behind it the planner, answer or refuse; they never panic and never take for ever.
//!
//! Runs the seed corpus in `__fuzz__/` and random inputs for a bounded time; a failure prints its seed. With `cargo bolero test` it becomes a
//! coverage-guided fuzz target.

#[path = "plan/h4.rs"]
#[allow(dead_code)]
mod h4;

use haptimill::plan::Plan;
use haptimill::program::{Options, read};
use std::time::Duration;

#[test]
fn reader_takes_any_bytes() {
    let settings = h4::settings();
    let options = Options::h4(h4::HOME);
    bolero::check!()
        .with_max_len(4096)
        .with_iterations(20_000)
        .with_test_time(Duration::from_secs(4))
        .for_each(|input: &[u8]| {
            match read("fuzz.ngc", input, &options) {
                Err(refused) => assert!(!refused.problems.is_empty()),
                Ok(program) => {
                    // What was understood is planned or refused, and ends at rest.
                    if program.steps.len() <= 200
                        && let Ok(plan) = Plan::new(&program, &settings, &h4::H4)
                    {
                        let last = plan.setpoints.last().expect("a plan has a setpoint");
                        assert!(last.rates.iter().all(|&rate| rate == 0));
                        assert!(plan.setpoints.iter().all(|setpoint| setpoint.periods >= 1));
                    }
                }
            }
        });
}
