//! Planner: from steps to setpoints, as a stream.

mod laying;

use super::block::{self, Block};
use super::figures::Figures;
use super::joining::Joining;
use super::limits::{MachineModel, Settings};
use super::lookahead::Run;
use super::messages::Messages;
use super::outputs;
use super::profile::Phase;
use super::setpoints::{Emitter, Planned};
use super::track::{SharedTrack, Track};
use super::trajectory::{Leg, Piece, Trajectory};
use haptimill_gcode::{Coordinates, Measure, Move, Path, Place, Problem, Step, ToolLength};
use haptimill_protocol::message::Action;

/// Blocks of the look-ahead, when a part of them is planned; the rest is planned again with the
/// blocks that follow.
const FULL_WINDOW: usize = 8192;
/// The same where each of them has many joined moves.
const MAX_JOINED: usize = 32_768;
/// The first one, so that a stream starts early.
const FIRST_WINDOW: usize = 256;

/// What a planner keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Keep {
    /// Neither setpoints nor trajectory.
    Nothing,
    /// Setpoints, until they are taken.
    Setpoints,
    /// Setpoints and the whole trajectory.
    All,
}

/// Planner of a stream of steps.
///
/// A step that the machine cannot do is refused; later steps are then checked, but not planned.
/// [`Planner::finish`] ends the motion before it at standstill.
#[derive(Debug)]
pub struct Planner<M> {
    settings: Settings,
    model: M,
    keep: Keep,
    trajectory: Trajectory,
    emitter: Emitter,
    run: Run,
    /// Blocks of the look-ahead when the next part of them is planned.
    window: usize,
    /// Time of the end of the last planned block.
    time: f64,
    /// Blocks of the step that is added, and phases of the block that is laid: kept for their
    /// memory.
    prepared: Vec<Block>,
    phases: Vec<Phase>,
    /// Moves that are joined and not planned.
    joining: Joining,
    /// End of the last step: pose of the tip, and its tool.
    at: Coordinates,
    tool: ToolLength,
    /// Whether a step was refused.
    refused: bool,
    /// Whether the program has ended.
    ended: bool,
    /// Whether the last run of motion ended with a rapid move.
    ended_rapid: bool,
    figures: Figures,
    /// Messages whose setpoints are not taken.
    messages: Messages,
    /// The track of the job, and the first piece that it does not have.
    track: Option<SharedTrack>,
    tracked: usize,
    /// Whether the last setpoint may be taken, because the next step is late.
    released: bool,
}

impl<M: MachineModel> Planner<M> {
    /// Creates a planner of a program that starts at a pose, mm and degrees.
    pub fn new(start: Coordinates, settings: Settings, model: M) -> Self {
        Self {
            window: FIRST_WINDOW,
            ..Self::keeping(start, settings, model, Keep::Setpoints)
        }
    }

    /// Creates a planner as [`Planner::new`], of a program that was checked: the first setpoints
    /// wait for the whole look-ahead, so that they are those of [`Plan`](super::Plan).
    pub fn of_checked(start: Coordinates, settings: Settings, model: M) -> Self {
        Self::keeping(start, settings, model, Keep::Setpoints)
    }

    pub(crate) fn keeping(start: Coordinates, settings: Settings, model: M, keep: Keep) -> Self {
        // Path 0 is the start pose, so that every time has a path.
        let standing = Path {
            from: start,
            to: start,
            arc: None,
            length: 1.0,
            measure: Measure::Tip,
        };
        let mut trajectory = Trajectory::default();
        trajectory.paths.push(Leg {
            place: Place::default(),
            places: Vec::new(),
            messages: 0,
            path: standing,
            tool: ToolLength::default(),
            is_rapid: true,
            is_fixed: false,
        });
        trajectory.pieces.push(Piece::resting(0.0, 0, 1.0));
        Self {
            emitter: Emitter::new(&settings),
            settings,
            model,
            keep,
            trajectory,
            run: Run::default(),
            window: FULL_WINDOW,
            time: 0.0,
            prepared: Vec::new(),
            phases: Vec::new(),
            joining: Joining::default(),
            at: start,
            tool: ToolLength::default(),
            refused: false,
            ended: false,
            ended_rapid: false,
            figures: Figures::default(),
            messages: Messages::default(),
            track: None,
            tracked: 0,
            released: false,
        }
    }

