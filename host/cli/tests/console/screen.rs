//! Screen sizes.

use super::terminal::Keyboard;
use super::*;
use std::time::Duration;

#[test]
fn screen_adapts_to_the_terminal_size() {
    let terminal = homed(&[], Keyboard::Plain);
    let always = ["IDLE", "hold", "stop"];
    for (columns, rows) in [
        (40, 10),
        (200, 60),
        (80, 24),
        (20, 5),
        (3, 2),
        (1, 1),
        (100, 8),
        (30, 50),
        (80, 24),
    ] {
        terminal.resize(columns, rows);
        std::thread::sleep(Duration::from_millis(250));
        if columns >= 40 && rows >= 10 {
            for word in always {
                terminal.expect_text(word);
            }
            // Every axis with its values.
            for axis in ["x", "y", "z", "theta", "alpha"] {
                terminal.wait_until(axis, |_| terminal.number(axis, 2).is_some());
            }
        }
        if columns >= 80 && rows >= 24 {
            for panel in [
                "Position", "Joints", "Force", "Jog", "Program", "Messages", "link ",
            ] {
                terminal.expect_text(panel);
            }
            for joint in ["l1", "l2", "l3", "l4"] {
                assert!(terminal.number(joint, 1).is_some(), "{}", terminal.text());
            }
        }
    }
    // Keys still work afterwards, also in an overlay on a screen that is too small for it.
    terminal.press(RIGHT);
    terminal.expect_state("JOG");
    terminal.expect_state("IDLE");
    terminal.press_expect(b"?", "Keys: arrows scroll");
    terminal.resize(12, 4);
    std::thread::sleep(Duration::from_millis(250));
    terminal.resize(80, 24);
    terminal.expect_text("Keys: arrows scroll");
    terminal.press(DOWN);
    terminal.press(PAGE_DOWN);
    terminal.escape();
    terminal.wait_until("closed", |text| !text.contains("Keys: arrows scroll"));
}

/// A window that changes its size sends a signal while keys arrive: none may wait for the next key.
#[test]
fn keys_at_the_moment_of_a_resize_take_effect() {
    let terminal = console(&[], Keyboard::Plain);
    terminal.expect_state("DISABLED");
    for round in 0..60 {
        let columns = if round % 2 == 0 { 100 } else { 80 };
        // The key first, then the signal: both are there when the console looks.
        terminal.press(b"?");
        terminal.resize(columns, 24);
        terminal.expect_text("Keys: arrows scroll");
        terminal.resize(columns + 1, 24);
        terminal.press(b"?");
        terminal.wait_until("closed", |text| !text.contains("Keys: arrows scroll"));
    }
}

#[test]
fn homing_enables_and_positions_before_it_are_marked() {
    let terminal = console(&[], Keyboard::Plain);
    terminal.expect_state("DISABLED");
    terminal.expect_text("not homed. h enables and homes");
    terminal.expect_text("? not referenced");
    let is_marked = |text: &str| {
        let row = text.lines().find(|row| row.starts_with(" x "));
        row.is_some_and(|row| row.contains('?'))
    };
    terminal.wait_until("mark", is_marked);
    terminal.press_expect(b"h", "Home? The drives are switched on");
    terminal.press(ENTER);
    terminal.expect_text("move to the home pose: done");
    assert!(!is_marked(&terminal.text()), "{}", terminal.text());
}

#[test]
fn key_table_keeps_its_frame_while_it_scrolls() {
    let terminal = console(&[], Keyboard::Plain);
    terminal.press_expect(b"?", "Keys: arrows scroll");
    // First and last row of the frame, and its width.
    let frame = |terminal: &Terminal| {
        let text = terminal.text();
        let rows: Vec<&str> = text.lines().collect();
        let top = rows.iter().position(|row| row.contains("Keys: arrows"));
        let bottom = rows.iter().position(|row| row.contains('└'));
        let width = top.map(|top| rows[top].chars().filter(|letter| *letter == '─').count());
        (top, bottom, width)
    };
    // The title may be on the screen before the rest of the frame.
    terminal.wait_until("frame", |_| {
        let (top, bottom, _) = frame(&terminal);
        bottom > top
    });
    let before = frame(&terminal);
    terminal.press(PAGE_DOWN);
    terminal.wait_until("scrolled", |text| !text.contains("Space, F5"));
    assert_eq!(frame(&terminal), before);
    // The table has less than eight pages.
    for _ in 0..8 {
        terminal.press(PAGE_DOWN);
    }
    let last = "Esc        close";
    terminal.expect_text(last);
    assert_eq!(frame(&terminal), before);
    // The last row is at the bottom of the frame, and the first key upwards moves it out of it.
    let is_above_bottom = |text: &str| {
        let rows: Vec<&str> = text.lines().collect();
        let at = rows.iter().position(|row| row.contains(last));
        at.is_some_and(|at| rows[at + 1].contains('└'))
    };
    terminal.wait_until("last row", is_above_bottom);
    terminal.press(UP);
    terminal.wait_until("scrolled up", |text| !text.contains(last));
    assert_eq!(frame(&terminal), before);
}
