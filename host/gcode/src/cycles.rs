//! Drilling, tapping and boring cycles: G73, G74, G81 to G89.

use super::block::{Block, letters};
use super::canonical::Step;
use super::executor::{Executor, Here, mistake};
use super::expression::Read;
use super::output::MoveFeed;
use super::problem::{Cause, Mistake, Place};
use super::state::{FeedMode, Turn};
use super::tool_table::PerLetter;

/// Clearance above the last depth of a peck, mm (0.010 inch).
const PECK_CLEARANCE_MM: f64 = 0.254;

/// Most moves of one block.
const MAX_MOVES: f64 = 100_000.0;

/// A hole: levels in machine coordinates.
struct Hole {
    /// Normal axis.
    normal: usize,
    /// Retract plane, bottom, and level after the hole.
    r: f64,
    bottom: f64,
    clear: f64,
    /// Depth of a peck, mm.
    peck: f64,
    /// Seconds.
    dwell: f64,
    place: Place,
    at: usize,
    move_feed: MoveFeed,
    /// The feed belongs to the speed of the spindle: the overrides have no effect.
    is_tapped: bool,
}

impl Executor {
    /// Runs the cycle of a block: one of a series of holes whose words stay in force.
    pub(crate) fn run_series(
        &mut self,
        block: &Block,
        here: &Here,
        number: u8,
        to: PerLetter,
        at: usize,
    ) -> Read<()> {
        if let Some((_, word)) = block.first_of(letters(b"ABCUVW")) {
            return mistake(
                word.at,
                format!("{} in a cycle", here.text(word)),
                "move this axis in a block before the cycle",
            );
        }
        let repeats = block.value(b'L').unwrap_or(1.0);
        if repeats.fract() != 0.0 || !(1.0..=10_000.0).contains(&repeats) {
            return mistake(
                at,
                format!("L{repeats} is not a number of repeats"),
                "write a whole number from 1 to 10000",
            );
        }
        self.run_cycle(block, here, number, to, at, repeats)
            .map_err(|mut found| {
                let [first, second, _] = self.state.modes.plane.axes();
                for axis in [first, second] {
                    self.state.at[axis] = to[axis];
                }
                // The next holes have the same words.
                found.cause.get_or_insert(Cause::Series);
                found
            })
    }

