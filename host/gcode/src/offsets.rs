//! Codes that change offsets and reference positions: G10, G28, G30, G40 to G43, G49, G52, G92.

use super::block::{AXES, AXIS_LETTERS, Block, Word, letters};
use super::codes::{Code, Group, word};
use super::compensation::Active;
use super::executor::{Executor, Here, mistake};
use super::expression::Read;
use super::output::MoveFeed;
use super::state::{G28, G30, G92, Z};
use super::tool_table::{PerLetter, SYSTEMS, Tool};

/// Largest tool number.
const LARGEST_TOOL: f64 = 99_999.0;

/// Largest part of a direction across Z that counts as along it.
const ALONG_Z: f64 = 1e-9;

impl Executor {
    /// Returns the number of a tool.
    ///
    /// # Errors
    ///
    /// The word is no whole number of the range.
    pub(crate) fn tool_number(&self, here: &Here, word: Word) -> Read<u32> {
        if word.value.fract() != 0.0 || !(0.0..=LARGEST_TOOL).contains(&word.value) {
            return mistake(
                word.at,
                format!("{} is not a tool", here.text(word)),
                "write a whole number from 0 to 99999",
            );
        }
        Ok(word.value as u32)
    }

    /// Ends cutter compensation.
    pub(crate) fn end_compensation(&mut self) {
        if let Some(active) = self.out.compensation.active.take() {
            self.out.release();
            self.arc_is_refused = !active.is_first;
        }
        self.state.compensation = 400;
    }

    pub(crate) fn set_compensation(&mut self, block: &Block, here: &Here) -> Read<()> {
        let Some(code) = block.codes.get(Group::Compensation) else {
            return Ok(());
        };
        if code.tenths == 400 {
            self.end_compensation();
            return Ok(());
        }
        if self.out.compensation.active.is_some() {
            return mistake(
                code.at,
                format!("{} while cutter compensation is on", word(here.line, code)),
                "switch it off (G40) before",
            );
        }
        let diameter = if matches!(code.tenths, 411 | 421) {
            let Some(word) = block.word(b'D') else {
                return mistake(
                    code.at,
                    format!("{} without a diameter", word(here.line, code)),
                    "write D with the diameter of the cutter",
                );
            };
            word.value * self.state.unit()
        } else {
            let number = match block.word(b'D') {
                Some(word) => self.tool_number(here, word)?,
                None => self.state.tool,
            };
            match self.state.tool_of(number) {
                Some(tool) => tool.diameter,
                None if number == 0 => 0.0,
                None => {
                    let at = block.word(b'D').map_or(code.at, |word| word.at);
                    return Err(self.missing_tool(
                        number,
                        at,
                        ": its diameter is unknown",
                        "add it, or write G41.1 or G42.1 with D",
                    ));
                }
            }
        };
        if diameter == 0.0 {
            let what = format!(
                "{}: the diameter of the tool is 0, so the path is not moved sideways",
                word(here.line, code)
            );
            self.notice(here, code.at, "diameter", what)?;
        }
        let is_left = code.tenths < 420;
        // A negative diameter is compensation on the other side.
        let side = if is_left { 1.0 } else { -1.0 } * if diameter < 0.0 { -1.0 } else { 1.0 };
        let [first, second, _] = self.state.modes.plane.axes();
        if !self.state.rotation.is_none() && [first, second] != [0, 1] {
            return mistake(
                code.at,
                "cutter compensation outside G17 in a turned coordinate system",
                "write G17, or a coordinate system without R",
            );
        }
        let active = Active::new(side, 0.5 * diameter.abs(), [first, second]);
        self.out.compensation.active = Some(active);
        self.state.compensation = code.tenths;
        Ok(())
    }

