//! Cutting a way into a workpiece with as few sweeps as it needs.
//!
//! Places come in at short intervals. They are joined into straight sweeps of up to 0.1 mm, for as long as the way stays within 4 um of the line on
//! which it began and does not turn back by 2 um; on a circle of 15 mm radius the sweep lies within 0.1 um of the arc.

use crate::cutting::path::Passed;
use crate::cutting::workpiece::Workpiece;

/// Longest sweep, mm.
const LONGEST: f64 = 0.1;

/// The direction of a sweep is settled when it is this long, mm.
const SETTLED: f64 = 0.02;

/// How far a place may lie off the line on which the sweep began, mm.
const ASIDE: f64 = 0.004;

/// How far the way may turn back, mm.
const BACK: f64 = 0.002;

type Vector = [f64; 3];

/// The way that is cut.
#[derive(Debug, Clone)]
pub struct Carver {
    radius: f64,
    /// The workpiece is cut up to here.
    cut: Vector,
    /// Latest place.
    end: Vector,
    /// Direction of the sweep, once it is settled.
    direction: Option<Vector>,
    /// Furthest along the sweep, mm.
    furthest: f64,
}

fn minus(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl Carver {
    /// A ball of this radius that stands in the air.
    pub const fn new(radius: f64, centre: Vector) -> Self {
        Self {
            radius,
            cut: centre,
            end: centre,
            direction: None,
            furthest: 0.0,
        }
    }

    /// Where the centre was when the workpiece was cut last.
    pub const fn cut(&self) -> Vector {
        self.cut
    }

    /// The ball was here.
    pub fn follow(&mut self, workpiece: &mut Workpiece, passed: Passed) {
        let place = passed.centre;
        if passed.apart {
            self.finish(workpiece);
            workpiece.sweep(self.radius, place, place);
            self.cut = place;
            self.end = place;
            return;
        }
        let chord = minus(place, self.cut);
        let length = dot(chord, chord).sqrt();
        let leaves = match self.direction {
            Some(direction) => {
                let along = dot(chord, direction);
                let aside = (length * length - along * along).max(0.0);
                let turned = along < self.furthest - BACK;
                self.furthest = if along > self.furthest { along } else { self.furthest };
                turned || aside > ASIDE * ASIDE
            }
            None => {
                // Not settled yet: it has turned back when it is nearer to the start than it was.
                let turned = length < self.furthest - BACK;
                self.furthest = if length > self.furthest { length } else { self.furthest };
                turned
            }
        };
        if leaves || length > LONGEST {
            self.finish(workpiece);
            let step = minus(place, self.cut);
            self.furthest = dot(step, step).sqrt();
        } else if self.direction.is_none() && length > SETTLED {
            self.direction = Some(chord.map(|part| part / length));
        }
        self.end = place;
    }

    /// Cuts up to the latest place.
    pub fn finish(&mut self, workpiece: &mut Workpiece) {
        if self.end != self.cut {
            workpiece.sweep(self.radius, self.cut, self.end);
        }
        self.cut = self.end;
        self.direction = None;
        self.furthest = 0.0;
    }
}
