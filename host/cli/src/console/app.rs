//! Application state: everything between key input and controller. It never blocks.
//!
//! [`App::update`] is called at least every few milliseconds. It advances the line, the session and
//! the jog, and waits at most one line timeout (1 ms). Key input arrives in between through
//! [`App::handle_input`] (`input.rs`), messages of the controller are handled in `events.rs`, and
//! the view model is built in `view_model/build.rs`.
//!
//! After a link loss the console reopens the port and a session, and does nothing else by itself:
//! jogs, programs and homing end with their session. A stop requested meanwhile is sent first after
//! reconnection.

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

/// Telemetry period, ms. On a slow line telemetry takes at most a quarter of the bandwidth.
const TELEMETRY_MS: u32 = 20;

/// Approximate size of a telemetry frame, bytes.
const TELEMETRY_BYTES: u32 = 150;

/// Longest wait for standstill when the console quits.
const SHUTDOWN: Duration = Duration::from_millis(2000);

/// Full scales of the force bars, N.
pub(super) const FORCE_SCALES: [f64; 5] = [5.0, 10.0, 20.0, 50.0, 100.0];

/// Action on the positive acknowledgement of a request.
#[derive(Debug, Clone)]
pub(super) enum OnAck {
    Nothing,
    /// The configuration was active before, so other hosts may have changed settings since.
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
        /// Set or removed.
        is_set: bool,
        /// Part of a removal of all faces.
        all: bool,
    },
    PositionScale(u16),
    Notify(&'static str),
}

/// Requested settings of a force loop: the latest ones, one request at a time.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct RequestedLoop {
    pub(super) settings: Option<ForceLoop>,
    /// Settings of the request under way.
    pub(super) in_flight: Option<ForceLoop>,
    /// Earliest time of the next request: the controller still applies the last change.
    pub(super) not_before_us: u64,
}

impl RequestedLoop {
    /// The latest settings that were requested and not yet acknowledged.
    pub(super) fn latest(&self) -> Option<ForceLoop> {
        self.settings.or(self.in_flight)
    }
}

/// A stop that waits for a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum PendingStop {
    None,
    Stop,
    Emergency,
}

/// Settings from the command line.
pub(super) struct Settings {
    pub(super) dead_man_ms: u16,
    pub(super) folder: PathBuf,
    /// Program offered first.
    pub(super) program: Option<PathBuf>,
    /// Stock to clamp on the simulated table after homing.
    pub(super) stock: Option<CuttingConfig>,
    pub(super) options: Options,
    /// Choice of the configuration of a board behind a port.
    pub(super) board: Option<Chosen>,
}