    pub(crate) fn set_tool_length(&mut self, block: &Block, here: &Here) -> Read<()> {
        let Some(code) = block.codes.get(Group::ToolLength) else {
            return Ok(());
        };
        self.state.length_is_open = false;
        let offset = match code.tenths {
            490 => PerLetter::default(),
            431 => {
                let mut offset = self.state.tool_offset;
                for (axis, letter) in AXES.iter().enumerate() {
                    if let Some(value) = block.value(*letter) {
                        offset[axis] = value * self.state.scale(axis);
                    }
                }
                offset
            }
            tenths => {
                let (number, at) = match block.word(b'H') {
                    Some(word) => (self.tool_number(here, word)?, word.at),
                    None => (self.state.tool, code.at),
                };
                if let (432, Some(_), Some((_, word))) =
                    (tenths, block.word(b'H'), block.first_of(AXIS_LETTERS))
                {
                    return mistake(
                        word.at,
                        format!("{} with G43.2 and H", here.text(word)),
                        "write G43.2 with H or with axis words, and a move in another block",
                    );
                }
                let tool = match self.state.tool_of(number) {
                    _ if tenths == 432 && block.has_any(AXIS_LETTERS) => Tool {
                        offset: std::array::from_fn(|axis| {
                            block.value(AXES[axis]).unwrap_or(0.0) * self.state.scale(axis)
                        }),
                        diameter: 0.0,
                    },
                    Some(tool) => tool,
                    None if number == 0 => Tool::default(),
                    None if self.state.tools.is_empty() => {
                        let what = format!(
                            "{}: the tool table is empty, the length of tool {number} is that of \
                             the machine file",
                            word(here.line, code)
                        );
                        self.notice(here, code.at, "G43", what)?;
                        Tool::default()
                    }
                    None => {
                        return Err(self.missing_tool(
                            number,
                            at,
                            ": its length is unknown",
                            "add it, or write H with the number of another tool",
                        ));
                    }
                };
                if tenths == 432 {
                    std::array::from_fn(|axis| self.state.tool_offset[axis] + tool.offset[axis])
                } else {
                    tool.offset
                }
            }
        };
        if offset != self.state.tool_offset {
            self.refuse_while_compensated(code, here)?;
            let is_length = |axis: usize| axis == Z || offset[axis] == 0.0;
            if self.options.tool_axis.turns() && !(0..offset.len()).all(is_length) {
                return mistake(
                    code.at,
                    format!(
                        "{}: tool and workpiece of this machine turn against each other, so that a \
                         tool has a length (Z) and no other offset",
                        word(here.line, code)
                    ),
                    "write the length as z of the tool, and no other offset",
                );
            }
            self.change_tool_offset(offset);
        }
        Ok(())
    }

    /// Puts a tool offset in force. The machine stays where it is.
    pub(crate) fn change_tool_offset(&mut self, offset: PerLetter) {
        let before = self.state.at;
        self.state.set_tool_offset(offset);
        // The compensated position is beside the programmed one.
        let mut at = *self.out.at();
        for (axis, slot) in at.iter_mut().enumerate() {
            *slot += self.state.at[axis] - before[axis];
        }
        self.out.place_at(at);
    }

    /// Runs the codes of one block: G10, G28, G30, G52, G92.
    pub(crate) fn run_once(&mut self, block: &Block, here: &Here) -> Read<()> {
        let Some(code) = block.codes.get(Group::Once) else {
            return Ok(());
        };
        if code.tenths == 40 {
            return Ok(());
        }
        self.refuse_while_compensated(code, here)?;
        match code.tenths {
            100 => self.set_data(block, here, code),
            280 => self.go_home(block, here, code, G28),
            300 => self.go_home(block, here, code, G30),
            281 | 301 => {
                let first = if code.tenths == 281 { G28 } else { G30 };
                let at = self.state.length.machine_pose(&self.state.at);
                self.state.numbered[first..first + 9].copy_from_slice(&at);
                Ok(())
            }
            520 | 920 => self.shift_program(block, here, code),
            921 => {
                self.state.numbered[G92..G92 + 9].fill(0.0);
                self.state.set_g92(None);
                Ok(())
            }
            922 => {
                self.state.set_g92(None);
                Ok(())
            }
            _ => {
                let mut offset = PerLetter::default();
                offset.copy_from_slice(&self.state.numbered[G92..G92 + 9]);
                self.state.set_g92(Some(offset));
                Ok(())
            }
        }
    }

