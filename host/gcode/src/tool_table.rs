//! Tool table and work offsets: what a machine keeps between programs.

use std::collections::BTreeMap;

/// Values per axis letter, in the order X Y Z A B C U V W: mm, degrees.
pub type PerLetter = [f64; 9];

/// Number of work coordinate systems: G54 to G59, G59.1 to G59.3.
pub const SYSTEMS: usize = 9;

/// A tool.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Tool {
    /// Offset of its tip, mm, degrees; its length is Z.
    pub offset: PerLetter,
    /// Diameter, mm.
    pub diameter: f64,
}

/// The tools by number.
pub type ToolTable = BTreeMap<u32, Tool>;

/// A work coordinate system.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct WorkOffset {
    /// Machine coordinates of its origin, mm, degrees.
    pub origin: PerLetter,
    /// Rotation about Z, degrees.
    pub rotation: f64,
}

/// Work offsets and reference positions of a machine.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Offsets {
    /// G54 to G59, G59.1 to G59.3.
    pub systems: [WorkOffset; SYSTEMS],
    /// Number of the system in force at the start, from 0 (G54) to 8 (G59.3).
    pub active: usize,
    /// Offset of G92, mm, degrees, and whether it is in force.
    pub g92: PerLetter,
    /// Whether the offset of G92 is in force at the start.
    pub g92_active: bool,
    /// Position of G28, machine coordinates.
    pub g28: PerLetter,
    /// Position of G30, machine coordinates.
    pub g30: PerLetter,
}

/// Names of the work coordinate systems, as in a program.
pub const SYSTEM_NAMES: [&str; SYSTEMS] = [
    "G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3",
];