    /// Appends programmed poses and places of the setpoints to a track while it makes them.
    pub fn follow(&mut self, track: &SharedTrack) {
        track.lock().add_pieces(&self.trajectory, self.tracked);
        self.tracked = self.trajectory.pieces.len();
        self.track = Some(track.clone());
    }

    /// Plans a part of the look-ahead now, for a machine that waits for setpoints: half of it, or
    /// all of it, up to a standstill, if it `ends` because the next step is not known in time.
    ///
    /// # Errors
    ///
    /// Returns a pose that the machine cannot reach.
    pub fn hurry(&mut self, ends: bool) -> Result<(), Problem> {
        if self.refused {
            return Ok(());
        }
        let count = self.run.blocks.len() / 2;
        let made = if ends {
            self.released = true;
            self.stop()
        } else if count > 0 {
            self.plan_blocks(count)
        } else {
            return Ok(());
        };
        self.discard();
        made
    }

    /// Plans the look-ahead and makes the setpoints of its first blocks.
    fn plan_blocks(&mut self, count: usize) -> Result<(), Problem> {
        self.run.plan();
        self.lay_blocks(count)?;
        self.emit(false)
    }

    /// Checks that the machine can be at the start pose.
    ///
    /// # Errors
    ///
    /// Returns why not.
    pub fn check_start(&mut self) -> Result<(), Problem> {
        block::check_pose(&self.at, &self.settings, &self.model).map_err(|(what, _)| {
            self.refused = true;
            Problem {
                place: Place {
                    line: 1,
                    column: 1,
                    ..Place::default()
                },
                what: format!("the machine cannot be at the start of the program: {what}"),
                remedy: "home the machine".into(),
            }
        })?;
        Ok(())
    }

    /// Adds a step.
    ///
    /// # Errors
    ///
    /// Returns what the machine cannot do, with the place of the block.
    pub fn step(&mut self, step: &Step) -> Result<(), Problem> {
        self.released = false;
        // Moves on both sides of another step are not joined.
        let joined = match step {
            Step::Move(_) => Ok(()),
            _ => self.add_joined(),
        };
        joined.and(self.add_step(step))
    }

    fn add_step(&mut self, step: &Step) -> Result<(), Problem> {
        let (mut first, mut second, mut seconds) = (Action::None, Action::None, 0.0);
        match step {
            Step::Move(step) => return self.add(step),
            Step::Message { place, text } => {
                if self.keep != Keep::Nothing {
                    self.messages.add(*place, text);
                }
                return Ok(());
            }
            Step::Dwell { seconds: dwell, .. } => seconds = *dwell,
            Step::Spindle { rpm, place } => {
                first = Action::Spindle(self.checked_speed(*rpm, *place)?);
            }
            // The operator changes the tool during a pause.
            Step::Pause { place } | Step::ToolChange { place, .. } => {
                self.messages.drop_block(*place);
                first = Action::Pause;
            }
            Step::Coolant { mist, flood, .. } => {
                [first, second] = outputs::coolant(&self.settings.outputs, *flood, *mist);
            }
            Step::Output { number, value, .. } => {
                let action = outputs::action(&self.settings.outputs, *number, *value);
                first = action.map_err(|(what, remedy)| {
                    self.refused = true;
                    Problem {
                        place: step.place(),
                        what,
                        remedy,
                    }
                })?;
            }
            // A check plans a probe move to its programmed end, with a standstill at both ends.
            Step::Probe { step, .. } if self.keep == Keep::Nothing => {
                self.stop()?;
                self.add(step)?;
            }
            Step::Wait { .. } if self.keep == Keep::Nothing => {}
            Step::Probe { .. } | Step::Wait { .. } => {
                self.refused = true;
                return Err(Problem {
                    place: step.place(),
                    what: "a job has no probe moves (G38) and no waits for inputs (M66)".into(),
                    remedy: "run the file with `haptimill run` without --stream, or probe with \
                             `haptimill mdi`"
                        .into(),
                });
            }
        }
        let place = step.place();
        if self.refused {
            return Ok(());
        }
        let stopped = self.stop();
        self.emitter.messages = self.messages.count();
        let at = self.machine_pose();
        if matches!(step, Step::Dwell { .. }) {
            self.emitter.rest(&at, seconds, place, &self.settings);
        }
        for action in [first, second] {
            if action != Action::None {
                self.emitter.act(&at, action, place, &self.settings);
            }
        }
        self.discard();
        stopped
    }

