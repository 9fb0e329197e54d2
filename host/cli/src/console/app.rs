//! The desk: everything between the keys and the controller. It waits for nobody.
//!
//! [`App::step`] is called again and again, at least every few milliseconds; it moves the line, the session and the jog on and never waits longer than a
//! line's own millisecond. Keys come in between through [`App::input`] (see `orders.rs`), what the controller says is taken in `hearing.rs`, and what is to be seen is made in `picture.rs`.
//!
//! After a lost link the desk opens the port and a session again by itself, and that is all that it does by itself: jogs, programs and homing end with
//! the session that they belong to. A stop that is asked for meanwhile goes out first when the line is back.

use super::connection::{Connection, Progress};
use super::jobs::Jobs;
use super::jogging::{JogCommand, Jogging};
use super::master::Master;
use super::recording::Recording;
use super::view_model::{Axis, Confirm, LinkState, Log, Overlay, Severity, StaticInfo};
use crate::commands::{CliError, Exit};
use haptimill_client::board::{Chosen, Decision};
use haptimill_client::client::{Client, ClientState, Options, Ticket};
use haptimill_client::port::PortError;
use haptimill_client::session::fresh_number;
use haptimill_firmware::config::Drive;
use haptimill_hil_sim::process::CuttingConfig;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_machine_file::scale::per_unit;
use haptimill_protocol::force::ForceLoop;
use haptimill_protocol::haptic::ForceFeedback;
use haptimill_protocol::message::{
    AxisValues, Command, Fault, MAX_AXES, RATE_SHIFT, Source, State, Telemetry,
};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Time between two telemetry frames, ms; on a slow line they take a quarter of it at most.
const TELEMETRY_MS: u32 = 20;

/// Bytes of a telemetry frame, about.
const TELEMETRY_BYTES: u32 = 150;

/// How long a machine may take to come to rest when the console is left.
const SHUTDOWN: Duration = Duration::from_millis(2000);

/// Full scales of the force bars, N.
pub(super) const FORCE_SCALES: [f64; 5] = [5.0, 10.0, 20.0, 50.0, 100.0];

/// What is done when a request is answered with yes.
#[derive(Debug, Clone)]
pub(super) enum OnAck {
    Nothing,
    /// With what the controller had already, or had set since.
    Configured {
        already_active: bool,
    },
    Enabled,
    Override(u8),
    Source(u8, Source),
    Loop(u8, ForceLoop),
    ForceFeedback(ForceFeedback),
    Fixture {
        axis: usize,
        upper: bool,
        /// Put there, or taken away.
        is_set: bool,
        /// All are taken away together.
        all: bool,
    },
    PositionScale(u16),
    Say(&'static str),
}

/// Settings of a force loop that are wanted and not yet taken: the newest ones, one request at a time.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct RequestedLoop {
    pub(super) settings: Option<ForceLoop>,
    /// A request for these is under way.
    pub(super) asked: Option<ForceLoop>,
    /// Not before then: the controller still works the last change out.
    pub(super) not_before_us: u64,
}

impl RequestedLoop {
    /// The newest settings that were wanted and are not yet taken.
    pub(super) fn newest(&self) -> Option<ForceLoop> {
        self.settings.or(self.asked)
    }
}

/// A stop that cannot be said now, because there is no session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum PendingStop {
    None,
    Stop,
    Emergency,
}

/// Settings of a console.
pub(super) struct Settings {
    pub(super) dead_man_ms: u16,
    pub(super) folder: PathBuf,
    /// The program to begin with.
    pub(super) program: Option<PathBuf>,
    /// A work that is clamped on the simulated table after homing.
    pub(super) stock: Option<CuttingConfig>,
    pub(super) options: Options,
    /// How the configuration of a board behind a port is chosen.
    pub(super) board: Option<Chosen>,
}

