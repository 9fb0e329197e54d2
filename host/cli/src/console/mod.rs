//! `haptimill console`: one operator, one screen, one machine, whatever becomes of terminal and line.
//!
//! Three threads. This one owns the port and everything that is known (`desk`); one reads keys; one draws. Keys never wait for the port or for the screen, the
//! port never waits for the screen. Built with the feature `console` only.
//!
//! | file | |
//! | --- | --- |
//! | `keys.rs` | the one table of keys |
//! | `jogging.rs` | jog keys, the dead-man time, releases |
//! | `desk.rs`, `hearing.rs` | the session, and what the controller says |
//! | `orders.rs` | from keys to orders |
//! | `job.rs` | part programs, steps, the way home |
//! | `hand.rs`, `hand/orders.rs` | the hand on a haptic arm: reflection, virtual walls, scale |
//! | `connect.rs` | the port, lost and found; the simulator in real time |
//! | `recording.rs` | telemetry as CSV |
//! | `picture.rs`, `shown.rs`, `view/` | what is to be seen, and its drawing |
//! | `terminal.rs` | the terminal, taken and given back |
//!
//! Misuse: a key on a terminal is no emergency stop. The line, the computer and the terminal may each be slow or dead; the machine needs one of its own.

mod connect;
mod desk;
mod hand;
mod hearing;
mod job;
pub mod jogging;
pub mod keys;
mod orders;
mod picture;
mod recording;
mod shown;
mod terminal;
mod view;

use crate::commands::console::ConsoleArgs;
use crate::commands::{CliError, Exit};
use connect::Connection;
use desk::{Desk, Settings};
use haptimill_client::client::Options;
use haptimill_client::port::PortSpec;
use haptimill_machine_file::model::Model;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{self, Receiver};
use std::time::{Duration, Instant};
use terminal::Painter;

/// Time between two pictures that are made.
const PICTURE: Duration = Duration::from_millis(33);

/// Time between two looks at the terminal.
const LOOK: Duration = Duration::from_millis(100);

/// Why the console ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    /// The operator wants it.
    Wanted,
    /// A signal: the terminal was closed, or the system wants it.
    Signal,
    /// The terminal is gone.
    Gone,
}

/// Runs the console.
///
/// # Errors
/// See [`Exit`].
pub fn run(args: ConsoleArgs) -> Result<(), CliError> {
    check(&args)?;
    let chosen = args.machine.load()?;
    let machine = Arc::new(chosen.file.clone());
    if let Some(program) = &args.program {
        // Mistakes are told here, where they can be read at leisure; from the home pose, as long as no other is known.
        let model = Model::new(&machine);
        if let Some(home) = model.home(&machine) {
            job::check(program, &machine, &model, &home)?;
        }
    }
    terminal::check()?;
    let baud = args.port.baud_or_default();
    let mut options = Options {
        connect_us: (args.timeout * 1e6) as u64,
        ..Options::default()
    };
    if matches!(args.port.port, PortSpec::Serial(_)) {
        options.timing.line_rate = baud / 10;
    }
    let work = args.stock.load(&machine)?;
    let person = args.operator.load(&machine)?;
    let connection = Connection::new(
        &args.port.port,
        baud,
        &machine,
        args.simulator.seed,
        args.simulator.fault,
        person.as_ref(),
    )?;
    let settings = Settings {
        dead_man_ms: args.dead_man,
        folder: args.out,
        program: args.program,
        work,
        options,
        board: (args.port.port != PortSpec::Simulator).then_some(chosen),
    };
    let signals = signals();
    terminal::take(&|| signals.load(Ordering::SeqCst) > 0)?;
    let (sender, events) = mpsc::channel();
    terminal::listen(sender);
    let painter = Painter::begin();
    let mut desk = Desk::new(machine, connection, settings);
    let ended = operate(&mut desk, &events, &painter, &signals);
    // First the machine, then the screen.
    let rests = desk.leave();
    painter.show(desk.shown());
    if !painter.end() {
        std::process::exit(i32::from(match ended {
            Ok(End::Wanted) => Exit::Done,
            Ok(_) => Exit::Stopped,
            Err(error) => error.exit,
        } as u8));
    }
    terminal::restore();
    told(ended?, rests, &desk)
}

