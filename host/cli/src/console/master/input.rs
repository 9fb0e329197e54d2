//! From keys in the overlay of the hand to orders, and what their answers mean.

use super::{FACE_TOLERANCE_MM, Face, Field, FieldPosition, NAMES, PER_SCALE};
use crate::console::app::{App, OnAck};
use crate::console::keys::Key;
use crate::console::view_model::{Overlay, Severity};
use haptimill_firmware::haptics::feedback_law::MOST;
use haptimill_machine_file::scale::{PER_EFFORT, PER_MM, to_i32};
use haptimill_protocol::haptic::{COMPONENTS, ForceFeedback, ForceFeedbackAxis, VirtualFixture};
use haptimill_protocol::message::{Command, RATE_SHIFT};
use haptimill_teleop::SCALES;
use haptimill_teleop::script::scale;
use ratatui::crossterm::event::KeyCode;

/// Changes for one key.
const PERCENT_STEP: f64 = 5.0;
const LIMIT_STEP_N: f64 = 0.2;
const SCALE_STEP: f64 = 0.1;

/// The most that a typed number has.
const MAX_DIGITS: usize = 8;

/// Reports that may still be of before a wall was put, or taken away.
const STALE_REPORTS: u8 = 2;

/// The time in which a hand may have gone on since its newest report, s.
const REPORT_AGE_S: f64 = 0.15;

/// The name of a wall.
fn face_name(axis: usize, upper: bool) -> String {
    let side = if upper { "upper" } else { "lower" };
    format!("{side} wall of {}", NAMES[axis])
}

fn axis_name(axis: Option<usize>) -> &'static str {
    axis.map_or("all axes", |axis| NAMES[axis])
}

impl App {
    /// Opens the overlay of the hand, or says why there is none.
    pub(in crate::console) fn open_master_overlay(&mut self) -> Option<Overlay> {
        match &self.master {
            Some(master) => Some(Overlay::Master {
                at: master.first_position(),
                typed: String::new(),
            }),
            None => {
                let what = "this machine has no haptic arm and follows none: no [haptic] or [follow] in its machine file";
                self.notify(Severity::Warning, what);
                None
            }
        }
    }

    /// Takes in the newest report of the arm.
    pub(in crate::console) fn update_arm(&mut self) {
        if let Some(report) = self.client.hand()
            && let Some(arm) = self.master.as_mut().and_then(|master| master.arm.as_mut())
        {
            arm.handle_notice(report);
        }
    }

    /// A key while the overlay is open.
    pub(in crate::console) fn master_key(
        &mut self,
        at: FieldPosition,
        mut typed: String,
        key: Key,
    ) {
        let Some(master) = &self.master else { return };
        let field = at.field();
        let fixture = matches!(field, Field::Fixture { .. });
        let mut next = at;
        match key.code {
            KeyCode::Up | KeyCode::Down | KeyCode::Left | KeyCode::Right => {
                next = master.neighbour(at, key.code);
                typed.clear();
            }
            KeyCode::Esc if !typed.is_empty() => typed.clear(),
            KeyCode::Esc | KeyCode::Char('w' | 'q') => return,
            KeyCode::Char('c') if key.control => return,
            KeyCode::Char('0'..='9' | '.') if fixture => {
                let what = "a wall is put where the tip is: bring the handle there, then Enter";
                self.notify(Severity::Warning, what);
            }
            KeyCode::Char(letter @ ('0'..='9' | '.')) if typed.len() < MAX_DIGITS => {
                typed.push(letter);
            }
            KeyCode::Backspace if !typed.is_empty() => {
                typed.pop();
            }
            KeyCode::Enter | KeyCode::Backspace | KeyCode::Delete if fixture => {
                self.change_faces(field, key.code == KeyCode::Enter);
            }
            KeyCode::Enter if !typed.is_empty() => {
                match typed.parse() {
                    Ok(value) => self.set_field(field, value),
                    Err(_) => {
                        let what = format!("'{typed}' is no number; type one like 12.5");
                        self.notify(Severity::Warning, what);
                    }
                }
                typed.clear();
            }
            KeyCode::Char('+' | '=') => self.step_field(field, 1.0),
            KeyCode::Char('-') => self.step_field(field, -1.0),
            _ => {}
        }
        self.overlay = Overlay::Master { at: next, typed };
    }

