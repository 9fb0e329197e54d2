//! `haptimill dnc`: programs over a pseudo-terminal in place of the serial line.

use super::stream::last_x;
use crate::scene::{SimServer, TestFolder, number, start};
use haptimill_client::port::{PtyServer, Transport as _};
use std::time::{Duration, Instant};

/// Sends bytes on the line.
fn send(line: &mut PtyServer, mut bytes: &[u8]) {
    while !bytes.is_empty() {
        let count = line.write(bytes, Duration::from_millis(100)).unwrap();
        bytes = &bytes[count..];
    }
}

#[test]
fn a_program_comes_over_a_line_and_runs() {
    let folder = TestFolder::new();
    let (file, out) = (folder.path("came.ngc"), folder.path("out"));
    let mut line = PtyServer::open().unwrap();
    let name = line.name().to_string();
    let mut dnc = start(&[
        "dnc", &file, "--line", &name, "--flow", "xon", "--out", &out,
    ]);
    dnc.wait_for_output("receiving");
    send(&mut line, b"\0\0%\r\nN1 G21 G90\r\nN2 G1 X-5 F60");
    // In the middle of a block, for less than the silence.
    std::thread::sleep(Duration::from_millis(300));
    send(&mut line, b"0\r\nN3 X0 (M30)\r\nM30\r\n%\r\n\0");
    dnc.end().expect_code(0);
    let summary = folder.summary("out");
    assert_eq!(summary["completed"], true, "{summary:#}");
    assert!(
        (number(&summary, "path_length_mm") - 10.0).abs() < 0.01,
        "{summary:#}"
    );
    assert!(
        folder
            .read("came.ngc")
            .starts_with("%\r\nN1 G21 G90\r\nN2 G1 X-5 F600\r\n")
    );
}

#[test]
fn a_line_that_is_cut_names_the_last_block_and_nothing_moves() {
    let folder = TestFolder::new();
    let (file, out) = (folder.path("came.ngc"), folder.path("out"));
    let mut line = PtyServer::open().unwrap();
    let name = line.name().to_string();
    let dnc = [
        "dnc",
        &file,
        "--line",
        &name,
        "--silence",
        "0.5",
        "--out",
        &out,
    ];
    let mut dnc = start(&dnc);
    dnc.wait_for_output("receiving");
    send(&mut line, b"%\nN10 G0 X1\nN20 X2\nN30 X");
    let cut = dnc.end().expect_code(5);
    assert!(
        cut.err.contains("last block was line 3, N20 X2;"),
        "{}",
        cut.err
    );
    assert!(cut.err.contains("nothing moved"), "{}", cut.err);
    assert!(!std::path::Path::new(&out).exists());
}

/// Each move ends before its successor comes; then the line is cut in the middle of a block.
#[test]
fn a_program_runs_as_it_comes_and_stops_where_the_line_is_cut() {
    let folder = TestFolder::new();
    let (file, out) = (folder.path("came.ngc"), folder.path("out"));
    let served = SimServer::on_tcp(&[]);
    let mut line = PtyServer::open().unwrap();
    let name = line.name().to_string();
    let arguments = [
        "dnc",
        &file,
        "--stream",
        "--line",
        &name,
        "--silence",
        "3",
        "--out",
        &out,
        "--port",
        &served.port,
    ];
    let mut dnc = start(&arguments);
    dnc.wait_for_output("receiving");
    send(&mut line, b"%\r\nG21 G90 F900\r\n");
    let recording = folder.path("out/recording.hmr");
    let reaches = |x: f64, within_s: u64| {
        let start = Instant::now();
        while last_x(&recording).is_none_or(|at| (at - x).abs() > 1e-3) {
            assert!(start.elapsed().as_secs() < within_s, "X{x} is not reached");
            std::thread::sleep(Duration::from_millis(50));
        }
    };
    send(&mut line, b"G1 X2\r\n");
    // The line is not silent while the machine homes.
    dnc.wait_for_output("running");
    reaches(2.0, 60);
    send(&mut line, b"G1 X3.5\r\n");
    reaches(3.5, 60);
    send(&mut line, b"G1 X-1\r\nG1 X");
    let cut = dnc.end().expect_code(5);
    assert!(cut.err.contains("line 5, G1 X-1"), "{}", cut.err);
    assert!(
        cut.err.contains("the last executed block is line 5"),
        "{}",
        cut.err
    );
    assert_eq!(folder.summary("out")["completed"], false);
    assert!(folder.read("came.ngc").ends_with("G1 X-1\r\n"));
    let status = served.status();
    assert_eq!(status["state"], "Idle", "{status:#}");
    assert!(
        (number(&status["commanded"], "x") + 1.0).abs() < 1e-4,
        "{status:#}"
    );
}

