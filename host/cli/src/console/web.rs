//! `haptimill serve`: the application state of the console behind a page.
//!
//! The page of `haptimill-web` gives orders in place of keys, and the view model becomes JSON. The
//! dead-man time of the jog keys holds for the buttons: the page repeats a press while its button
//! is held.

use super::app::{App, OverrideKind};
use super::jogging::KeyPhase;
use super::keys::Action;
use super::view_model::{Axis, Confirm, LinkState, Overlay, Severity, ViewModel};
use crate::commands::console::ConsoleArgs;
use crate::commands::exit::{CliError, Exit};
use crate::commands::force::newtons;
use crate::commands::interrupt;
use crate::commands::preview::preview;
use crate::commands::program::{LanguageArgs, PartProgram};
use crate::commands::serve::ServeArgs;
use crate::commands::sim::token_of;
use haptimill_firmware::config::AxisKind;
use haptimill_hil_sim::process::ToolPose;
use haptimill_kinematics::descriptor::Role;
use haptimill_machine_file::model::Model;
use haptimill_machine_file::scale::per_unit;
use haptimill_machine_file::{AxisLimits, MachineFile};
use haptimill_protocol::message::{AxisValues, FULL_PATH_RATE, State};
use haptimill_web::{Config, Order, Scaled, Server};
use serde_json::{Value, json};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{self, Receiver, TryRecvError};
use std::time::{Duration, Instant};

/// Time between two states.
const PUBLISH: Duration = Duration::from_millis(50);