/// See the module.
pub(super) struct App {
    pub(super) machine: Arc<MachineFile>,
    pub(super) model: Model,
    pub(super) settings: Settings,
    pub(super) client: Client,
    pub(super) connection: Connection,
    pub(super) static_info: Arc<StaticInfo>,
    pub(super) transmit: Vec<u8>,
    pub(super) received: Vec<u8>,
    /// Time of the line at the last exchange.
    pub(super) line_us: u64,
    pub(super) started: Instant,
    pub(super) link_state: LinkState,
    /// There was a session once: a port that fails now is tried again, not reported as a mistake of the command line.
    pub(super) connected_once: bool,
    pub(super) reconnects: u32,
    /// The board had the configuration of this console, or took it.
    configuration_checked: bool,
    /// The controller has the configuration of our machine file.
    pub(super) configured: bool,
    pub(super) asked: Vec<(Ticket, OnAck)>,
    pub(super) pending_stop: PendingStop,
    pub(super) telemetry: Option<Telemetry>,
    pub(super) telemetry_at: Instant,
    /// The period of the last change of state: what was reported before it is about another state.
    pub(super) state_period: u64,
    pub(super) log: Log,
    pub(super) overlay: Overlay,
    pub(super) sources: [Source; MAX_AXES],
    pub(super) feed_override: u8,
    /// The override that was asked for last.
    pub(super) requested_override: u8,
    pub(super) jogging: Jogging,
    pub(super) jobs: Jobs,
    pub(super) loops: Option<[ForceLoop; 3]>,
    pub(super) requested_loops: [RequestedLoop; 3],
    pub(super) force_scale: (usize, Instant),
    pub(super) master: Option<Master>,
    pub(super) recording: Option<Recording>,
    pub(super) stopping: Option<&'static str>,
    pub(super) fault: Option<Fault>,
    /// When the question that is open was asked.
    pub(super) opened_us: u64,
    /// The console is to end, when the machine is at rest.
    pub(super) quitting: bool,
}

impl App {
    pub(super) fn new(
        machine: Arc<MachineFile>,
        connection: Connection,
        settings: Settings,
    ) -> Self {
        let limits: Vec<f64> = machine.pose.iter().map(|axis| axis.rate).collect();
        let static_info = Arc::new(StaticInfo {
            port: connection.name(),
            pose: Axis::all(&machine.pose),
            joints: Axis::all(&machine.joints),
            period_s: f64::from(machine.config.period_us) * 1e-6,
            analogue: machine
                .config
                .joints
                .iter()
                .map(|joint| matches!(joint.drive, Drive::Torque { .. }))
                .collect(),
        });
        let loops = machine.config.force.as_ref().map(|force| {
            force
                .axes
                .each_ref()
                .map(haptimill_protocol::force::ForceLoop::from)
        });
        let now = Instant::now();
        Self {
            model: Model::new(&machine),
            jobs: Jobs::new(settings.program.clone()),
            client: Client::new(settings.options),
            jogging: Jogging::new(&limits, settings.dead_man_ms),
            settings,
            connection,
            static_info,
            transmit: Vec::new(),
            received: Vec::new(),
            line_us: 0,
            started: now,
            link_state: LinkState::Opening,
            connected_once: false,
            reconnects: 0,
            configuration_checked: false,
            configured: false,
            asked: Vec::new(),
            pending_stop: PendingStop::None,
            telemetry: None,
            telemetry_at: now,
            state_period: 0,
            log: Log::default(),
            overlay: Overlay::None,
            sources: [Source::Program; MAX_AXES],
            feed_override: 100,
            requested_override: 100,
            loops,
            requested_loops: [RequestedLoop::default(); 3],
            force_scale: (0, now),
            master: Master::of(&machine),
            recording: None,
            stopping: None,
            fault: None,
            opened_us: 0,
            quitting: false,
            machine,
        }
    }

    /// Microseconds since the console began.
    pub(super) fn now_us(&self) -> u64 {
        u64::try_from(self.started.elapsed().as_micros()).unwrap_or(u64::MAX)
    }

    pub(super) fn notify(&mut self, severity: Severity, text: impl Into<String>) {
        self.log.add(self.started.elapsed(), severity, text);
    }

    pub(super) fn is_ready(&self) -> bool {
        self.link_state == LinkState::Ready
    }

    /// The state, if it is known now.
    pub(super) fn state(&self) -> Option<State> {
        let telemetry = self.telemetry.as_ref().filter(|_| self.is_ready())?;
        Some(telemetry.state)
    }

    /// Something moves, or may.
    pub(super) fn is_moving(&self) -> bool {
        matches!(
            self.telemetry.as_ref().map(|telemetry| telemetry.state),
            Some(State::Run | State::Jog | State::Homing | State::Hold)
        )
    }

