//! Key input of the master panel, and handling of the answers.

use super::app::{App, OnAck};
use super::keys::Key;
use super::master::{FACE_TOLERANCE_MM, Face, Field, FieldPosition, PER_SCALE};
use super::view_model::{Overlay, Severity};
use haptimill_firmware::haptics::feedback_law::MAX;
use haptimill_machine_file::scale::{PER_EFFORT, PER_MM, to_i32};
use haptimill_protocol::haptic::{
    COMPONENT_NAMES, COMPONENTS, ForceFeedback, ForceFeedbackAxis, VirtualFixture,
};
use haptimill_protocol::message::{Command, RATE_SHIFT};
use haptimill_teleop::SCALES;
use haptimill_teleop::script::scale;
use ratatui::crossterm::event::KeyCode;

/// Changes per key press.
const PERCENT_STEP: f64 = 5.0;
const LIMIT_STEP_N: f64 = 0.2;
const SCALE_STEP: f64 = 0.1;

/// Largest length of a typed number.
const MAX_DIGITS: usize = 8;

/// Number of reports after a change of the fixture that may still describe the previous one.
const STALE_REPORTS: u8 = 2;

/// Largest age of the newest report, s: the master may have moved since.
const REPORT_AGE_S: f64 = 0.15;

/// Name of a face of the virtual fixture.
fn face_name(axis: usize, upper: bool) -> String {
    let side = if upper { "upper" } else { "lower" };
    format!("{side} face of {}", COMPONENT_NAMES[axis])
}

fn axis_name(axis: Option<usize>) -> &'static str {
    axis.map_or("all axes", |axis| COMPONENT_NAMES[axis])
}

impl App {
    /// Opens the master panel, or reports why there is none.
    pub(super) fn open_master_overlay(&mut self) -> Option<Overlay> {
        match &self.master {
            Some(master) => Some(Overlay::Master {
                position: master.first_position(),
                typed: String::new(),
            }),
            None => {
                let message = "this machine has no haptic arm and no remote master: \
                               its machine file has neither [haptic] nor [follow]";
                self.notify(Severity::Warning, message);
                None
            }
        }
    }

    /// Evaluates the newest report of the arm.
    pub(super) fn update_arm(&mut self) {
        if let Some(report) = self.session.client().master()
            && let Some(arm) = self.master.as_mut().and_then(|master| master.arm.as_mut())
        {
            arm.update(report);
        }
    }

    /// Handles a key while the panel is open.
    pub(super) fn master_key(&mut self, position: FieldPosition, mut typed: String, key: Key) {
        let Some(master) = &self.master else { return };
        let field = position.field();
        let is_fixture = matches!(field, Field::Fixture { .. });
        let mut next = position;
        match key.code {
            KeyCode::Up | KeyCode::Down | KeyCode::Left | KeyCode::Right => {
                next = master.neighbour(position, key.code);
                typed.clear();
            }
            KeyCode::Esc if !typed.is_empty() => typed.clear(),
            KeyCode::Esc | KeyCode::Char('w' | 'q') => return,
            KeyCode::Char('c') if key.control => return,
            KeyCode::Char('0'..='9' | '.') if is_fixture => {
                let message =
                    "the fixture face is set at the tip: move the tip there, then press Enter";
                self.notify(Severity::Warning, message);
            }
            KeyCode::Char(letter @ ('0'..='9' | '.')) if typed.len() < MAX_DIGITS => {
                typed.push(letter);
            }
            KeyCode::Backspace if !typed.is_empty() => {
                typed.pop();
            }
            KeyCode::Enter | KeyCode::Backspace | KeyCode::Delete if is_fixture => {
                self.change_faces(field, key.code == KeyCode::Enter);
            }
            KeyCode::Enter if !typed.is_empty() => {
                match typed.parse() {
                    Ok(value) => self.set_field(field, value),
                    Err(_) => {
                        let message = format!("'{typed}' is not a number; type one like 12.5");
                        self.notify(Severity::Warning, message);
                    }
                }
                typed.clear();
            }
            KeyCode::Char('+' | '=') => self.step_field(field, 1.0),
            KeyCode::Char('-') => self.step_field(field, -1.0),
            _ => {}
        }
        self.overlay = Overlay::Master {
            position: next,
            typed,
        };
    }