    /// Ends the program, or what of it was not refused, at standstill. `line` is the last one of
    /// the program.
    ///
    /// # Errors
    ///
    /// Returns a pose of the last motion that the machine cannot reach.
    pub fn finish(&mut self, line: u32) -> Result<(), Problem> {
        let stopped = self.stop();
        if self.emitter.count == 0 {
            let end = Place {
                line,
                column: 1,
                ..Place::default()
            };
            self.emitter
                .rest(&self.machine_pose(), 0.0, end, &self.settings);
        }
        self.discard();
        self.ended = true;
        stopped
    }

    /// Takes the setpoints that are made; before the end all but the last one, which may get the
    /// next action, unless the next step is late.
    pub fn made(&mut self) -> std::vec::Drain<'_, Planned> {
        let made = self.emitter.made.len();
        let is_kept = !self.ended && !self.released && made > 0;
        let count = made - usize::from(is_kept);
        let mut track = self.track.as_ref().map(SharedTrack::lock);
        for planned in &self.emitter.made[..count] {
            if let Some(track) = &mut track {
                track.add_place(planned.place);
            }
            show(&mut self.messages, track.as_deref_mut(), planned.messages);
        }
        if self.ended {
            // A message after the last motion has no motion of its own.
            show(&mut self.messages, track.as_deref_mut(), u32::MAX);
        }
        drop(track);
        self.emitter.made.drain(..count)
    }

    /// Returns the figures of what is planned.
    pub fn figures(&self) -> Figures {
        Figures {
            duration_s: self.emitter.time(),
            setpoints: if self.keep == Keep::Nothing {
                0
            } else {
                self.emitter.count
            },
            peak_joint_rates: self.emitter.peak_joint_rates,
            ..self.figures
        }
    }

    /// Takes the messages whose setpoints are not taken.
    pub(crate) fn take_messages(&mut self) -> Messages {
        std::mem::take(&mut self.messages)
    }

    pub(crate) fn into_trajectory(self) -> Trajectory {
        self.trajectory
    }

    /// Returns the speed of the spindle if it is within its limits at the override.
    fn checked_speed(&mut self, rpm: i16, place: Place) -> Result<i16, Problem> {
        let Settings {
            spindle_rpm: [slowest, fastest],
            spindle_percent: percent,
            ..
        } = self.settings;
        let speed = rpm.unsigned_abs();
        if speed == 0 {
            return Ok(rpm);
        }
        let turns = f64::from(speed) * f64::from(percent) / 100.0;
        if !(f64::from(slowest)..=f64::from(fastest)).contains(&turns) {
            self.refused = true;
            let scaled = match percent {
                100 => String::new(),
                percent => format!(" at a spindle override of {percent} % is {turns:.0} rev/min"),
            };
            return Err(Problem {
                place,
                what: format!(
                    "S{speed}{scaled}: the spindle of the machine turns at {slowest} to {fastest} \
                     rev/min"
                ),
                remedy: "change S, or min_rpm and max_rpm in [spindle] of the machine file".into(),
            });
        }
        let [min, max] = self.figures.spindle_rpm.unwrap_or([speed; 2]);
        self.figures.spindle_rpm = Some([min.min(speed), max.max(speed)]);
        Ok(rpm)
    }

    /// Returns the pose of the machine at the end of the last step.
    fn machine_pose(&self) -> Coordinates {
        self.tool.machine_pose(&self.at)
    }

    /// Adds a move, joined with those before where it can be. Another tool begins at standstill.
    fn add(&mut self, step: &Move) -> Result<(), Problem> {
        if step.tool != self.tool && !self.refused {
            let stopped = self.stop();
            self.discard();
            self.tool = step.tool;
            self.emitter.tool = step.tool;
            self.at = step.path.from;
            stopped?;
        }
        let messages = self.messages.count();
        let kinds = self.settings.kinds();
        if !self.refused && self.joining.extend(step, &kinds) {
            return Ok(());
        }
        let joined = self.add_joined();
        if self.refused || !self.joining.begin(step, messages, &self.settings) {
            return joined.and(self.prepare(step, messages));
        }
        joined
    }

    /// Adds the moves that are joined.
    fn add_joined(&mut self) -> Result<(), Problem> {
        let Some(joined) = self.joining.take() else {
            return Ok(());
        };
        let others = joined.moves.len() - 1;
        let (settings, model) = (&self.settings, &self.model);
        self.prepared.clear();
        let is_possible = others > 0
            && block::prepare(&joined.whole, settings, model, &mut self.prepared).is_ok();
        if is_possible {
            // Figures are those of the program.
            self.figures.blocks += others;
            let programmed: f64 = joined.moves.iter().map(|it| it.path.tip_length()).sum();
            self.figures.path_length_mm += programmed - joined.whole.path.tip_length();
            joined.complete(&mut self.prepared, &self.settings.kinds());
            return self.add_prepared(&joined.whole, joined.messages);
        }
        // One by one: an error has the place of its block.
        let mut result = Ok(());
        for step in &joined.moves {
            result = result.and(self.prepare(step, joined.messages));
        }
        result
    }

    fn prepare(&mut self, step: &Move, messages: u32) -> Result<(), Problem> {
        self.prepared.clear();
        let (settings, model) = (&self.settings, &self.model);
        if let Err(problem) = block::prepare(step, settings, model, &mut self.prepared) {
            // A position that an earlier block is refused for is in the blocks behind it, too.
            let follows = self.refused && block::fails_as_at_its_start(step, settings, model);
            self.refused = true;
            return if follows { Ok(()) } else { Err(problem) };
        }
        if self.refused {
            return Ok(());
        }
        self.add_prepared(step, messages)
    }

    /// Adds the prepared blocks of a move.
    fn add_prepared(&mut self, step: &Move, messages: u32) -> Result<(), Problem> {
        self.at = step.path.to;
        self.figures.slowed += usize::from(self.prepared.iter().any(|block| block.is_slowed));
        for mut block in self.prepared.drain(..) {
            block.messages = messages;
            self.run.push(block, &self.settings);
        }
        if self.run.blocks.len() < self.window && self.run.joined < MAX_JOINED {
            return Ok(());
        }
        let count = self.run.blocks.len() / 2;
        self.window = (2 * self.window).min(FULL_WINDOW);
        let made = self.plan_blocks(count);
        self.discard();
        made
    }

    /// Plans the blocks of the look-ahead up to a standstill.
    fn stop(&mut self) -> Result<(), Problem> {
        // What could be planned before an error comes to a standstill.
        let joined = self.add_joined();
        let count = self.run.blocks.len();
        if count == 0 && !self.run.moves {
            return joined;
        }
        self.run.plan();
        self.ended_rapid = match self.run.blocks.last() {
            Some(block) => block.is_rapid,
            None => self.run.follows_rapid,
        };
        self.lay_blocks(count)?;
        self.run = Run::default();
        let path = self.trajectory.last_path();
        let length = self.trajectory.leg(path).path.length;
        let made = self.emit(true);
        self.trajectory
            .pieces
            .push(Piece::resting(self.time, path, length));
        joined.and(made)
    }

    /// Makes the setpoints of the planned blocks.
    fn emit(&mut self, is_end: bool) -> Result<(), Problem> {
        if self.keep != Keep::Nothing {
            let (settings, model) = (&self.settings, &self.model);
            let emitter = &mut self.emitter;
            return emitter
                .advance(&self.trajectory, self.time, is_end, settings, model)
                .inspect_err(|_| self.refused = true);
        }
        if is_end {
            let at = self.machine_pose();
            self.emitter.skip(self.time, &at, &self.settings);
        }
        Ok(())
    }

    /// Removes what nobody needs any more.
    fn discard(&mut self) {
        if let Some(track) = &self.track {
            let mut track = track.lock();
            track.add_pieces(&self.trajectory, self.tracked);
            self.tracked = self.trajectory.pieces.len();
        }
        match self.keep {
            Keep::All => {}
            Keep::Nothing => {
                self.trajectory.discard(self.time);
                // The next action may be that of the last setpoint.
                let last = self.emitter.made.len().saturating_sub(1);
                self.emitter.made.drain(..last);
            }
            Keep::Setpoints => {
                // The next setpoint begins at the last one; a place is that of a period before.
                let period = f64::from(self.settings.period_us) * 1e-6;
                let from = self.emitter.time() - 2.0 * period;
                let pieces = self.trajectory.discard(from);
                self.emitter.discard(pieces);
                self.tracked = self.tracked.saturating_sub(pieces);
            }
        }
    }
}

/// Moves the messages before a motion to the track; without a track nobody reads them.
fn show(messages: &mut Messages, mut track: Option<&mut Track>, motion: u32) {
    messages.take_before(motion, |text| {
        if let Some(track) = &mut track {
            track.add_message(text);
        }
    });
}
