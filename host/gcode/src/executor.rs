//! Executor: runs one block in the order of RS274/NGC.

use super::block::{AXIS_LETTERS, Block, Word};
use super::canonical::Step;
use super::codes::{Code, Group, word};
use super::expression::{Read, Scan, text_of};
use super::output::{Leg, MoveFeed, Output};
use super::problem::{Cause, Mistake, Notice, Place, place_of};
use super::saved_modes::SavedModes;
use super::series::{ControlPoint, Cycle};
use super::state::{FeedMode, Motion, PathControl, Plane, State, Turn};
use super::tool_axis::ToolLength;
use super::{LONGEST_DWELL_S, Options};
use std::collections::HashSet;

/// What a block does to the order of blocks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Next {
    /// The next block follows.
    Block,
    /// M2 or M30.
    End,
    /// M98 P L.
    Call {
        number: f64,
        repeats: u32,
        at: usize,
    },
    /// M99.
    Return { at: usize },
}

/// The line of a block, for places and messages.
#[derive(Clone, Copy)]
pub(crate) struct Here<'a> {
    pub line: &'a [u8],
    pub file: u16,
    pub number: u32,
}

impl Here<'_> {
    pub(crate) fn place(&self, at: usize) -> Place {
        place_of(self.file, self.number, self.line, at)
    }

    pub(crate) fn text(&self, word: Word) -> String {
        text_of(&self.line[word.at..word.end])
    }
}

/// Runs blocks.
pub(crate) struct Executor {
    pub state: State,
    pub out: Output,
    pub options: Options,
    pub notices: Vec<Notice>,
    noticed: HashSet<&'static str>,
    /// Modes that M70 or M73 saved, for the main program and each call in progress.
    pub saved: Vec<Option<SavedModes>>,
    pub cycle: Cycle,
    pub control_points: Vec<ControlPoint>,
    /// Control vector of the last G5, for the next one.
    pub last_tangent: Option<[f64; 2]>,
    /// Whether the next arc is refused because compensation was just switched off.
    pub arc_is_refused: bool,
}

pub(crate) fn mistake<T>(at: usize, what: impl Into<String>, remedy: &str) -> Read<T> {
    Err(Box::new(Mistake::new(at, what, remedy)))
}

impl Executor {
    pub(crate) fn new(state: State, out: Output, options: Options) -> Self {
        Self {
            state,
            out,
            options,
            notices: Vec::new(),
            noticed: HashSet::new(),
            saved: vec![None],
            cycle: Cycle::default(),
            control_points: Vec::new(),
            last_tangent: None,
            arc_is_refused: false,
        }
    }

    /// Notes once per program that a word changes nothing, or refuses it.
    ///
    /// # Errors
    ///
    /// The options refuse such words.
    pub(crate) fn notice(
        &mut self,
        here: &Here,
        at: usize,
        key: &'static str,
        what: String,
    ) -> Read<()> {
        if self.options.strict {
            return mistake(at, what, "remove it, or run without --strict");
        }
        self.advise(here, at, key, what);
        Ok(())
    }

    /// Notes once per program what is allowed and is often a mistake.
    pub(crate) fn advise(&mut self, here: &Here, at: usize, key: &'static str, what: String) {
        if self.noticed.insert(key) {
            self.notices.push(Notice {
                place: here.place(at),
                what,
            });
        }
    }

    /// Runs a block.
    pub(crate) fn run(&mut self, block: &mut Block, here: &Here) -> Read<Next> {
        self.show_messages(block, here)?;
        for (parameter, value) in &block.assignments {
            if let Err((what, remedy)) = self.state.assign(parameter, *value) {
                return mistake(block.first.unwrap_or(0), what, remedy);
            }
        }
        self.check_words(block, here)?;
        let before = self.state.modes;
        self.set_units_and_feed(block, here)?;
        self.set_spindle(block, here)?;
        self.select_tool(block, here)?;
        self.set_outputs(block, here)?;
        self.change_tool(block, here)?;
        self.turn_spindle(block, here)?;
        self.save_modes(block, &before, here)?;
        self.set_coolant(block, here)?;
        self.set_overrides(block, here)?;
        self.dwell(block, here)?;
        self.set_compensation(block, here)?;
        self.set_tool_length(block, here)?;
        self.set_system(block)?;
        self.set_path_control(block)?;
        self.set_distances(block);
        self.place_program();
        self.run_once(block, here)?;
        self.place_program();
        self.run_motion(block, here)?;
        self.stop(block, here)
    }