/// What cannot be meant is refused.
fn check(args: &ConsoleArgs) -> Result<(), CliError> {
    let simulated = args.port.port == PortSpec::Simulator;
    let what = if let PortSpec::Emulated(_) = args.port.port {
        format!(
            "{}: an emulated controller is slower than real time; use --port sim, or a machine",
            args.port.port
        )
    } else if !simulated && args.stock.stock.is_some() {
        "--stock is for the simulator in this process; clamp the stock on the table".to_string()
    } else if !simulated && (args.simulator.seed.is_some() || !args.simulator.fault.is_empty()) {
        "--seed and --fault are for the simulator in this process; give them to `haptimill sim serve`"
            .to_string()
    } else if !simulated && args.operator.operator.is_some() {
        "--operator is for the simulator in this process; give it to `haptimill sim serve`"
            .to_string()
    } else if args.port.baud.is_some() && !matches!(args.port.port, PortSpec::Serial(_)) {
        "--baud is for a serial port; leave it out".to_string()
    } else {
        return Ok(());
    };
    Err(CliError::new(Exit::Usage, what))
}

/// Counts the wishes of the system that this process ends. The third one ends it at once; the machine then stops by the silence.
fn signals() -> Arc<AtomicU32> {
    let count = Arc::new(AtomicU32::new(0));
    let seen = Arc::clone(&count);
    let handler = move || {
        if seen.fetch_add(1, Ordering::SeqCst) >= 2 {
            terminal::restore();
            std::process::exit(i32::from(Exit::Stopped as u8));
        }
    };
    // Without a handler the system ends the process: the machine stops by the silence, and the shell sees to its terminal.
    let _ = ctrlc::set_handler(handler);
    count
}

/// The loop: keys, then the port, then a picture.
fn operate(
    desk: &mut Desk,
    events: &Receiver<Option<ratatui::crossterm::event::Event>>,
    painter: &Painter,
    signals: &AtomicU32,
) -> Result<End, CliError> {
    let (mut next_picture, mut next_look) = (Instant::now(), Instant::now());
    loop {
        loop {
            match events.try_recv() {
                Ok(Some(event)) => desk.input(&event),
                Ok(None) | Err(mpsc::TryRecvError::Disconnected) => return Ok(End::Gone),
                Err(mpsc::TryRecvError::Empty) => break,
            }
        }
        if desk.leaving {
            return Ok(End::Wanted);
        }
        if signals.load(Ordering::SeqCst) > 0 {
            return Ok(End::Signal);
        }
        desk.step()?;
        let now = Instant::now();
        if now >= next_picture {
            next_picture = now + PICTURE;
            painter.show(desk.shown());
        }
        if now >= next_look {
            next_look = now + LOOK;
            if painter.ended() || terminal::hung_up() {
                return Ok(End::Gone);
            }
        }
    }
}

/// The last word, on a terminal that is the shell's again.
fn told(end: End, rests: bool, desk: &Desk) -> Result<(), CliError> {
    let state = match desk.telemetry.as_ref().map(|telemetry| telemetry.state) {
        Some(state) if rests => format!("the machine is {state}"),
        _ => format!(
            "the machine was not seen at rest; it stops by itself after {} ms without a host",
            desk.machine.config.supervision.heartbeat_ms
        ),
    };
    match end {
        End::Wanted => {
            use std::io::Write as _;
            let _ = writeln!(std::io::stdout(), "console left; {state}");
            Ok(())
        }
        End::Signal => Err(CliError::new(
            Exit::Stopped,
            format!("console ended by a signal; {state}"),
        )),
        End::Gone => Err(CliError::new(
            Exit::Stopped,
            format!("the terminal is gone; {state}"),
        )),
    }
}