    /// Runs a cycle at the end point of a block.
    fn run_cycle(
        &mut self,
        block: &Block,
        here: &Here,
        number: u8,
        to: PerLetter,
        at: usize,
        repeats: f64,
    ) -> Read<()> {
        let plane = self.state.modes.plane;
        let [first, second, normal] = plane.axes();
        if !self.state.rotation.is_none() && normal != 2 {
            let found = Mistake::new(
                at,
                "a cycle outside the plane of G17 in a turned coordinate system",
                "write G17, or a coordinate system without R",
            );
            return Err(Box::new(found.because(Cause::Plane)));
        }
        if [first, second, normal]
            .iter()
            .any(|axis| self.out.coordinate(*axis).is_none())
        {
            return mistake(
                at,
                format!("the machine has no axes for a cycle with {}", plane.word()),
                "choose a plane of the machine's axes",
            );
        }
        if self.state.modes.feed_mode == FeedMode::InverseTime {
            return mistake(at, "a cycle with inverse time (G93)", "write G94 before");
        }
        let name = format!("G{number}");
        const NORMALS: [u8; 3] = *b"XYZ";
        let depth_letter = NORMALS[normal];
        let unit = self.state.unit();
        self.cycle.depth = block.value(depth_letter).or(self.cycle.depth);
        self.cycle.r = block.value(b'R').or(self.cycle.r);
        self.cycle.peck = block.value(b'Q').or(self.cycle.peck);
        self.cycle.dwell = block.value(b'P').or(self.cycle.dwell);
        for (shift, letter) in self.cycle.shifts.iter_mut().zip(*b"IJK") {
            *shift = block.value(letter).or(*shift);
        }
        let (Some(r), Some(depth)) = (self.cycle.r, self.cycle.depth) else {
            let missing = if self.cycle.r.is_none() {
                "R, its retract plane".to_owned()
            } else {
                format!("{}, its depth", char::from(depth_letter))
            };
            let found = Mistake::new(
                at,
                format!("{name} without {missing}"),
                "write it in the first block of the cycle",
            );
            return Err(Box::new(found.because(Cause::Motion)));
        };
        let needs_peck = matches!(number, 73 | 83);
        let peck = match self.cycle.peck {
            Some(peck) if needs_peck && peck <= 0.0 => {
                return mistake(
                    at,
                    format!("{name} with the peck depth Q{peck}"),
                    "write Q above 0",
                );
            }
            None if needs_peck => {
                return mistake(
                    at,
                    format!("{name} without Q, the depth of a peck"),
                    "write Q above 0",
                );
            }
            peck => peck.unwrap_or(0.0) * unit,
        };
        let dwell = match self.cycle.dwell {
            Some(dwell) if !(0.0..=super::LONGEST_DWELL_S).contains(&dwell) => {
                return mistake(
                    at,
                    format!("P{dwell} is not a dwell time"),
                    "write 0 to 3600 seconds",
                );
            }
            None if matches!(number, 82 | 86 | 88 | 89) => {
                return mistake(
                    at,
                    format!("{name} without P, its dwell"),
                    "write P with the seconds at the bottom",
                );
            }
            dwell => dwell.unwrap_or(0.0),
        };
        let start = self.state.at;
        let incremental = self.state.modes.incremental;
        let shift = self.state.shift[normal];
        let level = *self.cycle.initial_level.get_or_insert(start[normal]);
        let (r, bottom) = if incremental {
            // R counts from the level before the series of cycles, for each hole of it.
            let r = level + r * unit;
            (r, r + depth * unit)
        } else {
            (r * unit + shift, depth * unit + shift)
        };
        if r < bottom {
            return mistake(
                at,
                format!(
                    "the retract plane of {name} is {:.4} mm below its bottom",
                    bottom - r
                ),
                "check R and the depth",
            );
        }
        let clear = if self.state.modes.return_to_r {
            r
        } else {
            level.max(r)
        };
        let pecks = if needs_peck {
            ((r - bottom) / peck).ceil()
        } else {
            1.0
        };
        if pecks * repeats > MAX_MOVES {
            return mistake(
                at,
                format!("{name} makes more than {MAX_MOVES} moves"),
                "write a larger peck depth Q, or fewer repeats L",
            );
        }
        let hole = Hole {
            normal,
            r,
            bottom,
            clear,
            peck,
            dwell,
            place: here.place(at),
            at,
            move_feed: self.move_feed(at, block)?,
            is_tapped: matches!(number, 74 | 84),
        };
        if start[normal] < r {
            self.level(&hole, r, MoveFeed::Rapid)?;
        }
        let step = [to[first] - start[first], to[second] - start[second]];
        for repeat in 1..=repeats as u32 {
            let mut over = self.state.at;
            let times = if incremental { f64::from(repeat) } else { 1.0 };
            over[first] = start[first] + step[0] * times;
            over[second] = start[second] + step[1] * times;
            // Each hole counts distance and angle from the last one.
            self.polar_end(block, &mut over);
            self.exact_to(&hole, over, MoveFeed::Rapid)?;
            if number != 87 {
                self.level(&hole, r, MoveFeed::Rapid)?;
            }
            self.machine_hole(number, &hole)?;
        }
        Ok(())
    }

    /// Moves to a position with an exact stop, as all moves of a cycle.
    fn exact_to(&mut self, hole: &Hole, to: PerLetter, move_feed: MoveFeed) -> Read<()> {
        let mut leg = self.line_to(hole.place, to, move_feed);
        leg.exact_stop = true;
        leg.fixed |= hole.is_tapped;
        self.out.leg(&leg);
        self.state.at = to;
        Ok(())
    }

    fn level(&mut self, hole: &Hole, level: f64, move_feed: MoveFeed) -> Read<()> {
        let mut to = self.state.at;
        if to[hole.normal] == level {
            return Ok(());
        }
        to[hole.normal] = level;
        self.exact_to(hole, to, move_feed)
    }

    fn machine_hole(&mut self, number: u8, hole: &Hole) -> Read<()> {
        match number {
            73 | 83 => {
                let mut depth = hole.r - hole.peck;
                while depth > hole.bottom + 1e-9 {
                    self.level(hole, depth, hole.move_feed)?;
                    if number == 83 {
                        self.level(hole, hole.r, MoveFeed::Rapid)?;
                    }
                    self.level(hole, depth + PECK_CLEARANCE_MM, MoveFeed::Rapid)?;
                    depth -= hole.peck;
                }
                self.level(hole, hole.bottom, hole.move_feed)?;
                self.level(hole, hole.clear, MoveFeed::Rapid)
            }
            81 | 82 => {
                self.level(hole, hole.bottom, hole.move_feed)?;
                if number == 82 {
                    self.push_dwell(hole.place, hole.dwell);
                }
                self.level(hole, hole.clear, MoveFeed::Rapid)
            }
            74 | 84 => {
                let turn = if number == 84 {
                    Turn::Clockwise
                } else {
                    Turn::CounterClockwise
                };
                self.check_turning(hole, number, Some(turn))?;
                self.level(hole, hole.bottom, hole.move_feed)?;
                self.turn(
                    hole,
                    if number == 84 {
                        Turn::CounterClockwise
                    } else {
                        Turn::Clockwise
                    },
                );
                self.push_dwell(hole.place, hole.dwell);
                self.level(hole, hole.clear, hole.move_feed)?;
                self.turn(hole, turn);
                Ok(())
            }
            85 => {
                self.level(hole, hole.bottom, hole.move_feed)?;
                self.level(hole, hole.r, hole.move_feed)?;
                self.level(hole, hole.clear, MoveFeed::Rapid)
            }
            89 => {
                self.level(hole, hole.bottom, hole.move_feed)?;
                self.push_dwell(hole.place, hole.dwell);
                self.level(hole, hole.clear, hole.move_feed)
            }
            86 | 88 => {
                self.check_turning(hole, number, None)?;
                let turn = self.state.modes.turn;
                self.level(hole, hole.bottom, hole.move_feed)?;
                self.push_dwell(hole.place, hole.dwell);
                self.turn(hole, Turn::Off);
                if number == 88 {
                    self.out.push(Step::Pause { place: hole.place });
                }
                self.level(hole, hole.clear, MoveFeed::Rapid)?;
                self.turn(hole, turn);
                Ok(())
            }
            _ => self.bore_back(hole),
        }
    }

