//! A viewer of the page: its connection, and what it was sent.

use super::{LIMIT, numbers, upgrade};
use serde_json::{Value, json};
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tungstenite::protocol::Role;
use tungstenite::{Message, WebSocket};

/// A viewer, as the page is one.
pub struct Viewer {
    pub socket: WebSocket<TcpStream>,
    /// The newest state.
    pub state: Value,
    pub control: Value,
    pub scene: Value,
    pub programs: Value,
    pub refused: Vec<String>,
    /// Heights of the stock.
    pub stock: Vec<f64>,
    /// Changes of the stock that came.
    pub parts: usize,
    /// Largest feed of the states, mm/min.
    pub feed: f64,
}

impl Viewer {
    pub fn open(address: &str) -> Self {
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
    pub fn next(&mut self) {
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

    pub fn send(&mut self, mut command: Value) {
        command["t"] = self.state["t"].clone();
        self.socket
            .send(Message::text(command.to_string()))
            .unwrap();
    }

    pub fn command(&mut self, command: &str) {
        self.send(json!({ "command": command }));
    }

    /// Waits until the state of the machine meets a condition.
    pub fn wait(&mut self, what: &str, holds: impl Fn(&Self) -> bool) {
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

    pub fn wait_for_state(&mut self, state: &str) {
        self.wait(state, |viewer| viewer.state["state"] == state);
    }

    pub fn take(&mut self) {
        self.wait("state", |viewer| viewer.state["ready"] == true);
        self.command("take");
        self.wait("control", Self::commands);
    }

    pub fn commands(&self) -> bool {
        self.control["you"] == self.control["commander"] && !self.control.is_null()
    }

    /// Enables and homes, and waits for the home pose.
    pub fn home(&mut self) {
        self.take();
        self.wait_for_state("disabled");
        assert_eq!(self.state["referenced"], false);
        // Nothing is commanded while the drives are off.
        let commanded = &self.state["columns"]["joint l1 commanded, mm"];
        assert!(commanded.is_null(), "{commanded}");
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
        // No program moves.
        near("speed factor, %", &json!(0.0));
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
    pub fn answer(&mut self) {
        self.wait("question", |viewer| viewer.state["question"].is_string());
        let read = Instant::now() + Duration::from_millis(500);
        while Instant::now() < read {
            self.next();
        }
        self.send(json!({"command": "answer", "yes": true}));
        self.wait("answer", |viewer| viewer.state["question"].is_null());
    }

    pub fn actual(&self, axis: usize) -> f64 {
        self.state["pose"][axis]["actual"].as_f64().unwrap()
    }
}

pub fn has_message(viewer: &Viewer, part: &str) -> bool {
    let messages = viewer.state["messages"].as_array();
    let mut messages = messages.into_iter().flatten();
    messages.any(|message| message["text"].as_str().unwrap().contains(part))
}
