//! Places of the numbers of starts on the plan, so that none covers another.

use crate::geometry::{Point, distance};
use std::fmt::Write as _;

/// Sizes of the letters that are tried, as a hundredth of the plan's longer side.
const SIZES: [f64; 4] = [2.0, 1.4, 1.0, 0.7];

/// Width of a digit, a comma or a space, as a part of the size: that of a wide font.
pub const WIDTH: f64 = 0.65;

/// Distance of two lines, as a part of the size.
pub const LINE: f64 = 1.15;

/// Characters of a line. Many starts at one place, as of many depths, need several.
const CHARACTERS: usize = 14;

/// Rings of places around a start that are tried, each a line farther away.
const RINGS: u32 = 12;

/// Low and high corner; y points down.
type Frame = [Point; 2];

/// The numbers at one place.
struct Label {
    start: Point,
    lines: Vec<String>,
}

impl Label {
    /// Width and height, as multiples of the size.
    fn extent(&self) -> Point {
        let longest = self.lines.iter().map(|line| line.chars().count()).max();
        let width = WIDTH * longest.unwrap_or(0) as f64;
        [width, LINE * self.lines.len() as f64]
    }

    /// Boxes to try at a start, the nearest first.
    fn boxes(&self, size: f64) -> impl Iterator<Item = Frame> {
        let [x, y] = self.start;
        let [width, height] = self.extent().map(|one| one * size);
        (0..RINGS).flat_map(move |ring| {
            let off = size * (0.25 + LINE * f64::from(ring));
            let (left, right) = (x - off - width, x + off);
            let (above, below) = (y - off - height, y + off);
            let corners = [[right, above], [left, above], [right, below], [left, below]];
            let middle = [x - width / 2.0, y - height / 2.0];
            let sides = [
                [middle[0], above],
                [right, middle[1]],
                [middle[0], below],
                [left, middle[1]],
            ];
            let all = corners.into_iter().chain(sides);
            all.map(move |low| [low, [low[0] + width, low[1] + height]])
        })
    }
}

fn overlap([low, high]: &Frame, [l, h]: &Frame) -> bool {
    (0..2).all(|axis| low[axis] < h[axis] && l[axis] < high[axis])
}

fn holds([low, high]: &Frame, [l, h]: &Frame) -> bool {
    (0..2).all(|axis| low[axis] <= l[axis] && high[axis] >= h[axis])
}

/// Rising numbers in lines of words: `1, 4-6,` and `9`.
fn lines(numbers: &[usize]) -> Vec<String> {
    let follows = |before: &usize, next: &usize| *next == before + 1;
    let mut out: Vec<String> = Vec::new();
    for run in numbers.chunk_by(follows) {
        let word = match run {
            [first, .., last] => format!("{first}-{last}"),
            _ => run.iter().map(usize::to_string).collect(),
        };
        match out.last_mut() {
            Some(line) if line.len() + word.len() < CHARACTERS - 2 => {
                let _ = write!(line, ", {word}");
            }
            Some(line) => {
                line.push(',');
                out.push(word);
            }
            None => out.push(word),
        }
    }
    out
}

/// Boxes of all labels that do not overlap, if there are such ones.
fn place(labels: &[Label], view: &Frame, size: f64) -> Option<Vec<Frame>> {
    let mut placed: Vec<Frame> = Vec::with_capacity(labels.len());
    for label in labels {
        let is_free =
            |one: &Frame| holds(view, one) && !placed.iter().any(|other| overlap(one, other));
        let free = label.boxes(size).find(is_free)?;
        placed.push(free);
    }
    Some(placed)
}

/// The texts of the numbers of starts (y up, mm) in a view (low and high corner, y down), with a
/// line to each that is away from its start.
pub fn texts(starts: &[Point], view: [Point; 2]) -> String {
    let unit = (view[1][0] - view[0][0]).max(view[1][1] - view[0][1]) / 100.0;
    // Starts of several depths are at one place.
    let mut groups: Vec<(Point, Vec<usize>)> = Vec::new();
    for (index, &start) in starts.iter().enumerate() {
        let mut known = groups.iter_mut();
        match known.find(|(place, _)| distance(*place, start) < unit) {
            Some((_, numbers)) => numbers.push(index + 1),
            None => groups.push((start, vec![index + 1])),
        }
    }
    let label = |(start, numbers): &(Point, Vec<usize>)| Label {
        start: [start[0], -start[1]],
        lines: lines(numbers),
    };
    let labels: Vec<Label> = groups.iter().map(label).collect();
    let fitting = SIZES.iter().find_map(|size| {
        let size = size * unit;
        Some((size, place(&labels, &view, size)?))
    });
    // Where not even small letters fit, every label is at its start.
    let (size, boxes) = fitting.unwrap_or_else(|| {
        let size = SIZES[SIZES.len() - 1] * unit;
        let first = |label: &Label| label.boxes(size).next().unwrap_or_default();
        (size, labels.iter().map(first).collect())
    });
    let mut out = String::new();
    for (label, [low, high]) in labels.iter().zip(boxes) {
        let [x, y] = label.start;
        let near = [x.clamp(low[0], high[0]), y.clamp(low[1], high[1])];
        if distance(near, label.start) > size {
            let _ = writeln!(
                out,
                "<line x1=\"{x:.3}\" y1=\"{y:.3}\" x2=\"{:.3}\" y2=\"{:.3}\" stroke=\"#666\" \
                 stroke-width=\"{:.3}\"/>",
                near[0],
                near[1],
                0.15 * unit
            );
        }
        for (row, line) in rows(&label.lines) {
            // The baseline is above the bottom of the line by the depth of a comma.
            let baseline = low[1] + size * (LINE * (row + 1.0) - 0.3);
            let _ = writeln!(
                out,
                "<text x=\"{:.3}\" y=\"{baseline:.3}\" font-size=\"{size:.3}\">{line}</text>",
                low[0]
            );
        }
    }
    out
}

fn rows(lines: &[String]) -> impl Iterator<Item = (f64, &String)> {
    lines
        .iter()
        .enumerate()
        .map(|(row, line)| (row as f64, line))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_in_short_lines() {
        assert_eq!(lines(&[1, 2, 3, 7]), ["1-3, 7"]);
        let long: Vec<usize> = (0..12).map(|k| 10 + 7 * k).collect();
        let found = lines(&long);
        assert_eq!(found[0], "10, 17, 24,");
        assert!(
            found.iter().all(|line| line.len() <= CHARACTERS),
            "{found:?}"
        );
        let words = found.join(" ");
        let numbers: Vec<usize> = words.split(", ").map(|one| one.parse().unwrap()).collect();
        assert_eq!(numbers, long);
    }
}
