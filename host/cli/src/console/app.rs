//! Application state: everything between key input and controller. It never blocks.
//!
//! [`App::update`] is called at least every few milliseconds. It advances the session and the jog,
//! and waits at most one line timeout (1 ms). Key input arrives in between through
//! [`App::handle_input`] (`input.rs`), messages of the controller are handled in `events.rs`, and
//! the view model is built in `view_model/build.rs`.
//!
//! After a link loss the session opens itself again, and the console does nothing else by itself:
//! jogs, programs and homing end with their session. A stop requested meanwhile is sent first.

use super::jobs::Jobs;
use super::jogging::{JogCommand, Jogging};
use super::keys::Action;
use super::master::Master;
use super::recording::Recording;
use super::view_model::{Axis, Confirm, LinkState, Log, Motion, Overlay, Severity, StaticInfo};
use crate::commands::exit::{CliError, Exit};
use crate::commands::requests::{NO_REPORT, Request, Requests, describe_overrides};
use crate::commands::status::StatusReport;
use haptimill_client::board::Chosen;
use haptimill_client::client::{Options, Ticket};
use haptimill_client::session::{Line, Session, SessionPhase, Startup, fresh_number};
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
use std::sync::atomic::AtomicUsize;
use std::time::{Duration, Instant};

/// Sleep while no port is open.
const CLOSED_SLEEP: Duration = Duration::from_millis(2);

/// Longest wait for standstill when the console quits.
const SHUTDOWN: Duration = Duration::from_millis(2000);

/// Full scales of the force bars, N.
pub(super) const FORCE_SCALES: [f64; 5] = [5.0, 10.0, 20.0, 50.0, 100.0];

/// What an override scales.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum OverrideKind {
    /// Moves at feed.
    Feed,
    /// Rapid moves.
    Rapid,
    /// The spindle speed.
    Spindle,
}

