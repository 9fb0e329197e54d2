//! Simulated named inputs: levels at rest, and the contacts of a probe and of a tool setter.
//!
//! The tool tip carries a ball. A contact begins when the ball has entered a block by the
//! pretravel. The contact exerts no force, and its switch neither bounces nor wears; the faults
//! `input-bounce` and `input-level` do that.

use crate::check::Check;
use crate::process::ToolPose;
use haptimill_firmware::named_io::config::CHANNELS;
use serde::{Deserialize, Serialize};

/// A digital input of the simulated machine: one section `[[plant.input]]`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InputLine {
    /// Name, for faults.
    pub name: String,
    /// Channel, 0 to 31.
    pub channel: u8,
    /// The level is high at rest.
    #[serde(default)]
    pub high: bool,
}

/// A block that the tool touches: section `[plant.probe]` or `[plant.tool_setter]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TouchConfig {
    /// Name of the input that a contact inverts.
    pub input: String,
    /// Lowest corner of the block in the workpiece frame, mm.
    pub low: [f64; 3],
    /// Highest corner of the block in the workpiece frame, mm.
    pub high: [f64; 3],
    /// Radius of the ball at the tip, mm. 0 is a point.
    pub radius: f64,
    /// Travel into the block at which the contact begins, mm.
    #[serde(default)]
    pub pretravel: f64,
}

impl TouchConfig {
    fn check(&self, key: &str, lines: &[InputLine], check: &mut Check) {
        if !lines.iter().any(|line| line.name == self.input) {
            check.refuse(
                format!("{key}: input"),
                format!("there is no [[plant.input]] \"{}\"; add one", self.input),
            );
        }
        for (low, high) in self.low.iter().zip(&self.high) {
            check.within(format!("{key}: low"), *low, -2000.0, 2000.0);
            check.within(format!("{key}: high"), *high, -2000.0, 2000.0);
            if low >= high {
                let problem = format!("{high} is not above `low`, {low}; raise it");
                check.refuse(format!("{key}: high"), problem);
            }
        }
        check.within(format!("{key}: radius"), self.radius, 0.0, 50.0);
        check.within(format!("{key}: pretravel"), self.pretravel, 0.0, 10.0);
    }

    /// Whether the tool touches the block.
    fn touches(&self, tool: &ToolPose) -> bool {
        let mut squared = 0.0;
        let mut inside = f64::INFINITY;
        for axis in 0..3 {
            let centre = tool.tip[axis] + self.radius * tool.axis[axis];
            let outside = (self.low[axis] - centre).max(centre - self.high[axis]);
            squared += outside.max(0.0) * outside.max(0.0);
            inside = inside.min(-outside);
        }
        // Signed distance of the centre from the surface of the block; negative inside.
        let distance = if inside > 0.0 {
            -inside
        } else {
            squared.sqrt()
        };
        distance <= self.radius - self.pretravel
    }
}

/// Injected faults of an input.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct InputCondition {
    /// The line is forced to this level.
    pub level: Option<bool>,
    /// The level alternates at this frequency, Hz; 0 is no bouncing.
    pub bounce_hz: f64,
}

/// Digital inputs and their contacts.
#[derive(Debug, Clone, Default)]
pub struct InputLines {
    lines: Vec<InputLine>,
    conditions: Vec<InputCondition>,
    /// Blocks, and the index of the input of each.
    touches: Vec<(TouchConfig, usize)>,
    /// Inputs with a contact.
    contacts: Vec<bool>,
}

/// Checks inputs and blocks.
pub(crate) fn check(
    lines: &[InputLine],
    touches: [(&str, Option<&TouchConfig>); 2],
    check: &mut Check,
) {
    for (index, line) in lines.iter().enumerate() {
        let key = format!("input {index} ({})", line.name);
        if line.channel >= CHANNELS {
            let problem = format!(
                "{} is out of range, allowed is 0 to 31; lower it",
                line.channel
            );
            check.refuse(format!("{key}: channel"), problem);
        }
        let before = &lines[..index];
        if line.name.is_empty() || before.iter().any(|other| other.name == line.name) {
            check.refuse(
                format!("{key}: name"),
                "is empty or a duplicate; rename it".into(),
            );
        }
        if before.iter().any(|other| other.channel == line.channel) {
            check.refuse(
                format!("{key}: channel"),
                "is a duplicate; give each its own".into(),
            );
        }
    }
    for (key, touch) in touches {
        if let Some(touch) = touch {
            touch.check(key, lines, check);
        }
    }
}

impl InputLines {
    /// Creates the inputs of a checked configuration.
    pub(crate) fn new(lines: &[InputLine], touches: [Option<&TouchConfig>; 2]) -> Self {
        let touches = touches.into_iter().flatten().filter_map(|touch| {
            let input = lines.iter().position(|line| line.name == touch.input)?;
            Some((touch.clone(), input))
        });
        Self {
            touches: touches.collect(),
            conditions: vec![InputCondition::default(); lines.len()],
            contacts: vec![false; lines.len()],
            lines: lines.to_vec(),
        }
    }

    /// Number of inputs.
    #[must_use]
    pub fn count(&self) -> usize {
        self.lines.len()
    }

    /// Sets the injected faults of an input.
    pub fn set_condition(&mut self, input: usize, condition: InputCondition) {
        self.conditions[input] = condition;
    }

    /// Whether an input has a contact.
    #[must_use]
    pub fn has_contact(&self, input: usize) -> bool {
        self.contacts[input]
    }

    /// Whether a block can be touched.
    pub(crate) fn has_touches(&self) -> bool {
        !self.touches.is_empty()
    }

    /// Updates the contacts for a pose of the tool.
    pub(crate) fn follow(&mut self, tool: &ToolPose) {
        self.contacts.fill(false);
        for (touch, input) in &self.touches {
            self.contacts[*input] |= touch.touches(tool);
        }
    }

    /// The digital word at a time.
    pub(crate) fn word(&self, time_ns: u64) -> u32 {
        let lines = self.lines.iter().zip(&self.conditions).zip(&self.contacts);
        lines.fold(0, |word, ((line, condition), contact)| {
            let level = condition.level.unwrap_or(line.high != *contact);
            let phase = time_ns as f64 * 1e-9 * condition.bounce_hz;
            let bounced = condition.bounce_hz > 0.0 && phase.fract() >= 0.5;
            word | u32::from(level != bounced) << line.channel
        })
    }
}
