//! Geometry of an arc from its words.

use super::block::{Block, Motion, Plane};
use super::lexer::Word;
use super::path::{Arc, Coordinates};
use super::problem::{Place, Problems};
use super::{Options, RADIUS_TOLERANCE_MM};
use std::f64::consts::TAU;

/// Returns the letters of a plane's axes, in the order in which G3 is a positive angle, their
/// centre words (0 for I), and the G word of the plane.
fn letters(plane: Plane) -> ([char; 2], [usize; 2], &'static str) {
    match plane {
        Plane::Xy => (['X', 'Y'], [0, 1], "G17"),
        Plane::Zx => (['Z', 'X'], [2, 0], "G18"),
        Plane::Yz => (['Y', 'Z'], [1, 2], "G19"),
    }
}

/// Reads the arc of a block from `from` to `to`; `scale` is mm per unit of the program. `None`
/// after a problem.
pub(crate) fn read_arc(
    block: &Block,
    (place, motion): (Place, Motion),
    plane: Plane,
    scale: f64,
    (from, to): (&Coordinates, &Coordinates),
    options: &Options,
    problems: &mut Problems,
) -> Option<Arc> {
    let (names, offsets, plane_name) = letters(plane);
    let find = |letter| {
        options
            .axes
            .iter()
            .take(6)
            .position(|axis| axis.letter == letter)
    };
    let (Some(first), Some(second)) = (find(names[0]), find(names[1])) else {
        let what = format!(
            "the machine has no plane {} {} ({plane_name})",
            names[0], names[1]
        );
        problems.add(place, what, "choose a plane of the machine's axes");
        return None;
    };
    let stray = (0..3)
        .filter(|k| !offsets.contains(k))
        .find_map(|k| block.centre[k].as_ref());
    if let Some(word) = stray {
        let what = format!("{} is not in the plane of {plane_name}", word.text);
        problems.add(
            word.place,
            what,
            "choose the plane with G17, G18 or G19, or the centre word of this plane",
        );
        return None;
    }
    let start = [from[first], from[second]];
    let end = [to[first], to[second]];
    let direction = if motion == Motion::CounterClockwise {
        1.0
    } else {
        -1.0
    };
    let centre_words = [&block.centre[offsets[0]], &block.centre[offsets[1]]];
    let has_centre = centre_words.iter().any(|word| word.is_some());
    let plane = [first, second];
    match (&block.radius, has_centre) {
        (Some(word), true) => {
            problems.add(
                word.place,
                "an arc with both a radius and a centre",
                "write R, or the centre words, not both",
            );
            None
        }
        (None, false) => {
            let what = "an arc with neither centre nor radius";
            problems.add(
                place,
                what,
                format!(
                    "write its centre from the start ({}), or R",
                    centre_letters(offsets)
                ),
            );
            None
        }
        (Some(word), false) => by_radius(
            word,
            word.value * scale,
            plane,
            start,
            end,
            direction,
            problems,
        ),
        (None, true) => {
            let offset =
                centre_words.map(|word| word.as_ref().map_or(0.0, |word| word.value * scale));
            by_centre(place, offset, plane, start, end, direction, problems)
        }
    }
}

fn centre_letters(offsets: [usize; 2]) -> String {
    offsets.map(|k| ["I", "J", "K"][k]).join(", ")
}

fn by_centre(
    place: Place,
    offset: [f64; 2],
    plane: [usize; 2],
    start: [f64; 2],
    end: [f64; 2],
    direction: f64,
    problems: &mut Problems,
) -> Option<Arc> {
    let centre = [start[0] + offset[0], start[1] + offset[1]];
    let to_end = [end[0] - centre[0], end[1] - centre[1]];
    let radius = [
        libm::hypot(offset[0], offset[1]),
        libm::hypot(to_end[0], to_end[1]),
    ];
    let smaller = radius[0].min(radius[1]);
    let difference = (radius[0] - radius[1]).abs();
    if smaller < 1e-6 {
        problems.add(
            place,
            "an arc without a radius: its centre is its own start or end",
            "check the centre words",
        );
        return None;
    }
    // The second bound is for small arcs, whose radii would differ by a large part.
    if difference > RADIUS_TOLERANCE_MM.min(0.1 * smaller) {
        let what = format!(
            "the arc's end is {:.6} mm from its centre and its start {:.6} mm: {difference:.6} mm apart",
            radius[1], radius[0]
        );
        problems.add(
            place,
            what,
            format!(
                "check end point and centre (from the start of the arc, incremental); up to {:.4} mm is accepted here",
                RADIUS_TOLERANCE_MM.min(0.1 * smaller)
            ),
        );
        return None;
    }
    let angle = libm::atan2(-offset[1], -offset[0]);
    let cross = -offset[0] * to_end[1] + offset[1] * to_end[0];
    let dot = -offset[0] * to_end[0] - offset[1] * to_end[1];
    let sweep = direction * libm::atan2(cross, dot);
    let closed = libm::hypot(end[0] - start[0], end[1] - start[1]) < 1e-6;
    let sweep = match (closed, sweep > 0.0) {
        (true, _) => TAU,
        (false, true) => sweep,
        (false, false) => sweep + TAU,
    };
    Some(Arc {
        plane,
        centre,
        radius,
        angle,
        sweep: direction * sweep,
    })
}

fn by_radius(
    word: &Word,
    radius: f64,
    plane: [usize; 2],
    start: [f64; 2],
    end: [f64; 2],
    direction: f64,
    problems: &mut Problems,
) -> Option<Arc> {
    let chord = [end[0] - start[0], end[1] - start[1]];
    let length = libm::hypot(chord[0], chord[1]);
    if length < 1e-6 {
        problems.add(
            word.place,
            "an arc by radius that ends where it starts",
            "write a full circle by its centre",
        );
        return None;
    }
    let size = radius.abs();
    let short = 0.5 * length - size;
    if short > 0.5 * RADIUS_TOLERANCE_MM || size < 1e-6 {
        let what = format!(
            "the ends of the arc are {length:.6} mm apart, more than twice the radius {size:.6} mm"
        );
        problems.add(word.place, what, "check end point and radius");
        return None;
    }
    // A radius that is too short by less than the tolerance gives a half circle over the chord.
    let height = if short >= 0.0 {
        0.0
    } else {
        ((size - 0.5 * length) * (size + 0.5 * length)).sqrt()
    };
    // Counter-clockwise and at most half a turn: the centre is on the left of the chord.
    let side = if radius < 0.0 { -direction } else { direction };
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
    let from_centre = [start[0] - centre[0], start[1] - centre[1]];
    let at_end = libm::hypot(end[0] - centre[0], end[1] - centre[1]);
    Some(Arc {
        plane,
        centre,
        radius: [libm::hypot(from_centre[0], from_centre[1]), at_end],
        angle: libm::atan2(from_centre[1], from_centre[0]),
        sweep: direction * sweep,
    })
}
