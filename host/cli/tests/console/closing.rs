//! Ways out: the machine is left safe, the terminal as it was.

use super::machine::Machine;
use super::scene::haptimill;
use super::terminal::Keyboard;
use super::*;
use haptimill_protocol::message::State;
use rustix::process::{Pid, Signal, kill_process};
use std::time::{Duration, Instant};

/// Holds a key down for a while, as a keyboard that repeats.
fn hold_down(terminal: &Terminal, key: &[u8], time: Duration) {
    let begun = Instant::now();
    while begun.elapsed() < time {
        terminal.keys(key);
        std::thread::sleep(Duration::from_millis(30));
    }
}

pub fn signal(terminal: &Terminal, signal: Signal) {
    let process = Pid::from_raw(terminal.process() as i32).unwrap();
    kill_process(process, signal).unwrap();
}

/// The machine stands idle within a second, and nothing moves it afterwards.
fn stands(machine: &Machine) {
    let begun = Instant::now();
    machine.comes_to(State::Idle);
    assert!(
        begun.elapsed() < Duration::from_secs(5),
        "{:?}",
        begun.elapsed()
    );
    let at = machine.now().commanded;
    std::thread::sleep(Duration::from_millis(900));
    let now = machine.now();
    assert_eq!((now.state, now.commanded), (State::Idle, at));
}

#[test]
fn a_terminal_that_is_closed_in_a_jog_stops_the_machine() {
    let machine = Machine::start();
    let mut terminal = homed(&["--port", &machine.port], Keyboard::Plain);
    hold_down(&terminal, RIGHT, Duration::from_millis(400));
    assert_eq!(machine.now().state, State::Jog);
    terminal.close();
    stands(&machine);
    assert_eq!(terminal.end(), 7);
}

#[test]
fn a_terminal_that_is_closed_in_a_program_stops_the_machine_along_its_path() {
    let folder = scene::TestFolder::new();
    let program = folder.file("way.ngc", "G21 G90 F600\nG1 X100\nM30\n");
    let machine = Machine::start();
    let mut terminal = homed(&["--port", &machine.port, &program], Keyboard::Plain);
    run(&terminal);
    machine.comes_to(State::Run);
    std::thread::sleep(Duration::from_millis(500));
    terminal.close();
    // Stopped by command, not by a fault after half a second of silence.
    stands(&machine);
    assert!(machine.now().commanded < 50.0);
    assert_eq!(terminal.end(), 7);
}

#[test]
fn a_console_that_is_killed_in_a_jog_stops_the_machine_by_its_dead_man() {
    let machine = Machine::start();
    let mut terminal = homed(&["--port", &machine.port], Keyboard::Plain);
    hold_down(&terminal, RIGHT, Duration::from_millis(400));
    assert_eq!(machine.now().state, State::Jog);
    signal(&terminal, Signal::KILL);
    let killed = Instant::now();
    stands(&machine);
    assert_eq!(terminal.end(), -1);
    let seen = machine.seen();
    let mut moves = seen
        .windows(2)
        .filter(|two| two[0].commanded != two[1].commanded);
    let stood = moves.next_back().unwrap()[1]
        .at
        .saturating_duration_since(killed);
    // The deadline of the last command, and 63 ms of braking; the rest is for a busy computer.
    assert!(stood < Duration::from_millis(200 + 63 + 500), "{stood:?}");
}

#[test]
fn signals_end_the_console_and_the_terminal_is_as_before() {
    for kind in [Signal::TERM, Signal::HUP, Signal::INT] {
        let mut terminal = console(&[], Keyboard::Kitty);
        terminal.state("DISABLED");
        assert!(!terminal.is_as_before());
        signal(&terminal, kind);
        assert_eq!(terminal.end(), 7, "{kind:?}");
        assert!(terminal.is_as_before(), "{kind:?}\n{}", terminal.text());
        terminal.sees("console ended by a signal; the machine is disabled");
    }
}

#[test]
fn a_terminal_that_goes_while_it_is_asked_ends_the_console() {
    for closes in [true, false] {
        let mut terminal = console(&[], Keyboard::Mute);
        terminal.waits("took the terminal", |_| {
            terminal.with_screen(|screen| screen.alternate_screen())
        });
        let begun = Instant::now();
        if closes {
            terminal.close();
        } else {
            signal(&terminal, Signal::TERM);
        }
        assert_eq!(terminal.end(), 7);
        // It would have waited two seconds for an answer.
        let took = begun.elapsed();
        assert!(took < Duration::from_millis(1800), "{took:?}");
        assert!(closes || terminal.is_as_before());
    }
}

#[test]
fn it_asks_before_it_leaves_a_machine_whose_drives_are_on() {
    let machine = Machine::start();
    let mut terminal = homed(&["--port", &machine.port], Keyboard::Plain);
    terminal.brings(b"q", "Quit? nothing moves; the drives stay on and hold.");
    terminal.keys(b"n");
    terminal.waits("closed the question", |text| !text.contains("Quit?"));
    terminal.brings(b"\x03", "Quit?");
    terminal.keys(ENTER);
    assert_eq!(terminal.end(), 0);
    terminal.sees("console left; the machine is idle");
    assert!(terminal.is_as_before());
    assert_eq!(machine.now().state, State::Idle);
}

#[test]
fn without_a_terminal_it_says_so() {
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
    let person = ["--operator", "examples/teleop.toml"];
    let afar = [&["console", "--port", "tcp:localhost:1"], &person[..]].concat();
    let ran = haptimill(&afar).expect_code(2);
    assert!(
        ran.err.contains("give it to `haptimill sim serve`"),
        "{}",
        ran.err
    );
}

#[test]
fn a_port_that_is_not_there_is_told_at_the_beginning() {
    let mut terminal = console(&["--port", "tcp:127.0.0.1:1"], Keyboard::Plain);
    assert_eq!(terminal.end(), 5);
    assert!(terminal.is_as_before());
    let text = terminal.text();
    assert!(text.contains("cannot be opened"), "{text}");
}

#[test]
fn what_stops_the_machine_by_itself_is_told_with_its_remedy() {
    let terminal = homed(
        &[
            "--fault",
            "emergency-stop at=8s for=1s",
            "--fault",
            "slide-jammed axis=l1 at=14s",
        ],
        Keyboard::Plain,
    );
    terminal.state("EMERGENCY STOP");
    terminal.sees("EMERGENCY STOP: drives off. Release the cause, then x resets");
    let reset = || {
        let begun = Instant::now();
        while terminal.row(0).starts_with(" FAULT") || terminal.row(0).starts_with(" EMERG") {
            terminal.keys(b"x");
            std::thread::sleep(Duration::from_millis(200));
            assert!(begun.elapsed() < terminal::PATIENCE, "{}", terminal.text());
        }
    };
    reset();
    terminal.keys(b"e");
    terminal.state("IDLE");
    // To and fro until the slide sticks.
    let begun = Instant::now();
    for key in [RIGHT, LEFT].iter().cycle() {
        if terminal.row(0).starts_with(" FAULT") {
            break;
        }
        hold_down(&terminal, key, Duration::from_millis(300));
        assert!(begun.elapsed() < terminal::PATIENCE, "{}", terminal.text());
    }
    terminal.sees("FAULT: l1 ");
    terminal.sees("Key: x resets");
    reset();
}