    /// Applies the offsets and the tool in force to the next moves.
    fn place_program(&mut self) {
        self.out.frame = self.state.frame();
        self.out.tool = match self.state.length.length {
            0.0 => ToolLength::default(),
            length => ToolLength {
                axis: self.options.tool_axis,
                length,
            },
        };
    }

    fn show_messages(&mut self, block: &Block, here: &Here) -> Read<()> {
        let is_pause = matches!(block.codes.tenths(Group::Stop), Some(0 | 10 | 600));
        for comment in &block.comments {
            let bytes = &here.line[comment.from..comment.to];
            let text = text_of(bytes);
            let head: String = text
                .chars()
                .take(6)
                .collect::<String>()
                .to_ascii_lowercase();
            let (text, values) = if head.starts_with("msg,") {
                (text[4..].trim().to_owned(), false)
            } else if head.starts_with("print,") || head.starts_with("debug,") {
                (text[6..].trim().to_owned(), true)
            } else if head.starts_with("log") || head.starts_with("probe") {
                let is_command = [
                    "logopen",
                    "logclose",
                    "logappend",
                    "log,",
                    "probeopen",
                    "probeclose",
                ]
                .iter()
                .any(|command| text.to_ascii_lowercase().starts_with(command));
                if is_command {
                    let what = format!("({text}) writes no file on this machine");
                    self.notice(here, comment.at, "log", what)?;
                }
                continue;
            } else if is_pause && !text.is_empty() {
                (text, false)
            } else {
                continue;
            };
            let text = if values {
                self.with_values(&text)
            } else {
                text
            };
            self.out.push(Step::Message {
                place: here.place(comment.at),
                text,
            });
        }
        Ok(())
    }

    /// Replaces the parameters of a text by their values.
    fn with_values(&self, text: &str) -> String {
        let bytes = text.as_bytes();
        let mut shown = Vec::with_capacity(bytes.len());
        let mut at = 0;
        while let Some(&byte) = bytes.get(at) {
            if byte == b'#' {
                let mut scan = Scan::new(bytes, at, &self.state);
                match scan.value() {
                    Ok(value) => {
                        let value = format!("{value:.6}");
                        let value = value.trim_end_matches('0').trim_end_matches('.');
                        shown.extend_from_slice(value.as_bytes());
                    }
                    Err(_) => shown.extend_from_slice(b"######"),
                }
                at = scan.at.max(at + 1);
            } else {
                shown.push(byte);
                at += 1;
            }
        }
        String::from_utf8_lossy(&shown).into_owned()
    }

    fn set_units_and_feed(&mut self, block: &Block, here: &Here) -> Read<()> {
        if let Some(code) = block.codes.get(Group::Plane) {
            let plane = match code.tenths {
                170 => Plane::Xy,
                180 => Plane::Zx,
                _ => Plane::Yz,
            };
            if plane != self.state.modes.plane {
                self.refuse_while_compensated(code, here)?;
                self.state.modes.plane = plane;
            }
        }
        if let Some(code) = block.codes.get(Group::Unit) {
            let inch = matches!(code.tenths, 200 | 700);
            if inch != self.state.modes.inch {
                self.state.modes.inch = inch;
                if self.state.modes.feed.is_some() && block.word(b'F').is_none() {
                    let what = format!(
                        "the feed stays {:.3} mm/min after {}",
                        self.state.modes.feed_mm,
                        word(here.line, code)
                    );
                    self.notice(here, code.at, "unit", what)?;
                }
            }
        }
        if let Some(tenths) = block.codes.tenths(Group::FeedMode) {
            let mode = match tenths {
                930 => FeedMode::InverseTime,
                950 => FeedMode::PerTurn,
                _ => FeedMode::PerMinute,
            };
            if mode != self.state.modes.feed_mode {
                // The feed of another mode has another unit.
                self.state.modes.feed = None;
            }
            self.state.modes.feed_mode = mode;
        }
        if let Some(word) = block.word(b'F') {
            let at_feed = !matches!(self.motion_of(block), Motion::Off | Motion::Rapid);
            if word.value < 0.0 || (word.value == 0.0 && at_feed) {
                return mistake(
                    word.at,
                    format!("feed {} is not above zero", here.text(word)),
                    "write a positive feed",
                );
            }
            let is_some = word.value > 0.0;
            self.state.modes.feed = is_some.then_some(word.value);
            self.state.modes.feed_mm = word.value * self.state.unit();
        }
        Ok(())
    }