    /// G87: the tool goes in beside the axis with a standing spindle, and bores upwards.
    fn bore_back(&mut self, hole: &Hole) -> Read<()> {
        self.check_turning(hole, 87, None)?;
        let turn = self.state.modes.turn;
        let [first, second, _] = self.state.modes.plane.axes();
        let unit = self.state.unit();
        let shifts = self.cycle.shifts;
        let [Some(_), Some(_), Some(_)] = [shifts[first], shifts[second], shifts[hole.normal]]
        else {
            return mistake(
                hole.at,
                "G87 without I, J and K",
                "write I and J, the shift of the tool, and K, the upper end",
            );
        };
        let value = |axis: usize| shifts[axis].unwrap_or(0.0) * unit;
        let upper = if self.state.modes.incremental {
            hole.bottom + value(hole.normal)
        } else {
            value(hole.normal) + self.state.shift[hole.normal]
        };
        if upper < hole.bottom {
            return mistake(
                hole.at,
                "the upper end of G87 is below its bottom",
                "check K and the depth",
            );
        }
        let over = self.state.at;
        let shift = [value(first), value(second)];
        let shift = if hole.normal == 2 {
            self.state.rotation.turn(shift)
        } else {
            shift
        };
        // The shift is added once: the tool goes in and comes out at the same place.
        let mut beside = over;
        beside[first] += shift[0];
        beside[second] += shift[1];
        let at_level = |from: &PerLetter, level: f64| {
            let mut at = *from;
            at[hole.normal] = level;
            at
        };
        self.level(hole, hole.r, MoveFeed::Rapid)?;
        self.exact_to(hole, at_level(&beside, hole.r), MoveFeed::Rapid)?;
        self.turn(hole, Turn::Off);
        self.exact_to(hole, at_level(&beside, hole.bottom), MoveFeed::Rapid)?;
        self.exact_to(hole, at_level(&over, hole.bottom), MoveFeed::Rapid)?;
        self.turn(hole, turn);
        self.exact_to(hole, at_level(&over, upper), hole.move_feed)?;
        self.exact_to(hole, at_level(&over, hole.bottom), hole.move_feed)?;
        self.turn(hole, Turn::Off);
        self.exact_to(hole, at_level(&beside, hole.bottom), MoveFeed::Rapid)?;
        self.exact_to(hole, at_level(&beside, hole.clear), MoveFeed::Rapid)?;
        self.exact_to(hole, at_level(&over, hole.clear), MoveFeed::Rapid)?;
        self.turn(hole, turn);
        Ok(())
    }

    fn turn(&mut self, hole: &Hole, turn: Turn) {
        self.state.modes.turn = turn;
        self.send_spindle(hole.place);
    }

    fn check_turning(&self, hole: &Hole, number: u8, turn: Option<Turn>) -> Read<()> {
        let now = self.state.modes.turn;
        let right = match turn {
            Some(turn) => now == turn,
            None => now != Turn::Off,
        };
        if right {
            return Ok(());
        }
        let found = Mistake::new(
            hole.at,
            match turn {
                None => format!("G{number} while the spindle is off"),
                Some(Turn::Clockwise) => {
                    format!("G{number} while the spindle does not turn clockwise")
                }
                Some(_) => {
                    format!("G{number} while the spindle does not turn counter-clockwise")
                }
            },
            if number == 74 {
                "write S and M4 before"
            } else {
                "write S and M3 before"
            },
        );
        Err(Box::new(found.because(Cause::Spindle)))
    }
}
