//! State of the interpreter: modes, position, offsets and parameters.

use super::block::AXES;
use super::expression::{Parameter, Values};
use super::frame::Rotation;
use super::tool_axis::ToolLength;
use super::tool_table::{PerLetter, SYSTEMS, Tool, ToolTable, WorkOffset};
use super::{INCH_MM, Options};
use std::collections::{BTreeSet, HashMap};

/// Number of numbered parameters, 0 included.
pub(crate) const PARAMETERS: usize = 5603;

/// First parameters of the reference positions, of G92, and of the work coordinate systems.
pub(crate) const G28: usize = 5161;
pub(crate) const G30: usize = 5181;
pub(crate) const G92_ACTIVE: usize = 5210;
pub(crate) const G92: usize = 5211;
pub(crate) const SYSTEM: usize = 5220;
pub(crate) const SYSTEM_1: usize = 5221;
/// First parameter of the probed position, and that of the probe's success.
pub(crate) const PROBED: usize = 5061;
pub(crate) const PROBE_DONE: usize = 5070;
/// Result of M66.
pub(crate) const WAITED: usize = 5399;
const TOOL: usize = 5400;
const POSITION: usize = 5420;

/// Motion group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Motion {
    Off,
    Rapid,
    Straight,
    Clockwise,
    CounterClockwise,
    /// G38.2 to G38.5, the last digit.
    Probe(u8),
    /// G73, G74, G81 to G89.
    Cycle(u8),
    /// G5, G5.1, G5.2.
    Cubic,
    Quadratic,
    Nurbs,
}

impl Motion {
    /// Returns the motion of a code, in tenths; `None` for G5.3.
    pub(crate) fn of(tenths: u16) -> Option<Motion> {
        Some(match tenths {
            0 => Motion::Rapid,
            10 => Motion::Straight,
            20 => Motion::Clockwise,
            30 => Motion::CounterClockwise,
            50 => Motion::Cubic,
            51 => Motion::Quadratic,
            52 => Motion::Nurbs,
            382..=385 => Motion::Probe((tenths - 380) as u8),
            730 | 740 | 810..=890 => Motion::Cycle((tenths / 10) as u8),
            800 => Motion::Off,
            _ => return None,
        })
    }

    pub(crate) fn tenths(self) -> u16 {
        match self {
            Motion::Off => 800,
            Motion::Rapid => 0,
            Motion::Straight => 10,
            Motion::Clockwise => 20,
            Motion::CounterClockwise => 30,
            Motion::Probe(kind) => 380 + u16::from(kind),
            Motion::Cycle(number) => 10 * u16::from(number),
            Motion::Cubic => 50,
            Motion::Quadratic => 51,
            Motion::Nurbs => 52,
        }
    }

    pub(crate) fn is_arc(self) -> bool {
        matches!(self, Motion::Clockwise | Motion::CounterClockwise)
    }
}

/// G17 to G19.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Plane {
    Xy,
    Zx,
    Yz,
}

impl Plane {
    /// Returns its axes in the order in which G3 is a positive angle, and its normal: indices of
    /// X, Y, Z.
    pub(crate) fn axes(self) -> [usize; 3] {
        match self {
            Plane::Xy => [0, 1, 2],
            Plane::Zx => [2, 0, 1],
            Plane::Yz => [1, 2, 0],
        }
    }

    /// Returns its G word.
    pub(crate) fn word(self) -> &'static str {
        match self {
            Plane::Xy => "G17",
            Plane::Zx => "G18",
            Plane::Yz => "G19",
        }
    }
}

/// G93 to G95.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FeedMode {
    InverseTime,
    PerMinute,
    PerTurn,
}

/// G61, G61.1, G64.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum PathControl {
    ExactStop,
    Blend {
        /// P, mm.
        tolerance: Option<f64>,
        /// Q, mm.
        joining: Option<f64>,
    },
}

/// Direction of the spindle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Turn {
    Off,
    Clockwise,
    CounterClockwise,
}

/// What modal words set; M70 saves it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Modes {
    pub motion: Motion,
    pub plane: Plane,
    pub inch: bool,
    pub incremental: bool,
    /// G90.1.
    pub absolute_centres: bool,
    pub feed_mode: FeedMode,
    /// F as written, in the unit of its block.
    pub feed: Option<f64>,
    /// F in mm/min (mm per revolution with G95).
    pub feed_mm: f64,
    pub path_control: PathControl,
    /// M49 or M50 P0: the overrides have no effect on moves at feed.
    pub fixed: bool,
    /// G99.
    pub return_to_r: bool,
    /// Rev/min, or m/min with G96.
    pub speed: Option<f64>,
    /// G96: maximum speed in rev/min.
    pub surface_limit: Option<f64>,
    pub turn: Turn,
    pub mist: bool,
    pub flood: bool,
    /// Index of the work coordinate system.
    pub system: usize,
}

