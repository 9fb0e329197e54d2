//! Material removal along the tool path with a small number of sweeps.
//!
//! Positions arrive at short intervals and are collected into stretches of 0.2 mm. A stretch is cut
//! in one straight sweep. If a position deviates by more than 1 um from it, the stretch is cut in
//! two sweeps with the corner at the position that deviates most. On a circle of 15 mm radius one
//! sweep deviates by 0.3 um from the arc.
//!
//! A stretch is cut when the next one is complete, so that the cut in the map ends some cells
//! behind the tool. Between its points the map rounds off the rim of a fresh cut, and the edges
//! must not see this. When the tool moves back by 2 um behind the latest position, all stretches
//! are cut at once, because the tool returns to where it was.

use crate::process::tooth_path::Passed;
use crate::process::workpiece::Workpiece;
use crate::vector::{Vector, dot, minus};

/// Length of a complete stretch, mm.
const LONGEST: f64 = 0.2;

/// Positions nearer to each other than this count as one, mm.
const SAME: f64 = 0.0002;

/// Largest deviation of a position from the sweep, mm.
const ASIDE: f64 = 0.001;

/// Largest number of sweeps per stretch.
const PIECES: usize = 2;

/// Largest backward motion without an immediate cut, mm.
const BACK: f64 = 0.002;

/// Tool path that is being cut.
#[derive(Debug, Clone)]
pub struct MaterialRemoval {
    radius: f64,
    /// Waiting stretch; it starts where the last cut ended.
    waiting: Vec<Vector>,
    /// Stretch that is being collected; it starts at the end of the waiting one.
    present: Vec<Vector>,
    /// Latest position.
    end: Vector,
    /// Largest distance from the end of the last cut, mm.
    furthest: f64,
}

fn distance(a: Vector, b: Vector) -> f64 {
    let off = minus(a, b);
    dot(off, off).sqrt()
}

impl MaterialRemoval {
    /// Starts with a ball of this radius in the air.
    pub fn new(radius: f64, centre: Vector) -> Self {
        Self {
            radius,
            waiting: vec![centre],
            present: vec![centre],
            end: centre,
            furthest: 0.0,
        }
    }

    /// Position of the centre at the end of the last cut.
    pub fn cut(&self) -> Vector {
        self.waiting[0]
    }

    /// Adds the position `passed`; `now` is the present position.
    pub fn follow(&mut self, workpiece: &mut Workpiece, passed: Passed, now: Vector) {
        let place = passed.centre;
        if passed.apart {
            self.finish(workpiece);
            workpiece.sweep(self.radius, place, place);
            self.begin(place);
            return;
        }
        let latest = self.present[self.present.len() - 1];
        let step = minus(place, latest);
        self.end = place;
        if dot(step, step) < SAME * SAME {
            return;
        }
        let from_cut = distance(place, self.waiting[0]);
        let back = self.furthest - BACK;
        self.present.push(place);
        if from_cut < back || distance(now, self.waiting[0]) < back {
            self.finish(workpiece);
            return;
        }
        self.furthest = if from_cut > self.furthest {
            from_cut
        } else {
            self.furthest
        };
        if distance(place, self.present[0]) > LONGEST {
            cut(workpiece, self.radius, &self.waiting);
            core::mem::swap(&mut self.waiting, &mut self.present);
            self.present.clear();
            self.present.push(place);
            self.furthest = distance(place, self.waiting[0]);
        }
    }

    /// Cuts up to the latest position.
    pub fn finish(&mut self, workpiece: &mut Workpiece) {
        cut(workpiece, self.radius, &self.waiting);
        self.present.push(self.end);
        cut(workpiece, self.radius, &self.present);
        self.begin(self.end);
    }

    fn begin(&mut self, place: Vector) {
        self.end = place;
        self.furthest = 0.0;
        for stretch in [&mut self.waiting, &mut self.present] {
            stretch.clear();
            stretch.push(place);
        }
    }
}

/// Sweeps the ball along these positions, on straight lines within the tolerance.
fn cut(workpiece: &mut Workpiece, radius: f64, way: &[Vector]) {
    let mut corners = [0; PIECES + 1];
    let mut pieces = 1;
    corners[1] = way.len() - 1;
    if corners[1] == 0 {
        return;
    }
    while pieces < PIECES {
        // The position that deviates most from its line becomes a corner.
        let (mut max, mut split, mut after) = (ASIDE * ASIDE, 0, 0);
        for piece in 0..pieces {
            let (from, to) = (way[corners[piece]], way[corners[piece + 1]]);
            let line = minus(to, from);
            let square = dot(line, line);
            for (k, place) in way
                .iter()
                .enumerate()
                .take(corners[piece + 1])
                .skip(corners[piece] + 1)
            {
                let off = minus(*place, from);
                let along = dot(off, line);
                let along = if along > 0.0 { along } else { 0.0 };
                let along = if along < square { along } else { square };
                let part = if square > 0.0 { along / square } else { 0.0 };
                let aside = minus(off, line.map(|value| value * part));
                let aside = dot(aside, aside);
                if aside > max {
                    (max, split, after) = (aside, k, piece);
                }
            }
        }
        if split == 0 {
            break;
        }
        corners.copy_within(after + 1..=pieces, after + 2);
        corners[after + 1] = split;
        pieces += 1;
    }
    for piece in 0..pieces {
        workpiece.sweep(radius, way[corners[piece]], way[corners[piece + 1]]);
    }
}
