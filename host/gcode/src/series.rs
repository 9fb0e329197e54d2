//! What the executor keeps through a series of blocks: words of a cycle, points of a curve.

/// Words of a cycle that stay in force, in program units.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Cycle {
    /// Level before the series of cycles, machine coordinates.
    pub initial_level: Option<f64>,
    pub r: Option<f64>,
    pub depth: Option<f64>,
    pub peck: Option<f64>,
    pub dwell: Option<f64>,
    pub shifts: [Option<f64>; 3],
}

impl Cycle {
    /// Forgets the words of another cycle.
    pub(crate) fn forget_words(&mut self) {
        *self = Cycle {
            initial_level: self.initial_level,
            ..Cycle::default()
        };
    }
}

/// A control point of a NURBS in machine coordinates, and the order of the curve.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ControlPoint {
    pub at: [f64; 2],
    pub weight: f64,
    pub order: usize,
}