    /// The wanted pose of a machine that stands idle, to the last bit.
    pub(super) fn standstill_pose(&self) -> Option<AxisValues> {
        let telemetry = self.telemetry.as_ref().filter(|_| self.is_ready())?;
        let known = telemetry.state == State::Idle && telemetry.period >= self.state_period;
        known.then(|| telemetry.commanded.clone())
    }

    /// Asks the controller, and remembers what follows.
    pub(super) fn request(&mut self, command: Command, on_ack: OnAck) {
        let ticket = self.client.request(command);
        self.asked.push((ticket, on_ack));
    }

    /// Moves everything on.
    ///
    /// # Errors
    /// There never was a controller: the port, or the session.
    pub(super) fn update(&mut self) -> Result<(), CliError> {
        match self.connection.advance() {
            Progress::Nothing => {}
            Progress::Line => self.send_hello(),
            Progress::Failed(error) => self.handle_port_error(&error)?,
        }
        if self.link_state == LinkState::Opening && self.connection.line().is_some() {
            // The simulator in this process is there from the start.
            self.send_hello();
        }
        self.send_jog();
        self.send_force_loops();
        let Some(line) = self.connection.line() else {
            std::thread::sleep(Duration::from_millis(2));
            return Ok(());
        };
        // What was ordered goes out with this exchange, not with the next one.
        self.client.advance(self.line_us, &[], &mut self.transmit);
        self.received.clear();
        match line.exchange(&self.transmit, &mut self.received) {
            Ok(now_us) => {
                self.transmit.clear();
                self.line_us = now_us;
                self.client
                    .advance(now_us, &self.received, &mut self.transmit);
            }
            Err(error) => return self.handle_port_error(&error),
        }
        while let Some(notice) = self.client.poll() {
            self.handle_notice(notice)?;
        }
        self.update_arm();
        self.advance_jobs();
        Ok(())
    }

    /// Begins a session on a line that was opened.
    fn send_hello(&mut self) {
        self.client = Client::new(self.settings.options);
        self.transmit.clear();
        self.asked.clear();
        self.line_us = 0;
        self.client.connect(fresh_number(), 0);
        if self.pending_stop != PendingStop::None {
            // Needs no session: the bytes go before the greeting.
            self.client.urgent_stop();
        }
        self.link_state = LinkState::Handshake;
    }

    fn handle_port_error(&mut self, error: &PortError) -> Result<(), CliError> {
        if !self.connected_once {
            return Err(CliError::new(Exit::Port, error));
        }
        self.handle_link_loss(&error.to_string());
        Ok(())
    }

    /// The link is gone: nothing that belonged to it goes on.
    pub(super) fn handle_link_loss(&mut self, why: &str) {
        if self.link_state == LinkState::Ready || self.link_state == LinkState::Configuring {
            let ms = self.machine.config.supervision.heartbeat_ms;
            self.notify(
                Severity::Alarm,
                format!("link lost: {why}. What moves stops by itself after {ms} ms of silence"),
            );
        }
        let now_us = self.now_us();
        self.jogging.release_all(now_us);
        self.jobs.clear();
        self.sources = [Source::Program; MAX_AXES];
        (self.feed_override, self.requested_override) = (100, 100);
        self.requested_loops = [RequestedLoop::default(); 3];
        if let Some(master) = &mut self.master {
            master.handle_link_loss();
        }
        self.configured = false;
        self.stopping = None;
        self.link_state = LinkState::Lost(why.to_string());
        self.connection.drop_line();
    }

