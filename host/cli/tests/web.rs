//! `haptimill serve` with raw TCP clients: who is admitted, who commands, jogs, a program.

mod scene;

use scene::{Running, SimServer, TestFolder, haptimill, start};
use serde_json::{Value, json};
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tungstenite::protocol::Role;
use tungstenite::{Message, WebSocket};

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

/// A viewer, as the page is one.
struct Viewer {
    socket: WebSocket<TcpStream>,
    /// The newest state.
    state: Value,
    control: Value,
    scene: Value,
    programs: Value,
    refused: Vec<String>,
    /// Heights of the stock.
    stock: Vec<f64>,
    /// Changes of the stock that came.
    parts: usize,
    /// Largest feed of the states, mm/min.
    feed: f64,
}

impl Viewer {
    fn open(address: &str) -> Self {
        let origin = format!("Origin: http://{address}\r\n");
        let (stream, head) = upgrade(address, "", address, &origin);
        assert!(head.starts_with("HTTP/1.1 101"), "{head}");
        // The key and answer of RFC 6455, section 1.3.
        assert!(head.contains("s3pPLMBiTxaQ9kYGzzhZRbK+xOo="), "{head}");
        Self {
            socket: WebSocket::from_raw_socket(stream, Role::Client, None),
            state: Value::Null,
            control: Value::Null,
            scene: Value::Null,
            programs: Value::Null,
            refused: Vec::new(),
            stock: Vec::new(),
            parts: 0,
            feed: 0.0,
        }
    }

