//! Raw TCP clients against the server: who is admitted, bounds, who commands.

use haptimill_web::{Config, OperatorCommand, Server};
use serde_json::{Value, json};
use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tempfile::TempDir;
use tungstenite::protocol::Role;
use tungstenite::{Message, WebSocket};

/// Longest wait. It is no speed limit.
const LIMIT: Duration = Duration::from_secs(120);

/// A server, and an owner that publishes a state every 20 ms and keeps the commands.
struct Served {
    address: SocketAddr,
    link: String,
    folder: TempDir,
    commands: Arc<Mutex<Vec<OperatorCommand>>>,
    ends: Arc<AtomicBool>,
    owner: Option<JoinHandle<()>>,
}

impl Served {
    fn new(listen: &str, token: Option<&str>) -> Self {
        let folder = TempDir::new().unwrap();
        let server = Server::bind(Config {
            listen: listen.parse().unwrap(),
            token: token.map(str::to_string),
            programs: folder.path().to_path_buf(),
        });
        let server = server.unwrap();
        let commands = Arc::new(Mutex::new(Vec::new()));
        let ends = Arc::new(AtomicBool::new(false));
        let (address, link) = (server.address(), server.link());
        let owner = {
            let (commands, ends) = (Arc::clone(&commands), Arc::clone(&ends));
            std::thread::spawn(move || {
                while !ends.load(Ordering::SeqCst) {
                    commands
                        .lock()
                        .unwrap()
                        .extend(std::iter::from_fn(|| server.next_command()));
                    server.publish(json!({"state": "idle"}));
                    std::thread::sleep(Duration::from_millis(20));
                }
            })
        };
        Self {
            address,
            link,
            folder,
            commands,
            ends,
            owner: Some(owner),
        }
    }

    fn local() -> Self {
        Self::new("127.0.0.1:0", None)
    }

