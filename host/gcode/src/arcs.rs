//! Geometry of an arc from its ends, and its centre or radius.

use super::path::Arc;
use super::{RADIUS_TOLERANCE_INCH_MM, RADIUS_TOLERANCE_MM};
use std::f64::consts::TAU;

/// Ends and direction of an arc in its plane; mm.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ends {
    /// Indices of the plane's coordinates.
    pub plane: [usize; 2],
    pub start: [f64; 2],
    pub end: [f64; 2],
    /// 1 is counter-clockwise, -1 clockwise.
    pub direction: f64,
    /// Number of turns that are begun: 1 for an arc of at most a full circle.
    pub turns: u32,
}

/// Largest difference of half the chord and the radius of an arc by radius, mm.
const LARGEST_SHORT_MM: f64 = 0.0025;

/// Problem and remedy.
pub(crate) type Refusal = (String, String);

/// Largest share of the radii by which the radii of an arc differ, and the largest difference in
/// multiples of the absolute tolerance.
const RELATIVE_TOLERANCE: f64 = 1e-3;
const MAX_TOLERANCES: f64 = 100.0;

/// Returns the largest difference of an arc's radii, mm: the rule of LinuxCNC, and a tenth of the
/// radius.
fn tolerance(smaller: f64, inch: bool) -> f64 {
    let absolute = if inch {
        RADIUS_TOLERANCE_INCH_MM
    } else {
        RADIUS_TOLERANCE_MM
    };
    let larger = smaller / (1.0 - RELATIVE_TOLERANCE);
    absolute
        .max((RELATIVE_TOLERANCE * larger).min(MAX_TOLERANCES * absolute))
        .min(0.1 * smaller)
}

/// Returns the arc around a centre, given from the start.
pub(crate) fn by_centre(ends: &Ends, offset: [f64; 2], inch: bool) -> Result<Arc, Refusal> {
    let Ends { start, end, .. } = *ends;
    let centre = [start[0] + offset[0], start[1] + offset[1]];
    let to_end = [end[0] - centre[0], end[1] - centre[1]];
    let radius = [
        libm::hypot(offset[0], offset[1]),
        libm::hypot(to_end[0], to_end[1]),
    ];
    let smaller = radius[0].min(radius[1]);
    let difference = (radius[0] - radius[1]).abs();
    if smaller < 1e-6 {
        return Err((
            "an arc without a radius: its centre is its own start or end".into(),
            "check the centre words".into(),
        ));
    }
    let tolerance = tolerance(smaller, inch);
    if difference > tolerance {
        return Err((
            format!(
                "the arc's end is {:.6} mm from its centre and its start {:.6} mm: \
                 {difference:.6} mm apart",
                radius[1], radius[0]
            ),
            format!(
                "check end point and centre (from the start of the arc with G91.1, from the \
                 origin with G90.1); up to {tolerance:.4} mm is accepted here"
            ),
        ));
    }
    let angle = libm::atan2(-offset[1], -offset[0]);
    let cross = -offset[0] * to_end[1] + offset[1] * to_end[0];
    let dot = -offset[0] * to_end[0] - offset[1] * to_end[1];
    let sweep = ends.direction * libm::atan2(cross, dot);
    let closed = libm::hypot(end[0] - start[0], end[1] - start[1]) < 1e-6;
    let sweep = match (closed, sweep > 0.0) {
        (true, _) => TAU,
        (false, true) => sweep,
        (false, false) => sweep + TAU,
    };
    let sweep = sweep + TAU * f64::from(ends.turns.saturating_sub(1));
    Ok(Arc {
        plane: ends.plane,
        centre,
        radius,
        angle,
        sweep: ends.direction * sweep,
    })
}

/// Returns the arc of a radius; a negative one is an arc of more than half a turn.
pub(crate) fn by_radius(ends: &Ends, radius: f64) -> Result<Arc, Refusal> {
    let Ends { start, end, .. } = *ends;
    let chord = [end[0] - start[0], end[1] - start[1]];
    let length = libm::hypot(chord[0], chord[1]);
    if length < 1e-6 {
        return Err((
            "an arc by radius that ends where it starts".into(),
            "write a full circle by its centre".into(),
        ));
    }
    let size = radius.abs();
    let short = 0.5 * length - size;
    if short > LARGEST_SHORT_MM || size < 1e-6 {
        return Err((
            format!(
                "the ends of the arc are {length:.6} mm apart, more than twice the radius \
                 {size:.6} mm"
            ),
            "check end point and radius".into(),
        ));
    }
    // A radius that is too short by less than the tolerance gives a half circle over the chord.
    let height = if short >= 0.0 {
        0.0
    } else {
        ((size - 0.5 * length) * (size + 0.5 * length)).sqrt()
    };
    // Counter-clockwise and at most half a turn: the centre is on the left of the chord.
    let side = if radius < 0.0 {
        -ends.direction
    } else {
        ends.direction
    };
    let centre = [
        0.5 * (start[0] + end[0]) - side * height * chord[1] / length,
        0.5 * (start[1] + end[1]) + side * height * chord[0] / length,
    ];
    let half = libm::atan2(0.5 * length, height);
    let sweep = if radius < 0.0 {
        TAU - 2.0 * half
    } else {
        2.0 * half
    };
    let sweep = sweep + TAU * f64::from(ends.turns.saturating_sub(1));
    let from_centre = [start[0] - centre[0], start[1] - centre[1]];
    let at_end = libm::hypot(end[0] - centre[0], end[1] - centre[1]);
    Ok(Arc {
        plane: ends.plane,
        centre,
        radius: [libm::hypot(from_centre[0], from_centre[1]), at_end],
        angle: libm::atan2(from_centre[1], from_centre[0]),
        sweep: ends.direction * sweep,
    })
}
