//! Check that each word of a block belongs to a code or to the motion in force.

use super::block::{AXES, AXIS_LETTERS, Block, Word, Written, letters};
use super::codes::{Code, Group, g_remedy, word as code_text};
use super::executor::{Executor, Here, mistake};
use super::expression::Read;
use super::problem::{Cause, Mistake};
use super::state::{Motion, is_linear};

/// Whether a number ends just before a place.
fn follows_digit(line: &[u8], at: usize) -> bool {
    matches!(line[..at].last(), Some(b'0'..=b'9' | b'.'))
}

/// Returns the letters of a cycle, without those of every cycle.
fn cycle_letters(number: u8) -> &'static [u8] {
    match number {
        73 | 83 => b"Q",
        74 | 82 | 84 | 86 | 88 | 89 => b"P",
        87 => b"IJK",
        _ => b"",
    }
}

/// Refuses a motion word beside a code that uses the axis words.
fn check_axis_codes(axis_code: Code, motion: Code, here: &Here) -> Read<()> {
    match (motion.tenths, axis_code.tenths) {
        // G28 and G30 are rapid moves, and CAM systems write G0 beside them; G80 is no move.
        (800, _) | (0, 280 | 300) => Ok(()),
        _ => mistake(
            motion.at,
            format!(
                "{} and {} in one block: both use the axis words",
                code_text(here.line, motion),
                code_text(here.line, axis_code)
            ),
            "write the move in another block",
        ),
    }
}

/// Refuses a letter that belongs to cycles, but not to this one or not without a hole.
fn stray_in_cycle(letter: u8, word: Word, number: u8, is_hole: bool, here: &Here) -> Read<()> {
    let text = here.text(word);
    let own = letters(b"RL") | letters(cycle_letters(number));
    if !is_hole && own & letters(&[letter]) != 0 {
        return mistake(
            word.at,
            format!("{text} without a hole"),
            "write it in the block of a hole, which has an axis word",
        );
    }
    let remedy = match letter {
        b'P' => {
            "P is the dwell of G74, G82, G84, G86, G88 and G89: write one of them, or remove it"
        }
        b'Q' => "Q is the peck of G73 and G83: write one of them, or remove it",
        _ => return Ok(()),
    };
    mistake(
        word.at,
        format!("{text} has no meaning in G{number}"),
        remedy,
    )
}

impl Executor {
    /// Returns the motion that the axis words of a block mean.
    pub(super) fn motion_of(&self, block: &Block) -> Motion {
        block
            .codes
            .tenths(Group::Motion)
            .map_or(self.state.modes.motion, |tenths| {
                Motion::of(tenths).unwrap_or(Motion::Off)
            })
    }

