//! The few routes over HTTP/1.1: the page, its script and style, and the upgrade to a WebSocket.

use crate::access::{Head, check_host, check_origin, check_token};
use crate::{Shared, socket};
use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tungstenite::handshake::derive_accept_key;

/// Length of a head at most, bytes.
const LONGEST_HEAD: usize = 8192;

/// Time in which the head must arrive.
const HEAD: Duration = Duration::from_secs(5);

/// Time in which a peer must take what is written.
const WRITE: Duration = Duration::from_secs(2);

const PAGE: &str = include_str!("page.html");
const MACHINE: &str = include_str!("machine.js");
const SCRIPT: &str = include_str!("page.js");
const STYLE: &str = include_str!("page.css");

/// Only what is served here; no frame of another page around it.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; \
                      connect-src 'self'; img-src 'self' data:; base-uri 'none'; \
                      form-action 'none'; frame-ancestors 'none'";

pub(super) fn serve(shared: &Arc<Shared>, mut stream: TcpStream, peer: SocketAddr) {
    let prepared = stream
        .set_nonblocking(false)
        .and_then(|()| stream.set_nodelay(true))
        .and_then(|()| stream.set_write_timeout(Some(WRITE)));
    let Ok(local) = prepared.and_then(|()| stream.local_addr()) else {
        return;
    };
    let (text, rest) = match read_head(&mut stream) {
        Ok(Some(read)) => read,
        // The peer left.
        Ok(None) => return,
        Err(what) => {
            shared.refuse(peer, what);
            return answer(&mut stream, "400 Bad Request", "text/plain", what);
        }
    };
    let head = match Head::parse(&text) {
        Ok(head) => head,
        Err(what) => {
            shared.refuse(peer, what);
            return answer(&mut stream, "400 Bad Request", "text/plain", what);
        }
    };
    let host = match check_host(&head, local) {
        Ok(host) => host,
        Err(what) => {
            shared.refuse(peer, &what);
            return answer(&mut stream, "421 Misdirected Request", "text/plain", &what);
        }
    };
    if head.method != "GET" {
        let what = "only GET is served";
        shared.refuse(peer, what);
        return answer(&mut stream, "405 Method Not Allowed", "text/plain", what);
    }
    let (kind, body) = match head.path() {
        "/" => ("text/html; charset=utf-8", PAGE.to_string()),
        "/page.js" => (
            "text/javascript; charset=utf-8",
            [haptimill_viewer::SCRIPT, MACHINE, SCRIPT].concat(),
        ),
        "/page.css" => (
            "text/css; charset=utf-8",
            [haptimill_viewer::STYLE, STYLE].concat(),
        ),
        "/ws" => {
            let admitted = check_origin(&head, host)
                .and_then(|()| check_token(&head, shared.token.as_deref()))
                .and_then(|()| accept_key(&head));
            return match admitted {
                Ok(key) => upgrade(shared, stream, peer, &key, rest),
                Err(what) => {
                    shared.refuse(peer, &what);
                    answer(&mut stream, "403 Forbidden", "text/plain", &what);
                }
            };
        }
        _ => {
            let what = "there is / only";
            // A browser asks for the icon of a page by itself.
            if head.path() != "/favicon.ico" {
                shared.refuse(peer, &format!("no such page {}", shown(head.path())));
            }
            return answer(&mut stream, "404 Not Found", "text/plain", what);
        }
    };
    answer(&mut stream, "200 OK", kind, &body);
}

/// The begin of a text of a stranger, without control characters.
fn shown(text: &str) -> String {
    let begin: String = text.chars().take(60).collect();
    format!("{begin:?}")
}

/// The head up to its empty line, and what came after it.
fn read_head(stream: &mut TcpStream) -> Result<Option<(String, Vec<u8>)>, &'static str> {
    let until = Instant::now() + HEAD;
    let mut received = Vec::new();
    let mut buffer = [0; 2048];
    loop {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() || stream.set_read_timeout(Some(left)).is_err() {
            return Err("no whole request within 5 s");
        }
        match stream.read(&mut buffer) {
            Ok(0) | Err(_) if received.is_empty() => return Ok(None),
            Ok(0) | Err(_) => return Err("no whole request within 5 s"),
            Ok(count) => received.extend_from_slice(&buffer[..count]),
        }
        if let Some(end) = received.windows(4).position(|four| four == b"\r\n\r\n") {
            let rest = received.split_off(end + 4);
            let text = String::from_utf8(received).map_err(|_| "the head is not UTF-8")?;
            return Ok(Some((text, rest)));
        }
        if received.len() > LONGEST_HEAD {
            return Err("the head is longer than 8192 bytes");
        }
    }
}

fn accept_key(head: &Head) -> Result<String, String> {
    let is_websocket = head
        .only("upgrade")
        .is_some_and(|value| value.eq_ignore_ascii_case("websocket"));
    match head.only("sec-websocket-key") {
        Some(key) if is_websocket && head.only("sec-websocket-version") == Some("13") => {
            Ok(derive_accept_key(key.as_bytes()))
        }
        _ => Err("this is no upgrade to a WebSocket of version 13".to_string()),
    }
}

fn upgrade(
    shared: &Arc<Shared>,
    mut stream: TcpStream,
    peer: SocketAddr,
    key: &str,
    rest: Vec<u8>,
) {
    let head = format!(
        "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
         Sec-WebSocket-Accept: {key}\r\n\r\n"
    );
    if stream.write_all(head.as_bytes()).is_ok() {
        socket::serve(shared, stream, peer, rest);
    }
}

fn answer(stream: &mut TcpStream, status: &str, kind: &str, body: &str) {
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n\
         Cache-Control: no-store\r\nContent-Security-Policy: {POLICY}\r\nX-Frame-Options: DENY\r\n\
         X-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n\r\n",
        body.len()
    );
    let _ = stream.write_all(head.as_bytes());
    let _ = stream.write_all(body.as_bytes());
}
