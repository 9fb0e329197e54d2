//! `haptimill serve` with raw TCP clients: who is admitted, who commands, jogs, a program.

use crate::scene;
mod access;
mod control;
mod viewer;

use scene::{Running, TestFolder, start};
use serde_json::Value;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::Duration;

/// Longest wait for a state of the machine.
const LIMIT: Duration = Duration::from_secs(120);

/// The command with a folder of programs.
struct Served {
    command: Running,
    folder: TestFolder,
    /// IP:PORT.
    address: String,
    /// With `#token=`.
    link: String,
}

fn serve(more: &[&str]) -> Served {
    let folder = TestFolder::new();
    let programs = folder.path("");
    let given = ["serve", "--listen", "127.0.0.1:0", "--programs", &programs];
    let mut command = start(&[&given[..], more].concat());
    let link = command.line().trim().to_string();
    let rest = link.strip_prefix("http://").unwrap();
    let address = rest.split('/').next().unwrap().to_string();
    Served {
        command,
        folder,
        address,
        link,
    }
}

/// Sends bytes; returns the connection and all that was answered up to the empty line.
fn ask(address: &str, request: &str) -> (TcpStream, String) {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(LIMIT)).unwrap();
    // A server that refuses early closes before all is written.
    let _ = stream.write_all(request.as_bytes());
    let mut head = Vec::new();
    let mut byte = [0];
    while !head.ends_with(b"\r\n\r\n") && matches!(stream.read(&mut byte), Ok(1)) {
        head.push(byte[0]);
    }
    (stream, String::from_utf8(head).unwrap())
}

fn get(address: &str, target: &str, headers: &str) -> String {
    ask(address, &format!("GET {target} HTTP/1.1\r\n{headers}\r\n")).1
}

fn upgrade(address: &str, query: &str, host: &str, origin: &str) -> (TcpStream, String) {
    let request = format!(
        "GET /ws{query} HTTP/1.1\r\nHost: {host}\r\n{origin}Upgrade: websocket\r\n\
         Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    );
    ask(address, &request)
}

fn numbers(array: &Value) -> Vec<f64> {
    let array = array.as_array().unwrap();
    array.iter().map(|value| value.as_f64().unwrap()).collect()
}
