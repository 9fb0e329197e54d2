//! Exit paths: the machine is left safe, the terminal restored.

use super::machine::Machine;
use super::scene::haptimill;
use super::terminal::Keyboard;
use super::*;
use haptimill_protocol::message::State;
use rustix::process::{Pid, Signal, kill_process};
use std::time::{Duration, Instant};

/// Holds a key down for a time, as a repeating keyboard does.
fn hold_down(terminal: &Terminal, key: &[u8], time: Duration) {
    let started = Instant::now();
    while started.elapsed() < time {
        terminal.press(key);
        std::thread::sleep(Duration::from_millis(30));
    }
}

pub fn signal(terminal: &Terminal, signal: Signal) {
    let process = Pid::from_raw(terminal.process() as i32).unwrap();
    kill_process(process, signal).unwrap();
}

/// The machine is idle within five seconds, and does not move afterwards.
fn assert_stays_idle(machine: &Machine) {
    let started = Instant::now();
    machine.wait_for_state(State::Idle);
    assert!(
        started.elapsed() < Duration::from_secs(5),
        "{:?}",
        started.elapsed()
    );
    let at = machine.now().commanded;
    std::thread::sleep(Duration::from_millis(900));
    let now = machine.now();
    assert_eq!((now.state, now.commanded), (State::Idle, at));
}

#[test]
fn closing_the_terminal_during_a_jog_stops_the_machine() {
    let machine = Machine::start();
    let mut terminal = homed(&["--port", &machine.port], Keyboard::Plain);
    hold_down(&terminal, RIGHT, Duration::from_millis(400));
    assert_eq!(machine.now().state, State::Jog);
    terminal.close();
    assert_stays_idle(&machine);
    assert_eq!(terminal.exit_code(), 7);
}

#[test]
fn closing_the_terminal_during_a_program_stops_the_machine_along_its_path() {
    let folder = scene::TestFolder::new();
    let program = folder.file("move.ngc", "G21 G90 F600\nG1 X100\nM30\n");
    let machine = Machine::start();
    let mut terminal = homed(&["--port", &machine.port, &program], Keyboard::Plain);
    run(&terminal);
    machine.wait_for_state(State::Run);
    std::thread::sleep(Duration::from_millis(500));
    terminal.close();
    // Stopped by command, not by the heartbeat fault after 500 ms.
    assert_stays_idle(&machine);
    assert!(machine.now().commanded < 50.0);
    assert_eq!(terminal.exit_code(), 7);
}

#[test]
fn killing_the_console_during_a_jog_stops_the_machine_by_the_jog_timeout() {
    let machine = Machine::start();
    let mut terminal = homed(&["--port", &machine.port], Keyboard::Plain);
    hold_down(&terminal, RIGHT, Duration::from_millis(400));
    assert_eq!(machine.now().state, State::Jog);
    signal(&terminal, Signal::KILL);
    let killed = Instant::now();
    assert_stays_idle(&machine);
    assert_eq!(terminal.exit_code(), -1);
    let samples = machine.samples();
    let mut moves = samples
        .windows(2)
        .filter(|two| two[0].commanded != two[1].commanded);
    let stood = moves.next_back().unwrap()[1]
        .at
        .saturating_duration_since(killed);
    // Timeout of the last command and 63 ms of deceleration; the rest is margin for a busy
    // computer.
    assert!(stood < Duration::from_millis(200 + 63 + 500), "{stood:?}");
}

#[test]
fn signals_end_the_console_and_the_terminal_is_restored() {
    for kind in [Signal::TERM, Signal::HUP, Signal::INT] {
        let mut terminal = console(&[], Keyboard::Kitty);
        terminal.expect_state("DISABLED");
        assert!(!terminal.is_restored());
        signal(&terminal, kind);
        assert_eq!(terminal.exit_code(), 7, "{kind:?}");
        assert!(terminal.is_restored(), "{kind:?}\n{}", terminal.text());
        terminal.expect_text("console ended by a signal; the machine is disabled");
    }
}

