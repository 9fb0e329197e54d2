//! Requests of other processes of the same user to the process that commands a machine.
//!
//! A controller has one session. The process that has it listens on a local socket in a folder that
//! only its user can open; the name of the socket is that of the port. A request and its answer are
//! one line each.

use super::{PortError, PortSpec, is_quiet};
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Longest request, bytes.
const LONGEST: usize = 4096;
/// Longest answer, bytes.
const LONGEST_ANSWER: u64 = 1 << 16;

/// Connections at most.
const MAX: usize = 8;

/// Longest wait for an answer: a job looks for requests every few milliseconds, and not during a
/// probe move.
const ANSWER: Duration = Duration::from_secs(5);

/// Longest part of a port's name in the name of the socket: a path of a socket has 108 bytes.
const LONGEST_NAME: usize = 60;

/// The socket of the process that commands a machine.
pub struct Control {
    path: PathBuf,
    listener: UnixListener,
    peers: Vec<Peer>,
}

struct Peer {
    stream: UnixStream,
    received: Vec<u8>,
}

impl Control {
    /// Listens for requests to the process that has the port.
    ///
    /// # Errors
    /// [`PortError::Open`]; another process that listens for the same port, too.
    pub fn listen(port: &PortSpec) -> Result<Self, PortError> {
        let path = folder()
            .map_err(|error| failed(port, &error))?
            .join(name(port));
        let listen = || {
            // The socket of a process that was killed stays, and nobody answers on it.
            if UnixStream::connect(&path).is_err() {
                let _ = std::fs::remove_file(&path);
            }
            let listener = UnixListener::bind(&path)?;
            listener.set_nonblocking(true)?;
            Ok(listener)
        };
        let listener = listen().map_err(|error: std::io::Error| failed(port, &error))?;
        Ok(Self {
            path,
            listener,
            peers: Vec::new(),
        })
    }

    /// Answers the requests that have arrived; never waits.
    pub fn serve(&mut self, mut answer: impl FnMut(&str) -> String) {
        while self.peers.len() < MAX
            && let Ok((stream, _)) = self.listener.accept()
        {
            if stream.set_nonblocking(true).is_ok() {
                self.peers.push(Peer {
                    stream,
                    received: Vec::new(),
                });
            }
        }
        self.peers.retain_mut(|peer| peer.serve(&mut answer));
    }
}

impl Drop for Control {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

impl Peer {
    /// Reads once; false when the connection ends, which is after one answer.
    fn serve(&mut self, answer: &mut impl FnMut(&str) -> String) -> bool {
        let mut buffer = [0; 512];
        match self.stream.read(&mut buffer) {
            Ok(0) => return false,
            Ok(count) => self.received.extend_from_slice(&buffer[..count]),
            Err(error) => return is_quiet(&error),
        }
        let Some(end) = self.received.iter().position(|byte| *byte == b'\n') else {
            return self.received.len() < LONGEST;
        };
        let request = String::from_utf8_lossy(&self.received[..end]).into_owned();
        // An answer of one line fits the buffer of a socket.
        let _ = self.stream.write_all((answer(&request) + "\n").as_bytes());
        false
    }
}

/// Sends a request to the process that commands the machine of a port, and returns its answer.
///
/// # Errors
/// No process of this user listens for this port, or it does not answer.
pub fn ask(port: &PortSpec, request: &str) -> Result<String, PortError> {
    let ask = || {
        let mut stream = UnixStream::connect(folder()?.join(name(port)))?;
        stream.set_read_timeout(Some(ANSWER))?;
        stream.write_all(format!("{request}\n").as_bytes())?;
        let mut line = String::new();
        BufReader::new(stream)
            .take(LONGEST_ANSWER)
            .read_line(&mut line)?;
        Ok(line.trim_end().to_string())
    };
    match ask() {
        Ok(line) if !line.is_empty() => Ok(line),
        Ok(_) => Err(unanswered(port, "its job has ended")),
        Err(error) if is_quiet(&error) => Err(unanswered(port, "it does not answer now")),
        Err(_) => Err(unanswered(port, "no process of this user runs a job on it")),
    }
}

fn unanswered(port: &PortSpec, reason: &str) -> PortError {
    PortError::Uncommanded {
        name: port.to_string(),
        reason: reason.into(),
    }
}

fn failed(port: &PortSpec, error: &std::io::Error) -> PortError {
    PortError::Open {
        name: format!("socket for requests to {port}"),
        reason: error.to_string(),
        remedy: "the job runs without it; `haptimill stop` works meanwhile",
    }
}

/// The folder of the sockets, which only this user can open.
fn folder() -> std::io::Result<PathBuf> {
    let user = rustix::process::getuid().as_raw();
    let folder = match std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from) {
        Some(runtime) if runtime.is_dir() => runtime.join("haptimill"),
        _ => std::env::temp_dir().join(format!("haptimill-{user}")),
    };
    let made = std::fs::DirBuilder::new().mode(0o700).create(&folder);
    if let Err(error) = made
        && error.kind() != std::io::ErrorKind::AlreadyExists
    {
        return Err(error);
    }
    check_owner(&folder, user)?;
    Ok(folder)
}