    /// Refuses a code that cannot be run while cutter compensation is on.
    pub(crate) fn refuse_while_compensated(&self, code: Code, here: &Here) -> Read<()> {
        if self.out.compensation.active.is_some() {
            return mistake(
                code.at,
                format!("{} while cutter compensation is on", word(here.line, code)),
                "switch it off (G40) before",
            );
        }
        Ok(())
    }

    fn dwell(&mut self, block: &Block, here: &Here) -> Read<()> {
        let Some(code) = block.codes.get(Group::Once) else {
            return Ok(());
        };
        if code.tenths != 40 {
            return Ok(());
        }
        let Some(word) = block.word(b'P') else {
            return mistake(
                code.at,
                "G4 without its time",
                "write P with the seconds to wait",
            );
        };
        if !(0.0..=LONGEST_DWELL_S).contains(&word.value) {
            return mistake(
                word.at,
                format!("{} is not a dwell time", here.text(word)),
                "write 0 to 3600 seconds",
            );
        }
        if let Some((_, word)) = block.first_of(AXIS_LETTERS)
            && block.codes.get(Group::Motion).is_none()
        {
            return mistake(
                word.at,
                "an axis word in the block of G4",
                "write the motion word too (the dwell is before the move), or another block",
            );
        }
        self.push_dwell(here.place(code.at), word.value);
        Ok(())
    }

    pub(crate) fn push_dwell(&mut self, place: Place, seconds: f64) {
        if seconds > 0.0 {
            self.out.push(Step::Dwell { place, seconds });
        }
    }

    fn set_system(&mut self, block: &Block) -> Read<()> {
        if let Some(code) = block.codes.get(Group::System) {
            let index = match code.tenths {
                590..=593 => 5 + usize::from(code.tenths - 590),
                tenths => usize::from(tenths - 540) / 10,
            };
            if index != self.state.modes.system && self.out.compensation.active.is_some() {
                return mistake(
                    code.at,
                    "the coordinate system changes while cutter compensation is on",
                    "switch it off (G40) before",
                );
            }
            self.state.select_system(index);
        }
        Ok(())
    }

    fn set_path_control(&mut self, block: &Block) -> Read<()> {
        let Some(code) = block.codes.get(Group::PathControl) else {
            return Ok(());
        };
        self.state.modes.path_control = if code.tenths == 640 {
            let words = [block.word(b'P'), block.word(b'Q')];
            if let Some(word) = words.iter().flatten().find(|word| word.value < 0.0) {
                return mistake(
                    word.at,
                    "a tolerance below zero",
                    "write P and Q with the largest distance from the path",
                );
            }
            let unit = self.state.unit();
            let [tolerance, joining] = words.map(|word| word.map(|word| word.value * unit));
            PathControl::Blend { tolerance, joining }
        } else {
            PathControl::ExactStop
        };
        Ok(())
    }

    fn set_distances(&mut self, block: &Block) {
        match block.codes.tenths(Group::Distance) {
            Some(900) => self.state.modes.incremental = false,
            Some(_) => self.state.modes.incremental = true,
            None => {}
        }
        match block.codes.tenths(Group::CentreDistance) {
            Some(901) => self.state.modes.absolute_centres = true,
            Some(_) => self.state.modes.absolute_centres = false,
            None => {}
        }
        match block.codes.tenths(Group::Return) {
            Some(990) => self.state.modes.return_to_r = true,
            Some(_) => self.state.modes.return_to_r = false,
            None => {}
        }
    }

