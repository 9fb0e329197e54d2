//! From keys in the overlay of the hand to orders, and what their answers mean.

use super::{At, Face, Field, NAMES, PER_SCALE, SAME_MM};
use crate::console::desk::{Desk, Then};
use crate::console::keys::Key;
use crate::console::shown::{Overlay, Weight};
use haptimill_firmware::haptics::feedback_law::MOST;
use haptimill_machine_file::scale::{PER_EFFORT, PER_MM, to_i32};
use haptimill_protocol::haptic::{COMPONENTS, ForceFeedback, ForceFeedbackAxis, VirtualFixture};
use haptimill_protocol::message::{Command, RATE_SHIFT};
use haptimill_teleop::SCALES;
use haptimill_teleop::script::scale;
use ratatui::crossterm::event::KeyCode;

/// Changes for one key.
const PERCENT_STEP: f64 = 5.0;
const MOST_STEP_N: f64 = 0.2;
const SCALE_STEP: f64 = 0.1;

/// The most that a typed number has.
const LETTERS: usize = 8;

/// Reports that may still be of before a wall was put, or taken away.
const OLD_REPORTS: u8 = 2;

/// The time in which a hand may have gone on since its newest report, s.
const UNSEEN_S: f64 = 0.15;

/// The name of a wall.
fn wall_name(axis: usize, upper: bool) -> String {
    let side = if upper { "upper" } else { "lower" };
    format!("{side} wall of {}", NAMES[axis])
}

fn axis_name(axis: Option<usize>) -> &'static str {
    axis.map_or("all axes", |axis| NAMES[axis])
}

impl Desk {
    /// Opens the overlay of the hand, or says why there is none.
    pub(in crate::console) fn hand_overlay(&mut self) -> Option<Overlay> {
        match &self.hand {
            Some(hand) => Some(Overlay::Hand {
                at: hand.first(),
                typed: String::new(),
            }),
            None => {
                let what = "this machine has no haptic arm and follows none: no [haptic] or [follow] in its machine file";
                self.say(Weight::Warning, what);
                None
            }
        }
    }

    /// Takes in the newest report of the arm.
    pub(in crate::console) fn hear_hand(&mut self) {
        if let Some(report) = self.client.master()
            && let Some(arm) = self.hand.as_mut().and_then(|hand| hand.arm.as_mut())
        {
            arm.hear(report);
        }
    }

    /// A key while the overlay is open.
    pub(in crate::console) fn hand_key(&mut self, at: At, mut typed: String, key: Key) {
        let Some(hand) = &self.hand else { return };
        let field = at.field();
        let wall = matches!(field, Field::Wall { .. });
        let mut next = at;
        match key.code {
            KeyCode::Up | KeyCode::Down | KeyCode::Left | KeyCode::Right => {
                next = hand.beside(at, key.code);
                typed.clear();
            }
            KeyCode::Esc if !typed.is_empty() => typed.clear(),
            KeyCode::Esc | KeyCode::Char('w' | 'q') => return,
            KeyCode::Char('c') if key.control => return,
            KeyCode::Char('0'..='9' | '.') if wall => {
                let what = "a wall is put where the tip is: bring the handle there, then Enter";
                self.say(Weight::Warning, what);
            }
            KeyCode::Char(letter @ ('0'..='9' | '.')) if typed.len() < LETTERS => {
                typed.push(letter);
            }
            KeyCode::Backspace if !typed.is_empty() => {
                typed.pop();
            }
            KeyCode::Enter | KeyCode::Backspace | KeyCode::Delete if wall => {
                self.change_walls(field, key.code == KeyCode::Enter);
            }
            KeyCode::Enter if !typed.is_empty() => {
                match typed.parse() {
                    Ok(value) => self.set_hand(field, value),
                    Err(_) => {
                        let what = format!("'{typed}' is no number; type one like 12.5");
                        self.say(Weight::Warning, what);
                    }
                }
                typed.clear();
            }
            KeyCode::Char('+' | '=') => self.step_hand(field, 1.0),
            KeyCode::Char('-') => self.step_hand(field, -1.0),
            _ => {}
        }
        self.overlay = Overlay::Hand { at: next, typed };
    }

