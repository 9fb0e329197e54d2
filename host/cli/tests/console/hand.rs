//! The hand on a haptic arm: what is shown of it, and what is ordered from its overlay.

use super::scene::{SimServer, TestFolder};
use super::terminal::Keyboard;
use super::*;
use haptimill_machine_file::{FOLLOW, HAND};
use std::time::{Duration, Instant};

const TITLE: &str = "Hand: what it feels";

/// Stiffness of the walls of machines/hand.toml, N/mm.
const STIFFNESS: f64 = 0.35;

/// Both ways along x, for as long as a test takes, with the button held.
fn to_and_fro() -> String {
    let strokes: String = (0..30)
        .map(|index| {
            let (at_s, x) = (1 + 4 * index, if index % 2 == 0 { -9.0 } else { 9.0 });
            format!(
                "[[stroke]]\nat_s = {at_s}.0\nto_mm = [{x:.1}, 0.0, 0.0]\npace_mm_s = 8.0\nramp_s = 0.3\n"
            )
        })
        .collect();
    format!("[[button]]\nat_s = 0.5\nheld = true\n{strokes}")
}

/// Numbers of the row of x in the table of forces: on the tool, at the hand, by the law, of the wall.
fn forces(text: &str) -> Option<Vec<f64>> {
    row(text, "law").map(|row| numbers(&row))
}

/// Numbers of the row of x in the table of settings.
fn settings(text: &str) -> Option<Vec<f64>> {
    row(text, "at most").map(|row| numbers(&row))
}

/// The row of x under a heading with this word.
fn row(text: &str, heading: &str) -> Option<String> {
    let mut rows = text.lines().skip_while(|row| !row.contains(heading));
    rows.next()?;
    Some(rows.next()?.to_string())
}

fn numbers(row: &str) -> Vec<f64> {
    row.split(|letter: char| !(letter.is_ascii_digit() || "+-.".contains(letter)))
        .filter_map(|word| word.parse().ok())
        .collect()
}

/// The number that leads the row of the wanted x: the panels are not covered in the upper rows.
fn wanted_x(terminal: &Terminal) -> f64 {
    terminal.number("x", 1).unwrap()
}

#[test]
fn reflection_walls_and_scale_are_set_from_the_overlay_and_refused_in_words() {
    let folder = TestFolder::new();
    let own = folder.machine_with(HAND);
    // The console gives the board its configuration, and so knows what is set.
    let served = SimServer::on_tcp(&["--machine", &own, "--unconfigured"]);
    let arguments = ["--machine", own.as_str(), "--port", served.port.as_str()];
    let terminal = console(&arguments, Keyboard::Plain);
    terminal.state("DISABLED");
    terminal.brings(b"w", TITLE);
    terminal.sees("button free; motors off");
    terminal.escape();
    terminal.waits("closed", |text| !text.contains(TITLE));
    // Everything of before is there, on 80 columns and 24 rows.
    for panel in [
        "Position", "Slides", "Force", "Jog", "Program", "Messages", "link ",
    ] {
        terminal.sees(panel);
    }
    terminal.keys(b"e");
    terminal.state("IDLE");
    terminal.brings(b"w", "motors on");
    // What the machine file says, and the controller took it from here.
    terminal.waits("x as in the machine file", |text| {
        settings(text).is_some_and(|x| x[..2] == [40.0, 3.2]) && !text.contains("40 %?")
    });
    terminal.brings(b"150\r", "150 % is not one of 0 to 100");
    terminal.brings(b"1.2.3\r", "'1.2.3' is no number");
    terminal.brings(b"55\r", "55 %");
    terminal.brings(b"+", "60 %");
    terminal.brings(b"-----", "35 %");
    terminal.keys(RIGHT);
    terminal.brings(b"11\r", "11 N is out of its range, 0 to 10 N");
    terminal.brings(b"2.6\r", "2.6 N");
    // A wall where the tip is, and none so near it that the ball at the tip would not fit.
    terminal.keys(RIGHT);
    terminal.brings(b"5", "a wall is put where the tip is");
    terminal.brings(ENTER, "lower wall of x where the tip is");
    terminal.keys(RIGHT);
    terminal.brings(ENTER, "upper wall of x: the ball at the tip does not fit");
    terminal.keys(LEFT);
    terminal.brings(ENTER, "lower wall of x taken away");
    terminal.keys(RIGHT);
    terminal.brings(ENTER, "upper wall of x where the tip is");
    // All of them at once, and the reflection of all axes.
    for _ in 0..3 {
        terminal.keys(DOWN);
    }
    terminal.brings(ENTER, "all walls taken away");
    for _ in 0..3 {
        terminal.keys(LEFT);
    }
    terminal.keys(b"20\r");
    terminal.waits("20 % of each", |text| text.matches("20 %").count() == 4);
    terminal.keys(DOWN);
    terminal.brings(b"3\r", "G_P of 3 is out of its range: 0.1 to 2");
    terminal.brings(b"0.5\r", "G_P 0.50");
    terminal.brings(
        b"-----",
        "that is the least it can be; + goes the other way",
    );
    terminal.sees("G_P 0.10");
    // Typing is left first, then the overlay.
    terminal.brings(b"7", "7_");
    terminal.escape();
    terminal.waits("nothing typed", |text| !text.contains("7_"));
    terminal.sees(TITLE);
    terminal.escape();
    terminal.waits("closed", |text| !text.contains(TITLE));
    // A hand may lead an axis of this machine.
    terminal.brings(b"a", "Axes: a jog begins and ends at rest");
    terminal.brings(b"m", "x: master");
    terminal.escape();
    // Another console knows what the machine file says, and that it may be otherwise.
    drop(terminal);
    let terminal = console(&arguments, Keyboard::Plain);
    terminal.state("IDLE");
    terminal.brings(b"w", "40 %?");
    terminal.sees("? unless another host has set it");
}

