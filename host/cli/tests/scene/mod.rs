//! Runs the command as a process, with temporary folders and served simulators.

// Each test file uses a part of this module.
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Time after which a command counts as hanging. It is no speed limit: all scenarios take half a
/// minute on two idle cores, and several minutes on busy ones.
pub const LIMIT: Duration = Duration::from_secs(600);

/// The root of the workspace, where commands run.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../..")
        .canonicalize()
        .unwrap()
}

/// A temporary folder that is removed at the end of the test.
pub struct TestFolder(PathBuf);

impl TestFolder {
    pub fn new() -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let path =
            std::env::temp_dir().join(format!("haptimill-test-{}-{number}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    /// A path in the folder, as text.
    pub fn path(&self, name: &str) -> String {
        self.0.join(name).to_str().unwrap().to_string()
    }

    /// Writes a file and returns its path.
    pub fn file(&self, name: &str, content: impl AsRef<[u8]>) -> String {
        let path = self.path(name);
        std::fs::write(&path, content).unwrap();
        path
    }

    /// Writes the built-in machine file with more sections and returns its path.
    pub fn machine_with(&self, sections: &str) -> String {
        let text = [haptimill_machine_file::BUILT_IN, sections].join("\n");
        self.file("own.toml", text)
    }

    pub fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.0.join(name)).unwrap()
    }

    /// The summary of a run in a subfolder.
    pub fn summary(&self, out: &str) -> serde_json::Value {
        serde_json::from_str(&self.read(&format!("{out}/summary.json"))).unwrap()
    }

    /// Replaces the path of this folder in a text.
    pub fn redact(&self, text: &str) -> String {
        text.replace(self.0.to_str().unwrap(), "DIR")
    }
}

impl Drop for TestFolder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Exit code and output of a command.
#[derive(Debug)]
pub struct RunResult {
    /// Exit code; -1 if a signal ended the process.
    pub code: i32,
    pub out: String,
    pub err: String,
}

impl RunResult {
    /// The standard output as JSON.
    pub fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.out).unwrap_or_else(|error| panic!("{error} in {self:?}"))
    }

    /// Fails the test unless the command ended with this exit code.
    #[track_caller]
    pub fn expect_code(self, code: i32) -> Self {
        assert_eq!(self.code, code, "{self:#?}");
        self
    }
}

/// A running command, killed if the test ends first.
pub struct Running {
    child: Child,
    out: Option<BufReader<std::process::ChildStdout>>,
    output: String,
    /// Standard error so far, and the thread that reads it.
    errors: Arc<Mutex<String>>,
    err: Option<std::thread::JoinHandle<()>>,
}

/// Starts the command in the root of the workspace, with an empty standard input and no terminal.
pub fn start(arguments: &[&str]) -> Running {
    start_with(arguments, Stdio::null())
}

/// Starts the command with this standard input.
pub fn start_with(arguments: &[&str], input: Stdio) -> Running {
    let mut child = Command::new(env!("CARGO_BIN_EXE_haptimill"))
        .args(arguments)
        .current_dir(root())
        .env("COLUMNS", "120")
        .stdin(input)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let out = BufReader::new(child.stdout.take().unwrap());
    let mut err = child.stderr.take().unwrap();
    let errors = Arc::new(Mutex::new(String::new()));
    let shared = Arc::clone(&errors);
    let err = std::thread::spawn(move || {
        let mut buffer = [0; 4096];
        while let Ok(count @ 1..) = err.read(&mut buffer) {
            let text = String::from_utf8_lossy(&buffer[..count]);
            shared.lock().unwrap().push_str(&text);
        }
    });
    Running {
        child,
        out: Some(out),
        output: String::new(),
        errors,
        err: Some(err),
    }
}

/// Runs the command to its end.
pub fn haptimill(arguments: &[&str]) -> RunResult {
    start(arguments).end()
}

impl Running {
    /// The next line of standard output without its newline; empty at the end.
    pub fn line(&mut self) -> String {
        let mut line = String::new();
        self.out.as_mut().unwrap().read_line(&mut line).unwrap();
        self.output.push_str(&line);
        line.trim_end().to_string()
    }

    /// Waits for a line of standard output that contains `part`.
    #[track_caller]
    pub fn wait_for_output(&mut self, part: &str) {
        loop {
            let line = self.line();
            if line.contains(part) {
                return;
            }
            if line.is_empty() {
                let status = self.child.wait();
                let err = self.collect_errors();
                panic!(
                    "no {part:?} in the output {:?}; {status:?}, {err:?}",
                    self.output
                );
            }
        }
    }