    /// A session is open.
    ///
    /// # Errors
    /// The board is configured as another machine, or not at all.
    pub(super) fn begin(&mut self) -> Result<(), CliError> {
        if self.connected_once {
            self.reconnects += 1;
            self.notify(
                Severity::Info,
                "connected again; nothing moves until it is asked to",
            );
        }
        self.connected_once = true;
        self.connection.reset_backoff();
        self.link_state = LinkState::Configuring;
        match std::mem::replace(&mut self.pending_stop, PendingStop::None) {
            PendingStop::None => {}
            PendingStop::Stop => self.stopping = Some("stop"),
            PendingStop::Emergency => {
                self.request(Command::EmergencyStop, OnAck::Nothing);
                self.stopping = Some("emergency stop");
            }
        }
        self.check_configuration()?;
        let quarter_ms = (4 * TELEMETRY_BYTES * 1000)
            .checked_div(self.settings.options.timing.line_rate)
            .unwrap_or(0);
        let period_us = self
            .client
            .controller()
            .map_or(200, |welcome| u32::from(welcome.period_us))
            .max(1);
        let every = TELEMETRY_MS.max(quarter_ms) * 1000 / period_us;
        let every = every.clamp(1, u32::from(u16::MAX)) as u16;
        self.request(Command::Telemetry { every }, OnAck::Nothing);
        self.request(Command::Status, OnAck::Nothing);
        Ok(())
    }

    /// Sees to it that board and console go by the same machine file.
    fn check_configuration(&mut self) -> Result<(), CliError> {
        if let (Some(board), Some(welcome)) = (&self.settings.board, self.client.controller()) {
            match board.decide(welcome)? {
                // A board that lost its power takes the configuration that it had in this console.
                _ if self.configuration_checked && welcome.config_crc == 0 => {}
                Decision::Active(file) => {
                    // The built-in haptic arm is known too, and is no machine to operate.
                    if self.machine.is_master() != file.is_master() {
                        let what = format!(
                            "{}: the board is configured as \"{}\"; give its machine file with --machine FILE",
                            self.connection.name(),
                            welcome.machine
                        );
                        return Err(CliError::new(Exit::Command, what));
                    }
                    self.configuration_checked = true;
                    self.request(
                        Command::Ping,
                        OnAck::Configured {
                            already_active: true,
                        },
                    );
                    return Ok(());
                }
                Decision::Send(what) => self.notify(Severity::Info, what),
                Decision::Unknown(what) => {
                    let what = format!("{}: {what}", self.connection.name());
                    return Err(CliError::new(Exit::Command, what));
                }
            }
            self.configuration_checked = true;
        }
        self.send_configuration();
        Ok(())
    }

    /// Makes our machine file the active configuration, unless it is.
    pub(super) fn send_configuration(&mut self) {
        match self.machine.encoded() {
            Ok((bytes, crc)) => {
                let already_active = self
                    .client
                    .controller()
                    .is_some_and(|welcome| welcome.config_crc == crc);
                let ticket = self.client.configure(&bytes, false);
                self.asked
                    .push((ticket, OnAck::Configured { already_active }));
            }
            Err(error) => self.notify(Severity::Alarm, format!("defect: {error}")),
        }
    }

    /// Tells the controller what the jog keys ask for.
    fn send_jog(&mut self) {
        let now_us = self.now_us();
        match self.jogging.command(now_us) {
            JogCommand::None => {}
            JogCommand::Cancel => {
                self.client.cancel_jog();
            }
            JogCommand::Move { rates, deadline_ms } if self.is_ready() => {
                let rates = rates
                    .iter()
                    .zip(&self.static_info.pose)
                    .map(|(rate, axis)| {
                        (rate * per_unit(axis.kind) / f64::from(1 << RATE_SHIFT)).round() as i32
                    })
                    .collect();
                // Without a session there is nothing to be kept moving.
                let _ = self.client.jog(rates, deadline_ms);
            }
            JogCommand::Move { .. } => {}
        }
    }

    /// Brings the machine to rest before the console is left, as far as it can be reached, and says whether it is known to be.
    pub(super) fn shut_down(&mut self) -> bool {
        let now_us = self.now_us();
        self.jogging.release_all(now_us);
        let until = Instant::now() + SHUTDOWN;
        if self.is_moving() && *self.client.state() == ClientState::Ready {
            self.client.urgent_stop();
            self.stopping = Some("stop");
        }
        while self.stopping.is_some() && self.is_ready() && Instant::now() < until {
            if self.update().is_err() {
                return false;
            }
        }
        // Closes the file.
        self.recording = None;
        !self.is_moving() && self.is_ready()
    }

    /// Opens a question.
    pub(super) fn confirm(&mut self, confirm: Confirm) {
        let now_us = self.now_us();
        self.jogging.release_all(now_us);
        self.opened_us = now_us;
        self.overlay = Overlay::Confirm(confirm);
    }
}