/// State of the interpreter.
#[derive(Clone)]
pub(crate) struct State {
    pub modes: Modes,
    /// Programmed position of the tip in machine coordinates: mm, degrees.
    pub at: PerLetter,
    /// Offset of the system in force.
    pub origin: WorkOffset,
    pub rotation: Rotation,
    /// Offset of G92 in force.
    pub g92: PerLetter,
    pub tool_offset: PerLetter,
    /// A tool was changed, and no code of the tool length came since.
    pub length_is_open: bool,
    /// Tool whose length is no offset, by letter.
    pub length: ToolLength,
    /// Number of the tool, and of the selected one.
    pub tool: u32,
    pub selected: u32,
    pub tools: ToolTable,
    /// Tools that the program names, and the table lacks.
    pub missing_tools: BTreeSet<u32>,
    /// Side of cutter compensation, in tenths of its G word; 400 is off.
    pub compensation: u16,
    /// Sum of all offsets, without rotation.
    pub shift: PerLetter,
    pub numbered: Vec<f64>,
    pub globals: HashMap<String, f64>,
    /// Named parameters of each subroutine call; the first is the main program's.
    pub locals: Vec<HashMap<String, f64>>,
    /// Line that is being read.
    pub line: u32,
}

/// Index of Z.
pub(crate) const Z: usize = 2;

/// Returns the index of the letter of a pose coordinate.
fn letter_of(options: &Options, index: usize) -> usize {
    let letter = options.axes.get(index).map(|axis| axis.letter);
    let mut letters = AXES.iter();
    letters
        .position(|known| Some(char::from(*known)) == letter)
        .unwrap_or(0)
}

/// Whether an index of the offsets is a linear axis.
pub(crate) const fn is_linear(axis: usize) -> bool {
    !matches!(axis, 3..=5)
}

impl State {
    pub(crate) fn new(options: &Options, at: PerLetter) -> Self {
        let offsets = &options.offsets;
        let mut numbered = vec![0.0; PARAMETERS];
        numbered[G28..G28 + 9].copy_from_slice(&offsets.g28);
        numbered[G30..G30 + 9].copy_from_slice(&offsets.g30);
        numbered[G92_ACTIVE] = f64::from(u8::from(offsets.g92_active));
        numbered[G92..G92 + 9].copy_from_slice(&offsets.g92);
        for (index, system) in offsets.systems.iter().enumerate() {
            let first = SYSTEM_1 + 20 * index;
            numbered[first..first + 9].copy_from_slice(&system.origin);
            numbered[first + 9] = system.rotation;
        }
        let mut state = Self {
            modes: Modes {
                motion: Motion::Off,
                plane: Plane::Xy,
                inch: false,
                incremental: false,
                absolute_centres: false,
                feed_mode: FeedMode::PerMinute,
                feed: None,
                feed_mm: 0.0,
                path_control: PathControl::Blend {
                    tolerance: None,
                    joining: None,
                },
                fixed: false,
                return_to_r: true,
                speed: None,
                surface_limit: None,
                turn: Turn::Off,
                mist: false,
                flood: false,
                system: offsets.active.min(SYSTEMS - 1),
            },
            at,
            origin: WorkOffset::default(),
            rotation: Rotation::of(0.0),
            g92: if offsets.g92_active {
                offsets.g92
            } else {
                PerLetter::default()
            },
            tool_offset: PerLetter::default(),
            length_is_open: false,
            length: ToolLength {
                axis: options.tool_axis.map(|index| letter_of(options, index)),
                length: 0.0,
            },
            tool: options.tool,
            selected: 0,
            tools: options.tools.clone(),
            missing_tools: BTreeSet::new(),
            compensation: 400,
            shift: PerLetter::default(),
            numbered,
            globals: ["_value", "_value_returned"]
                .map(|name| (name.into(), 0.0))
                .into(),
            locals: vec![HashMap::new()],
            line: 0,
        };
        state.select_system(state.modes.system);
        state
    }

    /// Returns mm per unit of the program for an axis; 1 for a rotary one.
    pub(crate) fn scale(&self, axis: usize) -> f64 {
        if self.modes.inch && is_linear(axis) {
            INCH_MM
        } else {
            1.0
        }
    }

    /// Returns mm per unit of the program.
    pub(crate) fn unit(&self) -> f64 {
        if self.modes.inch { INCH_MM } else { 1.0 }
    }

    /// Returns the tool of a number.
    pub(crate) fn tool_of(&self, number: u32) -> Option<Tool> {
        self.tools.get(&number).copied()
    }

    /// Assigns a parameter.
    ///
    /// # Errors
    ///
    /// Returns problem and remedy.
    pub(crate) fn assign(
        &mut self,
        parameter: &Parameter,
        value: f64,
    ) -> Result<(), (String, &'static str)> {
        match parameter {
            Parameter::Numbered(number) => {
                let index = *number as usize;
                if (TOOL..TOOL + 14).contains(&index) || (POSITION..POSITION + 9).contains(&index) {
                    return Err((format!("#{number} is read only"), "use another parameter"));
                }
                if !(1..PARAMETERS).contains(&index) {
                    return Err((
                        format!("#{number} is not a parameter"),
                        "parameters have the numbers 1 to 5602",
                    ));
                }
                if index == SYSTEM && !(1.0..=9.0).contains(&value) {
                    return Err((
                        format!("#5220 is the number of the coordinate system, not {value}"),
                        "write 1 (G54) to 9 (G59.3)",
                    ));
                }
                self.numbered[index] = value;
            }
            Parameter::Named(name) => {
                if name.starts_with('_') {
                    if self.predefined(name).is_some() {
                        return Err((format!("#<{name}> is read only"), "use another name"));
                    }
                    bounded(&mut self.globals, name, value)?;
                } else if let Some(locals) = self.locals.last_mut() {
                    bounded(locals, name, value)?;
                }
            }
        }
        Ok(())
    }

