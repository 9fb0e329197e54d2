//! `haptimill flash`: writes an image into the flash of a board.

use super::args::seconds;
use super::{CliError, Exit};
use crate::commands::interrupt;
use clap::Args;
use haptimill_client::client::Options;
use haptimill_client::flash::program::{Program, SearchPath, Seen, Writer};
use haptimill_client::flash::{
    BOARDS, Board, BootRom, Chip, Drive, Found, Places, Writing, drive_in,
};
use haptimill_client::port::{self, PortSpec};
use haptimill_client::session::{self, PortLine, Session, check_period};
use haptimill_machine_file::MachineFile;
use haptimill_protocol::message::Welcome;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Arguments of `haptimill flash`.
#[derive(Debug, Clone, Args)]
#[command(
    about = "Write the image into the flash of a board",
    long_about = "Write the image into the flash of a board.

Waits for a board in boot mode, whose boot ROM appears as a drive, copies the image, and waits for \
the restart of the board. An image for stm32 is an ELF file: `probe-rs` writes it with an ST-LINK, \
or `dfu-util` over the USB of the chip, started with BOOT0 high; this was never tried with a real \
board. With --machine it first checks that the board can drive this machine: joints, step clock, \
rates, inputs, outputs, control period. It then opens a session on the USB port of the board, or \
at --port, which checks that the protocol of the board is that of this program. Nothing moves."
)]
pub struct FlashArgs {
    /// Board [default: pico2]
    #[arg(default_value = "pico2", value_parser = board, hide_default_value = true)]
    pub board: &'static Board,
    /// UF2 file; for stm32 an ELF file [default: the image built in the source tree]
    #[arg(long, value_name = "FILE")]
    pub image: Option<PathBuf>,
    /// Machine file that the board is to drive; a wrong one is refused before the image is written
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    /// Folder of the drive of the boot ROM [default: found by a search]
    #[arg(long, value_name = "FOLDER")]
    pub drive: Option<PathBuf>,
    /// Program that writes stm32: probe-rs or dfu-util [default: the first that sees a device]
    #[arg(long, value_name = "PROGRAM", value_parser = program, conflicts_with = "drive")]
    pub with: Option<Program>,
    /// Port at which the board must answer: a serial port by its path, or tcp:HOST:PORT [default:
    /// its USB port]
    #[arg(long, value_name = "PORT")]
    pub port: Option<PortSpec>,
    /// Baud rate of the serial port [default: that of the image]
    #[arg(long, value_name = "N", requires = "port",
          value_parser = clap::value_parser!(u32).range(1200..=12_000_000))]
    pub baud: Option<u32>,
    /// Longest wait for the drive or device, for the restart, and for the answer, each
    #[arg(long, value_name = "SECONDS", default_value_t = 30.0, value_parser = seconds)]
    pub wait: f64,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

fn board(name: &str) -> Result<&'static Board, String> {
    Board::named(name).ok_or_else(|| {
        let names: Vec<&str> = BOARDS.iter().map(|board| board.name).collect();
        format!("boards that can be flashed: {}", names.join(", "))
    })
}

fn program(name: &str) -> Result<Program, String> {
    Program::named(name).ok_or_else(|| {
        let names = Program::ALL.map(Program::name);
        format!("programs that write an image: {}", names.join(", "))
    })
}

/// Time between two looks for a drive, a device or a port.
const POLL: Duration = Duration::from_millis(200);

