//! Part programs, and the four keys that are always active.

use super::scene::{SimServer, TestFolder, haptimill, number};
use super::terminal::Keyboard;
use super::*;
use std::time::Duration;

/// Key z writes the work offset of the present position beside the machine file. Space holds the
/// machine there, too, so commas separate.
#[test]
fn zero_of_a_work_offset_is_typed() {
    let folder = TestFolder::new();
    let machine = folder.machine_with("");
    let served = SimServer::on_tcp(&["--machine", &machine]);
    let arguments = ["--port", &served.port, "--machine", &machine];
    let terminal = homed(&arguments, Keyboard::Plain);
    let home = served
        .run_ok(&["status", "--json", "--machine", &machine])
        .json();
    terminal.press_expect(b"z", "Work offset: coordinates of the present position");
    terminal.expect_text("g54,x=0,y=0_");
    terminal.press(b"\x15");
    terminal.press(b"g55,x=0.5,z=-2");
    terminal.expect_text("g55,x=0.5,z=-2_");
    terminal.press(ENTER);
    terminal.expect_text("own.offsets.toml written");
    let shown = haptimill(&["offset", "show", "--machine", &machine]).expect_code(0);
    let z = (1e4 * (number(&home["commanded"], "z") + 2.0)).round() / 1e4;
    let origin = format!("G55   x=-0.5 y=0 z={z} ");
    assert!(shown.out.contains(&origin), "{origin}: {}", shown.out);
    // A mistake changes nothing.
    terminal.press_expect(b"z", "Work offset: coordinates of the present position");
    terminal.press(b",q=1");
    terminal.press(ENTER);
    terminal.expect_text("there is no coordinate 'q'");
    let after = haptimill(&["offset", "show", "--machine", &machine]).expect_code(0);
    assert_eq!(shown.out, after.out);
}

/// Moves back and forth for half a minute at 10 mm/s, with a pause after the first move.
const LONG: &str =
    "G21 G90 F600\nG1 X10\nM0 (turn it)\nG1 X0\nG1 X20\nG1 X0\nG1 X20\nG1 X0\nG1 X20\nG1 X0\nM30\n";

#[test]
fn hold_resume_stop_and_emergency_work_whatever_is_open() {
    let folder = TestFolder::new();
    let program = folder.file("long.ngc", LONG);
    let served = SimServer::on_tcp(&[]);
    let terminal = homed(&["--port", &served.port, &program], Keyboard::Plain);
    run(&terminal);
    terminal.expect_text("long.ngc  line 2/");
    terminal.expect_text("Feed 600 mm/min ─ spindle - rev/min");
    terminal.expect_text(" 2 G1 X10 ");
    // The program pause: one line number everywhere, and the comment. Nothing moves.
    terminal.expect_text("program pause in line 3 (turn it). Ctrl-R resumes");
    terminal.expect_state("HOLD");
    terminal.expect_text("long.ngc  line 3/");
    terminal.expect_text(" 3 M0 (turn it) ");
    terminal.expect_text("Feed 0 mm/min");
    terminal.expect_text("path speed 0 %");
    assert!(!terminal.text().contains("setpoint"), "{}", terminal.text());
    terminal.press(RESUME);
    terminal.expect_state("RUN");
    // Hold while the key table is open, resume while a name is typed.
    terminal.press_expect(b"?", "Keys: arrows scroll");
    terminal.press(SPACE);
    terminal.expect_state("HOLD");
    let held = || {
        std::thread::sleep(Duration::from_millis(700));
        let first = terminal.text();
        std::thread::sleep(Duration::from_millis(300));
        (first, terminal.text())
    };
    let row = |text: &str| {
        text.lines()
            .find(|row| row.starts_with(" x "))
            .map(|row| row[..20].to_string())
    };
    terminal.escape();
    terminal.expect_text("on hold. Ctrl-R resumes");
    let (before, after) = held();
    assert_eq!(row(&before), row(&after));
    terminal.press(b"p");
    terminal.press(b"some name");
    // A letter of a name is no key; the space in it is.
    terminal.expect_text("somename_");
    terminal.press(RESUME);
    terminal.expect_state("RUN");
    terminal.press(b"\x15");
    terminal.press(STOP);
    terminal.expect_state("IDLE");
    terminal.expect_text("long.ngc: dropped");
    terminal.escape();
    // Again from the present pose with a lower override; then the emergency stop while a question
    // is open.
    for _ in 0..5 {
        terminal.press(b"-");
    }
    terminal.expect_text("override 50 %");
    run(&terminal);
    terminal.expect_text("path speed 50 %");
    terminal.expect_text("Feed 300 mm/min");
    terminal.press_expect(b"q", "Quit?");
    terminal.press(EMERGENCY);
    terminal.expect_state("EMERGENCY STOP");
    terminal.expect_text("EMERGENCY STOP: drives off");
    terminal.escape();
    terminal.press_expect(
        b"e",
        "enable: not possible while the machine is in emergency stop",
    );
    terminal.press(b"x");
    terminal.expect_state("DISABLED");
    terminal.press(b"q");
    let mut terminal = terminal;
    assert_eq!(terminal.exit_code(), 0, "{}", terminal.text());
    assert!(terminal.is_restored());
    // Seen by another host: the drives are off, the machine is reset.
    assert_eq!(served.status()["state"], "Disabled");
}

