//! Pseudo-terminal with a program in it, its screen, and a keyboard.
//!
//! It is the controlling terminal of the program (`setsid --ctty`), so closing it is equivalent to
//! closing a terminal window.

// Each test binary uses another part of this module.
pub mod console;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::OwnedFd;
use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{LocalModes, Winsize, tcgetattr, tcsetwinsize};
use std::num::NonZero;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Longest wait for a change of the screen, on a loaded machine too.
pub const TIMEOUT: Duration = Duration::from_secs(40);

/// Keyboard protocol of the terminal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Keyboard {
    /// It reports presses only.
    Plain,
    /// It reports releases (kitty keyboard protocol).
    Kitty,
    /// It answers no query.
    Silent,
}

/// See the module documentation.
pub struct Terminal {
    device: Option<Arc<OwnedFd>>,
    screen: Arc<Mutex<vt100::Parser>>,
    ended: Arc<AtomicBool>,
    stuck: Arc<AtomicBool>,
    reader: Option<JoinHandle<()>>,
    child: Child,
}

fn cells(count: u16) -> NonZero<u16> {
    NonZero::new(count).expect("a terminal with cells")
}

fn size(columns: u16, rows: u16) -> Winsize {
    Winsize {
        ws_row: rows,
        ws_col: columns,
        ws_xpixel: 0,
        ws_ypixel: 0,
    }
}

/// Reads the output of the program and answers its queries.
fn read(
    device: &OwnedFd,
    screen: &Mutex<vt100::Parser>,
    ended: &AtomicBool,
    stuck: &AtomicBool,
    keyboard: Keyboard,
) {
    let wait = Timespec {
        tv_sec: 0,
        tv_nsec: 20_000_000,
    };
    let mut buffer = [0; 8192];
    let mut tail: Vec<u8> = Vec::new();
    while !ended.load(Ordering::Relaxed) {
        if stuck.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(5));
            continue;
        }
        let mut fds = [PollFd::new(device, PollFlags::IN)];
        if !matches!(poll(&mut fds, Some(&wait)), Ok(1..)) {
            continue;
        }
        match rustix::io::read(device, &mut buffer) {
            Ok(count @ 1..) => {
                let output = &buffer[..count];
                screen.lock().unwrap().process(output);
                tail.extend_from_slice(output);
                let queries =
                    |question: &[u8]| tail.windows(question.len()).any(|part| part == question);
                if keyboard != Keyboard::Silent && queries(b"\x1b[c") {
                    if keyboard == Keyboard::Kitty && queries(b"\x1b[?u") {
                        let _ = rustix::io::write(device, b"\x1b[?0u");
                    }
                    let _ = rustix::io::write(device, b"\x1b[?62;c");
                    tail.clear();
                }
                let surplus = tail.len().saturating_sub(16);
                tail.drain(..surplus);
            }
            // The program has closed its end, or has not opened it yet.
            _ => std::thread::sleep(Duration::from_millis(5)),
        }
    }
}

impl Terminal {
    /// Starts a program in a terminal of this size.
    pub fn start(
        program: &Path,
        arguments: &[&str],
        folder: &Path,
        (columns, rows): (u16, u16),
        keyboard: Keyboard,
    ) -> Self {
        let device =
            openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        grantpt(&device).unwrap();
        unlockpt(&device).unwrap();
        tcsetwinsize(&device, size(columns, rows)).unwrap();
        let path = ptsname(&device, Vec::new()).unwrap();
        let open = || {
            let flags = OFlags::RDWR | OFlags::NOCTTY;
            Stdio::from(rustix::fs::open(path.as_c_str(), flags, Mode::empty()).unwrap())
        };
        let child = Command::new("setsid")
            .arg("--ctty")
            .arg(program)
            .args(arguments)
            .current_dir(folder)
            .env("TERM", "xterm-256color")
            .env_remove("NO_COLOR")
            .stdin(open())
            .stdout(open())
            .stderr(open())
            .spawn()
            .expect("setsid, of util-linux");
        let device = Arc::new(device);
        let screen = Arc::new(Mutex::new(vt100::Parser::new(
            cells(rows),
            cells(columns),
            0,
        )));
        let ended = Arc::new(AtomicBool::new(false));
        let stuck = Arc::new(AtomicBool::new(false));
        let reader = {
            let (device, screen) = (Arc::clone(&device), Arc::clone(&screen));
            let (ended, stuck) = (Arc::clone(&ended), Arc::clone(&stuck));
            std::thread::spawn(move || read(&device, &screen, &ended, &stuck, keyboard))
        };
        Self {
            device: Some(device),
            screen,
            ended,
            stuck,
            reader: Some(reader),
            child,
        }
    }

