//! Geometry of a move: a line or an arc in pose space, parametrised by length.

/// Pose in millimetres and degrees, in the machine's order of coordinates; unused ones are 0.
pub type Coordinates = [f64; 6];

/// Linear or rotary.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WordKind {
    /// In millimetres.
    Linear,
    /// In degrees.
    Rotary,
}

/// Measure of the length of a path.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Measure {
    /// Millimetres of the tool tip in the workpiece.
    Tip,
    /// Degrees of the rotary axis that turns farthest; the tip does not move in the workpiece.
    Turn,
}

/// An arc in the plane of two pose coordinates. The others move in proportion to the angle (helix).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arc {
    /// The plane's coordinates, in the order that makes a positive sweep counter-clockwise (G3).
    pub plane: [usize; 2],
    /// Centre in the plane.
    pub centre: [f64; 2],
    /// Radius at start and end; in between it changes linearly.
    pub radius: [f64; 2],
    /// Angle of the start, radians.
    pub angle: f64,
    /// Signed angle of the whole arc, radians.
    pub sweep: f64,
}

impl Arc {
    /// Sets the coordinates of the plane at a fraction `u`, with sine and cosine of its angle.
    fn place(&self, u: f64, (sin, cos): (f64, f64), point: &mut Coordinates) {
        let radius = self.radius[0] + (self.radius[1] - self.radius[0]) * u;
        point[self.plane[0]] = self.centre[0] + radius * cos;
        point[self.plane[1]] = self.centre[1] + radius * sin;
    }

    /// Sets the derivatives of the coordinates of the plane by length.
    fn turn(&self, u: f64, (sin, cos): (f64, f64), length: f64, tangent: &mut Coordinates) {
        let growth = self.radius[1] - self.radius[0];
        let radius = self.radius[0] + growth * u;
        tangent[self.plane[0]] = (growth * cos - radius * self.sweep * sin) / length;
        tangent[self.plane[1]] = (growth * sin + radius * self.sweep * cos) / length;
    }
}

/// A line or an arc, parametrised by length: 0 at `from`, [`Path::length`] at `to`.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    /// Start.
    pub from: Coordinates,
    /// End.
    pub to: Coordinates,
    /// The arc; `None` for a line.
    pub arc: Option<Arc>,
    /// Length in the unit of `measure`; positive.
    pub length: f64,
    /// Measure of the length.
    pub measure: Measure,
}

impl Path {
    /// Creates a line; `None` if nothing moves.
    pub fn line(kinds: &[WordKind], from: Coordinates, to: Coordinates) -> Option<Path> {
        let (tip, turn) = extent(kinds, &from, &to, &[]);
        Self::with_length(from, to, None, tip.sqrt(), turn)
    }

    /// Creates an arc; `None` if nothing moves.
    pub fn arc(kinds: &[WordKind], from: Coordinates, to: Coordinates, arc: Arc) -> Option<Path> {
        let (rest, turn) = extent(kinds, &from, &to, &arc.plane);
        let in_plane = 0.5 * (arc.radius[0] + arc.radius[1]) * arc.sweep;
        Self::with_length(
            from,
            to,
            Some(arc),
            (in_plane * in_plane + rest).sqrt(),
            turn,
        )
    }

    fn with_length(
        from: Coordinates,
        to: Coordinates,
        arc: Option<Arc>,
        tip: f64,
        turn: f64,
    ) -> Option<Path> {
        // A path below the resolution of the setpoints (1 nm, 0.08 udeg) is no move.
        let (length, measure) = match (tip > 1e-7, turn > 1e-8) {
            (true, _) => (tip, Measure::Tip),
            (false, true) => (turn, Measure::Turn),
            (false, false) => return None,
        };
        Some(Path {
            from,
            to,
            arc,
            length,
            measure,
        })
    }

    /// Whether the path turns a rotary coordinate.
    pub fn turns(&self, kinds: &[WordKind]) -> bool {
        let mut ends = kinds.iter().zip(self.from.iter().zip(&self.to));
        ends.any(|(kind, (from, to))| *kind == WordKind::Rotary && from != to)
    }

