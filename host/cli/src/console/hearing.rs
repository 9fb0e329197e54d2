//! What the controller says, and what follows from it.

use super::desk::{Desk, SCALES, Then};
use super::shown::{Contact, Weight};
use crate::commands::{CliError, Exit};
use haptimill_client::client::{Notification, RequestError, Ticket};
use haptimill_protocol::force::{ForceLoop, ForceParameter};
use haptimill_protocol::message::{Command, Event, Refusal, State, Telemetry};
use std::time::{Duration, Instant};

/// How long a full scale of the force bars that is too large stays.
const SCALE_STAYS: Duration = Duration::from_secs(5);

/// Pause after a controller said that it is busy with the last change, microseconds.
const BUSY_US: u64 = 20_000;

/// Time between two reports of the hand, ms.
const HAND_MS: u32 = 100;

impl Desk {
    pub(super) fn hear(&mut self, notice: Notification) -> Result<(), CliError> {
        match notice {
            Notification::Connected(_) => self.begin()?,
            Notification::Answered {
                ticket,
                command,
                result,
            } => self.answered(ticket, command, result),
            Notification::Event { period, event } => self.event(period, &event),
            Notification::Telemetry(telemetry) => self.report(*telemetry),
            Notification::Refused(refusal) => {
                let why = self
                    .model
                    .with_axes(|axes| axes.describe(&refusal).to_string());
                self.say(Weight::Warning, format!("jog: {why}"));
            }
            Notification::Job(ending) => self.job_ended(&ending),
            Notification::Lost(error) => {
                if !self.connected_once {
                    let what = format!("{}: {error}", self.connection.name());
                    return Err(CliError::new(Exit::Port, what));
                }
                self.lose(&error.to_string());
            }
        }
        Ok(())
    }

    fn answered(&mut self, ticket: Ticket, command: &str, result: Result<(), RequestError>) {
        let then = self
            .asked
            .iter()
            .position(|(asked, _)| *asked == ticket)
            .map_or(Then::Nothing, |index| self.asked.swap_remove(index).1);
        if let Then::Configured { kept } = then {
            // Refused is heard all the same: what stops a machine needs no configuration.
            self.contact = Contact::Ready;
            self.configured = result.is_ok();
            if self.configured {
                if let Some(hand) = self.hand.as_mut().filter(|_| !kept) {
                    hand.begin();
                }
                self.ask_settings();
            }
        }
        if let Err(error) = result {
            match then {
                Then::Override(_) => self.requested_override = self.feed_override,
                Then::Loop(axis, settings) if self.loop_refused(axis, settings, &error) => return,
                _ => {}
            }
            let why = match &error {
                RequestError::Refused(refusal) => self
                    .model
                    .with_axes(|axes| axes.describe(refusal).to_string()),
                RequestError::Withdrawn | RequestError::Lost(_) => return,
                other => other.to_string(),
            };
            let what = self.hand_refused(&then);
            let what = what.as_deref().unwrap_or(command);
            self.say(Weight::Warning, format!("{what}: {why}"));
            return;
        }
        match then {
            Then::Nothing | Then::Configured { .. } => {}
            Then::Enabled => self.say(Weight::Note, "drives on"),
            Then::Override(percent) => self.feed_override = percent,
            Then::Source(axis, source) => {
                self.sources[usize::from(axis)] = source;
                let name = &self.fixed.pose[usize::from(axis)].name;
                let what = format!("{name}: {source}");
                self.say(Weight::Note, what);
            }
            Then::Loop(axis, settings) => {
                let axis = usize::from(axis);
                self.requested_loops[axis].asked = None;
                if let Some(loops) = &mut self.loops {
                    loops[axis] = settings;
                }
            }
            Then::ForceFeedback(_) | Then::Wall { .. } | Then::PositionScale(_) => {
                self.hand_set(&then)
            }
            Then::Say(what) => self.say(Weight::Note, what),
        }
    }

