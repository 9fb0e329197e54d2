//! `haptimill flash`: writes an image into the flash of a board in boot mode.

use super::args::seconds;
use super::{CliError, Exit};
use crate::commands::interrupt;
use clap::Args;
use haptimill_client::client::Options;
use haptimill_client::flash::{BOARDS, Board, Drive, Found, Places, drive_in};
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
the restart of the board. With --machine it first checks that the board can drive this machine: \
joints, step clock, rates, inputs, outputs, control period. It then opens a session on the USB port of the board, or at --port, which \
checks that the protocol of the board is that of this program. Nothing moves."
)]
pub struct FlashArgs {
    /// Board [default: pico2]
    #[arg(default_value = "pico2", value_parser = board, hide_default_value = true)]
    pub board: &'static Board,
    /// UF2 file [default: the image built in the source tree]
    #[arg(long, value_name = "FILE")]
    pub image: Option<PathBuf>,
    /// Machine file that the board is to drive; a wrong one is refused before the image is written
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    /// Folder of the drive of the boot ROM [default: found by a search]
    #[arg(long, value_name = "FOLDER")]
    pub drive: Option<PathBuf>,
    /// Port at which the board must answer: a serial port by its path, or tcp:HOST:PORT [default:
    /// its USB port]
    #[arg(long, value_name = "PORT")]
    pub port: Option<PortSpec>,
    /// Baud rate of the serial port [default: that of the image]
    #[arg(long, value_name = "N", requires = "port",
          value_parser = clap::value_parser!(u32).range(1200..=12_000_000))]
    pub baud: Option<u32>,
    /// Longest wait for the drive, for the restart, and for the answer, each
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

/// Time between two looks for a drive or a port.
const POLL: Duration = Duration::from_millis(200);

/// Writes an image.
///
/// # Errors
/// The image is wrong for the board, no board is in boot mode, the drive cannot be written, or the
/// board does not answer.
pub fn run(args: &FlashArgs) -> Result<(), CliError> {
    if let Some(port @ (PortSpec::Simulator | PortSpec::Emulated(_) | PortSpec::EmulatedPins)) =
        &args.port
    {
        let what = format!("--port {port}: a board has a serial port or a TCP port");
        return Err(CliError::new(Exit::Usage, what));
    }
    let board = args.board;
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
    let drive = match &args.drive {
        Some(folder) => drive_in(folder)?,
        None => find(board, &Places::default(), wait)?,
    };
    drive.check(board)?;
    let say = |what: &str| {
        if !args.json {
            print_line!("{what}");
        }
    };
    let folder = drive.folder.display();
    say(&format!(
        "{} to {folder}: {} bytes",
        path.display(),
        image.len()
    ));
    let name = path.file_name().and_then(|name| name.to_str());
    drive.write(name.unwrap_or("image.uf2"), &image, wait)?;
    say("the board has restarted");
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
                "drive": drive.folder.display().to_string(),
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

/// Waits for the drive of a board in boot mode.
fn find(board: &Board, places: &Places, wait: Duration) -> Result<Drive, CliError> {
    let end = Instant::now() + wait;
    let mut is_announced = false;
    loop {
        let found = places.find(board);
        let what = match found {
            Found::Mounted(drive) => return Ok(drive),
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
                return Ok(drive);
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
            Found::Nothing => format!("no {} is in boot mode: {}", board.title, board.boot_mode),
        };
        if Instant::now() >= end {
            return Err(CliError::new(Exit::Port, what));
        }
        if !is_announced {
            eprintln!("{what}");
            is_announced = true;
        }
        std::thread::sleep(POLL.min(end.saturating_duration_since(Instant::now())));
    }
}

/// Waits for the USB port of a board; none appears with an image for another line.
fn find_port(board: &Board, wait: Duration) -> Result<Option<PortSpec>, CliError> {
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
