//! The WebSocket of a viewer.

use crate::{FRESH, FRESH_JOG, OperatorCommand, Shared, lock, programs};
use serde::Deserialize;
use serde_json::{Value, json};
use std::io;
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Error, Message, WebSocket};

/// Longest wait for a message, and so the longest delay of a published state.
const POLL: Duration = Duration::from_millis(20);

/// Time between two pings.
const PING: Duration = Duration::from_secs(2);

/// Silence after which a viewer is disconnected.
const SILENCE: Duration = Duration::from_secs(20);

/// Largest message rate, 1/s, and largest burst.
const RATE: f64 = 100.0;

/// Length of a message at most: a program in JSON, whose line ends take two bytes.
const LONGEST_MESSAGE: usize = 2 * programs::LONGEST;

/// What the page sends.
#[derive(Debug, Deserialize)]
struct Envelope {
    /// Time of the newest state that the page has, ms.
    #[serde(default)]
    t: u64,
    #[serde(flatten)]
    request: Request,
}

#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Request {
    Command(OperatorCommand),
    Own(Own),
}

/// Requests that the server handles itself.
#[derive(Debug, Deserialize)]
#[serde(tag = "command", rename_all = "kebab-case")]
enum Own {
    Take,
    HandOver,
    Keep,
    List,
    Select {
        name: String,
    },
    Upload {
        name: String,
        text: String,
        #[serde(default)]
        replace: bool,
    },
}

struct Viewer<'a> {
    shared: &'a Arc<Shared>,
    peer: SocketAddr,
    number: u64,
    socket: WebSocket<TcpStream>,
    /// Versions that the viewer has.
    state: u64,
    scene: u64,
    /// Version of the whole surface of the stock, and the number of its changes.
    stock: (u64, usize),
    control: u64,
    last_received: Instant,
    pinged: Instant,
    allowance: f64,
    counted: Instant,
}

pub(super) fn serve(shared: &Arc<Shared>, stream: TcpStream, peer: SocketAddr, rest: Vec<u8>) {
    if stream.set_read_timeout(Some(POLL)).is_err() {
        return;
    }
    let config = WebSocketConfig::default()
        .max_message_size(Some(LONGEST_MESSAGE))
        .max_frame_size(Some(LONGEST_MESSAGE));
    let now = Instant::now();
    let mut viewer = Viewer {
        shared,
        peer,
        number: shared.last_viewer.fetch_add(1, Ordering::SeqCst) + 1,
        socket: WebSocket::from_partially_read(stream, rest, Role::Server, Some(config)),
        state: 0,
        scene: 0,
        stock: (0, 0),
        control: u64::MAX,
        last_received: now,
        pinged: now,
        allowance: RATE,
        counted: now,
    };
    lock(&shared.control).join();
    let ended = viewer.run();
    let commanded = lock(&shared.control).leave(viewer.number, Instant::now());
    if commanded {
        shared.send(OperatorCommand::ControlEnded);
    }
    if let Err(what) = ended {
        let ip = peer.ip();
        shared.warn(format!("viewer {} ({ip}): closed, {what}", viewer.number));
    }
    let _ = viewer.socket.close(None);
    let _ = viewer.socket.flush();
}

