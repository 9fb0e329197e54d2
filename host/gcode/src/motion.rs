//! Motion of a block: end points, lines, arcs and probe moves.

use super::arcs::{self, Ends, Refusal};
use super::block::{AXES, AXIS_LETTERS, Block, letters};
use super::canonical::{ProbeKind, Step};
use super::codes::{Code, Group, word};
use super::executor::{Executor, Here, mistake};
use super::expression::Read;
use super::frame::Frame;
use super::output::{Leg, MoveFeed};
use super::problem::{Cause, Mistake, Place};
use super::state::{FeedMode, Motion, PROBE_DONE, PROBED};
use super::tool_table::PerLetter;

/// Degrees of a turn.
const TURN: f64 = 360.0;

/// Angles within this are the same, degrees: a program that is where a word wants it to be makes no
/// turn because of a rounding.
const SAME_ANGLE: f64 = 1e-6;

/// End of a coordinate that wraps around, from `at`: at the angle of the word's magnitude, in the
/// direction of its sign, less than a turn away.
fn turned_to(at: f64, word: f64, shift: f64) -> f64 {
    let angle = word.abs() + shift;
    let turns = if word.is_sign_negative() {
        ((at + SAME_ANGLE - angle) / TURN).floor()
    } else {
        ((at - SAME_ANGLE - angle) / TURN).ceil()
    };
    angle + turns * TURN
}

const ARC_LETTERS: u32 = letters(b"IJKR");

/// Most turns of an arc (P).
const MAX_TURNS: f64 = 10_000.0;

/// Words of the centre of an arc, by axis.
const CENTRES: [u8; 3] = *b"IJK";

fn refused<T>(at: usize, (what, remedy): Refusal) -> Read<T> {
    Err(Box::new(
        Mistake::new(at, what, remedy).because(Cause::Position),
    ))
}

impl Executor {
    /// Returns the end point of a block in machine coordinates.
    pub(crate) fn target(&self, block: &Block, in_machine: bool) -> PerLetter {
        let state = &self.state;
        let mut to = if in_machine {
            state.length.machine_pose(&state.at)
        } else {
            state.at
        };
        let relative = state.modes.incremental && !in_machine;
        let turned = !state.rotation.is_none() && !in_machine;
        let mut step = [0.0; 2];
        let here = if turned {
            state.in_program(&state.at)
        } else {
            PerLetter::default()
        };
        for (axis, letter) in AXES.iter().enumerate() {
            let Some(value) = block.value(*letter) else {
                continue;
            };
            let value = value * state.scale(axis);
            if turned && axis < 2 {
                // The turned axes are moved together below.
                step[axis] = if relative { value } else { value - here[axis] };
            } else if relative {
                to[axis] += value;
            } else {
                let shift = if in_machine { 0.0 } else { state.shift[axis] };
                to[axis] = if self.wraps(*letter) {
                    turned_to(to[axis], value, shift)
                } else {
                    value + shift
                };
            }
        }
        if turned {
            let turned = state.rotation.turn(step);
            to[0] += turned[0];
            to[1] += turned[1];
        }
        if in_machine {
            return state.length.tip_pose(&to);
        }
        self.polar_end(block, &mut to);
        to
    }

    /// Sets X and Y of an end point in machine coordinates that the block states with a distance
    /// from the origin of the program and an angle. Without one of them, that of the position.
    pub(crate) fn polar_end(&self, block: &Block, to: &mut PerLetter) {
        let Some([distance, angle]) = block.polar() else {
            return;
        };
        let state = &self.state;
        let mut at = state.in_program(&state.at);
        let here = [libm::hypot(at[0], at[1]), libm::atan2(at[1], at[0])];
        let given = [
            distance.map(|distance| distance * state.unit()),
            angle.map(f64::to_radians),
        ];
        let [distance, angle] = if state.modes.incremental {
            [0, 1].map(|k| here[k] + given[k].unwrap_or(0.0))
        } else {
            [0, 1].map(|k| given[k].unwrap_or(here[k]))
        };
        let (sin, cos) = libm::sincos(angle);
        (at[0], at[1]) = (distance * cos, distance * sin);
        let at = state.in_machine(&at);
        (to[0], to[1]) = (at[0], at[1]);
    }

    /// Refuses polar coordinates where they have no meaning.
    fn check_polar(&self, block: &Block, in_machine: bool, at: usize) -> Read<()> {
        if block.polar().is_none() {
            return Ok(());
        }
        let state = &self.state;
        let here = state.in_program(&state.at);
        let (what, remedy) = if in_machine {
            ("polar coordinates with G53", "write X and Y")
        } else if state.modes.plane.axes()[2] != 2 {
            (
                "polar coordinates outside the plane of G17",
                "write G17 before, or X, Y and Z",
            )
        } else if state.modes.incremental && libm::hypot(here[0], here[1]) < 1e-9 {
            (
                "incremental polar coordinates at the origin, which has no angle",
                "move off the origin before, or write G90",
            )
        } else {
            return Ok(());
        };
        mistake(at, what, remedy)
    }

