//! Changes of a program before it is planned: a start in the middle, a dry run, single blocks.

use crate::commands::{CliError, Exit};
use haptimill_gcode::{
    Coordinates, Feed, Move, Options, OutputValue, Path, Place, Program, Step, ToolLength, WordKind,
};
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Feed of the way down of an approach to a rapid move, mm/min.
const DOWN_FEED: f64 = 300.0;

/// Options that change what a program does.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
pub struct ChangeArgs {
    /// Begin with line N: the lines before it set modes, offsets and tools, and move nothing. The
    /// command shows the approach and asks for confirmation: up to the highest Z before line N,
    /// over the start of line N, spindle on, down at feed
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub from_line: Option<u32>,
    /// With --from-line: do not ask
    #[arg(long, requires = "from_line")]
    pub yes: bool,
    /// Dry run: spindle, coolant and outputs stay as they are; --lift raises the path, and is
    /// required with a machine behind a port
    #[arg(long)]
    pub dry: bool,
    /// With --dry: raise every position of the program by this distance along Z
    #[arg(long, value_name = "MM", requires = "dry", value_parser = lift)]
    pub lift: Option<f64>,
    /// Single block: pause after every block; only on a machine behind a port
    #[arg(long)]
    pub single: bool,
}

fn lift(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.0..=1e4).contains(&value) => Ok(value),
        _ => Err("write 0 to 10000 mm".to_string()),
    }
}

impl ChangeArgs {
    /// Whether the program stays as it is.
    pub(super) const fn is_none(&self) -> bool {
        self.from_line.is_none() && !self.dry && !self.single
    }

    /// Refuses options that contradict each other on this port.
    ///
    /// # Errors
    /// [`Exit::Usage`].
    pub(super) fn check(&self, is_simulated: bool, skips_pauses: bool) -> Result<(), CliError> {
        let usage = |what: &str| Err(CliError::new(Exit::Usage, what));
        if self.dry && self.lift.is_none() && !is_simulated {
            return usage(
                "--dry moves the machine without its spindle; add --lift MM to raise the path \
                 above the part, or --lift 0 on an empty table",
            );
        }
        if self.single && is_simulated {
            return usage(
                "--single waits for an operator, and the simulator in this process does not run \
                 in real time; use `haptimill sim serve` and --port",
            );
        }
        if self.single && skips_pauses {
            return usage("--single pauses after every block, and --skip-pauses passes pauses");
        }
        Ok(())
    }

    /// Changes a program; returns the description of the approach of --from-line, in which the
    /// spindle gets `run_up_s` seconds.
    ///
    /// # Errors
    /// The line is beyond the end of the program.
    pub(in crate::commands) fn apply(
        &self,
        program: &mut Program,
        options: &Options,
        run_up_s: f64,
    ) -> Result<Option<String>, CliError> {
        let frame = BoxView::of(options);
        let approach = match self.from_line {
            Some(line) => Some(frame.begin_at(program, line, run_up_s, self.dry)?),
            None => None,
        };
        if self.dry {
            frame.make_dry(program, self.lift.unwrap_or(0.0));
        }
        if self.single {
            pause_between_blocks(program);
        }
        Ok(approach)
    }
}

/// The coordinates of a machine.
struct BoxView {
    kinds: Vec<WordKind>,
    letters: Vec<char>,
    z: Option<usize>,
}

impl BoxView {
    fn of(options: &Options) -> Self {
        let letters: Vec<char> = options.axes.iter().map(|axis| axis.letter).collect();
        Self {
            kinds: options.kinds(),
            z: letters.iter().position(|letter| *letter == 'Z'),
            letters,
        }
    }

    fn leg(&self, place: Place, from: Coordinates, to: Coordinates, feed: Feed) -> Option<Step> {
        let path = Path::line(&self.kinds, from, to)?;
        Some(Step::Move(Move {
            place,
            path,
            tool: ToolLength::default(),
            programmed: to,
            feed,
            fixed: false,
            exact_stop: true,
            tolerance: None,
            joining: Some(0.0),
        }))
    }