#[test]
fn program_runs_to_its_end_with_a_recording() {
    let folder = TestFolder::new();
    let program = folder.file("short.ngc", "G21 G90 F1200\nG1 X4\nG3 X0 I-2\nM30\n");
    let out = folder.path("");
    let mut terminal = homed(&["--out", &out, &program], Keyboard::Plain);
    terminal.press_expect(b"l", "REC console-");
    run(&terminal);
    terminal.expect_text("short.ngc: done");
    terminal.expect_state("IDLE");
    terminal.press_expect(b"l", " rows");
    terminal.press_expect(b"q", "the drives stay on and hold");
    terminal.press(ENTER);
    assert_eq!(terminal.exit_code(), 0);
    let file = std::fs::read_dir(&out)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .find(|path| path.extension().is_some_and(|end| end == "csv"))
        .unwrap();
    let text = std::fs::read_to_string(&file).unwrap();
    let mut lines = text.lines();
    let head: Vec<&str> = lines.next().unwrap().split(',').collect();
    let column = |name: &str| head.iter().position(|column| *column == name).unwrap();
    let (x, state, time) = (column("commanded_x_mm"), column("state"), column("time_s"));
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    assert!(rows.iter().all(|row| row.len() == head.len()));
    let largest = rows
        .iter()
        .filter(|row| row[state] == "Run")
        .map(|row| row[x].parse::<f64>().unwrap())
        .fold(0.0, f64::max);
    assert!((largest - 4.0).abs() < 0.1, "{largest}");
    let times: Vec<f64> = rows.iter().map(|row| row[time].parse().unwrap()).collect();
    // A frame every 20 ms as requested; a busy computer may skip some.
    let mut gaps: Vec<f64> = times.windows(2).map(|two| two[1] - two[0]).collect();
    gaps.sort_by(f64::total_cmp);
    assert!(gaps.len() > 30 && gaps[gaps.len() / 2] < 0.0201, "{gaps:?}");
}

/// The exact pose is reported after the state: on this line a fifth of a second later.
#[cfg(unix)]
#[test]
fn program_can_be_selected_right_at_standstill() {
    let folder = TestFolder::new();
    let program = folder.file("move.ngc", "G21 G90 F600\nG1 X1\nM30\n");
    let served = SimServer::on("pty", &["--fault", "link-delay ms=100"]);
    // A line as slow as this one also carries fewer reports.
    let line = ["--port", &served.port, "--baud", "9600", &program];
    let terminal = homed(&line, Keyboard::Plain);
    terminal.press_expect(b"p\r", "The machine moves.");
}

