//! TEXT, MTEXT and ATTRIB entities.

use super::ReadOptions;
use super::dxf_record::{Read, Record, Shapes};
use super::text::{Anchor, Font};
use super::text_remedy;
use crate::drawing::Problem;
use kurbo::Affine;

/// Distance of two baselines, in heights of a capital letter.
const LINE_SPACING: f64 = 5.0 / 3.0;

/// Reads a text as outlines of the font, or refuses it.
pub fn read(record: &Record, options: &ReadOptions, tolerance: f64) -> Result<Read, Problem> {
    let multi = record.kind == "MTEXT";
    let raw = content(record);
    let mut lines = if multi {
        plain_lines(&raw)
    } else {
        vec![special(&raw)]
    };
    let shown: String = lines.join(" ").chars().take(40).collect();
    if lines.iter().all(|line| line.trim().is_empty()) {
        return Ok(Read::LeftOut("its text is empty".into()));
    }
    let Some(font) = options.font else {
        if options.skip_text {
            return Ok(Read::LeftOut(format!("'{shown}' is text without a font")));
        }
        let what = format!("'{shown}' is text, which has no outlines of its own");
        return Err(record.refuse(what, text_remedy()));
    };
    let height = record.or(40, 1.0)?;
    if height <= 0.0 {
        return Err(record.refuse(format!("its height is {height}"), "repair the entity"));
    }
    let em = height / font.capital_height();
    let layout = if multi {
        let width = record.or(41, 0.0)? / em;
        if width > 0.0 {
            lines = wrapped(&lines, width, font);
        }
        multi_layout(record, lines.len(), height)?
    } else {
        single_layout(
            record,
            height,
            lines.first().map_or(0.0, |line| font.width(line)) * em,
        )?
    };
    let mut shapes = Shapes::default();
    for (index, line) in lines.iter().enumerate() {
        let below = layout.down + index as f64 * layout.pitch;
        let map = layout.place
            * Affine::translate((0.0, -below))
            * Affine::skew(layout.oblique.tan(), 0.0)
            * Affine::scale_non_uniform(em * layout.width, em);
        let outline = font.outline(line, layout.anchor, map, tolerance);
        let outline = outline.map_err(|what| {
            record.refuse(
                format!("'{shown}': {what}"),
                "choose another font with --font",
            )
        })?;
        shapes.paths.extend(outline);
    }
    Ok(Read::Shapes(shapes))
}

struct Layout {
    /// Map of the text's own axes, with the insertion point as origin, to the drawing.
    place: Affine,
    anchor: Anchor,
    /// Distance from the point down to the first baseline.
    down: f64,
    /// Distance of two baselines.
    pitch: f64,
    width: f64,
    oblique: f64,
}

/// Layout of a text of one line; `natural` is its width at a width factor of 1.
fn single_layout(record: &Record, height: f64, natural: f64) -> Result<Layout, Problem> {
    // An attribute has its vertical alignment in another group than a text.
    let vertical = if record.kind == "ATTRIB" { 74 } else { 73 };
    let (across, up) = (
        record.integer(72)?.unwrap_or(0),
        record.integer(vertical)?.unwrap_or(0),
    );
    let anchor = match across {
        1 | 4 => Anchor::Middle,
        2 => Anchor::End,
        _ => Anchor::Start,
    };
    // The second point counts where the text is not aligned left on its baseline.
    let aligned = (across != 0 || up != 0) && record.value(11).is_some();
    let fitted = aligned && matches!(across, 3 | 5);
    let at = if aligned && !fitted {
        record.point(11, 21)?
    } else {
        record.point(10, 20)?
    };
    let down = match (up, across) {
        (2, _) | (0, 4) => height / 2.0,
        (3, _) => height,
        _ => 0.0,
    };
    let (mut angle, mut width) = (record.or(50, 0.0)?.to_radians(), record.or(41, 1.0)?);
    let mut size = 1.0;
    if fitted {
        // Between two points: "aligned" (3) keeps the proportions, "fit" (5) the height.
        let to = record.point(11, 21)?;
        let span = [to[0] - at[0], to[1] - at[1]];
        angle = span[1].atan2(span[0]);
        let factor = span[0].hypot(span[1]) / natural;
        if factor > 0.0 && factor.is_finite() {
            (size, width) = if across == 3 {
                (factor, 1.0)
            } else {
                (1.0, factor)
            };
        }
    }
    let flags = record.integer(71)?.unwrap_or(0);
    let mirror = |bit: i64| if flags & bit != 0 { -size } else { size };
    let place = record.plane()?
        * Affine::translate((at[0], at[1]))
        * Affine::rotate(angle)
        * Affine::scale_non_uniform(mirror(2), mirror(4));
    Ok(Layout {
        place,
        anchor,
        down,
        pitch: height * LINE_SPACING,
        width,
        oblique: record.or(51, 0.0)?.to_radians(),
    })
}

