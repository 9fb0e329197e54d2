//! Scripts of a session: what a simulated person does at the haptic arm, and what the operator orders, in TOML.
//!
//! Times are seconds, of the person since the arm's motors came on, of orders since the hand may lead, which is the same to a few hundredths. Places are mm of the tip from its home.

use super::SCALES;
use crate::cli::{CliError, Exit};
use haptimill_hil_sim::hand::{Intention, Stroke};
use haptimill_hil_sim::rig::{Control, Rig};
use serde::Deserialize;
use std::path::Path;
use std::str::FromStr;

/// The script that `--hand sim` carries out.
pub const BUILT_IN: &str = include_str!("../../../examples/teleop.toml");

/// What the operator orders.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Order {
    /// Slow down and wait.
    Hold,
    /// Go on after a hold, from where hand and tool are then.
    Resume,
    /// Slow down and drop the job.
    Stop,
    /// The hand leads no more; the job comes to its end.
    End,
    /// The fault of the arm was looked after: it may have power again.
    ResetHand,
    /// Another G_P.
    Scale(f64),
}

/// How orders are written.
pub const ORDERS: &str = "hold, resume, stop, end, reset-hand, or gp=SCALE (0.1 to 2)";

impl FromStr for Order {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.trim() {
            "hold" => Ok(Self::Hold),
            "resume" => Ok(Self::Resume),
            "stop" => Ok(Self::Stop),
            "end" => Ok(Self::End),
            "reset-hand" => Ok(Self::ResetHand),
            other => match other.strip_prefix("gp=").map(str::parse) {
                Some(Ok(scale)) => Ok(Self::Scale(scale)),
                _ => Err(format!("\"{other}\" is no order; write {ORDERS}")),
            },
        }
    }
}

/// Checks G_P.
///
/// # Errors
/// The bounds, in words.
pub fn scale(scale: f64) -> Result<u16, String> {
    if SCALES.contains(&scale) {
        Ok((scale * 4096.0).round() as u16)
    } else {
        let (low, high) = (SCALES.start(), SCALES.end());
        Err(format!(
            "G_P of {scale} is out of its range: {low} to {high}"
        ))
    }
}

/// A script.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Script {
    /// What the hand means to do.
    stroke: Vec<Stroke>,
    /// When the button is pressed and let go.
    button: Vec<Button>,
    /// What the operator orders.
    order: Vec<Ordered>,
    /// When the session ends; 1 s after the last of all this begins when it is not given.
    end_s: Option<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Button {
    at_s: f64,
    held: bool,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Ordered {
    at_s: f64,
    what: String,
}

impl Script {
    /// Reads a script from disk.
    ///
    /// # Errors
    /// It cannot be read, or says what makes no sense, with the line.
    pub fn load(path: &Path) -> Result<Self, CliError> {
        let file = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|error| {
            let what = format!("{file}: cannot be read: {error}; check the path");
            CliError::new(Exit::BadInput, what)
        })?;
        Self::parse(&file, &text)
    }

    /// Reads the text of a script; `file` is its name in messages.
    ///
    /// # Errors
    /// As [`Script::load`].
    pub fn parse(file: &str, text: &str) -> Result<Self, CliError> {
        let bad = |what: String| CliError::new(Exit::BadInput, format!("{file}: {what}"));
        let script: Self = toml::from_str(text).map_err(|error| {
            let before = error.span().map_or("", |span| &text[..span.start]);
            let line = before.matches('\n').count() + 1;
            let what = error.message().trim().replace('\n', ", ");
            CliError::new(
                Exit::BadInput,
                format!("{file}:{line}: {what}; see examples/teleop.toml"),
            )
        })?;
        for (index, order) in script.order.iter().enumerate() {
            let order: Order = order
                .what
                .parse()
                .map_err(|what| bad(format!("order {}: {what}", index + 1)))?;
            if let Order::Scale(wanted) = order {
                scale(wanted).map_err(|what| bad(format!("order {}: {what}", index + 1)))?;
            }
        }
        for (index, stroke) in script.stroke.iter().enumerate() {
            let well = stroke.pace_mm_s > 0.0
                && stroke.pace_mm_s <= 500.0
                && stroke.ramp_s >= 0.0
                && stroke.to_mm.iter().all(|place| place.abs() <= 1000.0);
            if !well {
                let what = "pace_mm_s must be above 0 and at most 500, ramp_s not below 0, and places within 1000 mm";
                return Err(bad(format!("stroke {}: {what}", index + 1)));
            }
        }
        if script
            .times()
            .chain(script.end_s)
            .any(|time| !(0.0..=3600.0).contains(&time))
        {
            return Err(bad("times must be from 0 to 3600 s".to_string()));
        }
        Ok(script)
    }

    fn times(&self) -> impl Iterator<Item = f64> + '_ {
        let strokes = self.stroke.iter().map(|stroke| stroke.at_s);
        let buttons = self.button.iter().map(|button| button.at_s);
        strokes
            .chain(buttons)
            .chain(self.order.iter().map(|order| order.at_s))
    }

    /// When the session ends, s.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        let last = || self.times().fold(0.0, f64::max) + 1.0;
        self.end_s.unwrap_or_else(last)
    }

    /// What the operator orders, in the order of time.
    #[must_use]
    pub fn orders(&self) -> Vec<(f64, Order)> {
        let mut orders: Vec<(f64, Order)> = self
            .order
            .iter()
            .filter_map(|order| Some((order.at_s, order.what.parse().ok()?)))
            .collect();
        orders.sort_by(|one, other| one.0.total_cmp(&other.0));
        orders
    }
}

