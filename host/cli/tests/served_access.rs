//! Access to a served port: tokens, and connections that block the only session.
#![cfg(unix)]

use crate::scene;
use haptimill_protocol::link::{HostLink, Timing};
use scene::{SimServer, TestFolder, haptimill, start};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

const TOKEN: &str = "a-token-with-thirty-two-letters!";

fn address(served: &SimServer) -> String {
    served.port.strip_prefix("tcp:").unwrap().to_string()
}

/// The encoded Hello of a host.
fn hello() -> Vec<u8> {
    let mut link = HostLink::new(Timing::default());
    link.open(7, 0);
    let mut bytes = [0; 256];
    let count = link.transmit(0, &mut bytes);
    bytes[..count].to_vec()
}

/// Reads everything until the port closes the connection.
fn read_to_close(stream: &mut TcpStream) -> String {
    stream
        .set_read_timeout(Some(Duration::from_secs(10)))
        .unwrap();
    let mut said = Vec::new();
    // A connection reset ends it, too.
    let _ = stream.read_to_end(&mut said);
    String::from_utf8_lossy(&said).into_owned()
}

#[test]
fn public_address_requires_a_token() {
    let mut served = SimServer::on("tcp:0.0.0.0:0", &[]);
    let token = served.process.line();
    let token = token.strip_prefix("token ").expect("a token is printed");
    assert!(token.len() >= 32, "{token}");
    // The address from this computer.
    served.port = served.port.replace("0.0.0.0", "127.0.0.1");
    for more in [&[][..], &["--token", TOKEN]] {
        for command in [&["status"][..], &["home"], &["stop"]] {
            let ran = served.run(&[command, more].concat());
            if command != ["stop"] {
                assert_eq!(ran.code, 5, "{ran:?}");
                assert!(ran.err.contains("requires a token"), "{ran:?}");
            }
        }
    }
    let status = served
        .run_ok(&["status", "--json", "--token", token])
        .json();
    assert_eq!(status["state"], "Disabled");
    served.run_ok(&["home", "--token", token]);
    // A stop without the token does not stop a jog either.
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
    jog.wait_for_output("jogging");
    let begun = Instant::now();
    served.run(&["stop"]);
    let mut stranger = TcpStream::connect(address(&served)).unwrap();
    stranger.write_all(&[0, 0x18, 0, 0x18, 0]).unwrap();
    jog.end().expect_code(0);
    assert!(
        begun.elapsed() > Duration::from_secs(3),
        "{:?}",
        begun.elapsed()
    );
}

#[test]
fn token_is_read_from_file_and_environment() {
    let folder = TestFolder::new();
    let file = folder.file("token", format!("{TOKEN}\n"));
    let served = SimServer::on_tcp(&["--token-file", &file]);
    assert!(
        served
            .run(&["status"])
            .expect_code(5)
            .err
            .contains("requires a token")
    );
    let ran = std::process::Command::new(env!("CARGO_BIN_EXE_haptimill"))
        .args(["status", "--port", &served.port])
        .env("HAPTIMILL_TOKEN", TOKEN)
        .output()
        .unwrap();
    assert!(ran.status.success(), "{ran:?}");
    let short = folder.file("short", "secret\n");
    let serve = ["sim", "serve", "--listen", "tcp:127.0.0.1:0", "--for", "1"];
    let ran = haptimill(&[&serve[..], &["--token-file", &short]].concat()).expect_code(3);
    assert!(ran.err.contains("16 to 128"), "{}", ran.err);
    // A port without a token accepts one.
    let open = SimServer::on_tcp(&[]);
    open.run_ok(&["status", "--token", TOKEN]);
}

#[test]
fn silent_connection_is_closed() {
    let served = SimServer::on_tcp(&[]);
    let mut alone = TcpStream::connect(address(&served)).unwrap();
    let said = read_to_close(&mut alone);
    assert!(
        said.contains("no session was opened within 2 s"),
        "{said:?}"
    );
}

#[test]
fn silent_connections_do_not_block_a_host() {
    let served = SimServer::on_tcp(&[]);
    let mut silent: Vec<TcpStream> = (0..12)
        .map(|_| TcpStream::connect(address(&served)).unwrap())
        .collect();
    // The session stays open, so the silent connections meet it and not their own time limit.
    let mut host = TcpStream::connect(address(&served)).unwrap();
    host.write_all(&hello()).unwrap();
    for stream in &mut silent {
        let said = read_to_close(stream);
        assert!(said.contains("haptimill: busy"), "{said:?}");
    }
    drop(host);
    served.run_ok(&["status"]);
}

#[test]
fn silent_host_is_replaced() {
    let served = SimServer::on_tcp(&[]);
    let mut host = TcpStream::connect(address(&served)).unwrap();
    host.write_all(&hello()).unwrap();
    std::thread::sleep(Duration::from_millis(300));
    // It has the session, and another host gets an error message.
    let ran = served.run(&["status"]).expect_code(5);
    assert!(ran.err.contains("another host is connected"), "{ran:?}");
    std::thread::sleep(Duration::from_millis(2300));
    served.run_ok(&["status"]);
    let said = read_to_close(&mut host);
    assert!(said.contains("haptimill: closed"), "{said:?}");
}

/// Runs `during` while other connections flood a port, as fast as the system opens them.
fn flooded<T>(to: &str, during: impl FnOnce() -> T) -> T {
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                let mut kept = Vec::new();
                while !over.load(Ordering::Relaxed) {
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
        let result = during();
        over.store(true, Ordering::Relaxed);
        result
    })
}

/// A job runs while other connections flood the port, and a stop ends it.
#[test]
fn connection_flood_does_not_disturb_a_job() {
    let folder = TestFolder::new();
    let served = SimServer::on_tcp(&[]);
    let program = folder.file("short.ngc", "G21 G90 F600\nG1 X-5\nG1 X5\nG1 X0\nM30\n");
    let out = folder.path("out");
    let job = ["run", &program, "--port", &served.port, "--out", &out];
    let mut run = start(&job);
    run.wait_for_output("running");
    flooded(&address(&served), || run.end()).expect_code(0);
    assert_eq!(folder.summary("out")["completed"], true);
    let mut run = start(&job);
    run.wait_for_output("running");
    flooded(&address(&served), || {
        served.run_ok(&["stop"]);
        run.end()
    })
    .expect_code(7);
    served.run_ok(&["status"]);
}

/// A new host gets the session while other connections flood the port.
#[test]
fn connection_flood_does_not_lock_a_host_out() {
    let served = SimServer::on_tcp(&[]);
    flooded(&address(&served), || {
        for _ in 0..5 {
            served.run_ok(&["status"]);
        }
    });
}
