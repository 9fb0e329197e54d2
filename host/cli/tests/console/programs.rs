//! Part programs, and the four keys that are always heard.

use super::scene::{SimServer, TestFolder};
use super::terminal::Keyboard;
use super::*;
use std::time::Duration;

/// Back and forth for half a minute, at 10 mm/s, with a pause after the first way.
const LONG: &str =
    "G21 G90 F600\nG1 X10\nM0\nG1 X0\nG1 X20\nG1 X0\nG1 X20\nG1 X0\nG1 X20\nG1 X0\nM30\n";

#[test]
fn hold_resume_stop_and_emergency_are_heard_whatever_is_open() {
    let folder = TestFolder::new();
    let program = folder.file("long.ngc", LONG);
    let served = SimServer::on_tcp(&[]);
    let terminal = homed(&["--port", &served.port, &program], Keyboard::Plain);
    run(&terminal);
    terminal.sees("long.ngc  line 2/");
    // The pause of the program.
    terminal.sees("pause of the program in line 3. Ctrl-R goes on");
    terminal.state("HOLD");
    terminal.keys(RESUME);
    terminal.state("RUN");
    // Hold while the table of keys is open, resume while a name is typed.
    terminal.brings(b"?", "Keys: arrows scroll");
    terminal.keys(SPACE);
    terminal.state("HOLD");
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
    terminal.sees("on hold. Ctrl-R resumes");
    let (before, after) = held();
    assert_eq!(row(&before), row(&after));
    terminal.keys(b"p");
    terminal.keys(b"some name");
    // A letter of a name is no key; the space in it is.
    terminal.sees("somename_");
    terminal.keys(RESUME);
    terminal.state("RUN");
    terminal.keys(b"\x15");
    terminal.keys(STOP);
    terminal.state("IDLE");
    terminal.sees("long.ngc: dropped");
    terminal.escape();
    // From where it stands, again, with less speed; then the emergency stop, while a question is open.
    for _ in 0..5 {
        terminal.keys(b"-");
    }
    terminal.sees("override 50 %");
    run(&terminal);
    terminal.sees("path speed 50 %");
    terminal.brings(b"q", "Quit?");
    terminal.keys(EMERGENCY);
    terminal.state("EMERGENCY STOP");
    terminal.sees("EMERGENCY STOP: drives off");
    terminal.escape();
    terminal.brings(
        b"e",
        "enable: not possible while the machine is in emergency stop",
    );
    terminal.keys(b"x");
    terminal.state("DISABLED");
    terminal.keys(b"q");
    let mut terminal = terminal;
    assert_eq!(terminal.end(), 0, "{}", terminal.text());
    assert!(terminal.is_as_before());
    // From outside: the drives are off, and the machine is reset.
    assert_eq!(served.status()["state"], "Disabled");
}

#[test]
fn a_program_runs_to_its_end_beside_a_recording() {
    let folder = TestFolder::new();
    let program = folder.file("short.ngc", "G21 G90 F1200\nG1 X4\nG3 X0 I-2\nM30\n");
    let out = folder.path("");
    let mut terminal = homed(&["--out", &out, &program], Keyboard::Plain);
    terminal.brings(b"l", "REC console-");
    run(&terminal);
    terminal.sees("short.ngc: done");
    terminal.state("IDLE");
    terminal.brings(b"l", " rows");
    terminal.brings(b"q", "the drives stay on and hold");
    terminal.keys(ENTER);
    assert_eq!(terminal.end(), 0);
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
    // A frame every 20 ms, as it was asked for; a busy computer may have passed over some.
    let mut gaps: Vec<f64> = times.windows(2).map(|two| two[1] - two[0]).collect();
    gaps.sort_by(f64::total_cmp);
    assert!(gaps.len() > 30 && gaps[gaps.len() / 2] < 0.0201, "{gaps:?}");
}

/// It is said to be idle before it is said where it stands: on this line a fifth of a second before.
#[cfg(unix)]
#[test]
fn a_program_can_be_chosen_in_the_moment_in_which_the_machine_comes_to_rest() {
    let folder = TestFolder::new();
    let program = folder.file("way.ngc", "G21 G90 F600\nG1 X1\nM30\n");
    let served = SimServer::on("pty", &["--fault", "link-delay ms=100"]);
    // Of a line as slow as that reports come more rarely, too.
    let line = ["--port", &served.port, "--baud", "9600", &program];
    let terminal = homed(&line, Keyboard::Plain);
    terminal.brings(b"p\r", "The machine moves.");
}

#[test]
fn a_program_with_a_mistake_is_refused_with_its_line() {
    let folder = TestFolder::new();
    let bad = folder.file("bad.ngc", "G21\nG1 X10 F600\nG1 X900\nM30\n");
    // Given on the command line: before the screen is taken.
    let mut terminal = console(&[&bad], Keyboard::Plain);
    assert_eq!(terminal.end(), 4);
    assert!(terminal.is_as_before());
    assert!(
        terminal.text().contains("bad.ngc:3:"),
        "{}",
        terminal.text()
    );
    // Typed: over the screen.
    let terminal = homed(&[], Keyboard::Plain);
    terminal.brings(b"p", "Part program");
    terminal.keys(bad.as_bytes());
    terminal.brings(ENTER, "The program is refused");
    terminal.sees("bad.ngc:3:");
    terminal.escape();
    terminal.state("IDLE");
    terminal.keys(b"p");
    terminal.brings(b"\x15/nowhere.ngc\r", "/nowhere.ngc: cannot be read");
}

#[test]
fn axes_and_force_loop_are_set_from_the_screen() {
    let served = SimServer::on_tcp(&[]);
    let terminal = homed(&["--port", &served.port], Keyboard::Plain);
    terminal.brings(b"a", "Axes: a jog begins and ends at rest");
    terminal.keys(DOWN);
    terminal.brings(b"h", "y: hold");
    terminal.escape();
    terminal.waits("held y", |text| {
        text.lines()
            .any(|row| row.starts_with(" y ") && row.contains("hold"))
    });
    terminal.brings(b"t", "Tare?");
    terminal.brings(ENTER, "the force sensor has a new zero");
    terminal.brings(b"y", "Force loop");
    terminal.brings(ENTER, "x yields");
    terminal.brings(b"++", "f_d 6.0 N");
    // Refused by the controller, with its bound.
    for _ in 0..12 {
        terminal.keys(b"-");
    }
    terminal.sees("force loop of x");
    terminal.escape();
    terminal.waits("yielding x", |text| {
        text.lines().any(|row| row.contains("yield x>"))
    });
    // The console is left and another host asks.
    terminal.keys(b"q\r");
    let mut terminal = terminal;
    assert_eq!(terminal.end(), 0);
    // Another console asks the controller what it has, not the machine file.
    let terminal = console(&["--port", &served.port], Keyboard::Plain);
    terminal.state("IDLE");
    terminal.waits("the force of before", |text| {
        text.lines()
            .any(|row| row.contains("yield x>") && !row.contains("x>5.0N"))
    });
}