    fn wait_for(&self, what: &str, is_it: impl Fn(&OperatorCommand) -> bool) {
        let until = Instant::now() + LIMIT;
        while !self.commands.lock().unwrap().iter().any(&is_it) {
            assert!(Instant::now() < until, "{what}: {:?}", self.commands.lock());
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    fn wait_for_warning(&self, part: &str) {
        self.wait_for(
            part,
            |command| matches!(command, OperatorCommand::Warn(text) if text.contains(part)),
        );
    }

    /// The commands that would move a machine.
    fn moves(&self) -> Vec<OperatorCommand> {
        let commands = self.commands.lock().unwrap();
        let moves = commands
            .iter()
            .filter(|command| !matches!(command, OperatorCommand::Warn(_)));
        moves.cloned().collect()
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::SeqCst);
        let owner = self.owner.take().map(JoinHandle::join);
        assert!(std::thread::panicking() || owner.is_none_or(|end| end.is_ok()));
    }
}

/// Sends a request; returns the connection and the head of the answer.
fn ask(address: SocketAddr, request: &str) -> (TcpStream, String) {
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

fn get(address: SocketAddr, target: &str, headers: &str) -> String {
    ask(address, &format!("GET {target} HTTP/1.1\r\n{headers}\r\n")).1
}

fn upgrade(at: SocketAddr, query: &str, host: &str, origin: &str) -> (TcpStream, String) {
    let request = format!(
        "GET /ws{query} HTTP/1.1\r\nHost: {host}\r\n{origin}Upgrade: websocket\r\n\
         Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    );
    ask(at, &request)
}

/// A viewer, as the page is one.
struct Viewer {
    socket: WebSocket<TcpStream>,
    state: Value,
    control: Value,
    programs: Value,
    refused: Vec<String>,
}

impl Viewer {
    fn open(at: SocketAddr) -> Self {
        let (stream, head) = upgrade(at, "", &at.to_string(), &format!("Origin: http://{at}\r\n"));
        assert!(head.starts_with("HTTP/1.1 101"), "{head}");
        // The key and answer of RFC 6455, section 1.3.
        assert!(head.contains("s3pPLMBiTxaQ9kYGzzhZRbK+xOo="), "{head}");
        let mut viewer = Self {
            socket: WebSocket::from_raw_socket(stream, Role::Client, None),
            state: Value::Null,
            control: Value::Null,
            programs: Value::Null,
            refused: Vec::new(),
        };
        viewer.wait("state", |viewer| viewer.state["state"] == "idle");
        viewer
    }

    fn next(&mut self) {
        let Message::Text(text) = self.socket.read().unwrap() else {
            return;
        };
        let message: Value = serde_json::from_str(&text).unwrap();
        match message["kind"].as_str().unwrap() {
            "state" => self.state = message,
            "control" => self.control = message,
            "programs" => self.programs = message,
            "refused" => {
                let text = message["text"].as_str().unwrap();
                self.refused.push(text.to_string());
            }
            kind => panic!("{kind}"),
        }
    }

    fn send(&mut self, mut command: Value) {
        command["t"] = self.state["t"].clone();
        self.socket
            .send(Message::text(command.to_string()))
            .unwrap();
    }

    fn command(&mut self, command: &str) {
        self.next();
        self.send(json!({ "command": command }));
    }

    fn wait(&mut self, what: &str, holds: impl Fn(&Self) -> bool) {
        let until = Instant::now() + LIMIT;
        while !holds(self) {
            assert!(
                Instant::now() < until,
                "{what}: {} {:?}",
                self.control,
                self.refused
            );
            self.next();
        }
    }

    fn wait_for_refusal(&mut self, text: &str) {
        self.wait(text, |viewer| {
            viewer
                .refused
                .last()
                .is_some_and(|last| last.contains(text))
        });
        self.refused.clear();
    }

    fn take(&mut self) {
        self.command("take");
        self.wait("control", Self::commands);
    }

    fn commands(&self) -> bool {
        self.control["you"] == self.control["commander"] && !self.control.is_null()
    }
}

#[test]
fn only_the_served_page_is_admitted() {
    let served = Served::local();
    let at = served.address;
    let port = at.port();
    let page = get(at, "/", &format!("Host: localhost:{port}\r\n"));
    assert!(page.starts_with("HTTP/1.1 200"), "{page}");
    assert!(page.contains("frame-ancestors 'none'"), "{page}");
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
        format!("Origin: http://{at}.evil.test\r\n"),
        format!("Origin: https://{at}\r\n"),
        format!("Origin: http://localhost:{port}\r\n"),
        format!("Origin: http://{at}\r\nOrigin: http://{at}\r\n"),
    ] {
        let head = upgrade(at, "", &at.to_string(), &origin).1;
        assert!(head.starts_with("HTTP/1.1 403"), "{origin} {head}");
    }
    let host = format!("Host: {at}\r\n");
    let post = format!("POST / HTTP/1.1\r\n{host}Content-Length: 0\r\n\r\n");
    assert!(ask(at, &post).1.starts_with("HTTP/1.1 405"));
    assert!(get(at, "/../Cargo.toml", &host).starts_with("HTTP/1.1 404"));
    let long = format!("{host}X: {}\r\n", "a".repeat(20_000));
    assert!(!get(at, "/", &long).starts_with("HTTP/1.1 200"));
    served.wait_for_warning("evil.test");
    served.wait_for_warning("no such page \"/../Cargo.toml\"");
    served.wait_for_warning("only GET");
    // The same refusal is the same text, whatever the port of the peer: the owner counts it.
    let commands = served.commands.lock().unwrap().clone();
    let same = |command: &&OperatorCommand| {
        **command == OperatorCommand::Warn(format!("{}: refused, only GET is served", at.ip()))
    };
    assert_eq!(commands.iter().filter(same).count(), 1, "{commands:?}");
    assert_eq!(served.moves(), []);
}

/// The page of a server on all addresses has an address that a browser can open.
#[test]
fn the_printed_address_is_one_of_the_computer() {
    for (listen, loopback) in [("0.0.0.0:0", "127.0.0.1"), ("127.0.0.1:0", "127.0.0.1")] {
        let served = Served::new(listen, Some("abcdefghijklmnop"));
        let rest = served.link.strip_prefix("http://").unwrap();
        let address = rest.strip_suffix("/#token=abcdefghijklmnop").unwrap();
        let address: SocketAddr = address.parse().unwrap();
        assert!(!address.ip().is_unspecified(), "{listen}: {address}");
        assert_eq!(address.port(), served.address.port());
        if listen.starts_with("127") {
            assert_eq!(address.ip().to_string(), loopback);
        }
        let page = get(address, "/", &format!("Host: {address}\r\n"));
        assert!(page.starts_with("HTTP/1.1 200"), "{page}");
    }
}

#[test]
fn a_viewer_needs_the_token() {
    let served = Served::new("0.0.0.0:0", Some("abcdefghijklmnop"));
    assert!(served.link.ends_with("/#token=abcdefghijklmnop"));
    let at = SocketAddr::from(([127, 0, 0, 1], served.address.port()));
    let (host, origin) = (at.to_string(), format!("Origin: http://{at}\r\n"));
    for query in [
        "",
        "?token=",
        "?token=abcdefghijklmnoq",
        "?token=abcdefghijklmnopq",
    ] {
        let head = upgrade(at, query, &host, &origin).1;
        assert!(head.starts_with("HTTP/1.1 403"), "{query} {head}");
    }
    served.wait_for_warning("token is wrong");
    let head = upgrade(at, "?token=abcdefghijklmnop", &host, &origin).1;
    assert!(head.starts_with("HTTP/1.1 101"), "{head}");
}

#[test]
fn connections_beyond_the_limit_are_refused_and_the_viewer_stays() {
    let served = Served::local();
    let mut viewer = Viewer::open(served.address);
    // Sockets that never send a whole request.
    let mut open = Vec::new();
    for _ in 0..100 {
        let mut stream = TcpStream::connect(served.address).unwrap();
        let _ = stream.write_all(b"GET / HT");
        open.push(stream);
    }
    served.wait_for_warning("32 connections are open");
    viewer.take();
    // Those that were admitted are closed, after which the page is served again.
    let until = Instant::now() + LIMIT;
    let host = format!("Host: {}\r\n", served.address);
    while !get(served.address, "/", &host).starts_with("HTTP/1.1 200") {
        assert!(Instant::now() < until);
        viewer.next();
    }
    served.wait_for_warning("no whole request within 5 s");
    drop(open);
}

#[test]
fn a_message_that_is_too_long_or_unknown_closes_its_viewer_only() {
    let served = Served::local();
    let mut first = Viewer::open(served.address);
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
    let mut long = Viewer::open(served.address);
    // The head of a masked text frame of 2^40 bytes.
    let head = [0x81, 0xff, 0, 0, 1, 0, 0, 0, 0, 0, 1, 2, 3, 4];
    long.socket.get_mut().write_all(&head).unwrap();
    ends(&mut long);
    let mut odd = Viewer::open(served.address);
    odd.socket
        .send(Message::text("{\"command\":\"fly\"}"))
        .unwrap();
    ends(&mut odd);
    served.wait_for_warning("an unknown message");
    let mut flood = Viewer::open(served.address);
    for _ in 0..1000 {
        let _ = flood.socket.send(Message::text("{\"command\":\"list\"}"));
    }
    ends(&mut flood);
    served.wait_for_warning("messages per second");
    first.take();
    assert_eq!(served.moves(), []);
}

/// A viewer whose computer is gone leaves a half-open connection: it loses its control, and a jog
/// that it began has long ended.
#[test]
fn a_viewer_that_is_silent_for_20_s_is_closed() {
    let served = Served::local();
    let mut gone = Viewer::open(served.address);
    gone.take();
    let silent = Instant::now();
    let mut other = Viewer::open(served.address);
    // It answers no ping: its socket is not read.
    let until = silent + Duration::from_secs(18);
    while Instant::now() < until {
        other.next();
    }
    assert!(!other.control["commander"].is_null(), "{}", other.control);
    other.wait("the end of its control", |other| {
        other.control["commander"].is_null()
    });
    served.wait_for_warning("nothing came for 20 s");
    drop(gone);
    other.take();
}

#[test]
fn one_viewer_commands_and_every_viewer_stops() {
    let served = Served::local();
    let mut first = Viewer::open(served.address);
    first.take();
    let mut second = Viewer::open(served.address);
    second.command("enable");
    second.wait_for_refusal("take control first");
    assert_eq!(served.moves(), []);
    second.command("stop");
    served.wait_for("stop", |command| *command == OperatorCommand::Stop);
    second.command("take");
    first.wait("question", |viewer| !viewer.control["asks"].is_null());
    first.command("hand-over");
    second.wait("control", Viewer::commands);
    // A jog of the first viewer ends with its control.
    served.wait_for("end", |command| *command == OperatorCommand::ControlEnded);
    first.command("reset");
    first.wait_for_refusal("take control first");
    let jog = json!({"command": "jog", "coordinate": 1, "up": false, "repeat": false});
    second.next();
    second.send(jog.clone());
    let moved = OperatorCommand::Jog {
        coordinate: 1,
        up: false,
        repeat: false,
    };
    served.wait_for("jog", |command| *command == moved);
    // A command that answers an old state moves nothing, and neither does one of the future.
    served.commands.lock().unwrap().clear();
    std::thread::sleep(haptimill_web::FRESH_JOG);
    for t in [0, u64::MAX] {
        let mut late = jog.clone();
        late["t"] = json!(t);
        second.socket.send(Message::text(late.to_string())).unwrap();
        second.wait_for_refusal("the connection is slow");
    }
    drop(second);
    first.wait("nobody", |viewer| viewer.control["commander"].is_null());
    served.wait_for("end", |command| *command == OperatorCommand::ControlEnded);
    assert_eq!(served.moves(), [OperatorCommand::ControlEnded]);
}

#[test]
fn programs_stay_in_their_folder() {
    let served = Served::local();
    let mut viewer = Viewer::open(served.address);
    viewer.take();
    let upload = |name: &str, text: &str| json!({"command": "upload", "name": name, "text": text});
    for name in [
        "../out.ngc",
        "a/b.ngc",
        "/tmp/out.ngc",
        ".hidden.ngc",
        "x.sh",
    ] {
        viewer.next();
        viewer.send(upload(name, "M30\n"));
        viewer.wait_for_refusal("program");
    }
    served.wait_for_warning("../out.ngc");
    viewer.next();
    let long = "G1 X1\n".repeat(haptimill_web::programs::LONGEST / 6 + 1);
    viewer.send(upload("long.ngc", &long));
    viewer.wait_for_refusal("split it");
    served.wait_for_warning("split it");
    assert_eq!(served.folder.path().read_dir().unwrap().count(), 0);
    viewer.next();
    viewer.send(upload("part.ngc", "G1 X8\n"));
    viewer.wait("list", |viewer| {
        viewer.programs["names"] == json!(["part.ngc"])
    });
    viewer.next();
    viewer.send(upload("part.ngc", "M30\n"));
    viewer.wait_for_refusal("part.ngc exists");
    let path = served.folder.path().join("part.ngc");
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "G1 X8\n");
    viewer.next();
    viewer.send(json!({"command": "select", "name": "part.ngc"}));
    served.wait_for("select", |command| {
        *command == OperatorCommand::Select(path.clone())
    });
    viewer.next();
    viewer.send(json!({"command": "select", "name": "../part.ngc"}));
    viewer.wait_for_refusal("no file name");
}
