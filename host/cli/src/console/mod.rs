//! `haptimill console`: full-screen operator interface.
//!
//! Three threads. The first owns the port and the application state (`app`), the second reads keys,
//! the third draws the screen. Key input never waits for the port or the screen; the port never
//! waits for the screen. Compiled with the feature `console` only.
//!
//! | file | contents |
//! | --- | --- |
//! | `keys.rs` | key table |
//! | `jogging.rs` | jog keys, jog timeout, key releases |
//! | `app.rs`, `events.rs` | application state and session; messages of the controller |
//! | `input.rs` | key input to commands |
//! | `jobs.rs` | part programs, steps, move to the home pose |
//! | `master.rs`, `master/input.rs` | haptic arm: force feedback, virtual fixture, position scale |
//! | `simulator.rs` | simulator in real time |
//! | `recording.rs` | telemetry to CSV |
//! | `view_model.rs`, `view/` | displayed values and their drawing |
//! | `watch.rs` | a screen without commands: `haptimill watch --screen` |
//! | `web.rs` | the same application state behind a page: `haptimill serve` |
//! | `terminal.rs` | set-up and restoration of the terminal |
//!
//! A key on a terminal is no emergency stop: the line, the computer or the terminal may be slow or
//! fail. Callers must provide an emergency stop of the machine itself.

mod app;
mod events;
mod input;
mod jobs;
pub mod jogging;
pub mod keys;
mod listing;
mod master;
mod master_input;
mod picker;
mod recording;
mod terminal;
mod view;
mod view_build;
mod view_model;
pub(crate) mod watch;
pub mod web;

use crate::commands::console::ConsoleArgs;
use crate::commands::exit::{CliError, Exit};
use crate::commands::real_time_sim::RealTimeSim;
use crate::commands::requests::Requests;
use app::{App, Settings};
use haptimill_client::client::Options;
use haptimill_client::port::PortSpec;
use haptimill_client::session::{Line, PortLine};
use haptimill_machine_file::model::Model;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{self, Receiver};
use std::time::{Duration, Instant};
use terminal::Renderer;
use view_model::Severity;

/// Period of view model updates.
const VIEW_INTERVAL: Duration = Duration::from_millis(33);

/// Period of terminal checks.
const CHECK_INTERVAL: Duration = Duration::from_millis(100);

/// Why the console ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Ending {
    /// The operator quits.
    Quit,
    /// A signal: the terminal was closed, or the system ends the process.
    Signal,
    /// The terminal hung up.
    TerminalLost,
}

/// Runs the console.
///
/// # Errors
/// See [`Exit`].
pub fn run(args: ConsoleArgs) -> Result<(), CliError> {
    let mut app = open_app(args, true)?;
    let signals = count_signals();
    terminal::take_over(&|| signals.load(Ordering::SeqCst) > 0)?;
    let (sender, events) = mpsc::channel();
    terminal::spawn_reader(sender);
    let renderer = Renderer::spawn();
    let outcome = operate(&mut app, &events, &renderer, &signals);
    // The machine stops before the terminal is restored.
    let at_standstill = app.shut_down();
    renderer.show(app.view_model());
    if !renderer.end() {
        std::process::exit(i32::from(match outcome {
            Ok(Ending::Quit) => Exit::Done,
            Ok(_) => Exit::Stopped,
            Err(error) => error.exit,
        } as u8));
    }
    terminal::restore();
    report_ending(outcome?, at_standstill, &app)
}