    /// Returns the two halves of the path.
    pub fn halves(&self) -> [Path; 2] {
        let middle = self.at(0.5 * self.length);
        [(0.0, self.from, middle), (0.5, middle, self.to)].map(|(begin, from, to)| {
            let arc = self.arc.map(|arc| {
                let radius = |u: f64| arc.radius[0] + (arc.radius[1] - arc.radius[0]) * u;
                Arc {
                    radius: [radius(begin), radius(begin + 0.5)],
                    angle: arc.angle + arc.sweep * begin,
                    sweep: 0.5 * arc.sweep,
                    ..arc
                }
            });
            Path {
                from,
                to,
                arc,
                length: 0.5 * self.length,
                measure: self.measure,
            }
        })
    }

    /// Returns the length of the path of the tool tip, mm.
    pub fn tip_length(&self) -> f64 {
        match self.measure {
            Measure::Tip => self.length,
            Measure::Turn => 0.0,
        }
    }

    /// Returns the point at length `s`. The ends are exact; `s` is limited to them.
    pub fn at(&self, s: f64) -> Coordinates {
        if s <= 0.0 {
            return self.from;
        }
        if s >= self.length {
            return self.to;
        }
        let u = s / self.length;
        let mut point = self.on_chord(u);
        if let Some(arc) = &self.arc {
            arc.place(u, libm::sincos(arc.angle + arc.sweep * u), &mut point);
        }
        point
    }

    /// Returns the derivative of the point by length, at `s`.
    pub fn tangent(&self, s: f64) -> Coordinates {
        let mut tangent = self.along_chord();
        if let Some(arc) = &self.arc {
            let u = (s / self.length).clamp(0.0, 1.0);
            let angle = libm::sincos(arc.angle + arc.sweep * u);
            arc.turn(u, angle, self.length, &mut tangent);
        }
        tangent
    }

    /// Returns [`Path::at`] and [`Path::tangent`], with the same bits, in less time.
    pub fn at_with_tangent(&self, s: f64) -> (Coordinates, Coordinates) {
        let mut tangent = self.along_chord();
        let u = (s / self.length).clamp(0.0, 1.0);
        let is_between = s > 0.0 && s < self.length;
        let mut point = match is_between {
            true => self.on_chord(u),
            false if s <= 0.0 => self.from,
            false => self.to,
        };
        if let Some(arc) = &self.arc {
            let angle = libm::sincos(arc.angle + arc.sweep * u);
            arc.turn(u, angle, self.length, &mut tangent);
            if is_between {
                arc.place(u, angle, &mut point);
            }
        }
        (point, tangent)
    }

    /// Point of the straight line at a fraction.
    fn on_chord(&self, u: f64) -> Coordinates {
        let mut point = self.from;
        for (value, to) in point.iter_mut().zip(&self.to) {
            *value += (to - *value) * u;
        }
        point
    }

    /// Derivative of the straight line by length.
    fn along_chord(&self) -> Coordinates {
        let mut tangent = [0.0; 6];
        for (value, (from, to)) in tangent.iter_mut().zip(self.from.iter().zip(&self.to)) {
            *value = (to - from) / self.length;
        }
        tangent
    }

    /// Returns the second derivative of the point by length, at `s`.
    pub fn curvature(&self, s: f64) -> Coordinates {
        let mut curvature = [0.0; 6];
        if let Some(arc) = &self.arc {
            let u = (s / self.length).clamp(0.0, 1.0);
            let (sin, cos) = libm::sincos(arc.angle + arc.sweep * u);
            let growth = arc.radius[1] - arc.radius[0];
            let radial = -(arc.radius[0] + growth * u) * arc.sweep * arc.sweep;
            let across = 2.0 * growth * arc.sweep;
            let scale = 1.0 / (self.length * self.length);
            curvature[arc.plane[0]] = (radial * cos - across * sin) * scale;
            curvature[arc.plane[1]] = (radial * sin + across * cos) * scale;
        }
        curvature
    }
}

/// Returns the squared length over the linear coordinates outside `skip`, and the largest turn of a
/// rotary coordinate.
fn extent(kinds: &[WordKind], from: &Coordinates, to: &Coordinates, skip: &[usize]) -> (f64, f64) {
    let (mut squared, mut turn) = (0.0, 0.0f64);
    for (k, kind) in kinds.iter().enumerate().take(6) {
        let step = to[k] - from[k];
        match kind {
            WordKind::Linear if !skip.contains(&k) => squared += step * step,
            WordKind::Linear => {}
            WordKind::Rotary => turn = turn.max(step.abs()),
        }
    }
    (squared, turn)
}
