//! What the controller says, and what follows from it.

use super::app::{App, FORCE_SCALES, OnAck};
use super::view_model::{LinkState, Severity};
use crate::commands::{CliError, Exit};
use haptimill_client::client::{Notice, RequestError, Ticket};
use haptimill_protocol::force::{ForceLoop, ForceParameter};
use haptimill_protocol::message::{Command, Event, Refusal, State, Telemetry};
use std::time::{Duration, Instant};

/// How long a full scale of the force bars that is too large stays.
const SCALE_HOLD: Duration = Duration::from_secs(5);

/// Pause after a controller said that it is busy with the last change, microseconds.
const BUSY_US: u64 = 20_000;

/// Time between two reports of the hand, ms.
const MASTER_MS: u32 = 100;

impl App {
    pub(super) fn handle_notice(&mut self, notice: Notice) -> Result<(), CliError> {
        match notice {
            Notice::Connected(_) => self.begin()?,
            Notice::Answered {
                ticket,
                command,
                result,
            } => self.handle_answer(ticket, command, result),
            Notice::Event { period, event } => self.handle_event(period, &event),
            Notice::Telemetry(telemetry) => self.update_telemetry(*telemetry),
            Notice::Refused(refusal) => {
                let why = self
                    .model
                    .with_axes(|axes| axes.describe(&refusal).to_string());
                self.notify(Severity::Warning, format!("jog: {why}"));
            }
            Notice::Job(ending) => self.job_ended(&ending),
            Notice::Lost(error) => {
                if !self.connected_once {
                    let what = format!("{}: {error}", self.connection.name());
                    return Err(CliError::new(Exit::Port, what));
                }
                self.handle_link_loss(&error.to_string());
            }
        }
        Ok(())
    }

    fn handle_answer(&mut self, ticket: Ticket, command: &str, result: Result<(), RequestError>) {
        let on_ack = self
            .asked
            .iter()
            .position(|(asked, _)| *asked == ticket)
            .map_or(OnAck::Nothing, |index| self.asked.swap_remove(index).1);
        if let OnAck::Configured { already_active } = on_ack {
            // Refused is heard all the same: what stops a machine needs no configuration.
            self.link_state = LinkState::Ready;
            self.configured = result.is_ok();
            if self.configured {
                if let Some(master) = self.master.as_mut().filter(|_| !already_active) {
                    master.begin();
                }
                self.query_settings();
            }
        }
        if let Err(error) = result {
            match on_ack {
                OnAck::Override(_) => self.requested_override = self.feed_override,
                OnAck::Loop(axis, settings) if self.retry_force_loop(axis, settings, &error) => {
                    return;
                }
                _ => {}
            }
            let why = match &error {
                RequestError::Refused(refusal) => self
                    .model
                    .with_axes(|axes| axes.describe(refusal).to_string()),
                RequestError::Withdrawn | RequestError::Lost(_) => return,
                other => other.to_string(),
            };
            let what = self.reject_master(&on_ack);
            let what = what.as_deref().unwrap_or(command);
            self.notify(Severity::Warning, format!("{what}: {why}"));
            return;
        }
        match on_ack {
            OnAck::Nothing | OnAck::Configured { .. } => {}
            OnAck::Enabled => self.notify(Severity::Info, "drives on"),
            OnAck::Override(percent) => self.feed_override = percent,
            OnAck::Source(axis, source) => {
                self.sources[usize::from(axis)] = source;
                let name = &self.static_info.pose[usize::from(axis)].name;
                let what = format!("{name}: {source}");
                self.notify(Severity::Info, what);
            }
            OnAck::Loop(axis, settings) => {
                let axis = usize::from(axis);
                self.requested_loops[axis].asked = None;
                if let Some(loops) = &mut self.loops {
                    loops[axis] = settings;
                }
            }
            OnAck::ForceFeedback(_) | OnAck::Fixture { .. } | OnAck::PositionScale(_) => {
                self.acknowledge_master(&on_ack)
            }
            OnAck::Say(what) => self.notify(Severity::Info, what),
        }
    }

    /// What the controller has by itself of what is shown: force loops may have been set by another host.
    fn query_settings(&mut self) {
        if self.loops.is_some() {
            for axis in 0..3 {
                self.request(Command::ForceSettings { axis }, OnAck::Nothing);
            }
        }
        if self.machine.config.haptic.is_some() {
            let every = MASTER_MS * 1000 / u32::from(self.machine.config.period_us.max(1));
            let every = every.clamp(1, u32::from(u16::MAX)) as u16;
            self.request(Command::MasterTelemetry { every }, OnAck::Nothing);
        }
    }