/// The application state with the line of the arguments, which is not open yet.
fn open_app(args: ConsoleArgs, needs_terminal: bool) -> Result<App, CliError> {
    check_arguments(&args)?;
    let chosen = args.machine.load()?;
    let machine = Arc::new(chosen.file.clone());
    if let Some(program) = &args.program {
        // Program errors are reported before the screen is taken over. The check starts at the home
        // pose, since no other pose is known yet.
        let model = Model::new(&machine);
        if let Some(home) = model.home(&machine) {
            jobs::check(program, &machine, &model, &home)?;
        }
    }
    let stock = args.stock.load(&machine)?;
    let operator = args.operator.load(&machine)?;
    if needs_terminal {
        terminal::require_terminal("console", "`haptimill status`, `jog`, `run` with --json")?;
    }
    let baud = args.port.baud_or_default();
    let mut options = Options {
        connect_us: (args.timeout * 1e6) as u64,
        ..Options::default()
    };
    if matches!(args.port.port, PortSpec::Serial(_)) {
        options.timing.line_rate = baud / 10;
    }
    let is_simulated = args.port.port == PortSpec::Simulator;
    let line: Box<dyn Line> = if is_simulated {
        let faults = args.simulator.fault;
        let seed = args.simulator.seed;
        Box::new(RealTimeSim::new(&machine, seed, faults, operator.as_ref())?)
    } else {
        Box::new(PortLine::closed(&args.port.port, baud))
    };
    let settings = Settings {
        jog_timeout_ms: args.jog_timeout,
        folder: args.out,
        program: args.program,
        stock,
    };
    let board = (!is_simulated).then_some(chosen);
    let requests = Requests::listen(&args.port.port);
    let mut app = App::new(machine, line, options, board, settings)?;
    match requests {
        Ok(requests) => app.requests_of_others = requests,
        Err(error) => app.notify(Severity::Warning, error),
    }
    Ok(app)
}

/// Refuses combinations of arguments that make no sense.
fn check_arguments(args: &ConsoleArgs) -> Result<(), CliError> {
    let simulated = args.port.port == PortSpec::Simulator;
    let message = if let PortSpec::Emulated(_) | PortSpec::EmulatedPins = args.port.port {
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
    Err(CliError::new(Exit::Usage, message))
}

/// Counts termination signals. The third one ends the process at once; the machine then stops by
/// its heartbeat.
fn count_signals() -> Arc<AtomicU32> {
    let count = Arc::new(AtomicU32::new(0));
    let counter = Arc::clone(&count);
    let handler = move || {
        if counter.fetch_add(1, Ordering::SeqCst) >= 2 {
            terminal::restore();
            std::process::exit(i32::from(Exit::Stopped as u8));
        }
    };
    // Without a handler the system ends the process: the machine stops by its heartbeat, and the
    // shell restores its terminal.
    let _ = ctrlc::set_handler(handler);
    count
}

/// Main loop: keys, then the port, then the view model.
fn operate(
    app: &mut App,
    events: &Receiver<Option<ratatui::crossterm::event::Event>>,
    renderer: &Renderer,
    signals: &AtomicU32,
) -> Result<Ending, CliError> {
    let (mut next_view, mut next_check) = (Instant::now(), Instant::now());
    loop {
        loop {
            match events.try_recv() {
                Ok(Some(event)) => app.handle_input(&event),
                Ok(None) | Err(mpsc::TryRecvError::Disconnected) => {
                    return Ok(Ending::TerminalLost);
                }
                Err(mpsc::TryRecvError::Empty) => break,
            }
        }
        if app.quitting {
            return Ok(Ending::Quit);
        }
        if signals.load(Ordering::SeqCst) > 0 {
            return Ok(Ending::Signal);
        }
        app.update()?;
        let now = Instant::now();
        if now >= next_view {
            next_view = now + VIEW_INTERVAL;
            renderer.show(app.view_model());
        }
        if now >= next_check {
            next_check = now + CHECK_INTERVAL;
            if renderer.has_ended() || terminal::is_hung_up() {
                return Ok(Ending::TerminalLost);
            }
        }
    }
}

/// Reports the ending on the restored terminal.
fn report_ending(end: Ending, at_standstill: bool, app: &App) -> Result<(), CliError> {
    let state = match app.telemetry.as_ref().map(|telemetry| telemetry.state) {
        Some(state) if at_standstill => format!("the machine is {state}"),
        _ => format!(
            "no standstill was reported; \
             the machine stops {} ms after the last message of the host",
            app.machine.config.supervision.heartbeat_ms
        ),
    };
    match end {
        Ending::Quit => {
            use std::io::Write as _;
            let _ = writeln!(std::io::stdout(), "console quit; {state}");
            Ok(())
        }
        Ending::Signal => Err(CliError::new(
            Exit::Stopped,
            format!("console ended by a signal; {state}"),
        )),
        Ending::TerminalLost => Err(CliError::new(
            Exit::Stopped,
            format!("the terminal is closed; {state}"),
        )),
    }
}
