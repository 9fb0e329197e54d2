//! Scripts of a session in TOML: the motion of a simulated operator at the haptic arm, and
//! commands.
//!
//! Times are seconds: of the motion since the motors of the arm were enabled, of commands since the
//! session started, which is the same to a few hundredths. Positions are mm of the tip from its
//! home.

use super::SCALES;
use haptimill_client::Error;
use haptimill_hil_sim::operator::{Stroke, Trajectory};
use haptimill_hil_sim::rig::{Control, Rig};
use haptimill_machine_file::document::{Allowed, Document, Section, real};
use haptimill_machine_file::read_text;
use std::path::Path;
use std::str::FromStr;

/// The script of `--master sim`.
pub const BUILT_IN: &str = include_str!("../../../examples/teleop.toml");

/// A command of the operator.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum OperatorCommand {
    /// Feed hold.
    Hold,
    /// Resume after a hold, from the present positions of master and tool.
    Resume,
    /// Decelerate and drop the job.
    Stop,
    /// Complete the job.
    End,
    /// Clear the fault of the arm and enable its motors.
    ResetMaster,
    /// Set G_P.
    Scale(f64),
}

/// A message of a command input.
#[derive(Debug, Clone, PartialEq)]
pub enum CommandInput {
    /// A command.
    Command(OperatorCommand),
    /// Text that is no command, with the remedy.
    Invalid(String),
    /// The input failed, with the reason: a `stop` would not arrive any more. The end of an input
    /// is no failure.
    Lost(String),
}

/// Syntax of the commands.
pub const COMMANDS: &str = "hold, resume, stop, end, reset-master, or gp=SCALE (0.1 to 2)";

impl FromStr for OperatorCommand {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.trim() {
            "hold" => Ok(Self::Hold),
            "resume" => Ok(Self::Resume),
            "stop" => Ok(Self::Stop),
            "end" => Ok(Self::End),
            "reset-master" => Ok(Self::ResetMaster),
            other => match other.strip_prefix("gp=").map(str::parse) {
                Some(Ok(scale)) => Ok(Self::Scale(scale)),
                _ => Err(format!("\"{other}\" is no command; write {COMMANDS}")),
            },
        }
    }
}

/// Converts G_P to the units of the protocol.
///
/// # Errors
/// The value is out of range.
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
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Script {
    /// Motion of the operator.
    stroke: Vec<Stroke>,
    /// Times at which the enabling switch is pressed and released.
    button: Vec<Button>,
    /// Commands with their times.
    command: Vec<TimedCommand>,
    /// End of the session; 1 s after the start of the last entry when it is not given.
    end_s: Option<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Button {
    at_s: f64,
    held: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct TimedCommand {
    at_s: f64,
    command: OperatorCommand,
}

/// Range of times.
fn times() -> Allowed {
    real(0.0, 3600.0, "s")
}

/// Reads the blocks of a kind, each with its time.
fn blocks<T>(
    root: &Section<'_, '_>,
    key: &'static str,
    read: impl Fn(f64, &Section<'_, '_>) -> Option<T>,
) -> Vec<T> {
    if !root.has(key) {
        return Vec::new();
    }
    let block = |section: Section<'_, '_>| {
        let at_s = section.number("at_s", times());
        let block = read(at_s, &section);
        let ends = section.has(END);
        section.finish();
        if ends {
            // A TOML key belongs to the block above it.
            let remedy = format!(
                "move it to the top of the file, above the first block, or take it out of [[{key}]]"
            );
            section.report(END, "is the end of the session, not of a block", remedy);
        }
        block
    };
    root.list(key).into_iter().filter_map(block).collect()
}

/// Key of the end of the session.
const END: &str = "end_s";

fn stroke(at_s: f64, section: &Section<'_, '_>) -> Stroke {
    Stroke {
        at_s,
        to_mm: section.numbers("to_mm", real(-1000.0, 1000.0, "mm")),
        pace_mm_s: section.number("pace_mm_s", real(0.001, 500.0, "mm/s")),
        quarters: [1.0; 4],
        ramp_s: section.number("ramp_s", times()),
        stop_s: 0.0,
    }
}

fn command(at_s: f64, section: &Section<'_, '_>) -> Option<TimedCommand> {
    let text = section.text("what", &format!("write {COMMANDS}"))?;
    let command = text.parse().and_then(|command| match command {
        OperatorCommand::Scale(commanded) => scale(commanded).map(|_| command),
        _ => Ok(command),
    });
    match command {
        Ok(command) => Some(TimedCommand { at_s, command }),
        Err(why) => {
            section.report("what", why, "");
            None
        }
    }
}

impl Script {
    /// Reads a script from disk.
    ///
    /// # Errors
    /// It cannot be read, or has mistakes, with their lines.
    pub fn load(path: &Path) -> Result<Self, Error> {
        let file = path.display().to_string();
        let text = read_text(path)?;
        Self::parse(&file, &text)
    }

    /// Reads the text of a script; `file` is its name in messages.
    ///
    /// # Errors
    /// As [`Script::load`].
    pub fn parse(file: &str, text: &str) -> Result<Self, Error> {
        let document = Document::new(file, text, Vec::new());
        let Some(table) = document.parse() else {
            return Err(document.into_problems().into());
        };
        let root = Section::root(&document, table.get_ref());
        let script = Self {
            stroke: blocks(&root, "stroke", |at_s, section| Some(stroke(at_s, section))),
            button: blocks(&root, "button", |at_s, section| {
                let held = section.flag("held")?;
                Some(Button { at_s, held })
            }),
            command: blocks(&root, "command", command),
            end_s: root.has(END).then(|| root.number(END, times())),
        };
        root.finish();
        document.finish()?;
        Ok(script)
    }

    fn times(&self) -> impl Iterator<Item = f64> + '_ {
        let strokes = self.stroke.iter().map(|stroke| stroke.at_s);
        let buttons = self.button.iter().map(|button| button.at_s);
        strokes
            .chain(buttons)
            .chain(self.command.iter().map(|command| command.at_s))
    }

    /// End of the session, s.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        let last = || self.times().fold(0.0, f64::max) + 1.0;
        self.end_s.unwrap_or_else(last)
    }

    /// The commands, sorted by time.
    #[must_use]
    pub fn commands(&self) -> Vec<(f64, OperatorCommand)> {
        let timed = |timed: &TimedCommand| (timed.at_s, timed.command);
        let mut commands: Vec<(f64, OperatorCommand)> = self.command.iter().map(timed).collect();
        commands.sort_by(|one, other| one.0.total_cmp(&other.0));
        commands
    }
}

