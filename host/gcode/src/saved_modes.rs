//! M70 to M73: modes that are saved and put in force again.

use super::block::Block;
use super::canonical::Step;
use super::codes::Group;
use super::compensation::Active;
use super::executor::{Executor, Here, mistake};
use super::expression::Read;
use super::problem::Place;
use super::state::Modes;
use super::tool_table::PerLetter;

/// Modes that M70 or M73 saved.
#[derive(Clone, Copy)]
pub(crate) struct SavedModes {
    modes: Modes,
    tool_offset: PerLetter,
    /// Cutter compensation: its code, its side and radius.
    compensation: u16,
    active: Option<Active>,
    /// M73: the end of the subroutine restores them.
    at_return: bool,
}

impl Executor {
    /// Runs M70 to M73. Plane and unit of the block come behind them, as with LinuxCNC; `before`
    /// has those of the last block.
    pub(super) fn save_modes(&mut self, block: &Block, before: &Modes, here: &Here) -> Read<()> {
        let Some(code) = block.codes.get(Group::State) else {
            return Ok(());
        };
        let Some(saved) = self.saved.last_mut() else {
            return Ok(());
        };
        match code.tenths {
            700 | 730 => {
                *saved = Some(SavedModes {
                    modes: Modes {
                        plane: before.plane,
                        inch: before.inch,
                        ..self.state.modes
                    },
                    tool_offset: self.state.tool_offset,
                    compensation: self.state.compensation,
                    active: self.out.compensation.active,
                    at_return: code.tenths == 730,
                });
            }
            710 => *saved = None,
            _ => {
                let Some(saved) = *saved else {
                    return mistake(
                        code.at,
                        "M72 without a saved state",
                        "save it before with M70, in the same subroutine",
                    );
                };
                let Modes { plane, inch, .. } = self.state.modes;
                self.restore_modes(&saved, here.place(code.at));
                if let Some(code) = block.codes.get(Group::Plane) {
                    if plane != self.state.modes.plane {
                        self.refuse_while_compensated(code, here)?;
                    }
                    self.state.modes.plane = plane;
                }
                if block.codes.get(Group::Unit).is_some() {
                    self.state.modes.inch = inch;
                }
            }
        }
        Ok(())
    }

    /// Puts saved modes in force. The motion word stays, as with LinuxCNC.
    fn restore_modes(&mut self, saved: &SavedModes, place: Place) {
        let now = self.state.modes;
        self.state.modes = Modes {
            motion: now.motion,
            ..saved.modes
        };
        let modes = self.state.modes;
        let kind = |active: Option<Active>| active.map(|it| (it.side, it.radius, it.plane));
        if (saved.compensation, kind(saved.active))
            != (self.state.compensation, kind(self.out.compensation.active))
        {
            self.end_compensation();
            self.state.compensation = saved.compensation;
            let begun = |active: Active| Active::new(active.side, active.radius, active.plane);
            self.out.compensation.active = saved.active.map(begun);
        }
        let none = Default::default();
        let had_length = saved.tool_offset != none;
        if had_length != (self.state.tool_offset != none) {
            let tool = self.state.tool_of(self.state.tool);
            let offset = tool.map_or(saved.tool_offset, |tool| tool.offset);
            self.change_tool_offset(if had_length { offset } else { none });
        }
        self.state.select_system(modes.system);
        if (modes.turn, modes.speed) != (now.turn, now.speed) {
            self.send_spindle(place);
        }
        let coolant = (modes.mist, modes.flood);
        if coolant != (now.mist, now.flood) && self.options.coolant {
            let (mist, flood) = coolant;
            self.out.push(Step::Coolant { place, mist, flood });
        }
    }

    /// Begins a subroutine, which saves modes of its own.
    pub(crate) fn enter_call(&mut self) {
        self.saved.push(None);
    }

    /// Ends a subroutine: M73 restores its modes.
    pub(crate) fn leave_call(&mut self, place: Place) {
        if let Some(Some(saved)) = self.saved.pop()
            && saved.at_return
        {
            self.restore_modes(&saved, place);
        }
    }

    /// Ends all subroutines, without a change of modes.
    pub(crate) fn leave_all_calls(&mut self) {
        self.saved.truncate(1);
    }
}