    /// Whether the coordinate of a letter wraps around.
    fn wraps(&self, letter: u8) -> bool {
        let mut axes = self.options.axes.iter();
        axes.any(|axis| axis.wraps && axis.letter == char::from(letter))
    }

    /// Refuses an absolute angle of a turn or more on a coordinate that wraps around.
    fn check_angles(&self, block: &Block, in_machine: bool) -> Read<()> {
        if self.state.modes.incremental && !in_machine {
            return Ok(());
        }
        for letter in AXES {
            let value = block.value(letter).unwrap_or(0.0);
            if self.wraps(letter) && value.abs() >= TURN {
                let at = block.first_of(letters(&[letter]));
                return mistake(
                    at.map_or(0, |(_, word)| word.at),
                    format!(
                        "{}{value} is a turn or more, on a coordinate that wraps around",
                        char::from(letter)
                    ),
                    "write an angle below 360, with a minus sign to turn backwards; G91 turns farther",
                );
            }
        }
        Ok(())
    }

    /// Runs the motion of a block.
    pub(crate) fn run_motion(&mut self, block: &Block, here: &Here) -> Read<()> {
        let code = block.codes.get(Group::Motion);
        if let Some(code) = code {
            if code.tenths == 53 {
                return self.finish_nurbs(block, here, code);
            }
            let open = self.refuse_open_nurbs(code.tenths, code.at);
            if let Some(motion) = Motion::of(code.tenths) {
                if let Motion::Cycle(_) = motion {
                    self.refuse_while_compensated(code, here)?;
                }
                self.begin_motion(motion);
            }
            open?;
        }
        let has_axis_code = block.axis_code().is_some();
        let machine = block.codes.get(Group::Machine);
        if let Some(machine) = machine {
            if has_axis_code || (code.is_none() && !block.has_any(AXIS_LETTERS)) {
                return mistake(
                    machine.at,
                    "G53 without a move",
                    "write G53 G0 or G53 G1 with the machine coordinates, or remove it",
                );
            }
            self.check_machine_move(machine, here)?;
            self.out.frame = Frame::default();
        }
        if has_axis_code {
            return Ok(());
        }
        let motion = self.state.modes.motion;
        let first_axis = block.first_of(AXIS_LETTERS).map(|(_, word)| word);
        if motion == Motion::Nurbs {
            return self.control_point(block, here, code);
        }
        let words = AXIS_LETTERS | if motion.is_arc() { ARC_LETTERS } else { 0 };
        let Some((_, first)) = block.first_of(words) else {
            return self.check_empty_motion(code, here);
        };
        self.advise_on_motion(block, here, motion)?;
        let first = first_axis.unwrap_or(first);
        let place = here.place(first.at);
        self.check_angles(block, machine.is_some())?;
        self.check_polar(block, machine.is_some(), first.at)?;
        let to = self.target(block, machine.is_some());
        match motion {
            Motion::Rapid => self.travel_to(to, MoveFeed::Rapid, place, first.at),
            Motion::Straight => {
                let move_feed = self.move_feed(first.at, block);
                let Ok(move_feed) = move_feed else {
                    self.state.at = to;
                    return move_feed.map(|_| ());
                };
                self.travel_to(to, move_feed, place, first.at)
            }
            Motion::Clockwise | Motion::CounterClockwise => {
                let at = code.map_or(first.at, |code| code.at);
                // The end is known even if the arc is wrong.
                let arc = self.arc(block, here, at, to);
                match arc.and_then(|leg| Ok((leg, self.move_feed(first.at, block)?))) {
                    Ok((leg, move_feed)) => self.travel(
                        Leg {
                            place,
                            move_feed,
                            ..leg
                        },
                        to,
                        first.at,
                    ),
                    Err(found) => {
                        self.state.at = to;
                        Err(found)
                    }
                }
            }
            Motion::Probe(kind) => self.probe(block, kind, to, place, first.at),
            Motion::Cycle(number) => self.run_series(block, here, number, to, first.at),
            Motion::Cubic | Motion::Quadratic => self.spline(block, here, to, first.at),
            Motion::Nurbs | Motion::Off => Ok(()),
        }
    }