    /// Replaces the steps before a line by an approach, and describes it. A line with a call begins
    /// at the first step of the subroutine. Spindle, coolant and outputs stay off in a dry run.
    fn begin_at(
        &self,
        program: &mut Program,
        line: u32,
        run_up_s: f64,
        is_dry: bool,
    ) -> Result<String, CliError> {
        let main_lines = std::mem::take(&mut program.main_lines);
        let first = main_lines.iter().position(|at| *at >= line);
        let before = first.map_or(u32::MAX, |first| main_lines[first]);
        let in_subroutine = |step: &Step| {
            let place = step.place();
            place.file == 0 && (line..before).contains(&place.line)
        };
        let mut steps = program.steps.iter().zip(&main_lines);
        if let Some((step, call)) = steps.find(|(step, _)| in_subroutine(step)) {
            let what = format!(
                "{}: the next block that does something is line {}, in a subroutine; begin with \
                 its call: --from-line {call}",
                program.file,
                step.place().line
            );
            return Err(CliError::new(Exit::BadInput, what));
        }
        let Some(first) = first else {
            let what = format!(
                "{}: nothing is to be done from line {line} on; the last block that does something \
                 is in line {}",
                program.file,
                main_lines.iter().max().unwrap_or(&0)
            );
            return Err(CliError::new(Exit::BadInput, what));
        };
        let rest = program.steps.split_off(first);
        let before = std::mem::take(&mut program.steps);
        let place = Place {
            line: main_lines[first],
            ..Place::default()
        };
        let (mut rpm, mut tool, mut at) = (0, None, program.start);
        let mut top = f64::NEG_INFINITY;
        let mut longest = 0.0_f64;
        let (mut coolant, mut outputs) = (None, BTreeMap::new());
        for step in &before {
            match step {
                Step::Move(step) | Step::Probe { step, .. } => {
                    at = step.tool.machine_pose(&step.path.to);
                    longest = step.tool.length.max(0.0);
                    if let Some(z) = self.z {
                        top = top.max(step.path.from[z]).max(step.path.to[z]);
                    }
                }
                Step::Spindle { rpm: speed, .. } => rpm = *speed,
                Step::ToolChange { tool: number, .. } => tool = Some(*number),
                Step::Coolant { mist, flood, .. } => coolant = Some((*mist, *flood)),
                Step::Output { number, value, .. } => {
                    outputs.insert(*number, *value);
                }
                _ => {}
            }
        }
        if is_dry {
            (rpm, coolant, outputs) = (0, None, BTreeMap::new());
        }
        let feed = rest.iter().find_map(|step| match step {
            Step::Move(Move {
                feed: Feed::PerMinute(feed),
                path,
                ..
            }) if path.tip_length() > 0.0 => Some(*feed),
            _ => None,
        });
        let down = feed.unwrap_or(DOWN_FEED).min(DOWN_FEED);
        let first_move = rest.iter().find_map(|step| match step {
            Step::Move(step) | Step::Probe { step, .. } => Some(step),
            _ => None,
        });
        // The tip of a longer tool is up to its length below the pose of the machine.
        longest = first_move.map_or(longest, |step| longest.max(step.tool.length));
        top += longest;
        let (mut up, mut over) = (program.start, at);
        if let Some(z) = self.z {
            top = top.max(program.start[z]);
            (up[z], over[z]) = (top, top);
        }
        let steps = &mut program.steps;
        steps.extend(self.leg(place, program.start, up, Feed::Rapid));
        steps.extend(self.leg(place, up, over, Feed::Rapid));
        if rpm != 0 {
            steps.push(Step::Spindle { place, rpm });
            steps.push(Step::Dwell {
                place,
                seconds: run_up_s,
            });
        }
        if let Some((mist, flood)) = coolant {
            steps.push(Step::Coolant { place, mist, flood });
        }
        steps.extend(outputs.iter().map(|(number, value)| Step::Output {
            place,
            number: *number,
            value: *value,
            with_motion: false,
        }));
        steps.extend(self.leg(place, over, at, Feed::PerMinute(down)));
        steps.extend(rest);
        let mut text = format!("from line {}, at", place.line);
        for (letter, value) in self.letters.iter().zip(at) {
            let _ = write!(text, " {letter}{value:.3}");
        }
        let _ = write!(text, " of the machine. Approach:");
        if self.z.is_some() {
            let _ = write!(text, " up to Z{top:.3}, over that position,");
        }
        match rpm {
            0 => text.push_str(" spindle off,"),
            rpm => {
                let _ = write!(text, " spindle {rpm} rev/min for {run_up_s} s,");
            }
        }
        match coolant {
            Some((true, true)) => text.push_str(" mist and flood on,"),
            Some((true, false)) => text.push_str(" mist on,"),
            Some((false, true)) => text.push_str(" flood on,"),
            Some((false, false)) | None => {}
        }
        for (number, value) in &outputs {
            let _ = match value {
                OutputValue::Digital(true) => write!(text, " output {number} on,"),
                OutputValue::Digital(false) => write!(text, " output {number} off,"),
                OutputValue::Analogue(value) => write!(text, " output {number} at {value},"),
            };
        }
        let _ = write!(text, " then down to it at {down:.0} mm/min.");
        if let Some(tool) = tool {
            let _ = write!(text, " Tool {tool} must be in the spindle.");
        }
        Ok(text)
    }

    /// Removes spindle, coolant and outputs, and raises the path.
    fn make_dry(&self, program: &mut Program, lift: f64) {
        program.steps.retain(|step| {
            !matches!(
                step,
                Step::Spindle { .. } | Step::Coolant { .. } | Step::Output { .. }
            )
        });
        let Some(z) = self.z.filter(|_| lift > 0.0) else {
            return;
        };
        for step in &mut program.steps {
            if let Step::Move(step) | Step::Probe { step, .. } = step {
                let path = &mut step.path;
                path.from[z] += lift;
                path.to[z] += lift;
                if let Some(arc) = &mut path.arc {
                    for (axis, centre) in arc.plane.iter().zip(&mut arc.centre) {
                        *centre += if *axis == z { lift } else { 0.0 };
                    }
                }
            }
        }
        let is_move = |step: &Step| matches!(step, Step::Move(_) | Step::Probe { .. });
        if let Some(first) = program.steps.iter().position(is_move) {
            let place = program.steps[first].place();
            let mut up = program.start;
            up[z] += lift;
            if let Some(step) = self.leg(place, program.start, up, Feed::Rapid) {
                program.steps.insert(first, step);
            }
        }
    }
}

/// Inserts a pause before every block but the first.
fn pause_between_blocks(program: &mut Program) {
    let mut paused = Vec::with_capacity(2 * program.steps.len());
    let mut last: Option<(u16, u32)> = None;
    for step in program.steps.drain(..) {
        let place = step.place();
        let block = (place.file, place.line);
        let pauses = matches!(paused.last(), Some(Step::Pause { .. }));
        if last.is_some_and(|last| last != block) && !pauses {
            paused.push(Step::Pause { place });
        }
        last = Some(block);
        paused.push(step);
    }
    program.steps = paused;
}

#[cfg(test)]
mod tests;