impl Viewer<'_> {
    /// Serves until the viewer leaves.
    fn run(&mut self) -> Result<(), String> {
        self.list().map_err(|error| error.to_string())?;
        while !self.shared.has_ended.load(Ordering::SeqCst) {
            match self.socket.read() {
                Ok(Message::Text(text)) => {
                    self.last_received = Instant::now();
                    self.count()?;
                    self.handle(&text)?;
                }
                Ok(Message::Binary(_)) => return Err("a binary message".to_string()),
                Ok(Message::Close(_)) => return Ok(()),
                Ok(_) => {
                    self.last_received = Instant::now();
                    self.count()?;
                }
                Err(Error::Io(error)) if is_quiet(&error) => {}
                Err(Error::ConnectionClosed | Error::Io(_)) => return Ok(()),
                Err(error) => return Err(error.to_string()),
            }
            if self.last_received.elapsed() > SILENCE {
                return Err(format!("nothing came for {} s", SILENCE.as_secs()));
            }
            let moved = lock(&self.shared.control).advance(Instant::now());
            if moved {
                self.shared.send(OperatorCommand::ControlEnded);
            }
            match self.publish() {
                Ok(()) => {}
                Err(Error::Io(error)) if is_quiet(&error) => {
                    return Err("it does not read".to_string());
                }
                Err(_) => return Ok(()),
            }
        }
        Ok(())
    }

    /// Counts a message.
    fn count(&mut self) -> Result<(), String> {
        let now = Instant::now();
        let since = now.duration_since(self.counted).as_secs_f64();
        self.counted = now;
        self.allowance = (self.allowance + since * RATE).min(RATE) - 1.0;
        if self.allowance < 0.0 {
            return Err(format!("more than {RATE} messages per second"));
        }
        Ok(())
    }

    fn publish(&mut self) -> Result<(), Error> {
        let control = {
            let control = lock(&self.shared.control);
            (control.version() != self.control).then(|| {
                self.control = control.version();
                json!({
                    "kind": "control",
                    "you": self.number,
                    "commander": control.commander(),
                    "asks": control.asks(),
                    "viewers": control.viewers(),
                })
            })
        };
        if let Some(control) = control {
            self.send(&control)?;
        }
        for (published, seen) in [
            (&self.shared.scene, &mut self.scene),
            (&self.shared.state, &mut self.state),
        ] {
            let text = {
                let newest = lock(published);
                let is_new = std::mem::replace(seen, newest.version) != newest.version;
                is_new.then(|| newest.text.to_string())
            };
            if let Some(text) = text {
                self.socket.send(Message::text(text))?;
            }
        }
        let changes: Vec<Arc<str>> = {
            let stock = lock(&self.shared.stock);
            let (version, count) = self.stock;
            self.stock = (stock.version, stock.parts.len());
            let is_new = version != stock.version;
            let whole = is_new.then(|| Arc::clone(&stock.whole));
            let seen = if is_new { 0 } else { count };
            let parts = stock.parts.iter().skip(seen).cloned();
            whole.into_iter().chain(parts).collect()
        };
        for text in changes {
            self.socket.send(Message::text(text.to_string()))?;
        }
        if self.pinged.elapsed() > PING {
            self.pinged = Instant::now();
            self.socket.send(Message::Ping(Vec::new().into()))?;
        }
        Ok(())
    }

    fn send(&mut self, value: &Value) -> Result<(), Error> {
        self.socket.send(Message::text(value.to_string()))
    }

    fn list(&mut self) -> Result<(), Error> {
        let names = programs::list(&self.shared.programs);
        self.send(&json!({"kind": "programs", "names": names}))
    }

    /// Does what a message asks for; answers what is refused.
    ///
    /// # Errors
    /// It is no message of the page.
    fn handle(&mut self, text: &str) -> Result<(), String> {
        let Envelope { t, request } = serde_json::from_str(text).map_err(|_| {
            let begin: String = text.chars().take(60).collect();
            format!("an unknown message {begin:?}")
        })?;
        let done = match request {
            Request::Command(command) => self.command(command, t),
            Request::Own(own) => self.own(own, t),
        };
        if let Err(what) = done {
            let _ = self.send(&json!({"kind": "refused", "text": what}));
        }
        Ok(())
    }

    fn command(&self, command: OperatorCommand, t: u64) -> Result<(), String> {
        if !command.only_stops() {
            let limit = match command {
                OperatorCommand::Jog { .. } => FRESH_JOG,
                _ => FRESH,
            };
            self.check(t, limit)?;
        }
        if self.shared.send(command) {
            return Ok(());
        }
        Err("too many commands wait; try again".to_string())
    }

    /// Checks that the viewer commands, and that it sees the machine as it is now.
    fn check(&self, t: u64, limit: Duration) -> Result<(), String> {
        if lock(&self.shared.control).commander() != Some(self.number) {
            return Err("take control first".to_string());
        }
        let age = u128::from(self.shared.now_ms()).checked_sub(u128::from(t));
        if age.is_none_or(|age| age > limit.as_millis()) {
            return Err("the connection is slow: nothing was done".to_string());
        }
        Ok(())
    }

    fn own(&mut self, own: Own, t: u64) -> Result<(), String> {
        let now = Instant::now();
        match own {
            Own::Take => lock(&self.shared.control).take(self.number, now),
            Own::HandOver | Own::Keep => {
                let hands_over = matches!(own, Own::HandOver);
                let moved = lock(&self.shared.control).answer(self.number, hands_over);
                if moved {
                    self.shared.send(OperatorCommand::ControlEnded);
                }
            }
            Own::List => return self.list().map_err(|error| error.to_string()),
            Own::Select { name } => {
                self.check(t, FRESH)?;
                let path = self.logged(programs::find(&self.shared.programs, &name))?;
                self.shared.send(OperatorCommand::Select(path));
            }
            Own::Upload {
                name,
                text,
                replace,
            } => {
                // The text may take longer than a command to arrive; it moves nothing.
                self.check(t, SILENCE)?;
                let folder = &self.shared.programs;
                self.logged(programs::store(folder, &name, &text, replace))?;
                return self.list().map_err(|error| error.to_string());
            }
        }
        Ok(())
    }

    fn logged<T>(&self, result: Result<T, String>) -> Result<T, String> {
        if let Err(what) = &result {
            let number = self.number;
            self.shared
                .warn(format!("viewer {number} ({}): {what}", self.peer.ip()));
        }
        result
    }
}

fn is_quiet(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted
    )
}
