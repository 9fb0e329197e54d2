//! The line is lost and found again.

use super::machine::{Cable, Machine};
use super::terminal::Keyboard;
use super::*;
use haptimill_protocol::message::State;
use std::time::Duration;

#[test]
fn a_lost_line_is_found_again_and_nothing_moves_by_itself() {
    let folder = scene::TestFolder::new();
    let program = folder.file("way.ngc", "G21 G90 F600\nG1 X100\nM30\n");
    let machine = Machine::start();
    let cable = Cable::to(&machine.port);
    let terminal = homed(&["--port", &cable.port, &program], Keyboard::Plain);
    run(&terminal);
    machine.comes_to(State::Run);
    std::thread::sleep(Duration::from_millis(400));
    cable.cut();
    terminal.state("NO LINK");
    terminal.sees("NO LINK, trying again");
    // By itself, after half a second of silence.
    machine.comes_to(State::Fault);
    let at = machine.now().commanded;
    assert!(at < 50.0, "{at}");
    // Keys are heard all the same.
    terminal.brings(b"?", "Keys: arrows scroll");
    terminal.escape();
    terminal.brings(RIGHT, "no link to the controller");
    cable.mend();
    terminal.state("FAULT");
    terminal.sees("nothing was heard from the host");
    terminal.keys(b"x");
    terminal.state("IDLE");
    terminal.sees("connected again; nothing moves");
    std::thread::sleep(Duration::from_millis(600));
    assert_eq!(machine.now().commanded, at);
    // And it can be moved again.
    terminal.keys(LEFT);
    machine.comes_to(State::Jog);
    machine.comes_to(State::Idle);
}

#[test]
fn a_stop_that_is_wanted_without_a_line_goes_out_first() {
    let machine = Machine::start();
    let cable = Cable::to(&machine.port);
    let terminal = homed(&["--port", &cable.port], Keyboard::Plain);
    cable.cut();
    terminal.state("NO LINK");
    terminal.brings(SPACE, "A STOP goes out first");
    terminal.brings(
        EMERGENCY,
        "AN EMERGENCY STOP goes out first".trim_start_matches("AN "),
    );
    cable.mend();
    terminal.state("EMERGENCY STOP");
    machine.comes_to(State::EmergencyStop);
    // Before the greeting.
    assert_eq!(cable.first(3), [0x00, 0x18, 0x00]);
}

#[test]
fn a_terminal_that_is_stuck_keeps_neither_the_line_nor_a_stop() {
    let folder = scene::TestFolder::new();
    let program = folder.file("way.ngc", "G21 G90 F600\nG1 X100\nM30\n");
    let machine = Machine::start();
    let terminal = homed(&["--port", &machine.port, &program], Keyboard::Plain);
    run(&terminal);
    machine.comes_to(State::Run);
    // 2.5 s of pictures fill any buffer; a console that waited would be given up as a lost host after half a second.
    terminal.is_stuck(true);
    std::thread::sleep(Duration::from_millis(2500));
    assert_eq!(machine.now().state, State::Run);
    let at = machine.now().commanded;
    terminal.keys(STOP);
    machine.comes_to(State::Idle);
    assert!(machine.now().commanded - at < 40.0);
    terminal.is_stuck(false);
    terminal.state("IDLE");
    terminal.sees("way.ngc: dropped");
    // Nor its end.
    terminal.is_stuck(true);
    std::thread::sleep(Duration::from_millis(2500));
    closing::signal(&terminal, rustix::process::Signal::TERM);
    let mut terminal = terminal;
    assert_eq!(terminal.end(), 7);
}

#[test]
fn a_bad_line_is_shown_and_borne() {
    let terminal = homed(&["--fault", "link-errors rate=0.0003"], Keyboard::Plain);
    terminal.brings(b"\t", "step 0.1 mm");
    let before = terminal.number("x", 1).unwrap();
    for _ in 0..5 {
        terminal.keys(RIGHT);
        terminal.state("RUN");
        // Pressed again in the moment in which it comes to rest, whatever is on its way.
        terminal.state("IDLE");
    }
    terminal.waits("0.5 mm further", |_| {
        terminal
            .number("x", 1)
            .is_some_and(|x| (x - before - 0.5).abs() < 1e-6)
    });
    terminal.waits("bad frames", |text| {
        text.contains("bad frames ") && !text.contains("bad frames 0+0")
    });
}
