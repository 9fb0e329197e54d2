//! Live view: one page, and a WebSocket with the state of a machine and the commands of an
//! operator.
//!
//! The crate knows no machine. [`Server::bind`] serves the page; its owner publishes the state as
//! JSON ([`Server::publish`], [`Server::publish_scene`]) and takes commands
//! ([`Server::next_command`]). A thread serves each connection; the owner never waits for one.
//!
//! # Permissions
//!
//! | request | from |
//! | --- | --- |
//! | page, script, style | a `Host` header that names the served address |
//! | WebSocket | also an `Origin` header of the served page, and the token where there is one |
//! | hold, stop, emergency stop, end of a jog | every viewer |
//! | any other command | the viewer in control, in answer to a state of the last moment |
//!
//! A page of a stranger has another origin. A name of a stranger that resolves to this address (DNS
//! rebinding) is another host. Both are refused and reported as [`OperatorCommand::Warn`].
//!
//! A viewer that is asked to hand over and does not answer within [`control::ANSWER`] hands over.
//!
//! # Messages
//!
//! The page sends JSON objects with the key `command` ([`OperatorCommand`], and `take`,
//! `hand-over`, `keep`, `list`, `upload`, `select`) and `t`, the time of the newest state that it
//! has. A command that waited on the line for longer than [`FRESH`] (a jog: [`FRESH_JOG`]) is
//! refused: it moves nothing late. The page gets JSON objects with the key `kind`: `state`,
//! `scene`, `stock`,
//! `stock-part`, `control`, `programs`, `refused`.

pub mod access;
pub mod control;
mod http;
pub mod programs;
mod socket;

use control::Control;
use serde::Deserialize;
use serde_json::{Value, json};
use std::io::{self, Write as _};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Connections at most, viewers and those under way.
pub const MAX_CONNECTIONS: usize = 32;

/// Age of the state that a command answers, at most.
pub const FRESH: Duration = Duration::from_millis(2000);

/// As [`FRESH`], of a jog.
pub const FRESH_JOG: Duration = Duration::from_millis(500);

/// Commands that wait for the owner at most.
const MAX_COMMANDS: usize = 256;

/// Time between two looks for a new connection.
const ACCEPT: Duration = Duration::from_millis(10);

/// What an override scales.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Scaled {
    /// Moves at feed.
    #[default]
    Feed,
    /// Rapid moves.
    Rapid,
    /// The spindle speed.
    Spindle,
}

/// A command of a viewer.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(tag = "command", rename_all = "kebab-case")]
pub enum OperatorCommand {
    /// Decelerate along the path.
    Hold,
    /// Stop, and drop the job.
    Stop,
    /// Drives off.
    EmergencyStop,
    /// Drives on.
    Enable,
    /// Drives off, at standstill.
    Disable,
    /// Leave fault or emergency stop.
    Reset,
    /// Home the machine, after a question.
    Home,
    /// Move a joint off its limit switch, after a question.
    MoveOff,
    /// Continue a job on hold.
    Resume,
    /// Run the selected program, after a question.
    Run,
    /// Answer to the question in the state.
    Answer {
        /// Do it.
        yes: bool,
    },
    /// An override.
    Override {
        /// What it scales.
        #[serde(default)]
        of: Scaled,
        /// Percent; the owner bounds it.
        percent: u8,
    },
    /// Select the next larger or smaller jog rate.
    JogRate {
        /// Larger.
        more: bool,
    },
    /// A jog button is pressed, or still held.
    Jog {
        /// Index of the pose coordinate.
        coordinate: usize,
        /// Direction.
        up: bool,
        /// Still held since an earlier press.
        repeat: bool,
    },
    /// The jog button is released.
    JogEnd,
    /// Make the present position the place of coordinates in a work coordinate system, as
    /// `g54 x=0 y=0`.
    Zero {
        /// System and coordinates.
        text: String,
    },
    /// Select a part program.
    #[serde(skip)]
    Select(PathBuf),
    /// Another viewer has control now, or none: no jog goes on.
    #[serde(skip)]
    ControlEnded,
    /// For the messages of the machine: something was refused.
    #[serde(skip)]
    Warn(String),
}