/// The operator of a script.
#[derive(Debug, Clone)]
pub struct ScriptedOperator {
    strokes: Option<Trajectory>,
    /// The latest first.
    buttons: Vec<Button>,
    /// When the motors were enabled, ns.
    start_ns: Option<u64>,
}

impl ScriptedOperator {
    /// The operator of a script.
    #[must_use]
    pub fn new(script: &Script) -> Self {
        let mut buttons = script.button.clone();
        buttons.sort_by(|one, other| other.at_s.total_cmp(&one.at_s));
        Self {
            strokes: Some(Trajectory::Strokes(script.stroke.clone())),
            buttons,
            start_ns: None,
        }
    }

    /// Moves the arm; called before each control period.
    pub fn act<C: Control>(&mut self, rig: &mut Rig<C>) {
        let now = rig.time_ns();
        if self.start_ns.is_none() && !rig.outputs().haptic.enabled {
            return;
        }
        let start_ns = *self.start_ns.get_or_insert(now);
        let time_s = (now - start_ns) as f64 * 1e-9;
        let Some(arm) = rig.plant_mut().haptic_mut() else {
            return;
        };
        if let Some(strokes) = self.strokes.take() {
            arm.set_trajectory(strokes);
        }
        while let Some(button) = self.buttons.pop_if(|button| time_s >= button.at_s) {
            arm.set_enabling_switch(button.held);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mistakes_are_reported_with_their_lines() {
        let problems_of = |text: &str| Script::parse("s.toml", text).unwrap_err().message;
        assert_eq!(
            problems_of(
                "end_s = 4\n\n[[button]]\nat_s = 1\n\n[[stroke]]\nat_s = 1\nto_mm = [1.0, 2]\nramp_s = 1\n"
            ),
            "s.toml:3:1: button[1].held: is missing; add `held = true` or `held = false`\n\
             s.toml:6:1: stroke[1].pace_mm_s: is missing; add `pace_mm_s = ...`, allowed is 0.001 to 500 mm/s\n\
             s.toml:8:9: stroke[1].to_mm: has 2 numbers; write 3"
        );
        assert_eq!(
            problems_of("\n[[button]]\nat_s = 4000\nheld = 2\n"),
            "s.toml:3:8: button[1].at_s: 4000 is out of range, allowed is 0 to 3600 s; lower it\n\
             s.toml:4:8: button[1].held: is a number, not true or false; write true or false"
        );
        assert!(
            problems_of("[[command]]\nat_s = 1\nwhat = \"go\"\n")
                .starts_with("s.toml:3:8: command[1].what: \"go\" is no command; write hold,")
        );
        let bound = problems_of("[[command]]\nat_s = 1\nwhat = \"gp=3\"\n");
        assert!(
            bound.ends_with("G_P of 3 is out of its range: 0.1 to 2"),
            "{bound}"
        );
        assert!(problems_of("end_s = -1.0").contains("0 to 3600 s"));
        assert_eq!(
            problems_of("[[button]]\nat_s = 1\nheld = true\nend_s = 4\n"),
            "s.toml:4:9: button[1].end_s: is the end of the session, not of a block; move it to the top of the file, above the first block, or take it out of [[button]]"
        );
        assert!(problems_of("[[strok]]\nat_s = 1\n").starts_with("s.toml:1:"));
        assert!(problems_of("[[button]\nat_s = 1\n").starts_with("s.toml:1:"));
        let script = Script::parse("built in", BUILT_IN).unwrap();
        assert!(script.end_s() > 1.0);
        assert!(scale(0.1).is_ok() && scale(2.0) == Ok(8192) && scale(f64::NAN).is_err());
    }
}