/// Action on the positive acknowledgement of a request.
#[derive(Debug, Clone)]
pub(super) enum OnAck {
    Nothing,
    Enabled,
    /// The drives were enabled for homing.
    EnabledToHome,
    Override(OverrideKind, u8),
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

/// Settings from the command line.
pub(super) struct Settings {
    pub(super) jog_timeout_ms: u16,
    pub(super) folder: PathBuf,
    /// Program offered first.
    pub(super) program: Option<PathBuf>,
    /// Stock to clamp on the simulated table after homing.
    pub(super) stock: Option<CuttingConfig>,
}

/// See the module documentation.
pub(super) struct App {
    pub(super) machine: Arc<MachineFile>,
    pub(super) model: Model,
    pub(super) settings: Settings,
    pub(super) session: Session<Box<dyn Line>>,
    pub(super) static_info: Arc<StaticInfo>,
    pub(super) started: Instant,
    /// A session was open before: a lost one is opened again instead of ending the program.
    pub(super) connected_once: bool,
    pub(super) reconnects: u32,
    /// The startup of the present session is done.
    was_ready: bool,
    pub(super) requests: Vec<(Ticket, OnAck)>,
    pub(super) telemetry: Option<Telemetry>,
    pub(super) telemetry_at: Instant,
    /// The newest telemetry as it was received.
    pub(super) reported: Option<Telemetry>,
    pub(super) motion: Option<Motion>,
    /// Control period of the last change of state; older telemetry describes another state.
    pub(super) state_period: u64,
    pub(super) log: Log,
    pub(super) overlay: Overlay,
    /// First row of the last page of the overlay, which its drawing writes.
    pub(super) last_scroll: Arc<AtomicUsize>,
    pub(super) sources: [Source; MAX_AXES],
    /// Feed, rapid and spindle override, percent.
    pub(super) overrides: [u8; 3],
    /// The overrides requested last.
    pub(super) requested_overrides: [u8; 3],
    pub(super) jogging: Jogging,
    pub(super) jobs: Jobs,
    pub(super) loops: Option<[ForceLoop; 3]>,
    pub(super) requested_loops: [RequestedLoop; 3],
    pub(super) force_scale: (usize, Instant),
    pub(super) master: Option<Master>,
    pub(super) recording: Option<Recording>,
    pub(super) stopping: Option<&'static str>,
    pub(super) fault: Option<Fault>,
    /// Joint that is on its limit switch, as the controller said last.
    pub(super) on_switch: Option<u8>,
    /// Time at which the overlay was opened, us.
    pub(super) opened_us: u64,
    /// Quit was confirmed.
    pub(super) quitting: bool,
    /// Requests of other processes.
    pub(super) requests_of_others: Requests,
}

impl App {
    /// The application with a line that is not open yet. `board` chooses the configuration of a
    /// board behind a port.
    ///
    /// # Errors
    /// The machine file cannot be encoded.
    pub(super) fn new(
        machine: Arc<MachineFile>,
        line: Box<dyn Line>,
        options: Options,
        board: Option<Chosen>,
        settings: Settings,
    ) -> Result<Self, CliError> {
        let startup = Startup::new(&machine, board, Vec::new())?.allowing_refusal();
        let limits: Vec<f64> = machine.pose.iter().map(|axis| axis.rate).collect();
        let static_info = Arc::new(StaticInfo {
            port: line.name(),
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
        let session = Session::new(line, &machine, options, Arc::default())
            .with_startup(startup)
            .with_reconnection(Box::new(fresh_number))
            .with_closed_line();
        Ok(Self {
            model: Model::new(&machine),
            jobs: Jobs::new(settings.program.clone()),
            jogging: Jogging::new(&limits, settings.jog_timeout_ms),
            settings,
            session,
            static_info,
            started: now,
            connected_once: false,
            reconnects: 0,
            was_ready: false,
            requests: Vec::new(),
            telemetry: None,
            telemetry_at: now,
            reported: None,
            motion: None,
            state_period: 0,
            log: Log::default(),
            overlay: Overlay::None,
            last_scroll: Arc::default(),
            sources: [Source::Program; MAX_AXES],
            overrides: [100; 3],
            requested_overrides: [100; 3],
            loops,
            requested_loops: [RequestedLoop::default(); 3],
            force_scale: (0, now),
            master: Master::from_machine(&machine),
            recording: None,
            stopping: None,
            fault: None,
            on_switch: None,
            opened_us: 0,
            quitting: false,
            requests_of_others: Requests::default(),
            machine,
        })
    }

    /// Time since the start of the console, us.
    pub(super) fn now_us(&self) -> u64 {
        u64::try_from(self.started.elapsed().as_micros()).unwrap_or(u64::MAX)
    }

    pub(super) fn notify(&mut self, severity: Severity, text: impl Into<String>) {
        self.log.add(self.started.elapsed(), severity, text);
    }

    pub(super) fn is_ready(&self) -> bool {
        *self.session.phase() == SessionPhase::Ready
    }

    /// State of the link.
    pub(super) fn link_state(&self) -> LinkState {
        match self.session.phase() {
            SessionPhase::Ready => LinkState::Ready,
            SessionPhase::Starting(_) => LinkState::Configuring,
            _ if self.connected_once => LinkState::Lost(self.session.reason().to_string()),
            SessionPhase::Disconnected => LinkState::Opening,
            SessionPhase::Closed | SessionPhase::Identifying | SessionPhase::Connecting => {
                LinkState::Handshake
            }
        }
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
        let ticket = self.session.client_mut().request(command);
        self.requests.push((ticket, on_ack));
    }

    /// Advances session and commands by one exchange.
    ///
    /// # Errors
    /// No session was ever open, and the port or the session fails; or the board has another
    /// configuration.
    pub(super) fn update(&mut self) -> Result<(), CliError> {
        self.answer_others();
        self.send_jog();
        self.send_force_loops();
        // Key input is sent with this exchange, not with the next one.
        self.session.flush();
        self.session.exchange()?;
        if *self.session.phase() == SessionPhase::Disconnected {
            if !self.connected_once && !self.session.reason().is_empty() {
                return Err(CliError::new(Exit::Port, self.session.reason()));
            }
            std::thread::sleep(CLOSED_SLEEP);
        }
        while let Some(notification) = self.session.poll()? {
            self.handle_notification(notification)?;
        }
        while let Some(notice) = self.session.next_notice() {
            self.notify(Severity::Warning, notice);
        }
        if self.is_ready() && !std::mem::replace(&mut self.was_ready, true) {
            self.begin();
        }
        self.update_arm();
        self.advance_jobs();
        Ok(())
    }

    /// Answers the requests of other processes.
    fn answer_others(&mut self) {
        let mut requests = std::mem::take(&mut self.requests_of_others);
        requests.serve(|request| self.answer_other(request));
        self.requests_of_others = requests;
    }

    /// Does what another process requests, and describes it.
    fn answer_other(&mut self, request: Request) -> Result<String, String> {
        let state = self.state().ok_or("there is no link to the controller")?;
        match request {
            Request::Override(percents) => {
                if let (Some(percent), Some(running)) = (percents[2], &self.jobs.checked)
                    && self.jobs.is_running_program()
                {
                    self.check_spindle(running, percent)?;
                }
                let kinds = [
                    OverrideKind::Feed,
                    OverrideKind::Rapid,
                    OverrideKind::Spindle,
                ];
                for (kind, percent) in kinds.into_iter().zip(percents) {
                    if let Some(percent) = percent {
                        self.set_override(kind, percent);
                    }
                }
                Ok(describe_overrides(self.requested_overrides))
            }
            Request::Hold => match state {
                State::Hold => Ok("the job is held".into()),
                State::Run | State::Jog | State::Homing => {
                    self.execute(Action::Hold);
                    Ok("the machine holds along its path".into())
                }
                _ => Err(format!("nothing moves: the machine is {state}")),
            },
            Request::Resume if state == State::Hold => {
                self.execute(Action::Resume);
                Ok("the job continues".into())
            }
            Request::Resume => Err("the job is not held, and does not pause".into()),
            Request::Status => {
                let telemetry = self.telemetry.as_ref().ok_or(NO_REPORT)?;
                let name = self.session.machine_name();
                let configuration = (self.session.configuration_crc(), self.session.kept());
                Ok(StatusReport::new(&name, configuration, &self.model, telemetry).answer())
            }
        }
    }

    /// Ends everything that belonged to the lost session.
    pub(super) fn handle_link_loss(&mut self) {
        if std::mem::take(&mut self.was_ready) {
            let reason = self.session.reason();
            let ms = self.machine.config.supervision.heartbeat_ms;
            let text = format!(
                "link lost: {reason}. A moving machine stops after {ms} ms without the host"
            );
            self.notify(Severity::Alarm, text);
        }
        let now_us = self.now_us();
        self.jogging.release_all(now_us);
        self.jobs.clear();
        self.sources = [Source::Program; MAX_AXES];
        (self.overrides, self.requested_overrides) = ([100; 3], [100; 3]);
        self.note_overrides();
        self.requested_loops = [RequestedLoop::default(); 3];
        if let Some(master) = &mut self.master {
            master.handle_link_loss();
        }
        self.stopping = None;
        self.motion = None;
        self.requests.clear();
    }

    /// The controller answered.
    pub(super) fn handle_connection(&mut self) {
        if self.connected_once {
            self.reconnects += 1;
            self.notify(
                Severity::Info,
                "reconnected; the machine does not move until commanded",
            );
        }
        self.connected_once = true;
        if self.session.is_stopping() {
            self.stopping.get_or_insert("stop");
        }
    }

    /// The startup is done: subscribes to telemetry, and queries the settings that another host may
    /// have changed.
    fn begin(&mut self) {
        let every = self.session.telemetry_periods();
        self.request(Command::Telemetry { every }, OnAck::Nothing);
        self.request(Command::Status, OnAck::Nothing);
        if !self.session.is_configured() {
            return;
        }
        let was_active = self.session.was_configured();
        if let Some(master) = self.master.as_mut().filter(|_| !was_active) {
            master.begin();
        }
        self.query_settings();
    }

    /// Sends the command of the jog keys.
    fn send_jog(&mut self) {
        let now_us = self.now_us();
        match self.jogging.command(now_us) {
            JogCommand::None => {}
            JogCommand::Cancel => {
                self.session.client_mut().cancel_jog();
            }
            JogCommand::Move { rates, timeout_ms } if self.is_ready() => {
                let rates = rates
                    .iter()
                    .zip(&self.static_info.pose)
                    .map(|(rate, axis)| {
                        (rate * per_unit(axis.kind) / f64::from(1 << RATE_SHIFT)).round() as i32
                    })
                    .collect();
                // Without a session there is no motion to keep alive.
                let _ = self.session.client_mut().jog(rates, timeout_ms);
            }
            JogCommand::Move { .. } => {}
        }
    }

    /// Stops the machine before the console ends. Returns true when its standstill is confirmed.
    pub(super) fn shut_down(&mut self) -> bool {
        let now_us = self.now_us();
        self.jogging.release_all(now_us);
        let until = Instant::now() + SHUTDOWN;
        if self.is_moving() && self.session.is_open() {
            self.session.stop();
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