    /// What the controller has by itself of what is shown: force loops may have been set by another host.
    fn ask_settings(&mut self) {
        if self.loops.is_some() {
            for axis in 0..3 {
                self.ask(Command::ForceSettings { axis }, Then::Nothing);
            }
        }
        if self.machine.config.haptic.is_some() {
            let every = HAND_MS * 1000 / u32::from(self.machine.config.period_us.max(1));
            let every = every.clamp(1, u32::from(u16::MAX)) as u16;
            self.ask(Command::MasterTelemetry { every }, Then::Nothing);
        }
    }

    /// True when it is to be asked again: a newer wish waits already, or the controller works the last change out.
    fn loop_refused(&mut self, axis: u8, settings: ForceLoop, error: &RequestError) -> bool {
        let now_us = self.now_us();
        let commanded = &mut self.requested_loops[usize::from(axis)];
        commanded.asked = None;
        let busy = matches!(
            error,
            RequestError::Refused(Refusal::Force { refusal, .. })
                if refusal.parameter == ForceParameter::Busy
        );
        if busy {
            commanded.settings.get_or_insert(settings);
            commanded.after_us = now_us + BUSY_US;
        }
        busy
    }

    /// Asks for the settings of force loops that are wanted.
    pub(super) fn ask_loops(&mut self) {
        let now_us = self.now_us();
        for axis in 0..self.requested_loops.len() {
            let commanded = &mut self.requested_loops[axis];
            if commanded.asked.is_some() || now_us < commanded.after_us {
                continue;
            }
            if let Some(settings) = commanded.settings.take() {
                commanded.asked = Some(settings);
                let axis = axis as u8;
                self.ask(
                    Command::ForceLoop { axis, settings },
                    Then::Loop(axis, settings),
                );
            }
        }
    }

    fn event(&mut self, period: u64, event: &Event) {
        if let Event::State { to, .. } = event {
            self.changed = period;
            if let Some(telemetry) = &mut self.telemetry {
                telemetry.state = *to;
            }
            self.rests(*to);
            if *to == State::Idle {
                // Where it stands, to the last bit: what comes next begins there.
                self.ask(Command::Status, Then::Nothing);
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
        let weight = match event {
            Event::Fault(fault) => {
                self.fault = Some(*fault);
                Weight::Alarm
            }
            Event::State {
                to: State::EmergencyStop,
                ..
            } => Weight::Alarm,
            Event::Underrun { .. }
            | Event::Blocked { .. }
            | Event::JogLimited { .. }
            | Event::Saturated { .. }
            | Event::TareRefused(_)
            | Event::ComplianceLimited { .. }
            | Event::Paused { .. } => Weight::Warning,
            _ => Weight::Note,
        };
        self.work_event(event);
        // Begin and end of every jog and step is no news.
        let usual = matches!(
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
        if !usual {
            let text = self
                .model
                .with_axes(|axes| axes.describe(event).to_string());
            self.say(weight, text);
        }
    }

    /// A state in which nothing moves answers a stop.
    fn rests(&mut self, state: State) {
        if !matches!(state, State::Run | State::Jog | State::Homing | State::Hold)
            && !self.client.urgent().0
        {
            self.stopping = None;
        }
    }

    fn report(&mut self, telemetry: Telemetry) {
        self.telemetry_at = Instant::now();
        self.fault = telemetry.fault;
        if telemetry.period >= self.changed {
            self.rests(telemetry.state);
        }
        if let Some(force) = &telemetry.force {
            let largest = force
                .high
                .iter()
                .chain(&force.low)
                .map(|value| f64::from(*value).abs() / 65_536.0)
                .fold(0.0, f64::max);
            let fits = SCALES
                .iter()
                .position(|scale| largest <= *scale)
                .unwrap_or(SCALES.len() - 1);
            let (shown, since) = &mut self.force_scale;
            if fits >= *shown || since.elapsed() > SCALE_STAYS {
                (*shown, *since) = (fits, Instant::now());
            }
        }
        if let Some(recording) = &mut self.recording
            && let Err(why) = recording.add(&telemetry)
        {
            self.recording = None;
            self.say(Weight::Alarm, format!("recording ended: {why}"));
        }
        self.telemetry = Some(telemetry);
    }
}
