//! Spindle, coolant, tool, inputs and outputs of a block.

use super::LONGEST_DWELL_S;
use super::block::{Block, Word};
use super::canonical::{OutputValue, Step, WaitFor};
use super::codes::{Group, word};
use super::executor::{Executor, Here, mistake};
use super::expression::Read;
use super::problem::{Cause, Mistake, Place};
use super::state::{Turn, WAITED};

/// Maximum speed of the spindle, rev/min.
const FASTEST_SPINDLE: f64 = 32_767.0;

/// Checks the words of M19 as LinuxCNC does, although the spindle only stops.
fn check_orientation(block: &Block, here: &Here) -> Read<()> {
    let check = |letter: u8, right: fn(f64) -> bool, what: &str, remedy: &str| match block
        .word(letter)
        .filter(|word| !right(word.value))
    {
        Some(word) => mistake(
            word.at,
            format!("{} is not {what}", here.text(word)),
            remedy,
        ),
        None => Ok(()),
    };
    check(
        b'R',
        |angle| (0.0..=360.0).contains(&angle),
        "an angle of the spindle",
        "write 0 to 360 degrees",
    )?;
    check(
        b'P',
        |way| [0.0, 1.0, 2.0].contains(&way),
        "a direction of the spindle",
        "write 0, 1 or 2",
    )?;
    check(
        b'Q',
        |seconds| seconds > 0.0,
        "a time limit",
        "write seconds above 0",
    )
}

impl Executor {
    pub(crate) fn set_spindle(&mut self, block: &Block, here: &Here) -> Read<()> {
        if let Some(code) = block.codes.get(Group::SpindleMode) {
            if code.tenths == 960 {
                let limit = block.word(b'D').map_or(FASTEST_SPINDLE, |word| word.value);
                if !(0.0..=FASTEST_SPINDLE).contains(&limit) {
                    return mistake(
                        code.at,
                        format!("{limit} is not a spindle speed"),
                        "write D with the maximum speed, 0 to 32767 rev/min",
                    );
                }
                if block.word(b'S').is_none() {
                    return mistake(
                        code.at,
                        format!("{} without a surface speed", word(here.line, code)),
                        "write S with the speed in m/min (feet/min with G20)",
                    );
                }
                self.state.modes.surface_limit = Some(limit);
            } else if self.state.modes.surface_limit.take().is_some() {
                self.state.modes.speed = None;
            }
        }
        if let Some(word) = block.word(b'S') {
            let is_surface = self.state.modes.surface_limit.is_some();
            if !(0.0..=FASTEST_SPINDLE).contains(&word.value) {
                return mistake(
                    word.at,
                    format!("{} is not a spindle speed", here.text(word)),
                    "write 0 to 32767 rev/min",
                );
            }
            let per_metre = if self.state.modes.inch { 0.3048 } else { 1.0 };
            let speed = if is_surface {
                word.value * per_metre
            } else {
                word.value
            };
            let changes = self.state.modes.speed != Some(speed);
            self.state.modes.speed = Some(speed);
            if self.state.modes.turn != Turn::Off
                && changes
                && block.codes.get(Group::Spindle).is_none()
            {
                let place = here.place(word.at);
                self.send_spindle(place);
            }
        }
        Ok(())
    }

    /// Returns the speed of the spindle, rev/min.
    pub(crate) fn rpm(&self) -> f64 {
        let speed = self.state.modes.speed.unwrap_or(0.0);
        match self.state.modes.surface_limit {
            None => speed,
            Some(limit) => {
                // The radius is X of the program, as on a lathe.
                let radius = self.state.in_program(&self.state.at)[0].abs();
                (speed * 1000.0 / (std::f64::consts::TAU * radius.max(1e-3))).min(limit)
            }
        }
    }

    pub(crate) fn send_spindle(&mut self, place: Place) {
        let rpm = self.rpm().round().clamp(0.0, FASTEST_SPINDLE) as i16;
        let rpm = match self.state.modes.turn {
            Turn::Off => 0,
            Turn::Clockwise => rpm,
            Turn::CounterClockwise => -rpm,
        };
        self.out.push(Step::Spindle { place, rpm });
    }

