//! Jogs and steps by keys.

use super::terminal::Keyboard;
use super::*;
use machine::Machine;
use std::time::{Duration, Instant};

/// Commanded coordinate of an axis on the screen, at standstill.
#[track_caller]
fn at(terminal: &Terminal, axis: &str) -> f64 {
    terminal.expect_state("IDLE");
    // The displayed state may be older than the end of the motion.
    std::thread::sleep(Duration::from_millis(120));
    terminal
        .number(axis, 1)
        .unwrap_or_else(|| panic!("no {axis} in\n{}", terminal.text()))
}

#[test]
fn every_axis_jogs_both_ways_and_stops_after_the_jog_timeout() {
    let terminal = homed(&[], Keyboard::Plain);
    for (axis, up, down) in [
        ("x", RIGHT, LEFT),
        ("y", UP, DOWN),
        ("z", PAGE_UP, PAGE_DOWN),
        ("theta", b".".as_slice(), b",".as_slice()),
        ("alpha", b"m".as_slice(), b"n".as_slice()),
    ] {
        let before = at(&terminal, axis);
        terminal.press(up);
        terminal.expect_state("JOG");
        let after = at(&terminal, axis);
        // At most 5 mm/s for 200 ms; less when a busy computer delayed the simulated machine, never
        // more.
        let travel = after - before;
        assert!((0.2..1.15).contains(&travel), "{axis} {before} {after}");
        terminal.press(down);
        terminal.expect_state("JOG");
        let back = at(&terminal, axis);
        let travel = after - back;
        assert!((0.2..1.15).contains(&travel), "{axis} {after} {back}");
    }
    // A lower rate moves less far.
    terminal.press_expect(b"sss", "continuous 0.5 mm/s");
    let before = at(&terminal, "x");
    terminal.press(RIGHT);
    terminal.expect_state("JOG");
    let after = at(&terminal, "x");
    assert!((0.02..0.12).contains(&(after - before)), "{before} {after}");
}

#[test]
fn steps_are_exact_and_one_per_key_press() {
    let terminal = homed(&[], Keyboard::Plain);
    terminal.press_expect(b"\t", "step 0.1 mm");
    let before = at(&terminal, "y");
    terminal.press_expect(b"ss", "step 0.001 mm");
    for _ in 0..3 {
        terminal.press(UP);
        std::thread::sleep(Duration::from_millis(300));
    }
    let after = at(&terminal, "y");
    assert!((after - before - 0.003).abs() < 1e-6, "{before} {after}");
    terminal.press_expect(b"ffff", "step 10 mm");
    terminal.press(DOWN);
    terminal.expect_state("RUN");
    let down = at(&terminal, "y");
    assert!((down - after + 10.0).abs() < 1e-6, "{after} {down}");
    // Hold ends a step and leaves nothing to resume. The state is shown before the first motion.
    terminal.press(UP);
    terminal.expect_state("RUN");
    let has_moved = |_: &str| terminal.number("y", 1).is_some_and(|y| y > down);
    terminal.wait_until("y above the end of the step", has_moved);
    terminal.press(SPACE);
    let stopped = at(&terminal, "y");
    assert!(stopped > down && stopped < down + 9.9, "{down} {stopped}");
    // A rotary axis moves in steps of degrees.
    terminal.press_expect(b"s", "step 1 mm");
    let tilt = at(&terminal, "theta");
    terminal.press(b".");
    terminal.expect_state("RUN");
    assert!((at(&terminal, "theta") - tilt - 1.0).abs() < 1e-6);
}

#[test]
fn held_key_keeps_jogging_and_release_stops_at_once() {
    let machine = Machine::start();
    let terminal = homed(&["--port", &machine.port], Keyboard::Kitty);
    // The first release shows that the terminal reports releases.
    terminal.press(b"\x1b[1;1:1C");
    machine.wait_for_state(haptimill_protocol::message::State::Jog);
    terminal.press(b"\x1b[1;1:3C");
    machine.wait_for_standstill(Duration::from_millis(300));
    terminal.expect_text("ends on release");
    // Longer than the jog timeout without a repeat, as before a keyboard starts to repeat.
    terminal.press(b"\x1b[1;1:1C");
    let started = Instant::now();
    std::thread::sleep(Duration::from_millis(450));
    assert_eq!(machine.now().state, haptimill_protocol::message::State::Jog);
    for _ in 0..10 {
        terminal.press(b"\x1b[1;1:2C");
        std::thread::sleep(Duration::from_millis(30));
    }
    let released = machine.now().commanded;
    terminal.press(b"\x1b[1;1:3C");
    machine.wait_for_standstill(Duration::from_millis(300));
    let travel = machine.now().commanded - released;
    // 5 mm/s during the latency of the release, then 63 ms of deceleration; without the release it
    // would be 1 mm or more.
    assert!(
        travel < 0.7 || started.elapsed() > Duration::from_secs(3),
        "{travel} mm after the release"
    );
    // Repeats of a key that a hold released move nothing.
    terminal.press(b"\x1b[1;1:1C");
    machine.wait_for_state(haptimill_protocol::message::State::Jog);
    terminal.press(SPACE);
    machine.wait_for_standstill(Duration::from_millis(400));
    let stopped = machine.now().commanded;
    for _ in 0..5 {
        terminal.press(b"\x1b[1;1:2C");
        std::thread::sleep(Duration::from_millis(30));
    }
    machine.wait_for_standstill(Duration::from_millis(200));
    assert_eq!(machine.now().commanded, stopped);
}

#[test]
fn jog_is_refused_when_not_ready_and_pasted_text_is_ignored() {
    let terminal = console(&[], Keyboard::Plain);
    terminal.expect_state("DISABLED");
    terminal.press_expect(RIGHT, "jog: not possible while the machine is disabled");
    terminal.press(b"e");
    terminal.expect_state("IDLE");
    terminal.press_expect(RIGHT, "jog: home the machine first");
    // Pasted text and a split escape sequence are not key input.
    terminal.press_expect(
        b"\x1b[200~hhh\reee\x1b[201~",
        "pasted text is not taken as key input",
    );
    terminal.press(b"[C");
    terminal.press(b"[15~ABCD");
    std::thread::sleep(Duration::from_millis(200));
    assert!(terminal.text().contains("continuous 5 mm/s"));
    assert!(!terminal.text().contains("Home?"), "{}", terminal.text());
}