    /// Sets a field to a number, if it may be.
    fn set_hand(&mut self, field: Field, value: f64) {
        let most_n = f64::from(MOST.0) / PER_EFFORT;
        match field {
            Field::Percent(axis) if value <= 100.0 && value.fract() == 0.0 => {
                self.reflect(axis, |axis| axis.percent = value as u8);
            }
            Field::Percent(axis) => {
                let of = axis_name(axis);
                let what = format!(
                    "reflection of {of}: {value} % is not one of 0 to 100, in whole percent; type one of them"
                );
                self.say(Weight::Warning, what);
            }
            Field::Most(axis) if value <= most_n => {
                self.reflect(axis, |axis| axis.limit = to_i32(value * PER_EFFORT));
            }
            Field::Most(axis) => {
                let of = axis_name(axis);
                let what = format!(
                    "limit of {of}: {value} N is out of its range, 0 to {most_n} N; type a number within it"
                );
                self.say(Weight::Warning, what);
            }
            Field::Scale => match scale(value) {
                Ok(scale) => self.ask_scale(scale),
                Err(why) => self.say(Weight::Warning, format!("{why}; type a number within it")),
            },
            Field::Wall { .. } => {}
        }
    }

    /// Sets a field a step further, or to its bound.
    fn step_hand(&mut self, field: Field, way: f64) {
        let changed = match field {
            Field::Percent(axis) => self.reflect(axis, |axis| {
                let percent = f64::from(axis.percent) + way * PERCENT_STEP;
                axis.percent = percent.clamp(0.0, 100.0) as u8;
            }),
            Field::Most(axis) => self.reflect(axis, |axis| {
                let most = f64::from(axis.limit) / PER_EFFORT + way * MOST_STEP_N;
                // In tenths, so that a step forth and one back is none.
                let most = to_i32((most * 10.0).round() / 10.0 * PER_EFFORT);
                axis.limit = most.clamp(0, MOST.0);
            }),
            Field::Scale => {
                let Some(setting) = self.hand.as_ref().and_then(|hand| hand.scale) else {
                    return;
                };
                let next = f64::from(setting.commanded) / PER_SCALE + way * SCALE_STEP;
                let next = ((next * 10.0).round() / 10.0).clamp(*SCALES.start(), *SCALES.end());
                let next = (next * PER_SCALE).round() as u16;
                let changed = next != setting.commanded;
                if changed {
                    self.ask_scale(next);
                }
                changed
            }
            Field::Wall { .. } => {
                let what =
                    "a wall is put where the tip is by Enter, and taken away by Enter or Backspace";
                return self.say(Weight::Warning, what);
            }
        };
        if !changed {
            let (bound, other) = if way > 0.0 {
                ("most", '-')
            } else {
                ("least", '+')
            };
            let what = format!("that is the {bound} it can be; {other} goes the other way");
            self.say(Weight::Warning, what);
        }
    }

    /// Changes the reflection of one axis, or of all; says whether that changes anything.
    fn reflect(&mut self, axis: Option<usize>, change: impl Fn(&mut ForceFeedbackAxis)) -> bool {
        let Some(arm) = self.hand.as_mut().and_then(|hand| hand.arm.as_mut()) else {
            return false;
        };
        let mut settings = arm.reflection.commanded;
        for (index, slot) in settings.axes.iter_mut().enumerate() {
            if axis.is_none_or(|axis| axis == index) {
                change(slot);
            }
        }
        let changed = settings != arm.reflection.commanded;
        // What another host may have set is set all the same.
        if (changed || !arm.reflection.sure) && self.can_set() {
            self.set_wanted(settings);
            self.ask(
                Command::ForceFeedback(settings),
                Then::ForceFeedback(settings),
            );
        }
        changed
    }

    fn set_wanted(&mut self, settings: ForceFeedback) {
        if let Some(arm) = self.hand.as_mut().and_then(|hand| hand.arm.as_mut()) {
            arm.reflection.commanded = settings;
        }
    }

    fn ask_scale(&mut self, scale: u16) {
        if self.can_set()
            && let Some(setting) = self.hand.as_mut().and_then(|hand| hand.scale.as_mut())
        {
            setting.commanded = scale;
            self.ask(Command::PositionScale { scale }, Then::PositionScale(scale));
        }
    }

