//! In real time: over ports, from a stick, from keys in a terminal.

use super::scene::{self, Folder, Served, haptimill, number, start_with};
use super::{AWAY, MM, records, within_limits};
use std::io::Write;
use std::path::Path;
use std::process::Stdio;

/// Two controllers, each behind a port of its own, in real time.
#[cfg(unix)]
#[test]
fn two_boards_are_connected_over_ports_and_orders_come_line_by_line() {
    let folder = Folder::new();
    let script = folder.file("person.toml", AWAY);
    let machine = Served::on_tcp(&[]);
    let arm = Served::on(
        "pty",
        &[
            "--machine",
            "machines/hand-master.toml",
            "--person",
            &script,
        ],
    );
    let out = folder.path("out");
    let (orders, mut input) = std::io::pipe().unwrap();
    let mut session = start_with(
        &[
            "teleop",
            "--port",
            &machine.port,
            "--hand",
            &arm.port,
            "--hand-baud",
            "1000000",
            "--out",
            &out,
            "--for",
            "8",
            // This is about ports and orders, in real time: a busy computer is not to hold the machine.
            "--stale",
            "200",
        ],
        Stdio::from(orders),
    );
    session.says("the hand leads");
    session.says("idle -> running");
    std::thread::sleep(std::time::Duration::from_millis(1500));
    input.write_all(b"hold\n").unwrap();
    session.says("running -> on hold");
    input.write_all(b"nonsense\nresume\n").unwrap();
    session.says("no order");
    session.says("on hold -> running");
    let ran = session.end().ended_with(0);
    println!("{}", ran.out);
    let said = folder.summary("out");
    let session = &said["session"];
    assert_eq!(session["ended"], "done");
    assert_eq!(session["latency_is_exact"], false);
    assert!(number(session, "words") > 200.0);
    let table = folder.read("out/hand.csv");
    let tool: Vec<f64> = table
        .lines()
        .skip(1)
        .map(|line| line.split(',').nth(10).unwrap().parse().unwrap())
        .collect();
    assert!(*tool.last().unwrap() < -10.0, "{tool:?}");
    // Exchanged, both say what they are.
    let ran = haptimill(&[
        "teleop",
        "--port",
        &arm.port,
        "--hand",
        &machine.port,
        "--out",
        &out,
        "--for",
        "1",
    ]);
    assert!(ran.code != 0);
}

/// A game controller whose device file is a pipe. Held open from the start: a pipe without a writer is at its end.
#[cfg(unix)]
fn stick(device: &str) -> std::fs::File {
    rustix::fs::mknodat(
        rustix::fs::CWD,
        device,
        rustix::fs::FileType::Fifo,
        rustix::fs::Mode::from_raw_mode(0o600),
        0,
    )
    .unwrap();
    let mut both = std::fs::File::options();
    both.read(true).write(true).open(device).unwrap()
}

#[cfg(unix)]
#[test]
fn a_line_that_is_no_text_is_refused_and_stop_is_still_heard() {
    let folder = Folder::new();
    let device = folder.path("js0");
    let _stick = stick(&device);
    let (out, hand) = (folder.path("out"), format!("joystick:{device}"));
    let arguments = ["teleop", "--hand", &hand, "--out", &out, "--for", "20"];
    let (orders, mut input) = std::io::pipe().unwrap();
    let mut session = start_with(&arguments, Stdio::from(orders));
    session.says("idle -> running");
    input.write_all(b"r\xe9sume\n").unwrap();
    session.says("is no order; write hold");
    input.write_all(b"stop\n").unwrap();
    let ran = session.end().ended_with(7);
    assert!(ran.err.contains("stopped by the operator"), "{}", ran.err);
    let said = folder.summary("out");
    assert_eq!(said["session"]["refused"].as_array().unwrap().len(), 1);

    // A folder can be opened, and not be read.
    let unreadable = std::fs::File::open(scene::root()).unwrap();
    let ran = start_with(&arguments, Stdio::from(unreadable))
        .end()
        .ended_with(7);
    let what = "orders cannot be read any more: ";
    assert!(ran.out.contains(what) && ran.err.contains(what), "{ran:?}");
}

