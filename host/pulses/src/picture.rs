//! Picture of a part of a capture.

use crate::NANOSECOND;
use crate::capture::Signal;
use std::fmt::Write as _;

const LEFT: f64 = 120.0;
const WIDTH: f64 = 1000.0;
const ROW: f64 = 34.0;
const LEVEL: f64 = 20.0;
const TOP: f64 = 16.0;
/// Largest number of level changes of a line that are drawn.
const MAX_CHANGES: usize = 4000;

/// Draws the lines between two times, in fs, as SVG. `marks` are commanded times of the line with
/// the same index, drawn as ticks below it.
///
/// # Errors
/// The part is empty, or has too many level changes for a picture.
pub fn picture(
    signals: &[&Signal],
    marks: &[Vec<i64>],
    from: i64,
    to: i64,
) -> Result<String, String> {
    if to <= from {
        return Err("the end of the part is not after its start".to_string());
    }
    let scale = WIDTH / (to - from) as f64;
    let x = |time: i64| LEFT + (time - from) as f64 * scale;
    let height = TOP + ROW * signals.len() as f64 + 34.0;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {:.0} {height:.0}\" \
         font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n",
        LEFT + WIDTH + 20.0
    );
    for (row, signal) in signals.iter().enumerate() {
        let low = TOP + ROW * row as f64 + LEVEL;
        let y = |level: bool| if level { low - LEVEL } else { low };
        let first = signal.changes_until(from);
        let end = signal.changes_until(to);
        if end - first > MAX_CHANGES {
            return Err(format!(
                "'{}' changes {} times in this part; a picture can show {MAX_CHANGES}, so choose a shorter one",
                signal.name,
                end - first
            ));
        }
        let mut level = signal.level_at(from);
        let mut path = format!("M{LEFT:.2} {:.1}", y(level));
        for change in &signal.changes[first..end] {
            level = !level;
            let _ = write!(path, "H{:.2}V{:.1}", x(*change), y(level));
        }
        let _ = write!(path, "H{:.2}", LEFT + WIDTH);
        let _ = writeln!(
            svg,
            "<text x=\"{:.0}\" y=\"{:.1}\" text-anchor=\"end\" fill=\"#3b4754\">{}</text>\n\
             <path d=\"{path}\" fill=\"none\" stroke=\"#0072b2\" stroke-width=\"1.2\"/>",
            LEFT - 8.0,
            low - 4.0,
            escape(signal.short_name()),
        );
        for mark in marks.get(row).into_iter().flatten() {
            if (from..=to).contains(mark) {
                let _ = writeln!(
                    svg,
                    "<path d=\"M{:.2} {:.1}v6\" stroke=\"#d55e00\"/>",
                    x(*mark),
                    low + 2.0
                );
            }
        }
    }
    let base = TOP + ROW * signals.len() as f64;
    let step = round_step((to - from) / 8);
    let mut at = from.div_euclid(step) * step;
    while at <= to {
        if at >= from {
            let _ = writeln!(
                svg,
                "<path d=\"M{0:.2} {TOP:.1}V{base:.1}\" stroke=\"#e8ebef\"/>\
                 <text x=\"{0:.2}\" y=\"{1:.1}\" text-anchor=\"middle\" fill=\"#5b6875\">{2}</text>",
                x(at),
                base + 18.0,
                label(at)
            );
        }
        at += step;
    }
    svg.push_str("</svg>\n");
    Ok(svg)
}

/// The next larger of 1, 2, 5 times a power of ten.
fn round_step(min: i64) -> i64 {
    let mut power = 1;
    loop {
        for digit in [1, 2, 5] {
            if digit * power >= min {
                return digit * power;
            }
        }
        power *= 10;
    }
}

/// A time in us.
fn label(time: i64) -> String {
    let us = time as f64 / (1000 * NANOSECOND) as f64;
    format!("{us} \u{b5}s")
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}