/// Writes an image.
///
/// # Errors
/// The image is wrong for the board, no board is in boot mode, the drive cannot be written, the
/// program that writes the image is missing or fails, or the board does not answer.
pub fn run(args: &FlashArgs) -> Result<(), CliError> {
    if let Some(port @ (PortSpec::Simulator | PortSpec::Emulated(_) | PortSpec::EmulatedPins)) =
        &args.port
    {
        let what = format!("--port {port}: a board has a serial port or a TCP port");
        return Err(CliError::new(Exit::Usage, what));
    }
    let board = args.board;
    let unfit = match &board.writing {
        Writing::Drive(_) if args.with.is_some() => "--with: the board needs no program",
        Writing::Program(_) if args.drive.is_some() => "--drive: the board has no drive",
        _ => "",
    };
    if !unfit.is_empty() {
        let what = format!("{unfit} ({}); leave it out", board.title);
        return Err(CliError::new(Exit::Usage, what));
    }
    let machine = match &args.machine {
        Some(path) => Some(MachineFile::load(path)?),
        None => None,
    };
    if let Some(machine) = &machine {
        board.check_machine(machine)?;
    }
    let path = match &args.image {
        Some(path) => path.clone(),
        None => board.find_image()?,
    };
    let image = board.read_image(&path)?;
    board.check_own(&image)?;
    if let Some(machine) = &machine {
        board.check_image(machine, &image)?;
    }
    let wait = Duration::from_secs_f64(args.wait);
    let say = |what: &str| {
        if !args.json {
            print_line!("{what}");
        }
    };
    let (mut drive, mut program) = (None, None);
    match &board.writing {
        Writing::Drive(boot_rom) => {
            let found = match &args.drive {
                Some(folder) => drive_in(folder)?,
                None => find(board, boot_rom, &Places::default(), wait)?,
            };
            found.check(board)?;
            let folder = found.folder.display().to_string();
            say(&format!(
                "{} to {folder}: {} bytes",
                path.display(),
                image.len()
            ));
            let name = path.file_name().and_then(|name| name.to_str());
            found.write(name.unwrap_or("image.uf2"), &image, wait)?;
            say("the board has restarted");
            drive = Some(folder);
        }
        Writing::Program(chip) => {
            let writer = find_program(args.with, chip, &SearchPath::of_environment(), wait)?;
            let name = writer.program.name();
            say(&format!("{} with {name}", path.display()));
            let scratch = tempfile::tempdir().map_err(|error| {
                CliError::new(Exit::Output, format!("temporary folder: {error}"))
            })?;
            writer.write(&path, &image, chip, scratch.path())?;
            say(match writer.program {
                Program::ProbeRs => "the image is in the flash, and the chip was reset",
                Program::DfuUtil => {
                    "the image is in the flash and was started; set BOOT0 low, for the next reset \
                     starts the boot ROM otherwise"
                }
            });
            program = Some(name);
        }
    }
    let port = match &args.port {
        Some(port) => Some(port.clone()),
        None => find_port(board, wait)?,
    };
    let answer = match &port {
        Some(port) => Some(answer(board, port, args.baud, wait)?),
        None => None,
    };
    if let (Some(machine), Some(port), Some(welcome)) = (&machine, &port, &answer) {
        check_period(&port.to_string(), welcome, machine)?;
    }
    if args.json {
        let answer = answer.as_ref().map(|welcome| {
            serde_json::json!({
                "protocol": welcome.version,
                "period_us": welcome.period_us,
                "machine": welcome.machine.as_str(),
            })
        });
        print_line!(
            "{:#}",
            serde_json::json!({
                "board": board.name,
                "image": path.display().to_string(),
                "bytes": image.len(),
                "drive": drive,
                "program": program,
                "port": port.as_ref().map(ToString::to_string),
                "answer": answer,
            })
        );
        return Ok(());
    }
    match (answer, &port) {
        (Some(welcome), Some(port)) => {
            let machine = match welcome.machine.as_str() {
                "" => "no configuration",
                name => name,
            };
            print_line!(
                "the board answers at {port}: protocol {}, control period {} us, {machine}",
                welcome.version,
                welcome.period_us
            );
        }
        _ => print_line!(
            "its answer was not checked, because it has no USB port here: its line to the host is \
             {}; `haptimill status --port PORT --baud {}`",
            board.line,
            board.baud
        ),
    }
    Ok(())
}