    /// G92: the position gets the written coordinates. G52: the written coordinates are the offset.
    fn shift_program(&mut self, block: &Block, here: &Here, code: Code) -> Read<()> {
        if !block.has_any(AXIS_LETTERS) {
            return mistake(
                code.at,
                format!("{} without axis words", word(here.line, code)),
                "write the coordinates of the position",
            );
        }
        let here_in_program = self.state.in_program(&self.state.at);
        let mut offset = self.state.g92;
        for (axis, letter) in AXES.iter().enumerate() {
            if let Some(value) = block.value(*letter) {
                let value = value * self.state.scale(axis);
                offset[axis] = if code.tenths == 520 {
                    value
                } else {
                    offset[axis] + here_in_program[axis] - value
                };
            }
        }
        self.state.numbered[G92..G92 + 9].copy_from_slice(&offset);
        self.state.set_g92(Some(offset));
        Ok(())
    }

    /// G28 and G30: over the written point to the reference position.
    fn go_home(&mut self, block: &Block, here: &Here, code: Code, first: usize) -> Read<()> {
        let place = here.place(code.at);
        let via = self.target(block, false);
        let has_words = block.has_any(AXIS_LETTERS);
        if has_words {
            self.travel_to(via, MoveFeed::Rapid, place, code.at)?;
        }
        let here = self.state.length.machine_pose(&self.state.at);
        let mut home = here;
        for (axis, slot) in home.iter_mut().enumerate() {
            if self.out.coordinate(axis).is_some() {
                *slot = self.state.numbered[first + axis];
            }
        }
        let mut to = home;
        if has_words {
            // The written axes are those of the program, also in a turned coordinate system.
            let home = self.state.in_program(&home);
            let mut point = self.state.in_program(&here);
            for (axis, letter) in AXES.iter().enumerate() {
                if block.word(*letter).is_some() {
                    point[axis] = home[axis];
                }
            }
            to = self.state.in_machine(&point);
        }
        let to = self.state.length.tip_pose(&to);
        self.travel_to(to, MoveFeed::Rapid, place, code.at)
    }

    /// G10.
    fn set_data(&mut self, block: &Block, here: &Here, code: Code) -> Read<()> {
        let Some(kind) = block.word(b'L') else {
            return mistake(
                code.at,
                "G10 without L",
                "write L2 or L20 for a coordinate system, L1, L10 or L11 for a tool",
            );
        };
        let Some(number) = block.word(b'P') else {
            return mistake(
                code.at,
                "G10 without P",
                "write P with the number of the coordinate system or tool",
            );
        };
        let whole = number.value.fract() == 0.0;
        match kind.value {
            2.0 | 20.0 => {
                if !whole || !(0.0..=SYSTEMS as f64).contains(&number.value) {
                    return mistake(
                        number.at,
                        format!("{} is not a coordinate system", here.text(number)),
                        "write P0 for the one in force, P1 (G54) to P9 (G59.3)",
                    );
                }
                let index = match number.value as usize {
                    0 => self.state.modes.system,
                    number => number - 1,
                };
                if let Some((_, word)) = block.first_of(letters(b"IJ")) {
                    return mistake(
                        word.at,
                        format!(
                            "{} in the block of G10 {}",
                            here.text(word),
                            here.text(kind)
                        ),
                        "a coordinate system has an origin (axis words) and a rotation (R): \
                         remove it",
                    );
                }
                self.note_lathe_words(block, here, letters(b"Q"))?;
                self.set_system_data(block, index, kind.value == 20.0)
            }
            1.0 | 10.0 | 11.0 => {
                let number = self.tool_number(here, number)?;
                if !block.has_any(AXIS_LETTERS | letters(b"RIJQ")) {
                    return mistake(
                        code.at,
                        format!("G10 {} without a value", here.text(kind)),
                        "write axis words with the offset of the tool, or R with its radius",
                    );
                }
                self.note_lathe_words(block, here, letters(b"IJQ"))?;
                self.set_tool_data(block, number, kind.value)
            }
            _ => mistake(
                kind.at,
                format!("G10 {} is not supported", here.text(kind)),
                "write L1, L2, L10, L11 or L20",
            ),
        }
    }

