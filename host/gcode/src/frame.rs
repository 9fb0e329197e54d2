//! Place of the program in the machine: work coordinate systems, G92 and tool offsets.

use super::block::AXES;
use super::state::{G92_ACTIVE, SYSTEM, SYSTEM_1, State, Z};
use super::tool_table::{PerLetter, SYSTEM_NAMES, WorkOffset};

/// Rotation of a work coordinate system about Z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Rotation {
    pub sin: f64,
    pub cos: f64,
}

impl Rotation {
    pub(crate) fn of(degrees: f64) -> Self {
        if degrees == 0.0 {
            return Rotation { sin: 0.0, cos: 1.0 };
        }
        let (sin, cos) = libm::sincos(degrees.to_radians());
        Self { sin, cos }
    }

    pub(crate) fn is_none(self) -> bool {
        self.sin == 0.0 && self.cos == 1.0
    }

    /// Turns a vector of the program into one of the machine.
    pub(crate) fn turn(self, [x, y]: [f64; 2]) -> [f64; 2] {
        [x * self.cos - y * self.sin, x * self.sin + y * self.cos]
    }

    /// Turns a vector of the machine into one of the program.
    pub(crate) fn turn_back(self, [x, y]: [f64; 2]) -> [f64; 2] {
        [x * self.cos + y * self.sin, y * self.cos - x * self.sin]
    }
}

/// Place of the program in the machine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Frame {
    shift: PerLetter,
    rotation: Rotation,
}

impl Default for Frame {
    fn default() -> Self {
        Self {
            shift: PerLetter::default(),
            rotation: Rotation::of(0.0),
        }
    }
}

impl Frame {
    /// Returns a position of the machine in program coordinates: mm, degrees.
    pub(crate) fn in_program(&self, at: &PerLetter) -> PerLetter {
        let mut value: PerLetter = std::array::from_fn(|axis| at[axis] - self.shift[axis]);
        if !self.rotation.is_none() {
            [value[0], value[1]] = self.rotation.turn_back([value[0], value[1]]);
        }
        value
    }
}

impl State {
    /// Puts a work coordinate system in force.
    pub(crate) fn select_system(&mut self, index: usize) {
        self.modes.system = index;
        let first = SYSTEM_1 + 20 * index;
        self.origin
            .origin
            .copy_from_slice(&self.numbered[first..first + 9]);
        self.origin.rotation = self.numbered[first + 9];
        self.rotation = Rotation::of(self.origin.rotation);
        self.numbered[SYSTEM] = (index + 1) as f64;
        self.update_shift();
    }

    /// Returns a work coordinate system.
    pub(crate) fn system(&self, index: usize) -> WorkOffset {
        let first = SYSTEM_1 + 20 * index;
        let mut origin = PerLetter::default();
        origin.copy_from_slice(&self.numbered[first..first + 9]);
        WorkOffset {
            origin,
            rotation: self.numbered[first + 9],
        }
    }

    /// Changes a work coordinate system.
    pub(crate) fn set_system(&mut self, index: usize, offset: WorkOffset) {
        let first = SYSTEM_1 + 20 * index;
        self.numbered[first..first + 9].copy_from_slice(&offset.origin);
        self.numbered[first + 9] = offset.rotation;
        if index == self.modes.system {
            self.select_system(index);
        }
    }

    /// Puts an offset of G92 in force, or none.
    pub(crate) fn set_g92(&mut self, offset: Option<PerLetter>) {
        self.numbered[G92_ACTIVE] = f64::from(u8::from(offset.is_some()));
        self.g92 = offset.unwrap_or_default();
        self.update_shift();
    }

    /// Computes the sum of the offsets after a change of one.
    pub(crate) fn update_shift(&mut self) {
        let tool = self.tool_shift();
        for (axis, tool) in tool.iter().enumerate() {
            self.shift[axis] = self.origin.origin[axis] + tool + self.g92[axis];
        }
        if !self.rotation.is_none() {
            // G92 is an offset within the turned system.
            let turned = self.rotation.turn([self.g92[0], self.g92[1]]);
            for (axis, turned) in turned.into_iter().enumerate() {
                self.shift[axis] = self.origin.origin[axis] + tool[axis] + turned;
            }
        }
    }

    /// Returns the offset of the tool that is part of [`State::shift`].
    pub(crate) fn tool_shift(&self) -> PerLetter {
        if self.length.axis.turns() {
            PerLetter::default()
        } else {
            self.tool_offset
        }
    }

    /// Puts a tool offset in force. The machine stays where it is.
    pub(crate) fn set_tool_offset(&mut self, offset: PerLetter) {
        self.tool_offset = offset;
        if self.length.axis.turns() {
            let machine = self.length.machine_pose(&self.at);
            self.length.length = offset[Z];
            self.at = self.length.tip_pose(&machine);
        }
        self.update_shift();
    }

    /// Returns the place of the program in the machine.
    pub(crate) fn frame(&self) -> Frame {
        Frame {
            shift: self.shift,
            rotation: self.rotation,
        }
    }

    /// Returns a position of the machine in program coordinates: mm, degrees.
    pub(crate) fn in_program(&self, at: &PerLetter) -> PerLetter {
        self.frame().in_program(at)
    }

    /// Returns a position in program coordinates in those of the machine.
    pub(crate) fn in_machine(&self, value: &PerLetter) -> PerLetter {
        let mut at = *value;
        if !self.rotation.is_none() {
            [at[0], at[1]] = self.rotation.turn([at[0], at[1]]);
        }
        for (at, shift) in at.iter_mut().zip(&self.shift) {
            *at += shift;
        }
        at
    }

    /// Returns the offsets in force of these letters as a text for messages ("G55 X100.000, tool
    /// length Z50.000"); `None` if program and machine coordinates are the same.
    pub(crate) fn offsets_in_force(&self, letters: &[usize]) -> Option<String> {
        let values = |offset: &PerLetter| {
            let letters = letters.iter().filter(|&&axis| offset[axis] != 0.0);
            let words =
                letters.map(|&axis| format!(" {}{:.3}", char::from(AXES[axis]), offset[axis]));
            words.collect::<String>()
        };
        let mut system = values(&self.origin.origin);
        if self.origin.rotation != 0.0 {
            system.push_str(&format!(" turned by {} deg", self.origin.rotation));
        }
        let parts = [
            (SYSTEM_NAMES[self.modes.system], system),
            ("G92", values(&self.g92)),
            ("tool offset", values(&self.tool_offset)),
        ];
        let parts = parts.iter().filter(|(_, values)| !values.is_empty());
        let parts: Vec<String> = parts
            .map(|(name, values)| format!("{name}{values}"))
            .collect();
        (!parts.is_empty()).then(|| parts.join(", "))
    }
}
