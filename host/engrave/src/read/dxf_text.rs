//! TEXT, MTEXT and ATTRIB entities.

use super::ReadOptions;
use super::dxf_record::{Read, Record, Shapes};
use super::text::Anchor;
use super::text_remedy;
use crate::drawing::Problem;
use kurbo::Affine;

/// Distance of two baselines, in heights of a capital letter.
const LINE_SPACING: f64 = 5.0 / 3.0;

/// Reads a text as outlines of the font, or refuses it.
pub fn read(record: &Record, options: &ReadOptions) -> Result<Read, Problem> {
    let multi = record.kind == "MTEXT";
    let raw = content(record);
    let lines = if multi {
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
        multi_layout(record, lines.len(), height)?
    } else {
        single_layout(record, height)?
    };
    let plane = record.plane()?;
    let mut shapes = Shapes::default();
    for (index, line) in lines.iter().enumerate() {
        let below = layout.down + index as f64 * height * LINE_SPACING;
        let map = plane
            * Affine::translate((layout.at[0], layout.at[1]))
            * Affine::rotate(layout.angle)
            * Affine::translate((0.0, -below))
            * Affine::skew(layout.oblique.tan(), 0.0)
            * Affine::scale_non_uniform(em * layout.width, em);
        let outline = font.outline(line, layout.anchor, map);
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
    at: [f64; 2],
    angle: f64,
    anchor: Anchor,
    /// Distance from the point down to the first baseline.
    down: f64,
    width: f64,
    oblique: f64,
}

fn single_layout(record: &Record, height: f64) -> Result<Layout, Problem> {
    let (across, up) = (
        record.integer(72)?.unwrap_or(0),
        record.integer(73)?.unwrap_or(0),
    );
    let anchor = match across {
        1 | 4 => Anchor::Middle,
        2 => Anchor::End,
        _ => Anchor::Start,
    };
    // The second point counts where the text is not aligned left on its baseline.
    let aligned = (across != 0 || up != 0) && record.value(11).is_some();
    let fitted = matches!(across, 3 | 5);
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
    Ok(Layout {
        at,
        angle: record.or(50, 0.0)?.to_radians(),
        anchor,
        down,
        width: record.or(41, 1.0)?,
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
    let tall = height + (lines.max(1) - 1) as f64 * height * LINE_SPACING;
    let down = match attachment {
        4..=6 => height - tall / 2.0,
        7..=9 => height - tall,
        _ => height,
    };
    let angle = match (record.number(11)?, record.number(21)?) {
        (Some(x), Some(y)) if x != 0.0 || y != 0.0 => y.atan2(x),
        _ => record.or(50, 0.0)?.to_radians(),
    };
    Ok(Layout {
        at: record.point(10, 20)?,
        angle,
        anchor,
        down,
        width: 1.0,
        oblique: 0.0,
    })
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
