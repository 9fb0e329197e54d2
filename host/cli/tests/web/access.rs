//! Who is admitted: addresses, tokens, numbers of connections, and messages.

use super::viewer::{Viewer, has_message};
use super::{LIMIT, ask, get, serve, upgrade};
use crate::scene::{TestFolder, haptimill, start};
use std::io::Write as _;
use std::net::TcpStream;
use std::time::Instant;
use tungstenite::Message;

#[test]
fn only_the_served_page_is_admitted() {
    let served = serve(&[]);
    let at = &served.address;
    let port = at.rsplit(':').next().unwrap();
    let page = get(at, "/", &format!("Host: localhost:{port}\r\n"));
    assert!(page.starts_with("HTTP/1.1 200"), "{page}");
    assert!(page.contains("frame-ancestors 'none'"), "{page}");
    let ours = format!("http://{at}");
    // DNS rebinding: the name of a stranger that resolves to this address, with its own page.
    let evil = format!("evil.test:{port}");
    let same = format!("Origin: http://{evil}\r\n");
    assert!(upgrade(at, "", &evil, &same).1.starts_with("HTTP/1.1 421"));
    assert!(get(at, "/", &format!("Host: {evil}\r\n")).starts_with("HTTP/1.1 421"));
    assert!(get(at, "/", "").starts_with("HTTP/1.1 421"));
    // A page of a stranger that calls the right address.
    for origin in [
        String::new(),
        "Origin: null\r\n".to_string(),
        "Origin: http://evil.test\r\n".to_string(),
        format!("Origin: {ours}.evil.test\r\n"),
        format!("Origin: https://{at}\r\n"),
        format!("Origin: http://localhost:{port}\r\n"),
        format!("Origin: {ours}\r\nOrigin: {ours}\r\n"),
    ] {
        let head = upgrade(at, "", at, &origin).1;
        assert!(head.starts_with("HTTP/1.1 403"), "{origin} {head}");
    }
    let post = format!("POST / HTTP/1.1\r\nHost: {at}\r\nContent-Length: 0\r\n\r\n");
    assert!(ask(at, &post).1.starts_with("HTTP/1.1 405"));
    let up = get(at, "/../Cargo.toml", &format!("Host: {at}\r\n"));
    assert!(up.starts_with("HTTP/1.1 404"), "{up}");
    let long = format!("Host: {at}\r\nX: {}\r\n", "a".repeat(20_000));
    assert!(!get(at, "/", &long).starts_with("HTTP/1.1 200"));
    // The refusals are in the messages of the machine.
    let mut viewer = Viewer::open(at);
    viewer.wait("refusal", |viewer| has_message(viewer, "evil.test"));
    assert_eq!(viewer.state["state"], "disabled");
}

#[test]
fn another_address_needs_its_token() {
    let folder = TestFolder::new();
    let programs = folder.path("");
    let mut command = start(&["serve", "--listen", "0.0.0.0:0", "--programs", &programs]);
    let link = command.line().trim().to_string();
    let (address, token) = link.split_once("/#token=").expect("a new token");
    assert!(token.len() >= 32, "{link}");
    let port = address.rsplit(':').next().unwrap();
    let at = format!("127.0.0.1:{port}");
    let origin = format!("Origin: http://{at}\r\n");
    for query in ["", "?token=", "?token=0123456789abcdef0123456789abcdef"] {
        let head = upgrade(&at, query, &at, &origin).1;
        assert!(head.starts_with("HTTP/1.1 403"), "{query} {head}");
    }
    let head = upgrade(&at, &format!("?token={token}"), &at, &origin).1;
    assert!(head.starts_with("HTTP/1.1 101"), "{head}");
    let given = serve(&["--token", "abcdefghijklmnop"]);
    assert!(given.link.ends_with("/#token=abcdefghijklmnop"));
    haptimill(&["serve", "--token", "abcdefghijklmnop&"]).expect_code(2);
    haptimill(&["serve", "--programs", &folder.path("none")]).expect_code(2);
}

#[test]
fn connections_beyond_the_limit_are_refused_and_the_viewer_stays() {
    let served = serve(&[]);
    let mut viewer = Viewer::open(&served.address);
    viewer.wait_for_state("disabled");
    // Sockets that never send a whole request.
    let mut open = Vec::new();
    for _ in 0..100 {
        let mut stream = TcpStream::connect(&served.address).unwrap();
        let _ = stream.write_all(b"GET / HT");
        open.push(stream);
    }
    viewer.wait("refusal", |viewer| {
        has_message(viewer, "32 connections are open")
    });
    // Those that were admitted end by themselves, after which the page is served again.
    let until = Instant::now() + LIMIT;
    let host = format!("Host: {}\r\n", served.address);
    while !get(&served.address, "/", &host).starts_with("HTTP/1.1 200") {
        assert!(Instant::now() < until);
        viewer.next();
    }
    viewer.take();
    drop(open);
}

#[test]
fn a_message_that_is_too_long_or_unknown_closes_its_viewer_only() {
    let served = serve(&[]);
    let mut first = Viewer::open(&served.address);
    first.wait_for_state("disabled");
    let mut long = Viewer::open(&served.address);
    // The head of a masked text frame of 2^40 bytes.
    let head = [0x81, 0xff, 0, 0, 1, 0, 0, 0, 0, 0, 1, 2, 3, 4];
    long.socket.get_mut().write_all(&head).unwrap();
    let ends = |viewer: &mut Viewer| {
        let until = Instant::now() + LIMIT;
        while viewer
            .socket
            .read()
            .is_ok_and(|message| !message.is_close())
        {
            assert!(Instant::now() < until, "still open");
        }
    };
    ends(&mut long);
    let mut odd = Viewer::open(&served.address);
    odd.socket
        .send(Message::text("{\"command\":\"fly\"}"))
        .unwrap();
    ends(&mut odd);
    let mut flood = Viewer::open(&served.address);
    for _ in 0..1000 {
        let _ = flood.socket.send(Message::text("{\"command\":\"list\"}"));
    }
    ends(&mut flood);
    first.take();
}
