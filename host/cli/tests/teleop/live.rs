//! Teleoperation in real time: over ports, with a joystick, with keys in a terminal.

use super::scene::{self, Running, SimServer, TestFolder, haptimill, number, start_with};
use super::{AWAY, MM, expect_within_limits, read_records};
use std::io::Write;
use std::path::Path;
use std::process::Stdio;

/// Moves by 40 mm in 10 s with the enabling switch pressed.
const SLOWLY_AWAY: &str = "
[[button]]
at_s = 0.3
held = true
[[stroke]]
at_s = 0.5
to_mm = [-40.0, 5.0, 3.0]
pace_mm_s = 4.0
ramp_s = 0.3
";

/// Waits until the tool is beyond `x` in the table of a session that runs.
///
/// Time does not count, because a busy computer moves the machines slower than real time.
#[cfg(unix)]
fn wait_for_tool(session: &mut Running, folder: &TestFolder, x: f64) {
    let begun = std::time::Instant::now();
    loop {
        let table = std::fs::read_to_string(folder.path("out/teleop.csv")).unwrap_or_default();
        // The last line may be written in part.
        let whole = table.rsplit_once('\n').map_or("", |(whole, _)| whole);
        let last = whole.lines().skip(1).last();
        let tool = last.and_then(|line| line.split(',').nth(10)?.parse::<f64>().ok());
        if tool.is_some_and(|tool| tool < x) {
            return;
        }
        assert!(
            session.runs(),
            "the session ended with the tool at {tool:?}"
        );
        assert!(begun.elapsed() < scene::LIMIT, "the tool is at {tool:?}");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
}

/// Two controllers on two ports in real time.
#[cfg(unix)]
#[test]
fn two_boards_over_ports_with_commands_on_standard_input() {
    let folder = TestFolder::new();
    let script = folder.file("operator.toml", SLOWLY_AWAY);
    let machine = SimServer::on_tcp(&[]);
    let arm = SimServer::on(
        "pty",
        &[
            "--machine",
            "machines/haptic-master.toml",
            "--operator",
            &script,
        ],
    );
    let out = folder.path("out");
    let (commands, mut input) = std::io::pipe().unwrap();
    let mut session = start_with(
        &[
            "teleop",
            "--port",
            &machine.port,
            "--master",
            &arm.port,
            "--master-baud",
            "1000000",
            "--out",
            &out,
            // The test is about ports and commands; a long --stale prevents a hold on a busy
            // computer.
            "--stale",
            "1000",
        ],
        Stdio::from(commands),
    );
    session.wait_for_output("teleoperation started");
    session.wait_for_output("idle -> running");
    wait_for_tool(&mut session, &folder, -1.0);
    input.write_all(b"hold\n").unwrap();
    session.wait_for_output("running -> on hold");
    input.write_all(b"nonsense\nresume\n").unwrap();
    session.wait_for_output("no command");
    session.wait_for_output("on hold -> running");
    wait_for_tool(&mut session, &folder, -10.0);
    input.write_all(b"end\n").unwrap();
    let ran = session.end().expect_code(0);
    println!("{}", ran.out);
    let said = folder.summary("out");
    let session = &said["session"];
    assert_eq!(session["ended"], "done");
    assert_eq!(session["latency_is_exact"], false);
    assert!(number(session, "samples_sent") > 20.0);
    let table = folder.read("out/teleop.csv");
    let tool: Vec<f64> = table
        .lines()
        .skip(1)
        .map(|line| line.split(',').nth(10).unwrap().parse().unwrap())
        .collect();
    assert!(*tool.last().unwrap() < -10.0, "{tool:?}");
    // With exchanged ports both controllers report what they are.
    let ran = haptimill(&[
        "teleop",
        "--port",
        &arm.port,
        "--master",
        &machine.port,
        "--out",
        &out,
        "--for",
        "1",
    ]);
    assert!(ran.code != 0);
}

/// A game controller whose device file is a pipe. The test keeps it open, because a pipe without a
/// writer is at its end.
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
fn line_that_is_not_text_is_refused_and_stop_still_works() {
    let folder = TestFolder::new();
    let device = folder.path("js0");
    let _stick = stick(&device);
    let (out, master) = (folder.path("out"), format!("joystick:{device}"));
    let arguments = ["teleop", "--master", &master, "--out", &out, "--for", "20"];
    let (commands, mut input) = std::io::pipe().unwrap();
    let mut session = start_with(&arguments, Stdio::from(commands));
    session.wait_for_output("idle -> running");
    input.write_all(b"r\xe9sume\n").unwrap();
    session.wait_for_output("is no command; write hold");
    input.write_all(b"stop\n").unwrap();
    let ran = session.end().expect_code(7);
    assert!(ran.err.contains("stopped by the operator"), "{}", ran.err);
    let said = folder.summary("out");
    assert_eq!(said["session"]["refused"].as_array().unwrap().len(), 1);

    // A folder can be opened but not read.
    let unreadable = std::fs::File::open(scene::root()).unwrap();
    let ran = start_with(&arguments, Stdio::from(unreadable))
        .end()
        .expect_code(7);
    let what = "commands cannot be read any more: ";
    assert!(ran.out.contains(what) && ran.err.contains(what), "{ran:?}");
}

/// A master that is no device, and one that is lost while its enabling switch is released.
#[cfg(unix)]
#[test]
fn wrong_device_is_refused_and_a_lost_one_is_reported() {
    let folder = TestFolder::new();
    let out = folder.path("out");
    let file = folder.file("file", "");
    for kind in ["joystick", "mouse3d"] {
        for path in ["/dev/null", "/dev/zero", &file, "/"] {
            let master = format!("{kind}:{path}");
            let ran = haptimill(&["teleop", "--master", &master, "--out", &out]).expect_code(5);
            assert!(ran.err.contains(&format!("{path}: no ")), "{}", ran.err);
            assert!(!Path::new(&out).exists());
        }
    }
    let device = folder.path("js0");
    let stick = stick(&device);
    let master = format!("joystick:{device}");
    let mut session = start_with(
        &["teleop", "--master", &master, "--out", &out, "--for", "4"],
        Stdio::null(),
    );
    session.wait_for_output("idle -> running");
    drop(stick);
    session.wait_for_output("unexpected end of file");
    let ran = session.end().expect_code(5);
    assert!(ran.err.contains("the master is lost: "), "{}", ran.err);
    let said = folder.summary("out");
    assert_eq!(said["session"]["ended"], "master_lost");
}

#[cfg(unix)]
#[test]
fn joystick_moves_the_tool_while_its_button_is_pressed() {
    let folder = TestFolder::new();
    let device = folder.path("js0");
    let mut stick = stick(&device);
    let out = folder.path("out");
    let master = format!("joystick:{device}");
    let mut session = start_with(
        &[
            "teleop", "--master", &master, "--out", &out, "--for", "5", "--speed", "10",
        ],
        Stdio::null(),
    );
    session.wait_for_output("idle -> running");
    let record = |value: i16, kind: u8, number: u8| {
        let [low, high] = value.to_le_bytes();
        [0, 0, 0, 0, low, high, kind, number]
    };
    stick.write_all(&record(32767, 2, 0)).unwrap();
    std::thread::sleep(std::time::Duration::from_millis(500));
    stick.write_all(&record(1, 1, 0)).unwrap();
    std::thread::sleep(std::time::Duration::from_millis(1500));
    stick.write_all(&record(0, 1, 0)).unwrap();
    session.end().expect_code(0);
    let made = read_records(&format!("{out}/recording.hmr"));
    expect_within_limits(&made);
    let x = f64::from(made.last().unwrap().commanded[0] - made[0].commanded[0]) / MM;
    // 10 mm/s for about 1.5 s of real time.
    assert!((8.0..20.0).contains(&x), "{x} mm");
    haptimill(&["replay", &format!("{out}/recording.hmr")]).expect_code(0);
}

/// Keys in a real terminal, and a terminal that is closed while the machine moves.
#[cfg(unix)]
#[test]
fn key_moves_one_step_and_a_closed_terminal_stops_the_machine() {
    use super::terminal::{Keyboard, Terminal};
    let folder = TestFolder::new();
    let out = folder.path("out");
    let open = |more: &[&str]| {
        let words = ["teleop", "--master", "keyboard", "--out", &out];
        Terminal::start(
            Path::new(env!("CARGO_BIN_EXE_haptimill")),
            &[&words, more].concat(),
            &scene::root(),
            (150, 30),
            Keyboard::Plain,
        )
    };
    let mut window = open(&[]);
    window.expect_text("idle -> running");
    assert!(!window.is_restored());
    for _ in 0..3 {
        window.press(b"d");
        std::thread::sleep(std::time::Duration::from_millis(200));
    }
    window.expect_text("Run switch released");
    window.press_expect(b"\x1b[6~", "Run switch pressed");
    window.expect_text("Run switch released");
    window.press_expect(b" ", "running -> on hold");
    window.press_expect(b"g", "on hold -> running");
    window.press(b"q");
    assert_eq!(window.exit_code(), 0, "{}", window.text());
    assert!(window.is_restored());
    let made = read_records(&format!("{out}/recording.hmr"));
    expect_within_limits(&made);
    let way = |axis: usize| {
        f64::from(made.last().unwrap().commanded[axis] - made[0].commanded[axis]) / MM
    };
    // Three steps of 0.2 mm in x and one in z; the filter settles within 2 um.
    assert!(
        (way(0) - 0.6).abs() < 0.002 && (way(2) + 0.2).abs() < 0.002,
        "{} {}",
        way(0),
        way(2)
    );

    let machine = SimServer::on_tcp(&[]);
    let mut window = open(&["--port", &machine.port, "--speed", "2"]);
    window.expect_text("idle -> running");
    window.press_expect(b"++d", "switch pressed");
    window.close();
    // The machine is at standstill with a valid position.
    let begun = std::time::Instant::now();
    let at_rest = loop {
        let tried = machine.run(&["status", "--json"]);
        if tried.code == 0 {
            let status = tried.json();
            if status["state"] != "Run" {
                break status;
            }
        }
        assert!(begun.elapsed().as_secs() < 20, "{tried:?}");
    };
    assert_eq!(at_rest["homed"], true, "{at_rest:#}");
    let again = machine.status();
    assert_eq!(at_rest["commanded"], again["commanded"]);
}

/// The recording of a machine with an arm on its own board, behind a port, has the reported master
/// data.
#[test]
fn haptic_arm_of_a_machine_on_a_port_is_recorded() {
    let folder = TestFolder::new();
    let own = folder.machine_with(haptimill_machine_file::HAPTIC_ARM);
    let served = SimServer::on_tcp(&["--machine", &own]);
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
    haptimill(&run).expect_code(0);
    let trace = format!("{out}/recording.hmr");
    let made = read_records(&trace);
    let known = made
        .iter()
        .filter(|record| record.haptic_flags != 0)
        .count();
    assert!(
        known > 3 && made.len() < 2 * known + 10,
        "{known} of {}",
        made.len()
    );
    let ran = haptimill(&[
        "trace",
        "csv",
        &trace,
        "--columns",
        "z_master_mm,master_enabling_switch",
    ])
    .expect_code(0);
    assert!(
        ran.out
            .lines()
            .any(|line| line.starts_with("600.0") && line.ends_with(",0")),
        "{}",
        ran.out
    );
}

/// The enabling switch was released, so the machine did not hold. The loss is still reported.
#[test]
fn lost_arm_with_released_enabling_switch_is_reported() {
    let folder = TestFolder::new();
    let machine = SimServer::on_tcp(&[]);
    let mut arm = SimServer::on_tcp(&["--machine", "machines/haptic-master.toml"]);
    let out = folder.path("out");
    let mut session = start_with(
        &[
            "teleop",
            "--port",
            &machine.port,
            "--master",
            &arm.port,
            "--out",
            &out,
            "--for",
            "5",
        ],
        Stdio::null(),
    );
    session.wait_for_output("idle -> running");
    std::thread::sleep(std::time::Duration::from_millis(500));
    arm.process.kill();
    session.wait_for_output("the connection is lost");
    let ran = session.end().expect_code(5);
    assert!(ran.err.contains("the master is lost: "), "{}", ran.err);
    let said = folder.summary("out");
    assert_eq!(said["session"]["holds"].as_array().unwrap().len(), 0);
}

/// The arm's controller disappears with its port, and returns.
#[cfg(unix)]
#[test]
fn reconnected_arm_continues_after_resume() {
    let folder = TestFolder::new();
    let script = folder.file("operator.toml", AWAY);
    let machine = SimServer::on_tcp(&[]);
    let more = [
        "--machine",
        "machines/haptic-master.toml",
        "--operator",
        &script,
    ];
    let mut arm = SimServer::on_tcp(&more);
    let out = folder.path("out");
    let (commands, mut input) = std::io::pipe().unwrap();
    let mut session = start_with(
        &[
            "teleop",
            "--port",
            &machine.port,
            "--master",
            &arm.port,
            "--out",
            &out,
            "--for",
            "60",
        ],
        Stdio::from(commands),
    );
    session.wait_for_output("idle -> running");
    std::thread::sleep(std::time::Duration::from_millis(1500));
    arm.process.kill();
    session.wait_for_output("running -> on hold");
    input.write_all(b"resume\n").unwrap();
    session.wait_for_output("not resumed: master: ");
    let again = SimServer::on(&arm.port, &more);
    std::thread::sleep(std::time::Duration::from_millis(2500));
    input.write_all(b"resume\n").unwrap();
    session.wait_for_output("on hold -> running");
    input.write_all(b"gp=7\nend\n").unwrap();
    session.wait_for_output("G_P of 7 is out of its range: 0.1 to 2");
    session.end().expect_code(0);
    drop(again);
    let said = folder.summary("out");
    let holds = said["session"]["holds"].as_array().unwrap();
    assert_eq!(holds.len(), 1, "{said:#}");
    assert_eq!(said["session"]["refused"].as_array().unwrap().len(), 2);
}