/// See the module documentation.
pub(super) struct App {
    pub(super) machine: Arc<MachineFile>,
    pub(super) model: Model,
    pub(super) settings: Settings,
    pub(super) client: Client,
    pub(super) connection: Connection,
    pub(super) static_info: Arc<StaticInfo>,
    pub(super) transmit: Vec<u8>,
    pub(super) received: Vec<u8>,
    /// Time of the line at the last exchange, us.
    pub(super) line_us: u64,
    pub(super) started: Instant,
    pub(super) link_state: LinkState,
    /// A session was open before: a port error now starts a retry instead of ending the program.
    pub(super) connected_once: bool,
    pub(super) reconnects: u32,
    /// The board had the configuration of this console, or accepted it.
    configuration_checked: bool,
    /// The controller has the configuration of the machine file.
    pub(super) configured: bool,
    pub(super) requests: Vec<(Ticket, OnAck)>,
    pub(super) pending_stop: PendingStop,
    pub(super) telemetry: Option<Telemetry>,
    pub(super) telemetry_at: Instant,
    /// Control period of the last change of state; older telemetry describes another state.
    pub(super) state_period: u64,
    pub(super) log: Log,
    pub(super) overlay: Overlay,
    pub(super) sources: [Source; MAX_AXES],
    pub(super) feed_override: u8,
    /// The override requested last.
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
    /// Time at which the overlay was opened, us.
    pub(super) opened_us: u64,
    /// Quit was confirmed.
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
            requests: Vec::new(),
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
            master: Master::from_machine(&machine),
            recording: None,
            stopping: None,
            fault: None,
            opened_us: 0,
            quitting: false,
            machine,
        }
    }

    /// Time since the start of the console, us.
    pub(super) fn now_us(&self) -> u64 {
        u64::try_from(self.started.elapsed().as_micros()).unwrap_or(u64::MAX)
    }

    pub(super) fn notify(&mut self, severity: Severity, text: impl Into<String>) {
        self.log.add(self.started.elapsed(), severity, text);
    }

    pub(super) fn is_ready(&self) -> bool {
        self.link_state == LinkState::Ready
    }

    /// The present state, if a session is open.
    pub(super) fn state(&self) -> Option<State> {
        let telemetry = self.telemetry.as_ref().filter(|_| self.is_ready())?;
        Some(telemetry.state)
    }

    /// The machine moves or may move.
    pub(super) fn is_moving(&self) -> bool {
        matches!(
            self.telemetry.as_ref().map(|telemetry| telemetry.state),
            Some(State::Run | State::Jog | State::Homing | State::Hold)
        )
    }

    /// The exact commanded pose of an idle machine.
    pub(super) fn standstill_pose(&self) -> Option<AxisValues> {
        let telemetry = self.telemetry.as_ref().filter(|_| self.is_ready())?;
        let known = telemetry.state == State::Idle && telemetry.period >= self.state_period;
        known.then(|| telemetry.commanded.clone())
    }

    /// Sends a request and stores its on-acknowledge action.
    pub(super) fn request(&mut self, command: Command, on_ack: OnAck) {
        let ticket = self.client.request(command);
        self.requests.push((ticket, on_ack));
    }

    /// Advances connection, session and commands by one exchange.
    ///
    /// # Errors
    /// No session was ever open, and the port or the session fails.
    pub(super) fn update(&mut self) -> Result<(), CliError> {
        match self.connection.advance() {
            Progress::Nothing => {}
            Progress::Open => self.send_hello(),
            Progress::Failed(error) => self.handle_port_error(&error)?,
        }
        if self.link_state == LinkState::Opening && self.connection.line().is_some() {
            // The in-process simulator is connected from the start.
            self.send_hello();
        }
        self.send_jog();
        self.send_force_loops();
        let Some(line) = self.connection.line() else {
            std::thread::sleep(Duration::from_millis(2));
            return Ok(());
        };
        // Queued commands are sent with this exchange, not with the next one.
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

    /// Starts a session on a line that was just opened.
    fn send_hello(&mut self) {
        self.client = Client::new(self.settings.options);
        self.transmit.clear();
        self.requests.clear();
        self.line_us = 0;
        self.client.connect(fresh_number(), 0);
        if self.pending_stop != PendingStop::None {
            // The out-of-band stop needs no session: it is sent before the Hello.
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

    /// Ends everything that belonged to the lost session.
    pub(super) fn handle_link_loss(&mut self, reason: &str) {
        if self.link_state == LinkState::Ready || self.link_state == LinkState::Configuring {
            let ms = self.machine.config.supervision.heartbeat_ms;
            self.notify(
                Severity::Alarm,
                format!(
                    "link lost: {reason}. A moving machine stops after {ms} ms without the host"
                ),
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
        self.link_state = LinkState::Lost(reason.to_string());
        self.connection.drop_line();
    }

    /// Configures a session that was just opened.
    ///
    /// # Errors
    /// The board has another configuration, or none.
    pub(super) fn begin(&mut self) -> Result<(), CliError> {
        if self.connected_once {
            self.reconnects += 1;
            self.notify(
                Severity::Info,
                "reconnected; the machine does not move until commanded",
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

    /// Makes sure that board and console use the same machine file.
    fn check_configuration(&mut self) -> Result<(), CliError> {
        if let (Some(board), Some(welcome)) = (&self.settings.board, self.client.controller()) {
            match board.decide(welcome)? {
                // After a power loss the board receives the configuration that it had in this
                // console.
                _ if self.configuration_checked && welcome.config_crc == 0 => {}
                Decision::Active(file) => {
                    // The built-in haptic arm is a known configuration too, but no machine for this
                    // console.
                    if self.machine.is_master() != file.is_master() {
                        let message = format!(
                            "{}: the board is configured as \"{}\"; \
                             give its machine file with --machine FILE",
                            self.connection.name(),
                            welcome.machine
                        );
                        return Err(CliError::new(Exit::Command, message));
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
                Decision::Send(message) => self.notify(Severity::Info, message),
                Decision::Unknown(message) => {
                    let message = format!("{}: {message}", self.connection.name());
                    return Err(CliError::new(Exit::Command, message));
                }
            }
            self.configuration_checked = true;
        }
        self.send_configuration();
        Ok(())
    }

    /// Makes the machine file the active configuration, unless it is active already.
    pub(super) fn send_configuration(&mut self) {
        match self.machine.encoded() {
            Ok((bytes, crc)) => {
                let already_active = self
                    .client
                    .controller()
                    .is_some_and(|welcome| welcome.config_crc == crc);
                let ticket = self.client.configure(&bytes, false);
                self.requests
                    .push((ticket, OnAck::Configured { already_active }));
            }
            Err(error) => self.notify(Severity::Alarm, format!("defect: {error}")),
        }
    }

    /// Sends the command of the jog keys.
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
                // Without a session there is no motion to keep alive.
                let _ = self.client.jog(rates, deadline_ms);
            }
            JogCommand::Move { .. } => {}
        }
    }

    /// Stops the machine before the console ends. Returns true when its standstill is confirmed.
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
        // Closes the recording.
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