    pub(crate) fn turn_spindle(&mut self, block: &Block, here: &Here) -> Read<()> {
        let Some(code) = block.codes.get(Group::Spindle) else {
            return Ok(());
        };
        let turn = match code.tenths {
            30 | 130 => Turn::Clockwise,
            40 | 140 => Turn::CounterClockwise,
            _ => Turn::Off,
        };
        if turn != Turn::Off && self.state.modes.speed.unwrap_or(0.0) == 0.0 {
            let what = "the spindle is started without a speed: it stays off until an S word";
            self.notice(here, code.at, "spindle", what.into())?;
        }
        if code.tenths == 190 {
            check_orientation(block, here)?;
            let what = "M19 stops the spindle; this machine does not turn it to an angle";
            self.notice(here, code.at, "M19", what.into())?;
        }
        self.state.modes.turn = turn;
        // A wrong speed is named at its word.
        let at = block.word(b'S').map_or(code.at, |word| word.at);
        self.send_spindle(here.place(at));
        if matches!(code.tenths, 130 | 140) {
            self.send_coolant(here, code.at, self.state.modes.mist, true)?;
        }
        Ok(())
    }

    pub(crate) fn select_tool(&mut self, block: &Block, here: &Here) -> Read<()> {
        let Some(word) = block.word(b'T') else {
            return Ok(());
        };
        self.state.selected = self.tool_of_table(here, word)?;
        Ok(())
    }

    /// Returns the number of a tool that can be in the spindle.
    fn tool_of_table(&mut self, here: &Here, word: Word) -> Read<u32> {
        let number = self.tool_number(here, word)?;
        if number != 0 && !self.state.tools.is_empty() && self.state.tool_of(number).is_none() {
            return Err(self.missing_tool(
                number,
                word.at,
                "",
                "add it, or write the number of another tool",
            ));
        }
        Ok(number)
    }

    /// Returns the mistake of a tool that is not in the table; it is reported once for each tool.
    pub(crate) fn missing_tool(
        &mut self,
        number: u32,
        at: usize,
        unknown: &str,
        remedy: &str,
    ) -> Box<Mistake> {
        let table = match self.options.tools_file.as_str() {
            "" => "the tool table",
            file => file,
        };
        let what = format!("tool {number} is not in {table}{unknown}");
        let found = Mistake::new(at, what, remedy);
        Box::new(if self.state.missing_tools.insert(number) {
            found
        } else {
            found.because(Cause::Named)
        })
    }

    pub(crate) fn change_tool(&mut self, block: &Block, here: &Here) -> Read<()> {
        let Some(code) = block.codes.get(Group::ToolChange) else {
            return Ok(());
        };
        self.refuse_while_compensated(code, here)?;
        let tool = if code.tenths == 610 {
            let Some(word) = block.word(b'Q') else {
                return mistake(
                    code.at,
                    "M61 without its tool",
                    "write Q with the number of the tool",
                );
            };
            self.tool_of_table(here, word)?
        } else {
            self.state.selected
        };
        if code.tenths != 610 && tool != self.state.tool {
            if self.state.modes.turn != Turn::Off {
                self.state.modes.turn = Turn::Off;
                self.send_spindle(here.place(code.at));
            }
            self.out.push(Step::ToolChange {
                place: here.place(code.at),
                tool,
            });
        }
        self.state.length_is_open |= tool != self.state.tool;
        self.state.tool = tool;
        // After cutter compensation the tool is not where the program led it.
        self.state.at = *self.out.at();
        Ok(())
    }

    pub(crate) fn set_coolant(&mut self, block: &Block, here: &Here) -> Read<()> {
        let mist = block.codes.get(Group::Mist);
        let flood = block.codes.get(Group::Flood);
        let Some(code) = mist.or(flood) else {
            return Ok(());
        };
        let (mut on_mist, mut on_flood) = (self.state.modes.mist, self.state.modes.flood);
        match flood.map(|code| code.tenths) {
            Some(90) => {
                if mist.is_some() {
                    return mistake(
                        code.at,
                        "M7 and M9 in one block: both are of modal group coolant",
                        "keep one",
                    );
                }
                (on_mist, on_flood) = (false, false);
            }
            Some(_) => on_flood = true,
            None => {}
        }
        on_mist |= mist.is_some();
        self.send_coolant(here, code.at, on_mist, on_flood)
    }

