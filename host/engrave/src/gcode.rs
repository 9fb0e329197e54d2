//! Tool paths as part programs (RS274/NGC).

use crate::geometry::{Point, Segment};
use crate::toolpath::{Cut, PathStep, Toolpath};
use std::fmt::Write as _;

/// Numbers of the program.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rates {
    /// Feed along the paths, mm/min.
    pub feed: f64,
    /// Feed of plunges, mm/min.
    pub plunge: f64,
    /// Spindle speed, rev/min.
    pub speed: f64,
    /// Z of lifted moves, mm above the plate.
    pub lift_mm: f64,
}

/// Decimals of coordinates: 0.1 um.
const DECIMALS: i32 = 4;

/// Radius below which an arc is written as a line: the rounding of its centre would show.
const SMALLEST_RADIUS: f64 = 0.005;

/// Radius above which an arc is written as lines of its chords, mm.
const LARGEST_RADIUS: f64 = 20_000.0;

/// Length below which an arc whose rounded ends give another sweep is written as a line, mm.
const SHORT_ARC: f64 = 0.01;

/// Difference of the sweep of a written arc that no rounding explains, radians.
const OTHER_SWEEP: f64 = 0.5;

/// Difference of two angles that controls take for none, radians (`CIRCLE_FUZZ` of LinuxCNC).
const SAME_ANGLE: f64 = 1e-6;

/// Sweep of an arc as a control reads it, radians: above 0 to a whole circle, which it is where
/// both ends have the same angle. `start` and `end` are from the centre.
fn sweep_as_read(start: [i64; 2], end: [i64; 2], is_left: bool) -> f64 {
    let [start, end] = [start, end].map(|at| at.map(|part| part as f64));
    let cross = start[0] * end[1] - start[1] * end[0];
    let dot = start[0] * end[0] + start[1] * end[1];
    let turned = if is_left { cross } else { -cross }.atan2(dot);
    if turned > SAME_ANGLE {
        turned
    } else {
        turned + std::f64::consts::TAU
    }
}

/// A coordinate or a rate in its shortest form.
fn number(value: f64) -> String {
    shortest(rounded(value))
}

/// A number in units of the last decimal.
fn shortest(value: i64) -> String {
    let unit = 10_u64.pow(DECIMALS as u32);
    let sign = if value < 0 { "-" } else { "" };
    let whole = value.unsigned_abs() / unit;
    let part = value.unsigned_abs() % unit;
    if part == 0 {
        return format!("{sign}{whole}");
    }
    let text = format!("{sign}{whole}.{part:0width$}", width = DECIMALS as usize);
    text.trim_end_matches('0').into()
}

fn rounded(value: f64) -> i64 {
    (value * 10f64.powi(DECIMALS)).round() as i64
}

struct Writer {
    text: String,
    /// Position in units of the last decimal.
    at: [i64; 3],
    rates: Rates,
    feed: f64,
}

impl Writer {
    fn set_feed(&mut self, feed: f64) {
        if self.feed != feed {
            let _ = write!(self.text, " F{}", number(feed));
            self.feed = feed;
        }
    }

    /// A straight move to a point, if it is one after rounding.
    fn line(&mut self, word: &str, to: Point, z: f64, feed: Option<f64>) {
        let target = [rounded(to[0]), rounded(to[1]), rounded(z)];
        if target == self.at {
            return;
        }
        self.text.push_str(word);
        for (axis, letter) in ['X', 'Y', 'Z'].into_iter().enumerate() {
            if target[axis] != self.at[axis] {
                let _ = write!(self.text, " {letter}{}", shortest(target[axis]));
            }
        }
        if let Some(feed) = feed {
            self.set_feed(feed);
        }
        self.text.push('\n');
        self.at = target;
    }

