//! Construction of the view model and of the operator prompt.

use super::app::{App, FORCE_SCALES};
use super::master::to_ratio;
use super::view_model::{
    ArmView, Counters, JogView, LinkState, MasterView, ProgramView, Severity, ViewModel,
};
use haptimill_protocol::message::{Fault, State};
use std::sync::Arc;

/// Spindle speed at an override in percent, as the controller computes it outside of tapping.
fn overridden(rpm: i16, percent: u8) -> i16 {
    let rpm = i32::from(rpm) * i32::from(percent) / 100;
    rpm.clamp(-i32::from(i16::MAX), i32::from(i16::MAX)) as i16
}

impl App {
    /// Next action of the operator, or the fault with its remedy.
    fn prompt(&self) -> (Severity, String) {
        let alarm = |text: String| (Severity::Alarm, text);
        let note = |text: &str| (Severity::Info, text.to_string());
        match self.link_state() {
            LinkState::Opening => return note("opening the port"),
            LinkState::Handshake => return note("waiting for the controller's answer"),
            LinkState::Configuring => return note("sending the machine file to the controller"),
            LinkState::Lost(reason) => {
                let pending_stop = if self.session.is_emergency_pending() {
                    " EMERGENCY STOP pending, sent first."
                } else if self.session.is_stopping() {
                    " STOP pending, sent first."
                } else {
                    ""
                };
                return alarm(format!("NO LINK, reconnecting.{pending_stop} ({reason})"));
            }
            LinkState::Ready => {}
        }
        let Some(telemetry) = &self.telemetry else {
            return note("waiting for telemetry");
        };
        if let (State::Fault, Some(fault)) = (telemetry.state, &self.fault) {
            let message = self.session.describe(fault);
            let keys = match fault {
                Fault::LimitSwitch { .. } => "b moves it off, x resets",
                _ => "x resets",
            };
            return alarm(format!("FAULT ({keys}): {message}"));
        }
        if !self.session.is_configured() && telemetry.state != State::EmergencyStop {
            return (
                Severity::Warning,
                "the controller has a different configuration: names and values may be wrong. \
                 d disables the drives, e sends the machine file"
                    .to_string(),
            );
        }
        match telemetry.state {
            State::Fault => alarm("FAULT; x resets".to_string()),
            State::EmergencyStop => {
                alarm("EMERGENCY STOP: drives off. Remove the cause, then x resets".to_string())
            }
            State::Disabled if self.on_switch.is_some() => (
                Severity::Warning,
                "a joint is on its limit switch. b moves it off".to_string(),
            ),
            State::Disabled if !telemetry.homed => {
                note("drives off, not homed. h enables and homes: the machine moves")
            }
            State::Disabled => note("drives off. e enables them"),
            State::Idle if !telemetry.homed => note("not homed. h homes: the machine moves"),
            State::Idle => match self.jobs.selected_name() {
                Some(name) => (Severity::Info, format!("ready. Jog, or p runs {name}")),
                None => note("ready. Jog, or p selects a part program"),
            },
            State::Homing => note("homing. Space stops"),
            State::Run if self.jobs.is_running_step() => note("step. Space stops"),
            State::Run => note("running. Space holds, Ctrl-X stops"),
            State::Jog => note("jogging. Release the key or press Space to stop"),
            State::Hold if self.stopping.is_some() => note("stopping"),
            State::Hold => (
                Severity::Warning,
                match &self.jobs.pause {
                    Some(pause) => {
                        format!(
                            "program pause in {pause}. Ctrl-R resumes, Ctrl-X drops the program"
                        )
                    }
                    None => "on hold. Ctrl-R resumes, Ctrl-X drops the program".to_string(),
                },
            ),
        }
    }

    /// Haptic arm and position scale, if the machine has them.
    fn master_view(&self) -> Option<MasterView> {
        let master = self.master.as_ref()?;
        let arm = master.arm.as_ref().map(|arm| {
            let report = self.session.client().master().copied();
            let problem = report.and_then(|report| report.problem).map(|problem| {
                self.model
                    .with_axes(|axes| axes.describe(&problem).to_string())
            });
            ArmView {
                report,
                age: arm.age(),
                problem,
                feedback: arm.feedback.active,
                feedback_known: arm.feedback.is_known,
                faces: arm.faces,
            }
        });
        let scale = master
            .scale
            .map(|scale| (to_ratio(scale.active), scale.is_known));
        Some(MasterView { arm, scale })
    }

    /// The present view model.
    pub(super) fn view_model(&self) -> ViewModel {
        let now_us = self.now_us();
        let counters = self.session.client().link().counters();
        let is_running = self.jobs.is_running_program();
        let telemetry = self.telemetry.as_ref().filter(|_| is_running);
        let program = self.jobs.checked.as_ref().map(|checked| {
            let line = match (&self.jobs.pause, telemetry) {
                (Some(pause), _) => pause.line,
                (None, Some(telemetry)) => checked.plan.line_of(telemetry.setpoint as usize),
                (None, None) => 0,
            };
            ProgramView {
                name: checked.name.clone(),
                duration_s: checked.plan.figures.duration_s,
                left_s: checked
                    .times
                    .left_s(telemetry.map_or(0, |telemetry| u64::from(telemetry.program_periods))),
                is_running,
                line,
                lines: checked.lines,
                text: checked.text_of(line).to_string(),
                spindle_rpm: telemetry
                    .and_then(|telemetry| checked.spindle_rpm(telemetry.setpoint))
                    .map(|rpm| overridden(rpm, self.overrides[2])),
            }
        });
        ViewModel {
            static_info: Arc::clone(&self.static_info),
            elapsed: self.started.elapsed(),
            machine: self.machine.config.name.to_string(),
            link_state: self.link_state(),
            counters: Counters {
                round_trip_us: self.session.client().link().round_trip_us(),
                bad_frames: counters.bad_frames,
                resent: counters.resent,
                reconnects: self.reconnects,
            },
            telemetry: self.telemetry.clone(),
            age: self.telemetry_at.elapsed(),
            prompt: self.prompt(),
            log: self.log.clone(),
            overlay: self.overlay.clone(),
            last_scroll: Arc::clone(&self.last_scroll),
            sources: self.sources,
            overrides: self.overrides,
            motion: self.motion,
            jog: JogView {
                mode: self.jogging.mode(),
                rate: self.jogging.rate(),
                step: self.jogging.step(),
                jog_timeout_ms: self.jogging.jog_timeout_ms(),
                has_release_events: self.jogging.has_release_events(),
                held: self.jogging.held(now_us),
            },
            program,
            selected_name: self.jobs.selected_name(),
            loops: self.loops,
            force_scale_n: FORCE_SCALES[self.force_scale.0],
            master: self.master_view(),
            recording: self.recording.as_ref().map(|recording| {
                let name = recording.path.file_name().unwrap_or_default();
                (name.to_string_lossy().into_owned(), recording.rows)
            }),
            stopping: self.stopping,
        }
    }
}