impl OperatorCommand {
    /// Whether every viewer may give it, at any time: it only stops.
    const fn only_stops(&self) -> bool {
        matches!(
            self,
            Self::Hold | Self::Stop | Self::EmergencyStop | Self::JogEnd
        )
    }
}

/// What is served.
#[derive(Debug, Clone)]
pub struct Config {
    /// Address to listen on; port 0 takes a free one.
    pub listen: SocketAddr,
    /// Token that viewers must have. Callers must give one for an address that other computers
    /// reach.
    pub token: Option<String>,
    /// Folder of part programs.
    pub programs: PathBuf,
}

/// A text, and how often it was replaced.
#[derive(Debug, Default)]
struct Published {
    version: u64,
    text: Arc<str>,
}

impl Published {
    fn set(&mut self, text: String) {
        self.version += 1;
        self.text = text.into();
    }
}

/// The surface of the stock: a whole one, and what changed since.
#[derive(Debug, Default)]
struct Stock {
    /// Counts the whole surfaces.
    version: u64,
    whole: Arc<str>,
    parts: Vec<Arc<str>>,
}

/// What all threads share.
struct Shared {
    started: Instant,
    address: SocketAddr,
    token: Option<String>,
    programs: PathBuf,
    state: Mutex<Published>,
    scene: Mutex<Published>,
    stock: Mutex<Stock>,
    control: Mutex<Control>,
    commands: SyncSender<OperatorCommand>,
    connections: AtomicUsize,
    last_viewer: AtomicU64,
    has_ended: AtomicBool,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A thread that panicked leaves whole values: each is replaced in one assignment.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    /// Time since the server began, ms.
    fn now_ms(&self) -> u64 {
        u64::try_from(self.started.elapsed().as_millis()).unwrap_or(u64::MAX)
    }

    /// Reports a refusal; left out when more wait than the owner takes.
    fn warn(&self, text: String) {
        let _ = self.commands.try_send(OperatorCommand::Warn(text));
    }

    /// Reports a request that was refused. The port of the peer is left out: the report of a peer
    /// that tries again is the same one.
    fn refuse(&self, peer: SocketAddr, what: &str) {
        self.warn(format!("{}: refused, {what}", peer.ip()));
    }

    /// Passes a command; false when too many wait. A stop waits for its turn.
    fn send(&self, command: OperatorCommand) -> bool {
        if command.only_stops() || command == OperatorCommand::ControlEnded {
            return self.commands.send(command).is_ok();
        }
        !matches!(self.commands.try_send(command), Err(TrySendError::Full(_)))
    }
}

/// Counts a connection while it lives.
struct Counted(Arc<Shared>);

impl Counted {
    fn new(shared: &Arc<Shared>) -> Option<Self> {
        let count = shared.connections.fetch_add(1, Ordering::SeqCst);
        let counted = Self(Arc::clone(shared));
        (count < MAX_CONNECTIONS).then_some(counted)
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        self.0.connections.fetch_sub(1, Ordering::SeqCst);
    }
}

/// The server; it ends when it is dropped.
pub struct Server {
    shared: Arc<Shared>,
    commands: Receiver<OperatorCommand>,
}

impl Server {
    /// Listens, and serves from now on.
    ///
    /// # Errors
    /// The address cannot be listened on.
    pub fn bind(config: Config) -> io::Result<Self> {
        let listener = TcpListener::bind(config.listen)?;
        listener.set_nonblocking(true)?;
        let (sender, commands) = sync_channel(MAX_COMMANDS);
        let shared = Arc::new(Shared {
            started: Instant::now(),
            address: listener.local_addr()?,
            token: config.token,
            programs: config.programs,
            state: Mutex::default(),
            scene: Mutex::default(),
            stock: Mutex::default(),
            control: Mutex::default(),
            commands: sender,
            connections: AtomicUsize::new(0),
            last_viewer: AtomicU64::new(0),
            has_ended: AtomicBool::new(false),
        });
        let served = Arc::clone(&shared);
        thread::Builder::new()
            .name("web".into())
            .spawn(move || accept(&listener, &served))?;
        Ok(Self { shared, commands })
    }