/// Looks again until `look` finds something. Prints once what is missing; after `wait` that is the
/// error.
fn wait_for<T>(
    wait: Duration,
    look: impl Fn() -> Result<Result<T, String>, CliError>,
) -> Result<T, CliError> {
    let end = Instant::now() + wait;
    let mut is_announced = false;
    loop {
        let missing = match look()? {
            Ok(found) => return Ok(found),
            Err(missing) => missing,
        };
        if Instant::now() >= end {
            return Err(CliError::new(Exit::Port, missing));
        }
        if !is_announced {
            eprintln!("{missing}");
            is_announced = true;
        }
        std::thread::sleep(POLL.min(end.saturating_duration_since(Instant::now())));
    }
}

/// Waits for the drive of a board in boot mode.
fn find(
    board: &Board,
    boot_rom: &BootRom,
    places: &Places,
    wait: Duration,
) -> Result<Drive, CliError> {
    wait_for(wait, || {
        Ok(Err(match places.find(boot_rom) {
            Found::Mounted(drive) => return Ok(Ok(drive)),
            Found::Several(folders) => {
                let folders: Vec<String> =
                    folders.iter().map(|it| it.display().to_string()).collect();
                let what = format!(
                    "several boards are in boot mode: {}; name one with --drive",
                    folders.join(", ")
                );
                return Err(CliError::new(Exit::Port, what));
            }
            Found::OtherChip(drive) => {
                drive.check(board)?;
                return Ok(Ok(drive));
            }
            Found::NotMounted(device) => format!(
                "the drive of the board is not mounted: `udisksctl mount -b {}`, or mount it and \
                 give its folder with --drive",
                device.display()
            ),
            Found::NoDrive => format!(
                "{} is in boot mode, but this computer shows no drive of it: mount it and give its \
                 folder with --drive",
                board.title
            ),
            Found::Nothing => format!("no {} is in boot mode: {}", board.title, boot_rom.start),
        }))
    })
}

/// Waits for a device that a program can write.
fn find_program(
    with: Option<Program>,
    chip: &Chip,
    path: &SearchPath,
    wait: Duration,
) -> Result<Writer, CliError> {
    wait_for(wait, || {
        Ok(match path.find(with, chip)? {
            Seen::Device(writer) => Ok(writer),
            Seen::Nothing(missing) => Err(missing),
        })
    })
}

/// Waits for the USB port of a board; none appears with an image for another line.
fn find_port(board: &Board, wait: Duration) -> Result<Option<PortSpec>, CliError> {
    if board.usb.is_none() {
        return Ok(None);
    }
    let end = Instant::now() + wait;
    loop {
        let ports = port::list_of(board)?;
        match &ports[..] {
            [one] => return Ok(Some(PortSpec::Serial(one.clone()))),
            [_, _, ..] => {
                let what = format!(
                    "the image was written; several boards are on the USB: {}; name one with --port",
                    ports.join(", ")
                );
                return Err(CliError::new(Exit::Port, what));
            }
            [] if Instant::now() >= end => return Ok(None),
            [] => std::thread::sleep(POLL.min(end.saturating_duration_since(Instant::now()))),
        }
    }
}

/// Waits for the port of a board, and opens a session.
fn answer(
    board: &Board,
    port: &PortSpec,
    baud: Option<u32>,
    wait: Duration,
) -> Result<Welcome, CliError> {
    let end = Instant::now() + wait;
    let baud = baud.unwrap_or(board.baud);
    let line = loop {
        match PortLine::opened(port, baud) {
            Ok(line) => break line,
            Err(error) if Instant::now() >= end => {
                let what = format!("the image was written, but {error}");
                return Err(CliError::new(Exit::Port, what));
            }
            Err(_) => std::thread::sleep(POLL),
        }
    };
    let left = end.saturating_duration_since(Instant::now());
    let options = Options {
        connect_us: left.max(POLL).as_micros() as u64,
        ..Options::default()
    };
    let machine = MachineFile::built_in()?;
    let mut session = Session::new(line, &machine, options, interrupt::flag());
    session.connect(session::fresh_number()).map_err(|error| {
        let what = format!(
            "the image was written, but {error}; its line is {}",
            board.line
        );
        CliError::new(error.kind.into(), what)
    })?;
    let welcome = session.client_mut().controller().cloned();
    welcome.ok_or_else(|| CliError::new(Exit::Internal, "no session"))
}