    pub(crate) fn send_coolant(
        &mut self,
        here: &Here,
        at: usize,
        mist: bool,
        flood: bool,
    ) -> Read<()> {
        if !self.options.coolant {
            let what = "this machine has no coolant: M7, M8 and M9 change nothing";
            self.notice(here, at, "coolant", what.into())?;
        }
        (self.state.modes.mist, self.state.modes.flood) = (mist, flood);
        if self.options.coolant {
            self.out.push(Step::Coolant {
                place: here.place(at),
                mist,
                flood,
            });
        }
        Ok(())
    }

    pub(crate) fn set_overrides(&mut self, block: &Block, here: &Here) -> Read<()> {
        let Some(code) = block.codes.get(Group::Override) else {
            return Ok(());
        };
        let switch = block.value(b'P').unwrap_or(1.0) == 0.0;
        match code.tenths {
            480 => self.state.modes.fixed = false,
            490 => self.state.modes.fixed = true,
            500 => self.state.modes.fixed = switch,
            _ => {
                let what = "M51 to M53 change nothing: M49 and M50 P0 switch the overrides of feed and \
                            spindle off, and a hold is always possible";
                return self.notice(here, code.at, "override", what.into());
            }
        }
        Ok(())
    }

    pub(crate) fn set_outputs(&mut self, block: &Block, here: &Here) -> Read<()> {
        let Some(code) = block.codes.get(Group::Output) else {
            return Ok(());
        };
        let name = word(here.line, code);
        let number = |letter: u8| -> Read<Option<u16>> {
            match block.word(letter) {
                None => Ok(None),
                Some(word) if word.value.fract() == 0.0 && (0.0..=1023.0).contains(&word.value) => {
                    Ok(Some(word.value as u16))
                }
                Some(word) => mistake(
                    word.at,
                    format!("{} is not an input or output", here.text(word)),
                    "write a whole number from 0 to 1023",
                ),
            }
        };
        let needed = |letter: u8| -> Read<u16> {
            match number(letter)? {
                Some(number) => Ok(number),
                None => mistake(
                    code.at,
                    format!("{name} without its number"),
                    &format!("write {} with the number", char::from(letter)),
                ),
            }
        };
        let place = here.place(code.at);
        let step = match code.tenths {
            620..=650 => Step::Output {
                place,
                number: needed(b'P')?,
                value: OutputValue::Digital(matches!(code.tenths, 620 | 640)),
                with_motion: code.tenths <= 630,
            },
            670 | 680 => Step::Output {
                place,
                number: needed(b'E')?,
                value: OutputValue::Analogue(block.value(b'Q').unwrap_or(0.0)),
                with_motion: code.tenths == 670,
            },
            _ => {
                let analogue = number(b'E')?;
                if let (Some(_), Some(word)) = (analogue, block.word(b'P')) {
                    return mistake(
                        word.at,
                        "M66 with both P and E",
                        "write P for a digital input, or E for an analog one",
                    );
                }
                let number = match analogue {
                    Some(number) => number,
                    None => needed(b'P')?,
                };
                let until = match block.value(b'L').unwrap_or(0.0) {
                    0.0 => WaitFor::Nothing,
                    1.0 => WaitFor::Rise,
                    2.0 => WaitFor::Fall,
                    3.0 => WaitFor::High,
                    4.0 => WaitFor::Low,
                    other => {
                        return mistake(
                            code.at,
                            format!("L{other} is not a kind of wait"),
                            "write L0 to L4",
                        );
                    }
                };
                if analogue.is_some() && until != WaitFor::Nothing {
                    return mistake(code.at, "an analogue input has no edge", "write L0 with E");
                }
                let seconds = block.value(b'Q').unwrap_or(0.0);
                if until != WaitFor::Nothing && !(seconds > 0.0 && seconds <= LONGEST_DWELL_S) {
                    let (at, what) = match block.word(b'Q') {
                        Some(word) => (word.at, format!("{} is not a time limit", here.text(word))),
                        None => (code.at, "M66 waits without a time limit".to_string()),
                    };
                    return mistake(at, what, "write Q with the seconds, up to 3600");
                }
                // The value of an input is known only when the machine runs.
                self.state.numbered[WAITED] = 0.0;
                Step::Wait {
                    place,
                    number,
                    analogue: analogue.is_some(),
                    until,
                    seconds,
                }
            }
        };
        if !self.options.outputs {
            let what = format!("this machine has no inputs and outputs for {name}");
            return mistake(code.at, what, "remove it, or name them in the machine file");
        }
        self.out.push(step);
        Ok(())
    }
}