    fn stop(&mut self, block: &Block, here: &Here) -> Read<Next> {
        if let Some(code) = block.codes.get(Group::Subprogram) {
            return if code.tenths == 990 {
                Ok(Next::Return { at: code.at })
            } else {
                let Some(number) = block.word(b'P') else {
                    return mistake(
                        code.at,
                        "M98 without its subprogram",
                        "write P with the number of the subprogram",
                    );
                };
                let repeats = block.value(b'L').unwrap_or(1.0);
                if repeats.fract() != 0.0 || !(0.0..=1e6).contains(&repeats) {
                    return mistake(
                        code.at,
                        format!("L{repeats} is not a number of repeats"),
                        "write a whole number from 0 to 1,000,000",
                    );
                }
                Ok(Next::Call {
                    number: number.value,
                    repeats: repeats as u32,
                    at: code.at,
                })
            };
        }
        let Some(code) = block.codes.get(Group::Stop) else {
            return Ok(Next::Block);
        };
        let place = here.place(code.at);
        match code.tenths {
            10 if !self.options.optional_stop => {}
            0 | 10 | 600 => self.out.push(Step::Pause { place }),
            _ => {
                self.finish(place);
                return Ok(Next::End);
            }
        }
        Ok(Next::Block)
    }

    /// Ends the program: spindle and coolant off.
    fn finish(&mut self, place: Place) {
        self.out.release();
        if self.state.modes.turn != Turn::Off {
            self.state.modes.turn = Turn::Off;
            self.out.push(Step::Spindle { place, rpm: 0 });
        }
        if self.options.coolant && (self.state.modes.mist || self.state.modes.flood) {
            self.out.push(Step::Coolant {
                place,
                mist: false,
                flood: false,
            });
        }
    }

    /// Returns the feed of a move.
    ///
    /// # Errors
    ///
    /// No feed is in force.
    pub(crate) fn move_feed(&self, at: usize, block: &Block) -> Read<MoveFeed> {
        let modes = &self.state.modes;
        let missing = |what: &str, remedy: &str| {
            Err(Box::new(
                Mistake::new(at, what, remedy).because(Cause::Feed),
            ))
        };
        match modes.feed_mode {
            FeedMode::InverseTime => match block.value(b'F') {
                Some(rate) if rate > 0.0 => Ok(MoveFeed::Inverse(rate)),
                _ => missing(
                    "a move with inverse time (G93) without F",
                    "write F in each block: moves per minute",
                ),
            },
            FeedMode::PerMinute | FeedMode::PerTurn => {
                let Some(feed) = modes.feed else {
                    return missing(
                        "a move at feed without a feed",
                        &format!(
                            "write F with the feed in {}",
                            match (modes.feed_mode, modes.inch) {
                                (FeedMode::PerTurn, true) => "inch per revolution",
                                (FeedMode::PerTurn, false) => "mm per revolution",
                                (_, true) => "inch/min",
                                (_, false) => "mm/min",
                            }
                        ),
                    );
                };
                if modes.feed_mode == FeedMode::PerMinute {
                    return Ok(MoveFeed::PerMinute(modes.feed_mm, feed));
                }
                let rpm = self.rpm();
                if modes.turn == Turn::Off || rpm < 1.0 {
                    return missing(
                        "a feed per revolution (G95) while the spindle is off",
                        "start the spindle (S, M3) before",
                    );
                }
                Ok(MoveFeed::PerMinute(modes.feed_mm * rpm, feed * rpm))
            }
        }
    }

    /// Returns a straight leg with the modes in force.
    pub(crate) fn line_to(&self, place: Place, to: super::PerLetter, move_feed: MoveFeed) -> Leg {
        let (exact_stop, tolerance, joining) = match self.state.modes.path_control {
            PathControl::ExactStop => (true, None, None),
            PathControl::Blend { tolerance, joining } => (false, tolerance, joining),
        };
        Leg {
            place,
            to,
            arc: None,
            fixed: self.state.modes.fixed,
            move_feed,
            exact_stop,
            tolerance,
            joining,
        }
    }
}