/// A hand that is no device, and one that goes while it leads nothing.
#[cfg(unix)]
#[test]
fn an_invalid_device_is_refused_and_a_lost_one_is_reported() {
    let folder = Folder::new();
    let out = folder.path("out");
    let file = folder.file("file", "");
    for kind in ["joystick", "mouse3d"] {
        for path in ["/dev/null", "/dev/zero", &file, "/"] {
            let hand = format!("{kind}:{path}");
            let ran = haptimill(&["teleop", "--hand", &hand, "--out", &out]).ended_with(5);
            assert!(ran.err.contains(&format!("{path}: no ")), "{}", ran.err);
            assert!(!Path::new(&out).exists());
        }
    }
    let device = folder.path("js0");
    let stick = stick(&device);
    let hand = format!("joystick:{device}");
    let mut session = start_with(
        &["teleop", "--hand", &hand, "--out", &out, "--for", "4"],
        Stdio::null(),
    );
    session.says("idle -> running");
    drop(stick);
    session.says("master: ");
    let ran = session.end().ended_with(5);
    assert!(ran.err.contains("the master is lost: "), "{}", ran.err);
    let said = folder.summary("out");
    assert_eq!(said["session"]["ended"], "hand_lost");
}

#[cfg(unix)]
#[test]
fn a_stick_leads_while_its_button_is_held() {
    let folder = Folder::new();
    let device = folder.path("js0");
    let mut stick = stick(&device);
    let out = folder.path("out");
    let hand = format!("joystick:{device}");
    let mut session = start_with(
        &[
            "teleop", "--hand", &hand, "--out", &out, "--for", "5", "--speed", "10",
        ],
        Stdio::null(),
    );
    session.says("idle -> running");
    let record = |value: i16, kind: u8, number: u8| {
        let [low, high] = value.to_le_bytes();
        [0, 0, 0, 0, low, high, kind, number]
    };
    stick.write_all(&record(32767, 2, 0)).unwrap();
    std::thread::sleep(std::time::Duration::from_millis(500));
    stick.write_all(&record(1, 1, 0)).unwrap();
    std::thread::sleep(std::time::Duration::from_millis(1500));
    stick.write_all(&record(0, 1, 0)).unwrap();
    session.end().ended_with(0);
    let made = records(&format!("{out}/recording.hmr"));
    within_limits(&made);
    let x = f64::from(made.last().unwrap().commanded[0] - made[0].commanded[0]) / MM;
    // 10 mm/s for about a second and a half, as this computer keeps time.
    assert!((8.0..20.0).contains(&x), "{x} mm");
    haptimill(&["replay", &format!("{out}/recording.hmr")]).ended_with(0);
}

/// Keys in a real terminal, and a window that is closed while the machine moves.
#[cfg(unix)]
#[test]
fn a_key_is_a_step_and_a_closed_window_stops_the_machine() {
    use super::terminal::{Keyboard, Terminal};
    let folder = Folder::new();
    let out = folder.path("out");
    let open = |more: &[&str]| {
        let words = ["teleop", "--hand", "keyboard", "--out", &out];
        Terminal::start(
            Path::new(env!("CARGO_BIN_EXE_haptimill")),
            &[&words, more].concat(),
            &scene::root(),
            (150, 30),
            Keyboard::Plain,
        )
    };
    let mut window = open(&[]);
    window.sees("idle -> running");
    assert!(!window.is_as_before());
    for _ in 0..3 {
        window.keys(b"d");
        std::thread::sleep(std::time::Duration::from_millis(200));
    }
    window.sees("Run free");
    window.brings(b"\x1b[6~", "Run led");
    window.sees("Run free");
    window.brings(b" ", "running -> on hold");
    window.brings(b"g", "on hold -> running");
    window.keys(b"q");
    assert_eq!(window.end(), 0, "{}", window.text());
    assert!(window.is_as_before());
    let made = records(&format!("{out}/recording.hmr"));
    within_limits(&made);
    let way = |axis: usize| {
        f64::from(made.last().unwrap().commanded[axis] - made[0].commanded[axis]) / MM
    };
    // Three steps of 0.2 mm along x and one down, and the filter comes to rest within 2 um.
    assert!(
        (way(0) - 0.6).abs() < 0.002 && (way(2) + 0.2).abs() < 0.002,
        "{} {}",
        way(0),
        way(2)
    );

    let machine = Served::on_tcp(&[]);
    let mut window = open(&["--port", &machine.port, "--speed", "2"]);
    window.sees("idle -> running");
    window.brings(b"++d", "led ");
    window.close();
    // Whatever the process still could say: the machine stands, and knows where.
    let begun = std::time::Instant::now();
    let at_rest = loop {
        let tried = machine.tries(&["status", "--json"]);
        if tried.code == 0 {
            let status = tried.json();
            if status["state"] != "Run" {
                break status;
            }
        }
        assert!(begun.elapsed().as_secs() < 20, "{tried:?}");
    };
    assert_eq!(at_rest["position_kept"], true, "{at_rest:#}");
    let again = machine.status();
    assert_eq!(at_rest["commanded"], again["commanded"]);
}

