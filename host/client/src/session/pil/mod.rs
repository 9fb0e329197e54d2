//! Processor in the loop: the controller on an emulated chip.
//!
//! The image exchanges the I/O of the plant over two named pipes in a folder of its own, and its
//! serial line is a socket there. All three are unlinked as soon as both ends are open, so no file
//! remains however this process ends; the image ends the emulator when the other end of its pipes
//! is closed. The emulator has a process group of its own: Ctrl-C is delivered to this process,
//! which stops the machine along its path.
//!
//! An emulator that was killed is detected at the next exchange, one that stalls after [`STALL`].

mod image;
mod instructions;

pub use image::{image, image_for, other_image};
pub use instructions::{INSTRUCTIONS_FILE, INSTRUCTIONS_PER_COUNT, Instructions, budget, counts};

use crate::port::Board;
use crate::{Error, ErrorKind};
use haptimill_firmware::pil::{FROM_BOARD_BYTES, TO_BOARD_BYTES};
use haptimill_hil_sim::remote::PlantLink;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

/// Program of the emulator.
const EMULATOR: &str = "qemu-system-arm";

/// Longest wait for the emulator to start.
const START: Duration = Duration::from_secs(10);

/// Longest wait for an answer of the image.
pub const STALL: Duration = Duration::from_millis(1500);

/// A running emulator with an image.
#[derive(Debug)]
pub struct Emulator {
    child: Child,
    folder: Folder,
    to_board: File,
    from_board: File,
    serial: UnixStream,
}

/// Options of an emulator.
#[derive(Debug, Clone, Default)]
pub struct EmulatorOptions {
    /// Arguments of the image.
    pub arguments: Vec<String>,
    /// File for the log line of the board; without it the log is dropped.
    pub log: Option<PathBuf>,
}

impl EmulatorOptions {
    /// The option that enables semihosting, with the command line of the image.
    fn semihosting(&self) -> String {
        let mut option = "enable=on,target=native,arg=image".to_string();
        for argument in &self.arguments {
            option += ",arg=";
            // A doubled comma is a literal one.
            option += &argument.replace(',', ",,");
        }
        option
    }
}

/// Pins this thread, and the emulator that it starts, to one processor: they alternate, and a
/// switch on one processor is four times faster than a switch between two.
fn share_processor() {
    #[cfg(target_os = "linux")]
    {
        let mut one = rustix::thread::CpuSet::new();
        one.set(rustix::thread::sched_getcpu());
        // Without the permission the run only takes longer.
        let _ = rustix::thread::sched_setaffinity(None, &one);
    }
}

/// A folder that is removed when it is dropped.
#[derive(Debug)]
struct Folder(PathBuf);

impl Folder {
    fn new() -> io::Result<Self> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("haptimill-{}-{number}", std::process::id()));
        // A folder of this name belongs to a process that has ended.
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir(&path)?;
        Ok(Self(path))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // It may be removed already.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Ends the emulator unless it is taken out.
struct Starting(Option<Child>);

impl Drop for Starting {
    fn drop(&mut self) {
        if let Some(child) = &mut self.0 {
            end(child);
        }
    }
}

/// Kills a process and waits for its end.
fn end(child: &mut Child) {
    // Fails when it has ended already.
    let _ = child.kill();
    let _ = child.wait();
}

impl Emulator {
    /// Starts the emulator with an image.
    ///
    /// # Errors
    /// The emulator is not installed, or the image does not start.
    pub fn start(board: Board, image: &Path) -> Result<Self, Error> {
        Self::start_with(board, image, &EmulatorOptions::default())
    }