#[test]
fn terminal_loss_during_the_query_ends_the_console() {
    for closes in [true, false] {
        let mut terminal = console(&[], Keyboard::Silent);
        terminal.wait_until("took the terminal", |_| {
            terminal.with_screen(|screen| screen.alternate_screen())
        });
        let started = Instant::now();
        if closes {
            terminal.close();
        } else {
            signal(&terminal, Signal::TERM);
        }
        assert_eq!(terminal.exit_code(), 7);
        // The query of the terminal would wait two seconds for an answer.
        let took = started.elapsed();
        assert!(took < Duration::from_millis(1800), "{took:?}");
        assert!(closes || terminal.is_restored());
    }
}

#[test]
fn quit_asks_first_when_drives_are_on() {
    let machine = Machine::start();
    let mut terminal = homed(&["--port", &machine.port], Keyboard::Plain);
    terminal.press_expect(
        b"q",
        "Quit? the machine is at standstill; the drives stay on and hold.",
    );
    terminal.press(b"n");
    terminal.wait_until("closed the question", |text| !text.contains("Quit?"));
    terminal.press_expect(b"\x03", "Quit?");
    terminal.press(ENTER);
    assert_eq!(terminal.exit_code(), 0);
    terminal.expect_text("console quit; the machine is idle");
    assert!(terminal.is_restored());
    assert_eq!(machine.now().state, State::Idle);
}

#[test]
fn missing_terminal_and_invalid_arguments_are_usage_errors() {
    let ran = haptimill(&["console"]).expect_code(2);
    assert!(
        ran.err
            .contains("standard input is not a terminal; run it in one"),
        "{}",
        ran.err
    );
    assert_eq!(ran.out, "");
    haptimill(&["console", "--port", "pil:mps2"]).expect_code(2);
    haptimill(&["console", "--port", "tcp:localhost:1", "--seed", "3"]).expect_code(2);
    let operator = ["--operator", "examples/teleop.toml"];
    let remote = [&["console", "--port", "tcp:localhost:1"], &operator[..]].concat();
    let ran = haptimill(&remote).expect_code(2);
    assert!(
        ran.err.contains("give it to `haptimill sim serve`"),
        "{}",
        ran.err
    );
}

#[test]
fn absent_port_is_reported_at_the_start() {
    let mut terminal = console(&["--port", "tcp:127.0.0.1:1"], Keyboard::Plain);
    assert_eq!(terminal.exit_code(), 5);
    assert!(terminal.is_restored());
    let text = terminal.text();
    assert!(text.contains("cannot be opened"), "{text}");
}

#[test]
fn faults_are_shown_with_their_remedy() {
    let terminal = homed(
        &[
            "--fault",
            "emergency-stop at=8s for=1s",
            "--fault",
            "joint-jammed joint=l1 at=14s",
        ],
        Keyboard::Plain,
    );
    terminal.expect_state("EMERGENCY STOP");
    terminal.expect_text("EMERGENCY STOP: drives off. Remove the cause, then x resets");
    let reset = || {
        let started = Instant::now();
        while terminal.row(0).starts_with(" FAULT") || terminal.row(0).starts_with(" EMERG") {
            terminal.press(b"x");
            std::thread::sleep(Duration::from_millis(200));
            assert!(started.elapsed() < terminal::TIMEOUT, "{}", terminal.text());
        }
    };
    reset();
    terminal.press(b"e");
    terminal.expect_state("IDLE");
    // Jog in both directions until the slide jams.
    let started = Instant::now();
    for key in [RIGHT, LEFT].iter().cycle() {
        if terminal.row(0).starts_with(" FAULT") {
            break;
        }
        hold_down(&terminal, key, Duration::from_millis(300));
        assert!(started.elapsed() < terminal::TIMEOUT, "{}", terminal.text());
    }
    // Which of two faults it is depends on the moment: the following error exceeds its limit, or
    // the effort rises without a count. Both name the joint.
    terminal.expect_text("FAULT (x resets): the ");
    terminal.expect_text(" of l1 ");
    reset();
}
