//! `haptimill serve`: the application state of the console behind a page.
//!
//! The page of `haptimill-web` gives commands in place of keys, and the view model becomes JSON.
//! The jog timeout of the keys holds for the buttons: the page repeats a press while its
//! button is held.

mod values;

use super::app::{App, OverrideKind};
use super::jogging::KeyPhase;
use super::keys::Action;
use super::view_model::{Axis, Confirm, LinkState, Overlay, Severity};
use crate::commands::console::ConsoleArgs;
use crate::commands::exit::{CliError, Exit};
use crate::commands::force::newtons;
use crate::commands::interrupt;
use crate::commands::preview::preview;
use crate::commands::program::{LanguageArgs, PartProgram};
use crate::commands::serve::ServeArgs;
use crate::commands::sim::token_of;
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::haptics::geometry::HapticGeometry;
use haptimill_hil_sim::machines::{GeometryConfig, Picture};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_protocol::message::{AxisValues, State};
use haptimill_web::{Config, OperatorCommand, Scaled, Server};
use serde_json::{Value, json};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{self, Receiver, TryRecvError};
use std::time::{Duration, Instant};
use values::{arm_links, changed_runs, columns, numbers, offsets, picture, rows, tip, tool_axis};

/// Time between two states.
const PUBLISH: Duration = Duration::from_millis(50);

/// Time between two looks at the stock, and points along its longer side.
const STOCK: Duration = Duration::from_millis(500);
const STOCK_POINTS: usize = 120;

/// Time between two looks at the work offsets.
const OFFSETS: Duration = Duration::from_secs(1);

/// Messages in a state.
const MESSAGES: usize = 30;

/// Name of a program, and its path as a scene, or why it has none.
type Path3d = (String, Result<String, CliError>);

/// What the page adds to the application state.
struct Web {
    server: Server,
    selected: Option<PathBuf>,
    planning: Option<Receiver<Path3d>>,
    /// Next look at the surface of the stock.
    stock_at: Instant,
    /// Heights that were published, and the length of the changes since the whole surface.
    heights: Vec<f32>,
    stock_parts: usize,
    /// Geometry of the simulated machine and of its haptic arm, which are drawn.
    geometry: Option<GeometryConfig>,
    arm: Option<HapticGeometry>,
    offsets: Value,
    offsets_at: Instant,
}

/// Serves the page.
///
/// # Errors
/// See [`Exit`].
pub fn run(args: ServeArgs) -> Result<(), CliError> {
    let (token, _) = token_of(args.token, args.listen.ip().is_loopback())?;
    let config = Config {
        listen: args.listen,
        token: token.map(|token| token.reveal().to_string()),
        programs: args.programs,
    };
    let mut app = super::open_app(
        ConsoleArgs {
            program: None,
            machine: args.machine,
            port: args.port,
            timeout: args.timeout,
            jog_timeout: args.jog_timeout,
            out: PathBuf::from("."),
            stock: args.stock,
            operator: args.operator,
            simulator: args.simulator,
        },
        false,
    )?;
    let interrupted = interrupt::flag();
    let server = Server::bind(config).map_err(|error| {
        let what = format!(
            "--listen {}: {error}; choose an address of this computer and a free port",
            args.listen
        );
        CliError::new(Exit::Port, what)
    })?;
    let mut out = std::io::stdout();
    writeln!(out, "{}", server.link())
        .and_then(|()| out.flush())
        .map_err(|error| CliError::new(Exit::Output, error))?;
    if args.listen.ip().is_unspecified() {
        eprintln!(
            "--listen {}: the page is on every address of this computer; where the printed address \
             is not reachable, use another address of this computer",
            args.listen
        );
    }
    let plant: Option<PlantConfig> = app.machine.plant().ok();
    let mut web = Web {
        server,
        selected: None,
        planning: None,
        stock_at: Instant::now(),
        heights: Vec::new(),
        stock_parts: 0,
        geometry: plant.as_ref().and_then(|plant| plant.geometry.clone()),
        arm: plant.and_then(|plant| plant.haptic).map(|arm| arm.geometry),
        offsets: Value::Null,
        offsets_at: Instant::now(),
    };
    let mut next = Instant::now();
    let outcome = loop {
        while let Some(command) = web.server.next_command() {
            web.execute(&mut app, command);
        }
        if interrupted.load(Ordering::Relaxed) {
            break Ok(());
        }
        if let Err(error) = app.update() {
            break Err(error);
        }
        web.advance(&mut app);
        web.show_stock(&mut app);
        if Instant::now() >= next {
            // The mean rate stays, also where a state was late.
            next = (next + PUBLISH).max(Instant::now());
            let offsets = web.offsets(&app);
            let mut state = web.state(&app);
            state["offsets"] = offsets;
            web.server.publish(state);
        }
    };
    let at_standstill = app.shut_down();
    outcome?;
    let what = if at_standstill {
        "stopped by the user; the machine is at standstill".to_string()
    } else {
        format!(
            "stopped by the user; no standstill was reported: the machine stops {} ms after the \
             last message of the host",
            app.machine.config.supervision.heartbeat_ms
        )
    };
    Err(CliError::new(Exit::Stopped, what))
}

