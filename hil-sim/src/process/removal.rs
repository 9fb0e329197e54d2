//! Cutting a way into a workpiece with as few sweeps as it needs.
//!
//! Places come in at short intervals. They are gathered into stretches of 0.2 mm; a stretch is cut in one straight sweep, or in two with the corner at the
//! place that lies furthest aside, when that is more than 1 um. On a circle of 15 mm radius one sweep leaves 0.3 um of the arc.
//!
//! A stretch is cut when the next one is whole, so that the map ends some cells behind the tool: between its points it rounds off the rim of a
//! fresh cut, and the edges must not see that. When the tool has come back by 2 um behind the latest place, everything is cut at once, for then
//! it comes to where it was.

use crate::process::tooth_path::Passed;
use crate::process::workpiece::Workpiece;
use crate::vector::{Vector, dot, minus};

/// A stretch is whole when it reaches this far, mm.
const LONGEST: f64 = 0.2;

/// Places nearer to each other than this are one, mm.
const SAME: f64 = 0.0002;

/// A place may lie this far off the sweep, mm.
const ASIDE: f64 = 0.001;

/// Sweeps in one stretch at most.
const PIECES: usize = 2;

/// How far the way may turn back, mm.
const BACK: f64 = 0.002;

/// The way that is cut.
#[derive(Debug, Clone)]
pub struct MaterialRemoval {
    radius: f64,
    /// The stretch that waits, from where the workpiece is cut up to.
    waiting: Vec<Vector>,
    /// The stretch that is gathered; it begins where the other ends.
    present: Vec<Vector>,
    /// Latest place.
    end: Vector,
    /// Furthest from where the workpiece is cut up to, mm.
    furthest: f64,
}

fn distance(a: Vector, b: Vector) -> f64 {
    let off = minus(a, b);
    dot(off, off).sqrt()
}

impl MaterialRemoval {
    /// A ball of this radius that stands in the air.
    pub fn new(radius: f64, centre: Vector) -> Self {
        Self {
            radius,
            waiting: vec![centre],
            present: vec![centre],
            end: centre,
            furthest: 0.0,
        }
    }

    /// Where the centre was when the workpiece was cut last.
    pub fn cut(&self) -> Vector {
        self.waiting[0]
    }

    /// The ball was at a place, and now it is at another.
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

    /// Cuts up to the latest place.
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

/// Sweeps the ball along these places, straight where that is near enough.
fn cut(workpiece: &mut Workpiece, radius: f64, way: &[Vector]) {
    let mut corners = [0; PIECES + 1];
    let mut pieces = 1;
    corners[1] = way.len() - 1;
    if corners[1] == 0 {
        return;
    }
    while pieces < PIECES {
        // The place that lies furthest aside from its piece becomes a corner.
        let (mut most, mut split, mut after) = (ASIDE * ASIDE, 0, 0);
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
                if aside > most {
                    (most, split, after) = (aside, k, piece);
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
