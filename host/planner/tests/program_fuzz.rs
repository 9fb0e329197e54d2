//! Fuzz tests of the part-program reader and the planner: any bytes are planned or refused, without
//! panic and in bounded time.
//!
//! Two targets use one seed corpus (`__fuzz__/reader/corpus`), each for a bounded time; a failure
//! prints its seed. Raw bytes seldom pass the first word, so the second target edits the seeds.
//! With `cargo bolero test` both are coverage-guided.

#[path = "plan/h4.rs"]
#[allow(dead_code)]
mod h4;

use haptimill_gcode::{LISTED_PROBLEMS, Options, Tool, ToolAxis, read};
use haptimill_planner::Plan;
use std::time::Duration;

const SEEDS: [&[u8]; 13] = [
    include_bytes!("__fuzz__/reader/corpus/lines.ngc"),
    include_bytes!("__fuzz__/reader/corpus/arcs.ngc"),
    include_bytes!("__fuzz__/reader/corpus/five-axis.ngc"),
    include_bytes!("__fuzz__/reader/corpus/modes.ngc"),
    include_bytes!("__fuzz__/reader/corpus/bytes.ngc"),
    include_bytes!("__fuzz__/reader/corpus/wrong.ngc"),
    include_bytes!("__fuzz__/reader/corpus/numbers.ngc"),
    include_bytes!("__fuzz__/reader/corpus/tiny.ngc"),
    include_bytes!("__fuzz__/reader/corpus/order.ngc"),
    include_bytes!("__fuzz__/reader/corpus/cycles.ngc"),
    include_bytes!("__fuzz__/reader/corpus/compensation.ngc"),
    include_bytes!("__fuzz__/reader/corpus/splines.ngc"),
    include_bytes!("__fuzz__/reader/corpus/offsets.ngc"),
];

/// Reads and plans a program on each machine. Returns whether one of them planned it.
fn run(text: &[u8]) -> bool {
    let mut planned = false;
    for options in options() {
        planned |= run_with(text, &options);
    }
    planned
}

/// The options of machines that differ: without and with tools, offsets, coolant and outputs.
fn options() -> [Options; 2] {
    let plain = Options::of_letters("XYZBA", h4::HOME);
    let mut full = Options {
        coolant: true,
        outputs: true,
        block_delete: true,
        no_decimal: true,
        tool: 2,
        tool_axis: ToolAxis {
            tip: [0, 1, 2],
            tilt: Some(3),
            ..ToolAxis::default()
        },
        ..plain.clone()
    };
    for number in 1..=3 {
        let length = f64::from(number);
        let offset = [0.0, 0.0, length, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let diameter = 2.0 * length;
        full.tools.insert(number, Tool { offset, diameter });
    }
    full.offsets.systems[0].origin[0] = 1.5;
    full.offsets.systems[1].rotation = 30.0;
    [plain, full]
}

/// Reads and plans a program with these options. Returns whether it was planned.
fn run_with(text: &[u8], options: &Options) -> bool {
    match read("fuzz.ngc", text, options) {
        Err(refused) => {
            assert!((1..=LISTED_PROBLEMS).contains(&refused.problems.len()));
            assert!(refused.to_string().starts_with("fuzz.ngc:"));
            false
        }
        Ok(program) => match Plan::new(&program, &h4::settings(), &h4::H4) {
            Err(refused) => {
                assert!(!refused.problems.is_empty());
                false
            }
            Ok(plan) => {
                let last = plan.setpoints.last().expect("a plan has a setpoint");
                assert!(
                    last.rates.iter().all(|&rate| rate == 0),
                    "the motion does not end at standstill"
                );
                assert!(plan.setpoints.iter().all(|setpoint| setpoint.periods >= 1));
                assert!(
                    plan.figures.duration_s.is_finite() && plan.figures.path_length_mm.is_finite()
                );
                true
            }
        },
    }
}

#[test]
fn any_bytes_are_parsed_or_refused() {
    bolero::check!(name = "reader")
        .with_max_len(4096)
        .with_iterations(50_000)
        .with_test_time(Duration::from_secs(3))
        .for_each(|input: &[u8]| {
            run(input);
        });
}

#[test]
fn edited_programs_are_planned_or_refused() {
    // Characters of part programs, so that an edit is more likely to be valid.
    const ALPHABET: &[u8] = b"GXYZABIJKRFSMNPODHLQ0123456789.- \n%();[]#<>@^/+*=";
    bolero::check!(name = "edits")
        .with_max_len(64)
        .with_iterations(20_000)
        .with_test_time(Duration::from_secs(4))
        .for_each(|input: &[u8]| {
            let Some((&seed, edits)) = input.split_first() else {
                return;
            };
            let mut text = SEEDS[usize::from(seed) % SEEDS.len()].to_vec();
            for edit in edits.chunks_exact(3) {
                let at = usize::from(edit[0]) % text.len().max(1);
                let byte = ALPHABET[usize::from(edit[1]) % ALPHABET.len()];
                match edit[2] % 4 {
                    0 => text.insert(at, byte),
                    1 if at < text.len() => text[at] = byte,
                    2 if at < text.len() => drop(text.remove(at)),
                    _ => text.insert(at, edit[1]),
                }
            }
            run(&text);
        });
}

#[test]
fn seeds_reach_the_planner() {
    let planned = SEEDS.iter().filter(|seed| run(seed)).count();
    assert!(
        planned >= 9,
        "only {planned} seeds are planned: edits of them would test the lexer alone"
    );
}
