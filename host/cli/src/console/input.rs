//! Key input to commands.

use super::app::{App, OnAck, OverrideKind};
use super::jogging::{KeyPhase, Mode};
use super::keys::{Action, Key};
use super::recording::Recording;
use super::view_model::{Confirm, LinkState, Overlay, Severity};
use crate::commands::exit::{CliError, Exit};
use crate::commands::jog::{CoordinateValue, coordinate_index};
use crate::commands::probe_cycle::{kept_beside, set_origin};
use crate::commands::run::overrides;
use haptimill_machine_file::work_data::offsets_path;
use haptimill_protocol::message::{Command, Fault, Source, State};
use ratatui::crossterm::event::{Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use std::sync::atomic::Ordering;

/// Change of a force setpoint per key press, 2^-16 N: 0.5 N.
const FORCE_STEP: i32 = 1 << 15;

/// Shortest time between the question and the Enter that starts a program, us. The Enter that
/// selected the file, pressed twice, starts nothing.
const CONFIRM_DELAY_US: u64 = 400_000;

/// Title of the prompt for a work offset.
pub(super) const ZERO: &str = "Work offset: coordinates of the present position";

impl App {
    /// Makes the present position the place of coordinates, as `g54,x=0,z=2`. Spaces separate, too;
    /// on the keyboard, Space holds the machine.
    pub(super) fn set_zero(&mut self, text: &str) {
        match self.zero_of(text) {
            Ok(written) => self.notify(Severity::Info, written),
            Err(error) => self.notify(Severity::Warning, error.message),
        }
    }

    fn zero_of(&self, text: &str) -> Result<String, CliError> {
        let usage = |what: String| CliError::new(Exit::Usage, format!("zero: {what}"));
        let is_separator = |letter: char| letter == ',' || letter.is_whitespace();
        let mut words = text.split(is_separator).filter(|word| !word.is_empty());
        let system = words
            .next()
            .ok_or_else(|| usage("write a system and coordinates, as g54,x=0".to_string()))?;
        let homed = self.telemetry.as_ref().is_some_and(|now| now.homed);
        let pose = self.standstill_pose().filter(|_| homed);
        let pose = pose.ok_or_else(|| usage("the machine must be homed and idle".to_string()))?;
        let here = self.model.to_engineering_units(&pose);
        let mut origins = Vec::new();
        for word in words {
            let value: CoordinateValue = word.parse().map_err(usage)?;
            let axis = coordinate_index(&self.machine, &value.coordinate)?;
            origins.push((axis, here[axis] - value.value));
        }
        if origins.is_empty() {
            return Err(usage("name the coordinates, as g54,x=0,y=0".to_string()));
        }
        let file = kept_beside(&self.machine)?;
        set_origin(&self.machine, &file, system, &origins)?;
        Ok(format!("{} written", offsets_path(&file).display()))
    }

    /// Handles an event of the terminal.
    pub(super) fn handle_input(&mut self, event: &Event) {
        match event {
            Event::Key(key) => self.handle_key(key),
            Event::Paste(text) => match &mut self.overlay {
                Overlay::Prompt { text: typed, .. } => {
                    typed.extend(text.chars().take_while(|letter| !letter.is_control()));
                }
                Overlay::Programs(picker) => {
                    let picker = std::mem::take(picker);
                    self.paste_path(picker, text);
                }
                _ => self.notify(Severity::Warning, "pasted text is not taken as key input"),
            },
            Event::FocusLost => {
                let now_us = self.now_us();
                if self.jogging.held(now_us).iter().any(Option::is_some) {
                    self.jogging.release_all(now_us);
                    self.notify(Severity::Warning, "keyboard focus lost: jog ended");
                }
            }
            Event::FocusGained | Event::Mouse(_) | Event::Resize(..) => {}
        }
    }

    fn handle_key(&mut self, event: &KeyEvent) {
        let mut key = Key::from_event(event);
        let phase = match event.kind {
            KeyEventKind::Press => KeyPhase::Press,
            KeyEventKind::Repeat => KeyPhase::Repeat,
            KeyEventKind::Release => KeyPhase::Release,
        };
        if phase == KeyPhase::Release {
            // A release ends a jog whatever is open.
            if let Some(Action::Jog { coordinate, up }) = key.action() {
                let now_us = self.now_us();
                self.jogging
                    .handle_key(usize::from(coordinate), up, phase, now_us);
            }
            return;
        }
        if let Some(action) = key.always_active_action() {
            if phase == KeyPhase::Press {
                self.execute(action);
            }
            return;
        }
        if event.modifiers.contains(KeyModifiers::ALT) {
            // An Escape read together with a key looks like Alt. Only the Escape counts: the key
            // may be part of a split sequence.
            key = Key::from_event(&KeyEvent::from(KeyCode::Esc));
        }
        let last_scroll = self.last_scroll.load(Ordering::Relaxed);
        match std::mem::replace(&mut self.overlay, Overlay::None) {
            Overlay::None => match key.action() {
                Some(Action::Jog { coordinate, up }) => {
                    self.jog_key(usize::from(coordinate), up, phase)
                }
                Some(action) if phase == KeyPhase::Press => self.execute(action),
                _ => {}
            },
            Overlay::Help { from } => {
                self.overlay = scroll(key, from, last_scroll)
                    .map_or(Overlay::None, |from| Overlay::Help { from })
            }
            Overlay::Problems { lines, from } => {
                if let Some(from) = scroll(key, from, last_scroll) {
                    self.overlay = Overlay::Problems { lines, from };
                }
            }
            Overlay::Confirm(confirm) => self.confirm_key(confirm, key),
            Overlay::Prompt { title, text } => self.prompt_key(title, &text, key),
            Overlay::Programs(picker) => self.picker_key(picker, key),
            Overlay::Sources { selected } => self.sources_key(selected, key),
            Overlay::Force { selected } => self.force_key(selected, key),
            Overlay::Master { position, typed } => self.master_key(position, typed, key),
        }
    }

    /// Executes an action of the key table.
    pub(super) fn execute(&mut self, action: Action) {
        match action {
            Action::Hold => self.hold(),
            Action::Resume => self.resume(),
            Action::Stop => self.stop(),
            Action::Emergency => self.emergency_stop(),
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
                self.enable(OnAck::Enabled);
            }
            Action::Disable => self.request(Command::Disable, OnAck::Notify("drives off")),
            Action::Reset => self.request(Command::Reset, OnAck::Notify("reset")),
            Action::Home => match self.state() {
                Some(State::Idle) => self.open(Overlay::Confirm(Confirm::Home)),
                Some(State::Disabled) => self.open(Overlay::Confirm(Confirm::EnableAndHome)),
                Some(state) => {
                    let message = format!("home: not possible while the machine is {state}");
                    self.notify(Severity::Warning, message);
                }
                None => {}
            },
            Action::MoveOff => self.ask_to_move_off(),
            Action::OverrideUp => self.select_override(OverrideKind::Feed, true),
            Action::OverrideDown => self.select_override(OverrideKind::Feed, false),
            Action::RapidUp => self.select_override(OverrideKind::Rapid, true),
            Action::RapidDown => self.select_override(OverrideKind::Rapid, false),
            Action::SpindleUp => self.select_override(OverrideKind::Spindle, true),
            Action::SpindleDown => self.select_override(OverrideKind::Spindle, false),
            Action::Program => self.open_picker(),
            Action::Zero => {
                let axes = self.machine.pose.iter().take(2);
                let axes: String = axes.map(|axis| format!(",{}=0", axis.name)).collect();
                let text = format!("g54{axes}");
                self.open(Overlay::Prompt { title: ZERO, text });
            }
            Action::Sources => self.open(Overlay::Sources { selected: 0 }),
            Action::Master => {
                if let Some(overlay) = self.open_master_overlay() {
                    self.open(overlay);
                }
            }
            Action::Force if self.loops.is_some() => self.open(Overlay::Force { selected: 0 }),
            Action::Tare if self.loops.is_some() => self.open(Overlay::Confirm(Confirm::Tare)),
            Action::Force | Action::Tare => {
                self.notify(Severity::Warning, "this machine has no force sensor");
            }
        }
    }

    /// Switches the drives on, after the machine file that the controller refused before.
    fn enable(&mut self, on_ack: OnAck) {
        if !self.session.is_configured()
            && let Err(error) = self.session.restart()
        {
            self.notify(Severity::Warning, error.message);
        }
        self.request(Command::Enable, on_ack);
    }

    /// Asks whether to move the joint of the fault, or of the refused enable, off its limit switch.
    fn ask_to_move_off(&mut self) {
        let state = self.state();
        let at_fault = state == Some(State::Fault);
        let joint = match self.fault {
            Some(Fault::LimitSwitch { joint }) if at_fault => Some(joint),
            _ => self.on_switch.filter(|_| state == Some(State::Disabled)),
        };
        match (joint, state) {
            (Some(joint), _) => {
                let joint = usize::from(joint);
                self.open(Overlay::Confirm(Confirm::MoveOff(joint)));
            }
            (None, Some(State::Disabled)) => {
                let what = "move off: no joint is known to be on its limit switch; enable, which \
                            names it";
                self.notify(Severity::Warning, what);
            }
            (None, Some(state)) => {
                let what = format!("move off: not possible while the machine is {state}");
                self.notify(Severity::Warning, what);
            }
            (None, None) => {}
        }
    }

    /// Moves a joint off its limit switch.
    fn move_off(&mut self, joint: usize) {
        if self.state() == Some(State::Fault) {
            self.request(Command::Reset, OnAck::Nothing);
        }
        self.request(Command::MoveOff { joint: joint as u8 }, OnAck::Nothing);
    }

    /// Homes the enabled machine.
    pub(super) fn home(&mut self) {
        self.jobs.home();
        self.request(Command::Home, OnAck::Nothing);
    }

    pub(super) fn open(&mut self, overlay: Overlay) {
        let now_us = self.now_us();
        self.jogging.release_all(now_us);
        self.opened_us = now_us;
        self.overlay = overlay;
    }

    /// Decelerates; a program keeps its place.
    fn hold(&mut self) {
        if !self.is_ready() || self.jobs.is_running_step() {
            // A step has no place to keep, and only a stop needs no session.
            self.stop();
            return;
        }
        let now_us = self.now_us();
        self.jogging.release_all(now_us);
        self.jobs.cancel_pending();
        self.request(Command::Hold, OnAck::Nothing);
    }

    fn resume(&mut self) {
        if self.is_ready() && self.state() == Some(State::Hold) {
            self.jobs.pause = None;
            self.request(Command::Resume, OnAck::Nothing);
        } else {
            self.notify(Severity::Warning, "resume: the machine is not on hold");
        }
    }

    fn stop(&mut self) {
        self.prepare_stop("stop");
        self.session.stop();
    }

    fn emergency_stop(&mut self) {
        self.prepare_stop("emergency stop");
        self.session.emergency_stop();
    }

    fn prepare_stop(&mut self, name: &'static str) {
        let now_us = self.now_us();
        self.jogging.release_all(now_us);
        self.jobs.cancel_pending();
        self.stopping = Some(name);
        if !self.is_ready() {
            self.notify(
                Severity::Alarm,
                "no link: the stop is pending until reconnection. \
                 Use the emergency stop of the machine",
            );
        }
    }

    fn quit(&mut self) {
        let ms = self.machine.config.supervision.heartbeat_ms;
        let text = match (self.link_state(), self.state()) {
            (LinkState::Ready, Some(State::Disabled | State::EmergencyStop)) => {
                self.quitting = true;
                return;
            }
            (LinkState::Ready, Some(State::Idle | State::Fault)) => {
                "the machine is at standstill; the drives stay on and hold".to_string()
            }
            (LinkState::Ready, _) => {
                "the machine decelerates along its path, the job is aborted, the drives stay on"
                    .to_string()
            }
            _ => format!("no link: a moving machine stops after {ms} ms without the host"),
        };
        self.open(Overlay::Confirm(Confirm::Quit(text)));
    }

    pub(super) fn jog_key(&mut self, axis: usize, up: bool, phase: KeyPhase) {
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
        if !possible || !self.session.is_configured() {
            let state = self
                .state()
                .map_or_else(String::new, |state| state.to_string());
            if self.session.is_configured() {
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
                self.jogging.handle_key(axis, up, phase, now_us);
            }
        }
    }

    fn select_override(&mut self, kind: OverrideKind, up: bool) {
        let values: &[u8] = match kind {
            OverrideKind::Feed => &overrides::FEED,
            OverrideKind::Rapid => &overrides::RAPID,
            OverrideKind::Spindle => &overrides::SPINDLE,
        };
        if let Some(percent) = overrides::next(values, self.requested_overrides[kind as usize], up)
        {
            self.set_override(kind, percent);
        }
    }

    /// Requests an override, percent.
    pub(super) fn set_override(&mut self, kind: OverrideKind, percent: u8) {
        let running = self.jobs.checked.as_ref();
        let running = running.filter(|_| self.jobs.is_running_program());
        if kind == OverrideKind::Spindle
            && let Some(running) = running
            && let Err(what) = self.check_spindle(running, percent)
        {
            self.notify(Severity::Warning, what);
            return;
        }
        self.requested_overrides[kind as usize] = percent;
        let command = match kind {
            OverrideKind::Feed => Command::Override { percent },
            OverrideKind::Rapid => Command::RapidOverride { percent },
            OverrideKind::Spindle => Command::SpindleOverride { percent },
        };
        self.request(command, OnAck::Override(kind, percent));
    }

    fn record(&mut self) {
        if let Some(recording) = self.recording.take() {
            let message = format!("{}: {} rows", recording.path.display(), recording.rows);
            self.notify(Severity::Info, message);
            return;
        }
        match Recording::begin(&self.settings.folder, &self.machine) {
            Ok(recording) => {
                let message = format!("recording to {}", recording.path.display());
                self.recording = Some(recording);
                self.notify(Severity::Info, message);
            }
            Err(reason) => self.notify(Severity::Warning, reason),
        }
    }

    fn confirm_key(&mut self, confirm: Confirm, key: Key) {
        if key.code == KeyCode::Enter {
            self.accept(confirm);
        }
    }

    /// Does what a question asks for. The question for a program that was opened just now stays.
    pub(super) fn accept(&mut self, confirm: Confirm) {
        match confirm {
            Confirm::Run(text, notices) => {
                if self.now_us() < self.opened_us + CONFIRM_DELAY_US {
                    self.overlay = Overlay::Confirm(Confirm::Run(text, notices));
                } else {
                    self.run_program();
                }
            }
            Confirm::Home => self.home(),
            Confirm::EnableAndHome => self.enable(OnAck::EnabledToHome),
            Confirm::MoveOff(joint) => self.move_off(joint),
            Confirm::Tare => self.request(Command::Tare, OnAck::Notify("tare started")),
            Confirm::Quit(_) => self.quitting = true,
        }
    }

    fn prompt_key(&mut self, title: &'static str, text: &str, key: Key) {
        if is_cancel(key) {
            return;
        }
        if key.code == KeyCode::Enter {
            self.set_zero(text);
            return;
        }
        let text = typed(text, key).unwrap_or_else(|| text.to_string());
        self.overlay = Overlay::Prompt { title, text };
    }

    fn sources_key(&mut self, selected: usize, key: Key) {
        let last = self.machine.pose.len().saturating_sub(1);
        if let Some(selected) = move_selection(key, selected, last) {
            return self.overlay = Overlay::Sources { selected };
        }
        let source = match key.code {
            KeyCode::Char('p') => Source::Program,
            KeyCode::Char('h') => Source::Hold,
            KeyCode::Char('j') => Source::Jog,
            KeyCode::Char('m') => Source::Master,
            KeyCode::Esc | KeyCode::Enter | KeyCode::Char('a' | 'q') => return,
            _ => return self.overlay = Overlay::Sources { selected },
        };
        self.overlay = Overlay::Sources { selected };
        let coordinate = selected as u8;
        self.request(
            Command::Source { coordinate, source },
            OnAck::Source(coordinate, source),
        );
    }

    fn force_key(&mut self, selected: usize, key: Key) {
        let Some(loops) = self.loops else { return };
        if let Some(selected) = move_selection(key, selected, loops.len() - 1) {
            return self.overlay = Overlay::Force { selected };
        }
        let change = match key.code {
            KeyCode::Enter => {
                let mask = self
                    .telemetry
                    .as_ref()
                    .and_then(|now| now.force.as_ref())
                    .map_or(0, |force| force.mask);
                let mask = mask ^ (1 << selected);
                self.request(Command::ForceMask { mask }, OnAck::Nothing);
                0
            }
            KeyCode::Char('+' | '=') => FORCE_STEP,
            KeyCode::Char('-') => -FORCE_STEP,
            KeyCode::Esc | KeyCode::Char('y' | 'q') => return,
            _ => 0,
        };
        self.overlay = Overlay::Force { selected };
        if change != 0 {
            let requested = &mut self.requested_loops[selected];
            let mut settings = requested.latest().unwrap_or(loops[selected]);
            settings.setpoint = settings.setpoint.saturating_add(change);
            requested.settings = Some(settings);
        }
    }
}

