//! Link loss and reconnection.

use super::machine::{Cable, Machine};
use super::terminal::Keyboard;
use super::*;
use haptimill_protocol::message::State;
use std::time::Duration;

#[test]
fn console_reconnects_after_a_link_loss_without_motion() {
    let folder = scene::TestFolder::new();
    let program = folder.file("move.ngc", "G21 G90 F600\nG1 X100\nM30\n");
    let machine = Machine::start();
    let cable = Cable::to(&machine.port);
    let terminal = homed(&["--port", &cable.port, &program], Keyboard::Plain);
    run(&terminal);
    machine.wait_for_state(State::Run);
    std::thread::sleep(Duration::from_millis(400));
    cable.disconnect();
    terminal.expect_state("NO LINK");
    terminal.expect_text("NO LINK, reconnecting");
    // By the heartbeat, after half a second.
    machine.wait_for_state(State::Fault);
    let at = machine.now().commanded;
    assert!(at < 50.0, "{at}");
    // Keys still work.
    terminal.press_expect(b"?", "Keys: arrows scroll");
    terminal.escape();
    terminal.press_expect(RIGHT, "no link to the controller");
    cable.reconnect();
    terminal.expect_state("FAULT");
    terminal.expect_text("nothing was received from the host");
    terminal.press(b"x");
    terminal.expect_state("IDLE");
    terminal.expect_text("reconnected; the machine does not move");
    std::thread::sleep(Duration::from_millis(600));
    assert_eq!(machine.now().commanded, at);
    // The machine can be moved again.
    terminal.press(LEFT);
    machine.wait_for_state(State::Jog);
    machine.wait_for_state(State::Idle);
}

#[test]
fn pending_stop_is_sent_first_after_reconnection() {
    let machine = Machine::start();
    let cable = Cable::to(&machine.port);
    let terminal = homed(&["--port", &cable.port], Keyboard::Plain);
    cable.disconnect();
    terminal.expect_state("NO LINK");
    terminal.press_expect(SPACE, " STOP pending, sent first");
    terminal.press_expect(EMERGENCY, "EMERGENCY STOP pending, sent first");
    cable.reconnect();
    terminal.expect_state("EMERGENCY STOP");
    machine.wait_for_state(State::EmergencyStop);
    // Before the Hello.
    assert_eq!(cable.first(3), [0x00, 0x18, 0x00]);
}

#[test]
fn stuck_terminal_blocks_neither_link_nor_stop() {
    let folder = scene::TestFolder::new();
    let program = folder.file("move.ngc", "G21 G90 F600\nG1 X100\nM30\n");
    let machine = Machine::start();
    let terminal = homed(&["--port", &machine.port, &program], Keyboard::Plain);
    run(&terminal);
    machine.wait_for_state(State::Run);
    // 2.5 s of frames fill any buffer. A console that blocked would lose the machine by the
    // heartbeat after half a second.
    terminal.set_stuck(true);
    std::thread::sleep(Duration::from_millis(2500));
    assert_eq!(machine.now().state, State::Run);
    let at = machine.now().commanded;
    terminal.press(STOP);
    machine.wait_for_state(State::Idle);
    assert!(machine.now().commanded - at < 40.0);
    terminal.set_stuck(false);
    terminal.expect_state("IDLE");
    terminal.expect_text("move.ngc: dropped");
    // A stuck terminal does not block the exit either.
    terminal.set_stuck(true);
    std::thread::sleep(Duration::from_millis(2500));
    closing::signal(&terminal, rustix::process::Signal::TERM);
    let mut terminal = terminal;
    assert_eq!(terminal.exit_code(), 7);
}

#[test]
fn link_errors_are_counted_and_tolerated() {
    let terminal = homed(&["--fault", "link-errors rate=0.0003"], Keyboard::Plain);
    terminal.press_expect(b"\t", "step 0.1 mm");
    let before = terminal.number("x", 1).unwrap();
    for _ in 0..5 {
        terminal.press(RIGHT);
        terminal.expect_state("RUN");
        // Pressed again right at standstill, whatever message is on its way.
        terminal.expect_state("IDLE");
    }
    terminal.wait_until("0.5 mm further", |_| {
        terminal
            .number("x", 1)
            .is_some_and(|x| (x - before - 0.5).abs() < 1e-6)
    });
    terminal.wait_until("bad frames", |text| {
        text.contains("bad frames ") && !text.contains("bad frames 0+0")
    });
}
