//! From keys to orders.

use super::app::{App, OnAck, PendingStop};
use super::jogging::{KeyPhase, Mode};
use super::keys::{Action, BINDINGS, Key};
use super::recording::Recording;
use super::view_model::{Confirm, LinkState, Overlay, Severity};
use haptimill_protocol::message::{Command, Source, State};
use ratatui::crossterm::event::{Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

/// Feed overrides to choose from, percent.
const OVERRIDES: [u8; 13] = [1, 2, 5, 10, 20, 30, 40, 50, 60, 70, 80, 90, 100];

/// Change of a desired force for one key, 2^-16 N: 0.5 N.
const FORCE_STEP: i32 = 1 << 15;

/// A program is run by an Enter that comes at least so long after the question, microseconds: not by the one that chose the file, pressed twice.
const CONFIRM_DELAY_US: u64 = 400_000;

impl App {
    /// Something came from the terminal.
    pub(super) fn handle_input(&mut self, event: &Event) {
        match event {
            Event::Key(key) => self.key(key),
            Event::Paste(text) => match &mut self.overlay {
                Overlay::Prompt { text: typed, .. } => {
                    typed.extend(text.chars().take_while(|letter| !letter.is_control()));
                }
                _ => self.notify(Severity::Warning, "pasted text is not heard as keys"),
            },
            Event::FocusLost => {
                let now_us = self.now_us();
                if self.jogging.held(now_us).iter().any(Option::is_some) {
                    self.jogging.release_all(now_us);
                    self.notify(Severity::Warning, "the window lost the keyboard: jog ended");
                }
            }
            Event::FocusGained | Event::Mouse(_) | Event::Resize(..) => {}
        }
    }

    fn key(&mut self, event: &KeyEvent) {
        let mut key = Key::of(event);
        let phase = match event.kind {
            KeyEventKind::Press => KeyPhase::Press,
            KeyEventKind::Repeat => KeyPhase::Repeat,
            KeyEventKind::Release => KeyPhase::Release,
        };
        if phase == KeyPhase::Release {
            // Whatever is open by now, a key that was let go moves nothing any more.
            if let Some(Action::Jog { axis, up }) = key.action() {
                let now_us = self.now_us();
                self.jogging.key(usize::from(axis), up, phase, now_us);
            }
            return;
        }
        if let Some(action) = key.always_active() {
            if phase == KeyPhase::Press {
                self.execute(action);
            }
            return;
        }
        if event.modifiers.contains(KeyModifiers::ALT) {
            // Escape and a key in one read look like this: the Escape counts, for the key may be a part of something torn.
            key = Key::of(&KeyEvent::from(KeyCode::Esc));
        }
        match std::mem::replace(&mut self.overlay, Overlay::None) {
            Overlay::None => match key.action() {
                Some(Action::Jog { axis, up }) => self.jog_key(usize::from(axis), up, phase),
                Some(action) if phase == KeyPhase::Press => self.execute(action),
                _ => {}
            },
            Overlay::Help { from } => {
                self.overlay = scroll(key, from, BINDINGS.len())
                    .map_or(Overlay::None, |from| Overlay::Help { from })
            }
            Overlay::Problems { lines, from } => {
                if let Some(from) = scroll(key, from, lines.len()) {
                    self.overlay = Overlay::Problems { lines, from };
                }
            }
            Overlay::Confirm(confirm) => self.confirm_key(confirm, key),
            Overlay::Prompt { title, text } => self.prompt_key(title, text, key),
            Overlay::Axes { at } => self.axes_key(at, key),
            Overlay::Force { at } => self.force_key(at, key),
            Overlay::Master { at, typed } => self.master_key(at, typed, key),
        }
    }

    /// Does what a key asks for; from the table, so with nothing open, or always.
    fn execute(&mut self, action: Action) {
        match action {
            Action::Hold => self.hold(),
            Action::Resume => self.resume(),
            Action::Stop => self.stop(),
            Action::Emergency => self.emergency(),
            Action::Quit => self.quit(),
            Action::Close => self.hold(),
            Action::Help => self.open(Overlay::Help { from: 0 }),
            Action::Mode => self.jogging.toggle_mode(),
            Action::Decrease => self.jogging.select(false),
            Action::Increase => self.jogging.select(true),
            Action::Record => self.record(),
            Action::Jog { .. } => {}
            _ if !self.is_ready() => self.notify(Severity::Warning, "no link to the controller"),
            Action::Enable => {
                if !self.configured {
                    self.send_configuration();
                }
                self.request(Command::Enable, OnAck::Enabled);
            }
            Action::Disable => self.request(Command::Disable, OnAck::Say("drives off")),
            Action::Reset => self.request(Command::Reset, OnAck::Say("reset")),
            Action::Home => match self.state() {
                Some(State::Idle) => self.open(Overlay::Confirm(Confirm::Home)),
                Some(state) => {
                    let what = format!("home: not possible while the machine is {state}");
                    self.notify(Severity::Warning, what);
                }
                None => {}
            },
            Action::OverrideUp => self.select_override(true),
            Action::OverrideDown => self.select_override(false),
            Action::Program => {
                let text = self.jobs.path();
                self.open(Overlay::Prompt {
                    title: "Part program",
                    text,
                });
            }
            Action::Axes => self.open(Overlay::Axes { at: 0 }),
            Action::Master => {
                if let Some(overlay) = self.open_master_overlay() {
                    self.open(overlay);
                }
            }
            Action::Force if self.loops.is_some() => self.open(Overlay::Force { at: 0 }),
            Action::Tare if self.loops.is_some() => self.open(Overlay::Confirm(Confirm::Tare)),
            Action::Force | Action::Tare => {
                self.notify(Severity::Warning, "this machine has no force sensor");
            }
        }
    }

    fn open(&mut self, overlay: Overlay) {
        let now_us = self.now_us();
        self.jogging.release_all(now_us);
        self.opened_us = now_us;
        self.overlay = overlay;
    }

    /// Everything that moves slows down; a program keeps its place.
    fn hold(&mut self) {
        let now_us = self.now_us();
        self.jogging.release_all(now_us);
        self.jobs.cancel_pending();
        if !self.is_ready() {
            self.queue_stop(PendingStop::Stop);
        } else if self.jobs.is_running_step() {
            // Of a step nothing is worth keeping.
            self.stop();
        } else {
            self.request(Command::Hold, OnAck::Nothing);
        }
    }

    fn resume(&mut self) {
        if self.is_ready() && self.state() == Some(State::Hold) {
            self.jobs.pause_line = None;
            self.request(Command::Resume, OnAck::Nothing);
        } else {
            self.notify(Severity::Warning, "resume: nothing is on hold");
        }
    }

    fn stop(&mut self) {
        let now_us = self.now_us();
        self.jogging.release_all(now_us);
        self.jobs.cancel_pending();
        self.client.urgent_stop();
        if self.is_ready() {
            self.stopping = Some("stop");
        } else {
            self.queue_stop(PendingStop::Stop);
        }
    }

    fn emergency(&mut self) {
        self.stop();
        if self.is_ready() {
            self.request(Command::EmergencyStop, OnAck::Nothing);
            self.stopping = Some("emergency stop");
        } else {
            self.queue_stop(PendingStop::Emergency);
        }
    }

    /// A stop that goes out as soon as there is a line.
    fn queue_stop(&mut self, what: PendingStop) {
        self.pending_stop = self.pending_stop.max(what);
        self.notify(
            Severity::Alarm,
            "no link: the stop goes out first when the line is back. Use the emergency stop of the machine",
        );
    }

    fn quit(&mut self) {
        let ms = self.machine.config.supervision.heartbeat_ms;
        let text = match (&self.link_state, self.state()) {
            (LinkState::Ready, Some(State::Disabled | State::EmergencyStop)) => {
                self.quitting = true;
                return;
            }
            (LinkState::Ready, Some(State::Idle | State::Fault)) => {
                "nothing moves; the drives stay on and hold".to_string()
            }
            (LinkState::Ready, _) => {
                "the machine slows down along its path, what runs is dropped, the drives stay on"
                    .to_string()
            }
            _ => format!("no link: what moves stops by itself after {ms} ms of silence"),
        };
        self.open(Overlay::Confirm(Confirm::Quit(text)));
    }

    fn jog_key(&mut self, axis: usize, up: bool, phase: KeyPhase) {
        if axis >= self.machine.pose.len() {
            return;
        }
        if !self.is_ready() {
            self.notify(Severity::Warning, "no link to the controller");
            return;
        }
        let jog_source = self.sources.contains(&Source::Jog);
        let possible = match self.state() {
            Some(State::Idle) => true,
            Some(State::Jog) => self.jogging.mode() == Mode::Continuous,
            Some(State::Run | State::Hold) => {
                self.jobs.is_running_step()
                    || (jog_source && self.jogging.mode() == Mode::Continuous)
            }
            _ => false,
        };
        if !possible || !self.configured {
            let state = self
                .state()
                .map_or_else(String::new, |state| state.to_string());
            if self.configured {
                self.notify(
                    Severity::Warning,
                    format!("jog: not possible while the machine is {state}"),
                );
            }
            return;
        }
        if !self.telemetry.as_ref().is_some_and(|now| now.homed) {
            self.notify(Severity::Warning, "jog: home the machine first");
            return;
        }
        match (self.jogging.mode(), phase) {
            (Mode::Step, KeyPhase::Press) => self.step_axis(axis, up),
            (Mode::Step, _) => {}
            (Mode::Continuous, phase) => {
                let now_us = self.now_us();
                self.jogging.key(axis, up, phase, now_us);
            }
        }
    }

    fn select_override(&mut self, up: bool) {
        let now = self.requested_override;
        let next = if up {
            OVERRIDES.iter().find(|percent| **percent > now)
        } else {
            OVERRIDES.iter().rev().find(|percent| **percent < now)
        };
        if let Some(percent) = next {
            let percent = *percent;
            self.requested_override = percent;
            self.request(Command::Override { percent }, OnAck::Override(percent));
        }
    }

    fn record(&mut self) {
        if let Some(recording) = self.recording.take() {
            let what = format!("{}: {} rows", recording.path.display(), recording.rows);
            self.notify(Severity::Info, what);
            return;
        }
        match Recording::begin(&self.settings.folder, &self.machine) {
            Ok(recording) => {
                let what = format!("recording to {}", recording.path.display());
                self.recording = Some(recording);
                self.notify(Severity::Info, what);
            }
            Err(why) => self.notify(Severity::Warning, why),
        }
    }

    fn confirm_key(&mut self, confirm: Confirm, key: Key) {
        if key.code != KeyCode::Enter {
            return;
        }
        match confirm {
            Confirm::Run(text) => {
                if self.now_us() < self.opened_us + CONFIRM_DELAY_US {
                    self.overlay = Overlay::Confirm(Confirm::Run(text));
                } else {
                    self.run_program();
                }
            }
            Confirm::Home => {
                self.jobs.home();
                self.request(Command::Home, OnAck::Nothing);
            }
            Confirm::Tare => self.request(Command::Tare, OnAck::Say("tare begun")),
            Confirm::Quit(_) => self.quitting = true,
        }
    }

    fn prompt_key(&mut self, title: &'static str, mut text: String, key: Key) {
        match key.code {
            KeyCode::Esc => return,
            KeyCode::Char('c') if key.control => return,
            KeyCode::Enter => {
                if !text.is_empty() {
                    self.check_program(&text);
                }
                return;
            }
            KeyCode::Backspace => {
                text.pop();
            }
            KeyCode::Char('u') if key.control => text.clear(),
            KeyCode::Char(letter) if !key.control => text.push(letter),
            _ => {}
        }
        self.overlay = Overlay::Prompt { title, text };
    }

    fn axes_key(&mut self, at: usize, key: Key) {
        let last = self.machine.pose.len().saturating_sub(1);
        let source = match key.code {
            KeyCode::Up => {
                return self.overlay = Overlay::Axes {
                    at: at.saturating_sub(1),
                };
            }
            KeyCode::Down => {
                return self.overlay = Overlay::Axes {
                    at: (at + 1).min(last),
                };
            }
            KeyCode::Char('p') => Source::Program,
            KeyCode::Char('h') => Source::Hold,
            KeyCode::Char('j') => Source::Jog,
            KeyCode::Char('m') => Source::Master,
            KeyCode::Esc | KeyCode::Enter | KeyCode::Char('a' | 'q') => return,
            _ => return self.overlay = Overlay::Axes { at },
        };
        self.overlay = Overlay::Axes { at };
        let axis = at as u8;
        self.request(
            Command::Source { axis, source },
            OnAck::Source(axis, source),
        );
    }

    fn force_key(&mut self, at: usize, key: Key) {
        let Some(loops) = self.loops else { return };
        let change = match key.code {
            KeyCode::Up => {
                return self.overlay = Overlay::Force {
                    at: at.saturating_sub(1),
                };
            }
            KeyCode::Down => {
                return self.overlay = Overlay::Force {
                    at: (at + 1).min(2),
                };
            }
            KeyCode::Enter => {
                let mask = self
                    .telemetry
                    .as_ref()
                    .and_then(|now| now.force.as_ref())
                    .map_or(0, |force| force.mask);
                let mask = mask ^ (1 << at);
                self.request(Command::ForceMask { mask }, OnAck::Nothing);
                0
            }
            KeyCode::Char('+' | '=') => FORCE_STEP,
            KeyCode::Char('-') => -FORCE_STEP,
            KeyCode::Esc | KeyCode::Char('y' | 'q') => return,
            _ => 0,
        };
        self.overlay = Overlay::Force { at };
        if change != 0 {
            let requested = &mut self.requested_loops[at];
            let mut settings = requested.newest().unwrap_or(loops[at]);
            settings.desired = settings.desired.saturating_add(change);
            requested.settings = Some(settings);
        }
    }
}

/// The row from which a list is shown after a key; none when the key leaves it.
fn scroll(key: Key, from: usize, rows: usize) -> Option<usize> {
    match key.code {
        KeyCode::Up => Some(from.saturating_sub(1)),
        KeyCode::Down => Some((from + 1).min(rows.saturating_sub(1))),
        KeyCode::PageUp => Some(from.saturating_sub(10)),
        KeyCode::PageDown => Some((from + 10).min(rows.saturating_sub(1))),
        _ => None,
    }
}