/// A sender that keeps to XON and XOFF: it begins with the first XON and is paused while the
/// machine executes what came. No byte is lost.
#[test]
fn a_sender_is_paused_by_xoff_and_resumed_by_xon() {
    const XON: u8 = 0x11;
    const XOFF: u8 = 0x13;
    let folder = TestFolder::new();
    let served = SimServer::on_tcp(&[]);
    let (file, out) = (folder.path("came.ngc"), folder.path("out"));
    let mut line = PtyServer::open().unwrap();
    let name = line.name().to_string();
    let dnc = start(&[
        "dnc",
        &file,
        "--stream",
        "--line",
        &name,
        "--out",
        &out,
        "--port",
        &served.port,
    ]);
    let mut text = String::from("%\r\nG21 G90 G61 F900\r\n");
    for block in 0..300 {
        text += &format!(
            "N{block} G1 X0.{} (a long line of a program)\r\n",
            block % 3
        );
    }
    text += "M30\r\n%\r\n";
    let (mut rest, mut may_send, mut pauses) = (text.as_bytes(), false, 0);
    let mut last = Instant::now();
    while !rest.is_empty() {
        assert!(
            last.elapsed() < Duration::from_secs(60),
            "the sender is not resumed"
        );
        let mut answer = [0; 16];
        let count = line.read(&mut answer, Duration::from_millis(1)).unwrap();
        for character in &answer[..count] {
            match *character {
                XON => may_send = true,
                XOFF => (may_send, pauses) = (false, pauses + 1),
                other => panic!("{other:#x} was sent"),
            }
        }
        if may_send {
            // As much as a UART keeps: a sender stops some bytes after XOFF.
            let part = &rest[..rest.len().min(16)];
            let count = line.write(part, Duration::from_millis(10)).unwrap();
            if count > 0 {
                (rest, last) = (&rest[count..], Instant::now());
            }
        }
    }
    assert!(pauses > 0, "the sender was never paused");
    dnc.end().expect_code(0);
    assert_eq!(folder.summary("out")["completed"], true);
    // What follows the second % is not kept.
    let kept = folder.read("came.ngc");
    assert_eq!(kept.len(), text.trim_end().len() + 1);
    assert!(text.starts_with(&kept), "bytes were changed");
}

/// What a pseudo-terminal shows of flow control: the settings of the line for each way, and that
/// the command takes at most 64 KiB more than the machine needs, so that the line fills also with a
/// sender that does not know XOFF.
#[test]
fn a_line_with_flow_control_holds_the_sender() {
    use rustix::fs::{Mode, OFlags};
    use rustix::termios::{ControlModes, InputModes, tcgetattr};
    let folder = TestFolder::new();
    let served = SimServer::on_tcp(&[]);
    let file = folder.path("came.ngc");
    for (flow, by_characters, by_wires) in [
        ("xon", true, false),
        ("rts", false, true),
        ("none", false, false),
    ] {
        let mut line = PtyServer::open().unwrap();
        let name = line.name().to_string();
        let out = folder.path(flow);
        let arguments = [
            "dnc",
            &file,
            "--stream",
            "--line",
            &name,
            "--flow",
            flow,
            "--out",
            &out,
            "--port",
            &served.port,
        ];
        let mut dnc = start(&arguments);
        dnc.wait_for_output("receiving");
        let flags = OFlags::RDWR | OFlags::NOCTTY;
        let other = rustix::fs::open(name.as_str(), flags, Mode::empty()).unwrap();
        let settings = tcgetattr(&other).unwrap();
        drop(other);
        let both = InputModes::IXON | InputModes::IXOFF;
        assert_eq!(settings.input_modes.contains(both), by_characters, "{flow}");
        assert_eq!(
            settings.input_modes.intersects(both),
            by_characters,
            "{flow}"
        );
        assert_eq!(
            settings.control_modes.contains(ControlModes::CRTSCTS),
            by_wires,
            "{flow}"
        );
        if flow == "xon" {
            // 2 MB of moves of 0.5 s each.
            send(&mut line, b"%\r\nG21 G90 G61 F120\r\n");
            let mut text = String::new();
            for block in 0..80_000 {
                text += &format!("N{block} G1 X{}.5 (a long line)\r\n", block % 2);
            }
            let mut rest = text.as_bytes();
            let mut last = Instant::now();
            while !rest.is_empty() && last.elapsed() < Duration::from_secs(2) {
                let count = line.write(rest, Duration::from_millis(50)).unwrap();
                if count > 0 {
                    (rest, last) = (&rest[count..], Instant::now());
                }
            }
            let taken = text.len() - rest.len();
            assert!(
                taken < text.len() / 8,
                "{taken} of {} bytes were taken",
                text.len()
            );
            dnc.wait_for_output("running");
        }
        dnc.interrupt();
        drop(line);
        let _ = dnc.end();
    }
}
