//! The controller on an emulated chip: starts the emulator, talks to the image in it, and leaves nothing behind.
//!
//! The image reads and writes two named pipes in a folder of its own, and its serial line is a socket there. All three lose their names as soon as
//! both ends have them, so that nothing is left on the disk however this process ends; and the image ends the emulator when it finds the
//! other end of its pipes gone. The emulator has a process group of its own: Ctrl-C is for this process, which then stops the machine
//! along its path.
//!
//! An emulator that was killed is noticed at the next exchange, one that stands still after [`STALL`].

use crate::port::Board;
use crate::{Error, ErrorKind};
use haptimill_firmware::pil::{FROM_BOARD_BYTES, TO_BOARD_BYTES};
use haptimill_firmware::profiler::Stage;
use haptimill_hil_sim::remote::{Cost, PlantLink};
use haptimill_machine_file::MachineFile;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// The emulator.
const EMULATOR: &str = "qemu-system-arm";

/// Longest wait for the emulator to start.
const START: Duration = Duration::from_secs(10);

/// Longest wait for an answer of the image.
pub const STALL: Duration = Duration::from_millis(1500);

/// Instructions a count of the board's timer stands for: 25 MHz, and 1024 ns an instruction.
pub const INSTRUCTIONS_PER_COUNT: f64 = 40.0 / 1024.0;

/// Instructions in a control period of so many microseconds, on a chip of 168 MHz at one cycle an instruction.
#[must_use]
pub const fn budget(period_us: u16) -> u32 {
    period_us as u32 * 168
}

/// The counts of the board's timer that so many instructions take.
#[must_use]
pub fn counts(instructions: u32) -> u32 {
    (f64::from(instructions) / INSTRUCTIONS_PER_COUNT) as u32
}

/// Builds the image of a board where its sources are, and says where it is.
///
/// The variable `HAPTIMILL_IMAGE` names one that is already there.
///
/// # Errors
/// There are neither sources nor an image, or the build failed.
pub fn image(board: Board) -> Result<PathBuf, Error> {
    match std::env::var_os("HAPTIMILL_IMAGE") {
        Some(image) => Ok(PathBuf::from(image)),
        None => build(board, None),
    }
}

/// The same for a machine: one with a haptic arm needs an image that can lead it.
///
/// # Errors
/// There are neither sources nor an image, or the build failed.
pub fn image_for(board: Board, machine: &MachineFile) -> Result<PathBuf, Error> {
    match &machine.config.haptic {
        Some(_) if std::env::var_os("HAPTIMILL_IMAGE").is_none() => build(board, Some("hand")),
        _ => image(board),
    }
}

/// Builds another image of a board than the product's, such as the one that checks itself.
///
/// # Errors
/// There are no sources, or the build failed.
pub fn other_image(board: Board, name: &str) -> Result<PathBuf, Error> {
    build(board, Some(name))
}

/// Every image is built once in a process.
fn build(board: Board, other: Option<&str>) -> Result<PathBuf, Error> {
    static BUILT: Mutex<BTreeMap<(&str, String), PathBuf>> = Mutex::new(BTreeMap::new());
    let mut built = BUILT.lock().unwrap_or_else(PoisonError::into_inner);
    let name = (board.name(), other.unwrap_or_default().to_string());
    if let Some(image) = built.get(&name) {
        return Ok(image.clone());
    }
    let image = build_anew(board, other)?;
    built.insert(name, image.clone());
    Ok(image)
}

fn build_anew(board: Board, other: Option<&str>) -> Result<PathBuf, Error> {
    let folder = board.folder();
    let here = std::env::current_dir().unwrap_or_default();
    let root = here
        .ancestors()
        .chain(Path::new(env!("CARGO_MANIFEST_DIR")).ancestors())
        .find(|root| root.join(folder).join("Cargo.toml").is_file());
    let Some(root) = root else {
        let what = format!(
            "the sources of the board ({folder}) are not here; run this in the source tree, or name an image in HAPTIMILL_IMAGE"
        );
        return Err(Error::new(ErrorKind::BadInput, what));
    };
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let built = Command::new(cargo)
        .args(["xtask", "board", board.name(), "--image"])
        .args(other)
        .current_dir(root)
        .stdin(Stdio::null())
        .stderr(Stdio::inherit())
        .output();
    match built {
        Ok(output) if output.status.success() => Ok(PathBuf::from(
            String::from_utf8_lossy(&output.stdout)
                .trim_end()
                .to_string(),
        )),
        Ok(output) => Err(Error::new(
            ErrorKind::BadInput,
            format!(
                "the image of {board} cannot be built ({}); `cargo xtask board {}` says more",
                output.status,
                board.name()
            ),
        )),
        Err(error) => Err(Error::new(
            ErrorKind::BadInput,
            format!("cargo cannot be started: {error}"),
        )),
    }
}

/// A running emulator with an image in it.
#[derive(Debug)]
pub struct Emulator {
    child: Child,
    folder: Folder,
    to_board: File,
    from_board: File,
    serial: UnixStream,
}

/// What an emulator is started with, besides its image.
#[derive(Debug, Clone, Default)]
pub struct Setup {
    /// Words for the image: its command line.
    pub words: Vec<String>,
    /// Where what comes over the board's log line goes; nowhere without it.
    pub log: Option<PathBuf>,
}

impl Setup {
    /// The option of the emulator: semihosting on, and the image's command line, which begins with a name.
    fn semihosting(&self) -> String {
        let mut option = "enable=on,target=native,arg=image".to_string();
        for word in &self.words {
            option += ",arg=";
            // A comma stands for itself when it is doubled.
            option += &word.replace(',', ",,");
        }
        option
    }
}

