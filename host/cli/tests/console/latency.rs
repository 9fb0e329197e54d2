//! Latency from a key press to motion, and from the last press or release to standstill: over a
//! pseudo-terminal, the real program and a TCP port, measured at the machine.
//!
//! `cargo test -p haptimill --release --test all latency -- --nocapture --test-threads 1`
//! prints the distributions. Only the bound of the jog timeout is asserted; the rest depends on
//! the computer.

use super::machine::{Machine, Sample};
use super::terminal::Keyboard;
use super::*;
use std::time::{Duration, Instant};

/// Presses of a distribution; a debug build only checks the bound.
const REPEATS: usize = if cfg!(debug_assertions) { 5 } else { 20 };

/// Threshold between motion and standstill of the tool, mm.
const STANDSTILL_MM: f64 = 0.005;

/// Deceleration from 5 mm/s with 5000 mm/s^3, ms.
const DECELERATION_MS: f64 = 63.3;

/// Times of one press, ms.
struct Press {
    to_commanded: f64,
    to_tool: f64,
    end_to_commanded: f64,
    end_to_tool: f64,
}

fn ms(from: Instant, to: Instant) -> f64 {
    to.saturating_duration_since(from).as_secs_f64() * 1000.0
}

/// Evaluates one press: the key was pressed at `pressed` and released at `released`.
fn evaluate(pressed: Instant, released: Instant, samples: &[Sample]) -> Press {
    let (first, last) = (samples[0], samples[samples.len() - 1]);
    let commanded = samples
        .iter()
        .find(|samples| samples.commanded != first.commanded);
    let tool = samples
        .iter()
        .find(|samples| (samples.tool - first.tool).abs() > STANDSTILL_MM);
    let still = |off: &dyn Fn(&Sample) -> bool| {
        let index = samples.iter().rposition(off).map_or(0, |index| index + 1);
        samples[index.min(samples.len() - 1)].at
    };
    Press {
        to_commanded: ms(pressed, commanded.unwrap().at),
        to_tool: ms(pressed, tool.unwrap().at),
        end_to_commanded: ms(
            released,
            still(&|samples| samples.commanded != last.commanded),
        ),
        end_to_tool: ms(
            released,
            still(&|samples| (samples.tool - last.tool).abs() > STANDSTILL_MM),
        ),
    }
}

fn print(what: &str, mut values: Vec<f64>) {
    values.sort_by(f64::total_cmp);
    let at = |part: f64| values[((values.len() - 1) as f64 * part).round() as usize];
    println!(
        "| {what} | {:.1} | {:.1} | {:.1} | {:.1} | {} |",
        at(0.0),
        at(0.5),
        at(0.95),
        at(1.0),
        values.len()
    );
}

fn measure(keyboard: Keyboard, down: &[u8], again: &[u8], up: Option<&[u8]>) -> Vec<Press> {
    let machine = Machine::start();
    let terminal = homed(&["--port", &machine.port], keyboard);
    let mut presses = Vec::new();
    for repeat in 0..=REPEATS {
        machine.wait_for_standstill(Duration::from_millis(250));
        machine.clear_samples();
        let pressed = Instant::now();
        terminal.press(down);
        let mut last = pressed;
        for _ in 0..5 {
            std::thread::sleep(Duration::from_millis(30));
            last = Instant::now();
            terminal.press(again);
        }
        if let Some(up) = up {
            std::thread::sleep(Duration::from_millis(20));
            last = Instant::now();
            terminal.press(up);
        }
        machine.wait_for_standstill(Duration::from_millis(250));
        // The first press shows the console which keyboard protocol the terminal has.
        if repeat > 0 {
            presses.push(evaluate(pressed, last, &machine.samples()));
        }
    }
    presses
}

fn report(which: &str, end: &str, presses: &[Press]) {
    println!(
        "\n| {which}, ms | min | median | p95 | max | n |\n| --- | --- | --- | --- | --- | --- |"
    );
    let column = |of: fn(&Press) -> f64| presses.iter().map(of).collect::<Vec<f64>>();
    print(
        "key to commanded motion",
        column(|press| press.to_commanded),
    );
    print("key to 5 um of the tool", column(|press| press.to_tool));
    print(
        &format!("{end} to commanded standstill"),
        column(|press| press.end_to_commanded),
    );
    print(
        &format!("{end} to the tool within 5 um of its final position"),
        column(|press| press.end_to_tool),
    );
}

#[test]
fn latency_of_a_keyboard_without_release_reports() {
    let presses = measure(Keyboard::Plain, RIGHT, RIGHT, None);
    report("presses only, jog timeout 200 ms", "last press", &presses);
    assert_eq!(presses.len(), REPEATS);
    for press in &presses {
        // The jog timeout is the bound, with half a second of margin for a busy computer.
        assert!(press.end_to_commanded < 200.0 + DECELERATION_MS + 500.0);
        // The motion is no shorter: repeats in time keep it alive.
        assert!(press.end_to_commanded > 150.0, "{}", press.end_to_commanded);
    }
}

#[test]
fn latency_of_a_keyboard_with_release_reports() {
    let presses = measure(
        Keyboard::Kitty,
        b"\x1b[1;1:1C",
        b"\x1b[1;1:2C",
        Some(b"\x1b[1;1:3C"),
    );
    report("releases reported (kitty protocol)", "release", &presses);
    assert_eq!(presses.len(), REPEATS);
    for press in &presses {
        assert!(press.end_to_commanded < 200.0 + DECELERATION_MS + 500.0);
    }
}