    /// Words that describe the tool of a lathe change nothing.
    fn note_lathe_words(&mut self, block: &Block, here: &Here, words: u32) -> Read<()> {
        let Some((_, word)) = block.first_of(words) else {
            return Ok(());
        };
        let what = format!(
            "{} of G10 changes nothing: angles and orientation of a tool belong to lathes",
            here.text(word)
        );
        self.notice(here, word.at, "G10", what)
    }

    fn set_system_data(&mut self, block: &Block, index: usize, to_position: bool) -> Read<()> {
        let mut system = self.state.system(index);
        if let Some(word) = block.word(b'R') {
            if to_position {
                return mistake(word.at, "G10 L20 with R", "the rotation is set with G10 L2");
            }
            system.rotation = word.value;
        }
        // For L20, the position in the system without its own origin.
        let position = {
            let state = &self.state;
            let tool = state.tool_shift();
            let mut at: PerLetter = std::array::from_fn(|axis| state.at[axis] - tool[axis]);
            let rotation = super::frame::Rotation::of(system.rotation);
            let turned = rotation.turn([state.g92[0], state.g92[1]]);
            at[0] -= turned[0];
            at[1] -= turned[1];
            for (axis, at) in at.iter_mut().enumerate().skip(2) {
                *at -= state.g92[axis];
            }
            at
        };
        let mut target = PerLetter::default();
        let rotation = super::frame::Rotation::of(system.rotation);
        if to_position && !rotation.is_none() {
            // Coordinates that are not written stay as they are in the old system.
            let old = [
                position[0] - system.origin[0],
                position[1] - system.origin[1],
            ];
            [target[0], target[1]] = rotation.turn_back(old);
        }
        let mut turned_words = false;
        for (axis, letter) in AXES.iter().enumerate() {
            let Some(value) = block.value(*letter) else {
                continue;
            };
            let value = value * self.state.scale(axis);
            if !to_position {
                system.origin[axis] = value;
            } else if axis < 2 && !rotation.is_none() {
                target[axis] = value;
                turned_words = true;
            } else {
                system.origin[axis] = position[axis] - value;
            }
        }
        if turned_words {
            let turned = rotation.turn([target[0], target[1]]);
            system.origin[0] = position[0] - turned[0];
            system.origin[1] = position[1] - turned[1];
        }
        self.state.set_system(index, system);
        Ok(())
    }

    fn set_tool_data(&mut self, block: &Block, number: u32, kind: f64) -> Read<()> {
        let mut tool = self.state.tool_of(number).unwrap_or_default();
        let state = &self.state;
        let machine = state.length.machine_pose(&state.at);
        let [x, y, _] = state.length.axis.direction(&machine);
        if kind != 1.0 && state.length.axis.turns() && (x.abs() > ALONG_Z || y.abs() > ALONG_Z) {
            return mistake(
                block.first.unwrap_or(0),
                format!("G10 L{kind} with a tool that does not stand along Z of the workpiece"),
                "turn the rotary coordinates so that the tool is along Z, or write its length with \
                 L1",
            );
        }
        for (axis, letter) in AXES.iter().enumerate() {
            let Some(value) = block.value(*letter) else {
                continue;
            };
            let value = value * state.scale(axis);
            tool.offset[axis] = if kind == 1.0 {
                value
            } else if kind == 10.0 {
                // The position gets the written coordinate in the system in force.
                machine[axis] - (state.shift[axis] - state.tool_shift()[axis]) - value
            } else {
                // L11: in the ninth system (G59.3), without G92.
                machine[axis] - state.system(SYSTEMS - 1).origin[axis] - value
            };
        }
        if let Some(word) = block.word(b'R') {
            // The tool table has no diameter below 0.
            if word.value < 0.0 {
                return mistake(
                    word.at,
                    format!("a radius of {} mm is below 0", word.value * state.unit()),
                    "write R from 0, and G42 in place of G41 for the other side",
                );
            }
            tool.diameter = 2.0 * word.value * state.unit();
        }
        if self.state.tools.len() >= 10_000 {
            return mistake(
                block.first.unwrap_or(0),
                "more than 10000 tools",
                "use fewer tools",
            );
        }
        self.state.tools.insert(number, tool);
        Ok(())
    }
}