/// Keeps this thread, and the emulator that it starts, on one processor: they take turns, and a hand-over there is four times faster than one
/// to another processor.
fn share_processor() {
    #[cfg(target_os = "linux")]
    {
        let mut one = rustix::thread::CpuSet::new();
        one.set(rustix::thread::sched_getcpu());
        // Where it is not allowed, it only takes longer.
        let _ = rustix::thread::sched_setaffinity(None, &one);
    }
}

/// A folder that goes when it is dropped.
#[derive(Debug)]
struct Folder(PathBuf);

impl Folder {
    fn new() -> io::Result<Self> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("haptimill-{}-{number}", std::process::id()));
        // One of this name is of a process that is gone.
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir(&path)?;
        Ok(Self(path))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // It may be gone already.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Ends the emulator unless it is handed on.
struct Starting(Option<Child>);

impl Drop for Starting {
    fn drop(&mut self) {
        if let Some(child) = &mut self.0 {
            end(child);
        }
    }
}

/// Ends a process for good, and waits until it is gone.
fn end(child: &mut Child) {
    // Fails when it is gone already.
    let _ = child.kill();
    let _ = child.wait();
}

impl Emulator {
    /// Starts the emulator with an image.
    ///
    /// # Errors
    /// The emulator is not installed, or the image does not start.
    pub fn start(board: Board, image: &Path) -> Result<Self, Error> {
        Self::start_with(board, image, &Setup::default())
    }

    /// Starts the emulator with an image that is told something, or says something beside the links.
    ///
    /// # Errors
    /// As [`Emulator::start`]; or the log cannot be written.
    pub fn start_with(board: Board, image: &Path, setup: &Setup) -> Result<Self, Error> {
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
        // Open before the emulator is there: whoever opens its other end must not wait for this one.
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
            None => Err(failed(io::Error::other("the emulator was lost"))),
        }
    }

    /// The process of the emulator, for tests that end it.
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
                    "the emulator has stood still for {:.1} s",
                    STALL.as_secs_f64()
                ),
            )),
            Ok(_) | Err(rustix::io::Errno::INTR) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }
}

impl Starting {
    /// Tries until it works, the emulator has gone, or time is up.
    fn wait<T>(
        &mut self,
        folder: &Folder,
        mut attempt: impl FnMut() -> io::Result<T>,
    ) -> io::Result<T> {
        let begun = Instant::now();
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
            if begun.elapsed() > START {
                return Err(io::Error::new(
                    io::ErrorKind::TimedOut,
                    format!("the image does not start: {error}"),
                ));
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

/// What the emulator and the image in it said last.
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
            // Nothing is there before the emulator had its turn, on the processor of this thread: so waiting comes first.
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
        // Its pipes close a moment before it is gone.
        let begun = Instant::now();
        while begun.elapsed() < Duration::from_millis(300) {
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
        // The image ends by itself once it was told so; whatever has not ended a moment later is of no use.
        self.last_words();
        end(&mut self.child);
    }
}

/// What a run cost, in its folder.
pub const INSTRUCTIONS_FILE: &str = "instructions.json";

/// What a run cost, in instructions, for people and for the table in the documentation.
#[derive(Debug, Clone, serde::Serialize)]
pub struct Instructions {
    /// Control periods in which a program ran.
    pub periods: u64,
    /// Each stage: its name, mean and worst.
    pub stages: Vec<(&'static str, f64, f64)>,
    /// Mean of a whole period.
    pub mean: f64,
    /// Worst whole period in which a program ran.
    pub worst: f64,
    /// Worst whole period in any state.
    pub worst_of_all: f64,
    /// Bytes of stack used.
    pub stack_bytes: u32,
    /// Most bytes that waited in the receive ring.
    pub ring_peak: u32,
    /// Fewest setpoints that waited in the queue after it had been fullest, while more of them were to come; `None` if none were.
    pub queue_low: Option<u16>,
    /// Most setpoints that waited in the queue.
    pub queue_high: u16,
    /// Control periods that were missed because one before took more instructions than there are in a period.
    pub missed: u64,
}

impl Instructions {
    /// From the counts of the board.
    #[must_use]
    pub fn of(cost: &Cost) -> Self {
        let periods = cost.periods.max(1) as f64;
        let worst = |counts: u32| f64::from(counts) * INSTRUCTIONS_PER_COUNT;
        let mean = |counts: u64| counts as f64 / periods * INSTRUCTIONS_PER_COUNT;
        Self {
            periods: cost.periods,
            stages: Stage::ALL
                .into_iter()
                .zip(cost.sums.iter().zip(&cost.worst))
                .map(|(stage, (sum, most))| (stage.name(), mean(*sum), worst(*most)))
                .collect(),
            mean: mean(cost.sums.iter().sum()),
            worst: worst(cost.worst_period),
            worst_of_all: worst(cost.worst_of_all),
            stack_bytes: cost.stack_bytes,
            ring_peak: cost.ring_peak,
            queue_low: cost.queue_low,
            queue_high: cost.queue_high,
            missed: cost.missed,
        }
    }

    /// What a run cost that is over, also written into its folder.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn leave(cost: &Mutex<Cost>, dir: &Path) -> Result<Self, Error> {
        let path = dir.join(INSTRUCTIONS_FILE);
        let instructions = Self::of(&cost.lock().unwrap_or_else(PoisonError::into_inner));
        let json = serde_json::to_string_pretty(&instructions)
            .map_err(|error| Error::new(ErrorKind::Internal, error))?;
        std::fs::write(&path, json).map_err(|error| {
            Error::new(ErrorKind::Output, format!("{}: {error}", path.display()))
        })?;
        Ok(instructions)
    }
}