    /// Sets a field to a number within its range.
    fn set_field(&mut self, field: Field, value: f64) {
        let limit_n = f64::from(MAX.0) / PER_EFFORT;
        match field {
            Field::Percent(axis) if value <= 100.0 && value.fract() == 0.0 => {
                self.change_feedback(axis, |axis| axis.percent = value as u8);
            }
            Field::Percent(axis) => {
                let of = axis_name(axis);
                let message = format!(
                    "force feedback of {of}: {value} % is out of its range; \
                     type a whole number from 0 to 100"
                );
                self.notify(Severity::Warning, message);
            }
            Field::Limit(axis) if value <= limit_n => {
                self.change_feedback(axis, |axis| axis.limit = to_i32(value * PER_EFFORT));
            }
            Field::Limit(axis) => {
                let of = axis_name(axis);
                let message = format!(
                    "force limit of {of}: {value} N is out of its range, 0 to {limit_n} N; \
                     type a number within it"
                );
                self.notify(Severity::Warning, message);
            }
            Field::Scale => match scale(value) {
                Ok(scale) => self.request_scale(scale),
                Err(reason) => self.notify(
                    Severity::Warning,
                    format!("{reason}; type a number within it"),
                ),
            },
            Field::Fixture { .. } => {}
        }
    }

    /// Changes a field by one step, within its range.
    fn step_field(&mut self, field: Field, sign: f64) {
        let changed = match field {
            Field::Percent(axis) => self.change_feedback(axis, |axis| {
                let percent = f64::from(axis.percent) + sign * PERCENT_STEP;
                axis.percent = percent.clamp(0.0, 100.0) as u8;
            }),
            Field::Limit(axis) => self.change_feedback(axis, |axis| {
                let limit_n = f64::from(axis.limit) / PER_EFFORT + sign * LIMIT_STEP_N;
                // Rounded to tenths, so that one step up and one down restore the value.
                let limit = to_i32((limit_n * 10.0).round() / 10.0 * PER_EFFORT);
                axis.limit = limit.clamp(0, MAX.0);
            }),
            Field::Scale => {
                let Some(setting) = self.master.as_ref().and_then(|master| master.scale) else {
                    return;
                };
                let next = f64::from(setting.requested) / PER_SCALE + sign * SCALE_STEP;
                let next = ((next * 10.0).round() / 10.0).clamp(*SCALES.start(), *SCALES.end());
                let next = (next * PER_SCALE).round() as u16;
                let changed = next != setting.requested;
                if changed {
                    self.request_scale(next);
                }
                changed
            }
            Field::Fixture { .. } => {
                let message = "Enter sets a fixture face at the tip; Enter or Backspace removes it";
                return self.notify(Severity::Warning, message);
            }
        };
        if !changed {
            let (bound, other) = if sign > 0.0 {
                ("largest", '-')
            } else {
                ("smallest", '+')
            };
            let message =
                format!("this is the {bound} value; {other} changes it in the other direction");
            self.notify(Severity::Warning, message);
        }
    }

    /// Changes the force feedback of one axis, or of all; returns true if that changes anything.
    fn change_feedback(
        &mut self,
        axis: Option<usize>,
        change: impl Fn(&mut ForceFeedbackAxis),
    ) -> bool {
        let Some(arm) = self.master.as_mut().and_then(|master| master.arm.as_mut()) else {
            return false;
        };
        let mut settings = arm.feedback.requested;
        for (index, slot) in settings.axes.iter_mut().enumerate() {
            if axis.is_none_or(|axis| axis == index) {
                change(slot);
            }
        }
        let changed = settings != arm.feedback.requested;
        // An unknown value is sent even if it does not change.
        if (changed || !arm.feedback.is_known) && self.check_link() {
            self.set_requested_feedback(settings);
            self.request(
                Command::ForceFeedback(settings),
                OnAck::ForceFeedback(settings),
            );
        }
        changed
    }

    fn set_requested_feedback(&mut self, settings: ForceFeedback) {
        if let Some(arm) = self.master.as_mut().and_then(|master| master.arm.as_mut()) {
            arm.feedback.requested = settings;
        }
    }

    fn request_scale(&mut self, scale: u16) {
        if self.check_link()
            && let Some(setting) = self
                .master
                .as_mut()
                .and_then(|master| master.scale.as_mut())
        {
            setting.requested = scale;
            self.request(
                Command::PositionScale { scale },
                OnAck::PositionScale(scale),
            );
        }
    }

    /// Returns true with a link; otherwise logs a warning.
    fn check_link(&mut self) -> bool {
        let is_ready = self.is_ready();
        if !is_ready {
            self.notify(Severity::Warning, "no link to the controller");
        }
        is_ready
    }