impl Web {
    fn execute(&mut self, app: &mut App, command: OperatorCommand) {
        match command {
            OperatorCommand::Hold => app.execute(Action::Hold),
            OperatorCommand::Stop => app.execute(Action::Stop),
            OperatorCommand::EmergencyStop => app.execute(Action::Emergency),
            OperatorCommand::Enable => app.execute(Action::Enable),
            OperatorCommand::Disable => app.execute(Action::Disable),
            OperatorCommand::Reset => app.execute(Action::Reset),
            OperatorCommand::Resume => app.execute(Action::Resume),
            OperatorCommand::Home => app.execute(Action::Home),
            OperatorCommand::MoveOff => app.execute(Action::MoveOff),
            OperatorCommand::Run => match &self.selected {
                Some(path) => app.check_program(path.clone()),
                None => app.notify(Severity::Warning, "run: select a part program first"),
            },
            OperatorCommand::Answer { yes } => {
                match std::mem::replace(&mut app.overlay, Overlay::None) {
                    // Quitting is no matter of a page.
                    Overlay::Confirm(Confirm::Quit(_)) => {}
                    Overlay::Confirm(confirm) if yes => {
                        app.accept(confirm);
                        if matches!(app.overlay, Overlay::Confirm(Confirm::Run(..))) {
                            let what = "the answer came less than 0.4 s after the question: read \
                                        the question, then answer again";
                            app.notify(Severity::Warning, what);
                        }
                    }
                    _ => {}
                }
            }
            OperatorCommand::Override { of, percent } => {
                let (kind, name, range) = match of {
                    Scaled::Feed => (OverrideKind::Feed, "feed", 1..=200),
                    Scaled::Rapid => (OverrideKind::Rapid, "rapid", 1..=100),
                    Scaled::Spindle => (OverrideKind::Spindle, "spindle", 10..=200),
                };
                if !range.contains(&percent) {
                    let (low, high) = (range.start(), range.end());
                    let what =
                        format!("{name} override {percent} %: write {low} to {high} percent");
                    app.notify(Severity::Warning, what);
                } else if app.is_ready() {
                    app.set_override(kind, percent);
                } else {
                    let what = format!("{name} override: there is no link to the controller");
                    app.notify(Severity::Warning, what);
                }
            }
            OperatorCommand::JogRate { more } => app.jogging.select(more),
            OperatorCommand::Jog { coordinate, .. } if coordinate >= app.machine.pose.len() => {
                let what = format!(
                    "jog: there is no coordinate {coordinate}; the machine has {}, from 0 on",
                    app.machine.pose.len()
                );
                app.notify(Severity::Warning, what);
            }
            OperatorCommand::Jog {
                coordinate,
                up,
                repeat,
            } if app.overlay == Overlay::None => {
                let phase = match repeat {
                    true => KeyPhase::Repeat,
                    false => KeyPhase::Press,
                };
                app.jog_key(coordinate, up, phase);
            }
            OperatorCommand::Jog { .. } => {}
            OperatorCommand::JogEnd => app.jogging.release(),
            OperatorCommand::ControlEnded => {
                app.jogging.release();
                app.overlay = Overlay::None;
            }
            OperatorCommand::Zero { text } => {
                app.set_zero(&text);
                self.offsets_at = Instant::now();
                // The programmed path moves with the zero.
                if let Some(path) = self.selected.clone() {
                    self.select(app, path);
                }
            }
            OperatorCommand::Select(path) => self.select(app, path),
            OperatorCommand::Warn(what) => {
                eprintln!("{what}");
                let at = app.started.elapsed();
                app.log.add_repeated(at, Severity::Warning, what);
            }
        }
    }