#[test]
fn spindle_speed_of_the_running_program_is_shown() {
    let folder = TestFolder::new();
    let text = "G21 G90 F600\nM3 S12000\nG1 X10\nM5\nG1 X0\nM30\n";
    let program = folder.file("spindle.ngc", text);
    let terminal = homed(&[&program], Keyboard::Plain);
    run(&terminal);
    terminal.expect_text("spindle 12000 rev/min");
    terminal.expect_text("spindle 0 rev/min");
    terminal.expect_text("spindle.ngc: done");
    terminal.expect_text("spindle - rev/min");
}

/// The question before a run shows the words that change nothing and the feeds that the machine
/// lowers; the messages keep them.
#[test]
fn notices_of_a_program_are_shown_before_it_runs() {
    let folder = TestFolder::new();
    let text = "G21 G90 F90000\nM8\nG1 X5\nM30\n";
    let program = folder.file("notice.ngc", text);
    let terminal = homed(&[&program], Keyboard::Plain);
    terminal.press_expect(b"p", "Enter checks it");
    terminal.press_expect(ENTER, "The machine moves.");
    let notices = [
        "notice.ngc:2:1: notice: this machine has no coolant",
        "notice.ngc: notice: the limits of the machine keep 1 block below the feed",
    ];
    for notice in notices {
        terminal.expect_text(notice);
    }
    std::thread::sleep(Duration::from_millis(600));
    terminal.press(ENTER);
    terminal.expect_text("notice.ngc: done");
    // The screen has rows for the last messages only, and wraps them.
    let last = "notice.ngc: notice: the limits of the machine keep 1 block";
    assert!(terminal.text().contains(last), "{}", terminal.text());
}

/// A program is picked from a list: folders are opened and left with keys, a typed folder is
/// opened, and the picked program is the one that is checked.
#[test]
fn program_is_picked_from_a_folder() {
    let folder = TestFolder::new();
    std::fs::create_dir_all(folder.path("plates/old")).unwrap();
    folder.file("plates/hole.ngc", "G21 G90 F600\nG1 X1\nM30\n");
    folder.file("plates/slot.NC", "G21 G90 F600\nG1 X1\nG1 X3\nM30\n");
    folder.file("plates/drawing.pdf", "");
    let terminal = homed(&[], Keyboard::Plain);
    // The current folder is that of the repository.
    terminal.press_expect(b"p", " examples/");
    terminal.press(b"\x15");
    terminal.press(folder.path("").as_bytes());
    terminal.press_expect(ENTER, " plates/");
    terminal.press_expect(ENTER, " hole.ngc");
    let text = terminal.text();
    assert!(
        text.contains(" old/") && text.contains(" slot.NC"),
        "{text}"
    );
    assert!(!text.contains("drawing"), "{text}");
    // Up again, and the folder that was left is selected.
    terminal.press_expect(b"\x7f", " plates/");
    terminal.press_expect(ENTER, " slot.NC");
    terminal.press_expect(DOWN, "Enter checks it, Backspace");
    terminal.press(DOWN);
    terminal.press_expect(ENTER, "Run slot.NC: 2 blocks");
    terminal.press(b"n");
    // The list begins at the picked program the next time, and Enter checks it again.
    terminal.press_expect(b"p", "slot.NC_");
    terminal.press_expect(ENTER, "Run slot.NC: 2 blocks");
    terminal.press(b"n");
    terminal.wait_until("closed", |text| !text.contains("Run slot.NC"));
    terminal.expect_state("IDLE");
    // A folder that is gone is said, and the way up is left.
    terminal.press_expect(b"p\x15", "Down selects");
    terminal.press(folder.path("plates").as_bytes());
    terminal.press_expect(ENTER, "Enter opens it, Backspace");
    std::fs::remove_dir(folder.path("plates/old")).unwrap();
    terminal.press_expect(ENTER, "No such file or directory");
    terminal.press_expect(b"\x7f", " hole.ngc");
}