/// Refuses a folder that another user made, or may write.
fn check_owner(folder: &Path, user: u32) -> std::io::Result<()> {
    let data = std::fs::symlink_metadata(folder)?;
    if data.is_dir() && data.uid() == user && data.mode() & 0o077 == 0 {
        return Ok(());
    }
    let what = format!("{}: other users may open it", folder.display());
    Err(std::io::Error::new(
        std::io::ErrorKind::PermissionDenied,
        what,
    ))
}

/// The name of the socket of a port.
fn name(port: &PortSpec) -> String {
    let port = match port {
        // A link to a device is the device.
        PortSpec::Serial(path) => std::fs::canonicalize(path)
            .map_or_else(|_| path.clone(), |path| path.display().to_string()),
        port => port.to_string(),
    };
    let plain = |letter: char| match letter {
        'a'..='z' | 'A'..='Z' | '0'..='9' | '.' => letter,
        _ => '-',
    };
    let name: Vec<char> = port.chars().map(plain).collect();
    let tail = &name[name.len().saturating_sub(LONGEST_NAME)..];
    format!("{}.sock", tail.iter().collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_is_answered_and_an_old_socket_is_replaced() {
        let port: PortSpec = format!("tcp:127.0.0.1:{}", 20_000 + std::process::id() % 10_000)
            .parse()
            .expect("a port");
        assert!(ask(&port, "hold").is_err());
        let path = folder().expect("a folder").join(name(&port));
        // What a process that was killed leaves.
        drop(UnixListener::bind(&path).expect("bound"));
        let mut control = Control::listen(&port).expect("listens");
        assert!(Control::listen(&port).is_err(), "two listen for one port");
        let asked = port.clone();
        let asking = std::thread::spawn(move || ask(&asked, "feed 120"));
        let mut seen = Vec::new();
        while !asking.is_finished() {
            control.serve(|request| {
                seen.push(request.to_string());
                "done".into()
            });
            std::thread::sleep(Duration::from_millis(1));
        }
        assert_eq!(asking.join().expect("no panic").expect("answered"), "done");
        assert_eq!(seen, ["feed 120"]);
        drop(control);
        assert!(!path.exists());
    }

    /// A flood without a line end ends its connection.
    #[test]
    fn a_request_without_an_end_is_dropped() {
        let port: PortSpec = format!("tcp:127.0.0.2:{}", 20_000 + std::process::id() % 10_000)
            .parse()
            .expect("a port");
        let mut control = Control::listen(&port).expect("listens");
        let mut rude = UnixStream::connect(&control.path).expect("connects");
        rude.write_all(&[b'x'; 2 * LONGEST]).expect("buffered");
        for _ in 0..40 {
            control.serve(|_| unreachable!("no request"));
        }
        assert!(control.peers.is_empty());
    }
}
