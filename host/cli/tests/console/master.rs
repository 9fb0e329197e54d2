//! Master panel: displayed values and settings.

use super::scene::{SimServer, TestFolder};
use super::terminal::Keyboard;
use super::*;
use haptimill_machine_file::{FOLLOW, HAPTIC_ARM};
use std::time::{Duration, Instant};

const TITLE: &str = "Master: forces";

/// Stiffness of the virtual fixture in machines/haptic-arm.toml, N/mm.
const STIFFNESS: f64 = 0.35;

/// Operator model: motion both ways along x for the duration of a test, with the enabling switch
/// pressed.
fn oscillating_operator() -> String {
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

/// Values of x in the force table: tool, operator, feedback law, fixture.
fn forces(text: &str) -> Option<Vec<f64>> {
    row(text, "law").map(|row| numbers(&row))
}

/// Values of x in the settings table: feedback, limit, tip, faces.
fn settings(text: &str) -> Option<Vec<f64>> {
    row(text, "tip, mm").map(|row| numbers(&row))
}

/// The row of x under a heading with this text.
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

/// Commanded x: the overlay leaves its row visible.
fn commanded_x(terminal: &Terminal) -> f64 {
    terminal.number("x", 1).unwrap()
}

#[test]
fn feedback_fixture_and_scale_are_set_and_range_errors_reported() {
    let folder = TestFolder::new();
    let machine_file = folder.machine_with(HAPTIC_ARM);
    // The console configures the board, so it knows all settings.
    let served = SimServer::on_tcp(&["--machine", &machine_file, "--unconfigured"]);
    let arguments = [
        "--machine",
        machine_file.as_str(),
        "--port",
        served.port.as_str(),
    ];
    let terminal = console(&arguments, Keyboard::Plain);
    terminal.expect_state("DISABLED");
    terminal.press_expect(b"w", TITLE);
    terminal.expect_text("enabling switch released; motors off");
    terminal.escape();
    terminal.wait_until("closed", |text| !text.contains(TITLE));
    // All other panels remain on 80 columns and 24 rows.
    for panel in [
        "Position", "Joints", "Force", "Jog", "Program", "Messages", "link ",
    ] {
        terminal.expect_text(panel);
    }
    terminal.press(b"e");
    terminal.expect_state("IDLE");
    terminal.press_expect(b"w", "motors on");
    // Values of the machine file, which this console sent.
    terminal.wait_until("x as in the machine file", |text| {
        settings(text).is_some_and(|x| x[..2] == [40.0, 3.2]) && !text.contains("40 %?")
    });
    terminal.press_expect(b"150\r", "150 % is out of its range");
    // The newest message is in the overlay, and not once more among the messages.
    for (columns, rows) in [(80, 24), (100, 40), (80, 24)] {
        terminal.resize(columns, rows);
        terminal.wait_until("the message once", |text| {
            text.contains(TITLE) && text.matches("150 % is out of its range").count() == 1
        });
    }
    terminal.press_expect(b"1.2.3\r", "'1.2.3' is not a number");
    terminal.press_expect(b"55\r", "55 %");
    terminal.press_expect(b"+", "60 %");
    terminal.press_expect(b"-----", "35 %");
    terminal.press(RIGHT);
    terminal.press_expect(b"11\r", "11 N is out of its range, 0 to 10 N");
    terminal.press_expect(b"2.6\r", "2.6 N");
    // A face at the tip, and none so close to it that the ball at the tip does not fit.
    terminal.press(RIGHT);
    terminal.press_expect(b"5", "the fixture face is set at the tip");
    terminal.press_expect(ENTER, "lower face of x set at the tip");
    terminal.press(RIGHT);
    terminal.press_expect(ENTER, "upper face of x: the ball at the tip does not fit");
    terminal.press(LEFT);
    terminal.press_expect(ENTER, "lower face of x removed");
    terminal.press(RIGHT);
    terminal.press_expect(ENTER, "upper face of x set at the tip");
    // All faces at once, and the force feedback of all axes.
    for _ in 0..3 {
        terminal.press(DOWN);
    }
    terminal.press_expect(ENTER, "all faces removed");
    for _ in 0..3 {
        terminal.press(LEFT);
    }
    terminal.press(b"20\r");
    terminal.wait_until("20 % of each", |text| text.matches("20 %").count() == 4);
    terminal.press(DOWN);
    terminal.press_expect(b"3\r", "G_P of 3 is out of its range: 0.1 to 2");
    terminal.press_expect(b"0.5\r", "position scale 0.50");
    terminal.press_expect(
        b"-----",
        "this is the smallest value; + changes it in the other direction",
    );
    terminal.expect_text("position scale 0.10");
    // Escape clears the typed number first, then closes the overlay.
    terminal.press_expect(b"7", "7_");
    terminal.escape();
    terminal.wait_until("nothing typed", |text| !text.contains("7_"));
    terminal.expect_text(TITLE);
    terminal.escape();
    terminal.wait_until("closed", |text| !text.contains(TITLE));
    // A master may drive an axis of this machine.
    terminal.press_expect(b"a", "Coordinate sources:");
    terminal.press_expect(b"m", "x: master");
    terminal.escape();
    // Another console has the values of the machine file, marked as unknown.
    drop(terminal);
    let terminal = console(&arguments, Keyboard::Plain);
    terminal.expect_state("IDLE");
    terminal.press_expect(b"w", "40 %?");
    terminal.expect_text("? another host may have changed it");
}

#[test]
fn fixture_force_is_proportional_to_depth_and_the_master_drives_x() {
    let folder = TestFolder::new();
    let machine_file = folder.machine_with(HAPTIC_ARM);
    let operator = folder.file("operator.toml", oscillating_operator());
    let program = folder.file("wait.ngc", "G21 G90 F600\nG4 P60\nM30\n");
    let served = SimServer::on_tcp(&["--machine", &machine_file, "--operator", &operator]);
    let arguments = ["--machine", &machine_file, "--port", &served.port, &program];
    let terminal = homed(&arguments, Keyboard::Plain);
    terminal.press_expect(b"w", "enabling switch pressed, moves no coordinate");
    terminal.press(RIGHT);
    terminal.press(RIGHT);
    // Near the middle of the operator trajectory.
    terminal.wait_until("in the middle", |text| {
        settings(text).is_some_and(|x| (-2.0..5.0).contains(&x[2]))
    });
    terminal.press_expect(ENTER, "lower face of x set at the tip");
    // Values of one report are consistent: the force is that of a spring between face and tip.
    let fixture_force = |text: &str| -> Option<(f64, f64)> {
        let (forces, settings) = (forces(text)?, settings(text)?);
        let force = *forces.last()?;
        let [_, _, tip, face] = settings[..] else {
            return None;
        };
        (force > 0.5).then_some((force, face - tip))
    };
    terminal.wait_until("fixture force", |text| fixture_force(text).is_some());
    let started = Instant::now();
    let mut samples = 0;
    while started.elapsed() < Duration::from_secs(6) {
        if let Some((force, depth)) = fixture_force(&terminal.text()) {
            samples += 1;
            assert!(
                (force - STIFFNESS * depth).abs() < 0.03,
                "{force} N, {depth} mm\n{}",
                terminal.text()
            );
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    assert!(samples > 5, "{samples}");
    // There is no upper face. A console that does not know the lower one recognises it by its
    // force.
    drop(terminal);
    let terminal = console(&arguments, Keyboard::Plain);
    terminal.expect_state("IDLE");
    terminal.press_expect(b"w", TITLE);
    terminal.wait_until("fixture recognised", |text| fixture_force(text).is_some());
    terminal.expect_text("none?");
    for _ in 0..3 {
        terminal.press(DOWN);
    }
    terminal.press(RIGHT);
    terminal.press(RIGHT);
    terminal.press_expect(ENTER, "all faces removed");
    terminal.wait_until("free", |text| {
        forces(text).is_some_and(|x| x.last() == Some(&0.0))
    });
    terminal.escape();
    // The master drives x while a program runs.
    terminal.press_expect(b"a", "Coordinate sources:");
    terminal.press_expect(b"m", "x: master");
    terminal.escape();
    run(&terminal);
    terminal.press_expect(b"w", "enabling switch pressed, moves x");
    terminal.escape();
    let first = commanded_x(&terminal);
    terminal.wait_until("x driven", |_| (commanded_x(&terminal) - first).abs() > 2.0);
    terminal.press(STOP);
    terminal.expect_state("IDLE");
    terminal.press_expect(b"a", "Coordinate sources:");
    terminal.press_expect(b"p", "x: program");
}

#[test]
fn failed_arm_is_reported_and_takes_no_fixture() {
    let folder = TestFolder::new();
    let machine_file = folder.machine_with(HAPTIC_ARM);
    let trip = "haptic-amplifiers-tripped at=1s";
    let terminal = console(
        &["--machine", &machine_file, "--fault", trip],
        Keyboard::Plain,
    );
    terminal.expect_state("DISABLED");
    terminal.press_expect(b"w", TITLE);
    terminal.escape();
    terminal.press(b"e");
    terminal.press_expect(b"w", "an amplifier of the haptic arm reports a fault");
    terminal.expect_text("motors off");
    terminal.press(RIGHT);
    terminal.press(RIGHT);
    terminal.press_expect(ENTER, "lower face of x: the position of the tip is unknown");
}

#[test]
fn machine_without_a_master_reports_it() {
    let terminal = console(&[], Keyboard::Plain);
    terminal.expect_state("DISABLED");
    terminal.press_expect(b"w", "this machine has no haptic arm and no remote master");
    assert!(!terminal.text().contains(TITLE), "{}", terminal.text());
    terminal.press(b"e");
    terminal.expect_state("IDLE");
    terminal.press_expect(b"a", "Coordinate sources:");
    terminal.press_expect(b"m", "source: the machine has no master");
}

#[test]
fn remote_master_machine_has_a_scale_and_a_master_board_its_forces() {
    let folder = TestFolder::new();
    let machine_file = folder.machine_with(FOLLOW);
    let terminal = console(&["--machine", &machine_file], Keyboard::Plain);
    terminal.expect_state("DISABLED");
    terminal.press_expect(b"w", "this machine follows a remote master");
    terminal.press_expect(b"0.25\r", "position scale 0.25");
    terminal.press(UP);
    terminal.press_expect(b"+", "position scale 0.40");
    drop(terminal);
    let terminal = console(
        &["--machine", "machines/haptic-master.toml"],
        Keyboard::Plain,
    );
    terminal.expect_state("DISABLED");
    terminal.press(b"e");
    terminal.press_expect(b"w", "motors on");
    terminal.wait_until("no tool", |text| {
        row(text, "law").is_some_and(|row| row.contains(" - "))
    });
    terminal.press_expect(b"45\r", "45 %");
    assert!(
        !terminal.text().contains("position scale"),
        "{}",
        terminal.text()
    );
}

#[test]
fn master_panel_depends_on_the_terminal_height() {
    let folder = TestFolder::new();
    let machine_file = folder.machine_with(HAPTIC_ARM);
    let terminal = console(&["--machine", &machine_file], Keyboard::Plain);
    terminal.expect_state("DISABLED");
    let panel = "Master ─ force ─ law ─ fixture";
    terminal.expect_text("Force high low master");
    assert!(!terminal.text().contains(panel));
    terminal.resize(100, 40);
    terminal.expect_text(panel);
    for panel in [
        "Position",
        "Joints",
        "Force ─ high ── low",
        "Jog",
        "Program",
        "Messages",
        "link ",
    ] {
        terminal.expect_text(panel);
    }
    // On a small terminal the selected field stays visible.
    terminal.press_expect(b"w", TITLE);
    terminal.resize(40, 10);
    terminal.wait_until("x marked", |text| text.contains("40 %"));
    for _ in 0..4 {
        terminal.press(DOWN);
    }
    terminal.expect_text("position scale 1.00");
    terminal.resize(80, 24);
    terminal.expect_text(panel.split(' ').next().unwrap());
    terminal.escape();
    terminal.expect_text("Force high low master");
}
