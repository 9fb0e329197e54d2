//! Reader: modal state and position from block to block, and the steps of the program.

use super::block::{Block, Motion, Plane, Stop, Turn, read_block};
use super::lexer::{Word, lines, read_line};
use super::path::{AxisKind, Coordinates, Path};
use super::problem::{Place, Problems, Refused};
use super::{Feed, Move, Options, Program, Step, geometry};

/// Millimetres per inch.
const INCH_MM: f64 = 25.4;

/// Reads a part program from any bytes. `file` is its name in messages.
///
/// # Errors
///
/// Returns every problem of the file, with line, column and remedy. A program with a problem is
/// refused as a whole.
pub fn read(file: &str, text: &[u8], options: &Options) -> Result<Program, Refused> {
    let mut reader = Reader::new(options);
    let mut comments = Vec::new();
    let mut count = 0;
    for (number, bytes) in lines(text) {
        count = number;
        let line = read_line(number, bytes, &mut comments, &mut reader.problems);
        if let Some(place) = line.percent {
            reader.tape_mark(place, !line.words.is_empty());
        }
        if line.words.is_empty() {
            continue;
        }
        if let Some(ended) = reader.ended {
            let what = format!(
                "this block is after the end of the program in line {}",
                ended.line
            );
            reader.problems.add(
                line.words[0].place,
                what,
                "remove it, or the M2, M30 or % before it",
            );
            break;
        }
        let block = read_block(&line, options, !reader.any_block, &mut reader.problems);
        reader.any_block = true;
        reader.execute(&block);
    }
    let program = Program {
        file: file.to_owned(),
        start: options.start,
        steps: reader.steps,
        comments,
        lines: count,
    };
    reader.problems.into_result(file, program)
}

struct Reader<'a> {
    options: &'a Options,
    kinds: Vec<AxisKind>,
    problems: Problems,
    steps: Vec<Step>,
    at: Coordinates,
    motion: Motion,
    plane: Plane,
    inch: bool,
    incremental: bool,
    exact_stop: bool,
    /// Programmed feed in mm/min, inch/min or deg/min.
    feed: Option<f64>,
    speed: Option<i16>,
    turn: Turn,
    any_block: bool,
    tape_open: bool,
    ended: Option<Place>,
    /// A missing feed is reported once.
    feed_missed: bool,
}

impl<'a> Reader<'a> {
    fn new(options: &'a Options) -> Self {
        Self {
            options,
            kinds: options.kinds(),
            problems: Problems::default(),
            steps: Vec::new(),
            at: options.start,
            motion: Motion::Off,
            plane: Plane::Xy,
            inch: false,
            incremental: false,
            exact_stop: false,
            feed: None,
            speed: None,
            turn: Turn::Off,
            any_block: false,
            tape_open: false,
            ended: None,
            feed_missed: false,
        }
    }

    /// `%` before the first block opens the tape, the next one ends it.
    fn tape_mark(&mut self, place: Place, with_words: bool) {
        if with_words {
            self.problems
                .add(place, "% in a block", "write % on a line of its own");
        } else if !self.any_block && !self.tape_open {
            self.tape_open = true;
        } else if self.ended.is_none() {
            self.ended = Some(place);
        }
    }

    fn execute(&mut self, block: &Block) {
        self.set_modes(block);
        self.set_spindle(block);
        if let (Some(place), Some(word)) = (block.dwell, &block.seconds)
            && word.value > 0.0
            && !block.has_problem
        {
            self.steps.push(Step::Dwell {
                place,
                seconds: word.value,
            });
        }
        self.run_motion(block);
        if let Some((place, stop)) = block.stop {
            match stop {
                Stop::OptionalPause if !self.options.optional_stop => {}
                Stop::Pause | Stop::OptionalPause => self.steps.push(Step::Pause { place }),
                Stop::End => {
                    if self.turn != Turn::Off {
                        self.steps.push(Step::Spindle { place, rpm: 0 });
                    }
                    self.ended = Some(place);
                }
            }
        }
    }

    fn set_modes(&mut self, block: &Block) {
        if let Some((_, motion)) = block.motion {
            self.motion = motion;
        }
        self.plane = block.plane.unwrap_or(self.plane);
        self.incremental = block.incremental.unwrap_or(self.incremental);
        self.exact_stop = block.exact_stop.unwrap_or(self.exact_stop);
        if let Some(inch) = block.inch
            && inch != self.inch
        {
            self.inch = inch;
            // The old feed is in the old unit: the program must give a new one.
            self.feed = None;
        }
        if let Some(word) = &block.feed {
            self.feed = Some(word.value);
        }
    }