/// A machine with an arm on its own board, behind a port: the recording has what was reported of the hand.
#[test]
fn a_hand_behind_a_port_is_recorded_as_it_is_reported() {
    let folder = Folder::new();
    let own = folder.machine_with(haptimill_machine_file::HAND);
    let served = Served::on_tcp(&["--machine", &own]);
    let program = folder.file("short.ngc", "G21 G90 F600\nG1 X2\nG1 X0\nM30\n");
    let out = folder.path("out");
    let run = [
        "run",
        &program,
        "--machine",
        &own,
        "--port",
        &served.port,
        "--quiet",
        "--out",
        &out,
    ];
    haptimill(&run).ended_with(0);
    let trace = format!("{out}/recording.hmr");
    let made = records(&trace);
    let known = made.iter().filter(|record| record.hand_flags != 0).count();
    assert!(
        known > 3 && made.len() < 2 * known + 10,
        "{known} of {}",
        made.len()
    );
    let ran =
        haptimill(&["trace", "csv", &trace, "--columns", "z_hand_mm,hand_held"]).ended_with(0);
    assert!(
        ran.out
            .lines()
            .any(|line| line.starts_with("600.0") && line.ends_with(",0")),
        "{}",
        ran.out
    );
}

/// Nothing was led when it went, so nothing held: it is told all the same.
#[test]
fn an_arm_that_is_lost_while_its_switch_is_released_is_reported() {
    let folder = Folder::new();
    let machine = Served::on_tcp(&[]);
    let mut arm = Served::on_tcp(&["--machine", "machines/hand-master.toml"]);
    let out = folder.path("out");
    let mut session = start_with(
        &[
            "teleop",
            "--port",
            &machine.port,
            "--hand",
            &arm.port,
            "--out",
            &out,
            "--for",
            "5",
        ],
        Stdio::null(),
    );
    session.says("idle -> running");
    std::thread::sleep(std::time::Duration::from_millis(500));
    arm.process.kill();
    session.says("master: ");
    let ran = session.end().ended_with(5);
    assert!(ran.err.contains("the master is lost: "), "{}", ran.err);
    let said = folder.summary("out");
    assert_eq!(said["session"]["holds"].as_array().unwrap().len(), 0);
}

/// The arm's controller is gone with its port, and comes back.
#[cfg(unix)]
#[test]
fn an_arm_that_goes_and_comes_back_leads_again_when_it_is_told_to() {
    let folder = Folder::new();
    let script = folder.file("person.toml", AWAY);
    let machine = Served::on_tcp(&[]);
    let more = [
        "--machine",
        "machines/hand-master.toml",
        "--person",
        &script,
    ];
    let mut arm = Served::on_tcp(&more);
    let out = folder.path("out");
    let (orders, mut input) = std::io::pipe().unwrap();
    let mut session = start_with(
        &[
            "teleop",
            "--port",
            &machine.port,
            "--hand",
            &arm.port,
            "--out",
            &out,
            "--for",
            "60",
        ],
        Stdio::from(orders),
    );
    session.says("idle -> running");
    std::thread::sleep(std::time::Duration::from_millis(1500));
    arm.process.kill();
    session.says("running -> on hold");
    input.write_all(b"resume\n").unwrap();
    session.says("not resumed: master: ");
    let again = Served::on(&arm.port, &more);
    std::thread::sleep(std::time::Duration::from_millis(2500));
    input.write_all(b"resume\n").unwrap();
    session.says("on hold -> running");
    input.write_all(b"gp=7\nend\n").unwrap();
    session.says("G_P of 7 is out of its range: 0.1 to 2");
    session.end().ended_with(0);
    drop(again);
    let said = folder.summary("out");
    let holds = said["session"]["holds"].as_array().unwrap();
    assert_eq!(holds.len(), 1, "{said:#}");
    assert_eq!(said["session"]["refused"].as_array().unwrap().len(), 2);
}