    /// Returns a predefined parameter.
    fn predefined(&self, name: &str) -> Option<f64> {
        let modes = &self.modes;
        let truth = |value: bool| f64::from(u8::from(value));
        let axis = |letter: &str| {
            let [letter] = letter.as_bytes() else {
                return None;
            };
            AXES.iter()
                .position(|axis| axis.eq_ignore_ascii_case(letter))
        };
        if let Some(axis) = name.strip_prefix("_abs_").and_then(axis) {
            return Some(self.length.machine_pose(&self.at)[axis] / self.scale(axis));
        }
        if let Some(axis) = name.strip_prefix('_').and_then(axis) {
            return Some(self.in_program(&self.at)[axis] / self.scale(axis));
        }
        Some(match name {
            "_line" => f64::from(self.line),
            "_motion_mode" => f64::from(modes.motion.tenths()),
            "_plane" => match modes.plane {
                Plane::Xy => 170.0,
                Plane::Zx => 180.0,
                Plane::Yz => 190.0,
            },
            "_ccomp" => f64::from(self.compensation),
            "_metric" => truth(!modes.inch),
            "_imperial" => truth(modes.inch),
            "_absolute" => truth(!modes.incremental),
            "_incremental" => truth(modes.incremental),
            "_inverse_time" => truth(modes.feed_mode == FeedMode::InverseTime),
            "_units_per_minute" => truth(modes.feed_mode == FeedMode::PerMinute),
            "_units_per_rev" => truth(modes.feed_mode == FeedMode::PerTurn),
            "_coord_system" => [
                540.0, 550.0, 560.0, 570.0, 580.0, 590.0, 591.0, 592.0, 593.0,
            ][modes.system],
            "_tool_offset" => truth(self.tool_offset != PerLetter::default()),
            "_retract_r_plane" => truth(modes.return_to_r),
            "_retract_old_z" => truth(!modes.return_to_r),
            "_spindle_rpm_mode" => truth(modes.surface_limit.is_none()),
            "_spindle_css_mode" => truth(modes.surface_limit.is_some()),
            "_ijk_absolute_mode" => truth(modes.absolute_centres),
            "_lathe_diameter_mode"
            | "_lathe_radius_mode"
            | "_adaptive_feed"
            | "_task"
            | "_remap_level" => 0.0,
            "_spindle_on" => truth(modes.turn != Turn::Off),
            "_spindle_cw" => truth(modes.turn == Turn::Clockwise),
            "_mist" => truth(modes.mist),
            "_flood" => truth(modes.flood),
            "_speed_override" | "_feed_override" | "_feed_hold" => 1.0,
            "_feed" => modes.feed.unwrap_or(0.0),
            "_rpm" => modes.speed.unwrap_or(0.0),
            "_current_tool" | "_current_pocket" => f64::from(self.tool),
            "_selected_tool" | "_selected_pocket" => f64::from(self.selected),
            "_call_level" => (self.locals.len() - 1) as f64,
            "_vmajor" => 2.9,
            "_vminor" => 0.0,
            _ => return None,
        })
    }
}

/// Largest number of named parameters in one scope.
const MAX_NAMES: usize = 10_000;

fn bounded(
    names: &mut HashMap<String, f64>,
    name: &str,
    value: f64,
) -> Result<(), (String, &'static str)> {
    if let Some(known) = names.get_mut(name) {
        *known = value;
    } else if names.len() >= MAX_NAMES {
        return Err((
            format!("more than {MAX_NAMES} named parameters"),
            "use numbered parameters",
        ));
    } else {
        names.insert(name.to_owned(), value);
    }
    Ok(())
}

impl Values for State {
    fn numbered(&self, number: u32) -> Option<f64> {
        let index = number as usize;
        match index {
            0 => None,
            TOOL => Some(f64::from(self.tool)),
            5401..=5409 => {
                let axis = index - 5401;
                Some(self.tool_offset[axis] / self.scale(axis))
            }
            5410 => Some(
                self.tool_of(self.tool)
                    .map_or(0.0, |tool| tool.diameter / self.unit()),
            ),
            5420..=5428 => {
                let axis = index - POSITION;
                Some(self.in_program(&self.at)[axis] / self.scale(axis))
            }
            _ => self.numbered.get(index).copied(),
        }
    }

    fn named(&self, name: &str) -> Option<f64> {
        if name.starts_with('_') {
            self.globals
                .get(name)
                .copied()
                .or_else(|| self.predefined(name))
        } else {
            self.locals.last()?.get(name).copied()
        }
    }
}