    fn set_spindle(&mut self, block: &Block) {
        let mut place = None;
        if let Some(word) = &block.speed {
            // A value out of range was reported; the conversion saturates.
            let speed = Some(word.value as i16);
            if self.turn != Turn::Off && speed != self.speed {
                place = Some(word.place);
            }
            self.speed = speed;
        }
        if let Some((at, turn)) = block.spindle {
            place = Some(at);
            if turn != Turn::Off && self.speed.unwrap_or(0) == 0 {
                self.problems.add(
                    at,
                    "the spindle is started without a speed",
                    "write S with the speed in rev/min",
                );
            }
            self.turn = turn;
        }
        if let Some(place) = place {
            let speed = self.speed.unwrap_or(0);
            let rpm = match self.turn {
                Turn::Off => 0,
                Turn::Clockwise => speed,
                Turn::CounterClockwise => -speed,
            };
            self.steps.push(Step::Spindle { place, rpm });
        }
    }

    fn scale(&self, kind: AxisKind) -> f64 {
        match kind {
            AxisKind::Linear if self.inch => INCH_MM,
            _ => 1.0,
        }
    }

    fn run_motion(&mut self, block: &Block) {
        if block.dwell.is_some() {
            return;
        }
        let is_arc = matches!(self.motion, Motion::Clockwise | Motion::CounterClockwise);
        let arc_word = || {
            block
                .centre
                .iter()
                .flatten()
                .chain(&block.radius)
                .min_by_key(|word| word.place)
        };
        let first: &Word = match (block.first_axis(), arc_word()) {
            (None, None) => {
                if let Some((place, Motion::Clockwise | Motion::CounterClockwise)) = block.motion {
                    self.problems.add(
                        place,
                        "an arc without end point and centre",
                        "write them in the block of G2 or G3",
                    );
                }
                return;
            }
            (Some(word), _) if self.motion == Motion::Off => {
                let what = format!("{} without a motion", word.text);
                return self.problems.add(
                    word.place,
                    what,
                    "write G0, G1, G2 or G3 in this block or before it",
                );
            }
            (_, Some(word)) if !is_arc => {
                let what = format!("{} without an arc", word.text);
                return self.problems.add(
                    word.place,
                    what,
                    "centre and radius belong to G2 and G3: write one, or remove it",
                );
            }
            (Some(word), _) | (None, Some(word)) => word,
        };
        let to = self.target(block);
        let from = std::mem::replace(&mut self.at, to);
        if block.has_problem {
            return;
        }
        let path = if is_arc {
            let place = block.motion.map_or(first.place, |(place, _)| place);
            let scale = self.scale(AxisKind::Linear);
            let ends = (&from, &to);
            match geometry::read_arc(
                block,
                (place, self.motion),
                self.plane,
                scale,
                ends,
                self.options,
                &mut self.problems,
            ) {
                Some(arc) => Path::arc(&self.kinds, from, to, arc),
                None => return,
            }
        } else {
            Path::line(&self.kinds, from, to)
        };
        // A block that ends at its start is no move, but the position becomes exactly the
        // programmed one.
        let Some(path) = path else { return };
        let feed = match (self.motion, self.feed) {
            (Motion::Rapid, _) => Feed::Rapid,
            (_, Some(feed)) => {
                let kind = if path.tip_length() > 0.0 {
                    AxisKind::Linear
                } else {
                    AxisKind::Rotary
                };
                Feed::PerMinute(feed * self.scale(kind))
            }
            (_, None) => {
                if !self.feed_missed {
                    let unit = if self.inch {
                        "inch/min (a change of the unit ends the old feed)"
                    } else {
                        "mm/min"
                    };
                    self.problems.add(
                        first.place,
                        "a move at feed without a feed",
                        format!("write F with the feed in {unit}"),
                    );
                }
                self.feed_missed = true;
                return;
            }
        };
        let exact_stop = self.exact_stop;
        self.steps.push(Step::Move(Move {
            place: first.place,
            path,
            feed,
            exact_stop,
        }));
    }

    /// Returns the end point of a block.
    fn target(&self, block: &Block) -> Coordinates {
        let mut to = self.at;
        for (k, (word, kind)) in block.axes.iter().zip(&self.kinds).enumerate() {
            if let Some(word) = word {
                let value = word.value * self.scale(*kind);
                to[k] = if self.incremental {
                    to[k] + value
                } else {
                    value
                };
            }
        }
        to
    }
}