    /// Starts the emulator with an image, with arguments or a log.
    ///
    /// # Errors
    /// As [`Emulator::start`]; the log cannot be written.
    pub fn start_with(board: Board, image: &Path, setup: &EmulatorOptions) -> Result<Self, Error> {
        let failed = |error: io::Error| Error::new(ErrorKind::Port, format!("{board}: {error}"));
        let image = image.canonicalize().map_err(|error| {
            Error::new(
                ErrorKind::BadInput,
                format!("{}: cannot be read: {error}", image.display()),
            )
        })?;
        let folder = Folder::new().map_err(failed)?;
        let pipes = ["to-board", "from-board"].map(|name| folder.0.join(name));
        let made = Command::new("mkfifo")
            .args(&pipes)
            .status()
            .map_err(failed)?;
        if !made.success() {
            return Err(failed(io::Error::other("named pipes cannot be made")));
        }
        let listener = UnixListener::bind(folder.0.join("serial")).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        // Open before the emulator starts: its open call must not wait for this end.
        let nonblocking = rustix::fs::OFlags::NONBLOCK.bits() as i32;
        let from_board = OpenOptions::new()
            .read(true)
            .custom_flags(nonblocking)
            .open(&pipes[1])
            .map_err(failed)?;
        let console = File::create(folder.0.join("console")).map_err(failed)?;
        if let Some(log) = &setup.log {
            let target =
                std::path::absolute(log).and_then(|path| File::create(&path).map(|_| path));
            let target =
                target.and_then(|path| std::os::unix::fs::symlink(path, folder.0.join("log")));
            target.map_err(|error| {
                Error::new(ErrorKind::Output, format!("{}: {error}", log.display()))
            })?;
        }
        share_processor();
        let child = Command::new(EMULATOR)
            .args([
                "-M",
                board.machine(),
                "-display",
                "none",
                "-monitor",
                "none",
            ])
            .args([
                "-chardev",
                "socket,id=host,path=serial",
                "-serial",
                "chardev:host",
            ])
            // UART1 is not used, UART2 is the log line.
            .args(["-serial", "null", "-serial"])
            .arg(if setup.log.is_some() {
                "file:log"
            } else {
                "null"
            })
            .args(["-icount", "shift=10,sleep=off"])
            .args(["-semihosting-config", &setup.semihosting()])
            .arg("-kernel")
            .arg(&image)
            .current_dir(&folder.0)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(console)
            .process_group(0)
            .spawn();
        let child = child.map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => Error::new(
                ErrorKind::Port,
                format!("{board}: the emulator {EMULATOR} is not installed; on Debian: apt-get install {EMULATOR}"),
            ),
            _ => failed(error),
        })?;
        let mut starting = Starting(Some(child));
        let opened = || {
            OpenOptions::new()
                .write(true)
                .custom_flags(nonblocking)
                .open(&pipes[0])
        };
        let to_board = starting.wait(&folder, opened).map_err(failed)?;
        let serial = starting
            .wait(&folder, || listener.accept().map(|(stream, _)| stream))
            .map_err(failed)?;
        serial.set_nonblocking(false).map_err(failed)?;
        serial.set_read_timeout(Some(STALL)).map_err(failed)?;
        serial.set_write_timeout(Some(STALL)).map_err(failed)?;
        for name in ["to-board", "from-board", "serial"] {
            std::fs::remove_file(folder.0.join(name)).map_err(failed)?;
        }
        match starting.0.take() {
            Some(child) => Ok(Self {
                child,
                folder,
                to_board,
                from_board,
                serial,
            }),
            None => Err(failed(io::Error::other(
                "the connection to the emulator is lost",
            ))),
        }
    }

    /// The process number of the emulator, for tests that kill it.
    #[must_use]
    pub fn process(&self) -> u32 {
        self.child.id()
    }

    fn wait_readable(&self) -> io::Result<()> {
        let mut descriptors = [PollFd::new(&self.from_board, PollFlags::IN)];
        let timeout = Timespec {
            tv_sec: STALL.as_secs() as i64,
            tv_nsec: i64::from(STALL.subsec_nanos()),
        };
        match poll(&mut descriptors, Some(&timeout)) {
            Ok(0) => Err(io::Error::new(
                io::ErrorKind::TimedOut,
                format!(
                    "the emulator did not answer for {:.1} s",
                    STALL.as_secs_f64()
                ),
            )),
            Ok(_) | Err(rustix::io::Errno::INTR) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }
}

impl Starting {
    /// Repeats an attempt until it succeeds, the emulator ends, or time is up.
    fn wait<T>(
        &mut self,
        folder: &Folder,
        mut attempt: impl FnMut() -> io::Result<T>,
    ) -> io::Result<T> {
        let started_at = Instant::now();
        loop {
            let error = match attempt() {
                Ok(done) => return Ok(done),
                Err(error) => error,
            };
            if let Some(child) = &mut self.0
                && let Some(status) = child.try_wait()?
            {
                return Err(io::Error::other(format!(
                    "the emulator ended ({status}){}",
                    console(&folder.0)
                )));
            }
            if started_at.elapsed() > START {
                return Err(io::Error::new(
                    io::ErrorKind::TimedOut,
                    format!("the image does not start: {error}"),
                ));
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

/// The last output of the emulator and its image.
fn console(folder: &Path) -> String {
    let text = std::fs::read(folder.join("console")).unwrap_or_default();
    let text = String::from_utf8_lossy(&text);
    let text = text.trim();
    if text.is_empty() {
        String::new()
    } else {
        format!(": {text}")
    }
}

impl PlantLink for Emulator {
    fn send(&mut self, frame: &[u8; TO_BOARD_BYTES]) -> io::Result<()> {
        self.to_board.write_all(frame)
    }

    fn receive(&mut self, frame: &mut [u8; FROM_BOARD_BYTES]) -> io::Result<()> {
        let mut done = 0;
        while done < frame.len() {
            // The emulator runs on the processor of this thread: nothing can arrive before this
            // waits.
            self.wait_readable()?;
            match self.from_board.read(&mut frame[done..]) {
                Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
                Ok(count) => done += count,
                Err(error)
                    if matches!(
                        error.kind(),
                        io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted
                    ) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    fn put_serial(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.serial.write_all(bytes)
    }

    fn take_serial(&mut self, bytes: &mut [u8]) -> io::Result<()> {
        self.serial.read_exact(bytes)
    }

    fn last_words(&mut self) -> Option<String> {
        // Its pipes close shortly before its end.
        let started_at = Instant::now();
        while started_at.elapsed() < Duration::from_millis(300) {
            match self.child.try_wait() {
                Ok(Some(status)) => {
                    return Some(format!(
                        "the emulator ended ({status}){}",
                        console(&self.folder.0)
                    ));
                }
                Ok(None) => std::thread::sleep(Duration::from_millis(2)),
                Err(_) => break,
            }
        }
        None
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        // The image ends the emulator by itself; one that does not is killed.
        self.last_words();
        end(&mut self.child);
    }
}