/// Whether a key closes what is typed into.
pub(super) fn is_cancel(key: Key) -> bool {
    key.code == KeyCode::Esc || (key.code == KeyCode::Char('c') && key.control)
}

/// The text after a key; none for keys that do not change it.
pub(super) fn typed(text: &str, key: Key) -> Option<String> {
    let mut text = text.to_string();
    match key.code {
        KeyCode::Backspace => {
            text.pop();
        }
        KeyCode::Char('u') if key.control => text.clear(),
        KeyCode::Char(letter) if !key.control => text.push(letter),
        _ => return None,
    }
    Some(text)
}

/// The selected row after an arrow key; none for other keys.
fn move_selection(key: Key, selected: usize, last: usize) -> Option<usize> {
    match key.code {
        KeyCode::Up => Some(selected.saturating_sub(1)),
        KeyCode::Down => Some((selected + 1).min(last)),
        _ => None,
    }
}

/// First row of a list after a key; none when the key closes the list. `last` is the first row of
/// its last page.
fn scroll(key: Key, from: usize, last: usize) -> Option<usize> {
    let from = from.min(last);
    match key.code {
        KeyCode::Up => Some(from.saturating_sub(1)),
        KeyCode::Down => Some((from + 1).min(last)),
        KeyCode::PageUp => Some(from.saturating_sub(10)),
        KeyCode::PageDown => Some((from + 10).min(last)),
        _ => None,
    }
}
