//! TEXT, MTEXT and ATTRIB entities.

use super::mtext::{self, Line, Notes, Style};
use super::record::{Read, Record, Shapes};
use crate::drawing::Problem;
use crate::read::ReadOptions;
use crate::read::text::{Anchor, Font};
use crate::read::text_remedy;
use kurbo::Affine;

/// Distance of two baselines, in heights of a capital letter.
const LINE_SPACING: f64 = 5.0 / 3.0;

/// Reads a text as outlines of the font, or refuses it.
pub fn read(record: &Record, options: &ReadOptions, tolerance: f64) -> Result<Read, Problem> {
    let multi = record.kind == "MTEXT";
    let raw = content(record);
    let height = record.or(40, 1.0)?;
    let style = Style {
        height,
        width: 1.0,
        oblique: 0.0,
    };
    let mut notes = Notes::new();
    let mut lines = if multi {
        mtext::lines(&raw, style, &mut notes)
    } else {
        vec![mtext::single_line(&raw, style, &mut notes)]
    };
    let letters = |line: &Line| line.iter().map(|one| one.0).collect::<String>();
    let all = lines.iter().map(letters).collect::<Vec<_>>().join(" ");
    let shown: String = all.chars().take(40).collect();
    if all.trim().is_empty() {
        return Ok(Read::LeftOut("its text is empty".into()));
    }
    let Some(font) = options.font else {
        if options.skip_text {
            return Ok(Read::LeftOut(format!("'{shown}' is text without a font")));
        }
        let what = format!("'{shown}' is text, which has no outlines of its own");
        return Err(record.refuse(what, text_remedy()));
    };
    if all.contains(char::REPLACEMENT_CHARACTER) {
        return Err(record.refuse(
            format!("'{shown}' has bytes that are no characters of the file's encoding"),
            "save the drawing as DXF 2007 or later, which is UTF-8",
        ));
    }
    if height <= 0.0 {
        return Err(record.refuse(format!("its height is {height}"), "repair the entity"));
    }
    let layout = if multi {
        let width = record.or(41, 0.0)?;
        if width > 0.0 {
            lines = wrapped(&lines, width, font);
        }
        multi_layout(record, &lines, height)?
    } else {
        let natural = lines.first().map_or(0.0, |line| width(line, font));
        let descent = height * font.descent() / font.capital_height();
        single_layout(record, height, descent, natural)?
    };
    let mut shapes = Shapes {
        notes,
        ..Shapes::default()
    };
    for (line, &below) in lines.iter().zip(&layout.baselines) {
        let mut x = match layout.anchor {
            Anchor::Start => 0.0,
            Anchor::Middle => -width(line, font) / 2.0,
            Anchor::End => -width(line, font),
        } * layout.width;
        for run in line.chunk_by(|a, b| a.1 == b.1) {
            let style = run[0].1;
            let em = style.height / font.capital_height();
            let text: String = run.iter().map(|one| one.0).collect();
            let map = layout.place
                * Affine::translate((x, -below))
                * Affine::skew((layout.oblique + style.oblique).tan(), 0.0)
                * Affine::scale_non_uniform(em * style.width * layout.width, em);
            let outline = font.outline(&text, Anchor::Start, map, tolerance);
            let outline = outline.map_err(|what| {
                record.refuse(
                    format!("'{shown}': {what}"),
                    "choose another font with --font",
                )
            })?;
            shapes.paths.extend(outline);
            x += font.width(&text) * em * style.width * layout.width;
        }
    }
    Ok(Read::Shapes(shapes))
}

/// Width of letters, in units of the drawing.
fn width(letters: &[(char, Style)], font: &Font) -> f64 {
    let mut bytes = [0; 4];
    let widths = letters.iter().map(|(one, style)| {
        let em = style.height / font.capital_height();
        font.width(one.encode_utf8(&mut bytes)) * em * style.width
    });
    widths.sum()
}

struct Layout {
    /// Map of the text's own axes, with the insertion point as origin, to the drawing.
    place: Affine,
    anchor: Anchor,
    /// Distances from the point down to the baselines of the lines.
    baselines: Vec<f64>,
    /// Factor of the width of letters.
    width: f64,
    oblique: f64,
}

/// Layout of a text of one line. Its letters reach `descent` below the baseline; `natural` is its
/// width at a width factor of 1.
fn single_layout(
    record: &Record,
    height: f64,
    descent: f64,
    natural: f64,
) -> Result<Layout, Problem> {
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
        (1, _) => -descent,
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
        baselines: vec![down],
        width,
        oblique: record.or(51, 0.0)?.to_radians(),
    })
}

fn multi_layout(record: &Record, lines: &[Line], height: f64) -> Result<Layout, Problem> {
    let attachment = record.integer(71)?.unwrap_or(1);
    let anchor = match attachment % 3 {
        1 => Anchor::Start,
        2 => Anchor::Middle,
        _ => Anchor::End,
    };
    // Spacing "at least": higher letters push their line down. Spacing "exact" has even lines.
    let exact = record.integer(73)? == Some(2);
    let tallest = |line: &Line| {
        let heights = line.iter().map(|one| one.1.height);
        heights
            .reduce(f64::max)
            .filter(|_| !exact)
            .unwrap_or(height)
    };
    let factor = LINE_SPACING * record.or(44, 1.0)?;
    let mut baselines = Vec::new();
    let mut below = 0.0;
    for line in lines {
        below += tallest(line) * if baselines.is_empty() { 1.0 } else { factor };
        baselines.push(below);
    }
    let up = match attachment {
        4..=6 => below / 2.0,
        7..=9 => below,
        _ => 0.0,
    };
    for baseline in &mut baselines {
        *baseline -= up;
    }
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
        baselines,
        width: 1.0,
        oblique: 0.0,
    })
}

/// Lines broken between words so that they fit a width, in units of the drawing.
fn wrapped(lines: &[Line], limit: f64, font: &Font) -> Vec<Line> {
    let mut out = Vec::new();
    for line in lines {
        let mut present = Line::new();
        // Each word with the blank in front of it.
        let mut from = 0;
        while from < line.len() {
            let behind = line[from + 1..].iter().position(|one| one.0 == ' ');
            let to = behind.map_or(line.len(), |length| from + 1 + length);
            let word = &line[from..to];
            let longer = [&present[..], word].concat();
            if present.is_empty() || width(&longer, font) <= limit {
                present = longer;
            } else {
                out.push(std::mem::replace(&mut present, word[1..].to_vec()));
            }
            from = to;
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
