//! Who may use a served port, and that nobody else keeps its only place.
#![cfg(unix)]

mod scene;

use haptimill_protocol::link::{HostLink, Timing};
use scene::{Folder, Served, haptimill, start};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

const WORD: &str = "a-word-of-thirty-two-characters!";

fn address(served: &Served) -> String {
    served.port.strip_prefix("tcp:").unwrap().to_string()
}

/// The Hello of a host, on the line.
fn hello() -> Vec<u8> {
    let mut link = HostLink::new(Timing::default());
    link.open(7, 0);
    let mut bytes = [0; 256];
    let count = link.transmit(0, &mut bytes);
    bytes[..count].to_vec()
}

/// All that a port says until it closes the connection.
fn last_words(stream: &mut TcpStream) -> String {
    stream
        .set_read_timeout(Some(Duration::from_secs(10)))
        .unwrap();
    let mut said = Vec::new();
    // A reset ends it as well.
    let _ = stream.read_to_end(&mut said);
    String::from_utf8_lossy(&said).into_owned()
}

#[test]
fn an_address_that_others_reach_asks_for_a_token() {
    let mut served = Served::on("tcp:0.0.0.0:0", &[]);
    let token = served.process.line();
    let token = token.strip_prefix("token ").expect("a token is printed");
    assert!(token.len() >= 32, "{token}");
    // As it is reached from this computer.
    served.port = served.port.replace("0.0.0.0", "127.0.0.1");
    for more in [&[][..], &["--token", WORD]] {
        for command in [&["status"][..], &["home"], &["stop"]] {
            let ran = served.tries(&[command, more].concat());
            if command != ["stop"] {
                assert_eq!(ran.code, 5, "{ran:?}");
                assert!(ran.err.contains("requires a token"), "{ran:?}");
            }
        }
    }
    let status = served.does(&["status", "--json", "--token", token]).json();
    assert_eq!(status["state"], "Disabled");
    served.does(&["home", "--token", token]);
    // Whoever has no token does not stop a jog either; whoever has it does.
    let jog = [
        "jog",
        "x=1",
        "--for",
        "4",
        "--token",
        token,
        "--port",
        &served.port,
    ];
    let mut jog = start(&jog);
    jog.says("jogging");
    let begun = Instant::now();
    served.tries(&["stop"]);
    let mut stranger = TcpStream::connect(address(&served)).unwrap();
    stranger.write_all(&[0, 0x18, 0, 0x18, 0]).unwrap();
    jog.end().ended_with(0);
    assert!(
        begun.elapsed() > Duration::from_secs(3),
        "{:?}",
        begun.elapsed()
    );
}

#[test]
fn a_token_comes_from_a_file_and_from_the_environment() {
    let folder = Folder::new();
    let file = folder.file("token", format!("{WORD}\n"));
    let served = Served::on_tcp(&["--token-file", &file]);
    assert!(
        served
            .tries(&["status"])
            .ended_with(5)
            .err
            .contains("requires a token")
    );
    let ran = std::process::Command::new(env!("CARGO_BIN_EXE_haptimill"))
        .args(["status", "--port", &served.port])
        .env("HAPTIMILL_TOKEN", WORD)
        .output()
        .unwrap();
    assert!(ran.status.success(), "{ran:?}");
    let short = folder.file("short", "secret\n");
    let serve = ["sim", "serve", "--listen", "tcp:127.0.0.1:0", "--for", "1"];
    let ran = haptimill(&[&serve[..], &["--token-file", &short]].concat()).ended_with(3);
    assert!(ran.err.contains("16 to 128"), "{}", ran.err);
    // A port that asks for none is used all the same.
    let open = Served::on_tcp(&[]);
    open.does(&["status", "--token", WORD]);
}

#[test]
fn a_connection_that_says_nothing_does_not_hold_the_place() {
    let served = Served::on_tcp(&[]);
    let mut alone = TcpStream::connect(address(&served)).unwrap();
    let begun = Instant::now();
    let said = last_words(&mut alone);
    assert!(
        said.contains("no session was opened within 2 s"),
        "{said:?}"
    );
    assert!(
        begun.elapsed() < Duration::from_secs(5),
        "{:?}",
        begun.elapsed()
    );
    let mut silent: Vec<TcpStream> = (0..12)
        .map(|_| TcpStream::connect(address(&served)).unwrap())
        .collect();
    std::thread::sleep(Duration::from_millis(100));
    let begun = Instant::now();
    served.does(&["status"]);
    assert!(
        begun.elapsed() < Duration::from_millis(1500),
        "{:?}",
        begun.elapsed()
    );
    // They were told that there is a host.
    let said = last_words(&mut silent[0]);
    assert!(said.contains("haptimill: busy"), "{said:?}");
}

#[test]
fn a_host_that_fell_silent_makes_room() {
    let served = Served::on_tcp(&[]);
    let mut host = TcpStream::connect(address(&served)).unwrap();
    host.write_all(&hello()).unwrap();
    std::thread::sleep(Duration::from_millis(300));
    // It has the place, and a newcomer is told so in words.
    let ran = served.tries(&["status"]).ended_with(5);
    assert!(ran.err.contains("another host is connected"), "{ran:?}");
    std::thread::sleep(Duration::from_millis(2300));
    served.does(&["status"]);
    let said = last_words(&mut host);
    assert!(said.contains("haptimill: closed"), "{said:?}");
}

/// A job is served while many others knock and shout.
#[test]
fn a_flood_does_not_starve_the_host() {
    let folder = Folder::new();
    let served = Served::on_tcp(&[]);
    let program = folder.file("short.ngc", "G21 G90 F600\nG1 X-5\nG1 X5\nG1 X0\nM30\n");
    let out = folder.path("out");
    let mut run = start(&["run", &program, "--port", &served.port, "--out", &out]);
    run.says("running");
    let over = std::sync::atomic::AtomicBool::new(false);
    let over = &over;
    let to = address(&served);
    std::thread::scope(|scope| {
        for _ in 0..2 {
            let to = &to;
            scope.spawn(move || {
                let mut kept = Vec::new();
                while !over.load(std::sync::atomic::Ordering::Relaxed) {
                    if let Ok(mut stream) = TcpStream::connect(to) {
                        let _ = stream.set_nonblocking(true);
                        let _ = stream.write(&[7; 60_000]);
                        kept.push(stream);
                    }
                    if kept.len() > 200 {
                        kept.clear();
                    }
                    std::thread::sleep(Duration::from_micros(300));
                }
            });
        }
        let ran = run.end();
        over.store(true, std::sync::atomic::Ordering::Relaxed);
        ran.ended_with(0);
    });
    assert_eq!(folder.summary("out")["completed"], true);
    served.does(&["status"]);
}