    fn along(&mut self, segment: &Segment, z: f64) {
        let feed = self.rates.feed;
        let target = [rounded(segment.to[0]), rounded(segment.to[1]), rounded(z)];
        let Some(arc) = segment.arc() else {
            self.line("G1", segment.to, z, Some(feed));
            return;
        };
        if arc.radius < SMALLEST_RADIUS {
            self.line("G1", segment.to, z, Some(feed));
            return;
        }
        if arc.radius > LARGEST_RADIUS {
            let count = crate::geometry::chords(&arc, 0.0005);
            let above = self.at[2] as f64 / 10f64.powi(DECIMALS);
            for k in 1..=count {
                let part = k as f64 / count as f64;
                self.line(
                    "G1",
                    arc.point(part),
                    above + (z - above) * part,
                    Some(feed),
                );
            }
            return;
        }
        // The centre from the written start, so that its rounding does not add up.
        let unit = 10f64.powi(-DECIMALS);
        let centre = [0, 1].map(|k| rounded(arc.centre[k] - self.at[k] as f64 * unit));
        let from_centre = [0, 1].map(|k| target[k] - self.at[k] - centre[k]);
        let read = sweep_as_read(centre.map(|part| -part), from_centre, arc.sweep > 0.0);
        if (read - arc.sweep.abs()).abs() > OTHER_SWEEP {
            if arc.radius * arc.sweep.abs() < SHORT_ARC {
                self.line("G1", segment.to, z, Some(feed));
            } else {
                let (first, second) = segment.split(0.5);
                self.along(&first, f64::midpoint(self.at[2] as f64 * unit, z));
                self.along(&second, z);
            }
            return;
        }
        self.text
            .push_str(if arc.sweep > 0.0 { "G3" } else { "G2" });
        let _ = write!(
            self.text,
            " X{} Y{}",
            shortest(target[0]),
            shortest(target[1])
        );
        if target[2] != self.at[2] {
            let _ = write!(self.text, " Z{}", number(z));
        }
        let [i, j] = centre.map(shortest);
        let _ = write!(self.text, " I{i} J{j}");
        self.set_feed(feed);
        self.text.push('\n');
        self.at = target;
    }

    fn cut(&mut self, cut: &Cut) {
        let lift = self.rates.lift_mm;
        let z = |writer: &Self| writer.at[2] as f64 / 10f64.powi(DECIMALS);
        let present = z(self);
        self.line("G0", cut.start, present, None);
        let plunge = self.rates.plunge;
        self.line("G1", cut.start, cut.z, Some(plunge));
        let mut at = cut.start;
        for step in &cut.steps {
            match step {
                PathStep::Along(segment, z) => {
                    self.along(segment, *z);
                    at = segment.to;
                }
                PathStep::Vertical(z) => self.line("G1", at, *z, Some(plunge)),
            }
        }
        self.line("G0", at, lift, None);
    }
}

/// Writes a tool path as a part program. `title` lines become comments at its head. The top of the
/// plate is Z0, the tool starts and ends above `reference`.
#[must_use]
pub fn program(toolpath: &Toolpath, rates: Rates, reference: Point, title: &[String]) -> String {
    let mut writer = Writer {
        text: String::new(),
        at: [i64::MAX; 3],
        rates,
        feed: f64::NAN,
    };
    for line in title {
        let plain: String = line
            .chars()
            .map(|one| {
                if one.is_control() || one == '(' || one == ')' {
                    ' '
                } else {
                    one
                }
            })
            .collect();
        let _ = writeln!(writer.text, "; {plain}");
    }
    writer.text.push_str("G21 G17 G90 G94\n");
    if rates.speed > 0.0 {
        let _ = writeln!(writer.text, "S{} M3", number(rates.speed));
    }
    let lift = rates.lift_mm;
    let _ = writeln!(writer.text, "G0 Z{}", number(lift));
    writer.at[2] = rounded(lift);
    writer.line("G0", reference, lift, None);
    for cut in &toolpath.cuts {
        writer.cut(cut);
    }
    writer.line("G0", reference, lift, None);
    writer.text.push_str(if rates.speed > 0.0 {
        "M5\nM2\n"
    } else {
        "M2\n"
    });
    writer.text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_in_their_shortest_form() {
        let written = [0.0, -0.00001, 1.5, -0.25, 100.0, 12.34567, -3.00004].map(number);
        assert_eq!(written, ["0", "0", "1.5", "-0.25", "100", "12.3457", "-3"]);
    }
}