    /// Notes what is often forgotten: the length of a new tool, and the plane of an arc.
    fn advise_on_motion(&mut self, block: &Block, here: &Here, motion: Motion) -> Read<()> {
        let at = block.first.unwrap_or(0);
        let cuts = motion.is_arc() || matches!(motion, Motion::Straight | Motion::Cycle(_));
        let state = &self.state;
        if cuts
            && state.length_is_open
            && let Some(tool) = state.tool_of(state.tool)
            && tool.offset != state.tool_offset
        {
            let what = format!(
                "tool {} cuts without its length: no G43 came after the tool was changed",
                state.tool
            );
            self.advise(here, at, "length", what);
        }
        let plane = self.state.modes.plane;
        let [first, second, normal] = plane.axes();
        if motion.is_arc()
            && normal != 2
            && let Some(word) = block.word(CENTRES[normal])
            && word.value == 0.0
        {
            let what = format!(
                "{} changes nothing: the arc is in the plane {} {} of {}",
                here.text(word),
                char::from(AXES[first]),
                char::from(AXES[second]),
                plane.word()
            );
            self.notice(here, word.at, "plane", what)?;
        }
        Ok(())
    }

    fn begin_motion(&mut self, motion: Motion) {
        let before = self.state.modes.motion;
        self.state.modes.motion = motion;
        if !matches!(motion, Motion::Cycle(_)) || !matches!(before, Motion::Cycle(_)) {
            self.cycle.initial_level = None;
        }
        if motion != before {
            self.cycle.forget_words();
        }
        if motion != Motion::Cubic {
            self.last_tangent = None;
        }
    }

    fn check_empty_motion(&self, code: Option<Code>, here: &Here) -> Read<()> {
        let Some(code) = code else {
            return Ok(());
        };
        match self.state.modes.motion {
            Motion::Clockwise | Motion::CounterClockwise => mistake(
                code.at,
                "an arc without end point and centre",
                "write them in the block of G2 or G3",
            ),
            Motion::Probe(_) | Motion::Cycle(_) | Motion::Cubic | Motion::Quadratic => mistake(
                code.at,
                format!("{} without axis words", word(here.line, code)),
                "write its end point in the same block",
            ),
            _ => Ok(()),
        }
    }

    fn check_machine_move(&self, code: Code, here: &Here) -> Read<()> {
        let motion = self.state.modes.motion;
        if !matches!(motion, Motion::Rapid | Motion::Straight) {
            return mistake(
                code.at,
                "G53 without G0 or G1",
                "write G53 G0 or G53 G1 with the machine coordinates",
            );
        }
        if self.state.modes.incremental {
            return mistake(
                code.at,
                "G53 with incremental distances",
                "write G90 before: machine coordinates are absolute",
            );
        }
        self.refuse_while_compensated(code, here)
    }

    /// Moves to a position, through cutter compensation.
    pub(crate) fn travel_to(
        &mut self,
        to: PerLetter,
        move_feed: MoveFeed,
        place: Place,
        at: usize,
    ) -> Read<()> {
        let leg = self.line_to(place, to, move_feed);
        self.arc_is_refused = false;
        self.travel(leg, to, at)
    }

    fn travel(&mut self, mut leg: Leg, to: PerLetter, at: usize) -> Read<()> {
        let place = leg.place;
        if let (MoveFeed::Inverse(rate), Some(path)) =
            (leg.move_feed, self.out.path(&self.state.at, &leg))
            && self.state.compensation != 400
        {
            // The feed is that of the programmed path, also around a corner.
            leg.move_feed = MoveFeed::PerMinute(rate * path.length, rate * path.length);
        }
        let done = self.out.travel(leg);
        self.state.at = to;
        if self.state.modes.surface_limit.is_some()
            && self.state.modes.turn != super::state::Turn::Off
        {
            // The surface speed needs another speed at another radius.
            self.send_spindle(place);
        }
        done.or_else(|refusal| refused(at, refusal))
    }