    /// Takes the next message.
    fn next(&mut self) {
        let Message::Text(text) = self.socket.read().unwrap() else {
            return;
        };
        let message: Value = serde_json::from_str(&text).unwrap();
        match message["kind"].as_str().unwrap() {
            "state" => {
                self.feed = message["feed_mm_min"]
                    .as_f64()
                    .unwrap_or(0.0)
                    .max(self.feed);
                self.state = message;
            }
            "control" => self.control = message,
            "scene" => self.scene = message,
            "stock" => self.stock = numbers(&message["heights"]),
            "stock-part" => {
                self.parts += 1;
                for run in message["runs"].as_array().unwrap() {
                    let run = numbers(run);
                    let first = run[0] as usize;
                    self.stock[first..first + run.len() - 1].copy_from_slice(&run[1..]);
                }
            }
            "programs" => self.programs = message,
            "refused" => self
                .refused
                .push(message["text"].as_str().unwrap().to_string()),
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
        self.send(json!({ "command": command }));
    }

    /// Waits until the state of the machine meets a condition.
    fn wait(&mut self, what: &str, holds: impl Fn(&Self) -> bool) {
        let until = Instant::now() + LIMIT;
        while !holds(self) {
            let late = Instant::now() > until;
            assert!(
                !late,
                "waited for {what}: {} {:?}",
                self.state, self.refused
            );
            self.next();
        }
    }

    fn wait_for_state(&mut self, state: &str) {
        self.wait(state, |viewer| viewer.state["state"] == state);
    }

    fn take(&mut self) {
        self.wait("state", |viewer| viewer.state["ready"] == true);
        self.command("take");
        self.wait("control", Self::commands);
    }

    fn commands(&self) -> bool {
        self.control["you"] == self.control["commander"] && !self.control.is_null()
    }

    /// Enables and homes, and waits for the home pose.
    fn home(&mut self) {
        self.take();
        self.wait_for_state("disabled");
        assert_eq!(self.state["referenced"], false);
        self.command("home");
        self.answer();
        self.wait("home pose", |viewer| {
            has_message(viewer, "move to the home pose: done")
        });
        self.wait_for_state("idle");
        assert_eq!(self.state["referenced"], true);
        // Without force control the reference is the commanded position.
        let x = &self.state["pose"][0]["commanded"];
        let columns = &self.state["columns"];
        assert_eq!(&columns["x reference, mm"], x);
        // Simulated and measured positions agree to the errors of the machine at rest.
        let near = |column: &str, other: &Value| {
            let (one, other) = (columns[column].as_f64().unwrap(), other.as_f64().unwrap());
            assert!((one - other).abs() < 0.05, "{column}: {one} {other}");
        };
        near("joint l1 commanded, mm", &self.state["joints"][0]["actual"]);
        near("homed", &json!(1.0));
        assert!(columns["drive l1, code"].is_number(), "{columns}");
        // Another process has the truth of its machine.
        if self.state["port"] == "simulator" {
            near("true tool x, mm", &self.state["pose"][0]["actual"]);
            near("true tool theta, deg", &self.state["pose"][3]["actual"]);
            near("true force z, N", &json!(0.0));
        }
        // The coordinates of the built-in machine are limited to 50 mm/s each, three of them.
        assert!(self.feed < 50.0 * 60.0 * 3.0_f64.sqrt(), "{}", self.feed);
    }

    /// Answers a question with yes, once it has been there for as long as an operator reads.
    fn answer(&mut self) {
        self.wait("question", |viewer| viewer.state["question"].is_string());
        let read = Instant::now() + Duration::from_millis(500);
        while Instant::now() < read {
            self.next();
        }
        self.send(json!({"command": "answer", "yes": true}));
        self.wait("answer", |viewer| viewer.state["question"].is_null());
    }

    fn actual(&self, axis: usize) -> f64 {
        self.state["pose"][axis]["actual"].as_f64().unwrap()
    }
}

fn numbers(array: &Value) -> Vec<f64> {
    let array = array.as_array().unwrap();
    array.iter().map(|value| value.as_f64().unwrap()).collect()
}

fn has_message(viewer: &Viewer, part: &str) -> bool {
    let messages = viewer.state["messages"].as_array();
    let mut messages = messages.into_iter().flatten();
    messages.any(|message| message["text"].as_str().unwrap().contains(part))
}

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

#[test]
fn one_viewer_commands_and_every_viewer_stops() {
    let served = serve(&[]);
    let mut first = Viewer::open(&served.address);
    first.take();
    let mut second = Viewer::open(&served.address);
    second.wait_for_state("disabled");
    second.command("enable");
    second.wait("refusal", |viewer| !viewer.refused.is_empty());
    assert_eq!(second.refused, ["take control first"]);
    first.command("enable");
    first.wait_for_state("idle");
    second.wait_for_state("idle");
    second.command("take");
    first.wait("question", |viewer| {
        viewer.control["asks"] == viewer.control["viewers"]
    });
    first.command("keep");
    second.wait("answer", |viewer| viewer.control["asks"].is_null());
    assert!(!second.commands());
    second.command("emergency-stop");
    first.wait_for_state("in emergency stop");
    second.command("take");
    first.wait("question", |viewer| !viewer.control["asks"].is_null());
    first.command("hand-over");
    second.wait("control", Viewer::commands);
    first.command("reset");
    first.wait("refusal", |viewer| !viewer.refused.is_empty());
    drop(second);
    first.wait("nobody", |viewer| viewer.control["commander"].is_null());
}

#[test]
fn a_dropped_connection_ends_a_jog_within_the_dead_man_time() {
    let served = serve(&["--dead-man", "200"]);
    let mut watcher = Viewer::open(&served.address);
    let mut viewer = Viewer::open(&served.address);
    viewer.home();
    watcher.wait_for_state("idle");
    // A command that answers an old state moves nothing.
    let late = json!({"command": "jog", "axis": 0, "up": true, "repeat": false, "t": 0});
    viewer.socket.send(Message::text(late.to_string())).unwrap();
    viewer.wait("refusal", |viewer| !viewer.refused.is_empty());
    assert_eq!(viewer.refused, ["the connection is slow: nothing was done"]);
    assert_eq!(viewer.state["state"], "idle");
    let begin = viewer.actual(0);
    let jog = |viewer: &mut Viewer| {
        viewer.next();
        viewer.send(json!({"command": "jog", "axis": 0, "up": true, "repeat": false}));
        let until = Instant::now() + Duration::from_secs(1);
        while Instant::now() < until {
            viewer.next();
            viewer.send(json!({"command": "jog", "axis": 0, "up": true, "repeat": true}));
        }
    };
    // Silence: the connection is open, as a half-open one seems to be.
    jog(&mut viewer);
    let silent = Instant::now();
    viewer.wait_for_state("idle");
    // 200 ms, the deceleration, two states, and a busy computer.
    assert!(
        silent.elapsed() < Duration::from_millis(200 + 800),
        "{:?}",
        silent.elapsed()
    );
    let moved = viewer.actual(0) - begin;
    assert!(
        moved > 2.0 && moved < 10.0,
        "5 mm/s for about 1.2 s: {moved}"
    );
    jog(&mut viewer);
    watcher.wait("old states", |watcher| {
        watcher.state["t"] == viewer.state["t"]
            || watcher.state["t"].as_u64() > viewer.state["t"].as_u64()
    });
    let dropped = Instant::now();
    drop(viewer);
    watcher.wait_for_state("idle");
    assert!(
        dropped.elapsed() < Duration::from_millis(200 + 800),
        "{:?}",
        dropped.elapsed()
    );
    let end = watcher.actual(0);
    let later = Instant::now() + Duration::from_millis(500);
    while Instant::now() < later {
        watcher.next();
    }
    assert!((watcher.actual(0) - end).abs() < 0.05, "it stays");
}

#[test]
fn a_program_is_uploaded_run_held_and_ends_without_its_viewer() {
    let served = serve(&[]);
    served.folder.file("beside.txt.bak", "");
    let mut viewer = Viewer::open(&served.address);
    viewer.home();
    let upload = |viewer: &mut Viewer, name: &str, text: &str| {
        viewer.next();
        viewer.send(json!({"command": "upload", "name": name, "text": text}));
    };
    for name in [
        "../out.ngc",
        "a/b.ngc",
        "/tmp/out.ngc",
        ".hidden.ngc",
        "x.sh",
    ] {
        let before = viewer.refused.len();
        upload(&mut viewer, name, "M30\n");
        viewer.wait("refusal", |viewer| viewer.refused.len() > before);
    }
    upload(
        &mut viewer,
        "part.ngc",
        "G21 G90 F600\nG1 X8 Y3\nG1 X0\nG1 Y0\nM30\n",
    );
    viewer.wait("list", |viewer| {
        viewer.programs["names"] == json!(["part.ngc"])
    });
    let before = viewer.refused.len();
    upload(&mut viewer, "part.ngc", "M30\n");
    viewer.wait("refusal", |viewer| viewer.refused.len() > before);
    assert_eq!(viewer.refused.last().unwrap(), "part.ngc exists");
    assert!(served.folder.read("part.ngc").contains("G1 X8"));
    viewer.send(json!({"command": "select", "name": "part.ngc"}));
    viewer.wait("scene", |viewer| {
        viewer.scene["scene"]["layers"][0]["points"].is_string()
    });
    viewer.send(json!({"command": "override", "percent": 50}));
    viewer.wait("override", |viewer| viewer.state["override"] == 50);
    for (place, of, percent) in [(1, "rapid", 40), (2, "spindle", 80)] {
        viewer.next();
        viewer.send(json!({"command": "override", "of": of, "percent": percent}));
        viewer.wait(of, |viewer| viewer.state["overrides"][place] == percent);
    }
    viewer.command("run");
    viewer.wait("question", |viewer| viewer.state["question"].is_string());
    viewer.send(json!({"command": "jog", "axis": 17, "up": true, "repeat": false}));
    viewer.wait("message", |viewer| {
        has_message(viewer, "there is no coordinate 17")
    });
    viewer.answer();
    viewer.wait("line", |viewer| viewer.state["program"]["line"] == 2);
    // The line end of the last line begins no sixth one.
    assert_eq!(viewer.state["program"]["lines"], 5);
    viewer.command("hold");
    viewer.wait_for_state("on hold");
    viewer.command("resume");
    viewer.wait_for_state("running");
    // The job goes on without its viewer.
    drop(viewer);
    let mut watcher = Viewer::open(&served.address);
    watcher.wait("last lines", |watcher| {
        watcher.state["program"]["line"] == 4
    });
    watcher.wait("end", |watcher| has_message(watcher, "part.ngc: done"));
    watcher.wait_for_state("idle");
    assert!(watcher.actual(0).abs() < 0.05 && watcher.actual(1).abs() < 0.05);
    served.command.interrupt();
    let ended = served.command.end();
    assert!(
        ended.err.contains("the machine is at standstill"),
        "{}",
        ended.err
    );
}

/// A viewer that saw every change of the stock, and one that comes afterwards, have one surface.
#[test]
fn the_stock_is_sent_once_and_then_its_changes() {
    let served = serve(&["--stock", "examples/block.toml"]);
    let mut viewer = Viewer::open(&served.address);
    viewer.home();
    viewer.wait("stock", |viewer| !viewer.stock.is_empty());
    let blank = viewer.stock.clone();
    let program = std::fs::read_to_string(scene::root().join("examples/e7-slot.ngc")).unwrap();
    viewer.next();
    viewer.send(json!({"command": "upload", "name": "slot.ngc", "text": program}));
    viewer.wait("list", |viewer| {
        viewer.programs["names"] == json!(["slot.ngc"])
    });
    viewer.send(json!({"command": "select", "name": "slot.ngc"}));
    viewer.wait("path", |viewer| viewer.state["selected"] == "slot.ngc");
    viewer.command("run");
    viewer.answer();
    viewer.wait("end", |viewer| has_message(viewer, "slot.ngc: done"));
    let settled = Instant::now() + Duration::from_secs(2);
    while Instant::now() < settled {
        viewer.next();
    }
    let mut late = Viewer::open(&served.address);
    late.wait("stock", |late| !late.stock.is_empty());
    let settled = Instant::now() + Duration::from_secs(1);
    while Instant::now() < settled {
        late.next();
    }
    assert!(viewer.parts > 3, "{} changes", viewer.parts);
    assert_eq!(viewer.stock, late.stock);
    let deepest = blank
        .iter()
        .zip(&viewer.stock)
        .map(|(blank, now)| blank - now);
    let deepest = deepest.fold(0.0, f64::max);
    assert!((1.9..2.1).contains(&deepest), "{deepest} mm");
}

/// The viewer in control makes the position of the tool the zero of a system; another process of
/// the user holds and resumes the job.
#[test]
fn work_offsets_are_set_and_another_process_holds_the_job() {
    let machine = SimServer::on_tcp(&[]);
    let folder = TestFolder::new();
    let text = std::fs::read_to_string(scene::root().join("machines/h4.toml")).unwrap();
    let file = folder.file("h4.toml", text);
    let served = serve(&["--port", &machine.port, "--machine", &file]);
    let mut viewer = Viewer::open(&served.address);
    viewer.home();
    let systems = |viewer: &Viewer| viewer.state["offsets"]["systems"].clone();
    assert_eq!(systems(&viewer), json!([]));
    let mut other = Viewer::open(&served.address);
    other.wait("state", |other| other.state["ready"] == true);
    other.send(json!({"command": "zero", "text": "g55 z=0"}));
    other.wait("refusal", |other| {
        other.refused.iter().any(|why| why == "take control first")
    });
    viewer.next();
    viewer.send(json!({"command": "zero", "text": "g55 z=0"}));
    viewer.wait("offset", |viewer| systems(viewer)[0]["name"] == "G55");
    let z = viewer.state["offsets"]["letters"].as_array().unwrap();
    let z = z.iter().position(|letter| letter == "z").unwrap();
    let origin = systems(&viewer)[0]["origin"][z].as_f64().unwrap();
    assert!((origin - viewer.actual(z)).abs() < 0.01, "{origin}");
    assert!(folder.read("h4.offsets.toml").contains("g55"));
    viewer.send(json!({"command": "zero", "text": "g99 z=0"}));
    viewer.wait("refusal", |viewer| has_message(viewer, "g99"));

    let text = "G21 G90 F300\nG1 X10\nG1 X0\nG1 X10\nG1 X0\nM30\n";
    viewer.send(json!({"command": "upload", "name": "part.ngc", "text": text}));
    viewer.wait("list", |viewer| {
        viewer.programs["names"] == json!(["part.ngc"])
    });
    viewer.send(json!({"command": "select", "name": "part.ngc"}));
    viewer.wait("path", |viewer| viewer.state["selected"] == "part.ngc");
    let nothing = machine.run(&["resume"]).expect_code(8);
    assert!(nothing.err.contains("not held"), "{nothing:?}");
    viewer.command("run");
    viewer.answer();
    viewer.wait_for_state("running");
    let set = machine.run(&["override", "--feed", "50"]).expect_code(0);
    assert!(set.out.contains("feed 50 %"), "{}", set.out);
    viewer.wait("override", |viewer| viewer.state["override"] == 50);
    machine.run(&["hold"]).expect_code(0);
    viewer.wait_for_state("on hold");
    machine.run(&["resume"]).expect_code(0);
    viewer.wait_for_state("running");
    viewer.wait("end", |viewer| has_message(viewer, "part.ngc: done"));
}

/// A program that is refused is not the selected one any more, and the page has its problems.
#[test]
fn a_refused_program_is_not_selected() {
    let served = serve(&[]);
    served.folder.file("good.ngc", "G21 G90 F300\nG1 X1\nM30\n");
    served
        .folder
        .file("bad.ngc", "G21 F600\nG1 X10\nG1 X900\nM30\n");
    let mut viewer = Viewer::open(&served.address);
    viewer.home();
    viewer.send(json!({"command": "select", "name": "good.ngc"}));
    viewer.wait("path", |viewer| {
        viewer.state["selected"] == "good.ngc" && viewer.state["planning"] == false
    });
    viewer.send(json!({"command": "select", "name": "bad.ngc"}));
    viewer.wait("problems", |viewer| viewer.state["problems"].is_array());
    let problems = viewer.state["problems"].to_string();
    assert!(problems.contains("bad.ngc:3:"), "{problems}");
    assert_eq!(viewer.state["selected"], Value::Null);
    viewer.send(json!({"command": "answer", "yes": false}));
    viewer.wait("no problems", |viewer| viewer.state["problems"].is_null());
    viewer.command("run");
    viewer.wait("refusal", |viewer| {
        has_message(viewer, "run: select a part program first")
    });
    assert_eq!(viewer.state["state"], "idle");
}

/// The push moves the joint with the drives off, onto its switch at 158 mm.
#[test]
fn a_joint_is_moved_off_its_limit_switch_by_the_button() {
    let mill = "machines/mill3-servo.toml";
    let push = "push axis=x effort=45 at=1s for=5s";
    let served = serve(&["--machine", mill, "--fault", push]);
    let mut viewer = Viewer::open(&served.address);
    viewer.take();
    viewer.wait_for_state("disabled");
    let pushed = Instant::now() + Duration::from_millis(6500);
    while Instant::now() < pushed {
        viewer.next();
    }
    viewer.command("enable");
    viewer.wait("refusal", |viewer| {
        has_message(viewer, "x is on its limit switch; move it off")
    });
    assert_eq!(viewer.state["state"], "disabled");
    // The pose is not known so far out.
    let x = |viewer: &Viewer| viewer.state["joints"][0]["actual"].as_f64().unwrap();
    assert!(x(&viewer) > 157.0, "{}", x(&viewer));
    viewer.command("move-off");
    viewer.wait("question", |viewer| {
        let question = viewer.state["question"].as_str().unwrap_or_default();
        question.contains("Move x off its limit switch?")
    });
    viewer.answer();
    viewer.wait("x off its switch", |viewer| {
        viewer.state["state"] == "idle" && (140.0..155.0).contains(&x(viewer))
    });
}