/// Time between two looks at the stock, and points along its longer side.
const STOCK: Duration = Duration::from_millis(500);
const STOCK_POINTS: usize = 120;

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
    /// Heights that were published.
    heights: Vec<f32>,
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
            dead_man: args.dead_man,
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
    let mut web = Web {
        server,
        selected: None,
        planning: None,
        stock_at: Instant::now(),
        heights: Vec::new(),
    };
    let mut next = Instant::now();
    let outcome = loop {
        while let Some(order) = web.server.next_order() {
            web.execute(&mut app, order);
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
            web.server.publish(web.state(&app));
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
    fn execute(&mut self, app: &mut App, order: Order) {
        match order {
            Order::Hold => app.execute(Action::Hold),
            Order::Stop => app.execute(Action::Stop),
            Order::EmergencyStop => app.execute(Action::Emergency),
            Order::Enable => app.execute(Action::Enable),
            Order::Disable => app.execute(Action::Disable),
            Order::Reset => app.execute(Action::Reset),
            Order::Resume => app.execute(Action::Resume),
            Order::Home => app.execute(Action::Home),
            Order::Run => match &self.selected {
                Some(path) => app.check_program(&path.display().to_string()),
                None => app.notify(Severity::Warning, "run: select a part program first"),
            },
            Order::Answer { yes } => {
                match std::mem::replace(&mut app.overlay, Overlay::None) {
                    // Quitting is no matter of a page.
                    Overlay::Confirm(Confirm::Quit(_)) => {}
                    Overlay::Confirm(confirm) if yes => app.accept(confirm),
                    _ => {}
                }
            }
            Order::Override { of, percent } => {
                let (kind, name, range) = match of {
                    Scaled::Feed => (OverrideKind::Feed, "feed", 1..=200),
                    Scaled::Rapid => (OverrideKind::Rapid, "rapid", 1..=100),
                    Scaled::Spindle => (OverrideKind::Spindle, "spindle", 10..=200),
                };
                if app.is_ready() && range.contains(&percent) {
                    app.set_override(kind, percent);
                } else {
                    let (low, high) = (range.start(), range.end());
                    let what = format!("{name} override {percent} %: {low} to {high}, with a link");
                    app.notify(Severity::Warning, what);
                }
            }
            Order::JogRate { more } => app.jogging.select(more),
            Order::Jog { axis, up, repeat } if app.overlay == Overlay::None => {
                let phase = match repeat {
                    true => KeyPhase::Repeat,
                    false => KeyPhase::Press,
                };
                app.jog_key(axis, up, phase);
            }
            Order::Jog { .. } => {}
            Order::JogEnd => app.jogging.release(),
            Order::ControlEnded => {
                app.jogging.release();
                app.overlay = Overlay::None;
            }
            Order::Select(path) => self.select(app, path),
            Order::Warn(what) => {
                eprintln!("{what}");
                app.notify(Severity::Warning, what);
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
                app.notify(Severity::Warning, error.message);
            }
        }
        self.planning = None;
    }

    /// Publishes the surface of the stock when it has changed.
    fn show_stock(&mut self, app: &mut App) {
        if Instant::now() < self.stock_at {
            return;
        }
        self.stock_at = Instant::now() + STOCK;
        let Some(stock) = app.session.line_mut().stock() else {
            return;
        };
        let picture = stock.picture(STOCK_POINTS);
        if picture.heights == self.heights {
            return;
        }
        let area = &picture.area;
        let rounded = |value: &f32| (f64::from(*value) * 1e3).round() / 1e3;
        self.server.publish_stock(json!({
            "x": [area.x_min, area.x_max],
            "y": [area.y_min, area.y_max],
            "columns": picture.columns,
            "rows": picture.rows,
            "heights": picture.heights.iter().map(rounded).collect::<Vec<_>>(),
            "depths": picture.depths.iter().map(rounded).collect::<Vec<_>>(),
        }));
        self.heights = picture.heights;
    }

    fn state(&self, app: &App) -> Value {
        let view = app.view_model();
        let telemetry = view.telemetry.as_ref();
        let state = telemetry.map(|now| now.state);
        let has_drives = !matches!(state, Some(State::Disabled | State::EmergencyStop));
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
            "feed_mm_min": view.motion.map(|motion| motion.feed_mm_min),
            "override": view.overrides[OverrideKind::Feed as usize],
            "overrides": view.overrides,
            "tool_axis": tool_axis(&app.machine, measured.or(commanded)),
            "force": telemetry.and_then(|now| now.force.as_ref()).map(|force| newtons(force.high)),
            "columns": columns(&view),
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
            "jog": {"rate": view.jog.rate, "dead_man_ms": view.jog.dead_man_ms,
                    "held": view.jog.held.map(|held| held.map(|(up, _)| up))},
            "question": question(&view.overlay),
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
    telemetry.is_some_and(|now| now.homed && now.position_kept)
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

fn rows(
    view: &ViewModel,
    axes: &[Axis],
    commanded: Option<&AxisValues>,
    actual: Option<&AxisValues>,
    limits: &[AxisLimits],
) -> Vec<Value> {
    let rows = axes.iter().enumerate().map(|(index, axis)| {
        let limit = |value: f64| value.is_finite().then_some(value);
        let value = |values: Option<&AxisValues>| {
            let value = values?.get(index)?;
            Some(view.unwound(axis, *value) as f64 / per_unit(axis.kind))
        };
        json!({
            "name": axis.name,
            "unit": if axis.kind.is_rotary() { "deg" } else { "mm" },
            "commanded": value(commanded),
            "actual": value(actual),
            "low": limits.get(index).and_then(|it| limit(it.low)),
            "high": limits.get(index).and_then(|it| limit(it.high)),
        })
    });
    rows.collect()
}

/// Place of the tool tip, mm; none where the pose is not known.
fn tip(machine: &MachineFile, pose: Option<&AxisValues>) -> Option<[f64; 3]> {
    let pose = pose.filter(|pose| !pose.is_empty())?;
    let described = machine.config.model.descriptor().pose;
    Some(['X', 'Y', 'Z'].map(|letter| {
        let index = described.iter().position(|axis| axis.letter == letter);
        let value = index.and_then(|index| pose.get(index)).copied();
        f64::from(value.unwrap_or(0)) / per_unit(AxisKind::Linear)
    }))
}

/// Unit vector from the tip towards the spindle, in the workpiece; none for a machine with a rotary
/// coordinate whose role does not say how it turns the tool.
fn tool_axis(machine: &MachineFile, pose: Option<&AxisValues>) -> Option<[f64; 3]> {
    let pose = pose.filter(|pose| !pose.is_empty())?;
    let described = machine.config.model.descriptor().pose;
    let known = |role| matches!(role, Role::ToolTilt | Role::WorkpieceRotation);
    let mut turning = described.iter().zip(&machine.pose);
    if turning.any(|(axis, limits)| limits.kind.is_rotary() && !known(axis.role)) {
        return None;
    }
    let angle = |role| {
        let index = described.iter().position(|axis| axis.role == role);
        let value = index
            .and_then(|index| pose.get(index))
            .copied()
            .unwrap_or(0);
        f64::from(value) / per_unit(AxisKind::Rotary)
    };
    let tool = ToolPose::leaning(
        [0.0; 3],
        angle(Role::ToolTilt),
        angle(Role::WorkpieceRotation),
    );
    Some(tool.axis)
}

/// Further values that the page plots, by name.
fn columns(view: &ViewModel) -> Value {
    let mut columns = serde_json::Map::new();
    let Some(now) = &view.telemetry else {
        return Value::Null;
    };
    for (axis, error) in view.static_info.joints.iter().zip(&now.following_error) {
        let unit = if axis.kind.is_rotary() { "mdeg" } else { "um" };
        let value = f64::from(*error) / per_unit(axis.kind) * 1e3;
        columns.insert(
            format!("following error {}, {unit}", axis.name),
            json!(value),
        );
    }
    for (axis, drive) in view.static_info.joints.iter().zip(&now.drive) {
        columns.insert(format!("drive {}", axis.name), json!(drive));
    }
    let rate = f64::from(now.path_rate) / f64::from(FULL_PATH_RATE) * 100.0;
    columns.insert("path rate, %".to_string(), json!(rate));
    columns.insert(
        "program line".to_string(),
        json!(view.program.as_ref().map(|it| it.line)),
    );
    if let Some(io) = &now.io {
        columns.insert("inputs, bits".to_string(), json!(io.inputs));
        columns.insert("outputs, bits".to_string(), json!(io.outputs));
    }
    if let Some(force) = &now.force {
        let (high, low) = (newtons(force.high), newtons(force.low));
        for (axis, name) in ["x", "y", "z"].iter().enumerate() {
            columns.insert(format!("force {name}, N"), json!(high[axis]));
            columns.insert(format!("opposite force {name}, N"), json!(low[axis]));
            let displacement = f64::from(force.displacement[axis]) / f64::from(1 << 20);
            columns.insert(format!("displacement {name}, mm"), json!(displacement));
        }
    }
    Value::Object(columns)
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

fn question(overlay: &Overlay) -> Option<String> {
    let Overlay::Confirm(confirm) = overlay else {
        return None;
    };
    Some(match confirm {
        Confirm::Home => "Home the machine? It moves.".to_string(),
        Confirm::EnableAndHome => {
            "Switch the drives on and home the machine? It moves.".to_string()
        }
        Confirm::Run(what) => format!("Run {what}?"),
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