    /// Standard error until it is closed.
    fn collect_errors(&mut self) -> String {
        if let Some(err) = self.err.take() {
            err.join().unwrap();
        }
        self.errors.lock().unwrap().clone()
    }

    /// Standard error so far.
    pub fn errors(&self) -> String {
        self.errors.lock().unwrap().clone()
    }

    /// Waits for a whole line of standard error that begins with `prefix`; returns the rest of it.
    #[track_caller]
    pub fn error_line(&mut self, prefix: &str) -> String {
        loop {
            self.wait_for_error(prefix);
            let errors = self.errors.lock().unwrap();
            let mut lines = errors
                .split_inclusive('\n')
                .filter(|line| line.ends_with('\n'));
            if let Some(rest) = lines.find_map(|line| line.strip_prefix(prefix)) {
                return rest.trim_end().to_string();
            }
            drop(errors);
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Waits until standard error contains `part`.
    #[track_caller]
    pub fn wait_for_error(&mut self, part: &str) {
        while !self.errors.lock().unwrap().contains(part) {
            if !self.runs() {
                panic!("no {part:?} in standard error {:?}", self.collect_errors());
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Waits for the end, at most [`LIMIT`].
    pub fn end(mut self) -> RunResult {
        let mut out = self.out.take().unwrap();
        let reader = std::thread::spawn(move || {
            let mut text = String::new();
            let _ = out.read_to_string(&mut text);
            text
        });
        let status = self.wait();
        self.output.push_str(&reader.join().unwrap());
        RunResult {
            code: status.code().unwrap_or(-1),
            out: std::mem::take(&mut self.output),
            err: self.collect_errors(),
        }
    }

    fn wait(&mut self) -> ExitStatus {
        let start = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            if start.elapsed() > LIMIT {
                let _ = self.child.kill();
                let status = self.child.wait().unwrap();
                panic!(
                    "still running after {LIMIT:?}: {status}; output {:?}",
                    self.output
                );
            }
            // The standard library has no wait with a time limit.
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Whether the process is running.
    pub fn runs(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }

    /// Sends Ctrl-C.
    #[cfg(unix)]
    pub fn interrupt(&self) {
        self.signal(rustix::process::Signal::INT);
    }

    /// Suspends the process, which keeps its ports open.
    #[cfg(unix)]
    pub fn suspend(&self) {
        self.signal(rustix::process::Signal::STOP);
    }

    #[cfg(unix)]
    fn signal(&self, signal: rustix::process::Signal) {
        let pid = rustix::process::Pid::from_raw(self.child.id() as i32).unwrap();
        rustix::process::kill_process(pid, signal).unwrap();
    }

    /// Kills the process.
    pub fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.kill();
    }
}

/// A simulator served in real time.
pub struct SimServer {
    pub process: Running,
    /// The value for --port.
    pub port: String,
}

impl SimServer {
    /// Serves on a free TCP port.
    pub fn on_tcp(more: &[&str]) -> Self {
        Self::on("tcp:127.0.0.1:0", more)
    }

    /// Serves on `tcp:HOST:PORT` or `pty`. The process ends after two minutes even if the test
    /// hangs.
    pub fn on(listen: &str, more: &[&str]) -> Self {
        let mut process =
            start(&[&["sim", "serve", "--for", "120", "--listen", listen], more].concat());
        let port = process.line();
        assert!(!port.is_empty(), "{:?}", process.end());
        Self { process, port }
    }

    /// Runs a command on this port, which must succeed.
    #[track_caller]
    pub fn run_ok(&self, command: &[&str]) -> RunResult {
        self.run(command).expect_code(0)
    }

    /// Runs a command on this port.
    pub fn run(&self, command: &[&str]) -> RunResult {
        haptimill(&[command, &["--port", &self.port]].concat())
    }

    /// `haptimill status --json`.
    #[track_caller]
    pub fn status(&self) -> serde_json::Value {
        self.run_ok(&["status", "--json"]).json()
    }
}

impl SimServer {
    /// As [`SimServer::status`], of a machine that is not built in.
    #[track_caller]
    pub fn status_of(&self, machine: &str) -> serde_json::Value {
        let ran = self.run_ok(&["status", "--json", "--machine", machine]);
        ran.json()
    }
}

/// The number in a field of a JSON object.
#[track_caller]
pub fn number(value: &serde_json::Value, field: &str) -> f64 {
    value[field]
        .as_f64()
        .unwrap_or_else(|| panic!("no number {field} in {value:#}"))
}