    /// Sets a face at the tip if there is none and `place` is true; otherwise removes it, or all
    /// faces.
    fn change_faces(&mut self, field: Field, place: bool) {
        let Field::Fixture { axis, upper } = field else {
            return;
        };
        let Some(faces) = self
            .master
            .as_ref()
            .and_then(|master| master.arm.as_ref())
            .map(|arm| arm.faces)
        else {
            return;
        };
        if !self.check_link() {
            return;
        }
        let Some(axis) = axis else {
            for axis in 0..COMPONENTS {
                self.request_fixture(axis, false, None, true);
                self.request_fixture(axis, true, None, true);
            }
            return;
        };
        let is_set = matches!(
            faces[axis][usize::from(upper)],
            Face::Approximate(_) | Face::Known(_)
        );
        if is_set || !place {
            return self.request_fixture(axis, upper, None, false);
        }
        let problem = match self.session.client().master().map(|report| report.problem) {
            None => Some("the arm has not reported yet; wait for its report".to_string()),
            Some(Some(problem)) => Some(
                self.model
                    .with_axes(|axes| axes.describe(&problem).to_string()),
            ),
            Some(None) => None,
        };
        match problem {
            Some(reason) => {
                let message = format!(
                    "{}: the position of the tip is unknown: {reason}",
                    face_name(axis, upper)
                );
                self.notify(Severity::Warning, message);
            }
            None => self.request_fixture(
                axis,
                upper,
                Some(VirtualFixture { at: None, rate: 0 }),
                false,
            ),
        }
    }

    fn request_fixture(
        &mut self,
        axis: usize,
        upper: bool,
        fixture: Option<VirtualFixture>,
        all: bool,
    ) {
        let is_set = fixture.is_some();
        self.request(
            Command::VirtualFixture {
                axis: axis as u8,
                upper,
                fixture,
            },
            OnAck::Fixture {
                axis,
                upper,
                is_set,
                all,
            },
        );
    }

    /// Handles the acknowledgement of a setting.
    pub(super) fn acknowledge_master(&mut self, on_ack: &OnAck) {
        let tip = self.session.client().master().map(|report| report.pose);
        let Some(master) = &mut self.master else {
            return;
        };
        let message = match (on_ack, &mut master.arm, &mut master.scale) {
            (OnAck::ForceFeedback(settings), Some(arm), _) => {
                return arm.feedback.acknowledge(*settings);
            }
            (OnAck::PositionScale(value), _, Some(setting)) => return setting.acknowledge(*value),
            (
                OnAck::Fixture {
                    axis,
                    upper,
                    is_set,
                    all,
                },
                Some(arm),
                _,
            ) => {
                let (axis, upper) = (*axis, *upper);
                arm.stale_reports = STALE_REPORTS;
                let face = &mut arm.faces[axis][usize::from(upper)];
                *face = match tip {
                    Some(tip) if *is_set => {
                        let at = f64::from(tip.tip[axis]) / PER_MM;
                        let rate = f64::from(tip.rate[axis]) * f64::from(1 << RATE_SHIFT) / PER_MM;
                        if (rate * REPORT_AGE_S).abs() < FACE_TOLERANCE_MM {
                            Face::Known(at)
                        } else {
                            Face::Approximate(at)
                        }
                    }
                    _ => Face::None,
                };
                match face {
                    Face::Known(at) | Face::Approximate(at) => {
                        format!("{} set at the tip: {at:.2} mm", face_name(axis, upper))
                    }
                    _ if !*all => format!("{} removed", face_name(axis, upper)),
                    _ if axis + 1 == COMPONENTS && upper => "all faces removed".to_string(),
                    _ => return,
                }
            }
            _ => return,
        };
        self.notify(Severity::Info, message);
    }

    /// Handles the refusal of a setting. Returns the name of a refused face.
    pub(super) fn reject_master(&mut self, on_ack: &OnAck) -> Option<String> {
        let master = self.master.as_mut()?;
        match on_ack {
            OnAck::ForceFeedback(settings) => {
                master.arm.as_mut()?.feedback.reject(*settings);
                None
            }
            OnAck::PositionScale(value) => {
                master.scale.as_mut()?.reject(*value);
                None
            }
            OnAck::Fixture { axis, upper, .. } => Some(face_name(*axis, *upper)),
            _ => None,
        }
    }
}