    fn device(&self) -> &OwnedFd {
        self.device.as_ref().expect("a terminal that is open")
    }

    /// Sends the byte sequences of keys.
    pub fn press(&self, bytes: &[u8]) {
        assert_eq!(rustix::io::write(self.device(), bytes), Ok(bytes.len()));
    }

    /// Sends keys and waits for a text on the screen.
    #[track_caller]
    pub fn press_expect(&self, keys: &[u8], part: &str) {
        self.press(keys);
        self.expect_text(part);
    }

    /// Presses Escape and waits: a byte right after it would make another key.
    pub fn escape(&self) {
        self.press(b"\x1b");
        std::thread::sleep(Duration::from_millis(150));
    }

    /// Text of the screen.
    pub fn text(&self) -> String {
        self.screen.lock().unwrap().screen().contents()
    }

    /// Calls a function with the screen.
    pub fn with_screen<T>(&self, use_screen: impl FnOnce(&vt100::Screen) -> T) -> T {
        use_screen(self.screen.lock().unwrap().screen())
    }

    /// Row of the screen.
    pub fn row(&self, index: usize) -> String {
        self.text()
            .lines()
            .nth(index)
            .unwrap_or_default()
            .to_string()
    }

    /// Waits until the text of the screen meets a condition.
    #[track_caller]
    pub fn wait_until(&self, what: &str, condition: impl Fn(&str) -> bool) {
        let started = Instant::now();
        loop {
            let text = self.text();
            if condition(&text) {
                return;
            }
            assert!(started.elapsed() < TIMEOUT, "timeout: {what}:\n{text}");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Waits for a text on the screen.
    #[track_caller]
    pub fn expect_text(&self, part: &str) {
        self.wait_until(&format!("text {part:?}"), |text| text.contains(part));
    }

    /// Waits for a text in the first row.
    #[track_caller]
    pub fn expect_state(&self, word: &str) {
        let word = format!(" {word} ");
        self.wait_until(&format!("state {word:?}"), |text| {
            text.lines()
                .next()
                .is_some_and(|row| row.starts_with(&word))
        });
    }

    /// Changes the size.
    pub fn resize(&self, columns: u16, rows: u16) {
        self.screen
            .lock()
            .unwrap()
            .screen_mut()
            .set_size(cells(rows), cells(columns));
        tcsetwinsize(self.device(), size(columns, rows)).unwrap();
    }

    /// Returns true when line editing, echo and screen are as a shell left them.
    pub fn is_restored(&self) -> bool {
        let modes = tcgetattr(self.device()).unwrap().local_modes;
        modes.contains(LocalModes::ICANON | LocalModes::ECHO | LocalModes::ISIG)
            && self.with_screen(|screen| {
                !screen.alternate_screen() && !screen.hide_cursor() && !screen.bracketed_paste()
            })
    }

    /// Stops or resumes reading of the output; keys still pass.
    pub fn set_stuck(&self, stuck: bool) {
        self.stuck.store(stuck, Ordering::Relaxed);
    }

    /// Number in a column of the row that starts with a name; column 1 follows the name.
    pub fn number(&self, name: &str, column: usize) -> Option<f64> {
        let text = self.text();
        let row = text
            .lines()
            .find(|row| row.split_whitespace().next() == Some(name))?;
        row.split_whitespace().nth(column)?.parse().ok()
    }

    /// Closes the terminal.
    pub fn close(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        if let Some(reader) = self.reader.take() {
            reader.join().unwrap();
        }
        self.device = None;
    }

    /// Process id.
    pub fn process(&self) -> u32 {
        self.child.id()
    }

    /// Waits for the end of the program. Returns its exit code, -1 after a signal.
    #[track_caller]
    pub fn exit_code(&mut self) -> i32 {
        let started = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                // The last output has to arrive.
                std::thread::sleep(Duration::from_millis(60));
                return status.code().unwrap_or(-1);
            }
            assert!(
                started.elapsed() < TIMEOUT,
                "still running:\n{}",
                self.text()
            );
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        self.close();
    }
}