    /// Selects a program, and plans its path in a thread.
    fn select(&mut self, app: &App, path: PathBuf) {
        let machine = Arc::clone(&app.machine);
        let here = app.standstill_pose().filter(|_| is_referenced(app));
        let start = here.or_else(|| app.model.home(&machine));
        let (sender, receiver) = mpsc::channel();
        let file = path.clone();
        std::thread::spawn(move || {
            let scene = plan(&file, &machine, start);
            let _ = sender.send((name_of(&file), scene));
        });
        self.planning = Some(receiver);
        self.selected = Some(path);
    }

    /// Publishes a path that is planned.
    fn advance(&mut self, app: &mut App) {
        let Some(planning) = &self.planning else {
            return;
        };
        match planning.try_recv() {
            Err(TryRecvError::Empty) => return,
            Err(TryRecvError::Disconnected) => {}
            Ok((name, Ok(scene))) => self.server.publish_scene(&name, &scene),
            Ok((name, Err(error))) => {
                self.server.publish_scene(&name, "null");
                // A file that is refused is not offered, as in the console.
                self.selected = None;
                if app.overlay == Overlay::None {
                    app.overlay = Overlay::Problems {
                        lines: error.message.lines().map(ToString::to_string).collect(),
                        from: 0,
                    };
                }
                app.notify(Severity::Warning, error.message);
            }
        }
        self.planning = None;
    }

    /// Publishes the surface of the stock, then its changes.
    fn show_stock(&mut self, app: &mut App) {
        if Instant::now() < self.stock_at {
            return;
        }
        self.stock_at = Instant::now() + STOCK;
        let Some(stock) = app.session.line_mut().stock() else {
            return;
        };
        let picture = stock.picture(STOCK_POINTS);
        if picture.heights.len() == self.heights.len() {
            let part = changed_runs(&self.heights, &picture.heights);
            if part.is_empty() {
                return;
            }
            self.stock_parts += part.len();
            // About the length of the whole surface: a viewer that comes later gets all parts.
            if self.stock_parts < 8 * picture.heights.len() {
                self.server
                    .publish_stock_part(&format!("\"runs\":[{part}]"));
                self.heights = picture.heights;
                return;
            }
        }
        let area = &picture.area;
        let members = format!(
            "\"x\":[{},{}],\"y\":[{},{}],\"columns\":{},\"rows\":{},\"heights\":[{}],\"depths\":[{}]",
            area.x_min,
            area.x_max,
            area.y_min,
            area.y_max,
            picture.columns,
            picture.rows,
            numbers(&picture.heights),
            numbers(&picture.depths)
        );
        self.server.publish_stock(&members);
        self.stock_parts = 0;
        self.heights = picture.heights;
    }

    /// The work offsets beside the machine file, read again once a second.
    fn offsets(&mut self, app: &App) -> Value {
        if Instant::now() >= self.offsets_at {
            self.offsets_at = Instant::now() + OFFSETS;
            self.offsets = offsets(&app.machine);
        }
        self.offsets.clone()
    }

    /// The machine from the simulated geometry of its file, once it is referenced; a haptic arm
    /// where the machine has no axes.
    fn picture(&self, app: &App) -> Option<Picture> {
        let now = app.telemetry.as_ref()?;
        match (&self.geometry, &self.arm) {
            (Some(geometry), _) if is_referenced(app) && !now.joints.is_empty() => picture(
                geometry,
                &app.model.joints_to_engineering_units(&now.joints),
            ),
            (None, Some(arm)) => {
                let report = app.session.client().master()?;
                let links = arm_links(arm, &report.pose);
                let tool_axis = [0.0, 0.0, 1.0];
                Some(Picture { links, tool_axis })
            }
            _ => None,
        }
    }

