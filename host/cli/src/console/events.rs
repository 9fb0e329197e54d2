//! Handling of the messages of the controller.

use super::app::{App, FORCE_SCALES, OnAck};
use super::view_model::{Axis, Motion, Severity};
use crate::commands::exit::{CliError, Exit};
use haptimill_client::client::{Notification, RequestError, Ticket};
use haptimill_firmware::config::AxisKind;
use haptimill_machine_file::jog_limit::soft_limits;
use haptimill_machine_file::scale::{PER_EFFORT, per_unit};
use haptimill_protocol::force::{ForceLoop, ForceParameter};
use haptimill_protocol::message::{Command, Event, Fault, InputProblem, Refusal, State, Telemetry};
use std::time::{Duration, Instant};

/// Time for which a full scale that is too large is kept.
const SCALE_HOLD: Duration = Duration::from_secs(5);

/// Delay before a request is repeated after a busy answer, us.
const BUSY_US: u64 = 20_000;

/// Longest time between two reports that give a speed, s.
const SPEED_S: f64 = 1.0;

/// The commanded motion between two reports; none where they are too far apart, where the drives
/// are off in one of them (the commanded pose is set to the measured one when they switch on), or
/// where the machine homes without references, which move the commanded pose when they are found.
fn motion(axes: &[Axis], period_s: f64, before: &Telemetry, now: &Telemetry) -> Option<Motion> {
    let is_set = |report: &&Telemetry| {
        report.state.has_drives_off() || report.state == State::Homing && !report.homed
    };
    if [before, now].iter().any(is_set) || before.homed != now.homed {
        return None;
    }
    let time_s = now.period.checked_sub(before.period)? as f64 * period_s;
    if time_s <= 0.0 || time_s > SPEED_S {
        return None;
    }
    let changes = axes.iter().zip(now.commanded.iter().zip(&before.commanded));
    let linear = changes.filter(|(axis, _)| axis.kind == AxisKind::Linear);
    let square: f64 = linear
        .map(|(axis, (now, before))| {
            ((f64::from(*now) - f64::from(*before)) / per_unit(axis.kind)).powi(2)
        })
        .sum();
    Some(Motion {
        feed_mm_min: square.sqrt() / time_s * 60.0,
        is_moving: now.commanded != before.commanded,
    })
}

/// Period of the master telemetry, ms.
const MASTER_MS: u32 = 100;

impl App {
    pub(super) fn handle_notification(
        &mut self,
        notification: Notification,
    ) -> Result<(), CliError> {
        match notification {
            Notification::Connected(_) => self.handle_connection(),
            Notification::Answered {
                ticket,
                command,
                result,
            } => self.handle_answer(ticket, command, result),
            Notification::Event { period, event } => self.handle_event(period, &event),
            Notification::Telemetry(telemetry) => self.update_telemetry(*telemetry),
            Notification::Refused(refusal) => {
                let reason = self.session.describe(&refusal);
                self.notify(Severity::Warning, format!("jog: {reason}"));
            }
            Notification::Job(ending) => self.job_ended(&ending),
            Notification::Lost(_) if !self.connected_once => {
                return Err(CliError::new(Exit::Port, self.session.reason()));
            }
            Notification::Lost(_) => self.handle_link_loss(),
        }
        Ok(())
    }

    fn handle_answer(&mut self, ticket: Ticket, command: &str, result: Result<(), RequestError>) {
        let on_ack = self
            .requests
            .iter()
            .position(|(sent, _)| *sent == ticket)
            .map_or(OnAck::Nothing, |index| self.requests.swap_remove(index).1);
        if let Err(error) = result {
            match on_ack {
                OnAck::Override(..) => self.requested_overrides = self.overrides,
                OnAck::Loop(axis, settings) if self.retry_force_loop(axis, settings, &error) => {
                    return;
                }
                _ => {}
            }
            if let RequestError::Refused(Refusal::Input(InputProblem::LimitSwitch { joint })) =
                error
            {
                self.on_switch = Some(joint);
            }
            let reason = match &error {
                RequestError::Refused(refusal) => self.session.describe(refusal),
                RequestError::Withdrawn | RequestError::Lost(_) => return,
                other => other.to_string(),
            };
            let message = self.reject_master(&on_ack);
            let message = message.as_deref().unwrap_or(command);
            self.notify(Severity::Warning, format!("{message}: {reason}"));
            return;
        }
        match on_ack {
            OnAck::Nothing => {}
            OnAck::Enabled => self.notify(Severity::Info, "drives on"),
            OnAck::EnabledToHome => {
                self.notify(Severity::Info, "drives on");
                self.home();
            }
            OnAck::Override(kind, percent) => {
                self.overrides[kind as usize] = percent;
                self.note_overrides();
            }
            OnAck::Source(axis, source) => {
                self.sources[usize::from(axis)] = source;
                let name = &self.static_info.pose[usize::from(axis)].name;
                let message = format!("{name}: {source}");
                self.notify(Severity::Info, message);
            }
            OnAck::Loop(axis, settings) => {
                let axis = usize::from(axis);
                self.requested_loops[axis].in_flight = None;
                if let Some(loops) = &mut self.loops {
                    loops[axis] = settings;
                }
            }
            OnAck::ForceFeedback(_) | OnAck::Fixture { .. } | OnAck::PositionScale(_) => {
                self.acknowledge_master(&on_ack)
            }
            OnAck::Notify(message) => self.notify(Severity::Info, message),
        }
    }