#[test]
fn program_error_is_reported_with_its_line() {
    let folder = TestFolder::new();
    let bad = folder.file("bad.ngc", "G21\nG1 X10 F600\nG1 X900\nM30\n");
    // Given on the command line: reported before the screen is taken over.
    let mut terminal = console(&[&bad], Keyboard::Plain);
    assert_eq!(terminal.exit_code(), 4);
    assert!(terminal.is_restored());
    assert!(
        terminal.text().contains("bad.ngc:3:"),
        "{}",
        terminal.text()
    );
    // Typed: reported on the screen.
    let terminal = homed(&[], Keyboard::Plain);
    terminal.press_expect(b"p", "Part program");
    terminal.press(bad.as_bytes());
    terminal.press_expect(ENTER, "Program refused");
    terminal.expect_text("bad.ngc:3:");
    terminal.escape();
    // A refused file is not offered.
    terminal.expect_text("ready. Jog, or p selects a part program");
    terminal.expect_state("IDLE");
    terminal.press(b"p");
    terminal.press_expect(b"\x15/nowhere.ngc\r", "/nowhere.ngc: cannot be read");
}

#[test]
fn axis_sources_and_force_control_are_set_from_the_screen() {
    let served = SimServer::on_tcp(&[]);
    let terminal = homed(&["--port", &served.port], Keyboard::Plain);
    terminal.press_expect(b"a", "Coordinate sources:");
    terminal.press(DOWN);
    terminal.press_expect(b"h", "y: hold");
    terminal.escape();
    terminal.wait_until("held y", |text| {
        text.lines()
            .any(|row| row.starts_with(" y ") && row.contains("hold"))
    });
    terminal.press_expect(b"t", "Tare?");
    terminal.press_expect(ENTER, "the force sensor has a new zero");
    terminal.press_expect(b"y", "Force control:");
    terminal.press_expect(ENTER, "x on   setpoint");
    terminal.press_expect(b"++", "setpoint 6.0 N");
    // Refused by the controller, with its bound.
    for _ in 0..12 {
        terminal.press(b"-");
    }
    terminal.expect_text("force loop of x");
    terminal.escape();
    terminal.wait_until("force control of x", |text| {
        text.lines().any(|row| row.contains("control x>"))
    });
    // The console quits and another host connects.
    terminal.press(b"q\r");
    let mut terminal = terminal;
    assert_eq!(terminal.exit_code(), 0);
    // Another console queries the controller, not the machine file.
    let terminal = console(&["--port", &served.port], Keyboard::Plain);
    terminal.expect_state("IDLE");
    terminal.wait_until("force setpoint of the first console", |text| {
        text.lines()
            .any(|row| row.contains("control x>") && !row.contains("x>5.0N"))
    });
}

/// The push moves the joint with the drives off, onto its switch at 158 mm.
#[test]
fn a_joint_is_moved_off_its_limit_switch_by_a_key() {
    let mill = "machines/mill3-servo.toml";
    let push = "push joint=x effort=45 at=1s for=5s";
    let terminal = console(&["--machine", mill, "--fault", push], Keyboard::Plain);
    terminal.expect_state("DISABLED");
    terminal.press_expect(
        b"b",
        "move off: no joint is known to be on its limit switch",
    );
    std::thread::sleep(Duration::from_millis(6500));
    terminal.press_expect(b"e", "x is on its limit switch");
    terminal.expect_state("DISABLED");
    // A row of x, with the mark of a machine that is not homed.
    let has_x = |text: &str, range: std::ops::Range<f64>| {
        let rows = text.lines().filter(|row| row.starts_with(" x "));
        let mut words = rows.flat_map(str::split_whitespace);
        words.any(|word| {
            let value = word.trim_end_matches('?').parse();
            value.is_ok_and(|value: f64| range.contains(&value))
        })
    };
    assert!(
        !has_x(&terminal.text(), 140.0..155.0),
        "{}",
        terminal.text()
    );
    let question = "Move x off its limit switch? It moves alone, slowly";
    // Another key than Enter answers no.
    terminal.press_expect(b"b", question);
    terminal.press(b"n");
    terminal.wait_until("closed", |text| !text.contains(question));
    terminal.expect_state("DISABLED");
    confirm(&terminal, b"b", question);
    terminal.expect_state("IDLE");
    terminal.wait_until("x off its switch", |text| has_x(text, 140.0..155.0));
}
