//! The picture of now: everything that is to be seen, and what to do next in words.

use super::desk::{Desk, Owed, SCALES};
use super::hand::scale_of;
use super::shown::{ArmShown, Contact, Counters, HandShown, JogShown, ProgramShown, Shown, Weight};
use haptimill_protocol::message::State;
use std::sync::Arc;

impl Desk {
    /// What to do next, or what is wrong and what to do about it.
    fn prompt(&self) -> (Weight, String) {
        let alarm = |text: String| (Weight::Alarm, text);
        let note = |text: &str| (Weight::Note, text.to_string());
        match &self.contact {
            Contact::Opening => return note("opening the port"),
            Contact::Greeting => return note("waiting for the controller's answer"),
            Contact::Configuring => return note("sending the machine file to the controller"),
            Contact::Lost(why) => {
                let owed = match self.owed {
                    Owed::Nothing => "",
                    Owed::Stop => " A STOP goes out first.",
                    Owed::Emergency => " An EMERGENCY STOP goes out first.",
                };
                return alarm(format!("NO LINK, trying again.{owed} ({why})"));
            }
            Contact::Ready => {}
        }
        let Some(telemetry) = &self.telemetry else {
            return note("waiting for the controller's report");
        };
        if let (State::Fault, Some(fault)) = (telemetry.state, &self.fault) {
            let what = self
                .model
                .with_axes(|axes| axes.describe(fault).to_string());
            return alarm(format!("FAULT: {what}. Key: x resets"));
        }
        if !self.configured && telemetry.state != State::EmergencyStop {
            return (
                Weight::Warning,
                "the controller has another configuration: names and numbers may be wrong. d disables, e sends the machine file".to_string(),
            );
        }
        match telemetry.state {
            State::Fault => alarm("FAULT; x resets".to_string()),
            State::EmergencyStop => {
                alarm("EMERGENCY STOP: drives off. Release the cause, then x resets".to_string())
            }
            State::Disabled => note("drives off. e enables them"),
            State::Idle if !telemetry.homed => note("not homed. h homes: the machine moves"),
            State::Idle if !telemetry.position_kept => {
                (Weight::Warning, "position lost. h homes".to_string())
            }
            State::Idle => match self.work.offered() {
                Some(name) => (Weight::Note, format!("ready. Jog, or p runs {name}")),
                None => note("ready. Jog, or p chooses a part program"),
            },
            State::Homing => note("homing. Space stops"),
            State::Run if self.work.runs_step() => note("step. Space stops"),
            State::Run => note("running. Space holds, Ctrl-X stops"),
            State::Jog => note("jogging. Ends with the key, or with Space"),
            State::Hold if self.stopping.is_some() => note("stopping"),
            State::Hold => (
                Weight::Warning,
                match self.work.pause_line {
                    Some(line) => {
                        format!(
                            "pause of the program in line {line}. Ctrl-R goes on, Ctrl-X drops it"
                        )
                    }
                    None => "on hold. Ctrl-R resumes, Ctrl-X drops the program".to_string(),
                },
            ),
        }
    }

    /// The hand, if the machine has one.
    fn hand_shown(&self) -> Option<HandShown> {
        let hand = self.hand.as_ref()?;
        let arm = hand.arm.as_ref().map(|arm| {
            let report = self.client.master().copied();
            let problem = report.and_then(|report| report.problem).map(|problem| {
                self.model
                    .with_axes(|axes| axes.describe(&problem).to_string())
            });
            ArmShown {
                report,
                age: arm.age(),
                problem,
                reflection: arm.reflection.now,
                reflection_sure: arm.reflection.sure,
                faces: arm.faces,
            }
        });
        let scale = hand.scale.map(|scale| (scale_of(scale.now), scale.sure));
        Some(HandShown { arm, scale })
    }

    /// The picture of now.
    pub(super) fn shown(&self) -> Shown {
        let now_us = self.now_us();
        let counters = self.client.link().counters();
        let program = self.work.checked.as_ref().map(|checked| ProgramShown {
            name: checked.name.clone(),
            duration_s: checked.plan.figures.duration_s,
            runs: self.work.runs_program(),
            line: self
                .telemetry
                .as_ref()
                .filter(|_| self.work.runs_program())
                .map_or(0, |telemetry| {
                    checked.plan.line_of(telemetry.setpoint as usize)
                }),
            lines: checked.lines,
        });
        Shown {
            fixed: Arc::clone(&self.fixed),
            elapsed: self.begun.elapsed(),
            machine: self.machine.config.name.to_string(),
            contact: self.contact.clone(),
            counters: Counters {
                round_trip_us: self.client.link().round_trip_us(),
                bad_frames: counters.bad_frames,
                resent: counters.resent,
                reconnects: self.reconnects,
            },
            telemetry: self.telemetry.clone(),
            age: self.telemetry_at.elapsed(),
            prompt: self.prompt(),
            log: self.log.clone(),
            overlay: self.overlay.clone(),
            sources: self.sources,
            feed_override: self.feed_override,
            jog: JogShown {
                mode: self.jogging.mode(),
                rate: self.jogging.rate(),
                step: self.jogging.step(),
                dead_man_ms: self.jogging.dead_man_ms(),
                releases_told: self.jogging.releases_told(),
                held: self.jogging.held(now_us),
            },
            program,
            offered: self.work.offered(),
            loops: self.loops,
            force_scale_n: SCALES[self.force_scale.0],
            hand: self.hand_shown(),
            recording: self.recording.as_ref().map(|recording| {
                let name = recording.path.file_name().unwrap_or_default();
                (name.to_string_lossy().into_owned(), recording.rows)
            }),
            stopping: self.stopping,
        }
    }
}