    /// The address on which it listens.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.shared.address
    }

    /// The address of the page, with the token. A server on all addresses of the computer names the
    /// one towards other computers, and the loopback address without such a one.
    #[must_use]
    pub fn link(&self) -> String {
        let address = reachable(self.address());
        match &self.shared.token {
            // Behind '#': the browser sends it to nobody by itself.
            Some(token) => format!("http://{address}/#token={token}"),
            None => format!("http://{address}/"),
        }
    }

    /// The next command; none when there is none now.
    #[must_use]
    pub fn next_command(&self) -> Option<OperatorCommand> {
        self.commands.try_recv().ok()
    }

    /// Publishes the state, a JSON object.
    pub fn publish(&self, mut state: Value) {
        state["kind"] = json!("state");
        state["t"] = json!(self.shared.now_ms());
        lock(&self.shared.state).set(state.to_string());
    }

    /// Publishes the programmed path: a scene of the viewer as JSON, with the program's name.
    pub fn publish_scene(&self, program: &str, scene: &str) {
        let name = json!(program);
        let text = format!("{{\"kind\":\"scene\",\"program\":{name},\"scene\":{scene}}}");
        lock(&self.shared.scene).set(text);
    }
}

impl Server {
    /// Publishes the surface of the stock: the members of a JSON object, without braces.
    pub fn publish_stock(&self, members: &str) {
        let mut stock = lock(&self.shared.stock);
        stock.version += 1;
        stock.whole = format!("{{\"kind\":\"stock\",{members}}}").into();
        stock.parts.clear();
    }

    /// Publishes a change of the surface, as [`Server::publish_stock`]. A viewer that comes later
    /// gets the surface and then all its changes: a caller must publish the whole surface again
    /// when these are longer.
    pub fn publish_stock_part(&self, members: &str) {
        let part = format!("{{\"kind\":\"stock-part\",{members}}}");
        lock(&self.shared.stock).parts.push(part.into());
    }
}

/// The address under which other computers reach a listener.
fn reachable(listening: SocketAddr) -> SocketAddr {
    if !listening.ip().is_unspecified() {
        return listening;
    }
    let port = listening.port();
    // No packet is sent: the system names the address from which it would send one to these
    // addresses of documentation.
    let towards = |from: &str, to: &str| {
        let socket = UdpSocket::bind(from).ok()?;
        socket.connect(to).ok()?;
        let ip = socket.local_addr().ok()?.ip();
        (!ip.is_unspecified()).then(|| SocketAddr::new(ip, port))
    };
    let four = || towards("0.0.0.0:0", "192.0.2.1:9");
    let loopback = match listening.ip() {
        IpAddr::V4(_) => IpAddr::V4(Ipv4Addr::LOCALHOST),
        IpAddr::V6(_) => IpAddr::V6(Ipv6Addr::LOCALHOST),
    };
    let found = match listening.ip() {
        IpAddr::V4(_) => four(),
        // A listener on all addresses of version 6 has those of version 4, too.
        IpAddr::V6(_) => four().or_else(|| towards("[::]:0", "[2001:db8::1]:9")),
    };
    found.unwrap_or(SocketAddr::new(loopback, port))
}

impl Drop for Server {
    fn drop(&mut self) {
        self.shared.has_ended.store(true, Ordering::SeqCst);
    }
}

fn accept(listener: &TcpListener, shared: &Arc<Shared>) {
    while !shared.has_ended.load(Ordering::SeqCst) {
        let Ok((stream, peer)) = listener.accept() else {
            thread::sleep(ACCEPT);
            continue;
        };
        let Some(counted) = Counted::new(shared) else {
            refuse_busy(stream);
            shared.warn(format!(
                "{}: refused, {MAX_CONNECTIONS} connections are open; close a page",
                peer.ip()
            ));
            continue;
        };
        let serve = move || {
            http::serve(&counted.0, stream, peer);
            drop(counted);
        };
        // Without a thread the connection closes.
        let _ = thread::Builder::new().name("viewer".into()).spawn(serve);
    }
}

fn refuse_busy(mut stream: TcpStream) {
    let _ = stream.set_nonblocking(true);
    let _ = stream.write(b"HTTP/1.1 503 Busy\r\nConnection: close\r\nContent-Length: 0\r\n\r\n");
}