    /// Sets a field to a number, if it may be.
    fn set_field(&mut self, field: Field, value: f64) {
        let most_n = f64::from(MOST.0) / PER_EFFORT;
        match field {
            Field::Percent(axis) if value <= 100.0 && value.fract() == 0.0 => {
                self.change_feedback(axis, |axis| axis.percent = value as u8);
            }
            Field::Percent(axis) => {
                let of = axis_name(axis);
                let what = format!(
                    "reflection of {of}: {value} % is not one of 0 to 100, in whole percent; type one of them"
                );
                self.notify(Severity::Warning, what);
            }
            Field::Limit(axis) if value <= most_n => {
                self.change_feedback(axis, |axis| axis.limit = to_i32(value * PER_EFFORT));
            }
            Field::Limit(axis) => {
                let of = axis_name(axis);
                let what = format!(
                    "limit of {of}: {value} N is out of its range, 0 to {most_n} N; type a number within it"
                );
                self.notify(Severity::Warning, what);
            }
            Field::Scale => match scale(value) {
                Ok(scale) => self.request_scale(scale),
                Err(why) => {
                    self.notify(Severity::Warning, format!("{why}; type a number within it"))
                }
            },
            Field::Fixture { .. } => {}
        }
    }

    /// Sets a field a step further, or to its bound.
    fn step_field(&mut self, field: Field, sign: f64) {
        let changed = match field {
            Field::Percent(axis) => self.change_feedback(axis, |axis| {
                let percent = f64::from(axis.percent) + sign * PERCENT_STEP;
                axis.percent = percent.clamp(0.0, 100.0) as u8;
            }),
            Field::Limit(axis) => self.change_feedback(axis, |axis| {
                let most = f64::from(axis.limit) / PER_EFFORT + sign * LIMIT_STEP_N;
                // In tenths, so that a step forth and one back is none.
                let most = to_i32((most * 10.0).round() / 10.0 * PER_EFFORT);
                axis.limit = most.clamp(0, MOST.0);
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
                let what =
                    "a wall is put where the tip is by Enter, and taken away by Enter or Backspace";
                return self.notify(Severity::Warning, what);
            }
        };
        if !changed {
            let (bound, other) = if sign > 0.0 {
                ("most", '-')
            } else {
                ("least", '+')
            };
            let what = format!("that is the {bound} it can be; {other} goes the other way");
            self.notify(Severity::Warning, what);
        }
    }

    /// Changes the reflection of one axis, or of all; says whether that changes anything.
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
        // What another host may have set is set all the same.
        if (changed || !arm.feedback.known) && self.check_link() {
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

    /// There is somebody to be asked; says so when there is not.
    fn check_link(&mut self) -> bool {
        let is_ready = self.is_ready();
        if !is_ready {
            self.notify(Severity::Warning, "no link to the controller");
        }
        is_ready
    }

    /// Puts a wall where the tip is, if there is none and one is `requested`; otherwise takes it away, or all of them.
    fn change_faces(&mut self, field: Field, requested: bool) {
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
            Face::Approximate(_) | Face::FieldPosition(_)
        );
        if is_set || !requested {
            return self.request_fixture(axis, upper, None, false);
        }
        let trouble = match self.client.hand().map(|report| report.problem) {
            None => Some("nothing was heard of the arm yet; wait for its report".to_string()),
            Some(Some(problem)) => Some(
                self.model
                    .with_axes(|axes| axes.describe(&problem).to_string()),
            ),
            Some(None) => None,
        };
        match trouble {
            Some(why) => {
                let what = format!(
                    "{}: where the tip is is not known: {why}",
                    face_name(axis, upper)
                );
                self.notify(Severity::Warning, what);
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

    /// What of the hand was asked for is done.
    pub(in crate::console) fn acknowledge_master(&mut self, on_ack: &OnAck) {
        let tip = self.client.hand().map(|report| report.pose);
        let Some(master) = &mut self.master else {
            return;
        };
        let what = match (on_ack, &mut master.arm, &mut master.scale) {
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
                            Face::FieldPosition(at)
                        } else {
                            Face::Approximate(at)
                        }
                    }
                    _ => Face::None,
                };
                match face {
                    Face::FieldPosition(at) | Face::Approximate(at) => {
                        format!("{} where the tip is: {at:.2} mm", face_name(axis, upper))
                    }
                    _ if !*all => format!("{} taken away", face_name(axis, upper)),
                    _ if axis + 1 == COMPONENTS && upper => "all walls taken away".to_string(),
                    _ => return,
                }
            }
            _ => return,
        };
        self.notify(Severity::Info, what);
    }

    /// What of the hand was asked for is refused; says what that was.
    pub(in crate::console) fn reject_master(&mut self, on_ack: &OnAck) -> Option<String> {
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