    /// True when it is to be asked again: a newer wish waits already, or the controller works the last change out.
    fn retry_force_loop(&mut self, axis: u8, settings: ForceLoop, error: &RequestError) -> bool {
        let now_us = self.now_us();
        let requested = &mut self.requested_loops[usize::from(axis)];
        requested.asked = None;
        let busy = matches!(
            error,
            RequestError::Refused(Refusal::Force { refusal, .. })
                if refusal.parameter == ForceParameter::Busy
        );
        if busy {
            requested.settings.get_or_insert(settings);
            requested.not_before_us = now_us + BUSY_US;
        }
        busy
    }

    /// Asks for the settings of force loops that are wanted.
    pub(super) fn send_force_loops(&mut self) {
        let now_us = self.now_us();
        for axis in 0..self.requested_loops.len() {
            let requested = &mut self.requested_loops[axis];
            if requested.asked.is_some() || now_us < requested.not_before_us {
                continue;
            }
            if let Some(settings) = requested.settings.take() {
                requested.asked = Some(settings);
                let axis = axis as u8;
                self.request(
                    Command::ForceLoop { axis, settings },
                    OnAck::Loop(axis, settings),
                );
            }
        }
    }

    fn handle_event(&mut self, period: u64, event: &Event) {
        if let Event::State { to, .. } = event {
            self.state_period = period;
            if let Some(telemetry) = &mut self.telemetry {
                telemetry.state = *to;
            }
            self.clear_stop(*to);
            if *to == State::Idle {
                // Where it stands, to the last bit: what comes next begins there.
                self.request(Command::Status, OnAck::Nothing);
            }
        }
        if let Event::ForceSettings { axis, settings } = event {
            if let Some(slot) = self
                .loops
                .as_mut()
                .and_then(|loops| loops.get_mut(usize::from(*axis)))
            {
                *slot = *settings;
            }
            return;
        }
        let severity = match event {
            Event::Fault(fault) => {
                self.fault = Some(*fault);
                Severity::Alarm
            }
            Event::State {
                to: State::EmergencyStop,
                ..
            } => Severity::Alarm,
            Event::Underrun { .. }
            | Event::Blocked { .. }
            | Event::JogLimited { .. }
            | Event::Saturated { .. }
            | Event::TareRefused(_)
            | Event::ComplianceLimited { .. }
            | Event::Paused { .. } => Severity::Warning,
            _ => Severity::Info,
        };
        self.update_jobs(event);
        // Begin and end of every jog and step is no news.
        let routine = matches!(
            event,
            Event::State {
                from: State::Idle,
                to: State::Jog | State::Run,
                position_kept: true
            } | Event::State {
                from: State::Jog | State::Run,
                to: State::Idle,
                position_kept: true
            } | Event::JobDone { .. }
        );
        if !routine {
            let text = self
                .model
                .with_axes(|axes| axes.describe(event).to_string());
            self.notify(severity, text);
        }
    }

    /// A state in which nothing moves answers a stop.
    fn clear_stop(&mut self, state: State) {
        if !matches!(state, State::Run | State::Jog | State::Homing | State::Hold)
            && !self.client.urgent().0
        {
            self.stopping = None;
        }
    }

    fn update_telemetry(&mut self, telemetry: Telemetry) {
        self.telemetry_at = Instant::now();
        self.fault = telemetry.fault;
        if telemetry.period >= self.state_period {
            self.clear_stop(telemetry.state);
        }
        if let Some(force) = &telemetry.force {
            let largest = force
                .high
                .iter()
                .chain(&force.low)
                .map(|value| f64::from(*value).abs() / 65_536.0)
                .fold(0.0, f64::max);
            let fits = FORCE_SCALES
                .iter()
                .position(|scale| largest <= *scale)
                .unwrap_or(FORCE_SCALES.len() - 1);
            let (view, since) = &mut self.force_scale;
            if fits >= *view || since.elapsed() > SCALE_HOLD {
                (*view, *since) = (fits, Instant::now());
            }
        }
        if let Some(recording) = &mut self.recording
            && let Err(why) = recording.add(&telemetry)
        {
            self.recording = None;
            self.notify(Severity::Alarm, format!("recording ended: {why}"));
        }
        self.telemetry = Some(telemetry);
    }
}