    fn state(&self, app: &App) -> Value {
        let view = app.view_model();
        let picture = self.picture(app);
        let telemetry = view.telemetry.as_ref();
        let state = telemetry.map(|now| now.state);
        let has_drives = !state.is_some_and(State::has_drives_off);
        let commanded = telemetry.map(|now| &now.commanded).filter(|_| has_drives);
        let measured = telemetry.map(|now| &now.measured);
        let pose = rows(
            &view,
            &view.static_info.pose,
            commanded,
            measured,
            &app.machine.pose,
        );
        let joints = telemetry.map(|now| &now.joints);
        let joints = rows(
            &view,
            &view.static_info.joints,
            None,
            joints,
            &app.machine.joints,
        );
        let messages = view.log.newest(MESSAGES).map(|entry| {
            json!({
                "s": entry.at.as_secs(),
                "level": entry.severity as u8,
                "text": entry.text,
                "times": entry.times,
            })
        });
        let program = view.program.as_ref().filter(|program| program.is_running);
        json!({
            "machine": view.machine,
            "port": view.static_info.port,
            "link": link_text(&view.link_state),
            "ready": view.link_state == LinkState::Ready,
            "age_ms": u64::try_from(view.age.as_millis()).unwrap_or(u64::MAX),
            "state": state.map(|state| state.to_string()),
            "fault": app.fault.as_ref().map(|fault| app.session.describe(fault)),
            "referenced": is_referenced(app),
            "pose": pose,
            "joints": joints,
            "tip": tip(&app.machine, measured.or(commanded)),
            "tip_axes": app.machine.config.model.descriptor().tool_tip_parts(),
            "links": picture.as_ref().map_or(&[][..], |picture| &picture.links),
            "feed_mm_min": view.motion.map(|motion| motion.feed_mm_min),
            "override": view.overrides[OverrideKind::Feed as usize],
            "overrides": view.overrides,
            "tool_axis": tool_axis(&app.machine, measured.or(commanded))
                .or(picture.as_ref().map(|picture| picture.tool_axis)),
            "force": telemetry.and_then(|now| now.force.as_ref()).map(|force| newtons(force.high)),
            "columns": columns(&view, &app.machine.io, app.session.line().truth()),
            "spindle_rpm": program.and_then(|program| program.spindle_rpm),
            "selected": self.selected.as_deref().map(name_of),
            "planning": self.planning.is_some(),
            "program": program.map(|program| json!({
                "name": program.name,
                "line": program.line,
                "left_s": program.left_s,
                "lines": program.lines,
                "text": program.text,
            })),
            "stopping": view.stopping,
            "jog": {"rate": view.jog.rate, "jog_timeout_ms": view.jog.jog_timeout_ms,
                    "held": view.jog.held.map(|held| held.map(|(up, _)| up))},
            "question": question(&view.overlay, &view.static_info.joints),
            "problems": problems(&view.overlay),
            "messages": messages.collect::<Vec<_>>(),
        })
    }
}

fn name_of(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

/// Whether the positions are those of the machine.
fn is_referenced(app: &App) -> bool {
    let telemetry = app.telemetry.as_ref();
    telemetry.is_some_and(|now| now.homed)
}

/// Plans the path of a program.
fn plan(file: &Path, machine: &MachineFile, start: Option<AxisValues>) -> Result<String, CliError> {
    let model = Model::new(machine);
    let program = PartProgram::load(file, LanguageArgs::default())?;
    let start = match start {
        Some(start) => start,
        None => haptimill_client::session::find_home_pose(machine, &model)?,
    };
    Ok(preview(&program, machine, &model, &start)?.scene().json())
}

fn link_text(state: &LinkState) -> String {
    match state {
        LinkState::Opening => "opening the port".to_string(),
        LinkState::Handshake => "waiting for the controller's answer".to_string(),
        LinkState::Configuring => "sending the machine file".to_string(),
        LinkState::Ready => String::new(),
        LinkState::Lost(reason) => format!("no link, reconnecting: {reason}"),
    }
}

fn question(overlay: &Overlay, joints: &[Axis]) -> Option<String> {
    let Overlay::Confirm(confirm) = overlay else {
        return None;
    };
    Some(match confirm {
        Confirm::Home => "Home the machine? It moves.".to_string(),
        Confirm::EnableAndHome => {
            "Switch the drives on and home the machine? It moves.".to_string()
        }
        Confirm::MoveOff(joint) => {
            let name = joints
                .get(*joint)
                .map_or("a joint", |joint| joint.name.as_str());
            format!("Move {name} off its limit switch? It moves slowly, then home the machine.")
        }
        Confirm::Run(what, notices) => [format!("Run {what}?")]
            .into_iter()
            .chain(notices.iter().cloned())
            .collect::<Vec<_>>()
            .join(" "),
        Confirm::Tare => "Tare the force sensor?".to_string(),
        Confirm::Quit(what) => what.clone(),
    })
}

fn problems(overlay: &Overlay) -> Option<&[String]> {
    match overlay {
        Overlay::Problems { lines, .. } => Some(lines),
        _ => None,
    }
}