    /// There is somebody to be asked; says so when there is not.
    fn can_set(&mut self) -> bool {
        let ready = self.ready();
        if !ready {
            self.say(Weight::Warning, "no link to the controller");
        }
        ready
    }

    /// Puts a wall where the tip is, if there is none and one is `commanded`; otherwise takes it away, or all of them.
    fn change_walls(&mut self, field: Field, commanded: bool) {
        let Field::Wall { axis, upper } = field else {
            return;
        };
        let Some(faces) = self
            .hand
            .as_ref()
            .and_then(|hand| hand.arm.as_ref())
            .map(|arm| arm.faces)
        else {
            return;
        };
        if !self.can_set() {
            return;
        }
        let Some(axis) = axis else {
            for axis in 0..COMPONENTS {
                self.ask_wall(axis, false, None, true);
                self.ask_wall(axis, true, None, true);
            }
            return;
        };
        let stands = matches!(faces[axis][usize::from(upper)], Face::Near(_) | Face::At(_));
        if stands || !commanded {
            return self.ask_wall(axis, upper, None, false);
        }
        let trouble = match self.client.master().map(|report| report.problem) {
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
                    wall_name(axis, upper)
                );
                self.say(Weight::Warning, what);
            }
            None => self.ask_wall(
                axis,
                upper,
                Some(VirtualFixture { at: None, rate: 0 }),
                false,
            ),
        }
    }

    fn ask_wall(&mut self, axis: usize, upper: bool, wall: Option<VirtualFixture>, all: bool) {
        let put = wall.is_some();
        self.ask(
            Command::VirtualFixture {
                axis: axis as u8,
                upper,
                fixture: wall,
            },
            Then::Wall {
                axis,
                upper,
                put,
                all,
            },
        );
    }

    /// What of the hand was asked for is done.
    pub(in crate::console) fn hand_set(&mut self, then: &Then) {
        let tip = self.client.master().map(|report| report.pose);
        let Some(hand) = &mut self.hand else { return };
        let what = match (then, &mut hand.arm, &mut hand.scale) {
            (Then::ForceFeedback(settings), Some(arm), _) => {
                return arm.reflection.taken(*settings);
            }
            (Then::PositionScale(value), _, Some(setting)) => return setting.taken(*value),
            (
                Then::Wall {
                    axis,
                    upper,
                    put,
                    all,
                },
                Some(arm),
                _,
            ) => {
                let (axis, upper) = (*axis, *upper);
                arm.old = OLD_REPORTS;
                let face = &mut arm.faces[axis][usize::from(upper)];
                *face = match tip {
                    Some(tip) if *put => {
                        let at = f64::from(tip.tip[axis]) / PER_MM;
                        let rate = f64::from(tip.rate[axis]) * f64::from(1 << RATE_SHIFT) / PER_MM;
                        if (rate * UNSEEN_S).abs() < SAME_MM {
                            Face::At(at)
                        } else {
                            Face::Near(at)
                        }
                    }
                    _ => Face::None,
                };
                match face {
                    Face::At(at) | Face::Near(at) => {
                        format!("{} where the tip is: {at:.2} mm", wall_name(axis, upper))
                    }
                    _ if !*all => format!("{} taken away", wall_name(axis, upper)),
                    _ if axis + 1 == COMPONENTS && upper => "all walls taken away".to_string(),
                    _ => return,
                }
            }
            _ => return,
        };
        self.say(Weight::Note, what);
    }

    /// What of the hand was asked for is refused; says what that was.
    pub(in crate::console) fn hand_refused(&mut self, then: &Then) -> Option<String> {
        let hand = self.hand.as_mut()?;
        match then {
            Then::ForceFeedback(settings) => {
                hand.arm.as_mut()?.reflection.refused(*settings);
                None
            }
            Then::PositionScale(value) => {
                hand.scale.as_mut()?.refused(*value);
                None
            }
            Then::Wall { axis, upper, .. } => Some(wall_name(*axis, *upper)),
            _ => None,
        }
    }
}