/// The person of a script.
#[derive(Debug, Clone)]
pub struct Person {
    strokes: Option<Intention>,
    /// Latest first.
    buttons: Vec<Button>,
    /// When the motors came on, ns.
    begun: Option<u64>,
}

impl Person {
    /// The person of a script.
    #[must_use]
    pub fn new(script: &Script) -> Self {
        let mut buttons = script.button.clone();
        buttons.sort_by(|one, other| other.at_s.total_cmp(&one.at_s));
        Self {
            strokes: Some(Intention::Strokes(script.stroke.clone())),
            buttons,
            begun: None,
        }
    }

    /// Before each control period.
    pub fn act<C: Control>(&mut self, rig: &mut Rig<C>) {
        let now = rig.time_ns();
        if self.begun.is_none() && !rig.outputs().haptic.enabled {
            return;
        }
        let begun = *self.begun.get_or_insert(now);
        let time_s = (now - begun) as f64 * 1e-9;
        let Some(arm) = rig.plant_mut().haptic_mut() else {
            return;
        };
        if let Some(strokes) = self.strokes.take() {
            arm.intend(strokes);
        }
        while let Some(button) = self.buttons.pop_if(|button| time_s >= button.at_s) {
            arm.set_engaged(button.held);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_makes_no_sense_is_told_with_its_place() {
        let said = |text: &str| Script::parse("s.toml", text).unwrap_err().message;
        assert!(said("[[stroke]]\nat_s = 1\n").starts_with("s.toml:1: missing field"));
        assert!(said("\n[[button]]\nat_s = 1\nheld = 2\n").starts_with("s.toml:4: "));
        assert!(
            said("[[order]]\nat_s = 1\nwhat = \"go\"\n")
                .contains("order 1: \"go\" is no order; write hold,")
        );
        let bound = said("[[order]]\nat_s = 1\nwhat = \"gp=3\"\n");
        assert!(
            bound.ends_with("G_P of 3 is out of its range: 0.1 to 2"),
            "{bound}"
        );
        assert!(said("end_s = -1.0").contains("0 to 3600 s"));
        let script = Script::parse("built in", BUILT_IN).unwrap();
        assert!(script.end_s() > 1.0);
        assert!(scale(0.1).is_ok() && scale(2.0) == Ok(8192) && scale(f64::NAN).is_err());
    }
}