fn multi_layout(record: &Record, lines: usize, height: f64) -> Result<Layout, Problem> {
    let attachment = record.integer(71)?.unwrap_or(1);
    let anchor = match attachment % 3 {
        1 => Anchor::Start,
        2 => Anchor::Middle,
        _ => Anchor::End,
    };
    let pitch = height * LINE_SPACING * record.or(44, 1.0)?;
    let tall = height + (lines.max(1) - 1) as f64 * pitch;
    let down = match attachment {
        4..=6 => height - tall / 2.0,
        7..=9 => height - tall,
        _ => height,
    };
    // The point and the direction are in the drawing plane, the angle is in the text's own plane.
    let plane = record.plane()?;
    let turn = match (record.number(11)?, record.number(21)?) {
        (Some(x), Some(y)) if x != 0.0 || y != 0.0 => {
            let mirrored = if plane.determinant() < 0.0 { -1.0 } else { 1.0 };
            Affine::rotate(y.atan2(x)) * Affine::scale_non_uniform(1.0, mirrored)
        }
        _ => plane * Affine::rotate(record.or(50, 0.0)?.to_radians()),
    };
    let at = record.point(10, 20)?;
    Ok(Layout {
        place: Affine::translate((at[0], at[1])) * turn,
        anchor,
        down,
        pitch,
        width: 1.0,
        oblique: 0.0,
    })
}

/// Lines broken between words so that they fit a width, in ems.
fn wrapped(lines: &[String], width: f64, font: &Font) -> Vec<String> {
    let mut out = Vec::new();
    for line in lines {
        let mut present = String::new();
        for word in line.split(' ') {
            let longer = if present.is_empty() {
                word.to_string()
            } else {
                format!("{present} {word}")
            };
            if present.is_empty() || font.width(&longer) <= width {
                present = longer;
            } else {
                out.push(std::mem::replace(&mut present, word.to_string()));
            }
        }
        out.push(present);
    }
    out
}

/// The string: chunks with code 3, then code 1.
fn content(record: &Record) -> String {
    let chunks = record.pairs.iter().filter(|pair| pair.code == 3);
    let last = record.pairs.iter().filter(|pair| pair.code == 1);
    chunks
        .chain(last)
        .map(|pair| pair.text().into_owned())
        .collect()
}

/// Replaces the codes of special characters: `%%d`, `%%p`, `%%c`, `\U+XXXX`.
fn special(text: &str) -> String {
    let text = text
        .replace("%%d", "\u{b0}")
        .replace("%%D", "\u{b0}")
        .replace("%%p", "\u{b1}")
        .replace("%%P", "\u{b1}")
        .replace("%%c", "\u{2300}")
        .replace("%%C", "\u{2300}")
        .replace("%%u", "")
        .replace("%%U", "")
        .replace("%%o", "")
        .replace("%%O", "");
    let mut out = String::new();
    let mut rest = text.as_str();
    while let Some(at) = rest.find("\\U+") {
        let (before, after) = rest.split_at(at);
        out.push_str(before);
        let code = after
            .get(3..7)
            .and_then(|hex| u32::from_str_radix(hex, 16).ok());
        match code.and_then(char::from_u32) {
            Some(one) => {
                out.push(one);
                rest = &after[7..];
            }
            None => {
                out.push_str("\\U+");
                rest = &after[3..];
            }
        }
    }
    out.push_str(rest);
    out
}

/// Lines of an MTEXT without its formatting codes.
fn plain_lines(text: &str) -> Vec<String> {
    let text = special(text);
    let mut lines = vec![String::new()];
    let mut chars = text.chars().peekable();
    while let Some(one) = chars.next() {
        let line = lines.len() - 1;
        match one {
            '{' | '}' => {}
            '^' => {
                // ^I is a tab, ^J a line end.
                match chars.next() {
                    Some('J') => lines.push(String::new()),
                    Some('I') => lines[line].push(' '),
                    _ => {}
                }
            }
            '\\' => match chars.next() {
                Some('P' | 'X') => lines.push(String::new()),
                Some('~') => lines[line].push(' '),
                Some(literal @ ('\\' | '{' | '}')) => lines[line].push(literal),
                Some('L' | 'l' | 'O' | 'o' | 'K' | 'k' | 'N') | None => {}
                Some('S') => {
                    for part in chars.by_ref().take_while(|&part| part != ';') {
                        lines[line].push(if part == '^' || part == '#' {
                            '/'
                        } else {
                            part
                        });
                    }
                }
                // A code with a value up to the semicolon: font, height, width, colour.
                Some(_) => for _ in chars.by_ref().take_while(|&part| part != ';') {},
            },
            other => lines[line].push(other),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formatting_codes_of_a_multi_line_text_go() {
        let text = r"\fTechnic|b0|i0|c2|p2;KMITL\P{\H2.5x;5%%d} \{a\} \S1/2;";
        assert_eq!(plain_lines(text), ["KMITL", "5\u{b0} {a} 1/2"]);
        assert_eq!(special(r"\U+00D8 5"), "\u{d8} 5");
    }
}