    /// Returns the arc of a block.
    fn arc(&self, block: &Block, here: &Here, at: usize, to: PerLetter) -> Read<Leg> {
        let state = &self.state;
        let plane = state.modes.plane;
        let [first, second, normal] = plane.axes();
        for axis in [first, second] {
            if self.out.coordinate(axis).is_none() {
                let what = format!(
                    "the machine has no plane {} {} ({})",
                    char::from(AXES[first]),
                    char::from(AXES[second]),
                    plane.word()
                );
                return mistake(at, what, "choose a plane of the machine's axes");
            }
        }
        if let Some(word) = block.word(CENTRES[normal])
            && word.value != 0.0
        {
            let what = format!(
                "{} is not in the plane of {}",
                here.text(word),
                plane.word()
            );
            let remedy = "choose the plane with G17, G18 or G19, or the centre word of this plane";
            return mistake(word.at, what, remedy);
        }
        if self.arc_is_refused {
            return mistake(
                at,
                "an arc directly after the end of cutter compensation",
                "write a straight move between G40 and the arc",
            );
        }
        if !state.rotation.is_none() && normal != 2 {
            let found = Mistake::new(
                at,
                "an arc outside the plane of G17 in a turned coordinate system",
                "write G17, or a coordinate system without R",
            );
            return Err(Box::new(found.because(Cause::Plane)));
        }
        let turns = match block.word(b'P') {
            None => 1,
            Some(word) if word.value.fract() == 0.0 && (1.0..=MAX_TURNS).contains(&word.value) => {
                word.value as u32
            }
            Some(word) => {
                return mistake(
                    word.at,
                    format!("{} is not a number of turns", here.text(word)),
                    "write a whole number from 1 to 10000",
                );
            }
        };
        let ends = Ends {
            plane: [first, second],
            start: [state.at[first], state.at[second]],
            end: [to[first], to[second]],
            direction: if state.modes.motion == Motion::CounterClockwise {
                1.0
            } else {
                -1.0
            },
            turns,
        };
        let unit = state.unit();
        let words = [CENTRES[first], CENTRES[second]];
        let centre = words.map(|letter| block.value(letter).map(|value| value * unit));
        let has_centre = centre.iter().any(Option::is_some);
        let radius = block.word(b'R');
        let arc = match (radius, has_centre) {
            (Some(word), true) => {
                return mistake(
                    word.at,
                    "an arc with both a radius and a centre",
                    "write R, or the centre words, not both",
                );
            }
            (None, false) => {
                return mistake(
                    at,
                    "an arc with neither centre nor radius",
                    &format!(
                        "write its centre from the start ({}, {}), or R",
                        char::from(words[0]),
                        char::from(words[1])
                    ),
                );
            }
            (Some(word), false) => match arcs::by_radius(&ends, word.value * unit) {
                Ok(arc) => arc,
                Err(refusal) => return refused(word.at, refusal),
            },
            (None, true) => {
                let offset = if state.modes.absolute_centres {
                    let [Some(a), Some(b)] = centre else {
                        return mistake(
                            at,
                            "an absolute centre (G90.1) with one word",
                            "write both centre words",
                        );
                    };
                    let mut point = state.in_program(&state.at);
                    (point[first], point[second]) = (a, b);
                    let point = state.in_machine(&point);
                    [point[first] - ends.start[0], point[second] - ends.start[1]]
                } else {
                    let offset = centre.map(Option::unwrap_or_default);
                    if normal == 2 {
                        state.rotation.turn(offset)
                    } else {
                        offset
                    }
                };
                match arcs::by_centre(&ends, offset, state.modes.inch) {
                    Ok(arc) => arc,
                    Err(refusal) => return refused(at, refusal),
                }
            }
        };
        let line = self.line_to(here.place(at), to, MoveFeed::Rapid);
        Ok(Leg {
            arc: Some(arc),
            ..line
        })
    }

    fn probe(
        &mut self,
        block: &Block,
        kind: u8,
        to: PerLetter,
        place: Place,
        at: usize,
    ) -> Read<()> {
        if self.out.compensation.active.is_some() {
            return mistake(
                at,
                "a probe move while cutter compensation is on",
                "switch it off (G40) before",
            );
        }
        if self.state.modes.feed_mode == FeedMode::InverseTime {
            return mistake(
                at,
                "a probe move with inverse time (G93)",
                "write G94 before",
            );
        }
        let move_feed = self.move_feed(at, block)?;
        let leg = self.line_to(place, to, move_feed);
        self.state.at = to;
        let Some(step) = self.out.build(&leg) else {
            return mistake(
                at,
                "a probe move that ends where it starts",
                "write an end point beyond the part",
            );
        };
        self.out.push(Step::Probe {
            step,
            kind: if kind <= 3 {
                ProbeKind::Towards
            } else {
                ProbeKind::Away
            },
            must_change: matches!(kind, 2 | 4),
        });
        // Until the machine reports another result, the move ends at its programmed end. Programs
        // repeat moves that need not touch until they do not.
        self.set_probed(to, matches!(kind, 2 | 4));
        Ok(())
    }

    /// Sets the result of a probe move: the position at which the probe changed.
    pub(crate) fn set_probed(&mut self, at: PerLetter, changed: bool) {
        let value = self.state.in_program(&at);
        for (axis, value) in value.iter().enumerate() {
            self.state.numbered[PROBED + axis] = value / self.state.scale(axis);
        }
        self.state.numbered[PROBE_DONE] = f64::from(u8::from(changed));
    }
}