    /// Queries the settings that another host may have changed, and subscribes to the master
    /// telemetry.
    pub(super) fn query_settings(&mut self) {
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

    /// Schedules a refused request again if the controller was busy, and returns true then.
    /// Settings requested meanwhile take precedence.
    fn retry_force_loop(&mut self, axis: u8, settings: ForceLoop, error: &RequestError) -> bool {
        let now_us = self.now_us();
        let requested = &mut self.requested_loops[usize::from(axis)];
        requested.in_flight = None;
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

    /// Sends the requested settings of the force loops.
    pub(super) fn send_force_loops(&mut self) {
        let now_us = self.now_us();
        for axis in 0..self.requested_loops.len() {
            let requested = &mut self.requested_loops[axis];
            if requested.in_flight.is_some() || now_us < requested.not_before_us {
                continue;
            }
            if let Some(settings) = requested.settings.take() {
                requested.in_flight = Some(settings);
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
                // The next motion starts at the exact commanded pose.
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
                if let Fault::LimitSwitch { joint } = fault {
                    self.on_switch = Some(*joint);
                }
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
        if let Event::MovedOff { .. }
        | Event::State {
            to: State::Idle, ..
        } = event
        {
            self.on_switch = None;
        }
        self.update_jobs(event);
        // Start and end of each jog and step are not logged.
        let routine = matches!(
            event,
            Event::State {
                from: State::Idle,
                to: State::Jog | State::Run,
                homed: true
            } | Event::State {
                from: State::Jog | State::Run,
                to: State::Idle,
                homed: true
            } | Event::JobDone { .. }
        );
        if !routine {
            let text = match (event, &self.jobs.pause) {
                (Event::Paused { .. }, Some(pause)) => format!("program pause in {pause}"),
                (Event::JogLimited { coordinate }, _) => {
                    let text = self.session.describe(event);
                    match self.machine.pose.get(usize::from(*coordinate)) {
                        Some(axis) => format!("{text} ({})", soft_limits(axis)),
                        None => text,
                    }
                }
                _ => self.session.describe(event),
            };
            self.notify(severity, text);
        }
    }

    /// A state at standstill completes a pending stop.
    fn clear_stop(&mut self, state: State) {
        if !matches!(state, State::Run | State::Jog | State::Homing | State::Hold)
            && !self.session.is_stopping()
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
                .map(|value| f64::from(*value).abs() / PER_EFFORT)
                .fold(0.0, f64::max);
            let fits = FORCE_SCALES
                .iter()
                .position(|scale| largest <= *scale)
                .unwrap_or(FORCE_SCALES.len() - 1);
            let (scale, since) = &mut self.force_scale;
            if fits >= *scale || since.elapsed() > SCALE_HOLD {
                (*scale, *since) = (fits, Instant::now());
            }
        }
        // The newest telemetry gets the state of an event, before the pose of that state is known.
        self.motion = self.reported.as_ref().and_then(|before| {
            let period_s = self.static_info.period_s;
            motion(&self.static_info.pose, period_s, before, &telemetry)
        });
        self.reported = Some(telemetry.clone());
        if let Some(recording) = &mut self.recording
            && let Err(reason) = recording.add(&telemetry)
        {
            self.recording = None;
            self.notify(Severity::Alarm, format!("recording ended: {reason}"));
        }
        self.show_program_messages(telemetry.setpoint);
        self.telemetry = Some(telemetry);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn feed_is_the_speed_of_the_tip_and_zero_at_standstill() {
        let axis = |kind| Axis {
            name: String::new(),
            kind,
        };
        let axes = [AxisKind::Linear, AxisKind::Linear, AxisKind::Rotary].map(axis);
        let report = |period: u64, x: f64, y: f64, tilt: i32| {
            let raw = |mm: f64| (mm * per_unit(AxisKind::Linear)).round() as i32;
            Telemetry {
                period,
                state: State::Idle,
                commanded: [raw(x), raw(y), tilt].into_iter().collect(),
                ..Telemetry::default()
            }
        };
        let before = report(1000, 1.0, 2.0, 0);
        let moved = |now: &Telemetry| motion(&axes, 2e-4, &before, now);
        // 0.5 mm along a diagonal in 100 periods of 0.2 ms: 25 mm/s.
        let diagonal = moved(&report(1100, 1.3, 2.4, 0)).unwrap();
        assert!((diagonal.feed_mm_min - 1500.0).abs() < 0.1 && diagonal.is_moving);
        let turning = moved(&report(1100, 1.0, 2.0, 500)).unwrap();
        assert!(turning.feed_mm_min == 0.0 && turning.is_moving);
        let still = moved(&report(1100, 1.0, 2.0, 0)).unwrap();
        assert!(still.feed_mm_min == 0.0 && !still.is_moving);
        assert_eq!(moved(&report(1000, 9.0, 2.0, 0)), None);
        assert_eq!(moved(&report(900, 9.0, 2.0, 0)), None);
        assert_eq!(moved(&report(9000, 9.0, 2.0, 0)), None);
    }

    fn along_a_line() -> [Axis; 1] {
        [Axis {
            name: String::new(),
            kind: AxisKind::Linear,
        }]
    }

    /// A report with one linear coordinate, mm.
    fn at(period: u64, state: State, homed: bool, x: f64) -> Telemetry {
        let raw = (x * per_unit(AxisKind::Linear)) as i32;
        Telemetry {
            period,
            state,
            homed,
            commanded: [raw].into_iter().collect(),
            ..Telemetry::default()
        }
    }

    #[test]
    fn a_commanded_pose_that_jumps_as_the_drives_switch_is_no_feed() {
        let moved =
            |before: &Telemetry, now: &Telemetry| motion(&along_a_line(), 2e-4, before, now);
        let idle = |period, x| at(period, State::Idle, false, x);
        for off in [State::Disabled, State::EmergencyStop] {
            let dark = |period| at(period, off, false, 0.0);
            let lit = idle(1250, 98.3);
            assert_eq!(moved(&dark(1000), &lit), None);
            assert_eq!(moved(&lit, &dark(1500)), None);
        }
        assert!(moved(&idle(0, 0.0), &idle(250, 0.0)).is_some());
    }

    /// The event of the new state comes before the first report with its pose.
    #[test]
    fn enabling_gives_no_feed_from_the_pose_before() {
        #[derive(clap::Parser)]
        struct Given {
            #[command(flatten)]
            console: crate::commands::console::ConsoleArgs,
        }
        let given: Given = clap::Parser::parse_from(["console"]);
        let mut app = super::super::open_app(given.console, false).unwrap();
        let report =
            |period, state, x| Notification::Telemetry(Box::new(at(period, state, false, x)));
        app.handle_notification(report(1000, State::Disabled, 0.0))
            .unwrap();
        let event = Event::State {
            from: State::Disabled,
            to: State::Idle,
            homed: true,
        };
        app.handle_event(1200, &event);
        app.handle_notification(report(1250, State::Idle, 98.3))
            .unwrap();
        assert_eq!(app.motion, None);
        app.handle_notification(report(1500, State::Idle, 98.3))
            .unwrap();
        assert_eq!(app.motion.map(|motion| motion.feed_mm_min), Some(0.0));
    }

    #[test]
    fn a_commanded_pose_that_the_references_move_is_no_feed() {
        let moved =
            |before: &Telemetry, now: &Telemetry| motion(&along_a_line(), 2e-4, before, now);
        let homing = |period, homed, x| at(period, State::Homing, homed, x);
        let (searching, found) = (homing(1000, false, 0.0), homing(1250, true, 98.3));
        assert_eq!(moved(&searching, &homing(1100, false, 5.0)), None);
        assert_eq!(moved(&searching, &found), None);
        assert!(moved(&found, &homing(1500, true, 98.4)).is_some());
    }
}