    /// Checks that each word belongs to a code of the block or to the motion in force.
    pub(super) fn check_words(&mut self, block: &mut Block, here: &Here) -> Read<()> {
        let codes = &block.codes;
        let once = codes.tenths(Group::Once);
        let motion = self.motion_of(block);
        let axis_code = block.axis_code();
        if let (Some(axis_code), Some(code)) = (axis_code, codes.get(Group::Motion)) {
            check_axis_codes(axis_code, code, here)?;
        }
        let mut known = letters(b"FST");
        if axis_code.is_some() || motion != Motion::Off {
            known |= AXIS_LETTERS;
        }
        let end = AXIS_LETTERS
            | match motion {
                Motion::Clockwise | Motion::CounterClockwise => letters(b"IJKR"),
                Motion::Nurbs => letters(b"PL"),
                _ => 0,
            };
        // Without an end the words of the motion would have no effect.
        let moves =
            axis_code.is_none() && (codes.get(Group::Motion).is_some() || block.has_any(end));
        if moves {
            known |= match motion {
                Motion::Clockwise | Motion::CounterClockwise => letters(b"IJKRP"),
                Motion::Cubic => letters(b"IJPQ"),
                Motion::Quadratic => letters(b"IJ"),
                Motion::Nurbs => letters(b"PL"),
                Motion::Cycle(number) => letters(b"RL") | letters(cycle_letters(number)),
                _ => 0,
            };
        }
        known |= match once {
            // An axis word with a dwell has a message of its own.
            Some(40) => letters(b"P") | AXIS_LETTERS,
            // I, J and Q have messages of their own.
            Some(100) => letters(b"LPRIJQ"),
            _ => 0,
        };
        if codes.tenths(Group::PathControl) == Some(640) {
            known |= letters(b"PQ");
        }
        if matches!(codes.tenths(Group::Compensation), Some(410..=421)) {
            known |= letters(b"DL");
        }
        if matches!(codes.tenths(Group::ToolLength), Some(430 | 432)) {
            known |= letters(b"H");
        }
        if codes.tenths(Group::SpindleMode) == Some(960) {
            known |= letters(b"D");
        }
        known |= match codes.tenths(Group::Output) {
            Some(660) => letters(b"PELQ"),
            Some(670 | 680) => letters(b"EQ"),
            Some(_) => letters(b"P"),
            None => 0,
        };
        if codes.tenths(Group::Subprogram) == Some(980) {
            known |= letters(b"PL");
        }
        if codes.tenths(Group::Override).is_some() {
            known |= letters(b"P");
        }
        match codes.tenths(Group::Spindle) {
            Some(190) => known |= letters(b"RPQ"),
            Some(_) => {}
            None => {}
        }
        if codes.tenths(Group::ToolChange) == Some(610) {
            known |= letters(b"Q");
        }
        if let Some((letter, word)) = block.first_of(!known) {
            if let (b'Q', Some(code)) = (letter, codes.get(Group::Unit))
                && matches!(code.tenths, 700 | 710)
            {
                let number = code.tenths / 10;
                return mistake(
                    code.at,
                    format!("G{number} with Q is a turning cycle, which is not supported"),
                    g_remedy(720),
                );
            }
            if let (Motion::Cycle(number), None) = (motion, axis_code) {
                stray_in_cycle(letter, word, number, moves, here)?;
            }
            return Err(Box::new(self.stray_word(letter, word, here)));
        }
        if block.polar().is_some() && (axis_code.is_some() || self.options.no_decimal) {
            let what = if self.options.no_decimal {
                "polar coordinates with --no-decimal"
            } else {
                "polar coordinates without a motion"
            };
            let at = block.first_of(AXIS_LETTERS).map_or(0, |(_, word)| word.at);
            return mistake(at, what, "write X and Y");
        }
        let missing = |axis: usize| self.out.coordinate(axis).is_none();
        if let Some((letter, word)) = block.first_of(AXIS_LETTERS)
            && AXES
                .iter()
                .enumerate()
                .any(|(axis, letter)| block.word(*letter).is_some() && missing(axis))
        {
            let (letter, word) = AXES
                .iter()
                .enumerate()
                .filter(|(axis, _)| missing(*axis))
                .filter_map(|(_, letter)| Some((*letter, block.word(*letter)?)))
                .min_by_key(|(_, word)| word.at)
                .unwrap_or((letter, word));
            return mistake(
                word.at,
                self.no_axis(letter),
                "write the program for the axes of the machine file",
            );
        }
        if self.options.no_decimal {
            self.scale_increments(block, here)?;
        }
        Ok(())
    }

    /// Letters of a block whose numbers are lengths, or angles of rotary axes.
    fn length_letters(&self, block: &Block) -> u32 {
        let codes = &block.codes;
        let mut lengths = AXIS_LETTERS;
        match codes.tenths(Group::Once) {
            // The radius of a tool; R of a coordinate system is an angle.
            Some(100) if matches!(block.value(b'L'), Some(1.0 | 10.0 | 11.0)) => {
                lengths |= letters(b"R");
            }
            Some(100) => {}
            _ => {
                lengths |= match self.motion_of(block) {
                    Motion::Clockwise | Motion::CounterClockwise => letters(b"IJKR"),
                    Motion::Cubic => letters(b"IJPQ"),
                    Motion::Quadratic => letters(b"IJ"),
                    // P is the dwell.
                    Motion::Cycle(_) => letters(b"RQIJK"),
                    _ => 0,
                }
            }
        }
        if codes.tenths(Group::PathControl) == Some(640) {
            lengths |= letters(b"PQ");
        }
        if matches!(codes.tenths(Group::Compensation), Some(411 | 421)) {
            lengths |= letters(b"D");
        }
        // Angle and time of M19, tool of M61, value or time of M66 to M68, number of M98.
        if codes.tenths(Group::Spindle) == Some(190) {
            lengths &= !letters(b"RPQ");
        }
        if codes.tenths(Group::ToolChange) == Some(610)
            || codes.tenths(Group::Output).is_some()
            || codes.tenths(Group::Subprogram).is_some()
            || codes.tenths(Group::Override).is_some()
        {
            lengths &= !letters(b"PQ");
        }
        lengths
    }

