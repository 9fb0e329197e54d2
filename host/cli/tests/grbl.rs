//! `haptimill bridge grbl` with a sender on its pseudo-terminal.

#![cfg(unix)]

use crate::scene;
use scene::{Running, SimServer, TestFolder, start};
use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufRead as _, BufReader, Write as _};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// Longest wait for an answer.
const LIMIT: Duration = Duration::from_secs(120);

/// Receive buffer of Grbl, bytes: a sender never has more under way.
const BUFFER: usize = 128;

struct Sender {
    _command: Running,
    _folder: TestFolder,
    pty: File,
    lines: Receiver<String>,
    /// What was received and not looked at.
    messages: Vec<String>,
}

impl Sender {
    fn start(more: &[&str]) -> Self {
        let folder = TestFolder::new();
        let link = folder.path("grbl");
        let given = [
            "bridge",
            "grbl",
            "--link",
            &link,
            "--machine",
            "machines/mill3-servo.toml",
        ];
        let mut command = start(&[&given[..], more].concat());
        let name = command.line().trim().to_string();
        assert_eq!(std::fs::read_link(&link).unwrap().to_str(), Some(&*name));
        let pty = File::options().read(true).write(true).open(&link).unwrap();
        let reader = BufReader::new(pty.try_clone().unwrap());
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            for line in reader.lines().map_while(Result::ok) {
                if sender.send(line.trim_end().to_string()).is_err() {
                    return;
                }
            }
        });
        Self {
            _command: command,
            _folder: folder,
            pty,
            lines,
            messages: Vec::new(),
        }
    }

    fn write(&mut self, bytes: &[u8]) {
        self.pty.write_all(bytes).unwrap();
    }

    fn next(&mut self) -> String {
        let line = self.lines.recv_timeout(LIMIT);
        let line = line.unwrap_or_else(|_| panic!("no answer after {:?}", self.messages));
        self.messages.push(line.clone());
        line
    }

    /// Sends a line and waits for its `ok` or `error:N`.
    fn line(&mut self, text: &str) -> String {
        self.write(format!("{text}\n").as_bytes());
        loop {
            let line = self.next();
            if line == "ok" || line.starts_with("error:") {
                return line;
            }
        }
    }

    /// The newest status report.
    fn status(&mut self) -> Status {
        self.write(b"?");
        loop {
            let line = self.next();
            if line.starts_with('<') {
                return Status::read(&line);
            }
        }
    }

    fn wait_for(&mut self, state: &str) -> Status {
        let until = Instant::now() + LIMIT;
        loop {
            let status = self.status();
            if status.state == state {
                return status;
            }
            assert!(
                Instant::now() < until,
                "{state}: {status:?} {:?}",
                self.messages
            );
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    fn reset(&mut self) {
        self.write(&[0x18]);
        while self.next() != "Grbl 1.1h ['$' for help]" {}
    }

    fn home(&mut self) {
        self.reset();
        assert_eq!(self.line("$H"), "ok");
    }

    fn has(&self, part: &str) -> bool {
        self.messages.iter().any(|line| line.contains(part))
    }
}

#[derive(Debug, Clone)]
struct Status {
    state: String,
    machine: Vec<f64>,
    text: String,
}

impl Status {
    fn read(line: &str) -> Self {
        let text = line.trim_matches(['<', '>']).to_string();
        let mut fields = text.split('|');
        let state = fields.next().unwrap().to_string();
        let position = fields
            .find_map(|field| field.strip_prefix("MPos:"))
            .unwrap();
        let machine = position
            .split(',')
            .map(|value| value.parse().unwrap())
            .collect();
        Self {
            state,
            machine,
            text,
        }
    }
}

/// The path is that of the program, the answers are those that a sender counts.
#[test]
fn a_job_streamed_by_counting_characters_ends_in_its_place() {
    let mut sender = Sender::start(&[]);
    sender.reset();
    assert_eq!(sender.status().state, "Alarm");
    assert_eq!(sender.line("G0 X-1"), "error:9", "not homed");
    assert_eq!(sender.line("$H"), "ok");
    let home = sender.wait_for("Idle").machine;
    assert_eq!(sender.line("$$"), "ok");
    assert!(sender.has("$22=1") && sender.has("$132="));
    assert_eq!(sender.line("$G"), "ok");
    assert!(
        sender.has("[GC:G80 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]"),
        "{:?}",
        sender.messages
    );
    assert_eq!(sender.line("$#"), "ok");
    assert!(sender.has("[G54:0.000,0.000,0.000]"));
    // 60 sides of a polygon, then a known end.
    let mut program = vec!["G21 G90 G94".to_string(), "S3000 M3".to_string()];
    for side in 0..60 {
        let (sin, cos) = (f64::from(side) / 60.0 * std::f64::consts::TAU).sin_cos();
        program.push(format!(
            "G1 X{:.4} Y{:.4} F3000",
            -10.0 + 8.0 * cos,
            8.0 * sin
        ));
    }
    program.extend([
        "G0 X-3 Y2".into(),
        format!("Z{:.3}", home[2] - 2.5),
        "M5".into(),
    ]);
    let mut under_way = VecDeque::new();
    let mut answers = 0;
    for line in &program {
        let length = line.len() + 1;
        while under_way.iter().sum::<usize>() + length > BUFFER {
            let answer = sender.next();
            assert!(!answer.starts_with("error"), "{:?}", sender.messages);
            if answer == "ok" {
                under_way.pop_front();
                answers += 1;
            }
        }
        sender.write(format!("{line}\n").as_bytes());
        under_way.push_back(length);
    }
    while answers < program.len() {
        answers += usize::from(sender.next() == "ok");
    }
    let end = sender.wait_for("Idle");
    for (value, expected) in end.machine.iter().zip([-3.0, 2.0, home[2] - 2.5]) {
        assert!((value - expected).abs() < 0.001, "{end:?}");
    }
}

/// Hold decelerates and keeps the rest; a reset drops it and keeps the position.
#[test]
fn hold_resume_and_reset_are_executed_at_once() {
    let mut sender = Sender::start(&[]);
    sender.home();
    assert_eq!(sender.line("G1 X-40 F600"), "ok");
    sender.wait_for("Run");
    sender.write(b"!");
    let held = sender.wait_for("Hold:0");
    std::thread::sleep(Duration::from_millis(300));
    let later = sender.status();
    assert_eq!((&later.state, &later.machine), (&held.state, &held.machine));
    assert!(held.machine[0] > -39.0, "{held:?}");
    sender.write(b"~");
    let moved = sender.wait_for("Run");
    assert!(moved.machine[0] <= held.machine[0]);
    sender.reset();
    let dropped = sender.wait_for("Idle");
    assert!(dropped.machine[0] > -39.0, "{dropped:?}");
    // The interpreter goes on at the place of the machine.
    assert_eq!(sender.line("G91 G0 X-1"), "ok");
    let end = sender.wait_for("Idle");
    assert!(
        (end.machine[0] - (dropped.machine[0] - 1.0)).abs() < 0.002,
        "{dropped:?} {end:?}"
    );
}

/// A jog ends at a jog cancel, and changes no mode.
#[test]
fn a_jog_is_cancelled_and_leaves_nothing_in_force() {
    let mut sender = Sender::start(&[]);
    sender.home();
    let home = sender.wait_for("Idle");
    assert_eq!(sender.line("$J=G91 G21 X-30 F600"), "ok");
    sender.wait_for("Jog");
    assert_eq!(
        sender.line("G0 X0"),
        "error:9",
        "blocks wait for the end of a jog"
    );
    sender.write(&[0x85]);
    let end = sender.wait_for("Idle");
    assert!(end.machine[0] > home.machine[0] - 29.0, "{end:?}");
    assert_eq!(sender.line("$G"), "ok");
    assert!(
        sender
            .messages
            .iter()
            .rev()
            .any(|line| line.contains(" G90 "))
    );
    assert_eq!(sender.line("$J=X1"), "error:22");
    assert_eq!(sender.line("$J=G91 X5000 F600"), "error:15");
    assert_eq!(sender.line("$J=G91 X1 F600 M3"), "error:16");
    sender.wait_for("Idle");
}

#[test]
fn mistakes_get_their_error_and_the_bridge_goes_on() {
    let mut sender = Sender::start(&[]);
    sender.home();
    assert_eq!(sender.line("G1 X- F100"), "error:20");
    assert!(sender.has("[MSG:"));
    assert_eq!(sender.line("G0 X9999"), "error:20");
    assert_eq!(sender.line("G38.2 Z0 F100"), "error:20");
    assert_eq!(sender.line("$Q"), "error:3");
    assert_eq!(sender.line("$100=250"), "error:5");
    assert_eq!(sender.line(&"X1 ".repeat(100)), "error:11");
    assert_eq!(sender.line(""), "ok");
    assert_eq!(sender.line("; a comment"), "ok");
    sender.write(&[0x91, 0x96, 0x9a]);
    let status = sender.status();
    assert!(status.text.contains("Ov:110,50,110"), "{status:?}");
    sender.wait_for("Idle");
    assert_eq!(sender.line("$C"), "ok");
    assert_eq!(sender.status().state, "Check");
    assert_eq!(sender.line("G1 X-5 F100"), "ok");
    assert_eq!(sender.line("$C"), "ok");
    let end = sender.wait_for("Idle");
    assert!(
        end.machine[0].abs() < 0.001,
        "checked blocks move nothing: {end:?}"
    );
}

#[test]
fn nothing_is_switched_on_before_every_input_is_read() {
    let folder = TestFolder::new();
    let machine = folder.machine_with("");
    let served = SimServer::on_tcp(&["--machine", &machine]);
    let bridge = ["bridge", "grbl", "--machine", &machine];
    let taken = folder.file("taken", "");
    let refused = served.run(&[&bridge[..], &["--link", &taken]].concat());
    let refused = refused.expect_code(9);
    assert!(refused.err.contains("use another path"), "{}", refused.err);
    assert_eq!(served.status_of(&machine)["state"], "Disabled");
    folder.file("own.offsets.toml", "[g54\nx = 1");
    let refused = served.run(&bridge).expect_code(3);
    assert!(refused.err.contains("own.offsets.toml"), "{}", refused.err);
    assert_eq!(served.status_of(&machine)["state"], "Disabled");
}