#[test]
fn a_wall_pushes_as_deep_as_the_hand_is_in_it_and_the_hand_leads() {
    let folder = TestFolder::new();
    let own = folder.machine_with(HAND);
    let person = folder.file("person.toml", to_and_fro());
    let program = folder.file("wait.ngc", "G21 G90 F600\nG4 P60\nM30\n");
    let served = SimServer::on_tcp(&["--machine", &own, "--operator", &person]);
    let arguments = ["--machine", &own, "--port", &served.port, &program];
    let terminal = homed(&arguments, Keyboard::Plain);
    terminal.brings(b"w", "button held, leads nothing");
    terminal.keys(RIGHT);
    terminal.keys(RIGHT);
    // Where the hand goes on from, to and fro.
    terminal.waits("in the middle", |text| {
        settings(text).is_some_and(|x| (-2.0..5.0).contains(&x[2]))
    });
    terminal.brings(ENTER, "lower wall of x where the tip is");
    // Numbers of one report belong together: the push is that of a spring from the wall to the tip.
    let deep = |text: &str| -> Option<(f64, f64)> {
        let (forces, settings) = (forces(text)?, settings(text)?);
        let push = *forces.last()?;
        let [_, _, tip, wall] = settings[..] else {
            return None;
        };
        (push > 0.5).then_some((push, wall - tip))
    };
    terminal.waits("pushed back", |text| deep(text).is_some());
    let begun = Instant::now();
    let mut seen = 0;
    while begun.elapsed() < Duration::from_secs(6) {
        if let Some((push, depth)) = deep(&terminal.text()) {
            seen += 1;
            assert!(
                (push - STIFFNESS * depth).abs() < 0.03,
                "{push} N, {depth} mm\n{}",
                terminal.text()
            );
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    assert!(seen > 5, "{seen}");
    // On the upper side of the hand there is none; a wall that another host does not know is found by its push.
    drop(terminal);
    let terminal = console(&arguments, Keyboard::Plain);
    terminal.state("IDLE");
    terminal.brings(b"w", TITLE);
    terminal.waits("found the wall", |text| deep(text).is_some());
    terminal.sees("none?");
    for _ in 0..3 {
        terminal.keys(DOWN);
    }
    terminal.keys(RIGHT);
    terminal.keys(RIGHT);
    terminal.brings(ENTER, "all walls taken away");
    terminal.waits("free", |text| {
        forces(text).is_some_and(|x| x.last() == Some(&0.0))
    });
    terminal.escape();
    // The hand leads x while a program runs.
    terminal.brings(b"a", "Axes: a jog begins and ends at rest");
    terminal.brings(b"m", "x: master");
    terminal.escape();
    run(&terminal);
    terminal.brings(b"w", "button held, leads x");
    terminal.escape();
    let first = wanted_x(&terminal);
    terminal.waits("led", |_| (wanted_x(&terminal) - first).abs() > 2.0);
    terminal.keys(STOP);
    terminal.state("IDLE");
    terminal.brings(b"a", "Axes: a jog begins and ends at rest");
    terminal.brings(b"p", "x: program");
}

#[test]
fn an_arm_that_fails_is_told_in_the_overlay_and_bears_no_wall() {
    let folder = TestFolder::new();
    let own = folder.machine_with(HAND);
    let trip = "hand-amplifiers-tripped at=1s";
    let terminal = console(&["--machine", &own, "--fault", trip], Keyboard::Plain);
    terminal.state("DISABLED");
    terminal.brings(b"w", TITLE);
    terminal.escape();
    terminal.keys(b"e");
    terminal.brings(b"w", "an amplifier of the haptic arm reports a fault");
    terminal.sees("motors off");
    terminal.keys(RIGHT);
    terminal.keys(RIGHT);
    terminal.brings(ENTER, "lower wall of x: where the tip is is not known");
}

#[test]
fn a_machine_without_a_hand_says_so() {
    let terminal = console(&[], Keyboard::Plain);
    terminal.state("DISABLED");
    terminal.brings(b"w", "this machine has no haptic arm and follows none");
    assert!(!terminal.text().contains(TITLE), "{}", terminal.text());
    terminal.keys(b"e");
    terminal.state("IDLE");
    terminal.brings(b"a", "Axes: a jog begins and ends at rest");
    terminal.brings(b"m", "source: no hand can lead this machine");
}

#[test]
fn a_machine_that_follows_afar_has_its_scale_and_an_arm_alone_its_forces() {
    let folder = TestFolder::new();
    let own = folder.machine_with(FOLLOW);
    let terminal = console(&["--machine", &own], Keyboard::Plain);
    terminal.state("DISABLED");
    terminal.brings(b"w", "this machine follows a hand afar");
    terminal.brings(b"0.25\r", "G_P 0.25");
    terminal.keys(UP);
    terminal.brings(b"+", "G_P 0.40");
    drop(terminal);
    let terminal = console(&["--machine", "machines/hand-master.toml"], Keyboard::Plain);
    terminal.state("DISABLED");
    terminal.keys(b"e");
    terminal.brings(b"w", "motors on");
    terminal.waits("no tool", |text| {
        row(text, "law").is_some_and(|row| row.contains(" - "))
    });
    terminal.brings(b"45\r", "45 %");
    assert!(!terminal.text().contains("G_P"), "{}", terminal.text());
}

#[test]
fn the_hand_is_shown_as_far_as_there_is_room() {
    let folder = TestFolder::new();
    let own = folder.machine_with(HAND);
    let terminal = console(&["--machine", &own], Keyboard::Plain);
    terminal.state("DISABLED");
    let panel = "Hand ─ felt ── law ── wall";
    terminal.sees("Force high, low, hand");
    assert!(!terminal.text().contains(panel));
    terminal.resize(100, 40);
    terminal.sees(panel);
    for panel in [
        "Position",
        "Slides",
        "Force ─ high ── low",
        "Jog",
        "Program",
        "Messages",
        "link ",
    ] {
        terminal.sees(panel);
    }
    // On a small terminal the marked field is in sight, wherever it is.
    terminal.brings(b"w", TITLE);
    terminal.resize(40, 10);
    terminal.waits("x marked", |text| text.contains("40 %"));
    for _ in 0..4 {
        terminal.keys(DOWN);
    }
    terminal.sees("G_P 1.00");
    terminal.resize(80, 24);
    terminal.sees(panel.split(' ').next().unwrap());
    terminal.escape();
    terminal.sees("Force high, low, hand");
}