    /// Numbers without a decimal point count the least increment. The value of a parameter or an
    /// expression is a length, as on controls that have this dialect.
    pub(super) fn scale_increments(&mut self, block: &mut Block, here: &Here) -> Read<()> {
        let inch = match block.codes.tenths(Group::Unit) {
            Some(tenths) => matches!(tenths, 200 | 700),
            None => self.state.modes.inch,
        };
        let mut rest = self.length_letters(block);
        while let Some((letter, word)) = block.first_of(rest) {
            rest &= !letters(&[letter]);
            if word.written == Written::Value {
                continue;
            }
            if word.written == Written::Point {
                return mistake(
                    word.at,
                    format!("{} has a decimal point", here.text(word)),
                    "with --no-decimal all lengths count 0.001 mm or 0.0001 inch",
                );
            }
            let axis = AXES.iter().position(|axis| *axis == letter).unwrap_or(0);
            block.scale(letter, if inch && is_linear(axis) { 1e-4 } else { 1e-3 });
        }
        Ok(())
    }

    /// The value of the word is not named: the same mistake in many blocks is one error.
    fn no_axis(&self, letter: u8) -> String {
        let axes = self.options.axes.iter();
        let letters: Vec<String> = axes.map(|axis| axis.letter.to_string()).collect();
        format!(
            "this machine has no axis {}, only {}",
            char::from(letter),
            letters.join(", ")
        )
    }

    pub(super) fn stray_word(&self, letter: u8, word: Word, here: &Here) -> Mistake {
        let text = here.text(word);
        let (what, remedy) = match letter {
            b'X' | b'Y' | b'Z' | b'A' | b'B' | b'C' | b'U' | b'V' | b'W' => {
                let axis = AXES.iter().position(|axis| *axis == letter);
                if axis.is_some_and(|axis| self.out.coordinate(axis).is_none()) {
                    (
                        self.no_axis(letter),
                        "write the program for the axes of the machine file",
                    )
                } else {
                    return Mistake::new(
                        word.at,
                        format!("{text} without a motion"),
                        "write G0, G1, G2 or G3 in this block or before it",
                    )
                    .because(Cause::Motion);
                }
            }
            b'I' | b'J' | b'K' | b'R' => {
                return Mistake::new(
                    word.at,
                    format!("{text} without an arc"),
                    "centre and radius belong to G2 and G3: write one, or remove it",
                )
                .because(Cause::Motion);
            }
            b'E' if follows_digit(here.line, word.at) => (
                format!("{text}: exponents are not supported"),
                "write all digits of the number",
            ),
            b'E' => (
                format!("{text} belongs to no word of its block"),
                "E belongs to M66 to M68: write one, or remove it",
            ),
            b'P' => (
                format!("{text} belongs to no word of its block"),
                "P is the time of G4: write G4, or remove it",
            ),
            b'D' | b'H' => (
                format!("{text} belongs to no word of its block"),
                "D belongs to G41 and G42, H to G43: write one, or remove it",
            ),
            b'Q' | b'L' => (
                format!("{text} belongs to no word of its block"),
                "it belongs to cycles: write one, or remove it",
            ),
            _ => (
                format!("{text} is not supported"),
                "remove it, or put it in a comment ( )",
            ),
        };
        Mistake::new(word.at, what, remedy)
    }
}
